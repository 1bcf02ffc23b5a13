"""The verdict: what is claimed of sets of effects, the checks of a claim, and an effect's size."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.special import logsumexp

from rtcal.finder import prior
from rtcal.finder.case import Case
from rtcal.finder.claim import (
    CLAIMED,
    Names,
    by_family_sets,
    claimed,
    credible_set,
    family_of,
    narrowest_family,
    numbers_of,
    over_frequency,
)
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.effects.checks import AppliedEffect, changed_states
from rtcal.finder.finding import End, Size
from rtcal.finder.means.evidence import NEGLIGIBLE, MeansEvidence
from rtcal.finder.means.gap import (
    GapCheck,
    Objection,
    decided_below_schroeder,
    end_of_range,
    gap_against,
    gap_check,
    gross,
    mistake_in,
    too_large,
    unexplained,
)
from rtcal.finder.means.hypotheses import predict_hypotheses, state
from rtcal.finder.means.sets import SetPosterior
from rtcal.finder.model import rates
from rtcal.finder.prior import COEFFICIENTS, NONE, SCALES, UNKNOWN, OffTogether
from rtcal.support.types import Array

AT_END = 2.0
"""Evidence in nats below that of the best size from which the last size that is tried is no end."""


@dataclass(frozen=True, eq=False)
class AbsorptionChange:
    """Absorption area that an effect adds by band, over the room's mean one over the bands.

    ``share`` (3, n_bands) is that of the size's mean, and of both ends of its interval. ``end`` is the
    size's.
    """

    share: Array
    end: End = ""

    @property
    def words(self) -> str:
        """The mean over the bands, and whether it rises with frequency.

        >>> AbsorptionChange(np.array([[0.2, 0.6], [0.1, 0.3], [0.3, 0.9]])).words
        '40 % more absorption (90 %: 20 to 60 %), rising with frequency'
        """
        mean, *ends = 100 * np.abs(self.share.mean(1))
        more = "more" if self.share[0].mean() > 0 else "less"
        if self.end:
            bound = min(ends) if self.end == "least" else max(ends)
            said = f"at {self.end} {bound:.0f} % {more} absorption"
        else:
            said = f"{mean:.0f} % {more} absorption (90 %: {min(ends):.0f} to {max(ends):.0f} %)"
        return f"{said}, {over_frequency(self.share[0])}"


def absorption_change(
    case: Case, effect: Effect, parameters: Parameters, size: Size | None
) -> AbsorptionChange | None:
    """Return what an effect of absorption changes in the first configuration; None for another."""
    if size is None or "absorption" not in effect.family:
        return None
    base = state(case, case.configurations[0])
    sets = [{**parameters, effect.size: s} for s in (size.mean, size.low, size.high)]
    without, *others = rates([base, *changed_states(effect, base, sets)])
    return AbsorptionChange((np.array(others) - without) / without.mean(), size.end)


def estimate_size(
    evidence: MeansEvidence, name: str, *, precise: bool = True
) -> tuple[Parameters, Size | None]:
    """Return the effect's most probable parameters, and its size with a 90 % interval.

    Without ``precise``, the best set of the grid is taken, and the size is evaluated for it in wide
    steps. With it, a search improves the best set, and the size is evaluated in fine steps for it and
    for the three most probable sets of the other parameters.
    """
    problem = evidence.problem
    predicted, base = problem.predicted, state(problem.case, problem.case.configurations[0])
    effect, rows = predicted.effects[name], evidence.rows[name]
    likelihood = evidence.by_hypothesis()[rows]
    grid = [predicted.parameters[i] for i in rows]

    def log_density(thetas: Sequence[Parameters]) -> Array:
        return np.log(np.maximum(effect.densities(thetas, base), _LEAST_DENSITY))

    def evaluated(thetas: Sequence[Parameters]) -> Array:
        return evidence.under(effect, thetas).by_hypothesis()[1:] + log_density(thetas)

    best = grid[int(np.argmax(likelihood + log_density(grid)))]
    if precise:
        best = _searched(grid, best, effect.discrete, evaluated)
    if not np.isfinite(effect.neutral):
        return best, None
    weights = predicted.weights[rows] * np.exp(likelihood - likelihood.max())
    weights = weights / weights.sum()
    by_others: dict[tuple[tuple[str, float], ...], float] = {}
    for theta, w in zip(grid, weights, strict=True):
        key = _others(theta, effect)
        by_others[key] = by_others.get(key, 0.0) + float(w)
    most = sorted(by_others, key=lambda k: -by_others[k])[:3]
    likely = list(dict.fromkeys([_others(best, effect), *most]))
    sizes = np.array([theta[effect.size] for theta in grid])
    logs = bool(sizes.min() > 0)
    low, high = float(sizes.min()), float(sizes.max())
    possible = effect.size_limits(evidence.problem.case.room)
    if logs:
        first, last = np.log(low / 3), np.log(high * 3)
        ends = np.log(np.maximum(possible, low / 1e6))
    else:
        first, last, ends = low - 10, high + 10, np.array(possible)

    def size_of(x: Array) -> Array:
        return np.clip(np.exp(x), *possible) if logs else x

    def at(x: Array, kinds: Sequence[Any]) -> Array:
        return evaluated([{**dict(k), effect.size: float(s)} for k in kinds for s in size_of(x)])

    def steps(first: float, last: float, count: int) -> Array:
        return np.linspace(max(first, ends[0]), min(last, ends[1]), count)

    fine = steps(first, last, 25)
    log_p = at(fine, likely[:1])
    end: End = ""
    if high > effect.neutral and fine[-1] < ends[1] and log_p[-1] > log_p.max() - AT_END:
        end = "least"
    elif low < effect.neutral and fine[0] > ends[0] and log_p[0] > log_p.max() - AT_END:
        end = "most"
    if precise:
        likely_range = fine[log_p > log_p.max() - NEGLIGIBLE]
        step = fine[1] - fine[0] + 2.6 * effect.size_error
        fine = steps(likely_range[0] - step, likely_range[-1] + step, 37)
        log_p = at(fine, likely)
    else:
        likely = likely[:1]
    by_size = np.exp(log_p - logsumexp(log_p)).reshape(len(likely), len(fine)).sum(0)
    by_size = _widened(by_size, fine, effect.size_error)
    cumulated = np.cumsum(by_size) - 0.5 * by_size
    interval = [float(np.interp(q, cumulated, size_of(fine))) for q in (0.05, 0.95)]
    return best, Size(float(by_size @ size_of(fine)), interval[0], interval[1], effect.unit, end)


_LEAST_DENSITY = 1e-30
"""Density below which parameters are impossible."""


def _widened(p: Array, at: Array, spread: float) -> Array:
    """Return probabilities on an even grid, convolved with a normal distribution."""
    if spread == 0:
        return p
    kernel = np.exp(-0.5 * (np.subtract.outer(at, at) / spread) ** 2)
    # Probability that would leave the grid stays at its ends.
    return np.asarray(kernel / kernel.sum(0) @ p)


def _others(theta: Parameters, effect: Effect) -> tuple[tuple[str, float], ...]:
    return tuple((k, v) for k, v in theta.items() if k != effect.size)


def _searched(
    grid: Sequence[Parameters],
    start: Parameters,
    discrete: Sequence[str],
    evaluated: Callable[[Sequence[Parameters]], Array],
) -> Parameters:
    """Improve the grid's best parameters within the grid's range; discrete ones stay.

    Each round evaluates a lattice around the best, one step of the last lattice wide.
    """
    names = [k for k in start if k not in discrete and len({theta[k] for theta in grid}) > 1]
    if not names:
        return start
    values = np.array([[theta[k] for k in names] for theta in grid])
    logs = values.min(0) > 0
    scaled = np.log(np.where(logs, values, 1.0)) + np.where(logs, 0.0, values)
    low, width = scaled.min(0), np.ptp(scaled, axis=0)
    at = (scaled[grid.index(start)] - low) / width
    step = np.array([1 / (len(np.unique(column)) - 1) for column in values.T])

    def theta_of(x: Array) -> Parameters:
        values = low + width * x
        values = np.where(logs, np.exp(np.where(logs, values, 0.0)), values)
        return {**start, **dict(zip(names, values.tolist(), strict=True))}

    points, rounds = {1: (9, 3), 2: (5, 5)}.get(len(names), (3, 5))
    lattice = np.array(list(product(np.linspace(-1, 1, points), repeat=len(names))))
    for _ in range(rounds):
        candidates = np.unique(np.clip(at + lattice * step, 0, 1), axis=0)
        at = candidates[np.argmax(evaluated([theta_of(x) for x in candidates]))]
        step = step * 2 / (points - 1) if points > 3 else step / 2
    return theta_of(at)


LIKELY = 0.5
"""Probability from which coefficients that are off together are said beside an effect."""
TWO = 0.98
"""Probability of two or more effects from which more than one family is claimed. An absorber hides the
wall behind it and makes the field less even, and a formula knows neither. So one effect of the room
leaves what a second one explains. Chosen on development rooms of the first hidden
world (docs/discrepancy_study.md)."""
_LARGER = SCALES[0][0]


@dataclass(frozen=True, eq=False)
class Fit:
    """A candidate in its most probable form.

    ``parameters`` have the size's mean, ``most_probable`` the size that fits best. ``coefficients``
    are None where they are right as stated. ``gap`` is the gap that alpha cannot close. ``surprise`` is
    what `goodness_of_fit` returns, ``absorption`` how much the room's absorption changes.
    """

    name: str
    parameters: Parameters
    size: Size | None
    coefficients: OffTogether | None
    gap: GapCheck
    most_probable: Parameters
    surprise: tuple[float, float]
    absorption: AbsorptionChange | None = None

    def applied(self, effect: Effect) -> AppliedEffect:
        """Return the effect with its size and interval, to be put into a case."""
        ends = None if self.size is None else (self.size.low, self.size.high)
        return AppliedEffect.of(effect, self.parameters, ends)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The verdict; its fields are those of `rtcal.finder.MeansFinding`; ``names`` the candidates'."""

    verdict: str
    family: str | None = None
    named: Names = ()
    named_families: Names = ()
    named_set: Names = ()
    members: Names = ()
    names: Names = ()
    fits: Mapping[str, Fit] = field(default_factory=dict)
    alone: Mapping[str, Fit] = field(default_factory=dict)
    stand_ins: Mapping[str, Names] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()
    leads: bool = False
    mistake: str = ""


def of_single(
    evidence: MeansEvidence,
    probabilities: Mapping[str, float],
    families: Mapping[str, float],
    detected: str | None,
    weak: str = "",
) -> Verdict:
    """Return what is claimed where one effect is missing at most.

    ``detected`` is "none" or "hint" where the score does not exceed its threshold, else None.
    ``weak`` is why the data do not say enough (`rtcal.finder.claim.too_weak`): a hint, then.
    """
    effects = evidence.problem.predicted.effects
    best = next(k for k in probabilities if k != NONE)
    rough = [name for name, effect in effects.items() if not effect.alone]
    verdict, family = claimed(detected, probabilities, families, rough)
    if verdict == "none":
        return Verdict(verdict=verdict, family=family)
    weak = weak if detected is None and verdict in ("ambiguous", "unknown") else ""
    verdict = "hint" if weak else verdict
    fits, found = dict[str, Fit](), tuple[Objection, ...]()
    if best != UNKNOWN:
        fits[best] = fit(evidence, best, precise=True)
        found = doubts(evidence, fits[best])
        verdict = doubted(verdict, family, found)
    names = (best,) if verdict == "named" else credible_set(probabilities)
    for name in names:
        if name not in (best, UNKNOWN):
            fits[name] = fit(evidence, name, precise=False)
    sure = family is not None and verdict in ("named", "family")
    return Verdict(
        verdict=verdict,
        family=family,
        named=(best,) if verdict == "named" else (),
        named_families=(str(family),) if sure else (),
        members=(best,) if best in fits else (),
        names=names,
        fits=fits,
        reasons=tuple(filter(None, (weak, *(doubt.words for doubt in found)))),
        leads=sure and bool(found) and found[0].of == "stated",
        mistake=mistake_in(found),
    )


def of_sets(
    evidence: MeansEvidence,
    posterior: SetPosterior,
    probabilities: Mapping[str, float],
    families: Mapping[str, float],
) -> Verdict:
    """Return what is claimed of sets of effects, where something is missing.

    A doubt that speaks against the effect leaves nothing of it claimed, any other its family.
    """
    if probabilities.get(UNKNOWN, 0.0) >= CLAIMED:
        return Verdict(verdict="unknown", names=(UNKNOWN,))
    effects = evidence.problem.predicted.effects
    together = _together(by_family_sets(posterior.sets, effects), numbers_of(posterior.sets))
    best = posterior.best(effects, together)
    fits, found = _members(evidence, posterior, best)
    every = [doubt for n in best for doubt in found[n]]
    refuted = {n for n in best if any(doubt.of == "effect" for doubt in found[n])}
    if refuted:
        together = ()
    sound = [n for n in best if n not in refuted]
    sound.sort(key=lambda n: -families[family_of(n, effects)])
    if not together:
        sound = sound[:1]
    named = [n for n in sound if probabilities[n] >= CLAIMED and effects[n].alone and not found[n]]
    if probabilities.get(COEFFICIENTS, 0.0) >= CLAIMED:
        named.append(COEFFICIENTS)
    claimed = _families_claimed(sound, families, effects)
    verdict = "named" if named else "family" if claimed or together else "ambiguous"
    stand_ins = posterior.stand_ins(best)
    others = dict.fromkeys(n for names in stand_ins.values() for n in names)
    return Verdict(
        verdict=verdict,
        family=claimed[0] if claimed else None,
        named=tuple(named),
        named_families=tuple(claimed),
        named_set=together,
        members=best,
        names=(*best, *(n for n in others if n not in best)),
        fits=fits,
        alone={n: fit(evidence.beside(n), n, precise=True) for n in best} if len(best) > 1 else {},
        stand_ins=stand_ins,
        reasons=tuple(dict.fromkeys(doubt.words for doubt in every)),
        leads=verdict == "family" and bool(every) and every[0].of == "stated",
        mistake=mistake_in(every),
    )


def _members(
    evidence: MeansEvidence, posterior: SetPosterior, best: Names
) -> tuple[dict[str, Fit], dict[str, tuple[Objection, ...]]]:
    """Return the fit of each effect of a set with the others in the model, and the doubts about it."""
    predicted = evidence.problem.predicted
    effects, parameters = predicted.effects, predicted.parameters
    model = {
        name: AppliedEffect.of(effects[name], parameters[i])
        for name, i in zip(best, posterior.rows[best], strict=True)
    }
    fits: dict[str, Fit] = {}
    found: dict[str, tuple[Objection, ...]] = {}
    # The others' sizes enter each fit, so the first is fitted again.
    for name in (*best, best[0]) if len(best) > 1 else best:
        beside = evidence.beside(name, [model[n] for n in best if n != name])
        fits[name] = fit(beside, name, precise=True)
        found[name] = doubts(beside, fits[name])
        model[name] = fits[name].applied(effects[name])
    return {n: fits[n] for n in best}, found


def _together(family_sets: Mapping[Names, float], numbers: Sequence[float]) -> Names:
    """Return the most probable families of two or more effects; () where these are not probable."""
    several = next((s for s in family_sets if len(s) > 1 and UNKNOWN not in s), ())
    return several if several and sum(numbers[2:]) >= TWO else ()


def _families_claimed(
    sound: Sequence[str], families: Mapping[str, float], effects: Mapping[str, Effect]
) -> list[str]:
    """Return the families of effects that are probable enough to be claimed."""
    claimed = []
    for name in sound:
        family = family_of(name, effects)
        wide = family.split(",")[0]
        narrow = narrowest_family({f: families[f] for f in (family, wide)}, CLAIMED)
        if narrow is not None and narrow not in claimed:
            claimed.append(narrow)
    return claimed


def fit(evidence: MeansEvidence, name: str, *, precise: bool) -> Fit:
    """Return a candidate's parameters, its size (`estimate_size`), and what becomes of the gap."""
    problem = evidence.problem
    case = problem.case
    parameters: Parameters = {}
    likely: Parameters = {}
    size, absorption = None, None
    row, predicted = 0, predict_hypotheses(case, [])
    probability = 1.0
    if name != COEFFICIENTS:
        effect = problem.predicted.effects[name]
        likely, size = estimate_size(evidence, name, precise=precise)
        parameters = likely if size is None else {**likely, effect.size: size.mean}
        absorption = absorption_change(case, effect, parameters, size)
        row, predicted = 1, predict_hypotheses(case, [effect], [[parameters]])
        probability = float(evidence.off_given(name))
    alone = replace(problem, predicted=predicted)
    off, scale = None, 1.0
    if probability >= LIKELY:
        scale = _LARGER
        alpha, other = alone.covariance_of(row)
        off = prior.off_together(
            case,
            predicted.alpha_covariance.slopes(row),
            alone.spreading(row),
            alone.residual(row),
            alpha + other,
            probability,
        )
    gap = gap_check(alone, row, scale)
    surprise = alone.goodness_of_fit(row, scale)
    return Fit(name, parameters, size, off, gap, likely, surprise, absorption)


def doubts(evidence: MeansEvidence, best: Fit) -> tuple[Objection, ...]:
    """Return the doubts about the best candidate."""
    problem = evidence.problem
    out = gross(evidence, best.name, best.gap)
    out += unexplained(best.name, *best.surprise)
    out += gap_against(best.name, best.gap)
    effects = []
    if best.name != COEFFICIENTS:
        effects = [problem.predicted.effects[best.name]]
        out += end_of_range(best.name, best.size)
        out += too_large(problem.case, effects[0], best.parameters)
    hypotheses = predict_hypotheses(problem.case, effects)
    return (*out, *decided_below_schroeder(evidence, hypotheses, best.name))


def doubted(verdict: str, family: str | None, found: Sequence[Objection]) -> str:
    """Return what is left of a claim after the doubts about its best candidate.

    Doubts about the size, the fit or what is stated leave the family claimed, where it is probable.
    """
    if verdict not in ("named", "family") or not found:
        return verdict
    if family is None or any(doubt.of == "effect" for doubt in found):
        return "hint"
    return "family"
