"""The calibrated coefficients of a case, and a finding verified by the gaps that alpha cannot fit.

Plain calibration changes alpha until T20 fits, whatever effect is missing. So a smaller gap in T20
proves nothing. The two models are compared in quantities that alpha cannot fit: the decay's shape (EDT,
T30), the level (C80, G), and T20 of every configuration but the first (another absorber, another
humidity, the suspect removed). A gap that shrinks there proves that the model is better, not that
the name is right: a rival that does the same would shrink it too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics.observables import observable
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.calibration.problem_data import data_history, times_in_room
from rtcal.calibration.result import JointResult
from rtcal.finder.case import Case
from rtcal.finder.effects.checks import AppliedEffect
from rtcal.finder.finding import Verification, amount
from rtcal.finder.means.corrected import corrected_room
from rtcal.finder.means.features import distances, observe, state
from rtcal.finder.means.finding import MeansFinding, feature_names
from rtcal.finder.means.gap import LITTLE
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.likelihood import MeansProblem
from rtcal.finder.model import FEATURES, predict
from rtcal.support import __version__, text
from rtcal.support.files import json_numbers
from rtcal.support.results import Result
from rtcal.support.text import listed
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False, repr=False)
class Recalibrated(Result):
    """The calibrated coefficients of a case, and the model's prediction with them.

    Attributes
    ----------
    case : Case
        With the effects' sizes as calibrated.
    alpha : array (n_materials, n_bands)
        The room's coefficients; those that a configuration changes are in ``changed``.
    changed : mapping of (configuration, material) to array (n_bands,)
    sizes : mapping of str to float
        Sizes of the effects that have one, in the effect's unit.
    features : array (n_configurations, n_features, n_bands)
        Predicted: ln T20, ln EDT/T20, ln T30/T20, C80 and G in dB, the model's bias left out.
    off : float
        Root mean square of the fitted ln T less the measured one, over its standard deviation.
    joint : JointResult
        The QP's answer, in which a configuration's changed materials have names of their own.
    """

    record_kind: ClassVar[str] = "recalibration 1"

    case: Case
    alpha: Array
    changed: Mapping[tuple[str, str], Array]
    sizes: Mapping[str, float]
    features: Array
    off: float
    joint: JointResult

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of alpha, (n_materials, n_bands): the QP's `posterior_sigma`.

        It holds if the effects in the model are right, with their parameters. Only the sizes that are
        unknowns of the QP contribute their uncertainty.
        """
        by_name = dict(zip(self.joint.materials, self.joint.posterior_sigma, strict=True))
        room = self.case.room
        return np.array([by_name.get(m, room.sigma[i]) for i, m in enumerate(room.materials)])

    @property
    def interval(self) -> tuple[Array, Array]:
        """Ends of alpha's 90 % interval, each (n_materials, n_bands): alpha ± 1.645 sigma in 0 to 1."""
        spread = NORMAL_90 * self.sigma
        return np.clip(self.alpha - spread, 0, 1), np.clip(self.alpha + spread, 0, 1)

    @cached_property
    def room(self) -> Room:
        """`corrected_room` with the calibrated coefficients, their sigma, and the record of it."""
        stated = self.case.room
        data = [times_in_room(stated, c.measured) for c in self.case.configurations]
        calibrated = stated.replace(
            alpha=self.alpha,
            sigma=self.sigma,
            calibration=CalibrationRecord(
                method="gap",
                equation=self.joint.equation.name,
                solver=self.joint.solver,
                measured=" ".join(
                    [data_history(stated, data[0]), *(d.fingerprint for d in data[1:])]
                ),
                version=__version__,
            ),
        )
        return corrected_room(replace(self.case, room=calibrated))

    @property
    def effects(self) -> list[dict[str, Any]]:
        """The effects with their sizes, and the 90 % interval from all data.

        The size of a ``calibrated`` effect was an unknown of the QP, which uses T20 only. Other effects
        have the size with which they were added.
        """
        return [
            p.to_dict()
            | {
                "size": self.sizes.get(p.name),
                "unit": p.effect.unit,
                "material": p.effect.material(p.parameters, self.case.room),
                "calibrated": p.name in self.joint.effects,
            }
            for p in self.case.applied
        ]

    @property
    def effects_in_words(self) -> list[str]:
        """A line per effect: its size, and the data from which the size follows."""
        return [self._in_words(p) for p in self.case.applied]

    def _in_words(self, p: AppliedEffect) -> str:
        name = p.effect.title(p.parameters, self.case.room)
        size, ends = self.sizes.get(p.name), p.size_interval
        if size is None:
            return f"{name}: {p.effect.describe(p.parameters)}"
        time = self.case.configurations[0].measured.time_label
        source = f", calibrated to {time} alone" if p.name in self.joint.effects else ""
        return f"{name}{source}: {amount(size, p.effect.unit, ends)}"

    def __repr__(self) -> str:
        """Return one line: the room, and the effects with their sizes."""
        sizes = (
            p.name if p.name not in self.sizes else f"{p.name} {self.sizes[p.name]:.3g}"
            for p in self.case.applied
        )
        effects = text.shortened(", ".join(sizes)) or "no effect"
        name = text.shortened(self.case.room.name)
        return f'<Recalibrated "{name}": {len(self.alpha)} materials, with {effects}>'

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        low, high = self.interval
        return {
            "effects": self.effects,
            "materials": [
                {
                    "name": m,
                    "alpha": self.alpha[i].tolist(),
                    "sigma": self.sigma[i].tolist(),
                    "low": low[i].tolist(),
                    "high": high[i].tolist(),
                }
                for i, m in enumerate(self.case.room.materials)
            ],
            "changed": [
                {"configuration": c, "material": m, "alpha": v.tolist()}
                for (c, m), v in self.changed.items()
            ],
        }


def table(room: Room, columns: Mapping[str, Recalibrated]) -> list[str]:
    """Return lines with each material's alpha, as stated and as calibrated, and the effects."""
    named = {"prior": (room.alpha, NORMAL_90 * room.sigma)}
    named |= {k: (c.alpha, np.subtract(*c.interval[::-1]) / 2) for k, c in columns.items()}
    rows = []
    for i, material in enumerate(room.materials):
        cells = [f"{a[i].mean():.3f} ± {half[i].mean():.3f}" for a, half in named.values()]
        rows.append((f"  {material}", cells))
    lines = ["alpha ± half its 90 % interval, means over bands"]
    lines += text.table(rows, header=("", list(named)))
    for c in columns.values():
        for line in c.effects_in_words:
            lines += text.wrapped(line, indent="  ")
    return lines


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

    @classmethod
    def of(
        cls, finding: MeansFinding, case: Case, plain: Recalibrated, corrected: Recalibrated
    ) -> MeansVerification:
        """Return the gaps of a case that was calibrated without and with the effect."""
        observed, _ = observe(case)
        bias = finding.discrepancy.bias.reshape(observed.features.shape)
        quantities = []
        for c, configuration in enumerate(case.configurations):
            for f, name in enumerate(feature_names(configuration.measured)):
                if not observed.used[c, f].any():
                    continue
                # Plain calibration has bent alpha for the model's bias in T as well.
                usual = plain.features[c, f] + (0 if f == 0 else bias[c, f])
                one = [
                    float(np.nanmean(np.abs(_gap(f, observed.features[c, f], model))))
                    for model in (usual, corrected.features[c, f] + bias[c, f])
                ]
                quantities.append(Gap(configuration.name, name, f == 0 and c == 0, *one))
        return cls(
            finding=finding,
            quantities=tuple(quantities),
            predictive=finding.fits[str(finding.best_effect)].gap.predictive,
            plain=plain,
            corrected=corrected,
        )

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
                for name, row in zip(feature_names(c.measured), table, strict=True)
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
                f"rests on {self._time} and on the stated coefficients. {sure}"
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
            given = f"given {self._time} it is predicted {_better(self.predictive)}"
            return f"Withdrawn: {gap}, {but} {given}. {sure}"
        likely = "more" if self.predictive >= 0 else "less"
        return (
            f"Unproven: {gap}, which neither supports nor refutes the finding. It rests on "
            f"{self._time} and on the stated coefficients: weighed with their uncertainty, the other "
            "quantities are "
            f"{abs(self.predictive):.1f} nats {likely} probable with the effect. {sure}"
        )

    @property
    def _time(self) -> str:
        """Name of the reverberation time that was fitted."""
        return self.finding.case.configurations[0].measured.time_label

    @property
    def _fitted_in_words(self) -> str:
        """The misfit of the two calibrations to the T that they were fitted to."""
        off = self.corrected.off
        if off <= MET:
            plainly = next((g.before for g in self.quantities if g.fitted), 0.0)
            how = "exactly" if plainly < EXACT else f"to {plainly:.2f} JND"
            return (
                f"Plain calibration meets the fitted {self._time} {how}. The corrected one meets it as "
                "closely as the uncertainty of T allows."
            )
        return (
            f"The corrected model does not meet the fitted {self._time}: it is {off:.1f} times as far "
            "off as the uncertainty of T allows. So no coefficients near the stated ones go with this "
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
                f"Once {self._time} is fitted, the corrected model predicts what alpha cannot absorb "
                f"{_better(self.predictive)} than the plain one."
            )
        lines += text.wrapped(self._fitted_in_words)
        room = self.finding.case.room
        lines += table(room, {"plain": self.plain, "corrected": self.corrected})
        return "\n".join(lines)


def residual_map(verification: MeansVerification) -> Array:
    """Return corrected model less measured over its standard deviation, as `MeansFinding.residuals`."""
    finding = verification.finding
    case = finding.with_effects()
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
