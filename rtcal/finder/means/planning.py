"""Plan measurements: which effects the data could distinguish, and what to measure next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics.observables import parameter_label
from rtcal.finder.case import Case, Configuration
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.effects import Effect
from rtcal.finder.effects.checks import AppliedEffect, checked_effects, judged_effects
from rtcal.finder.means.features import (
    ModelDiscrepancy,
    ObservedFeatures,
    checked_discrepancy,
    observe,
)
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.hypotheses import MeansHypotheses, predict_hypotheses
from rtcal.finder.means.likelihood import MeansProblem
from rtcal.finder.means.measurements import (
    COSTS,
    Extended,
    FurtherMeasurement,
    Information,
    Mask,
    Pairs,
    Separations,
    blind,
    extended,
    possible,
    separations,
)
from rtcal.finder.means.sets import compare, moments
from rtcal.finder.prior import NONE, prior_of
from rtcal.support import checks, text
from rtcal.support.errors import DataError
from rtcal.support.saved import Result
from rtcal.support.speed import single_threaded_blas
from rtcal.support.text import listed

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
        return {
            "measurement": self.measurement,
            "kind": self.kind,
            "information_nats": self.information,
            "cost": self.cost,
            "nats_per_cost": self.per_cost,
        }


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Result):
    """The effects that a case's data could distinguish.

    ``separations`` maps (effect, effect) to nats: the expected evidence for the first effect
    against the most similar size of the second. The first has the size whose relative change of T
    is nearest to ``change``. ``reached`` maps each effect to the change of T at this size.
    ``proposals`` are the measurements that could be made next, the most information per hour first;
    ``sequence`` are the three that a greedy choice takes one after the other. ``uncertainty`` is the
    entropy of what is known of the effects now, in nats: no measurement gives more.
    """

    record_kind: ClassVar[str] = "plan 1"

    parameters: tuple[str, ...]
    change: float
    reached: Mapping[str, float]
    separations: Separations
    more: Mapping[str, Separations]
    proposals: tuple[Proposal, ...] = ()
    sequence: tuple[Proposal, ...] = ()
    uncertainty: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""

        def rows(table: Separations) -> list[dict[str, Any]]:
            return [{"effect": a, "against": b, "nats": v} for (a, b), v in table.items()]

        return {
            "parameters": list(self.parameters),
            "change": self.change,
            "reached": dict(self.reached),
            "separations": rows(self.separations),
            "with_more": {label: rows(table) for label, table in self.more.items()},
            "proposals": [p.to_dict() for p in self.proposals],
            "sequence": [p.to_dict() for p in self.sequence],
            "uncertainty_nats": self.uncertainty,
        }

    def __repr__(self) -> str:
        """Return one line: the parameters, and how many pairs of effects they can distinguish."""
        names = list(self.reached)
        pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
        both, one_sided = blind(self.separations, pairs)
        distinct = len(pairs) - len(both) - len(one_sided)
        return (
            f"<Plan with {', '.join(self.parameters)}: {distinct} of {len(pairs)} pairs of effects "
            "can be distinguished>"
        )

    def __str__(self) -> str:
        """Return what each effect would show, what it may be taken for, and what to measure next."""
        names = list(self.reached)
        pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
        both, one_sided = blind(self.separations, pairs)
        lines = [*self._seen(), "", *self._taken_for()]
        for label, table in self.more.items():
            still, half = blind(table, pairs)
            gained = [p for p in both if p not in still and p not in half and p[::-1] not in half]
            gained += [p for p in one_sided if p not in half]
            lines += ["", *_grouped(f"With {label} could also be told apart", gained)]
        return "\n".join([*lines, *self.proposed])

    def _seen(self) -> list[str]:
        """Return a table: each effect with its change of T and the evidence that it is there."""
        measured = listed([parameter_label(p) for p in self.parameters])
        rows = []
        for name, change in self.reached.items():
            nats = self.separations[name, NONE]
            seen = "yes" if nats >= DISTINCT_NATS else "no"
            rows.append((name, [f"{100 * change:.1f} %", _cell(nats), seen]))
        said = (
            f"What {measured} would show of each effect, if it alone were in the room. Each has the "
            f"size whose change of T is nearest to {100 * self.change:g} %. Evidence of "
            f"{DISTINCT_NATS} nats, odds of ten to one, is enough to see it."
        )
        header = ("effect", ["change of T", "evidence / nats", "seen"])
        return [*text.wrapped(said, hanging=""), *text.table(rows, header=header)]

    def _taken_for(self) -> list[str]:
        """Return for each effect the others that the data would leave possible."""
        lines = text.wrapped(
            "What each may be taken for: the data would tell it from these by less than "
            f"{DISTINCT_NATS} nats.",
            hanging="",
        )
        for name in self.reached:
            others = [b for b in self.reached if b != name]
            alike = [b for b in others if self.separations[name, b] < DISTINCT_NATS]
            apart = [b for b in others if b not in alike]
            said = ", ".join(alike) or "no other"
            if len(alike) > len(apart):
                said = f"all but {', '.join(apart)}" if apart else "all"
            lines += text.wrapped(f"{name}: {said}", indent="  ", hanging="    ")
        return lines

    @property
    def proposed(self) -> list[str]:
        """The further measurements as lines: information, hours, and the greedy sequence."""
        if not self.proposals:
            return []
        lines = text.wrapped(
            "What to measure next: the information to expect about which effects are there, and the "
            f"hours that it takes. Of {self.uncertainty:.2f} nats that are open:",
            hanging="",
        )
        rows = [
            (f"  {p.measurement}", [f"{p.information:.2f}", f"{p.cost:g}", f"{p.per_cost:.2f}"])
            for p in self.proposals
        ]
        lines += text.table(rows, header=("  measurement", ["nats", "hours", "nats/hour"]))
        lines += ["", "Best one after the other:"]
        for number, p in enumerate(self.sequence, 1):
            step = f"{number}. {p.measurement} ({p.information:+.2f} nats)"
            lines += text.wrapped(step, indent="  ", hanging="     ")
        return ["", *lines]


_MOST = 99.0
"""Evidence in nats above which the table shows no number: the distinction is certain."""


def _cell(nats: float) -> str:
    return f"{nats:.1f}" if nats <= _MOST else f">{_MOST:.0f}"


def _grouped(title: str, pairs: Pairs) -> list[str]:
    """Return a title, and a line for each first effect of some pairs with all its second ones."""
    others: dict[str, list[str]] = {}
    for a, b in pairs:
        others.setdefault(a, []).append(b)
    if not others:
        return [f"{title}: none."]
    rows = [f"{a} from {', '.join(b)}" for a, b in others.items()]
    return [f"{title}:", *(line for row in rows for line in text.wrapped(row, indent="  "))]


GENERIC_UNCERTAINTY = (0.04, 0.04, 0.02, 0.7, 0.7)
"""Standard deviation of the model's error before any engine has run, by feature."""


@single_threaded_blas()
def plan(
    case: Case,
    effects: Sequence[Effect] | None = None,
    change: float = 0.2,
    discrepancy: ModelDiscrepancy | None = None,
    *,
    finding: MeansFinding | None = None,
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
    discrepancy : ModelDiscrepancy, optional
        From the case's control rooms; by default the finding's, or `GENERIC_UNCERTAINTY`.
    finding : MeansFinding, optional
        Of this case, as `find` returns it.
    costs : mapping of str to float, optional
        Hours that a measurement takes, in place of `rtcal.finder.means.measurements.COSTS`:
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
    if discrepancy is None and finding is not None:
        discrepancy = finding.discrepancy
    if discrepancy is None:
        shape = observed.used.shape
        spread = np.broadcast_to(np.array(GENERIC_UNCERTAINTY)[None, :, None] ** 2, shape).ravel()
        discrepancy = ModelDiscrepancy(np.zeros(spread.size), np.diag(spread))
    else:
        checked_discrepancy(case, discrepancy)
    problem = MeansProblem(case, observed, predicted, discrepancy)
    reached, tables = separations(problem, change)
    measured = tuple(
        p
        for p in ("t20", "edt", "t30", "c80", "g")
        if any(p in c.measured.values for c in case.configurations)
    )
    with_more = {label: t for label, t in tables.items() if label}
    further = possible(case, planned)
    whole = extended(problem, further)
    if finding is None:
        every = _before(case, predicted)
    else:
        every = [(effects_of, p) for effects_of, p in finding.likely if p > _NEGLIGIBLE]
    about = _information(whole, every, None if finding is None else observed)
    proposals = _ranked(about, whole, further, hours)
    return Plan(
        measured,
        change,
        reached,
        tables[""],
        with_more,
        tuple(proposals),
        tuple(_greedy(about, whole, further, hours)),
        about.entropy(),
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
        rows = [i for i, n in enumerate(predicted.names) if n == name]
        cumulated = np.cumsum(predicted.weights[rows])
        places = (np.arange(_OF_EACH) + 0.5) / _OF_EACH
        for i in np.minimum(np.searchsorted(cumulated, places), len(rows) - 1):
            added = AppliedEffect.of(effect, predicted.parameters[rows[i]])
            out.append(((added,), float(np.exp(prior[name])) / _OF_EACH))
    total = sum(p for _, p in out)
    return [(applied, p / total) for applied, p in out]


def _information(
    whole: Extended, every: Weighted, observed: ObservedFeatures | None
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
    predicted = predict_hypotheses(whole.problem.case, list(effects.values()), list(grids.values()))
    first = {name: predicted.names.index(name) for name in grids}
    rows = [
        tuple(first[a.name] + grids[a.name].index(a.parameters) for a in applied)
        for applied, _ in every
    ]
    names = [tuple(a.name for a in applied) for applied, _ in every]
    groups = {n: k for k, n in enumerate(dict.fromkeys(names))}
    of = moments(compare(replace(whole.problem, predicted=predicted)), rows)
    weights = np.array([p for _, p in every]) * of.possible
    return Information(
        of,
        weights / weights.sum(),
        np.array([groups[n] for n in names]),
        whole.measured,
        None if observed is None else observed.values,
    )


def _ranked(
    about: Information,
    whole: Extended,
    further: Sequence[FurtherMeasurement],
    hours: Mapping[str, float],
    before: Mask | None = None,
) -> list[Proposal]:
    """Return every measurement that adds something, the most nats per hour first.

    ``before`` are features that earlier measurements of a sequence give.
    """
    done: Mask = np.zeros(len(whole.measured), dtype=bool) if before is None else before
    start = about.of(done) if done.any() else 0.0
    out = [
        Proposal(
            f.words, f.kind, max(about.of(done | whole.masks[f.words]) - start, 0.0), hours[f.kind]
        )
        for f in further
        if (whole.masks[f.words] & ~done).any()
    ]
    return sorted(out, key=lambda p: -p.per_cost)


def _greedy(
    about: Information,
    whole: Extended,
    further: Sequence[FurtherMeasurement],
    hours: Mapping[str, float],
) -> list[Proposal]:
    """Return `STEPS` measurements, each the best after those before it."""
    out: list[Proposal] = []
    done: Mask = np.zeros(len(whole.measured), dtype=bool)
    for _ in range(min(STEPS, len(further))):
        best = _ranked(about, whole, further, hours, done)
        if not best:
            break
        out.append(best[0])
        done = done | whole.masks[best[0].measurement]
    return out
