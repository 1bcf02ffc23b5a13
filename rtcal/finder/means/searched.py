"""What a search by means compared: the case, its features, the hypotheses and their evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from rtcal.finder.case import AppliedEffect, Case
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.means.evidence import Evidence, evaluate, evaluate_beyond
from rtcal.finder.means.features import Observed
from rtcal.finder.means.hypotheses import Hypotheses, predict_hypotheses
from rtcal.finder.means.model_error import ModelDiscrepancy
from rtcal.finder.prior import NONE


@dataclass(frozen=True, eq=False)
class Searched:
    """What a search compared: hypotheses with their evidence, the measurement, the model's error."""

    case: Case
    observed: Observed
    predicted: Hypotheses
    discrepancy: ModelDiscrepancy
    evidence: Evidence

    def nats(self, name: str) -> float:
        """Return the log evidence of an effect over "none"."""
        table = self.evidence.by_effect()
        return float(table[name] - table[NONE])

    def under(self, effect: Effect, grid: Sequence[Parameters]) -> Evidence:
        """Return the evidence of "none", and of an effect with these sets of parameters."""
        predicted = predict_hypotheses(self.case, [effect], [grid])
        return evaluate(self.observed, predicted, self.discrepancy, self.evidence.prior_off)

    def beside(self, name: str, others: Sequence[AppliedEffect] = ()) -> Searched:
        """Return the search for one effect, with others in the model."""
        case = replace(self.case, applied=(*self.case.applied, *others))
        predicted, evidence = evaluate_beyond(
            case,
            self.observed,
            predict_hypotheses(case, [self.predicted.effects[name]]),
            self.discrepancy,
            self.evidence.prior_off,
        )
        return replace(self, case=case, predicted=predicted, evidence=evidence)
