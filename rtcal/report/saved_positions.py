"""A saved calibration to every position, as its page uses it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from rtcal.acoustics.parameters import UNITS
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.decode import Entries, Rule, list_of, named, optional, record_of
from rtcal.support.types import Array

_LARGEST = 1e6  # far above any gap in JND, length in m and shift in sigmas
_ALPHA = (0.0, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class SavedPositions:
    """A calibration to every position with its numbers as arrays; see `PositionsResult.to_dict`.

    Attributes
    ----------
    record : mapping
        The whole record, as read.
    centre_frequencies : array (n_bands,)
    parameters : tuple of str
    pairs : tuple of (source, receiver)
    gap_before, gap_after : array (n_parameters, n_pairs, n_bands)
        JND, NaN where missing.
    materials : tuple of str
    areas : array (n_materials,)
    alpha_before, sigma_before, alpha_after, sigma_after : array (n_materials, n_bands)
    interval : array (2, n_materials, n_bands) or None
    scattering : (array, array) or None
        Coefficients and their sigma, (n_materials, n_bands), if they were fitted.
    pulls : array (n_pairs, n_materials, n_bands)
    misfit : array (n_pairs,)
    faces : list of array (n_corners, 3)
        Of the room in m; empty if it has no geometry.
    sources, receivers : mapping of str to array (3,)
    """

    record: Mapping[str, Any]
    centre_frequencies: Array
    parameters: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    gap_before: Array
    gap_after: Array
    materials: tuple[str, ...]
    areas: Array
    alpha_before: Array
    sigma_before: Array
    alpha_after: Array
    sigma_after: Array
    interval: Array | None
    scattering: tuple[Array, Array] | None
    pulls: Array
    misfit: Array
    faces: list[Array]
    sources: Mapping[str, Array]
    receivers: Mapping[str, Array]

    @property
    def shift(self) -> Array:
        """How far alpha moved, in prior sigmas, (n_materials, n_bands); 0 where sigma is 0."""
        sigma = np.where(self.sigma_before > 0, self.sigma_before, np.inf)
        return np.asarray((self.alpha_after - self.alpha_before) / sigma)


def read(record: Mapping[str, Any], place: str) -> SavedPositions:
    """Return a record as `PositionsResult.to_dict` returns it; messages name it by ``place``.

    Raises DataError, with place, value and rule, if it breaks a rule.
    """
    try:
        return _read(record)
    except DataError as error:
        raise DataError(f"{place}: no calibration to every position: {error}") from error


def _read(record: Mapping[str, Any]) -> SavedPositions:
    entries = Entries("", record, _KEYS, record)
    frequencies = entries.array("centre_frequencies", (None,), limits=(1.0, 1e6))
    parameters = entries.texts("parameters")
    if unknown := [p for p in parameters if p not in UNITS]:
        raise DataError(f"parameters has {checks.shown(unknown[0])}, which is no parameter")
    pairs = [_pair(pair) for pair in entries.listed("pairs")]
    if not (len(frequencies) and parameters and pairs):
        raise DataError("it has no band, parameter or pair")
    n_bands, n_pairs = len(frequencies), len(pairs)
    gap = partial(
        Entries.array,
        shape=(len(parameters), n_pairs, n_bands),
        limits=(-_LARGEST, _LARGEST),
        missing=True,
    )
    alpha = partial(Entries.array, shape=(n_bands,), limits=_ALPHA)
    rules: dict[str, Rule] = {
        "name": Entries.text,
        "area": partial(Entries.number, limits=(0.0, _LARGEST)),
        "alpha_before": alpha,
        "sigma_before": alpha,
        "alpha_after": alpha,
        "sigma_after": partial(Entries.array, shape=(n_bands,), limits=(0.0, _LARGEST)),
        "interval_after": optional(partial(Entries.array, shape=(2, n_bands), limits=_ALPHA)),
        "pulls": partial(Entries.array, shape=(n_pairs, n_bands), limits=(-_LARGEST, _LARGEST)),
    }
    materials = list_of(record_of(rules))(entries, "materials")
    if not materials:
        raise DataError("it has no material")
    columns = {key: [m[key] for m in materials] for key in rules}
    coefficients = partial(Entries.array, shape=(len(materials), n_bands), limits=_ALPHA)
    rules_of_scattering: dict[str, Rule] = {
        "model": Entries.text,
        "mean": partial(Entries.number, limits=_ALPHA),
        "coefficients": coefficients,
        "sigma": coefficients,
    }
    scattering = optional(record_of(rules_of_scattering))(entries, "scattering")
    intervals = columns["interval_after"]
    plan = optional(record_of(_PLAN))(entries, "plan") or {
        "sources": {},
        "receivers": {},
        "faces": [],
    }
    if plan["faces"] and (lost := [r for _, r in pairs if r not in plan["receivers"]]):
        raise DataError(f"plan.receivers lacks {checks.shown(lost[0])}")
    if any(len(face) < 3 for face in plan["faces"]):
        raise DataError("plan.faces has a face of fewer than 3 corners")
    for key, rule in _SHOWN.items():
        rule(entries, key)
    for pair in entries.listed("contradictions"):
        _pair(pair)
    return SavedPositions(
        record=record,
        centre_frequencies=frequencies,
        parameters=tuple(parameters),
        pairs=tuple(pairs),
        gap_before=gap(entries, "gap_before_jnd"),
        gap_after=gap(entries, "gap_after_jnd"),
        materials=tuple(columns["name"]),
        areas=np.array(columns["area"]),
        alpha_before=np.array(columns["alpha_before"]),
        sigma_before=np.array(columns["sigma_before"]),
        alpha_after=np.array(columns["alpha_after"]),
        sigma_after=np.array(columns["sigma_after"]),
        interval=None if any(i is None for i in intervals) else np.stack(intervals, axis=1),
        scattering=scattering and (scattering["coefficients"], scattering["sigma"]),
        pulls=np.stack(columns["pulls"], axis=1),
        misfit=entries.array("misfit", (n_pairs,), limits=(0.0, np.inf)),
        faces=plan["faces"],
        sources=plan["sources"],
        receivers=plan["receivers"],
    )


def _pair(value: Any) -> tuple[str, str]:
    if not isinstance(value, list) or len(value) != 2 or not all(isinstance(v, str) for v in value):
        raise DataError(f"{checks.shown(value)} is no pair of a source and a receiver")
    return value[0], value[1]


_POINT = partial(Entries.array, shape=(3,), limits=(-_LARGEST, _LARGEST))
_PLAN: dict[str, Rule] = {
    "sources": named(_POINT),
    "receivers": named(_POINT),
    "faces": list_of(partial(Entries.array, shape=(None, 3), limits=(-_LARGEST, _LARGEST))),
}
_SHOWN: dict[str, Rule] = {
    "room": Entries.text,
    "author": Entries.text,
    "simulator": Entries.text,
    "level": Entries.text,
    "control_runs": partial(Entries.whole, least=0),
    "error_scale": partial(Entries.number, limits=(1.0, np.inf)),
    "settled": Entries.flag,
    "notes": Entries.texts,
}
_KEYS = (
    *_SHOWN,
    "centre_frequencies",
    "parameters",
    "pairs",
    "gap_before_jnd",
    "gap_after_jnd",
    "materials",
    "misfit",
    "contradictions",
    "plan",
    "scattering",
)
