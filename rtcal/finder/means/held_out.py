"""A finding verified by data that it was not fitted to.

A finding by means is fitted to all that was measured, so none of it proves the finding. Of the case
that was searched a part is therefore held out: C80 and G, and each configuration but the first. The
effect is fitted anew to the rest, both models are calibrated to the rest, and the part is predicted.
T20, EDT and T30 of one configuration leave nothing to hold out: the shape of a decay fits a coupled
room, a field that is not diffuse and a noise floor alike. Of a case with further parameters or bands
these are held out, and the effect stays as it was found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.finder.case import LEVELS, Case
from rtcal.finder.effects import Effect
from rtcal.finder.means.evidence import evaluate
from rtcal.finder.means.features import ObservedFeatures, observe
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.gap import GapCheck, gap_check
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.likelihood import MeansProblem
from rtcal.finder.means.recalibration import plain, recalibrate
from rtcal.finder.means.verdict import Fit, fit
from rtcal.finder.means.verification import (
    Gap,
    MeansVerification,
    Recalibrated,
    misses_of,
    quantities_of,
)
from rtcal.finder.model import FEATURES
from rtcal.finder.prior import SCALES, probability_off
from rtcal.support.errors import DataError
from rtcal.support.speed import single_threaded_blas
from rtcal.support.types import Array

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
