"""The verdict: what is claimed, and the checks that a claim must pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rtcal.finder import coefficients
from rtcal.finder.case import Case
from rtcal.finder.coefficients import SCALES, OffTogether
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.means.doubts import (
    Doubt,
    decided_below_schroeder,
    end_of_range,
    gap_against,
    gross,
    too_large,
    unexplained,
)
from rtcal.finder.means.evidence import Evidence
from rtcal.finder.means.features import Observed
from rtcal.finder.means.gap import GapCheck, gap_check
from rtcal.finder.means.hypotheses import Hypotheses, predict_hypotheses
from rtcal.finder.means.likelihood import covariance_of, goodness_of_fit, spreading
from rtcal.finder.means.model_error import ModelDiscrepancy
from rtcal.finder.prior import COEFFICIENTS
from rtcal.finder.size import (
    AbsorptionChange,
    Size,
    absorption_change,
    estimate_size,
)

LIKELY = 0.5
"""Probability from which coefficients that are off together are said beside an effect."""
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


def fit(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    evidence: Evidence,
    name: str,
    *,
    precise: bool,
) -> Fit:
    """Return a candidate's parameters, its size (`estimate_size`), and what becomes of the gap."""
    parameters: Parameters = {}
    likely: Parameters = {}
    size, absorption = None, None
    row, alone = 0, predict_hypotheses(case, [])
    probability = 1.0
    if name != COEFFICIENTS:
        effect: Effect = predicted.effects[name]
        likely, size = estimate_size(
            case, observed, predicted, discrepancy, evidence, name, precise=precise
        )
        parameters = likely if size is None else {**likely, effect.size: size.mean}
        absorption = absorption_change(case, effect, parameters, size)
        alone, row = predict_hypotheses(case, [effect], [[parameters]]), 1
        probability = float(evidence.off_given(name))
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


def doubts(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    evidence: Evidence,
    best: Fit,
    nats: float,
) -> tuple[Doubt, ...]:
    """Return the doubts about the best candidate, ``nats`` its evidence."""
    out = gross(observed, predicted, best.gap)
    out += unexplained(best.name, *best.surprise)
    out += gap_against(best.name, best.gap)
    effects = []
    if best.name != COEFFICIENTS:
        effect = predicted.effects[best.name]
        effects = [effect]
        out += end_of_range(effect.name, best.size)
        out += too_large(case, effect, best.parameters)
    hypotheses = predict_hypotheses(case, effects)
    out += decided_below_schroeder(
        case, observed, hypotheses, discrepancy, evidence.prior_off, best.name, nats
    )
    return tuple(out)


def doubted(verdict: str, family: str | None, found: Sequence[Doubt]) -> str:
    """Return what is left of a claim after the doubts about its best candidate.

    Doubts about the size or the fit leave the family claimed, where it has the probability.
    """
    if verdict not in ("named", "family") or not found:
        return verdict
    if family is None or any(doubt.of == "effect" for doubt in found):
        return "hint"
    return "family"
