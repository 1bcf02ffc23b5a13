"""Find several effects at once, and say of each whether it is there at all."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

from rtcal.errors import DataError
from rtcal.finder.case import AppliedEffect, Case
from rtcal.finder.claim import CLAIMED, family_of, narrowest_family
from rtcal.finder.effects import Effect
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.evidence import evaluate_beyond
from rtcal.finder.means.features import Observed, observe
from rtcal.finder.means.finding import Finding
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.search import effects_to_try, find
from rtcal.finder.means.set_alpha import averaged_alpha
from rtcal.finder.means.set_posterior import MOST, Names, SetPosterior, set_posterior
from rtcal.finder.means.sets import compare
from rtcal.finder.means.several_finding import Member, SeveralFinding, applied_with
from rtcal.finder.means.verdict import Fit, doubts, fit
from rtcal.finder.prior import COEFFICIENTS, EXPECTED, NONE, UNKNOWN
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.progress import TaskProgress
from rtcal.support.threads import single_threaded_blas

LEAST_EXPECTED, MOST_EXPECTED = 0.01, 10.0
"""Numbers of effects that may be expected: beyond, nothing measured would change the answer."""
TWO = 0.98
"""Probability of two or more effects from which more than one family is claimed. An absorber hides the
wall behind it and makes the field less even, and a formula knows neither. So one effect of the room
leaves what a second one explains. Chosen on development rooms of the first hidden
world (docs/discrepancy_study.md)."""


@single_threaded_blas()
@checked
def find_several(
    case: Case,
    effects: Sequence[Effect] | None = None,
    expected: float = EXPECTED,
    most: int = MOST,
    seed: int = 0,
    *,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    prior: Mapping[str, float] | None = None,
    engines: Sequence[str] = ("path tracing", "network"),
    controls: Sequence[ControlRooms] | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
) -> SeveralFinding:
    """Find what the case's model lacks, where it may lack several effects at once.

    Parameters
    ----------
    case : Case
    effects : sequence of Effect, optional
        The effects to try; the whole library if not given.
    expected : float
        Expected number of effects: the mean of a Poisson distribution, above 0.
    most : int
        Largest number of effects in a set, from 1 to 3.
    seed : int
        Of the control rooms and of the bootstrap.
    without, only, prior, engines, controls, cache, progress
        As `rtcal.finder.find` takes them, but for prior odds of "none": ``expected`` takes their
        place.

    Returns
    -------
    SeveralFinding

    Raises
    ------
    DataError
        If ``expected`` or ``most`` is out of its range, if ``prior`` has odds of "none", and as
        `rtcal.finder.find` does.

    Examples
    --------
    >>> import rtcal as rt
    >>> case, truth = rt.datasets.hidden_room()
    >>> print(rt.finder.find_several(case))  # doctest: +SKIP
    """
    expected = checks.positive("expected", expected)
    if not LEAST_EXPECTED <= expected <= MOST_EXPECTED:
        raise DataError(
            f"expected = {expected:g} effects is not from {LEAST_EXPECTED:g} to {MOST_EXPECTED:g}"
        )
    most = checks.whole("most", most, 1)
    if most > MOST:
        raise DataError(f"most = {most} is not from 1 to {MOST}")
    if prior is not None and NONE in prior:
        raise DataError(
            'prior has odds of "none": of several effects, expected says how many there are'
        )
    tried, _ = effects_to_try(effects, without, only)
    if len(tried) < 2:
        raise DataError(
            f"{len(tried)} effect is tried, and sets need at least two; use find for one"
        )
    single = find(
        case,
        effects,
        seed=seed,
        without=without,
        only=only,
        prior=prior,
        engines=engines,
        controls=controls,
        cache=cache,
        progress=progress,
    )
    observed, _ = observe(case)
    predicted, _ = evaluate_beyond(
        case,
        observed,
        predict_hypotheses(case, list(single.effects.values())),
        single.discrepancy,
        single.prior.off,
    )
    compared = compare(case, observed, predicted, single.discrepancy)
    posterior = set_posterior(compared, single.prior, expected=expected, most=most)
    probabilities = posterior.effects()
    families = posterior.families(predicted.effects)
    family_sets = posterior.by_families(predicted.effects)
    verdict, members = single.verdict, {}
    named: list[str] = []
    named_families: list[str] = []
    together: Names = ()
    if single.score > single.threshold and probabilities.get(UNKNOWN, 0.0) >= CLAIMED:
        verdict = "unknown"
    elif single.score > single.threshold:
        together = _together(family_sets, posterior.numbers())
        best = posterior.best(predicted.effects, together)
        members = _members(case, observed, single, posterior, best, predicted.parameters)
        if any(m.reasons for m in members.values()):
            together = ()
        sound = [n for n, m in members.items() if not m.reasons]
        sound.sort(key=lambda n: -families[family_of(n, predicted.effects)])
        named, named_families = _claims(
            sound if together else sound[:1], probabilities, families, predicted.effects
        )
        families_claimed = named_families or together
        verdict = "named" if named else "family" if families_claimed else "ambiguous"
    return SeveralFinding(
        single=single,
        expected=expected,
        verdict=verdict,
        named=tuple(named),
        named_families=tuple(named_families),
        named_set=together,
        probabilities=probabilities,
        families=families,
        numbers=posterior.numbers(),
        sets=posterior.sets,
        family_sets=family_sets,
        members=members,
        alpha=averaged_alpha(compared, posterior.likely),
        likely=[
            (
                tuple(
                    AppliedEffect.of(predicted.effects[predicted.names[i]], predicted.parameters[i])
                    for i in rows
                ),
                p,
            )
            for rows, p in posterior.likely
        ],
    )


def _members(
    case: Case,
    observed: Observed,
    single: Finding,
    posterior: SetPosterior,
    best: Names,
    parameters: Sequence[Mapping[str, float]],
) -> dict[str, Member]:
    """Return the effects of a set, each with its size alone and with the others."""
    rows = posterior.rows[best]
    stand_ins = posterior.stand_ins(best)
    model = {
        name: AppliedEffect.of(single.effects[name], parameters[i])
        for name, i in zip(best, rows, strict=True)
    }
    alone = {name: _fitted(case, observed, single, name)[0] for name in best}
    together: dict[str, Fit] = {}
    reasons: dict[str, tuple[str, ...]] = {}
    # The others' sizes enter each fit, so the first is fitted again.
    for name in (*best, best[0]) if len(best) > 1 else best:
        others = [model[n] for n in best if n != name]
        together[name], reasons[name] = _fitted(
            replace(case, applied=(*case.applied, *others)), observed, single, name
        )
        model[name] = applied_with(single.effects[name], together[name])
    return {n: Member(alone[n], together[n], stand_ins[n], reasons[n]) for n in best}


def _fitted(
    case: Case, observed: Observed, single: Finding, name: str
) -> tuple[Fit, tuple[str, ...]]:
    """Return one effect's fit in a case whose model has the others, and the doubts about it."""
    predicted, evidence = evaluate_beyond(
        case,
        observed,
        predict_hypotheses(case, [single.effects[name]]),
        single.discrepancy,
        single.prior.off,
    )
    table = evidence.by_effect()
    nats = float(table[name] - table[NONE])
    fitted = fit(case, observed, predicted, single.discrepancy, evidence, name, precise=True)
    found = doubts(case, observed, predicted, single.discrepancy, evidence, fitted, nats)
    return fitted, tuple(doubt.words for doubt in found)


def _together(family_sets: Mapping[Names, float], numbers: Sequence[float]) -> Names:
    """Return the most probable families of two or more effects; () where these are not probable."""
    several = next((s for s in family_sets if len(s) > 1 and UNKNOWN not in s), ())
    return several if several and sum(numbers[2:]) >= TWO else ()


def _claims(
    sound: Sequence[str],
    probabilities: Mapping[str, float],
    families: Mapping[str, float],
    effects: Mapping[str, Effect],
) -> tuple[list[str], list[str]]:
    """Return which of the effects are probable enough to be claimed, and which of their families."""
    named = [n for n in sound if probabilities[n] >= CLAIMED and effects[n].alone]
    if probabilities.get(COEFFICIENTS, 0.0) >= CLAIMED:
        named.append(COEFFICIENTS)
    claimed = []
    for name in sound:
        family = family_of(name, effects)
        wide = family.split(",")[0]
        narrow = narrowest_family({f: families[f] for f in (family, wide)}, CLAIMED)
        if narrow is not None and narrow not in claimed:
            claimed.append(narrow)
    return named, claimed
