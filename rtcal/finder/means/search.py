"""Find what is missing from a model by means over positions.

The marginal likelihoods of all effects are compared, an effect is identified or not, and its size is
estimated. The most probable effect is then checked by the parameters that coefficients cannot fit.
Calibrated coefficients fit T20 of the first configuration whatever is missing; the deviations of C80,
G, EDT and of other configurations remain, and must become smaller with the effect. Here they are
calculated by a linear model; `rtcal.finder.verify` calculates them by calibrating.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr

from rtcal.acoustics import bands
from rtcal.acoustics.bands import mid_frequency_time, schroeder_frequency
from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.observables import TARGET, observable, parameter_label
from rtcal.finder.case import Case
from rtcal.finder.claim import (
    CLAIMED,
    DISTINCT_NATS,
    EQUATION_OFF,
    LEADING,
    LEAVES,
    MISTAKE,
    Candidate,
    Detection,
    End,
    Names,
    Reason,
    Size,
    by_family,
    conclude,
    credible_set,
    family_of,
    narrowest_family,
    of_program,
    posterior,
    summed,
    too_weak,
    wide,
)
from rtcal.finder.effects import (
    Effect,
    Parameters,
    changed_states,
    checked_effects,
    columns,
    judged_effects,
)
from rtcal.finder.evidence import (
    COEFFICIENTS,
    EXPECTED,
    NONE,
    NONE_LEFT,
    SCALES,
    UNKNOWN,
    Prior,
    by_direction,
    directions,
    left_out_of,
    off_together,
    prior_of,
)
from rtcal.finder.finding import Finding
from rtcal.finder.means.engines import ControlRooms, checked_controls, control_rooms
from rtcal.finder.means.planning import next_measurement
from rtcal.finder.means.problem import (
    MOST,
    NEGLIGIBLE,
    MeansEvidence,
    MeansProblem,
    SetPosterior,
    applied_effects,
    averaged_alpha,
    compare,
    estimate_discrepancy,
    evaluate,
    evaluate_beyond,
    log_density,
    null_scores,
    observe,
    offset_of,
    posterior_of_sets,
    predict_hypotheses,
    single_posterior,
    state,
    steps,
    thresholds,
    values_of_features,
)
from rtcal.finder.means.problem import score as evidence_of_something
from rtcal.finder.model import FEATURES, LEVELS, rates
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import TaskProgress, single_threaded_blas
from rtcal.support.types import Array


@single_threaded_blas()
def find(
    case: Case,
    effects: Sequence[Effect] | None = None,
    *,
    most: int = 1,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    prior: Mapping[str, float] | None = None,
    controls: Sequence[ControlRooms] | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
    scheduler: str | None = None,
) -> Finding:
    """Find the effects that are missing, by means over positions, as `rtcal.find` says."""
    checks.instance("case", case, Case).require_fresh()
    every = checked_effects(effects)
    special = [COEFFICIENTS, UNKNOWN]
    left_out = left_out_of(only, without, [*(e.name for e in every), *special], [UNKNOWN])
    effects = tuple(e for e in every if e.name not in left_out)
    if not effects:
        raise DataError(NONE_LEFT)
    odds, names = dict[str, float](), [*(e.name for e in effects), NONE, *special]
    for name, value in ({} if prior is None else checks.mapped("prior", prior)).items():
        if name not in names:
            raise DataError(f'prior has "{name}", which is not one of {", ".join(names)}')
        odds[name] = checks.positive(f'prior["{name}"]', value)
    effects, not_judged = judged_effects(effects, case.directions_known, bool(case.program))
    if checks.whole("most", most, 1) > MOST:
        raise DataError(f"most = {most} must be from 1 to {MOST}")
    if most > 1 and len(effects) < 2:
        raise DataError(
            f"most = {most} is too large, because only {len(effects)} effect is tried; use most = 1"
        )
    expected = float(np.log1p(1 / odds[NONE])) if NONE in odds else EXPECTED
    observed, dropped = observe(case)
    noted: list[Reason | str] = [*dropped]
    if len(without) or len(only) or prior:
        noted.append(Reason("chosen"))
    before = prior_of(case.room, effects, odds, left_out)
    predicted = predict_hypotheses(case, effects)
    if controls is None:
        controls = control_rooms(case, 0, progress, cache, scheduler)
    else:
        controls = checked_controls(case, controls)
    limits = thresholds(null_scores(case, observed, predicted, controls, before))
    problem = MeansProblem(case, observed, predicted, estimate_discrepancy(case, controls))
    found = _conclude(problem, limits, before, noted, most, expected)
    return replace(found, not_judged=not_judged) if not_judged else found


def _conclude(
    problem: MeansProblem,
    limits: Array,
    prior: Prior,
    notes: Sequence[Reason | str],
    most: int,
    expected: float,
) -> Finding:
    """Compare the hypotheses' evidence and return the finding."""
    case, observed = problem.case, problem.observed
    parts = steps(case, observed.used)
    by_part = evaluate_beyond(problem, prior.off, list(parts)[:-1])
    evidence = by_part[-1]
    problem, effects = evidence.problem, evidence.problem.predicted.effects
    compared = compare(problem)
    table = {k: float(v) for k, v in evidence.by_effect().items()}
    over = {k: v - table[NONE] for k, v in table.items() if k != NONE}
    *fewer, everything = (
        Detection(float(evidence_of_something(part, prior)), float(limit))
        for part, limit in zip(by_part, limits, strict=True)
    )
    detection = replace(everything, parts=dict(zip(parts.values(), fewer, strict=False)))
    detected = detection.verdict
    probabilities = of_one = posterior(table, prior)
    families = of_one_family = by_family(of_one, effects)
    if most == 1:
        sets = single_posterior(evidence, of_one)
    else:
        sets = posterior_of_sets(compared, prior, expected=expected, most=most)
        probabilities, families = sets.effects(), sets.families(effects)
    weak = (of_program(families) if case.program else None) or too_weak(probabilities, families)
    found = Finding(
        case=case,
        verdict=NONE,
        family=None,
        probabilities=probabilities,
        families=families,
        detection=detection,
        reasons=(),
        notes=(*_off_levels(problem), *notes, observed.origin, *_notes(case)),
        effects=effects,
        candidates=(),
        sets=sets.sets,
        evidence=dict(sorted(over.items(), key=lambda kv: -kv[1])),
        likely=[(applied_effects(problem.predicted, rows), p) for rows, p in sets.likely],
        alpha=averaged_alpha(compared, sets.likely),
        prior=prior,
        residuals=problem.standardized_residuals(),
        modelled=tuple(
            values_of_features(features, c.measured.centre_frequencies, c.measured.values)
            if c.simulated is None
            else c.simulated.simulated
            for c, features in zip(case.configurations, problem.predicted.features[0], strict=True)
        ),
        discrepancy=problem.discrepancy,
    )
    rivals = credible_set(of_one)
    if most == 1 or detected is not None:
        found = _of_single(found, evidence, of_one, of_one_family, detected, weak)
        rivals = found.names
    elif weak is not None:
        found = _of_single(found, evidence, of_one, of_one_family, "hint")
        found = replace(found, reasons=(weak, *found.reasons))
    else:
        found = _of_sets(found, evidence, sets)
    no_step = weak is not None and found.verdict == "hint"
    return replace(
        found,
        size=found.candidates[0].extent if found.candidates else None,
        advice=None if no_step else next_measurement(evidence, rivals),
        mistake=next((r for r in found.reasons if r.code in (LEADING, MISTAKE)), None),
    )


LIKELY = 0.5
"""Probability from which an error that all coefficients have in common is reported in addition to an
effect."""
TWO = 0.98
"""Probability of two or more effects from which more than one group is identified. An absorber hides
the wall behind it and makes the field less even, which no equation contains; a single effect therefore
leaves deviations that a second one seems to explain. Chosen on simulated rooms
(benchmarks/studies/means)."""


def _of_single(
    found: Finding,
    evidence: MeansEvidence,
    probabilities: Mapping[str, float],
    families: Mapping[str, float],
    detected: str | None,
    weak: Reason | None = None,
) -> Finding:
    """Return what is identified where one effect is missing at most, as `conclude` takes it."""
    best = next(k for k in probabilities if k != NONE)
    rough = [name for name, effect in found.effects.items() if not effect.alone]
    fits, reasons = dict[str, Candidate](), tuple[Reason, ...]()
    if best != UNKNOWN and detected != NONE:
        fits[best] = fit(evidence, best, precise=True)
        reasons = _doubts(evidence, fits[best])
    claim = conclude(detected, probabilities, families, rough, reasons, weak)
    if claim.verdict == NONE:
        return replace(found, **vars(claim))
    names = claim.named or credible_set(probabilities)
    for name in names:
        if name not in (best, UNKNOWN):
            fits[name] = fit(evidence, name, precise=False)
    sure = claim.family is not None and claim.verdict in ("named", "family")
    return replace(
        found,
        **vars(claim),
        named_families=(str(claim.family),) if sure else (),
        members=(best,) if best in fits else (),
        candidates=_candidates(found, names, fits),
    )


def _of_sets(found: Finding, evidence: MeansEvidence, posterior: SetPosterior) -> Finding:
    """Return what is identified of sets of effects; a doubt against an effect leaves nothing of it."""
    probabilities, effects = found.probabilities, found.effects
    if probabilities.get(UNKNOWN, 0.0) >= CLAIMED:
        only = _candidates(found, (UNKNOWN,), {})
        return replace(found, verdict="unknown", candidates=only)
    several = next((s for s in found.family_sets if len(s) > 1 and UNKNOWN not in s), ())
    together = several if sum(found.numbers[2:]) >= TWO else ()
    best, predicted = posterior.best(effects, together), evidence.problem.predicted
    model = dict(zip(best, applied_effects(predicted, posterior.rows[best]), strict=True))
    fits, reasons = dict[str, Candidate](), dict[str, tuple[Reason, ...]]()
    # The others' sizes enter each fit, so the first is fitted again.
    for name in (*best, best[0]) if len(best) > 1 else best:
        beside = evidence.beside(name, [model[n] for n in best if n != name])
        fits[name] = fit(beside, name, precise=True)
        reasons[name] = _doubts(beside, fits[name])
        model[name] = fits[name].applied(effects[name])
    every = [doubt for n in best for doubt in reasons[n]]
    sound = [n for n in best if all(LEAVES[doubt.code] != "hint" for doubt in reasons[n])]
    if len(sound) < len(best):
        together = ()
    sound.sort(key=lambda n: -found.families[family_of(n, effects)])
    if not together:
        sound = sound[:1]
    named = [
        n for n in sound if probabilities[n] >= CLAIMED and effects[n].alone and not reasons[n]
    ]
    if probabilities.get(COEFFICIENTS, 0.0) >= CLAIMED:
        named.append(COEFFICIENTS)
    # Of each the narrowest of its family and the wide one around it that is probable enough.
    both = [(narrow, wide(narrow)) for narrow in (family_of(n, effects) for n in sound)]
    probable = (narrowest_family({f: found.families[f] for f in of}, CLAIMED) for of in both)
    claimed = tuple(dict.fromkeys(filter(None, probable)))
    stand_ins = posterior.stand_ins(best)
    others = dict.fromkeys(n for names in stand_ins.values() for n in names)
    return replace(
        found,
        verdict="named" if named else "family" if claimed or together else "ambiguous",
        family=claimed[0] if claimed else None,
        named=tuple(named),
        named_families=claimed,
        named_set=together,
        members=best,
        candidates=_candidates(found, (*best, *(n for n in others if n not in best)), fits),
        stand_ins=stand_ins,
        reasons=tuple(doubt for i, doubt in enumerate(every) if doubt not in every[:i]),
    )


def _candidates(
    found: Finding, names: Names, fits: Mapping[str, Candidate]
) -> tuple[Candidate, ...]:
    """Return candidates with their probabilities; of one without a fit nothing else is known."""
    every = [
        fits.get(n) or Candidate(effect=n, family=family_of(n, found.effects), probability=0.0)
        for n in names
    ]
    return tuple(replace(c, probability=found.probabilities.get(c.effect, 0.0)) for c in every)


def fit(evidence: MeansEvidence, name: str, *, precise: bool) -> Candidate:
    """Return the parameters and size of an effect, or of the error in common; its probability is 0.

    If ``precise``, the parameters are refined between the values that were tried.
    """
    problem, case = evidence.problem, evidence.problem.case
    found = Candidate(
        effect=name, family=family_of(name, problem.predicted.effects), probability=0.0
    )
    probability = 1.0
    if name != COEFFICIENTS:
        effect = problem.predicted.effects[name]
        likely, size = _estimate_size(evidence, name, precise=precise)
        material = effect.material(likely, case.room)
        place = "" if material is None else f'"{material}"'
        found = replace(found, parameters=likely, place=place)
        if size is not None:
            parameters = {**likely, effect.size: size.mean}
            found = replace(found, parameters=parameters, **size.fields)
            if "absorption" in effect.family:
                # What is added in the first configuration, over the mean, of the size and its ends.
                base = state(case, case.configurations[0])
                sets = [{**likely, effect.size: s} for s in (size.mean, size.low, size.high)]
                bare, *others = rates([base, *changed_states(effect, base, sets)])
                found = replace(found, absorption=(np.array(others) - bare) / bare.mean())
        probability = float(evidence.off_given(name))
    if probability < LIKELY:
        return found
    alone, row = _with_candidate(problem, found)
    by_time = by_direction(directions(case), alone.predicted.jacobian[row][None])
    changes = -alone.by_log_time(alone.predicted, slice(row, row + 1), by_time)[0]
    covariance = np.add(*alone.covariance_of(row))
    off = off_together(case, changes, alone.residual(row), covariance, probability)
    return replace(found, coefficients=off)


def _with_candidate(problem: MeansProblem, candidate: Candidate) -> tuple[MeansProblem, int]:
    """Return the problem with "none" and a candidate as its hypotheses, and the candidate's row."""
    effect = problem.predicted.effects.get(candidate.effect)
    tried, grids = ([], None) if effect is None else ([effect], [[candidate.parameters]])
    return replace(problem, predicted=predict_hypotheses(problem.case, tried, grids)), len(tried)


AT_END = 2.0
"""ln Bayes factor of the best size over the last size that is tried, below which the size has no limit
there."""


def _estimate_size(
    evidence: MeansEvidence, name: str, *, precise: bool = True
) -> tuple[Parameters, Size | None]:
    """Return the most probable parameters of an effect, and its size; None if it has none.

    If ``precise``, a search improves the parameters, and the size is evaluated in fine steps.
    """
    problem = evidence.problem
    predicted, base = problem.predicted, state(problem.case, problem.case.configurations[0])
    effect, rows = predicted.effects[name], predicted.rows[name]
    likelihood = evidence.by_hypothesis()[rows]
    grid = predicted.grid(name)

    def log_density(thetas: Sequence[Parameters]) -> Array:
        return np.log(np.maximum(effect.density(columns(thetas), base), _LEAST_DENSITY))

    def evaluated(thetas: Sequence[Parameters]) -> Array:
        alone = replace(problem, predicted=predict_hypotheses(problem.case, [effect], [thetas]))
        return evaluate(alone, evidence.prior_off)[-1].by_hypothesis()[1:] + log_density(thetas)

    best = grid[int(np.argmax(likelihood + log_density(grid)))]
    if precise:
        best = _searched(grid, best, effect.discrete, evaluated)
    if not np.isfinite(effect.neutral):
        return best, None
    weights = np.exp(predicted.log_weights[rows] + likelihood - likelihood.max())
    weights = weights / weights.sum()
    others = [name for name in grid[0] if name != effect.size]
    kinds = [tuple(theta[name] for name in others) for theta in grid]
    most = [*summed(zip(kinds, weights.tolist(), strict=True))][:3]
    likely = list(dict.fromkeys([tuple(best[name] for name in others), *most]))
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

    def at(x: Array, kinds: Sequence[tuple[float, ...]]) -> Array:
        of_kinds = [dict(zip(others, kind, strict=True)) for kind in kinds]
        return evaluated([{**k, effect.size: s} for k in of_kinds for s in size_of(x).tolist()])

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
    if (spread := effect.size_error) > 0:
        kernel = np.exp(-0.5 * (np.subtract.outer(fine, fine) / spread) ** 2)
        # Probability that would leave the grid stays at its ends.
        by_size = kernel / kernel.sum(0) @ by_size
    cumulated = np.cumsum(by_size) - 0.5 * by_size
    interval = [float(np.interp(q, cumulated, size_of(fine))) for q in (0.05, 0.95)]
    unit = effect.unit_in(best, evidence.problem.case.room)
    return best, Size(float(by_size @ size_of(fine)), interval[0], interval[1], unit, end)


_LEAST_DENSITY = 1e-30  # density below which parameters are impossible


def _searched(
    grid: Sequence[Parameters],
    start: Parameters,
    discrete: Sequence[str],
    evaluated: Callable[[Sequence[Parameters]], Array],
) -> Parameters:
    """Improve the grid's best parameters within its range by ever finer lattices."""
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


def _doubts(evidence: MeansEvidence, best: Candidate) -> tuple[Reason, ...]:
    """Return the reasons not to identify the fitted effect ``best``; `LEAVES` has what remains."""
    problem, name = evidence.problem, best.effect
    alone, row = _with_candidate(problem, best)
    gap = gap_check(alone, best)
    found = [_gross(evidence, name, gap)]
    times, chance = alone.goodness_of_fit(row, _scale(best))
    if chance < SURPRISING:
        found.append(Reason("not explained", {"effect": name, "times": times}))
    found.append(gap_against(name, gap))
    if row:
        effect, size = problem.predicted.effects[name], best.extent
        if size is not None and size.end:
            other = "larger" if size.end == "least" else "smaller"
            found.append(Reason("size unbounded", {"effect": name, "size": size, "other": other}))
        share = best.parameters[effect.size] / problem.case.room.total_area
        if effect.takes_wall and share > (most := effect.largest_share):
            found.append(Reason("too large", {"effect": name, "share": share, "most": most}))
    found.append(_decided_below_schroeder(evidence, name))
    return tuple(doubt for doubt in found if doubt is not None)


def _scale(candidate: Candidate) -> float:
    """Return the factor on errors that coefficients have in common, with a candidate in the model."""
    return 1.0 if candidate.coefficients is None else SCALES[0][0]


GROSS = np.log(1.8)
"""Change of ln T beyond which wrong input is suspected first. A box that is entered twice as large has
twice the T, or a little less with air."""
MISTAKE_SIGMA = 1.5
"""Standard deviation of ln T from wrong input: factors of 2 to 20 are usual."""
SHOWN = 4.6
"""ln Bayes factor (odds of 100 to one) from which parameters other than T show an effect."""
SURPRISING = 1e-3
"""Probability of the residuals below which the best effect does not explain them."""


def gap_against(name: str, gap: GapCheck) -> Reason | None:
    """Return why an effect is doubted by deviations that grow or contradict it, or None."""
    ends = {"effect": name, "before": gap.before, "after": gap.after}
    if gap.growth >= CLAIMED:
        return Reason("gap grows", ends)
    if gap.predictive < CONTRADICTED:
        return Reason("contradicted", {"effect": name, "nats": gap.predictive})
    if gap.growth >= 0.5:
        return Reason("gap may grow", {**ends, "little": LITTLE, "probability": gap.growth})
    return None


def _schroeder_limits(case: Case) -> list[float]:
    """Return Schroeder's frequency in Hz of each configuration."""
    times = [c.measured.reverberation_time for c in case.configurations]
    middle = [mid_frequency_time(t, case.room.centre_frequencies) for t in times]
    return [float(schroeder_frequency(np.array(t), case.room.volume)) for t in middle]


def _decided_below_schroeder(evidence: MeansEvidence, name: str) -> Reason | None:
    """Return a doubt if an effect is identified only by bands below Schroeder's frequency, or None."""
    problem, nats = evidence.problem, evidence.nats(name)
    case, observed = problem.case, problem.observed
    frequencies = case.room.centre_frequencies
    low = frequencies < np.array(_schroeder_limits(case))[:, None]
    used = np.logical_and(observed.used, np.logical_not(low)[:, None, :])
    if not low.any() or (used == observed.used).all() or not used.any():
        return None
    effects = [e for n, e in problem.predicted.effects.items() if n == name]
    predicted = predict_hypotheses(case, effects)
    above = replace(problem, observed=observed.only(used), predicted=predicted)
    rest = evaluate(above, evidence.prior_off)[-1].nats(name)
    if rest >= 0.5 * nats or rest >= DISTINCT_NATS:
        return None
    places = bands.labels(frequencies[low.any(0)])
    values = {"effect": name, "bands": places, "nats": nats, "without": rest}
    return Reason("below Schroeder", values)


def _gross(evidence: MeansEvidence, name: str, gap: GapCheck) -> Reason | None:
    """Return a doubt if the measured T is about twice or half the model's T, or None.

    Most mistakes of this size are wrong input, which changes T by one factor in all bands. The
    group stays identified if the effect explains the data much better than that. There is no doubt
    if it explains them better than wrong units of T and the ``gap`` shows it, too.
    """
    problem = evidence.problem
    off = problem.observed.features - problem.predicted.features[0]
    change = float(np.nanmedian(off[:, 0]))
    if abs(change) <= GROSS:
        return None
    c, f, b = problem.places
    alpha, other = problem.covariance_of(0)
    factors = np.array([f == 0, problem.predicted.slopes[0, c, f, b]], dtype=float)
    more = MISTAKE_SIGMA**2 * np.einsum("di,dj->dij", factors, factors)
    of_units, of_room = log_density(problem.residual(0), alpha + other + more).tolist()
    best = float(evidence.by_effect()[name])
    if gap.predictive > SHOWN and best - of_units > DISTINCT_NATS:
        return None
    stands = best - max(of_units, of_room) > DISTINCT_NATS
    return Reason(LEADING if stands else MISTAKE, {"factor": float(np.exp(change))})


LITTLE = 0.1
"""Change of the mean deviation in JND that counts as little, whatever its uncertainty."""
CONTRADICTED = -3.0
"""ln Bayes factor below which the parameters that coefficients cannot fit contradict the effect."""
_DRAWS = 64


@dataclass(frozen=True)
class GapCheck:
    """Hold the deviations that no coefficients can remove, with and without an effect in the model."""

    before: float  # mean absolute deviation in JND without the effect; NaN if only T20 was measured
    after: float
    uncertainty: float  # standard deviation of after - before
    predictive: float  # ln Bayes factor for the effect by these values alone, given T20

    @property
    def growth(self) -> float:
        """Probability that the mean deviation grows by more than 0.1 JND."""
        grown = self.after - self.before - LITTLE
        if not self.uncertainty > 0:
            return float(grown > 0)
        return float(ndtr(grown / self.uncertainty))


def gap_check(
    problem: MeansProblem,
    candidate: Candidate,
    held: NDArray[np.bool_] | None = None,
) -> GapCheck:
    """Return the deviations that no coefficients can remove, without and with a candidate.

    ``held`` (n_used,) are the values that count, by default all but T20 of the first configuration.
    """
    problem, last = _with_candidate(problem, candidate)
    c, f, _ = problem.places
    fitted = (c == 0) & (f == 0)
    held = ~fitted if held is None else held
    if not held.any():
        return GapCheck(np.nan, np.nan, np.nan, 0.0)
    jnd = np.array([observable(name).jnd for name in FEATURES])[f[held]]
    kept = np.flatnonzero(~held)
    gaps, moves, density = [], [], []
    for row, factor, exact in ((0, 1.0, True), (last, _scale(candidate), False)):
        alpha, other = problem.covariance_of(row, factor)
        whole = alpha + other
        against = alpha if exact else whole
        gain = np.linalg.solve(
            _plus(against[np.ix_(fitted, fitted)]), alpha[np.ix_(fitted, held)]
        ).T
        residual = problem.residual(row)
        gaps.append((residual[held] - gain @ residual[fitted]) / jnd)
        moves.append(np.concatenate([-gain, np.eye(int(held.sum()))], axis=1) / jnd[:, None])
        of_all, of_kept = (
            float(log_density(residual[i], whole[None][:, i][:, :, i])[0])
            for i in (slice(None), kept)
        )
        density.append(of_all - of_kept)
        noise = other
    order = np.concatenate([np.flatnonzero(fitted), np.flatnonzero(held)])
    root = np.linalg.cholesky(_plus(noise[np.ix_(order, order)]))
    drawn = np.random.default_rng(0).standard_normal((_DRAWS, len(order))) @ root.T
    before, after = (np.abs(g + drawn @ m.T).mean(1) for g, m in zip(gaps, moves, strict=True))
    return GapCheck(
        float(np.abs(gaps[0]).mean()),
        float(np.abs(gaps[1]).mean()),
        float(np.std(after - before)),
        float(density[1] - density[0]),
    )


def _plus(covariance: Array) -> Array:
    """Return the matrix with a trace on its diagonal, so that it can be inverted where sigma is 0."""
    size = len(covariance)
    return np.asarray(covariance + 1e-9 * (1.0 + np.trace(covariance) / size) * np.eye(size))


_OFF_LEVEL = 3.0
"""Least mean in dB over the bands by which a level is said to be off; its spread is a third at most."""


def _off_levels(problem: MeansProblem) -> list[Reason]:
    """Return notes on levels that are off alike in all bands, from what T gives and from the input."""
    level, name = FEATURES.index(LEVELS[-1]), parameter_label(LEVELS[-1])
    off = problem.observed.features - problem.predicted.features[0]
    beside = off[:, level] - problem.predicted.slopes[0, :, level] * off[:, 0]
    out = []
    for c, configuration in enumerate(problem.case.configurations):
        known = np.isfinite(beside[c])
        if known.sum() < 2:
            continue
        mean, direct = beside[c, known].mean(), off[c, level, known].mean()
        least = max(_OFF_LEVEL, 3 * beside[c, known].std())
        if abs(mean) >= least and np.sign(mean) * direct >= _OFF_LEVEL:
            side = "above" if mean > 0 else "below"
            values = {"configuration": configuration.name, "parameter": name, "side": side}
            out.append(Reason("level off", {**values, "by": float(abs(mean))}))
    return out


def _notes(case: Case) -> list[Reason]:
    """Return reasons to doubt the result, whatever it is."""
    out, frequencies = list[Reason](), case.room.centre_frequencies
    for c, limit in zip(case.configurations, _schroeder_limits(case), strict=True):
        where = {"configuration": c.name}
        if (low := frequencies < limit).any():
            values = {**where, "bands": bands.labels(frequencies[low]), "limit": limit}
            out.append(Reason("Schroeder", values))
        if unused := [parameter_label(p) for p in c.measured.values if p not in FEATURES]:
            known = [parameter_label(p) for p in FEATURES]
            out.append(Reason("not used", {**where, "parameters": unused, "known": known}))
        if {"t20", "t30"} <= set(c.measured.values):
            curved = 100 * (c.measured.mean("t30") / c.measured.mean("t20") - 1)
            places = [
                f"{bands.label(f)} ({v:+.0f} %)"
                for f, v in zip(frequencies, curved, strict=True)
                if abs(v) > _CURVED
            ]
            if places:
                out.append(Reason("curved", {**where, "bands": places, "most": _CURVED}))
        place = f'"{c.name}": ' if len(case.configurations) > 1 else ""
        out += [Reason("run lacks", {**where, "said": place + said}) for said in c.left_out]
        if c.simulated is None:
            continue
        # Where the equation's T differs from the run's by more than 1 JND, the most bands first.
        ratio = np.expm1(-offset_of(case, c)[FEATURES.index("t20")])
        with np.errstate(invalid="ignore"):
            off = {"shorter": ratio < -TARGET.jnd, "longer": ratio > TARGET.jnd}
        for side, there in sorted(off.items(), key=lambda of: -of[1].sum()):
            if there.any():
                values = {
                    "equation": mean_equation(case.equation).name,
                    "by": np.abs(100 * ratio[there]),
                    "side": side,
                    "bands": (frequencies, there, np.isfinite(ratio)),
                }
                out.append(Reason(EQUATION_OFF, values))
    return [*out, *([Reason("no air")] if case.room.air is None else [])]


_CURVED = 10.0  # curvature in percent above which a decay is not straight (ISO 3382-2, Annex B)
