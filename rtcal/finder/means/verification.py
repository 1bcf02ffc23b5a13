"""The verdict on a finding by means over positions, by data that were held out.

A finding by means is fitted to all that was measured, so none of it proves the finding. Of the case
that was searched a part is therefore held out: C80 and G, and each configuration but the first. The
effect is fitted anew to the rest, both models are calibrated to the rest, and the part is predicted.
T20, EDT and T30 of one configuration leave nothing to hold out: the shape of a decay fits a coupled
room, a field that is not diffuse and a noise floor alike. Of a case with further parameters or bands
these are held out, and the effect stays as it was found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.observables import TARGET, observable
from rtcal.files.disk import json_numbers
from rtcal.finder.case import LEVELS, Case
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.means.finding import MeansFinding, feature_names
from rtcal.finder.means.problem import (
    MeansProblem,
    ObservedFeatures,
    distances,
    evaluate,
    observe,
    predict_hypotheses,
    state,
)
from rtcal.finder.means.recalibration import Recalibrated, plain, recalibrate
from rtcal.finder.means.verdict import LITTLE, GapCheck, fit, gap_check
from rtcal.finder.model import FEATURES, predict
from rtcal.finder.prior import SCALES, probability_off
from rtcal.finder.verification import LEAST_SHRINKAGE, Gap, Miss, Verification, is_miss
from rtcal.support.errors import DataError
from rtcal.support.speed import single_threaded_blas
from rtcal.support.text import listed
from rtcal.support.types import Array

MODELS = ("plain", "corrected")
EXACT = 0.005
"""Gap in JND that is printed as 0.00."""
MET = 2.0
"""Standard deviations of T within which a calibration has met it."""
_SURE = 1.645
"""Standard errors by which a gap must shrink: 95 %, one-sided."""
_PREDICTED = 1.0
"""Mean gap in JND at what was held out, up to which the corrected model predicts it."""
_T20 = FEATURES.index(TARGET.key)


def concluded(
    finding: MeansFinding,
    quantities: Sequence[Gap],
    uncertainty: float,
    predictive: float,
    misses: Sequence[Miss],
    held_out: Sequence[str],
    *,
    before: Recalibrated,
    after: Recalibrated,
) -> Verification:
    """Return what the gaps say of a finding.

    Parameters
    ----------
    finding : MeansFinding
    quantities : sequence of Gap
    uncertainty : float
        Standard error of the gap's change in JND, by measurement, model and the effect's size.
    predictive : float
        Nats by which the effect predicts what was held out better than the model without it.
    misses : sequence of Miss
    held_out : sequence of str
        The parts of the data that were held out, in words.
    before, after : Recalibrated
        The calibrations without and with the effect.
    """
    held = [gap for gap in quantities if gap.used == "held out"]
    mean = np.mean([gap.values for gap in held], axis=0) if held else np.full(2, np.nan)
    doubts = []
    if mean[1] > _PREDICTED:
        doubts.append(f"with it these data are still missed by {mean[1]:.2f} JND on average")
    for kind in dict.fromkeys(gap.quantity for gap in held):
        one, other = np.mean([gap.values for gap in held if gap.quantity == kind], axis=0)
        if other - one > LEAST_SHRINKAGE:
            doubts.append(f"the gap of {kind} grows from {one:.2f} to {other:.2f} JND")
    if predictive < DISTINCT_NATS:
        doubts.append(
            "weighed with their uncertainty, these data are "
            f"{abs(predictive):.1f} nats {'more' if predictive > 0 else 'less'} probable with it; "
            f"{DISTINCT_NATS:g} count"
        )
    if finding.verdict not in ("named", "family"):
        doubts.append("no effect and no family of effects is claimed")
    configurations = finding.case.configurations
    times = reverberation_times(finding, before, after)
    left = residual_map(finding, after)
    return Verification(
        finding=finding,
        models=MODELS,
        held_out=tuple(held_out),
        before=float(mean[0]),
        after=float(mean[1]),
        gain=float(mean[0] - mean[1]),
        uncertainty=uncertainty,
        needed=max(LEAST_SHRINKAGE, _SURE * uncertainty),
        endured=max(LITTLE, uncertainty),
        quantities=tuple(quantities),
        misses=tuple(misses),
        doubts=tuple(doubts),
        but=f", but not told apart from {listed(finding.rivals)}" if finding.rivals else "",
        notes=(f"It is {finding.support}.", _fitted_in_words(finding, quantities, after)),
        plain=before,
        corrected=after,
        details={
            "predictive_nats": predictive,
            "gaps": [
                {
                    "configuration": gap.place,
                    "quantity": gap.quantity,
                    "fitted": gap.used == "matched",
                    "held_out": gap.used == "held out",
                    "before_jnd": gap.values[0],
                    "after_jnd": gap.values[1],
                }
                for gap in quantities
            ],
            "reverberation_time": [
                {"configuration": c.name, **{k: json_numbers(v) for k, v in of.items()}}
                for c, of in zip(configurations, times, strict=True)
            ],
            "residuals_after": [
                {"configuration": c.name, "feature": name, "values": json_numbers(row)}
                for c, rows in zip(configurations, left, strict=True)
                for name, row in zip(feature_names(c.measured), rows, strict=True)
                if np.isfinite(row).any()
            ],
        },
    )


def _fitted_in_words(finding: MeansFinding, quantities: Sequence[Gap], after: Recalibrated) -> str:
    """Return the misfit of the two calibrations to the T that they were fitted to, in words."""
    time = finding.case.configurations[0].measured.time_label
    if after.off > MET:
        return (
            f"The corrected model does not meet the fitted {time}: it is {after.off:.1f} times as far "
            "off as the uncertainty of T allows. So no coefficients near the stated ones go with this "
            "effect and size."
        )
    gap = next((gap.values[0] for gap in quantities if gap.used == "matched"), 0.0)
    how = "exactly" if gap < EXACT else f"to {gap:.2f} JND"
    return (
        f"Plain calibration meets the fitted {time} {how}. The corrected one meets it as closely as "
        "the uncertainty of T allows."
    )


def residual_map(finding: MeansFinding, after: Recalibrated) -> Array:
    """Return corrected model less measured over its standard deviation, as `MeansFinding.residuals`."""
    case = finding.with_effects()
    observed, _ = observe(case)
    predicted = replace(predict_hypotheses(case, []), features=after.features[None])
    return MeansProblem(case, observed, predicted, finding.discrepancy).standardized_residuals()


def reverberation_times(
    finding: MeansFinding, before: Recalibrated, after: Recalibrated
) -> list[dict[str, Array]]:
    """Return T in s, (n_bands,), by configuration: measured, prior, plain, corrected."""
    case = finding.case
    bias = finding.discrepancy.bias.reshape(finding.residuals.shape)
    return [
        {
            "measured": c.measured.reverberation_time,
            "prior": predict([state(case, c)], distances(case, c)).reverberation_time[0],
            "plain": np.exp(before.features[i, 0]),
            "corrected": np.exp(after.features[i, 0] + bias[i, 0]),
        }
        for i, c in enumerate(case.configurations)
    ]


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
            used = "matched" if f == _T20 and c == 0 else "held out" if held_out else ""
            out.append(Gap(name, configuration.name, (one, other), used))
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
def verify(finding: MeansFinding, case: Case | None = None) -> Verification:
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
    held, uncertainty, predictive = list[Gap](), 0.0, 0.0
    for part in parts:
        gaps, check = _judged(finding, case, observed, part, before)
        held += gaps
        uncertainty += check.uncertainty * len(gaps)
        predictive += check.predictive
    by_name = {(g.place, g.quantity): g for g in (*quantities, *held)}
    return concluded(
        finding,
        list(by_name.values()),
        uncertainty / len(held) if held else float("nan"),
        predictive,
        misses_of(case, observed, bias, after),
        [part.words for part in parts],
        before=before,
        after=after,
    )


def _judged(
    finding: MeansFinding,
    case: Case,
    observed: ObservedFeatures,
    part: HeldOut,
    before: Recalibrated,
) -> tuple[list[Gap], GapCheck]:
    """Return the gaps at a part of the data, and the linear model's check of their change."""
    name = str(finding.best_effect)
    effects = [finding.effects[name]] if name in finding.effects else []
    found = finding.fits[name]
    if part.refitted:
        # The best effect as the data without this part have it.
        used: Array = np.logical_and(observed.used, np.logical_not(part.hidden))
        kept = used[observed.used]
        rest = replace(observed, used=used, covariance=observed.covariance[np.ix_(kept, kept)])
        predicted = predict_hypotheses(case, effects)
        problem = MeansProblem(case, rest, predicted, finding.discrepancy)
        found = fit(evaluate(problem, probability_off(case.room)), name, precise=True)
    bias = finding.discrepancy.bias.reshape(observed.features.shape)
    with_it = finding.with_effects(case, fits={name: found})
    after = recalibrate(with_it, finding.discrepancy, left_out=part.configurations)
    gaps = quantities_of(case, observed, bias, before, after, part.counted)
    predicted = predict_hypotheses(case, effects, [[found.parameters]] if effects else None)
    problem = MeansProblem(case, observed, predicted, finding.discrepancy)
    scale = SCALES[0][0] if found.coefficients is not None else 1.0
    return gaps, gap_check(problem, 1 if effects else 0, scale, part.counted[observed.used])
