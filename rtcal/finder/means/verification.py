"""Verify a finding: compare the gaps in quantities that alpha cannot fit.

Plain calibration changes alpha until T20 fits, whatever effect is missing. So a smaller gap in T20
proves nothing. The two models are compared in quantities that alpha cannot fit: the decay's shape (EDT,
T30), the level (C80, G), and T20 of every configuration but the first (another absorber, another
humidity, the suspect removed). A gap that shrinks there proves that the model is better, not that
the name is right: a rival that does the same would shrink it too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics.observables import observable
from rtcal.finder.case import Case
from rtcal.finder.finding import Verification
from rtcal.finder.means.features import distances, observe, state
from rtcal.finder.means.finding import FEATURE_NAMES, MeansFinding
from rtcal.finder.means.gap import LITTLE
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.likelihood import MeansProblem
from rtcal.finder.means.recalibrated import Recalibrated, table
from rtcal.finder.means.recalibration import plain, recalibrate
from rtcal.finder.model import FEATURES, predict
from rtcal.support import text
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.files import json_numbers
from rtcal.support.speed import single_threaded_blas
from rtcal.support.text import listed
from rtcal.support.types import Array

EXACT = 0.005
"""Gap in JND that is printed as 0.00."""
MET = 2.0
"""Standard deviations of T within which a calibration has met it."""


@dataclass(frozen=True)
class Gap:
    """The mean absolute gap of one quantity in one configuration, in JND, before and after."""

    configuration: str
    quantity: str
    fitted: bool
    before: float
    after: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MeansVerification(Verification):
    """The gap before and after the correction; attributes beside those of `Verification`.

    Attributes
    ----------
    quantities : tuple of Gap
        By configuration and quantity. ``before`` and ``after`` are means over those that alpha cannot
        absorb.
    predictive : float
        Nats by which the effect predicts what alpha cannot absorb, given the fitted T20, better than
        the model without it.
    plain, corrected : Recalibrated
    """

    record_kind: ClassVar[str] = "verification 2"

    finding: MeansFinding
    quantities: tuple[Gap, ...]
    predictive: float
    plain: Recalibrated
    corrected: Recalibrated

    @property
    def before(self) -> float:
        """Mean absolute gap in JND without the effect, over what alpha cannot absorb; or NaN."""
        return float(self._means[0])

    @property
    def after(self) -> float:
        """The same with the effect."""
        return float(self._means[1])

    @property
    def _means(self) -> Array:
        proof = [(g.before, g.after) for g in self.quantities if not g.fitted]
        return np.mean(proof, axis=0) if proof else np.full(2, np.nan)

    @property
    def verdict(self) -> str:
        """``supported``: the model got better where alpha cannot have made it so.

        ``unproven``: the data have nothing that alpha could not absorb, or it does not change. Else
        ``withdrawn``.
        """
        fitted = self.finding.fits[str(self.finding.best_effect)].gap
        gap = replace(fitted, before=self.before, after=self.after, predictive=self.predictive)
        if gap.grows:
            return "withdrawn"
        return "supported" if gap.shrinks else "unproven"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            **super().to_dict(),
            "before_jnd": json_numbers(self.before),
            "after_jnd": json_numbers(self.after),
            "predictive_nats": self.predictive,
            "gaps": [
                {
                    "configuration": g.configuration,
                    "quantity": g.quantity,
                    "fitted": g.fitted,
                    "before_jnd": g.before,
                    "after_jnd": g.after,
                }
                for g in self.quantities
            ],
            "plain": self.plain.to_dict(),
            "corrected": self.corrected.to_dict(),
            "reverberation_time": [
                {"configuration": c.name, **{k: json_numbers(v) for k, v in times.items()}}
                for c, times in zip(
                    self.finding.case.configurations, reverberation_times(self), strict=True
                )
            ],
            "residuals_after": [
                {"configuration": c.name, "feature": name, "values": json_numbers(row)}
                for c, table in zip(
                    self.finding.case.configurations, residual_map(self), strict=True
                )
                for name, row in zip(FEATURE_NAMES, table, strict=True)
                if np.isfinite(row).any()
            ],
        }

    @property
    def sentence(self) -> str:
        """The change of the gap, in numbers, and how sure the effect's name is."""
        f, name = self.finding, self.finding.title
        sure = f"The finding was {f.support}."
        if np.isnan(self.before):
            return (
                f"Unproven: nothing was measured that tells {name} from bent coefficients. The finding "
                f"rests on T20 and on the stated coefficients. {sure}"
            )
        gap = (
            f"with {name} in the model the gap that alpha cannot close goes from {self.before:.2f} to "
            f"{self.after:.2f} JND"
        )
        if self.verdict == "supported":
            little = self.before - self.after < LITTLE
            apart = f", but not told apart from {listed(f.rivals)}" if f.rivals else ""
            return (
                f"Supported{apart}: {gap}{', which is little' if little else ''}. That speaks for the "
                f"model, not for the name ({f.support})."
            )
        if self.verdict == "withdrawn":
            but = "although" if self.predictive > 0 else "and"
            given = f"given T20 it is predicted {_better(self.predictive)}"
            return f"Withdrawn: {gap}, {but} {given}. {sure}"
        likely = "more" if self.predictive >= 0 else "less"
        return (
            f"Unproven: {gap}, which neither supports nor refutes the finding. It rests on T20 and on "
            "the stated coefficients: weighed with their uncertainty, the other quantities are "
            f"{abs(self.predictive):.1f} nats {likely} probable with the effect. {sure}"
        )

    @property
    def _fitted_in_words(self) -> str:
        """The misfit of the two calibrations to the T that they were fitted to."""
        off = self.corrected.off
        if off <= MET:
            plainly = next((g.before for g in self.quantities if g.fitted), 0.0)
            how = "exactly" if plainly < EXACT else f"to {plainly:.2f} JND"
            return (
                f"Plain calibration meets the fitted T20 {how}. The corrected one meets it as closely "
                "as the uncertainty of T allows."
            )
        return (
            f"The corrected model does not meet the fitted T20: it is {off:.1f} times as far off "
            "as the uncertainty of T allows. So no coefficients near the stated ones go with this "
            "effect and size."
        )

    def __repr__(self) -> str:
        """Return one line: verdict, effect, and the gap before and after."""
        return (
            f"<Verification {self.verdict}: {self.finding.title}; gap {self.before:.2f} to "
            f"{self.after:.2f} JND, {self.predictive:+.1f} nats>"
        )

    def _repr_html_(self) -> str:
        """Return the mean gaps before and after as a table, the verdict in words."""
        rows = [
            [
                f"{g.quantity} of {g.configuration}" + (" (fitted)" if g.fitted else ""),
                f"{g.before:.2f}",
                f"{g.after:.2f}",
            ]
            for g in self.quantities
        ]
        header = ["mean gap / JND", "plain", f"with {self.finding.title}"]
        return text.html_table(f"Verification: {self.verdict}", header, rows, [self.sentence])

    def __str__(self) -> str:
        """Return the sentence, the gaps and the coefficients."""
        rows = []
        for g in self.quantities:
            name = f"  {g.quantity} of {g.configuration}" + (" (fitted)" if g.fitted else "")
            rows.append((name, [f"{g.before:.2f}", f"{g.after:.2f}"]))
        if np.isfinite(self.before):
            cells = [f"{self.before:.2f}", f"{self.after:.2f}"]
            rows.append(("  what alpha cannot absorb", cells))
        lines = text.wrapped(self.sentence)
        lines += text.table(rows, header=("mean gap in JND", ["plain", "corrected"]))
        if self.verdict != "unproven":
            lines += text.wrapped(
                "Once T20 is fitted, the corrected model predicts what alpha cannot absorb "
                f"{_better(self.predictive)} than the plain one."
            )
        lines += text.wrapped(self._fitted_in_words)
        room = self.finding.case.room
        lines += table(room, {"plain": self.plain, "corrected": self.corrected})
        return "\n".join(lines)


@single_threaded_blas()
@checked
def verify(finding: MeansFinding, case: Case | None = None) -> MeansVerification:
    """Compare the plainly calibrated model with the one that has the named effect.

    Raises DataError where there is no named effect (see `MeansFinding.apply`), where there are two or
    more, or ``case`` differs in shape.
    """
    if len(finding.members) > 1:
        raise DataError(
            f"{len(finding.members)} effects were found together; the gap is compared for one: search "
            "with most = 1"
        )
    case = finding.case if case is None else case
    before, after = plain(case), recalibrate(finding.apply(case), finding.discrepancy)
    observed, _ = observe(case)
    bias = finding.discrepancy.bias.reshape(observed.features.shape)
    quantities = []
    for c, configuration in enumerate(case.configurations):
        for f, name in enumerate(FEATURE_NAMES):
            if not observed.used[c, f].any():
                continue
            fitted = f == 0 and c == 0
            # Plain calibration has bent alpha for the model's bias in T as well.
            usual = before.features[c, f] + (0 if f == 0 else bias[c, f])
            one = [
                float(np.nanmean(np.abs(_gap(f, observed.features[c, f], model))))
                for model in (usual, after.features[c, f] + bias[c, f])
            ]
            quantities.append(Gap(configuration.name, name, fitted, *one))
    return MeansVerification(
        finding=finding,
        quantities=tuple(quantities),
        predictive=finding.fits[str(finding.best_effect)].gap.predictive,
        plain=before,
        corrected=after,
    )


def residual_map(verification: MeansVerification) -> Array:
    """Return corrected model less measured over its standard deviation, as `MeansFinding.residuals`."""
    finding = verification.finding
    case = finding.apply()
    observed, _ = observe(case)
    predicted = replace(
        predict_hypotheses(case, []), features=verification.corrected.features[None]
    )
    problem = MeansProblem(case, observed, predicted, finding.discrepancy)
    return problem.standardized_residuals()


def reverberation_times(verification: MeansVerification) -> list[dict[str, Array]]:
    """Return T in s, (n_bands,), by configuration: measured, prior, plain, corrected."""
    finding = verification.finding
    case = finding.case
    bias = finding.discrepancy.bias.reshape(finding.residuals.shape)
    return [
        {
            "measured": c.measured.decay_time().mean,
            "prior": predict([state(case, c)], distances(case, c)).reverberation_time[0],
            "plain": np.exp(verification.plain.features[i, 0]),
            "corrected": np.exp(verification.corrected.features[i, 0] + bias[i, 0]),
        }
        for i, c in enumerate(case.configurations)
    ]


def _better(nats: float) -> str:
    return f"{abs(nats):.1f} nats {'better' if nats >= 0 else 'worse'}"


def _gap(feature: int, measured: Array, modelled: Array) -> Array:
    jnd = observable(FEATURES[feature]).jnd
    if feature < 3:  # relative, from logarithms
        return np.asarray((np.exp(modelled - measured) - 1) / jnd)
    return np.asarray((modelled - measured) / jnd)
