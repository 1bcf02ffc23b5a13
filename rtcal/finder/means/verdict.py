"""The verdict: what is claimed of sets of effects, and the checks that a claim must pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rtcal.finder import coefficients
from rtcal.finder.case import AppliedEffect
from rtcal.finder.claim import (
    CLAIMED,
    Names,
    by_family_sets,
    claim,
    credible_set,
    family_of,
    narrowest_family,
    numbers_of,
)
from rtcal.finder.coefficients import SCALES, OffTogether
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.finding import AbsorptionChange, Size
from rtcal.finder.means.doubts import (
    Doubt,
    decided_below_schroeder,
    end_of_range,
    gap_against,
    gross,
    too_large,
    unexplained,
)
from rtcal.finder.means.gap import GapCheck, gap_check
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.likelihood import covariance_of, goodness_of_fit, spreading
from rtcal.finder.means.searched import Searched
from rtcal.finder.means.set_posterior import SetPosterior
from rtcal.finder.means.size import absorption_change, estimate_size
from rtcal.finder.prior import COEFFICIENTS, NONE, UNKNOWN

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
    """What is claimed; its fields are those of `rtcal.finder.MeansFinding`."""

    verdict: str
    family: str | None = None
    named: Names = ()
    named_families: Names = ()
    named_set: Names = ()
    members: Names = ()
    candidates: Names = ()
    fits: Mapping[str, Fit] = field(default_factory=dict)
    alone: Mapping[str, Fit] = field(default_factory=dict)
    stand_ins: Mapping[str, Names] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()


def of_single(
    searched: Searched,
    probabilities: Mapping[str, float],
    families: Mapping[str, float],
    detected: str | None,
) -> Verdict:
    """Return what is claimed where one effect is missing at most.

    ``detected`` is "none" or "hint" where the score does not exceed its threshold, else None.
    """
    effects = searched.predicted.effects
    best = next(k for k in probabilities if k != NONE)
    rough = [name for name, effect in effects.items() if not effect.alone]
    verdict, family = claim(detected, probabilities, families, rough)
    if verdict == "none":
        return Verdict(verdict=verdict, family=family)
    fits, found = dict[str, Fit](), tuple[Doubt, ...]()
    if best != UNKNOWN:
        fits[best] = fit(searched, best, precise=True)
        found = doubts(searched, fits[best])
        verdict = doubted(verdict, family, found)
    candidates = (best,) if verdict == "named" else credible_set(probabilities)
    for name in candidates:
        if name not in (best, UNKNOWN):
            fits[name] = fit(searched, name, precise=False)
    claimed = family is not None and verdict in ("named", "family")
    return Verdict(
        verdict=verdict,
        family=family,
        named=(best,) if verdict == "named" else (),
        named_families=(str(family),) if claimed else (),
        members=(best,) if best in fits else (),
        candidates=candidates,
        fits=fits,
        reasons=tuple(doubt.words for doubt in found),
    )


def of_sets(
    searched: Searched,
    posterior: SetPosterior,
    probabilities: Mapping[str, float],
    families: Mapping[str, float],
) -> Verdict:
    """Return what is claimed of sets of effects, where something is missing.

    A doubt about a size or the fit leaves the family claimed, any other doubt nothing of that effect.
    """
    if probabilities.get(UNKNOWN, 0.0) >= CLAIMED:
        return Verdict(verdict="unknown", candidates=(UNKNOWN,))
    effects = searched.predicted.effects
    together = _together(by_family_sets(posterior.sets, effects), numbers_of(posterior.sets))
    best = posterior.best(effects, together)
    fits, found = _members(searched, posterior, best)
    refuted = {n for n in best if any(doubt.of == "effect" for doubt in found[n])}
    if refuted:
        together = ()
    sound = sorted(
        (n for n in best if n not in refuted), key=lambda n: -families[family_of(n, effects)]
    )
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
        candidates=(*best, *(n for n in others if n not in best)),
        fits=fits,
        alone={n: fit(searched.beside(n), n, precise=True) for n in best} if len(best) > 1 else {},
        stand_ins=stand_ins,
        reasons=tuple(doubt.words for n in best for doubt in found[n]),
    )


def _members(
    searched: Searched, posterior: SetPosterior, best: Names
) -> tuple[dict[str, Fit], dict[str, tuple[Doubt, ...]]]:
    """Return the fit of each effect of a set with the others in the model, and the doubts about it."""
    effects, parameters = searched.predicted.effects, searched.predicted.parameters
    model = {
        name: AppliedEffect.of(effects[name], parameters[i])
        for name, i in zip(best, posterior.rows[best], strict=True)
    }
    fits: dict[str, Fit] = {}
    found: dict[str, tuple[Doubt, ...]] = {}
    # The others' sizes enter each fit, so the first is fitted again.
    for name in (*best, best[0]) if len(best) > 1 else best:
        beside = searched.beside(name, [model[n] for n in best if n != name])
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


def fit(searched: Searched, name: str, *, precise: bool) -> Fit:
    """Return a candidate's parameters, its size (`estimate_size`), and what becomes of the gap."""
    case, observed, discrepancy = searched.case, searched.observed, searched.discrepancy
    parameters: Parameters = {}
    likely: Parameters = {}
    size, absorption = None, None
    row, alone = 0, predict_hypotheses(case, [])
    probability = 1.0
    if name != COEFFICIENTS:
        effect = searched.predicted.effects[name]
        likely, size = estimate_size(searched, name, precise=precise)
        parameters = likely if size is None else {**likely, effect.size: size.mean}
        absorption = absorption_change(case, effect, parameters, size)
        alone, row = predict_hypotheses(case, [effect], [[parameters]]), 1
        probability = float(searched.evidence.off_given(name))
    off, scale = None, 1.0
    if probability >= LIKELY:
        scale = _LARGER
        alpha, other = covariance_of(observed, alone, discrepancy, row)
        mask = observed.used.ravel()
        residual = observed.values - alone.features[row].ravel()[mask] - discrepancy.bias[mask]
        off = coefficients.off_together(
            case,
            alone.alpha_covariance.slopes(row),
            spreading(observed, alone, row),
            residual,
            alpha + other,
            probability,
        )
    gap = gap_check(observed, alone, discrepancy, row, scale)
    surprise = goodness_of_fit(observed, alone, discrepancy, row, scale)
    return Fit(name, parameters, size, off, gap, likely, surprise, absorption)


def doubts(searched: Searched, best: Fit) -> tuple[Doubt, ...]:
    """Return the doubts about the best candidate."""
    out = gross(searched.observed, searched.predicted, best.gap)
    out += unexplained(best.name, *best.surprise)
    out += gap_against(best.name, best.gap)
    effects = []
    if best.name != COEFFICIENTS:
        effects = [searched.predicted.effects[best.name]]
        out += end_of_range(best.name, best.size)
        out += too_large(searched.case, effects[0], best.parameters)
    hypotheses = predict_hypotheses(searched.case, effects)
    return (*out, *decided_below_schroeder(searched, hypotheses, best.name))


def doubted(verdict: str, family: str | None, found: Sequence[Doubt]) -> str:
    """Return what is left of a claim after the doubts about its best candidate.

    Doubts about the size or the fit leave the family claimed, where it has the probability.
    """
    if verdict not in ("named", "family") or not found:
        return verdict
    if family is None or any(doubt.of == "effect" for doubt in found):
        return "hint"
    return "family"
