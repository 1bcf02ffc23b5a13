"""Plan measurements: which effects the data could distinguish, and what to measure next.

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
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.air import Air
from rtcal.acoustics.observables import parameter_label
from rtcal.files.saved import Result
from rtcal.finder.case import Case, ChangedMaterial, Configuration
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.effects import AppliedEffect, Effect, Porous, checked_effects, judged_effects
from rtcal.finder.evidence import NONE, prior_of, student
from rtcal.finder.finding import Finding
from rtcal.finder.means.problem import (
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
from rtcal.finder.means.verdict import FURTHER, USUAL, further_in_words, separations
from rtcal.finder.model import FEATURES
from rtcal.support import checks
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError
from rtcal.support.speed import single_threaded_blas
from rtcal.support.text import listed
from rtcal.support.types import Array

STEPS = 3
"""Measurements that are proposed one after the other."""
_OF_EACH = 5
"""Parameter sets of each effect that stand for it where nothing was measured."""


@dataclass(frozen=True)
class Proposal:
    """A measurement that could be made next.

    Attributes
    ----------
    measurement : str
        In words.
    kind : str
        Its name among the costs.
    information : float
        Expected information about which effects are there, in nats. In a sequence: what it adds to the
        measurements before it.
    cost : float
        Hours.
    """

    measurement: str
    kind: str
    information: float
    cost: float

    @property
    def per_cost(self) -> float:
        """Nats per hour."""
        return self.information / self.cost

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return vars(self) | {"per_cost": self.per_cost}


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Result):
    """The effects that a case's data could distinguish, and what to measure next.

    Attributes
    ----------
    parameters : tuple of str
        Those that are measured.
    change : float
        Relative change of T. Each effect has the size whose change of T is nearest to it.
    reached : mapping of str to float
        The change of T by each effect at this size.
    separations : mapping of (effect, effect) to float
        The evidence in nats to be expected for the first effect against the most similar size of the
        second.
    proposals : tuple of Proposal
        The measurements that could be made next, the most information per hour first.
    sequence : tuple of Proposal
        The three that a greedy choice takes one after the other.
    uncertainty : float
        Entropy of what is known of the effects now, in nats: no measurement gives more.
    """

    record_kind: ClassVar[str] = "plan 2"

    parameters: tuple[str, ...]
    change: float
    reached: Mapping[str, float]
    separations: Mapping[tuple[str, str], float]
    proposals: tuple[Proposal, ...] = ()
    sequence: tuple[Proposal, ...] = ()
    uncertainty: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "parameters": list(self.parameters),
            "change": self.change,
            "reached": dict(self.reached),
            "separations": [
                {"effect": a, "against": b, "nats": v} for (a, b), v in self.separations.items()
            ],
            "proposals": [p.to_dict() for p in self.proposals],
            "sequence": [p.to_dict() for p in self.sequence],
            "uncertainty_nats": self.uncertainty,
        }

    def __repr__(self) -> str:
        return f"<Plan with {', '.join(self.parameters)}: {len(self.reached)} effects>"

    def blocks(self) -> list[Block]:
        """Return what each effect would show, what it may be taken for, and what to measure next."""
        measured = listed([parameter_label(p) for p in self.parameters])
        seen, taken = list[Row](), list[Block]()
        for name, change in self.reached.items():
            nats = self.separations[name, NONE]
            shown = f"{nats:.1f}" if nats <= _MOST else f">{_MOST:.0f}"
            seen.append(
                Row(
                    name, [f"{100 * change:.1f} %", shown, "yes" if nats >= DISTINCT_NATS else "no"]
                )
            )
            others = [b for b in self.reached if b != name]
            alike = [b for b in others if self.separations[name, b] < DISTINCT_NATS]
            apart = [b for b in others if b not in alike]
            said = ", ".join(alike) or "no other"
            if len(alike) > len(apart):
                said = f"all but {', '.join(apart)}" if apart else "all"
            taken.append(Note(f"{name}: {said}", "  "))
        out: list[Block] = [
            Note(
                f"What {measured} would show of each effect, if it alone were in the room. Each has "
                f"the size whose change of T is nearest to {100 * self.change:g} %. Evidence of "
                f"{DISTINCT_NATS} nats, odds of ten to one, is enough to see it.",
                hanging="",
            ),
            Table(["change of T", "evidence / nats", "seen"], seen, corner="effect"),
            Note(
                "What each may be taken for: the data would tell it from these by less than "
                f"{DISTINCT_NATS} nats.",
                hanging="",
            ),
            *taken,
        ]
        if not self.proposals:
            return out
        rows = [
            Row(p.measurement, [f"{p.information:.2f}", f"{p.cost:g}", f"{p.per_cost:.2f}"])
            for p in self.proposals
        ]
        return [
            *out,
            Note(""),
            Note(
                "What to measure next: the information to expect about which effects are there, and "
                f"the hours that it takes. Of {self.uncertainty:.2f} nats that are open:",
                hanging="",
            ),
            Table(["nats", "hours", "nats/hour"], rows, corner="measurement"),
            Note("Best one after the other:"),
            *(
                Note(f"{number}. {p.measurement} ({p.information:+.2f} nats)", "  ", "     ")
                for number, p in enumerate(self.sequence, 1)
            ),
        ]


_MOST = 99.0
"""Evidence in nats above which the table shows no number: the distinction is certain."""
GENERIC_UNCERTAINTY = (0.04, 0.04, 0.02, 0.7, 0.7)
"""Standard deviation of the model's error before any engine has run, by feature."""


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
    """Return the effects that the case's data could distinguish, and what to measure next.

    Without a finding the proposals are made before anything is measured: each effect of the library has
    its prior probability. With one they go on from the probabilities that the data have left.

    Parameters
    ----------
    case : Case
        Of its measurements, only the parameters and their uncertainties are used.
    effects : sequence of Effect, optional
        By default the whole library. Without known directions, those that need them are left out
        (`Effect.needs_directions`).
    change : float
        Relative change of T20 in the band that the effect changes most, above 0 and at most 1. Each
        effect has the size that comes nearest to it.
    finding : Finding, optional
        Of this case, as `find` returns it; its control rooms say how far the model errs, which is
        `GENERIC_UNCERTAINTY` without.
    costs : mapping of str to float, optional
        Hours that a measurement takes, in place of `rtcal.finder.means.planning.COSTS`:
        ``{"G": 0.5, "another climate": 40}``.
    planned : sequence of Configuration, optional
        Further configurations that could be measured.

    Raises
    ------
    DataError
        If ``change`` is no such number, an effect breaks a rule, ``costs`` has another name or a number
        that is not above 0, or the finding is of another case.

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
        raise DataError(f"change = {change:g} is not above 0 and at most 1 (a share of T)")
    hours = _checked_costs(costs)
    if finding is not None and finding.case is not case:
        raise DataError("finding is of another case: state the case that it was found in")
    observed, _ = observe(case)
    tried, _ = judged_effects(checked_effects(effects), case.directions_known)
    predicted = predict_hypotheses(case, tried)
    spread = np.broadcast_to(
        np.array(GENERIC_UNCERTAINTY)[:, None] ** 2, observed.used.shape
    ).ravel()
    discrepancy = ModelDiscrepancy(np.zeros(spread.size), np.diag(spread))
    if finding is not None:
        discrepancy = finding.discrepancy
    problem = MeansProblem(case, observed, predicted, discrepancy)
    reached, table = _told_apart(problem, change)
    measured = tuple(
        p
        for p in ("t20", "edt", "t30", "c80", "g")
        if any(p in c.measured.values for c in case.configurations)
    )
    further = possible(case, planned)
    whole, there, masks = extended(problem, further)
    if finding is None:
        every = _before(case, predicted)
    else:
        every = [(effects_of, p) for effects_of, p in finding.likely if p > _NEGLIGIBLE]
    about = _information(whole, there, every, None if finding is None else observed)

    def ranked(done: Mask) -> list[Proposal]:
        """Return every measurement that adds something to ``done``, the most nats per hour first."""
        start = about.of(done) if done.any() else 0.0
        added = [
            Proposal(f.words, f.kind, max(about.of(done | mask) - start, 0.0), hours[f.kind])
            for f in further
            if ((mask := masks[f.words]) & ~done).any()
        ]
        return sorted(added, key=lambda p: -p.per_cost)

    done: Mask = np.zeros(len(there), dtype=bool)
    proposals, sequence = ranked(done), list[Proposal]()
    best = proposals
    while best and len(sequence) < STEPS:
        sequence.append(best[0])
        done = done | masks[best[0].measurement]
        best = ranked(done) if len(sequence) < STEPS else []
    return Plan(
        measured, change, reached, table, tuple(proposals), tuple(sequence), about.entropy()
    )


def _checked_costs(costs: object) -> dict[str, float]:
    """Return `COSTS` with a user's in place; DataError for another name, or a cost not above 0."""
    stated = {} if costs is None else checks.mapped("costs", costs)
    for name in stated:
        if name not in COSTS:
            raise DataError(f'costs has "{name}", which is not one of {", ".join(COSTS)}')
    return {**COSTS, **{k: checks.positive(f'costs["{k}"]', v) for k, v in stated.items()}}


_NEGLIGIBLE = 1e-4
"""Probability of a hypothesis that a plan leaves out."""
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
        """Return the entropy of the sets before any further measurement, in nats."""
        return float(self._entropy(self._weights[None])[0])

    def of(self, further: Mask) -> float:
        """Return the information of measuring these features as well, in nats."""
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


def _told_apart(
    problem: MeansProblem, change: float
) -> tuple[dict[str, float], dict[tuple[str, str], float]]:
    """Return each effect's change of T, and the evidence in nats for each against each other.

    Each effect has the size whose largest relative change of T, over configurations (it may be taken
    away in some) and bands, is nearest to ``change``.
    """
    predicted = problem.predicted
    table: dict[tuple[str, str], float] = {}
    reached: dict[str, float] = {}
    log_t = predicted.features[:, :, 0]
    for name in predicted.effects:
        rows = predicted.rows[name]
        moved = np.abs(np.expm1(log_t[rows] - log_t[0])).max((1, 2))
        nearest = int(np.argmin(np.abs(moved - change)))
        reached[name] = float(moved[nearest])
        apart = separations(problem, int(rows[nearest]))
        table |= {(name, other): nats for other, nats in apart.items() if other != name}
    return reached, table


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
that there are. G needs a calibrated source. "planned" are configurations that a user states."""
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
    for kind, parameters in FURTHER.items():
        lacking = [c for c in case.configurations if not set(parameters) <= set(c.measured.values)]
        if lacking:
            out.append(FurtherMeasurement(kind, further_in_words(kind), parameters))
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


def extended(
    problem: MeansProblem, further: Sequence[FurtherMeasurement]
) -> tuple[MeansProblem, Mask, dict[str, Mask]]:
    """Return the problem with every further configuration in its case.

    Its hypotheses are those of the case as it is. Of the features in use, (m,), follow which are
    measured already, and which each further measurement adds, by its words.
    """
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
    places = np.flatnonzero(used.ravel())
    full[np.ix_(places, places)] = observed.covariance
    whole = replace(
        problem,
        case=replace(case, configurations=configurations),
        observed=ObservedFeatures(np.zeros(every.shape), every, full[np.ix_(flat, flat)]),
        discrepancy=_model_error(problem.discrepancy, count, [f.same_error for f, _ in new]),
    )
    return whole, used.ravel()[flat], {words: m.ravel()[flat] for words, m in masks.items()}


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
