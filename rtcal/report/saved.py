"""A saved calibration, from a file or from a result, as the figures and the page use it."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.quality import TrustMark
from rtcal.calibration.record import KIND
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.decode import Entries, Rule, json_object, list_of, named, optional, record_of
from rtcal.support.files import read_text
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

MAX_BYTES = 2**25
"""Largest size of a saved result in bytes: a hundred times a usual one."""

_LARGEST = 1e30  # far above any quantity of a room; the square of larger numbers may overflow


@dataclass(frozen=True, kw_only=True, eq=False)
class Saved:
    """A saved calibration with its numbers as arrays; see `CalibrationResult.to_dict`.

    Attributes
    ----------
    record : mapping
        The whole record, as read.
    centre_frequencies : array (n_bands,)
        Hz.
    measured, uncertainty, before, after : array (n_bands,)
        T in s, NaN where missing.
    gap_before, gap_after : array (n_bands,)
        JND.
    z, target, target_uncertainty, air_share, added_absorption : array (n_bands,)
        z; b and its uncertainty in m²; the air's share; the effects' absorption area in m².
    materials : tuple of str
    areas : array (n_materials,)
        m².
    alpha_before, sigma_before, alpha_after, sigma_after : array (n_materials, n_bands)
    interval : array (2, n_materials, n_bands) or None
        Ends of the coefficients' exact 90 % interval; None if it was not computed.
    shift_in_sigmas : array (n_materials, n_bands)
    at_bound : array (n_materials, n_bands) of str
        "lower", "upper" or "".
    trust_marks : tuple of TrustMark
    """

    record: Mapping[str, Any]
    centre_frequencies: Array
    measured: Array
    uncertainty: Array
    before: Array
    after: Array
    gap_before: Array
    gap_after: Array
    z: Array
    target: Array
    target_uncertainty: Array
    air_share: Array
    added_absorption: Array
    materials: tuple[str, ...]
    areas: Array
    alpha_before: Array
    sigma_before: Array
    alpha_after: Array
    sigma_after: Array
    interval: Array | None
    shift_in_sigmas: Array
    at_bound: np.ndarray[Any, np.dtype[np.str_]]
    trust_marks: tuple[TrustMark, ...]

    @property
    def matched(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Which bands were matched, (n_bands,)."""
        return np.isfinite(self.target)


def saved(result: CalibrationResult | Saved) -> Saved:
    """Return a result as it would be read from its file."""
    return result if isinstance(result, Saved) else from_dict(result.to_dict())


def read_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return a JSON object; DataError if the file cannot be read or holds something else."""
    text = read_text(path, MAX_BYTES)
    try:
        return json_object(text)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def read(path: str | os.PathLike[str]) -> Saved:
    """Read ``result.json``, or the one in a folder that ``rtcal calibrate --out`` wrote."""
    place = Path(path) / "result.json" if Path(path).is_dir() else Path(path)
    return from_dict(read_json(place), os.fspath(place))


def from_dict(record: Mapping[str, Any], place: str = "result") -> Saved:
    """Return a record as arrays.

    Raises DataError, with place, value and rule, if the record is no saved calibration.
    """
    if record.get("rtcal") != KIND:
        raise DataError(f'{place}: no saved calibration: its "rtcal" is not "{KIND}"')
    try:
        return _decoded(record)
    except DataError as error:
        raise DataError(f"{place}: no saved calibration: {error}") from error


_ANY = (-_LARGEST, _LARGEST)
_SIZE = (0.0, _LARGEST)
_POSITIVE = (1e-9, _LARGEST)
_SHARE = (0.0, 1.0)
_CORRELATION = (-1.0, 1.0)


def _number(limits: tuple[float, float], missing: bool = False) -> Rule:
    return partial(Entries.array, shape=(), limits=limits, missing=missing)


def _rules(n: int) -> dict[str, Rule]:
    """Return the rule of each key of a record with ``n`` bands."""

    def bands(limits: tuple[float, float], *more: int | None, missing: bool = True) -> Rule:
        return partial(Entries.array, shape=(*more, n), limits=limits, missing=missing)

    def each(keys: str, rule: Rule) -> dict[str, Rule]:
        return dict.fromkeys(keys.split(), rule)

    text, texts = Entries.text, Entries.texts
    residuals = record_of(each("primal_residual dual_residual duality_gap", bands(_ANY)))
    solver: dict[str, Rule] = {
        **each("name status", text),
        "iterations": partial(Entries.whole, least=0),
        "seconds": _number(_SIZE, missing=True),
        "polished": Entries.flag,
        "raw_certificate": residuals,
        "raw_alpha": bands(_ANY, None),
    }
    measured: dict[str, Rule] = {
        "reverberation_time": bands(_POSITIVE),
        "uncertainty": bands(_SIZE),
        "parameter": texts,
        "bands_not_in_room": partial(Entries.array, shape=(None,), limits=_POSITIVE),
        **each("fingerprint caution", text),
    }
    material: dict[str, Rule] = {
        **each("name source", text),
        "area": _number(_POSITIVE),
        **each("alpha_before alpha_after", bands(_SHARE, missing=False)),
        **each("sigma_before sigma_after", bands(_SIZE, missing=False)),
        "shift_in_sigmas": bands(_ANY, missing=False),
        "interval_after": optional(bands(_SHARE, 2)),
        "alpha_min": optional(bands(_SHARE)),
        "at_bound": texts,
        "error_bound": bands(_SIZE),
    }
    plausibility: dict[str, Rule] = {
        "z": bands(_ANY),
        "q": _number(_SIZE),
        "degrees_of_freedom": partial(Entries.whole, least=0),
        "p_value": _number(_SHARE, missing=True),
    }
    mark = {**each("kind letter text advice", text), "frequency": _number(_POSITIVE, missing=True)}
    return {
        **each("rtcal room method equation", text),
        **each("objective constraints unreachable", texts),
        **each("equation_parameters effects", named(_number(_ANY))),
        "versions": named(text),
        "inputs": record_of(each("room measured", text)),
        "matches_measured_time": Entries.flag,
        "volume": _number(_POSITIVE),
        "air": optional(record_of(each("temperature humidity pressure", _number(_ANY)))),
        "band_correlation": _number(_CORRELATION),
        "material_correlation": list_of(
            record_of({"materials": texts, "value": _number(_CORRELATION)})
        ),
        "centre_frequencies": bands((1e-3, _LARGEST), missing=False),
        **each("reverberation_time_before reverberation_time_after", bands(_POSITIVE)),
        **each("gap_before_jnd gap_after_jnd target", bands(_ANY)),
        **each("added_absorption multipliers", bands(_ANY)),
        "target_uncertainty": bands(_SIZE),
        "air_share": bands(_SHARE),
        "measured": record_of(measured),
        "materials": list_of(record_of(material)),
        "plausibility": record_of(plausibility),
        "trust_marks": list_of(record_of(mark)),
        "certificate": residuals,
        "solver": record_of(solver),
    }


def _decoded(record: Mapping[str, Any]) -> Saved:
    n = len(Entries("", record, (), record).listed("centre_frequencies"))
    rules = _rules(n)
    file = Entries("", record, rules)
    values = {key: rule(file, key) for key, rule in rules.items()}
    materials, measured, frequencies = (
        values[key] for key in ("materials", "measured", "centre_frequencies")
    )
    if not n or (np.diff(frequencies) <= 0).any():
        raise DataError("centre_frequencies is empty or does not increase")
    if not materials:
        raise DataError("materials is empty")
    for i, material in enumerate(materials):
        sides = material["at_bound"]
        if len(sides) != n or not set(sides) <= {"lower", "", "upper"}:
            raise DataError(
                f'materials[{i}].at_bound = {checks.shown(sides)} is not "lower", "upper" or "" for '
                f"each of {n} bands"
            )
    for i, pair in enumerate(values["material_correlation"]):
        if len(pair["materials"]) != 2:
            raise DataError(f"material_correlation[{i}].materials are not two")
    ends = [material["interval_after"] for material in materials]

    def of_materials(key: str) -> Any:
        return np.array([material[key] for material in materials])

    return Saved(
        record=record,
        centre_frequencies=frequencies,
        measured=measured["reverberation_time"],
        uncertainty=measured["uncertainty"],
        before=values["reverberation_time_before"],
        after=values["reverberation_time_after"],
        gap_before=values["gap_before_jnd"],
        gap_after=values["gap_after_jnd"],
        z=values["plausibility"]["z"],
        target=values["target"],
        target_uncertainty=values["target_uncertainty"],
        air_share=values["air_share"],
        added_absorption=values["added_absorption"],
        materials=tuple(material["name"] for material in materials),
        areas=of_materials("area"),
        alpha_before=of_materials("alpha_before"),
        sigma_before=of_materials("sigma_before"),
        alpha_after=of_materials("alpha_after"),
        sigma_after=of_materials("sigma_after"),
        interval=None if any(e is None for e in ends) else np.stack(ends, axis=1),
        shift_in_sigmas=of_materials("shift_in_sigmas"),
        at_bound=of_materials("at_bound"),
        trust_marks=tuple(_mark(entry) for entry in values["trust_marks"]),
    )


def _mark(entry: Mapping[str, Any]) -> TrustMark:
    frequency = float(entry["frequency"])
    return TrustMark(**{**entry, "frequency": None if math.isnan(frequency) else frequency})
