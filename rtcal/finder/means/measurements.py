"""The measurements that a user can make next, what they would show, and which one would decide.

A further measurement is further parameters of the configurations that there are, or a further
configuration: the room again at other positions, in another climate, with a surface covered, or
without what can be taken out of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.finder.case import Case
from rtcal.finder.configuration import Change, Configuration
from rtcal.finder.effects.porous import Porous
from rtcal.finder.means.evidence import Searched
from rtcal.finder.means.features import Observed
from rtcal.finder.means.model_error import ModelDiscrepancy
from rtcal.finder.means.separation import (
    USUAL,
    Mask,
    covariance_with,
    separation,
    variances_of,
    with_features,
)
from rtcal.finder.model import FEATURES
from rtcal.finder.prior import COEFFICIENTS, UNKNOWN
from rtcal.support import checks
from rtcal.support.errors import DataError

COSTS: Mapping[str, float] = {
    "EDT and T30": 0.2,
    "C80": 0.2,
    "G": 2.0,
    "more positions": 1.0,
    "another climate": 8.0,
    "covered": 4.0,
    "removed": 3.0,
    "planned": 4.0,
}
"""Hours that a measurement takes: a judgement, settable. EDT, T30 and C80 are evaluated from responses
that there are. G needs a calibrated source. "planned" are configurations that a user states. Half or
twice any of them leaves the proposal in 11 to 14 of 14 rooms (`benchmarks.next_measurement table`)."""
MORE_POSITIONS = 4
SAME_ERROR = 0.85
"""Correlation of the model's error between two configurations of a room. Of control rooms of twelve
development rooms it is 0.72 to 0.99 by feature, T30/T20 apart."""
_ABSORBER = {"thickness": 0.05, "flow_resistivity": 12e3}
_PARAMETERS = {"EDT and T30": ("edt", "t30"), "C80": ("c80",), "G": ("g",)}


@dataclass(frozen=True, eq=False)
class Further:
    """A measurement that could be made next.

    ``parameters`` are measured in the configurations that there are, or ``configuration`` is measured.
    ``same_error`` is the correlation of the model's error between it and the first one, ``share`` its
    measurement variance over the first one's.
    """

    kind: str
    words: str
    parameters: tuple[str, ...] = ()
    configuration: Configuration | None = None
    same_error: float = SAME_ERROR
    share: float = 1.0


def possible(case: Case, planned: Sequence[Configuration] = ()) -> list[Further]:
    """Return the measurements that a user can make in a case's room."""
    first = case.configurations[0]
    out = []
    for kind, parameters in _PARAMETERS.items():
        lacking = [c for c in case.configurations if not set(parameters) <= set(c.measured.values)]
        if lacking:
            out.append(Further(kind, _in_words(kind), parameters))
    again = replace(first, name="further", planned=True)
    pairs = max(len(next(iter(first.measured.values.values()))), 1)
    out.append(
        Further(
            "more positions",
            f"{MORE_POSITIONS} more positions",
            configuration=again,
            same_error=1.0,
            share=pairs / MORE_POSITIONS,
        )
    )
    if (air := first.air or case.room.air) is not None:
        humidity = 30.0 if air.humidity > 45 else 65.0
        other = Air(air.temperature, humidity)
        words = f"another climate: {humidity:.0f} % of humidity at {air.temperature:.0f} °C"
        out.append(Further("another climate", words, configuration=replace(again, air=other)))
    out.append(_covered(case, again))
    bare = replace(again, suspect_removed=True)
    if not any(c.suspect_removed for c in case.configurations):
        words = "without all that can be taken out or closed: objects, people, openings"
        out.append(Further("removed", words, configuration=bare))
    out += [
        Further("planned", f'configuration "{c.name}"', configuration=replace(c, planned=True))
        for c in planned
    ]
    return out


def _in_words(kind: str) -> str:
    return "G, with a calibrated source" if kind == "G" else kind


def _covered(case: Case, again: Configuration) -> Further:
    """Return the largest surface covered with mineral wool of known coefficients."""
    row = int(np.argmax(case.room.areas))
    material = case.room.materials[row]
    alpha = np.clip(Porous().spectrum(case.room.centre_frequencies, _ABSORBER), 0.02, 0.98)
    change = Change(alpha, 0.01 + 0.07 * alpha)
    words = f'"{material}" covered with 50 mm of mineral wool of known coefficients'
    return Further("covered", words, configuration=replace(again, changes={material: change}))


def checked_costs(costs: object) -> dict[str, float]:
    """Return `COSTS` with a user's in place; DataError for another name, or a cost not above 0."""
    stated = {} if costs is None else checks.mapped("costs", costs)
    for name in stated:
        if name not in COSTS:
            raise DataError(f'costs has "{name}", which is not one of {", ".join(COSTS)}')
    return {**COSTS, **{k: checks.positive(f'costs["{k}"]', v) for k, v in stated.items()}}


@dataclass(frozen=True, eq=False)
class Extended:
    """A case with all further configurations, and which features each measurement would add.

    ``measured`` (m,) are the features in use that are measured already; ``masks`` those of each further
    measurement.
    """

    case: Case
    observed: Observed
    discrepancy: ModelDiscrepancy
    measured: Mask
    masks: Mapping[str, Mask]


def extended(
    case: Case, observed: Observed, discrepancy: ModelDiscrepancy, further: Sequence[Further]
) -> Extended:
    """Return the case with every further configuration in it."""
    new = [(f, f.configuration) for f in further if f.configuration is not None]
    added = [replace(c, name=f"further {i}") for i, (_, c) in enumerate(new)]
    configurations = [*case.configurations, *added]
    n, count = len(configurations), len(case.configurations)
    bands = case.room.n_bands
    used = np.zeros((n, len(FEATURES), bands), dtype=bool)
    used[:count] = observed.used
    variance = np.broadcast_to(USUAL[:, None] ** 2, used.shape).copy()
    variance[:count][observed.used] = np.diag(observed.covariance)
    masks: dict[str, Mask] = {}
    place = {f.words: count + i for i, (f, _) in enumerate(new)}
    for f in further:
        mask: Mask = np.zeros(used.shape, dtype=bool)
        if f.configuration is None:
            rows = [FEATURES.index(p) for p in f.parameters]
            without = np.logical_not(observed.used[:, rows])
            mask[:count, rows] = np.logical_and(observed.used[:, :1], without)
        else:
            at = place[f.words]
            mask[at] = observed.used[0]
            variance[at] = np.where(observed.used[0], f.share * variance[0], variance[0])
        masks[f.words] = mask
    every = used | np.any(list(masks.values()), axis=0)
    flat = every.ravel()
    full = np.diag(variance.ravel())
    old = np.zeros_like(every)
    old[:count] = observed.used
    places = np.flatnonzero(old.ravel())
    full[np.ix_(places, places)] = observed.covariance
    return Extended(
        replace(case, configurations=configurations),
        Observed(np.zeros(every.shape), every, full[np.ix_(flat, flat)]),
        _model_error(discrepancy, count, [f.same_error for f, _ in new]),
        used.ravel()[flat],
        {words: mask.ravel()[flat] for words, mask in masks.items()},
    )


def _model_error(
    discrepancy: ModelDiscrepancy, count: int, same: Sequence[float]
) -> ModelDiscrepancy:
    """Return the model's error with further configurations, whose error is like the first one's."""
    size = len(discrepancy.bias) // count
    n = count + len(same)
    source = np.array([*range(count), *[0] * len(same)])
    share = np.array([*[1.0] * count, *same])
    blocks = discrepancy.covariance.reshape(count, size, count, size)
    covariance = blocks[source][:, :, source] * np.outer(share, share)[:, None, :, None]
    for i in range(count, n):
        covariance[i, :, i] = blocks[0, :, 0]
    bias = discrepancy.bias.reshape(count, size)[source].ravel()
    return ModelDiscrepancy(bias, covariance.reshape(n * size, n * size), discrepancy.engines)


def next_measurement(searched: Searched, candidates: Sequence[str]) -> str:
    """Return the measurement that would decide between the candidates."""
    observed, predicted = searched.observed, searched.predicted
    named = [c for c in candidates if c not in (UNKNOWN, COEFFICIENTS)]
    if candidates and candidates[0] == COEFFICIENTS:
        return (
            "look for another source of the coefficients, first for the material with the largest "
            "product of area and sigma; or measure with and without a known absorber"
        )
    if not named:
        return (
            "these data leave nothing to tell apart. That does not confirm the model"
            if not candidates
            else "see in the residuals which band and parameter disagree, and measure these again"
        )
    best = named[0]
    rows = [i for i, n in enumerate(predicted.names) if n == best]
    first = rows[int(np.argmax(searched.evidence.by_hypothesis()[rows]))]
    if len(named) == 1:
        if predicted.effects[best].removable:
            return f"confirm it: measure once without the {best}"
        return f"confirm it: check the {best} where it can be looked up or measured by itself"
    rival = named[1]
    used, variances = observed.used, variances_of(observed)
    covariance = covariance_with(predicted, searched.discrepancy, variances, first)
    now = separation(predicted, covariance, used.ravel(), first, rival)
    options = []
    for kind, features in _PARAMETERS.items():
        more = with_features(used, features)
        if more.sum() > used.sum():
            nats = separation(predicted, covariance, more.ravel(), first, rival)
            options.append((nats, _in_words(kind)))
    removable = {n: predicted.effects[n].removable for n in (best, rival)}
    if len(set(removable.values())) == 2:
        suspect = best if removable[best] else rival
        return (
            f"measure with and without the {suspect}. If it is that, T changes, and the uncertainty of "
            "alpha cancels in the difference"
        )
    if options and max(options)[0] > now + 1:
        gain, label = max(options)
        return (
            f"measure {label}: with it {best} and {rival} would differ by {gain:.1f} nats instead of "
            f"{now:.1f}"
        )
    if all(removable.values()):
        return (
            f"measure without the {best} and without the {rival}, one at a time. The uncertainty of "
            "alpha cancels in the difference"
        )
    return (
        f"look at the room: {best} and {rival} predict the same in every parameter, and one of them "
        "can be seen, or measured with a rule"
    )
