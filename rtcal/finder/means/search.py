"""Find what a model lacks: compare the evidence of every effect, decide, estimate the effect's size."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables import parameter_label
from rtcal.finder.case import Case
from rtcal.finder.claim import (
    LEADING,
    MISTAKE,
    Candidate,
    Detection,
    Reason,
    by_family,
    credible_set,
    family_of,
    posterior,
    too_weak,
)
from rtcal.finder.effects import Effect, checked_effects, judged_effects
from rtcal.finder.evidence import (
    EXPECTED,
    NONE,
    Prior,
    checked_odds,
    chosen_effects,
    prior_of,
)
from rtcal.finder.finding import Finding
from rtcal.finder.means.engines import (
    ControlRooms,
    checked_controls,
    control_rooms,
)
from rtcal.finder.means.problem import (
    LEVELS,
    MOST,
    MeansProblem,
    applied_effects,
    averaged_alpha,
    compare,
    estimate_discrepancy,
    evaluate_beyond,
    null_scores,
    observe,
    posterior_of_sets,
    predict_hypotheses,
    single_posterior,
    steps,
    thresholds,
)
from rtcal.finder.means.problem import score as evidence_of_something
from rtcal.finder.means.verdict import (
    Fit,
    next_measurement,
    of_sets,
    of_single,
    schroeder_limit,
)
from rtcal.finder.model import FEATURES
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
    expected: float | None = None,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    prior: Mapping[str, float] | None = None,
    controls: Sequence[ControlRooms] | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
) -> Finding:
    """Find what the case's model lacks.

    Parameters
    ----------
    case : Case
    most : int
        Largest number of effects that may be missing at once, from 1 to 3.
    expected : float, optional
        Expected number of effects where ``most`` is above 1: the mean of a Poisson distribution, 0.7
        unless given.
    prior : mapping of str to float, optional
        Prior odds of effects against the others, in place of their own: ``{"opening": 2.0}``. Those
        of "none" are against anything missing, those of "coefficients" against coefficients as stated.
        Where ``most`` is above 1, ``expected`` takes the place of those of "none".
    effects, without, only, controls, cache, progress
        As `rtcal.find` takes them; ``without`` may have "coefficients" and "unknown".

    Raises
    ------
    DataError
        For control rooms of one engine, or of another case; if the room was
        calibrated on one of the case's T already; for an effect that breaks a rule, which the message
        names; if ``most`` or ``expected`` is out of its range.

    Examples
    --------
    >>> import rtcal as rt
    >>> case, truth = rt.datasets.hidden_room()
    >>> print(rt.find(case, most=3))  # doctest: +SKIP
    """
    checks.instance("case", case, Case).require_fresh()
    every = checked_effects(effects)
    effects, left_out = chosen_effects(every, without, only)
    odds = checked_odds(effects, prior)
    effects, not_judged = judged_effects(effects, case.directions_known)
    number = _checked_number(most, expected, effects, prior)
    observed, dropped = observe(case)
    noted: list[Reason | str] = [*dropped]
    if len(without) or len(only) or prior:
        noted.append(Reason("chosen"))
    before = prior_of(case.room, effects, odds, left_out)
    predicted = predict_hypotheses(case, effects)
    if controls is None:
        controls = control_rooms(case, 0, progress, cache)
    else:
        controls = checked_controls(case, controls)
    limits = thresholds(null_scores(case, observed, predicted, controls, before))
    problem = MeansProblem(case, observed, predicted, estimate_discrepancy(case, controls))
    found = _conclude(problem, limits, before, noted, most, number)
    return replace(found, not_judged=not_judged) if not_judged else found


LEAST_EXPECTED, MOST_EXPECTED = 0.01, 10.0
"""Numbers of effects that may be expected: beyond, nothing measured would change the answer."""


def _checked_number(
    most: int,
    expected: float | None,
    effects: Sequence[Effect],
    prior: Mapping[str, float] | None,
) -> float:
    """Return the expected number of effects; DataError where it does not go with the largest."""
    if checks.whole("most", most, 1) > MOST:
        raise DataError(f"most = {most} is not from 1 to {MOST}")
    if most == 1:
        if expected is not None:
            raise DataError(f"expected = {expected} is of more than one effect: state most, 2 or 3")
        return EXPECTED
    number = EXPECTED if expected is None else checks.positive("expected", expected)
    if not LEAST_EXPECTED <= number <= MOST_EXPECTED:
        raise DataError(
            f"expected = {number:g} effects is not from {LEAST_EXPECTED:g} to {MOST_EXPECTED:g}"
        )
    if prior is not None and NONE in prior:
        raise DataError(
            'prior has odds of "none": of more than one effect, expected says how many there are'
        )
    if len(effects) < 2:
        raise DataError(f"most = {most}, and {len(effects)} effect is tried: most is 1 then")
    return number


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
    weak = too_weak(probabilities, families)
    if most == 1 or detected is not None:
        verdict = of_single(evidence, of_one, of_one_family, detected, weak)
    elif weak is not None:
        verdict = of_single(evidence, of_one, of_one_family, "hint")
        verdict = replace(verdict, reasons=(weak, *verdict.reasons))
    else:
        verdict = of_sets(evidence, sets, probabilities, families)
    fits = verdict.fits
    told_apart = verdict.names if most == 1 or detected is not None else credible_set(of_one)
    no_step = weak is not None and verdict.verdict == "hint"
    return Finding(
        case=case,
        **{k: v for k, v in vars(verdict).items() if k != "names"},
        candidates=tuple(
            _candidate(case, name, verdict.fits.get(name), probabilities, effects)
            for name in verdict.names
        ),
        size=fits[verdict.names[0]].size if verdict.names and verdict.names[0] in fits else None,
        evidence={k: over[k] for k in sorted(over, key=lambda k: -over[k])},
        probabilities=probabilities,
        families=families,
        sets=sets.sets,
        likely=[(applied_effects(problem.predicted, rows), p) for rows, p in sets.likely],
        alpha=averaged_alpha(compared, sets.likely),
        prior=prior,
        detection=detection,
        advice=None if no_step else next_measurement(evidence, told_apart),
        mistake=next((r for r in verdict.reasons if r.code in (LEADING, MISTAKE)), None),
        residuals=problem.standardized_residuals(),
        notes=(*_off_levels(problem), *notes, observed.origin, *_notes(case)),
        discrepancy=problem.discrepancy,
        effects=effects,
    )


def _candidate(
    case: Case,
    name: str,
    fit: Fit | None,
    probabilities: Mapping[str, float],
    effects: Mapping[str, Effect],
) -> Candidate:
    found = Candidate(
        effect=name, family=family_of(name, effects), probability=probabilities.get(name, 0.0)
    )
    if fit is None:
        return found
    found = replace(found, parameters=fit.parameters)
    if name in effects:
        found = replace(found, called=effects[name].title(fit.parameters, case.room))
    return found if fit.size is None else replace(found, **fit.size.fields)


_OFF_LEVEL = 3.0
"""Least mean in dB over the bands by which a level is said to be off; its spread is a third at most."""


def _off_levels(problem: MeansProblem) -> list[Reason]:
    """Return notes of levels that are off alike in all bands, beside what T gives of the stated room.

    They are off from the stated room itself, too: noise in the decay lengthens T and leaves the level.
    """
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
    for c in case.configurations:
        where = {"configuration": c.name}
        limit = schroeder_limit(case, c.measured.reverberation_time)
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
    return [*out, *([Reason("no air")] if case.room.air is None else [])]


_CURVED = 10.0
"""Curvature in percent above which a decay is not straight (ISO 3382-2, Annex B)."""
