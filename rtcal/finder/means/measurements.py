"""The measurements that a user can make next, what they would show, and which one would decide.

A further measurement is further parameters of the configurations that there are, or a further
configuration: the room again at other positions, in another climate, with a surface covered, or
without what can be taken out of it.

The information that a measurement is expected to give about the effects is in nats. It is the mutual
information of what is not measured yet and the set of effects (Lindley 1956): the entropy of the sets'
probabilities, less its mean after the measurement, over measurements drawn from the hypotheses
themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.air import Air
from rtcal.finder.case import Case, ChangedMaterial, Configuration
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.effects.absorbers import Porous
from rtcal.finder.means.features import ModelDiscrepancy, ObservedFeatures
from rtcal.finder.means.gap import (
    _PARAMETERS,
    USUAL,
    _in_words,
    covariance_of_all,
    separation,
    with_features,
)
from rtcal.finder.means.likelihood import MeansProblem, student
from rtcal.finder.means.sets import Moments
from rtcal.finder.model import FEATURES
from rtcal.finder.prior import NONE
from rtcal.support.types import Array

Mask = NDArray[np.bool_]
_DRAWS = 128
_TRACE = 1e-9  # of the mean variance, on a diagonal: two of several features may be nearly one


class Information:
    """Expected information about which set of effects is there.

    Parameters
    ----------
    moments : Moments
        Of n hypotheses, over all features that are or could be measured.
    weights : array (n,)
        Their probabilities.
    groups : int array (n,)
        The set of effects that each belongs to.
    measured : bool array (m,)
        Which of the features are measured already.
    values : array (n_measured,), optional
        Their values, which the weights have in them; without them only the kind of the measurement is
        known.
    """

    def __init__(
        self,
        moments: Moments,
        weights: Array,
        groups: NDArray[np.intp],
        measured: Mask,
        values: Array | None = None,
    ) -> None:
        covariance = moments.covariance.copy()
        diagonal = np.arange(covariance.shape[1])
        covariance[:, diagonal, diagonal] *= 1 + _TRACE
        mean = moments.mean
        self._known = measured if values is not None else np.zeros_like(measured)
        self._measured = measured
        if values is not None:
            across = covariance[:, measured]
            solved = np.linalg.solve(across[:, :, measured], across)  # (n, n_measured, m)
            residual = values - mean[:, measured]
            mean = mean + np.einsum("nu,num->nm", residual, solved)
            covariance = covariance - across.swapaxes(1, 2) @ solved
        self._mean, self._covariance = mean, covariance
        self._weights, self._groups = weights, groups
        places = (np.arange(_DRAWS) + 0.5) / _DRAWS
        self._drawn = np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)
        self._normal = np.random.default_rng(0).standard_normal((_DRAWS, covariance.shape[1]))

    def entropy(self) -> float:
        """Return the entropy of the sets before any further measurement, in nats."""
        return float(_entropy(self._by_group(self._weights[None]))[0])

    def of(self, further: Mask) -> float:
        """Return the information of measuring these features as well, in nats."""
        if self._known.any():
            return self._information(further & ~self._known)
        return self._information(further | self._measured) - self._information(self._measured)

    def _information(self, mask: Mask) -> float:
        if not mask.any():
            return 0.0
        mean, m = self._mean[:, mask], int(mask.sum())
        factor = np.linalg.cholesky(self._covariance[:, mask][:, :, mask])
        half = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(1)
        noise = np.einsum("dij,dj->di", factor[self._drawn], self._normal[:, mask])
        values = mean[self._drawn] + noise
        residual = (values[None] - mean[:, None]).swapaxes(1, 2)  # (n, m, draws)
        square = (np.linalg.solve(factor, residual) ** 2).sum(1)
        with np.errstate(divide="ignore"):
            log = student(square, half[:, None], m, coarsened=False)
            log += np.log(self._weights)[:, None]
        log -= log.max(0)
        after = np.exp(log)
        after /= after.sum(0)
        return max(self.entropy() - float(_entropy(self._by_group(after.T)).mean()), 0.0)

    def _by_group(self, weights: Array) -> Array:
        """Return the probabilities of the sets, (draws, n_groups)."""
        out = np.zeros((len(weights), int(self._groups.max()) + 1))
        np.add.at(out.T, self._groups, weights.T)
        return out


def _entropy(probabilities: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-np.nansum(probabilities * np.log(probabilities), axis=1))


Pairs = list[tuple[str, str]]
Separations = Mapping[tuple[str, str], float]
"""Expected evidence in nats against the second effect if the first is true."""


def separations(
    problem: MeansProblem, change: float
) -> tuple[dict[str, float], dict[str, Separations]]:
    """Return each effect's change of T, and the evidence between effects, by what is measured more.

    Each effect has the size whose largest relative change of T, over configurations (it may be taken
    away in some) and bands, is nearest to ``change``. The evidence of the data as they are is that of
    "".
    """
    case, used, predicted = problem.case, problem.observed.used, problem.predicted
    base = predicted.features[0]
    names = [n for n in dict.fromkeys(predicted.names) if n != NONE]
    masks = {"": used}
    for label, features in (
        ("EDT and T30", ("edt", "t30")),
        ("C80 and G", ("c80", "g")),
    ):
        more = with_features(used, features)
        if more.sum() > used.sum():
            lacking = [i for i in range(len(case.configurations)) if (more[i] & ~used[i]).any()]
            where = [f'"{case.configurations[i].name}"' for i in lacking]
            there = len(where) < len(case.configurations)
            masks[label + (f" of {' and '.join(where)}" if there else "")] = more
    tables: dict[str, dict[tuple[str, str], float]] = {m: {} for m in masks}
    reached: dict[str, float] = {}
    for a in names:
        rows = [i for i, n in enumerate(predicted.names) if n == a]
        moved = np.abs(np.expm1(predicted.features[rows][:, :, 0] - base[:, 0])).max((1, 2))
        nearest = int(np.argmin(np.abs(moved - change)))
        first, reached[a] = rows[nearest], float(moved[nearest])
        covariance = covariance_of_all(problem, first)
        for label, mask in masks.items():
            for b in (NONE, *names):
                if a != b:
                    tables[label][a, b] = separation(predicted, covariance, mask.ravel(), first, b)
    return reached, dict(tables)


def blind(separations: Separations, pairs: Pairs) -> tuple[Pairs, Pairs]:
    """Pairs indistinguishable both ways, and pairs where only the first can pass for the second."""
    both, one_sided = [], []
    for a, b in pairs:
        weak = (separations[a, b] < DISTINCT_NATS, separations[b, a] < DISTINCT_NATS)
        if all(weak):
            both.append((a, b))
        elif any(weak):
            one_sided.append((a, b) if weak[0] else (b, a))
    return both, one_sided


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


@dataclass(frozen=True, eq=False)
class FurtherMeasurement:
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


def possible(case: Case, planned: Sequence[Configuration] = ()) -> list[FurtherMeasurement]:
    """Return the measurements that a user can make in a case's room."""
    first = case.configurations[0]
    out = []
    for kind, parameters in _PARAMETERS.items():
        lacking = [c for c in case.configurations if not set(parameters) <= set(c.measured.values)]
        if lacking:
            out.append(FurtherMeasurement(kind, _in_words(kind), parameters))
    again = replace(first, name="further", planned=True)
    pairs = max(len(next(iter(first.measured.values.values()))), 1)
    out.append(
        FurtherMeasurement(
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
        out.append(
            FurtherMeasurement("another climate", words, configuration=replace(again, air=other))
        )
    out.append(_covered(case, again))
    bare = replace(again, suspect_removed=True)
    if not any(c.suspect_removed for c in case.configurations):
        words = "without all that can be taken out or closed: objects, people, openings"
        out.append(FurtherMeasurement("removed", words, configuration=bare))
    out += [
        FurtherMeasurement(
            "planned", f'configuration "{c.name}"', configuration=replace(c, planned=True)
        )
        for c in planned
    ]
    return out


def _covered(case: Case, again: Configuration) -> FurtherMeasurement:
    """Return the largest surface covered with mineral wool of known coefficients."""
    row = int(np.argmax(case.room.areas))
    material = case.room.materials[row]
    alpha = np.clip(Porous().spectrum(case.room.centre_frequencies, _ABSORBER), 0.02, 0.98)
    change = ChangedMaterial(alpha, 0.01 + 0.07 * alpha)
    words = f'"{material}" covered with 50 mm of mineral wool of known coefficients'
    return FurtherMeasurement(
        "covered", words, configuration=replace(again, changes={material: change})
    )


@dataclass(frozen=True, eq=False)
class Extended:
    """A problem with all further configurations, and which features each measurement would add.

    Its hypotheses are those of the case as it is. ``measured`` (m,) are the features in use that are
    measured already; ``masks`` those of each further measurement.
    """

    problem: MeansProblem
    measured: Mask
    masks: Mapping[str, Mask]


def extended(problem: MeansProblem, further: Sequence[FurtherMeasurement]) -> Extended:
    """Return the problem with every further configuration in its case."""
    case, observed = problem.case, problem.observed
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
        replace(
            problem,
            case=replace(case, configurations=configurations),
            observed=ObservedFeatures(np.zeros(every.shape), every, full[np.ix_(flat, flat)]),
            discrepancy=_model_error(problem.discrepancy, count, [f.same_error for f, _ in new]),
        ),
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
