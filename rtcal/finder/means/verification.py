"""The verdict on a finding by data that were held out.

Plain calibration changes alpha until T20 fits, whatever effect is missing. So a smaller gap in T20
proves nothing, and a smaller gap in what the effect was fitted to proves little. The two models are
compared at data that were held out: the level (C80, G), and further
configurations (another absorber, another humidity, the suspect removed). A gap that shrinks there
shows that the model is better, not that the name is right: a rival that does the same would shrink it
too.

A finding by means is fitted to all that was measured, so none of it proves the finding. Of the case
that was searched a part is therefore held out: C80 and G, and each configuration but the first. The
effect is fitted anew to the rest, both models are calibrated to the rest, and the part is predicted.
T20, EDT and T30 of one configuration leave nothing to hold out: the shape of a decay fits a coupled
room, a field that is not diffuse and a noise floor alike. Of a case with further parameters or bands
these are held out, and the effect stays as it was found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.observables import TARGET, observable
from rtcal.files.disk import json_numbers
from rtcal.finder.case import LEVELS, Case
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.effects import Effect
from rtcal.finder.finding import LEAST_SHRINKAGE, Miss, Verification, is_miss
from rtcal.finder.means.evidence import evaluate
from rtcal.finder.means.finding import MeansFinding, feature_names
from rtcal.finder.means.problem import (
    MeansProblem,
    ObservedFeatures,
    distances,
    observe,
    predict_hypotheses,
    state,
)
from rtcal.finder.means.recalibration import Recalibrated, plain, recalibrate, table
from rtcal.finder.means.verdict import LITTLE, Fit, GapCheck, fit, gap_check
from rtcal.finder.model import FEATURES, predict
from rtcal.finder.prior import SCALES, probability_off
from rtcal.support import blocks, text
from rtcal.support.blocks import Row, Table
from rtcal.support.errors import DataError
from rtcal.support.speed import single_threaded_blas
from rtcal.support.text import as_sentence, listed
from rtcal.support.types import Array

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
        gaps = Table(columns, rows, corner="mean gap / JND", note=self.sentence)
        return blocks.notebook(f"Verification: {self.verdict}", [gaps])

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


_LEVEL_ROWS = [FEATURES.index(name) for name in LEVELS]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A part of the data that the effect is not fitted to.

    Attributes
    ----------
    words : str
    hidden, counted : array (n_configurations, n_features, n_bands)
        What the effect is not fitted to, and what of it counts.
    configurations : tuple of int
        Numbers of the configurations that no model is calibrated to.
    refitted : bool
        Whether the effect is fitted anew without it.
    """

    words: str
    hidden: NDArray[np.bool_]
    counted: NDArray[np.bool_]
    configurations: tuple[int, ...] = ()
    refitted: bool = True


def parts_of(case: Case, observed: ObservedFeatures, fitted: ObservedFeatures) -> list[HeldOut]:
    """Return the parts of the data that can be held out; none where there are none.

    ``fitted`` is what the finding was fitted to.
    """
    used = np.array(observed.used, dtype=bool)
    further = used & ~np.array(fitted.used, dtype=bool)
    further[0, 0] = False  # alpha fits T20 of the first configuration, whatever is missing
    if further.any():
        return [HeldOut("what was not in the search", further, further, refitted=False)]
    out = []
    levels = np.zeros_like(used)
    levels[:, _LEVEL_ROWS] = used[:, _LEVEL_ROWS]
    if levels[0].any():
        counted = np.zeros_like(used)
        counted[0] = levels[0]
        names = [
            n.upper() for n, row in zip(LEVELS, _LEVEL_ROWS, strict=True) if used[0, row].any()
        ]
        out.append(HeldOut(" and ".join(names), levels, counted))
    for c, configuration in enumerate(case.configurations[1:], 1):
        whole = np.zeros_like(used)
        whole[c] = used[c]
        out.append(HeldOut(f'configuration "{configuration.name}"', whole, whole, (c,)))
    return out


@single_threaded_blas()
def verify(finding: MeansFinding, case: Case | None = None) -> MeansVerification:
    """Compare the model with and without the best effect by data that the effect is not fitted to.

    Parameters
    ----------
    finding : MeansFinding
    case : Case, optional
        With further parameters or bands of the same configurations, which are then held out; by default
        the finding's own, parts of which are held out in turn.

    Raises
    ------
    DataError
        If the verdict names no effect ("none", "hint", "unknown"), if two or more effects were found
        together, or ``case`` has other configurations or bands.
    """
    if not finding.can_be_added:
        raise DataError(f'the verdict is "{finding.verdict}"; there is no effect to add')
    if len(finding.members) > 1:
        raise DataError(
            f"{len(finding.members)} effects were found together; the gap is compared for one: search "
            "with most = 1"
        )
    case = finding.case if case is None else case
    observed, _ = observe(case)
    before, after = plain(case), recalibrate(finding.with_effects(case), finding.discrepancy)
    fitted = observe(finding.case)[0]
    if fitted.used.shape != observed.used.shape:
        raise DataError(
            f"case has {len(case.configurations)} configurations in {case.room.n_bands} bands; the "
            f"finding has {len(finding.case.configurations)} in {finding.case.room.n_bands}"
        )
    bias = finding.discrepancy.bias.reshape(observed.features.shape)
    every = np.array(observed.used, dtype=bool)
    quantities = quantities_of(case, observed, bias, before, after, every, held_out=False)
    parts = parts_of(case, observed, fitted)
    held, uncertainty, predictive = [], 0.0, 0.0
    for part in parts:
        judged = _judged(finding, case, observed, part, before)
        held += judged.quantities
        uncertainty += judged.check.uncertainty * len(judged.quantities)
        predictive += judged.check.predictive
    by_name = {(g.configuration, g.quantity): g for g in quantities}
    by_name |= {(g.configuration, g.quantity): g for g in held}
    return MeansVerification(
        finding=finding,
        quantities=tuple(by_name.values()),
        held_out=tuple(part.words for part in parts),
        uncertainty=uncertainty / len(held) if held else float("nan"),
        predictive=predictive,
        missed=misses_of(case, observed, bias, after),
        plain=before,
        corrected=after,
    )


@dataclass(frozen=True, eq=False)
class _Judged:
    """The gaps at one part, and the linear model's standard error of their change and evidence."""

    quantities: list[Gap]
    check: GapCheck


def _judged(
    finding: MeansFinding,
    case: Case,
    observed: ObservedFeatures,
    part: HeldOut,
    before: Recalibrated,
) -> _Judged:
    """Return what becomes of the gap at a part of the data."""
    name = str(finding.best_effect)
    effects = [finding.effects[name]] if name in finding.effects else []
    found = finding.fits[name]
    if part.refitted:
        found = _refitted(finding, case, observed, part, effects)
    bias = finding.discrepancy.bias.reshape(observed.features.shape)

    with_it = finding.with_effects(case, fits={name: found})
    after = recalibrate(with_it, finding.discrepancy, left_out=part.configurations)
    quantities = quantities_of(case, observed, bias, before, after, part.counted, held_out=True)
    predicted = predict_hypotheses(case, effects, [[found.parameters]] if effects else None)
    problem = MeansProblem(case, observed, predicted, finding.discrepancy)
    scale = SCALES[0][0] if found.coefficients is not None else 1.0
    check = gap_check(problem, 1 if effects else 0, scale, part.counted[observed.used])
    return _Judged(quantities, check)


def _refitted(
    finding: MeansFinding,
    case: Case,
    observed: ObservedFeatures,
    part: HeldOut,
    effects: list[Effect],
) -> Fit:
    """Return the best effect as the data without a part have it."""
    used: Array = np.logical_and(observed.used, np.logical_not(part.hidden))
    kept = used[observed.used]
    rest = replace(observed, used=used, covariance=observed.covariance[np.ix_(kept, kept)])
    predicted = predict_hypotheses(case, effects)
    problem = MeansProblem(case, rest, predicted, finding.discrepancy)
    evidence = evaluate(problem, probability_off(case.room))
    return fit(evidence, str(finding.best_effect), precise=True)
