"""The measured features of a case, and the state of its room in each configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.measurement import MAX_POSITIONS, Measurement
from rtcal.acoustics.observables import observable, parameter_label
from rtcal.finder.case import AppliedEffect, Case
from rtcal.finder.configuration import Configuration
from rtcal.finder.effects.checks import changed_states
from rtcal.finder.model import FEATURES, RoomState
from rtcal.support.errors import DataError
from rtcal.support.types import Array

LARGEST_UNCERTAINTY = 0.15
"""Relative standard uncertainty of T beyond which a band is dropped: three JND of T (5 % each).

The evidence takes ln T as normal. With u = 15 % the mean of ln T is off by u²/2 = 1.1 %, which is 0.08
of its standard deviation; the error grows with u."""
TIMES, LEVELS = ("t20", "edt", "t30"), ("c80", "g")
SHARED_BY_T20_AND_T30 = 0.75
"""Correlation of that error between T20 and T30 of one decay, which share most of their range."""
ONE_LEVEL = 1.0
"""Standard deviation of C80 and G in dB over the positions of a room, where a single value has none."""

MADE = "not stated; made from scatter over pairs, theory and reproducibility"
"""Origin of an uncertainty that is not stated."""


@dataclass(frozen=True, eq=False)
class ObservedFeatures:
    """The measured features.

    Attributes
    ----------
    features : array (n_configurations, n_features, n_bands)
        NaN where nothing was measured.
    used : bool array, same shape
    covariance : array (n_used, n_used)
        R, the measurement covariance of the features in use.
    origin : str
        Where the uncertainties come from, in words.
    """

    features: Array
    used: Array
    covariance: Array
    origin: str = ""

    @cached_property
    def values(self) -> Array:
        """The features in use, (n_used,)."""
        return np.asarray(self.features[self.used])


def steps(case: Case, used: Array) -> dict[int, str]:
    """Return numbers of leading features, T20 of the first configuration and all, and their names.

    ``used`` is as `ObservedFeatures.used`.
    """
    first = int(np.argmax(used.any((1, 2))))
    configuration = case.configurations[first]
    time = parameter_label("t20" if "t20" in configuration.measured.values else "t30")
    of = f' of "{configuration.name}"' if len(case.configurations) > 1 else ""
    return {int(used[first, 0].sum()): f"{time}{of}", int(used.sum()): "all data"}


def observe(case: Case) -> tuple[ObservedFeatures, list[str]]:
    """Return the measured features, and in words which bands were dropped.

    Raises
    ------
    DataError
        If no band is left.
    """
    notes: list[str] = []
    origins: dict[str, list[str]] = {}
    n, k = len(case.configurations), case.room.n_bands
    table = np.full((n, len(FEATURES), k), np.nan)
    blocks = np.zeros((n, k, len(FEATURES), len(FEATURES)))
    for c, configuration in enumerate(case.configurations):
        table[c], blocks[c] = _features(configuration, origins)
        for b, f in enumerate(configuration.measured.centre_frequencies):
            if blocks[c, b, 0, 0] > LARGEST_UNCERTAINTY**2:
                u = 100 * float(np.sqrt(blocks[c, b, 0, 0]))
                notes.append(
                    f'"{configuration.name}": {bands.label(f)} dropped: T is known to {u:.0f} % only'
                )
                table[c, :, b] = np.nan
            elif np.isnan(table[c, 0, b]):
                notes.append(f'"{configuration.name}": {bands.label(f)} dropped: no T20')
                table[c, :, b] = np.nan
    used = np.isfinite(table)
    full = np.zeros((n, len(FEATURES), k, n, len(FEATURES), k))
    for c in range(n):
        for b in range(k):
            full[c, :, b, c, :, b] = np.nan_to_num(blocks[c, b])
    flat = used.ravel()
    size = flat.size
    if not used.any():
        raise DataError(
            "no band of any configuration has a T that can be trusted: " + "; ".join(notes)
        )
    words = "; ".join(f"{', '.join(ps)}: {origin}" for origin, ps in origins.items())
    covariance = full.reshape(size, size)[np.ix_(flat, flat)]
    return ObservedFeatures(table, used, covariance, f"uncertainty of {words}"), notes


def _features(configuration: Configuration, origins: dict[str, list[str]]) -> tuple[Array, Array]:
    """Return the features (n_features, n_bands) and their covariance in each band."""
    m = configuration.measured
    amount = "t20" if "t20" in m.values else "t30"
    mean = {p: m.mean(p) for p in (*TIMES, *LEVELS)}
    with np.errstate(divide="ignore", invalid="ignore"):
        table = np.stack(
            [
                np.log(mean[amount]),
                np.log(mean["edt"] / mean[amount]),
                np.log(mean["t30"] / mean[amount]),
                mean["c80"],
                mean["g"],
            ]
        )
    if amount == "t30":
        # T20 is missing and T30 stands in for it: the ratio would be 0 by construction.
        table[2] = np.nan
    k = len(m.centre_frequencies)
    block, common = np.zeros((k, 5, 5)), {}
    for row, p in enumerate((amount, "edt", "t30", *LEVELS)):
        if p not in m.values:
            continue
        alone, common[p], origin = _uncertainty(m, p)
        block[:, row, row] = alone**2 + common[p] ** 2
        names = origins.setdefault(origin, [])
        if (label := parameter_label(p)) not in names:
            names.append(label)
    if amount == "t20" and "t30" in m.values:
        both = SHARED_BY_T20_AND_T30 * common["t20"] * common["t30"]
        block[:, 0, 2] = block[:, 2, 0] = both
    # From ln T20, ln EDT, ln T30, C80, G to the ratios, which have T20 in the denominator.
    ratios = np.eye(5)
    ratios[1:3, 0] = -1.0
    return table, np.asarray(ratios @ block @ ratios.T)


def _uncertainty(m: Measurement, p: str) -> tuple[Array, Array, str]:
    """Return the standard uncertainty of a mean, the part that all pairs share, and their origin.

    Both (n_bands,), relative for a decay time and in dB for a level. A stated uncertainty is the whole,
    with the part in common that is stated.
    """
    mean = m.mean(p)
    scale = mean if p in TIMES else np.ones_like(mean)
    nothing = np.full(len(mean), np.nan)
    present = np.isfinite(m.values[p])
    stated = np.isfinite(np.where(present, m.uncertainty.get(p, nothing), 0.0)).all(0)
    common = m.common_uncertainty.get(p, nothing) / scale
    whole = m.mean_uncertainty(p) / scale
    alone = np.sqrt(np.maximum(np.nan_to_num(whole) ** 2 - np.nan_to_num(common) ** 2, 0.0))
    if stated.all():
        return alone, np.nan_to_num(common), "as stated"
    n = np.maximum(present.sum(0), 1)
    if m.is_summary:
        n = np.full(len(mean), (m.n_sources or 1) * (m.n_receivers or 1))
    if p in TIMES:
        one = observable(p).scatter(m.centre_frequencies, mean)
    else:
        one = np.full(len(mean), ONE_LEVEL)
    alone = np.where(stated, alone, np.fmax(alone, one / np.sqrt(np.minimum(n, MAX_POSITIONS))))
    shared = np.where(stated, 0.0, observable(p).between_teams(m.centre_frequencies))
    return np.nan_to_num(alone), np.where(np.isfinite(common), common, shared), MADE


USUAL_DISTANCE = 0.66
"""Source-receiver distance over the cube root of the volume, where it is not stated: the mean distance
between two points of a cube (Robbins 1978)."""
DISTANCE_ERROR = 0.35
"""Standard deviation of its logarithm: that of the distance between two points of a cube is 0.45 of one
pair, less of a mean over pairs."""
_STEP = 1e-4
"""Step of alpha for a derivative."""


def state(case: Case, configuration: Configuration, alpha: Array | None = None) -> RoomState:
    """Return the case's room in one configuration, with the applied effects.

    ``alpha`` (n_materials, n_bands) replaces the room's; the configuration's changes apply on top.
    """
    return states(case, configuration, [case.room.alpha if alpha is None else alpha])[0]


def states(case: Case, configuration: Configuration, alphas: Sequence[Array]) -> list[RoomState]:
    """Return the `state` of a configuration with each of these alpha (n_materials, n_bands)."""
    room = case.room
    changed = {room.material_index(m): c.alpha for m, c in configuration.changes.items()}
    unchanged = RoomState.of_room(room, case.facing, case.equation)
    if air := configuration.air:
        unchanged = replace(
            unchanged,
            air=air.attenuation(room.centre_frequencies),
            speed_of_sound=air.speed_of_sound,
        )
    out = []
    for alpha in alphas:
        values = np.array(alpha)
        for row, of_material in changed.items():
            values[row] = of_material
        made = replace(unchanged, alpha=values)
        out.append(with_applied(made, case.applied, configuration))
    return out


def with_applied(
    unchanged: RoomState, applied: Sequence[AppliedEffect], configuration: Configuration
) -> RoomState:
    """Return the state with effects; removable effects are left out if the suspect was removed."""
    for added in applied:
        if not (configuration.suspect_removed and added.effect.removable):
            (unchanged,) = changed_states(added.effect, unchanged, [added.parameters])
    return unchanged


def air_of(case: Case, configuration: Configuration) -> Air | None:
    """Return the climate of a configuration, with the applied effects."""
    air = configuration.air or case.room.air
    for added in case.applied:
        air = added.effect.air(air, added.parameters)
    return air


def seen(case: Case, configuration: Configuration) -> Array:
    """Return d (alpha of the state) / d (alpha of the room), (n_materials, n_bands).

    It is 1 but where an applied effect changes alpha: what is covered is not seen.
    """
    at = np.array(case.room.alpha)
    unchanged = replace(configuration, changes={})
    after = state(case, unchanged, at).alpha
    if np.array_equal(after, at):
        return np.ones_like(at)
    step = np.where(at < 0.5, _STEP, -_STEP)
    return np.asarray((state(case, unchanged, at + step).alpha - after) / step)


def distances(case: Case, configuration: Configuration) -> Array:
    """Return the source-receiver distances in m, (n_pairs,); where none are stated, the usual one."""
    if configuration.distances is not None:
        return configuration.distances
    return np.array([USUAL_DISTANCE * case.room.volume ** (1 / 3)])
