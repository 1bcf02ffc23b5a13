"""A saved calibration, as figures and page read it: the same from a file and from a result."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.quality import TrustMark
from rtcal.calibration.record import KIND
from rtcal.errors import DataError
from rtcal.support.decode import json_object
from rtcal.support.files import read_text
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

MAX_BYTES = 2**25
"""Largest size of a saved result in bytes: a hundred times a usual one."""

_LARGEST = 1e30  # no quantity of a room comes near; squares of larger ones overflow


@dataclass(frozen=True, kw_only=True, eq=False)
class Saved:
    """A saved calibration, as `CalibrationResult.to_dict` has it, with its numbers as arrays.

    Attributes
    ----------
    record : mapping
        Everything, as it was read.
    centre_frequencies : array (n_bands,)
        Hz.
    measured, uncertainty, before, after : array (n_bands,)
        T in s, NaN where missing.
    gap_before, gap_after : array (n_bands,)
        JND.
    z, target, target_uncertainty, air_share, added_absorption : array (n_bands,)
        b and what effects add in m².
    materials : tuple of str
    areas : array (n_materials,)
        m².
    alpha_before, sigma_before, alpha_after, sigma_after : array (n_materials, n_bands)
    interval : array (2, n_materials, n_bands) or None
        Ends of the coefficients' exact 90 % interval, where it is known.
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
    """Return a record as arrays; DataError names the place where it is no saved calibration."""
    if record.get("rtcal") != KIND:
        raise DataError(f'{place}: no saved calibration: its "rtcal" is not "{KIND}"')
    try:
        return _checked(record)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        what = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(f"{place}: no saved calibration: {what}") from error


def _checked(record: Mapping[str, Any]) -> Saved:
    n = len(record["centre_frequencies"])
    materials = record["materials"]
    if not n or not materials:
        raise ValueError("no bands, or no materials")
    _texts(record, "room", "method", "equation")
    _texts(record["inputs"], "room", "measured")
    _texts(record["solver"], "name", "status")
    _texts(record["measured"], "caution", "fingerprint")
    if type(record["solver"]["polished"]) is not bool:
        raise ValueError("polished is neither true nor false")
    for text in (
        *record["unreachable"],
        *record["objective"],
        *record["constraints"],
        *record["measured"]["parameter"],
        *record["effects"],
    ):
        if not isinstance(text, str):
            raise ValueError(f"{text!r} is not a text")
    for name in ("primal_residual", "dual_residual", "duality_gap"):
        _array(record["certificate"][name], n)
    plausibility = record["plausibility"]
    for value in (
        record["volume"],
        plausibility["q"],
        plausibility["degrees_of_freedom"],
        record["band_correlation"],
        *record["effects"].values(),
        *record["equation_parameters"].values(),
        *record["measured"]["bands_not_in_room"],
    ):
        _number(value, missing=False)
    _number(plausibility["p_value"])
    for pair in record["material_correlation"]:
        _texts(dict(enumerate(pair["materials"])), 0, 1)
        if not -1 < _number(pair["value"], missing=False) < 1:
            raise ValueError("a correlation is not between -1 and 1")
    if record["air"] is not None:
        for name in ("temperature", "humidity", "pressure"):
            _number(record["air"][name], missing=False)
    _texts(record["versions"], "rtcal", *record["versions"])

    def rows(key: str) -> Array:
        return np.array([_array(m[key], n, missing=False) for m in materials])

    interval = None
    if all(m["interval_after"] is not None for m in materials):
        if any(len(m["interval_after"]) != 2 for m in materials):
            raise ValueError("interval_after has not two ends")
        interval = np.array(
            [[_array(m["interval_after"][e], n) for m in materials] for e in (0, 1)]
        )
    for m in materials:
        _texts(m, "name", "source")
        _array(m["error_bound"], n)
        if m["alpha_min"] is not None:
            _array(m["alpha_min"], n)
        if len(m["at_bound"]) != n or not set(m["at_bound"]) <= {"lower", "", "upper"}:
            raise ValueError("at_bound is not one of lower, upper and nothing a band")
    found = Saved(
        record=record,
        centre_frequencies=_array(record["centre_frequencies"], n, missing=False),
        measured=_array(record["measured"]["reverberation_time"], n),
        uncertainty=_array(record["measured"]["uncertainty"], n),
        before=_array(record["reverberation_time_before"], n),
        after=_array(record["reverberation_time_after"], n),
        gap_before=_array(record["gap_before_jnd"], n),
        gap_after=_array(record["gap_after_jnd"], n),
        z=_array(plausibility["z"], n),
        target=_array(record["target"], n),
        target_uncertainty=_array(record["target_uncertainty"], n),
        air_share=_array(record["air_share"], n),
        added_absorption=_array(record["added_absorption"], n),
        materials=tuple(m["name"] for m in materials),
        areas=_array([m["area"] for m in materials], len(materials), missing=False),
        alpha_before=rows("alpha_before"),
        sigma_before=rows("sigma_before"),
        alpha_after=rows("alpha_after"),
        sigma_after=rows("sigma_after"),
        interval=interval,
        shift_in_sigmas=rows("shift_in_sigmas"),
        at_bound=np.array([m["at_bound"] for m in materials]),
        trust_marks=tuple(_mark(m) for m in record["trust_marks"]),
    )
    for rule, values, low, high in (
        ("centre_frequencies", found.centre_frequencies, 1e-3, _LARGEST),
        ("area", found.areas, 1e-9, _LARGEST),
        ("reverberation_time", [found.measured, found.before, found.after], 1e-9, _LARGEST),
        ("uncertainty", found.uncertainty, 0, _LARGEST),
        ("alpha", [found.alpha_before, found.alpha_after], 0, 1),
        ("sigma", [found.sigma_before, found.sigma_after], 0, _LARGEST),
        ("air_share", found.air_share, 0, 1),
    ):
        outside = (np.asarray(values) < low) | (np.asarray(values) > high)  # not where missing
        if outside.any():
            raise ValueError(f"{rule} has a value outside {low:g} to {high:g}")
    if (np.diff(found.centre_frequencies) <= 0).any():
        raise ValueError("centre_frequencies do not increase")
    return found


def _array(values: Any, n: int, missing: bool = True) -> Array:
    if not isinstance(values, list) or len(values) != n:
        raise ValueError(f"{str(values)[:40]} is not a list of {n} numbers")
    return np.array([_number(v, missing) for v in values])


def _number(value: Any, missing: bool = True) -> float:
    if value is None and missing:
        return math.nan
    real = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not real or not abs(value) < _LARGEST:  # NaN is not below it either
        raise ValueError(f"{str(value)[:40]} is not a number below {_LARGEST:g}")
    return float(value)


def _texts(table: Mapping[Any, Any], *keys: str | int) -> None:
    for key in keys:
        if not isinstance(table[key], str):
            raise ValueError(f"{key} = {str(table[key])[:40]} is not a text")


def _mark(entry: Mapping[str, Any]) -> TrustMark:
    _texts(entry, "kind", "letter", "text", "advice")
    frequency = entry["frequency"]
    return TrustMark(
        entry["kind"],
        entry["letter"],
        None if frequency is None else _number(frequency),
        entry["text"],
        entry["advice"],
    )
