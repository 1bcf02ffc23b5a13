"""The calibrated coefficients of a case, and the verdict on a finding by data that were held out.

Plain calibration changes alpha until T20 fits, whatever effect is missing. So a smaller gap in T20
proves nothing, and a smaller gap in what the effect was fitted to proves little. The two models are
compared at data that were held out (`rtcal.finder.means.held_out`): the level (C80, G), and further
configurations (another absorber, another humidity, the suspect removed). A gap that shrinks there
shows that the model is better, not that the name is right: a rival that does the same would shrink it
too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.observables import TARGET, observable
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.calibration.problem_data import data_history, times_in_room
from rtcal.calibration.result import JointResult
from rtcal.finder.case import Case
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.effects.checks import AppliedEffect
from rtcal.finder.finding import LEAST_SHRINKAGE, Miss, Verification, amount, is_miss
from rtcal.finder.means.corrected import corrected_room
from rtcal.finder.means.features import ObservedFeatures, distances, observe, state
from rtcal.finder.means.finding import MeansFinding, feature_names
from rtcal.finder.means.gap import LITTLE
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.likelihood import MeansProblem
from rtcal.finder.model import FEATURES, predict
from rtcal.support import __version__, blocks, text
from rtcal.support.blocks import Row, Table
from rtcal.support.files import json_numbers
from rtcal.support.saved import Result
from rtcal.support.text import as_sentence, listed
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
_SURE = 1.645
"""Standard errors by which a gap must shrink: 95 %, one-sided."""
_PREDICTED = 1.0
"""Mean gap in JND at what was held out, up to which the corrected model predicts it."""
_T20 = FEATURES.index(TARGET.key)


@dataclass(frozen=True)
class Gap:
    """The mean absolute gap of one quantity in one configuration, in JND, before and after.

    ``fitted`` is T20 of the first configuration, which plain calibration matches. ``held_out`` is what
    the effect was not fitted to when it was predicted.
    """

    configuration: str
    quantity: str
    fitted: bool
    held_out: bool
    before: float
    after: float


def quantities_of(
    case: Case,
    observed: ObservedFeatures,
    bias: Array,
    before: Recalibrated,
    after: Recalibrated,
    counted: NDArray[np.bool_],
    *,
    held_out: bool = True,
) -> list[Gap]:
    """Return the gaps of what is ``counted``, (n_configurations, n_features, n_bands)."""
    out = []
    for c, configuration in enumerate(case.configurations):
        for f, name in enumerate(feature_names(configuration.measured)):
            at = counted[c, f]
            if not at.any():
                continue
            measured = observed.features[c, f, at]
            # Plain calibration has bent alpha for the model's bias in T as well.
            usual = before.features[c, f] + (0 if f == _T20 else bias[c, f])
            one, other = (
                float(np.mean(np.abs(gap_in_jnd(f, measured, model[at]))))
                for model in (usual, after.features[c, f] + bias[c, f])
            )
            fitted = f == _T20 and c == 0
            out.append(Gap(configuration.name, name, fitted, held_out, one, other))
    return out


def misses_of(
    case: Case, observed: ObservedFeatures, bias: Array, corrected: Recalibrated
) -> tuple[Miss, ...]:
    """Return the T to which the corrected model was matched and which it misses."""
    spread = np.full(observed.used.shape, np.nan)
    spread[observed.used] = np.sqrt(np.diag(observed.covariance))
    out = []
    for c, configuration in enumerate(case.configurations):
        model = corrected.features[c, _T20] + bias[c, _T20]
        measured, u = observed.features[c, _T20], spread[c, _T20]
        jnd = gap_in_jnd(_T20, measured, model)
        missed = observed.used[c, _T20] & is_miss(jnd, u / observable(TARGET.key).jnd)
        place = configuration.name if len(case.configurations) > 1 else ""
        for k in np.flatnonzero(missed).tolist():
            frequency, time = float(case.room.centre_frequencies[k]), float(np.exp(measured[k]))
            model_time, error = float(np.exp(model[k])), float(time * u[k])
            out.append(
                Miss(
                    configuration.measured.time_label,
                    place,
                    frequency,
                    model_time,
                    time,
                    error,
                    float(jnd[k]),
                    "s",
                )
            )
    return tuple(out)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MeansVerification(Verification):
    """The gap before and after the correction; attributes beside those of `Verification`.

    Attributes
    ----------
    quantities : tuple of Gap
        By configuration and quantity. ``before`` and ``after`` are means over those that were held out.
    held_out : tuple of str
        The parts of the data that were held out, in words.
    uncertainty : float
        Standard error of the gap's change in JND, by measurement, model and the effect's size.
    predictive : float
        Nats by which the effect predicts what was held out better than the model without it.
    missed : tuple of Miss
        See `misses`.
    plain, corrected : Recalibrated
    """

    record_kind: ClassVar[str] = "verification 3"

    finding: MeansFinding
    quantities: tuple[Gap, ...]
    held_out: tuple[str, ...]
    uncertainty: float
    predictive: float
    missed: tuple[Miss, ...]
    plain: Recalibrated
    corrected: Recalibrated

    @property
    def misses(self) -> tuple[Miss, ...]:
        """T by band and configuration that the corrected model misses."""
        return self.missed

    @property
    def before(self) -> float:
        """Mean absolute gap in JND without the effect, over what was held out; or NaN."""
        return float(self._means[0])

    @property
    def after(self) -> float:
        """The same with the effect."""
        return float(self._means[1])

    @property
    def _means(self) -> Array:
        proof = [(g.before, g.after) for g in self.quantities if g.held_out]
        return np.mean(proof, axis=0) if proof else np.full(2, np.nan)

    @property
    def gain(self) -> float:
        """Decrease of the mean gap at what was held out, in JND; NaN where nothing was."""
        return self.before - self.after

    @property
    def needed(self) -> float:
        """Decrease in JND that supports the finding: 1.645 standard errors, and `LEAST_SHRINKAGE`."""
        return max(LEAST_SHRINKAGE, _SURE * self.uncertainty)

    @property
    def worse(self) -> dict[str, tuple[float, float]]:
        """Quantities whose gap at what was held out grows by `LEAST_SHRINKAGE`, before and after."""
        kinds = dict.fromkeys(g.quantity for g in self.quantities if g.held_out)
        out = {}
        for kind in kinds:
            pairs = [
                (g.before, g.after) for g in self.quantities if g.held_out and g.quantity == kind
            ]
            before, after = np.mean(pairs, axis=0).tolist()
            if after - before > LEAST_SHRINKAGE:
                out[kind] = (before, after)
        return out

    @property
    def verdict(self) -> str:
        """``supported``: the claimed effect predicts data better that it was not fitted to.

        ``not tested``: nothing was measured that the finding was not fitted to. ``withdrawn``: the gap
        grows there. Else ``unproven``, with the `objections`.
        """
        if np.isnan(self.before):
            return "not tested"
        if -self.gain > max(LITTLE, self.uncertainty):
            return "withdrawn"
        return "unproven" if self.objections else "supported"

    @property
    def objections(self) -> tuple[str, ...]:
        """Why the finding is not supported, a clause each; () where it is."""
        out = []
        if self.gain <= self.needed:
            out.append(f"only a decrease by more than {self.needed:.2f} JND counts")
        if self.after > _PREDICTED:
            out.append(f"with it these data are still missed by {self.after:.2f} JND on average")
        for kind, (before, after) in self.worse.items():
            out.append(f"the gap of {kind} grows from {before:.2f} to {after:.2f} JND")
        if self.predictive < DISTINCT_NATS:
            more = "more" if self.predictive > 0 else "less"
            out.append(
                "weighed with their uncertainty, these data are "
                f"{abs(self.predictive):.1f} nats {more} probable with it; {DISTINCT_NATS:g} count"
            )
        if self.finding.verdict not in ("named", "family"):
            out.append("no effect and no family of effects is claimed")
        if self.misses:
            out.append("the corrected model misses T")
        return tuple(out)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            **super().to_dict(),
            "held_out": list(self.held_out),
            "before_jnd": json_numbers(self.before),
            "after_jnd": json_numbers(self.after),
            "uncertainty_jnd": json_numbers(self.uncertainty),
            "objections": [] if np.isnan(self.before) else list(self.objections),
            "predictive_nats": self.predictive,
            "gaps": [
                {
                    "configuration": g.configuration,
                    "quantity": g.quantity,
                    "fitted": g.fitted,
                    "held_out": g.held_out,
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
        """The verdict, the change of the gap with its standard error, and how sure the name is."""
        f, name = self.finding, self.finding.title
        if np.isnan(self.before):
            said = (
                f"Not tested: {name} was fitted to all that was measured. Measure C80 or G, or a "
                "second configuration. The finding rests on T and on the stated coefficients. "
                f"It is {f.support}."
            )
            return " ".join(filter(None, [said, self.misses_in_words]))
        verb = "shrinks" if self.gain > 0 else "grows"
        gap = (
            f"at data that it was not fitted to ({listed(self.held_out)}) the gap {verb} with {name} "
            f"from {self.before:.2f} to {self.after:.2f} JND, by {abs(self.gain):.2f} ± "
            f"{self.uncertainty:.2f} JND (standard error)"
        )
        if self.verdict == "supported":
            apart = f", but not told apart from {listed(f.rivals)}" if f.rivals else ""
            return (
                f"Supported{apart}: {gap}; more than {self.needed:.2f} JND counts. The model is "
                f"better; the name may still be wrong ({f.support})."
            )
        grounds = [o for o in self.objections if "misses" not in o]
        why = f". {as_sentence(listed(grounds))}" if grounds else "."
        verdict = self.verdict.capitalize()
        return " ".join(
            filter(None, [f"{verdict}: {gap}{why}", f"It is {f.support}.", self.misses_in_words])
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
        rows = [Row(_named(g), [g.before, g.after], ".2f") for g in self.quantities]
        columns = ["plain", f"with {self.finding.title}"]
        table = Table(columns, rows, corner="mean gap / JND", note=self.sentence)
        return blocks.notebook(f"Verification: {self.verdict}", [table])

    def __str__(self) -> str:
        """Return the sentence, the gaps and the coefficients."""
        rows = []
        for g in self.quantities:
            rows.append((f"  {_named(g)}", [f"{g.before:.2f}", f"{g.after:.2f}"]))
        if np.isfinite(self.before):
            cells = [f"{self.before:.2f}", f"{self.after:.2f}"]
            rows.append(("  all that was held out", cells))
        lines = text.wrapped(self.sentence)
        lines += text.table(rows, header=("mean gap in JND", ["plain", "corrected"]))
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


def _named(g: Gap) -> str:
    """Return a quantity's name, and what it was used for."""
    used = " (matched)" if g.fitted else " (held out)" if g.held_out else ""
    return f"{g.quantity} of {g.configuration}{used}"


def gap_in_jnd(feature: int, measured: Array, modelled: Array) -> Array:
    """Return the gap of a row of `FEATURES` in JND, signed."""
    jnd = observable(FEATURES[feature]).jnd
    if feature < 3:  # relative, from logarithms
        return np.asarray((np.exp(modelled - measured) - 1) / jnd)
    return np.asarray((modelled - measured) / jnd)
