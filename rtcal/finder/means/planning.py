"""Plan measurements: which effects the data could distinguish, and what to measure next.

A further measurement is that of further parameters in the same configurations, or that of a further
configuration: the room again at other positions, in another climate, with a covered surface, or without
objects that can be taken out of it.

The information that a measurement is expected to give about the effects is the mutual information, in
nats, of the measurement and the missing effects (Lindley 1956). It is the entropy of the effects'
probabilities minus the mean entropy after the measurement, over random measurements.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.air import Air
from rtcal.files.saved import Result
from rtcal.finder.case import Case, ChangedMaterial, Configuration
from rtcal.finder.claim import WORDS, Reason
from rtcal.finder.effects import (
    AppliedEffect,
    Effect,
    Porous,
    WrongArea,
    checked_effects,
    judged_effects,
)
from rtcal.finder.evidence import COEFFICIENTS, NONE, UNKNOWN, prior_of, student
from rtcal.finder.finding import Finding
from rtcal.finder.means.problem import (
    MeansEvidence,
    MeansHypotheses,
    MeansProblem,
    ModelDiscrepancy,
    Moments,
    ObservedFeatures,
    compare,
    moments,
    observe,
    predict_hypotheses,
)
from rtcal.finder.model import FEATURES
from rtcal.support import checks
from rtcal.support.blocks import Block
from rtcal.support.errors import DataError
from rtcal.support.speed import single_threaded_blas
from rtcal.support.types import Array

STEPS = 3
"""Number of measurements in the proposed sequence."""
_OF_EACH = 5  # parameter sets of each effect that stand for it where nothing was measured


@dataclass(frozen=True)
class Proposal:
    """Propose a measurement, with what it is expected to show about missing effects, and its cost."""

    measurement: Reason
    """Measurement, as a key of `COSTS` with its values; ``str`` of it is its words."""
    information: float
    """Expected information on which effects are missing, in nats (1 nat = 1.44 bit). In a sequence, the
    information that it adds to the measurements before it."""
    cost: float
    """Cost of the measurement in hours."""

    @property
    def kind(self) -> str:
        """Name of the measurement among the `COSTS`."""
        return self.measurement.code

    @property
    def per_cost(self) -> float:
        """Expected information per hour, in nats (1 nat = 1.44 bit)."""
        return self.information / self.cost

    def to_dict(self) -> dict[str, Any]:
        """Return the proposal as plain values for JSON."""
        more = {"kind": self.kind, "measurement": str(self.measurement)}
        return vars(self) | more | {"per_cost": self.per_cost}


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Result):
    """Hold which effects a case's data could distinguish, and what to measure next."""

    record_kind: ClassVar[str] = "plan 2"
    in_file: ClassVar[str] = (
        "parameters change reached proposals sequence uncertainty_nats=uncertainty"
    )

    parameters: tuple[str, ...]
    """Names of the parameters that the case has."""
    change: float
    """Relative change of T that was required. Each effect has the size whose change of T is nearest to
    it."""
    reached: Mapping[str, float]
    """Relative change of T by each effect at this size."""
    separations: Mapping[tuple[str, str], float]
    """Expected ln Bayes factor for the first effect against the second, at the second's most similar
    size."""
    proposals: tuple[Proposal, ...] = ()
    """Measurements that could be made next, with the most information per hour first."""
    sequence: tuple[Proposal, ...] = ()
    """Three measurements in order, each the most informative per hour after those before it."""
    uncertainty: float = 0.0
    """Uncertainty about the missing effects now, as entropy in nats; no measurement gives more
    information."""

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain values for JSON."""
        apart = [{"effect": a, "against": b, "nats": v} for (a, b), v in self.separations.items()]
        return {**super().to_dict(), "separations": apart}

    def __repr__(self) -> str:
        return f"<Plan with {', '.join(self.parameters)}: {len(self.reached)} effects>"

    def blocks(self) -> list[Block]:
        """Return the printed tables: change by each effect, similar effects, next measurements."""
        made: list[Block] = import_module(WORDS).of_plan(self)
        return made


GENERIC_UNCERTAINTY = (0.04, 0.04, 0.02, 0.7, 0.7)
"""Standard deviation of the equation's error by feature, if no reference rooms are simulated."""


@single_threaded_blas()
def plan(
    case: Case,
    effects: Sequence[Effect] | None = None,
    change: float = 0.2,
    *,
    finding: Finding | None = None,
    costs: Mapping[str, float] | None = None,
    planned: Sequence[Configuration] = (),
) -> Plan:
    """Return which effects the data of a case could distinguish, and what to measure next.

    Without a finding, each effect of the library has its usual probability, as before a measurement.
    With a finding, the proposals start from the probabilities that it gives.

    Parameters
    ----------
    case : Case
        Room and its measurements, of which only the parameters' names and uncertainties are used.
    effects : sequence of Effect, optional
        Effects to compare, by default the whole library. If the directions of surfaces are unknown,
        effects that depend on them are left out (`Effect.needs_directions`).
    change : float
        Relative change of T20 that each effect is assumed to cause in the band that it changes most;
        above 0 and at most 1.
    finding : Finding, optional
        Result of `rtcal.find` for this case, whose reference rooms show how far the equation errs.
        Without it, the standard deviation of this error is 4 % for T20 and EDT/T20, 2 % for T30/T20,
        and 0.7 dB for C80 and G.
    costs : mapping of str to float, optional
        Hours that a measurement takes, such as ``{"G": 0.5, "another climate": 40}``. Names that are
        left out, and all names, are in `rtcal.finder.means.planning.COSTS`.
    planned : sequence of Configuration, optional
        Further configurations that could be measured.

    Returns
    -------
    Plan
        Proposed measurements, by the information per hour that each is expected to give.

    Raises
    ------
    DataError
        If ``change`` is outside its limits; if an effect breaks a rule; if ``costs`` has an unknown
        name or a number that is not above 0; or if the finding is of another case.

    Examples
    --------
    >>> import rtcal as rt
    >>> case, truth = rt.datasets.hidden_room()
    >>> plan = rt.finder.plan(case.only("t20"), costs={"G": 0.5})
    >>> len(plan.sequence)
    3
    """
    change = checks.number("change", change)
    if not 0 < change <= 1:
        raise DataError(f"change = {change:g} must be above 0 and at most 1 (a share of T)")
    checks.instance("case", case, Case)
    hours = dict(COSTS)
    for name, value in ({} if costs is None else checks.mapped("costs", costs)).items():
        if name not in COSTS:
            raise DataError(f'costs has "{name}", which is not one of {", ".join(COSTS)}')
        hours[name] = checks.positive(f'costs["{name}"]', value)
    if finding is not None and finding.case is not case:
        raise DataError("finding belongs to another case: give the case of this finding")
    observed, _ = observe(case)
    tried, _ = judged_effects(checked_effects(effects), case.directions_known, bool(case.program))
    predicted = predict_hypotheses(case, tried)
    variances = np.broadcast_to(np.square(GENERIC_UNCERTAINTY)[:, None], observed.used.shape)
    discrepancy = ModelDiscrepancy(np.zeros(variances.size), np.diag(variances.ravel()))
    if finding is not None:
        discrepancy = finding.discrepancy
    problem = MeansProblem(case, observed, predicted, discrepancy)
    # Of each effect the size whose largest change of T is nearest: it may be taken away somewhere.
    table, reached = dict[tuple[str, str], float](), dict[str, float]()
    moved = np.abs(np.expm1(predicted.features[:, :, 0] - predicted.features[0, :, 0])).max((1, 2))
    for name in predicted.effects:
        rows = predicted.rows[name]
        nearest = int(rows[np.argmin(np.abs(moved[rows] - change))])
        reached[name] = float(moved[nearest])
        apart = _separations(problem, nearest)
        table |= {(name, other): nats for other, nats in apart.items() if other != name}
    further = possible(case, planned)
    whole, there, masks = extended(problem, further)
    if finding is None:
        every = _before(case, predicted)
    else:
        every = [(effects_of, p) for effects_of, p in finding.likely if p > _NEGLIGIBLE]
    about = _information(whole, there, every, None if finding is None else observed)

    def ranked(done: Mask) -> list[tuple[Proposal, Mask]]:
        """Return measurements that add information to those ``done``, the most nats per hour first."""
        start = about.of(done) if done.any() else 0.0
        added = [
            (Proposal(f.measurement, max(about.of(done | mask) - start, 0.0), cost), mask)
            for f, mask in zip(further, masks, strict=True)
            if (mask & ~done).any()
            for cost in [hours[f.measurement.code]]
        ]
        return sorted(added, key=lambda each: -each[0].per_cost)

    done: Mask = np.zeros(len(there), dtype=bool)
    best, sequence = ranked(done), list[Proposal]()
    proposals = tuple(proposal for proposal, _ in best)
    while best and len(sequence) < STEPS:
        first, mask = best[0]
        sequence.append(first)
        done = done | mask
        best = ranked(done) if len(sequence) < STEPS else []
    measured = {name for c in case.configurations for name in c.measured.values}
    return Plan(
        tuple(name for name in FEATURES if name in measured),
        change,
        reached,
        table,
        proposals,
        tuple(sequence),
        about.entropy(),
    )


_NEGLIGIBLE = 1e-4  # probability of a hypothesis that a plan leaves out
Weighted = Sequence[tuple[tuple[AppliedEffect, ...], float]]


def _before(case: Case, predicted: MeansHypotheses) -> Weighted:
    """Return a few parameter sets of each effect with their prior probabilities, and "none"."""
    prior = prior_of(case.room, list(predicted.effects.values()), {}).log_probability
    out: list[tuple[tuple[AppliedEffect, ...], float]] = [((), float(np.exp(prior[NONE])))]
    for name, effect in predicted.effects.items():
        rows = predicted.rows[name]
        cumulated = np.cumsum(np.exp(predicted.log_weights[rows]))
        places = (np.arange(_OF_EACH) + 0.5) / _OF_EACH
        for i in np.minimum(np.searchsorted(cumulated, places), len(rows) - 1):
            added = AppliedEffect(effect, predicted.parameters[rows[i]])
            out.append(((added,), float(np.exp(prior[name])) / _OF_EACH))
    total = sum(p for _, p in out)
    return [(applied, p / total) for applied, p in out]


def _information(
    whole: MeansProblem, measured: Mask, every: Weighted, observed: ObservedFeatures | None
) -> Information:
    """Return the information about the hypotheses, given what was ``observed``."""
    grids: dict[str, list[Mapping[str, float]]] = {}
    effects: dict[str, Effect] = {}
    for applied, _ in every:
        for a in applied:
            effects[a.name] = a.effect
            grid = grids.setdefault(a.name, [])
            if a.parameters not in grid:
                grid.append(a.parameters)
    predicted = predict_hypotheses(whole.case, list(effects.values()), list(grids.values()))
    first = {name: predicted.names.index(name) for name in grids}
    rows = [
        tuple(first[a.name] + grids[a.name].index(a.parameters) for a in applied)
        for applied, _ in every
    ]
    names = [tuple(a.name for a in applied) for applied, _ in every]
    groups = {n: k for k, n in enumerate(dict.fromkeys(names))}
    of, possible = moments(compare(replace(whole, predicted=predicted)), rows)
    weights = np.array([p for _, p in every]) * possible
    return Information(
        of,
        weights / weights.sum(),
        np.array([groups[n] for n in names]),
        measured,
        None if observed is None else observed.values,
    )


Mask = NDArray[np.bool_]
_DRAWS = 128
_TRACE = 1e-9  # of the mean variance, on a diagonal: two of several features may be nearly one


class Information:
    """Compute how much a further measurement is expected to show about which effects are missing.

    A hypothesis is a combination of effects with sizes. ``moments`` has those of m values that are
    or could be measured, ``weights`` (n,) the probabilities of the hypotheses, and ``groups`` (n,)
    the numbers of their combinations. ``measured`` (m,) are the values that are measured, as
    ``values``; None of these if the measurement is only planned.
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
        self._measured, self._known = measured, np.zeros_like(measured)
        if values is not None:
            self._known = measured
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
        """Return how uncertain the combination of missing effects is, as entropy in nats (1.44 bit)."""
        return float(self._entropy(self._weights[None])[0])

    def of(self, further: Mask) -> float:
        """Return the expected decrease of `entropy` in nats by values ``further`` (m,)."""
        return self._information(further | self._measured) - self._information(self._measured)

    def _information(self, mask: Mask) -> float:
        mask = mask & ~self._known
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
        return max(self.entropy() - float(self._entropy(after.T).mean()), 0.0)

    def _entropy(self, weights: Array) -> Array:
        """Return the entropy of the sets, (n,), by the weights of the hypotheses, (n, n_hypotheses)."""
        sets = np.zeros((len(weights), int(self._groups.max()) + 1))
        np.add.at(sets.T, self._groups, weights.T)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(-np.nansum(sets * np.log(sets), axis=1))


USUAL = np.array([0.015, 0.03, 0.02, 0.5, 0.5])
"""Standard uncertainty, by feature, assumed for a mean over four positions that is not measured yet."""
FURTHER = {"EDT and T30": ("edt", "t30"), "C80": ("c80",), "G": ("g",)}
"""Names of parameters that could also be measured in the case's configurations."""


def _separations(
    problem: MeansProblem, first: int, further: Sequence[str] = ()
) -> dict[str, float]:
    """Return the expected ln Bayes factor of hypothesis ``first`` against each effect, if it is true.

    It is the minimum of ½ d' C⁻¹ d over the parameter values of the effect, d being the difference
    of the compared values. ``further`` names parameters that are compared beside the measured ones.
    """
    predicted, observed = problem.predicted, problem.observed
    used = observed.used.copy()
    used[:, [FEATURES.index(f) for f in further]] = True
    variances = np.broadcast_to(USUAL[None, :, None] ** 2, used.shape).copy()
    variances[observed.used] = np.diag(observed.covariance)
    mask = used.ravel()
    whole = replace(problem, observed=replace(observed, used=used))
    covariance = whole.of_alpha(slice(first, first + 1))[0][0] + np.diag(variances[used])
    covariance += problem.discrepancy.covariance[np.ix_(mask, mask)]
    d = (predicted.features - predicted.features[first]).reshape(len(predicted.names), -1)[:, mask]
    nats = 0.5 * ((d @ np.linalg.inv(covariance)) * d).sum(1)
    return {name: float(nats[rows].min()) for name, rows in predicted.rows.items()}


def next_measurement(evidence: MeansEvidence, candidates: Sequence[str]) -> Reason:
    """Return the measurement that would decide between the candidates."""
    problem, predicted = evidence.problem, evidence.problem.predicted
    named = [c for c in candidates if c not in (UNKNOWN, COEFFICIENTS)]
    if candidates and candidates[0] == COEFFICIENTS:
        return Reason("another source")
    if not named:
        return Reason("measure again" if candidates else "nothing to distinguish")
    best, *others = named
    removed = any(c.suspect_removed for c in problem.case.configurations)
    rows = predicted.rows[best]
    first = int(rows[np.argmax(evidence.by_hypothesis()[rows])])
    if not others:
        removable = predicted.effects[best].removable
        kind = "look it up" if not removable else "confirmed" if removed else "measure without"
        room, parameters = problem.case.room, predicted.parameters[first]
        unit = predicted.effects[best].unit_in(parameters, room)
        return Reason(kind, {"effect": WrongArea.NUMBER if unit == WrongArea.OF_NUMBER else best})
    rival = others[0]
    now, complete = _separations(problem, first)[rival], np.all(problem.observed.used, axis=(0, 2))
    options = [
        (_separations(problem, first, features)[rival], kind)
        for kind, features in FURTHER.items()
        if not complete[[FEATURES.index(f) for f in features]].all()
    ]
    two = {"effect": best, "rival": rival}
    removable_ones = [n for n in two.values() if predicted.effects[n].removable and not removed]
    if len(removable_ones) == 1:
        return Reason("with and without", {"effect": removable_ones[0]})
    if options and max(options)[0] > now + 1:
        gain, what = max(options)
        return Reason("measure further", {**two, "what": Reason(what), "nats": gain, "now": now})
    return Reason("each taken out" if removable_ones else "look at the room", two)


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
"""Hours that each kind of measurement takes, by judgement. EDT, T30 and C80 are evaluated from existing
responses. G needs a calibrated source. "planned" are configurations that you add."""
MORE_POSITIONS = 4
SAME_ERROR = 0.85
"""Correlation of the model's error between two configurations of a room. Of reference rooms of twelve
development rooms it is 0.72 to 0.99 by feature, T30/T20 apart."""
_ABSORBER = {"thickness": 0.05, "flow_resistivity": 12e3}


@dataclass(frozen=True, eq=False)
class _FurtherMeasurement:
    """Describe a measurement to come: of ``parameters``, or of a new ``configuration``."""

    measurement: Reason
    parameters: tuple[str, ...] = ()
    configuration: Configuration | None = None
    same_error: float = SAME_ERROR
    share: float = 1.0


def possible(case: Case, planned: Sequence[Configuration] = ()) -> list[_FurtherMeasurement]:
    """Return the further measurements that can be made in a case's room, with those ``planned``."""
    room, first = case.room, case.configurations[0]
    out = [
        _FurtherMeasurement(Reason(kind), parameters)
        for kind, parameters in FURTHER.items()
        if any(not set(parameters) <= set(c.measured.values) for c in case.configurations)
    ]

    def add(kind: str, values: Mapping[str, Any], of: Configuration, **more: Any) -> None:
        made = Reason(kind, values)
        out.append(_FurtherMeasurement(made, configuration=replace(of, planned=True), **more))

    pairs = max(len(next(iter(first.measured.values.values()))), 1)
    share = pairs / MORE_POSITIONS
    add("more positions", {"positions": MORE_POSITIONS}, first, same_error=1.0, share=share)
    if (air := first.air or room.air) is not None:
        other = Air(air.temperature, 30.0 if air.humidity > 45 else 65.0)
        climate = {"humidity": other.humidity, "temperature": other.temperature}
        add("another climate", climate, replace(first, air=other))
    # The largest surface, covered with mineral wool of known coefficients.
    material = room.materials[int(np.argmax(np.where(room.is_surface, room.areas, 0.0)))]
    alpha = np.clip(Porous().spectrum(room.centre_frequencies, _ABSORBER), 0.02, 0.98)
    covered = {material: ChangedMaterial(alpha, 0.01 + 0.07 * alpha)}
    values = {"material": material, "thickness": 1000 * _ABSORBER["thickness"]}
    add("covered", values, replace(first, changes=covered))
    if not any(c.suspect_removed for c in case.configurations):
        add("removed", {}, replace(first, suspect_removed=True))
    for c in planned:
        add("planned", {"configuration": c.name}, c)
    return out


def extended(
    problem: MeansProblem, further: Sequence[_FurtherMeasurement]
) -> tuple[MeansProblem, Mask, list[Mask]]:
    """Return a problem with further measurements added to its data, and masks of its m values.

    The first mask (m,) is of those that are measured already, and one for each of ``further`` of
    those that it adds.
    """
    case, observed = problem.case, problem.observed
    new = [f for f in further if f.configuration is not None]
    added = [c for c in (f.configuration for f in new) if c is not None]
    named = [replace(c, name=f"further {i}") for i, c in enumerate(added)]
    configurations = [*case.configurations, *named]
    n, count = len(configurations), len(case.configurations)
    used = np.zeros((n, len(FEATURES), case.room.n_bands), dtype=bool)
    used[:count] = observed.used
    variance = np.broadcast_to(USUAL[:, None] ** 2, used.shape).copy()
    variance[:count][observed.used] = np.diag(observed.covariance)
    masks = list[Mask]()
    for f in further:
        mask: Mask = np.zeros(used.shape, dtype=bool)
        if f.configuration is None:
            rows = [FEATURES.index(p) for p in f.parameters]
            without = np.logical_not(observed.used[:, rows])
            mask[:count, rows] = np.logical_and(observed.used[:, :1], without)
        else:
            at = count + new.index(f)
            mask[at] = observed.used[0]
            variance[at] = np.where(observed.used[0], f.share * variance[0], variance[0])
        masks.append(mask)
    every = used | np.any(masks, axis=0)
    flat = every.ravel()
    full = np.diag(variance.ravel())
    places = np.flatnonzero(used.ravel())
    full[np.ix_(places, places)] = observed.covariance
    # The model's error in a further configuration is like that in the first one.
    error, size = problem.discrepancy, used[0].size
    source = np.array([*range(count), *[0] * len(new)])
    same = np.array([*[1.0] * count, *(f.same_error for f in new)])
    blocks = error.covariance.reshape(count, size, count, size)
    errors = blocks[source][:, :, source] * np.outer(same, same)[:, None, :, None]
    for i in range(count, n):
        errors[i, :, i] = blocks[0, :, 0]
    bias = error.bias.reshape(count, size)[source].ravel()
    whole = replace(
        problem,
        case=replace(case, configurations=configurations),
        observed=replace(
            observed,
            features=np.zeros(every.shape),
            used=every,
            covariance=full[np.ix_(flat, flat)],
        ),
        discrepancy=replace(error, bias=bias, covariance=errors.reshape(n * size, n * size)),
    )
    return whole, used.ravel()[flat], [mask.ravel()[flat] for mask in masks]
