"""Whether the model predicts better with what was found, at data that it was not fitted to.

Calibration changes alpha until T fits, whatever effect is missing. So a smaller gap in what was fitted
proves nothing, and the gap is that of data that were held out. A gap that shrinks there shows that the
model is better, not that the name is right: a rival that does the same would shrink it too.

Of means over positions these are C80 and G, and each configuration but the first: the effect is fitted
anew to the rest, both models are calibrated to the rest, and the part is predicted. T20, EDT and T30 of
one configuration leave nothing to hold out: the shape of a decay fits a coupled room, a field that is
not diffuse and a noise floor alike. Of a case with further parameters or bands these are held out, and
the effect stays as it was found. At positions and of two states half of the pairs search again, and the
others are predicted: at positions by a model that is traced and calibrated anew, of two states by the
shift of ln T.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from rtcal.acoustics import bands
from rtcal.acoustics.marks import gap_jnd
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import (
    LEVEL,
    MATCH,
    TARGET,
    DecaySlope,
    observable,
    parameter_label,
)
from rtcal.acoustics.priors import NORMAL_90
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.finder.apply import corrected_geometry
from rtcal.finder.case import LEVELS, Case, PositionsCase, StatesCase
from rtcal.finder.claim import DISTINCT_NATS, Candidate, Reason
from rtcal.finder.evidence import SCALES, probability_off
from rtcal.finder.finding import LEAST_PAIRS, Finding, feature_names, rivals, support
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
from rtcal.finder.positions.search import find_by_positions
from rtcal.finder.states import find as find_change
from rtcal.loop.measured_pairs import Pair, gap_at_pairs, trace_ahead
from rtcal.loop.positions import calibrate_positions
from rtcal.simulators.base import Observations
from rtcal.simulators.base import observe as observe_pairs
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError
from rtcal.support.speed import TaskProgress, single_threaded_blas
from rtcal.support.text import as_sentence, first_of, listed
from rtcal.support.types import Array

LEAST_SHRINKAGE = 0.2
"""Decrease of the mean gap in JND that supports a finding at least, however well it is known: a gap
that goes from 1.75 to 1.74 JND supports nothing."""
_CONFIDENCE = 0.95
"""Of a gap over pairs that is said to shrink or to grow: one-sided, by Student's t."""
_SURE = 1.645
"""Standard errors by which a gap of means must shrink: the same confidence, of a normal error."""
_PREDICTED = 1.0
"""Mean gap in JND at what was held out, up to which the corrected model of means predicts it."""
_WORDS_OF_MISSES = 3
"""Bands that miss what was measured and are named in a sentence."""
_EXACT = 0.005
"""Gap in JND that is printed as 0.00."""
_MET = 2.0
"""Standard deviations of T within which a calibration has met it."""
_LEAST_NEW = 2
"""Fewest pairs that a finding of two states had not: their scatter tells how sure the gain is."""
_T20 = FEATURES.index(TARGET.key)
_LEVEL_ROWS = [FEATURES.index(name) for name in LEVELS]
MODELS = {
    "before": "as stated",
    "plain": "calibrated",
    "corrected": "corrected and calibrated",
}
"""The models whose gaps are compared at positions, and how each is called."""


@dataclass(frozen=True)
class Gap:
    """The mean absolute gap in JND of one quantity, at one place or all, by model.

    ``used`` is "matched" of what plain calibration matches, "held out" of what a model predicts that
    was not fitted to it, else "". ``spread`` is the standard deviation over the simulator's seeds.
    """

    quantity: str
    place: str
    values: tuple[float, ...]
    used: str = ""
    spread: tuple[float, ...] = ()

    @property
    def row(self) -> Row:
        """Quantity and place with the gap of each model."""
        name = " of ".join(filter(None, (self.quantity, self.place)))
        values = self.spread or (np.nan,) * len(self.values)
        cells = [
            f"{value:.2f}" + (f" ± {spread:.2f}" if np.isfinite(spread) else "")
            for value, spread in zip(self.values, values, strict=True)
        ]
        return Row(f"{name} ({self.used})" if self.used else name, cells)


@dataclass(frozen=True)
class Miss:
    """A band in which the model with what was found misses what it was matched to.

    Attributes
    ----------
    quantity, place : str
        "T20", and where: the name of a configuration; "" where there is one.
    frequency : float
        Centre frequency in Hz.
    model, measured, uncertainty : float
        In the quantity's ``unit``; the standard uncertainty of what was measured.
    jnd : float
        The gap in JND, signed.
    unit : str
    """

    quantity: str
    place: str
    frequency: float
    model: float
    measured: float
    uncertainty: float
    jnd: float
    unit: str

    @property
    def in_words(self) -> str:
        """The band with both values: "T20 at 500 Hz is 0.53 s, measured 0.645 ± 0.013 s"."""
        at = f"{self.quantity} at {bands.label(self.frequency)}"
        at += f' of "{self.place}"' if self.place else ""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{at} is {self.model:.3g}{unit}, measured {self.measured:.3g} ± "
            f"{self.uncertainty:.2g}{unit}"
        )


def _missed(
    quantity: str,
    place: str,
    unit: str,
    bands_and_values: tuple[Array, Array, Array, Array],
    jnd: Array,
    error: Array,
) -> list[Miss]:
    """Return the bands whose gap in JND exceeds 1 JND and its standard ``error``, which is in JND, too.

    Centre frequencies, model, measured and uncertainty are of all bands, (n_bands,).
    """
    far = np.isfinite(jnd) & (np.abs(jnd) > np.maximum(1.0, np.nan_to_num(error)))
    columns = (of[far].tolist() for of in (*bands_and_values, jnd))
    return [
        Miss(quantity, place, f, model, measured, u, by, unit)
        for f, model, measured, u, by in zip(*columns, strict=True)
    ]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Verification(Result):
    """The gap with and without what was found, at data that it was not fitted to.

    Attributes
    ----------
    finding : Finding
    models : tuple of str
        How each model is called; the last has what was found, the one before it has not.
    held_out : tuple of str
        What was held out, in words; () where nothing could be.
    before, after : float
        Mean absolute gap in JND at what was held out, without and with what was found; NaN where
        nothing was.
    gain, uncertainty : float
        The decrease of the gap and its standard error, in JND.
    needed, endured : float
        The decrease of the gap in JND that supports the finding, and the increase that withdraws it.
    quantities : tuple of Gap
    misses : tuple of Miss
        What the model with what was found was matched to, and misses.
    doubts : tuple of str
        Why the finding is not supported, beside gap and misses, a clause each.
    found_again : str
        The things that parts of the data found, where these are others, in words.
    but : str
        What a support leaves open, in words.
    notes : tuple of str
    gaps : array (n_models, n_seeds, n_parameters, n_pairs, n_bands)
        Model less measured in JND at pairs, NaN where nothing was measured; empty of means over
        positions.
    plain, corrected : Recalibrated or None
        Of means over positions: the calibrations to all data without and with what was found.
    details : mapping of str to plain values
        What its kind has beside these, as `to_dict` returns it.
    """

    record_kind: ClassVar[str] = "verification 5"

    finding: Finding
    models: tuple[str, ...]
    held_out: tuple[str, ...]
    before: float
    after: float
    gain: float
    uncertainty: float
    needed: float
    endured: float
    quantities: tuple[Gap, ...] = ()
    misses: tuple[Miss, ...] = ()
    doubts: tuple[str, ...] = ()
    found_again: str = ""
    but: str = ""
    notes: tuple[str, ...] = ()
    gaps: Array = field(default_factory=lambda: np.zeros((0, 0, 0, 0, 0)))
    plain: Recalibrated | None = None
    corrected: Recalibrated | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def calibrations(self) -> tuple[Recalibrated, ...]:
        """Of means, the calibrations to all data without and with what was found; else ()."""
        return tuple(c for c in (self.plain, self.corrected) if c is not None)

    @property
    def verdict(self) -> str:
        """``supported``: the gap shrinks by more than is `needed`, and there is no objection.

        ``withdrawn``: it grows. ``unproven``: it changes by less, or there are `objections`.
        ``not tested``: nothing was measured that the finding was not fitted to.
        """
        if np.isnan(self.before):
            return "not tested"
        if -self.gain > self.endured:
            return "withdrawn"
        return "unproven" if self.objections else "supported"

    @property
    def objections(self) -> tuple[str, ...]:
        """Why the finding is not supported, a clause each; () where it is."""
        little = self.gain <= self.needed
        return (
            *([f"only a decrease by more than {self.needed:.2f} JND counts"] if little else ()),
            *self.doubts,
            *(["the corrected model misses what it was matched to"] if self.misses else ()),
        )

    @property
    def misses_in_words(self) -> str:
        """A sentence on what the model misses, with the consequence; "" where it meets all."""
        if not self.misses:
            return ""
        worst = sorted(self.misses, key=lambda miss: -abs(miss.jnd))
        said = first_of([miss.in_words for miss in worst], _WORDS_OF_MISSES)
        return f"Do not simulate with it: with what was found {said}."

    @property
    def sentence(self) -> str:
        """The verdict, the change of the gap with its standard error, and what speaks against it."""
        if np.isnan(self.before):
            said = [
                "Not tested: what was found was fitted to all that was measured. Measure C80 or G, or "
                "a second configuration. The finding rests on T and on the stated coefficients."
            ]
        else:
            supported = self.verdict == "supported"
            verb = "shrinks" if self.gain > 0 else "grows"
            grounds = self.objections[: -1 if self.misses else None]
            said = [
                f"{self.verdict.capitalize()}{self.but if supported else ''}: {self.found_again}at "
                f"data that it was not fitted to ({listed(self.held_out)}) the mean gap {verb} with "
                f"what was found from {self.before:.2f} to {self.after:.2f} JND, by "
                f"{abs(self.gain):.2f} ± {self.uncertainty:.2f} JND (standard error)"
                f"{f'; more than {self.needed:.2f} JND counts' if supported else ''}.",
                as_sentence(listed(grounds)) if grounds else "",
                "The model is better; the name may still be wrong." if supported else "",
            ]
        return " ".join(filter(None, [*said, self.misses_in_words]))

    @property
    def by_seed(self) -> Array:
        """Mean absolute gap at pairs in JND by model and seed of the simulator, (n_models, n_seeds)."""
        return np.asarray(np.nanmean(np.abs(self.gaps), axis=(2, 3, 4)))

    @property
    def table(self) -> Table:
        """The mean gaps by quantity and place, and all that was held out, by model."""
        rows = [gap.row for gap in self.quantities]
        if np.isfinite(self.before) and not len(self.gaps):
            rows.append(Row("all that was held out", [self.before, self.after], ".2f"))
        return Table(self.models, rows, corner="mean gap / JND")

    def blocks(self) -> list[Block]:
        """Return what the result says."""
        table = [self.table] if self.quantities else []
        out: list[Block] = [Note(self.sentence), *map(Note, self.notes), *table]
        return out if self.corrected is None else [*out, *self.corrected.blocks(self.plain)]

    def __repr__(self) -> str:
        return (
            f"<Verification {self.verdict}: {self.finding.best_effect}; gap {self.before:.2f} to "
            f"{self.after:.2f} JND>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        calibrated = {"plain": self.plain, "corrected": self.corrected}
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "misses": [dict(vars(miss)) for miss in self.misses],
            "least_shrinkage_jnd": LEAST_SHRINKAGE,
            "finding": self.finding.to_dict(),
            "held_out": list(self.held_out),
            "before_jnd": json_numbers(self.before),
            "after_jnd": json_numbers(self.after),
            "gain_jnd": json_numbers(self.gain),
            "uncertainty_jnd": json_numbers(self.uncertainty),
            "objections": [] if np.isnan(self.before) else list(self.objections),
            **self.details,
            **{name: of.to_dict() for name, of in calibrated.items() if of is not None},
        }


def verify(finding: Finding, case: Case | None = None, **options: Any) -> Verification:
    """Verify a finding: by data that it was not fitted to.

    Parameters
    ----------
    finding : Finding
    case : Case, optional
        Of means: with further parameters or bands of the same configurations, which are then held out;
        by default the finding's own, parts of which are held out in turn.
    **options
        At positions: ``seeds`` of the simulator, over which the spread is the noise of the tracing;
        ``cache`` and ``progress`` as for `rtcal.find`. Of two states: ``before`` and ``after``, of
        which the finding predicts the pairs that it had not; ``seed`` of the samples from which the
        intervals come.

    Raises
    ------
    DataError
        Where there is nothing to add; of two or more effects; for fewer than four pairs, or fewer than
        two that are new; where one of two states is missing, or ``case`` has other configurations or
        bands.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1] * 2],
    ...                sigma=[[0.05] * 2], centre_frequencies=[500, 1000])
    >>> pairs = [("S1", "R1"), ("S1", "R2"), ("S2", "R1"), ("S2", "R2")]
    >>> before, after = (
    ...     rt.Measurement(centre_frequencies=[500, 1000], values={"t20": t}, pairs=pairs)
    ...     for t in ([[1.5, 1.4], [1.4, 1.4], [1.5, 1.3], [1.6, 1.5]],
    ...               [[0.8, 0.7], [0.8, 0.7], [0.7, 0.7], [0.8, 0.7]])
    ... )
    >>> print(verify(rt.find(room, after, before=before)).verdict)
    supported
    """
    if finding.kind == "positions":
        return _verify_at_positions(finding, **options)
    if finding.kind == "states":
        return _verify_states(finding, **options)
    return _verify_means(finding, case, **options)


# Means over positions.


@single_threaded_blas()
def _verify_means(finding: Finding, case: Case | None = None) -> Verification:
    """Compare the model with and without the best effect."""
    if not finding.can_be_added:
        raise DataError(f'the verdict is "{finding.verdict}"; there is no effect to add')
    if len(finding.members) > 1:
        raise DataError(
            f"{len(finding.members)} effects were found together; the gap is compared for one: search "
            "with most = 1"
        )
    own: Case = finding.case
    case = own if case is None else case
    observed, fitted = observe(case)[0], observe(own)[0]
    if fitted.used.shape != observed.used.shape:
        raise DataError(
            f"case has {len(case.configurations)} configurations in {case.room.n_bands} bands; the "
            f"finding has {len(own.configurations)} in {own.room.n_bands}"
        )
    before, after = plain(case), recalibrate(finding.with_effects(case), finding.discrepancy)
    bias = finding.discrepancy.bias.reshape(observed.features.shape)
    every = np.array(observed.used, dtype=bool)
    quantities = _gaps_of_means(case, observed, bias, before, after, every, held_out=False)
    parts = _parts_of(case, observed, fitted)
    held, uncertainty, predictive = list[Gap](), 0.0, 0.0
    for part in parts:
        gaps, check = _predicted_part(finding, case, observed, part, before)
        held += gaps
        uncertainty += check.uncertainty * len(gaps)
        predictive += check.predictive
    by_name = {(g.place, g.quantity): g for g in (*quantities, *held)}
    return of_means(
        finding,
        list(by_name.values()),
        uncertainty / len(held) if held else float("nan"),
        predictive,
        _misses_of_means(case, observed, bias, after),
        [part.words for part in parts],
        before=before,
        after=after,
    )


def of_means(
    finding: Finding,
    quantities: Sequence[Gap],
    uncertainty: float,
    predictive: float,
    misses: Sequence[Miss],
    held_out: Sequence[str],
    *,
    before: Recalibrated,
    after: Recalibrated,
) -> Verification:
    """Return what the gaps of means say of a finding.

    ``uncertainty`` is the standard error of the gap's change in JND, by measurement, model and the
    effect's size, and ``predictive`` the nats by which the effect predicts what was ``held_out`` better
    than the model without it. ``before`` and ``after`` are the calibrations without and with it.
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
        needed = {"nats": predictive, "least": DISTINCT_NATS}
        doubts.append(str(Reason("not predicted", needed)))
    if finding.verdict not in ("named", "family"):
        doubts.append("no effect and no family of effects is claimed")
    configurations = finding.case.configurations
    times, left = reverberation_times(finding, before, after), residual_map(finding, after)
    others = [c.effect for c in rivals(finding)]
    return Verification(
        finding=finding,
        models=("plain", "corrected"),
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
        but=f", but not told apart from {listed(others)}" if others else "",
        notes=(
            f"It is {support(finding, finding.candidates[0])}.",
            _fitted_in_words(finding, quantities, after),
        ),
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


def _fitted_in_words(finding: Finding, quantities: Sequence[Gap], after: Recalibrated) -> str:
    """Return the misfit of the two calibrations to the T that they were fitted to, in words."""
    time = finding.case.configurations[0].measured.time_label
    if after.off > _MET:
        return (
            f"The corrected model does not meet the fitted {time}: it is {after.off:.1f} times as far "
            "off as the uncertainty of T allows. So no coefficients near the stated ones go with this "
            "effect and size."
        )
    gap = next((gap.values[0] for gap in quantities if gap.used == "matched"), 0.0)
    how = "exactly" if gap < _EXACT else f"to {gap:.2f} JND"
    return (
        f"Plain calibration meets the fitted {time} {how}. The corrected one meets it as closely as "
        "the uncertainty of T allows."
    )


def residual_map(finding: Finding, after: Recalibrated) -> Array:
    """Return corrected model less measured over its standard deviation, as `Finding.residuals`."""
    case = finding.with_effects()
    predicted = replace(predict_hypotheses(case, []), features=after.features[None])
    problem = MeansProblem(case, observe(case)[0], predicted, finding.discrepancy)
    return problem.standardized_residuals()


def reverberation_times(
    finding: Finding, before: Recalibrated, after: Recalibrated
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


def _gaps_of_means(
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


def _misses_of_means(
    case: Case, observed: ObservedFeatures, bias: Array, corrected: Recalibrated
) -> tuple[Miss, ...]:
    """Return the T to which the corrected model was matched and which it misses."""
    u = np.full(observed.used.shape, np.nan)
    u[observed.used] = np.sqrt(np.diag(observed.covariance))
    out, several = list[Miss](), len(case.configurations) > 1
    for c, configuration in enumerate(case.configurations):
        model = corrected.features[c, _T20] + bias[c, _T20]
        measured = np.where(observed.used[c, _T20], observed.features[c, _T20], np.nan)
        time, spread = np.exp(measured), u[c, _T20]
        out += _missed(
            configuration.measured.time_label,
            configuration.name if several else "",
            "s",
            (case.room.centre_frequencies, np.exp(model), time, time * spread),
            gap_in_jnd(_T20, measured, model),
            spread / TARGET.jnd,
        )
    return tuple(out)


def gap_in_jnd(feature: int, measured: Array, modelled: Array) -> Array:
    """Return the gap of a row of `FEATURES` in JND, signed."""
    jnd = observable(FEATURES[feature]).jnd
    if feature < 3:  # relative, from logarithms
        return np.asarray((np.exp(modelled - measured) - 1) / jnd)
    return np.asarray((modelled - measured) / jnd)


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """A part of the data that the effect is not fitted to.

    ``hidden`` and ``counted`` (n_configurations, n_features, n_bands) are what the effect is not fitted
    to, and what of it counts. ``configurations`` are the numbers of those that no model is calibrated
    to, and ``refitted`` is whether the effect is fitted anew without the part.
    """

    words: str
    hidden: NDArray[np.bool_]
    counted: NDArray[np.bool_]
    configurations: tuple[int, ...] = ()
    refitted: bool = True


def _parts_of(case: Case, observed: ObservedFeatures, fitted: ObservedFeatures) -> list[_HeldOut]:
    """Return the parts of the data that can be held out of what the finding was ``fitted`` to."""
    used = np.array(observed.used, dtype=bool)
    further = used & ~np.array(fitted.used, dtype=bool)
    further[0, 0] = False  # alpha fits T20 of the first configuration, whatever is missing
    if further.any():
        return [_HeldOut("what was not in the search", further, further, refitted=False)]
    out = []
    levels = np.zeros_like(used)
    levels[:, _LEVEL_ROWS] = used[:, _LEVEL_ROWS]
    if levels[0].any():
        counted = np.zeros_like(used)
        counted[0] = levels[0]
        rows = zip(LEVELS, _LEVEL_ROWS, strict=True)
        names = [name.upper() for name, row in rows if used[0, row].any()]
        out.append(_HeldOut(" and ".join(names), levels, counted))
    for c, configuration in enumerate(case.configurations[1:], 1):
        whole = np.zeros_like(used)
        whole[c] = used[c]
        out.append(_HeldOut(f'configuration "{configuration.name}"', whole, whole, (c,)))
    return out


def _predicted_part(
    finding: Finding,
    case: Case,
    observed: ObservedFeatures,
    part: _HeldOut,
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
    gaps = _gaps_of_means(case, observed, bias, before, after, part.counted)
    predicted = predict_hypotheses(case, effects, [[found.parameters]] if effects else None)
    problem = MeansProblem(case, observed, predicted, finding.discrepancy)
    scale = SCALES[0][0] if found.coefficients is not None else 1.0
    return gaps, gap_check(problem, 1 if effects else 0, scale, part.counted[observed.used])


# Pairs of positions.


def _check_pairs(pairs: Sequence[object]) -> None:
    if len(pairs) < LEAST_PAIRS:
        raise DataError(
            f"there are {len(pairs)} pairs; {LEAST_PAIRS} are needed, half of which predict the others"
        )


def _gain_over_pairs(gains: Array) -> dict[str, Any]:
    """Return `Verification.gain`, ``uncertainty``, ``needed`` and ``endured``, of gains at pairs.

    ``gains`` (n_seeds, n_pairs) are decreases of the mean absolute gap in JND. The standard error is
    over pairs and, of two seeds and more, over seeds. More than it is needed, one-sided, by Student's t
    over the pairs, and `LEAST_SHRINKAGE`.
    """
    n_seeds, n_pairs = gains.shape
    of_pairs = gains.mean(axis=0).std(ddof=1) / np.sqrt(n_pairs)
    of_seeds = gains.mean(axis=1).std(ddof=1) / np.sqrt(n_seeds) if n_seeds > 1 else 0.0
    error = float(np.hypot(of_pairs, of_seeds))
    needed = max(LEAST_SHRINKAGE, error * float(stats.t.ppf(_CONFIDENCE, n_pairs - 1)))
    gain = float(gains.mean())
    return {"gain": gain, "uncertainty": error, "needed": needed, "endured": needed}


def _misses_over_pairs(
    matched: Mapping[str, tuple[Array, Array]],
    pairs: Sequence[Pair],
    frequencies: Array,
    times: Array | None = None,
    prediction: Array | float = 0.0,
) -> tuple[Miss, ...]:
    """Return the means over pairs that a model misses.

    Their variance is the larger of that over the pairs, of which as many are independent as there are
    sources or receivers, and of that of noise in as many responses (ISO 3382-2).

    Parameters
    ----------
    matched : mapping of str to two arrays
        For each parameter the mean measured over the pairs, (n_bands,), and what is left of the gap,
        (n_pairs, n_bands), signed and in JND.
    pairs : sequence of (source, receiver)
    frequencies : array (n_bands,)
        Hz.
    times : array (n_bands,), optional
        T in s by which a response is noisy; by default that among ``matched``.
    prediction : array (n_bands,) or float
        Standard deviation in JND that the model states for itself; 0 of a calibrated one.
    """
    out = list[Miss]()
    independent = max(len({s for s, _ in pairs}), len({r for _, r in pairs}))
    if times is None:
        slopes = (m for p, (m, _) in matched.items() if isinstance(observable(p), DecaySlope))
        times = next(slopes, None)
    for name, (measured, gaps) in matched.items():
        of = observable(name)
        step = of.jnd * measured if of.relative_jnd else np.full(len(measured), of.jnd)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a band without a value
            mean = np.nanmean(gaps, axis=0)
            error = np.nanstd(gaps, axis=0, ddof=1) / np.sqrt(independent)
        if times is not None:
            one = of.scatter(frequencies, times) * (measured if of.logarithmic else 1.0)
            error = np.fmax(error, one / step / np.sqrt(len(pairs)))
        error = np.hypot(error, prediction)
        values = (frequencies, measured + step * mean, measured, step * np.nan_to_num(error))
        out += _missed(of.label, "", of.unit, values, mean, error)
    return tuple(out)


# Every position.


def _verify_at_positions(
    finding: Finding,
    *,
    seeds: Sequence[int] = (0,),
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
) -> Verification:
    chosen = tuple(checks.whole("seeds", s, 0) for s in checks.listed("seeds", seeds))
    if not chosen:
        raise DataError("seeds is empty; it has at least one")
    if len(set(chosen)) < len(chosen):
        raise DataError(f"seeds has one twice: {', '.join(map(str, chosen))}")
    if finding.refusal is not None:
        raise DataError(str(finding.refusal))
    _check_pairs(finding.pairs)
    case: PositionsCase = finding.case
    halves, tried = _halves_of(finding.pairs), tuple(finding.effects.values())
    steps, done = len(halves) + len(chosen) * (1 + 2 * len(halves)), 0

    def finished(what: str) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(what, done, steps)

    added = list[Candidate | None]()
    for half in halves:
        again = find_by_positions(
            case.only(half), tried, finding.controls, cache, chosen[0], finding.left_out
        )
        added.append(next((c for c in again.candidates if c.can_be_added), None))
        finished("search in half of the pairs")
    gaps = _gaps_at_positions(finding, halves, added, chosen, finished)
    return at_positions(finding, gaps, added, halves, chosen)


def at_positions(
    finding: Finding,
    gaps: Array,
    added: Sequence[Candidate | None],
    halves: Sequence[Sequence[Pair]],
    seeds: Sequence[int],
) -> Verification:
    """Return what the gaps at pairs that were not fitted say of a finding.

    ``gaps`` (n_models, n_seeds, n_parameters, n_pairs, n_bands) are simulated less measured in JND at
    held-out pairs, of each of `MODELS`. ``added`` is what each half added to its model; None where it
    found no surface.
    """
    size, pairs, parameters = np.abs(gaps), finding.pairs, finding.parameters
    before, plainly, after = np.nanmean(size, axis=(2, 3, 4)).mean(axis=1).tolist()
    without, with_it = (np.nanmean(each, axis=(1, 3)) for each in size[1:])
    by_seed = np.nanmean(size, axis=(3, 4))
    spread = by_seed.std(axis=1, ddof=1) if len(seeds) > 1 else np.full(by_seed[:, 0].shape, np.nan)
    by_parameter = np.nanmean(size, axis=(1, 3, 4))
    by_pair = np.nanmean(size, axis=(1, 2, 4))
    measured = Observations.of_measurement(finding.case.in_room, parameters, pairs)
    relative = LEVEL.key if LEVEL.key in finding.case.measured.values else ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a band without a value
        left = np.nanmean(gaps[-1], axis=0)
        matched = {
            name: (np.nanmean(measured.natural(name), axis=0), left[p])
            for p, name in enumerate(parameters)
            if name != relative  # its mean over the pairs is taken off
        }
    doubts, but, again = _found_again(finding, added)
    n_seeds = "1 seed" if len(seeds) == 1 else f"{len(seeds)} seeds"
    notes = [
        f"± is the standard error over {len(pairs)} pairs and {n_seeds} of the simulator. As stated, "
        f"the gap is {before:.2f} JND."
    ]
    if before < plainly:
        notes.append(
            "Calibrated, the model is no better there than as stated: do not simulate with it."
        )
    for half, what in zip(halves, added, strict=True):
        names = ", ".join(" to ".join(pair) for pair in half)
        said = "nothing" if what is None else f"{what.title}, {what.in_words}"
        notes.append(f"Fitted on {names}: added {said}.")
    named = zip(parameters, by_parameter.T.tolist(), spread.T.tolist(), strict=True)
    quantities = [Gap(parameter_label(n), "", tuple(v), "", tuple(off)) for n, v, off in named]
    quantities.append(Gap("all", "", (before, plainly, after)))
    each = zip(pairs, by_pair.T.tolist(), strict=True)
    quantities += [Gap(" to ".join(pair), "", tuple(values)) for pair, values in each]
    return Verification(
        finding=finding,
        models=tuple(MODELS.values()),
        held_out=("pairs that were not fitted",),
        before=plainly,
        after=after,
        **_gain_over_pairs(without - with_it),
        quantities=tuple(quantities),
        misses=_misses_over_pairs(matched, pairs, finding.case.room.centre_frequencies),
        doubts=doubts,
        but=but,
        found_again=again,
        notes=tuple(notes),
        gaps=gaps,
        details={
            "pairs": [list(p) for p in pairs],
            "seeds": list(seeds),
            "halves": [[list(p) for p in half] for half in halves],
            "gaps_jnd": dict(zip(MODELS, np.nanmean(size, axis=(2, 3, 4)).tolist(), strict=True)),
            "by_parameter_jnd": {
                model: dict(zip(parameters, values, strict=True))
                for model, values in zip(MODELS, by_parameter.tolist(), strict=True)
            },
            "by_pair_jnd": dict(zip(MODELS, by_pair.tolist(), strict=True)),
            "added": [None if c is None else c.to_dict() for c in added],
        },
    )


def _found_again(
    finding: Finding, added: Sequence[Candidate | None]
) -> tuple[tuple[str, ...], str, str]:
    """Return doubts, what a support leaves open, and what halves found that is other, in words.

    The same thing is of the same family, all of added absorption as one; where a surface is claimed,
    also on that surface, or on one that these positions do not tell from it.
    """
    found, claimed = finding.likeliest, finding.surface
    if found is None:
        return (), "", ""
    alike = {claimed}.union(*(g for g in finding.groups if claimed in g))
    others = differing = [
        c
        for c in added
        if c is None or c.kind != found.kind or not (claimed is None or c.surface in alike)
    ]
    if not differing:
        others = [c for c in added if c is not None and c.surface != found.surface]
    if not others:
        return (), "", ""
    each = listed([*dict.fromkeys("nothing" if c is None else c.title for c in others)])
    which = "the halves of the pairs" if len(others) > 1 else "half of the pairs"
    again = f"{which} found {each}, not {found.title} as all pairs did; "
    if differing:
        return ("the halves of the pairs found another thing than all pairs",), "", again
    return (), f" for {found.kind}, not for its surface", again


def _gaps_at_positions(
    finding: Finding,
    halves: Sequence[Sequence[Pair]],
    added: Sequence[Candidate | None],
    seeds: Sequence[int],
    finished: Callable[[str], None],
) -> Array:
    """Return the gaps at held-out pairs, (n_models, n_seeds, n_parameters, n_pairs, n_bands).

    A relative level has its mean over each source's pairs taken off.
    """
    case: PositionsCase = finding.case
    gaps = np.full((len(MODELS), len(seeds), *finding.map.shape), np.nan)
    relative = LEVEL.key in case.measured.values

    def compare(model: int, n: int, simulated: Observations, half: Sequence[Pair]) -> None:
        left = [p for p in finding.pairs if p not in half]
        measured = Observations.of_measurement(case.in_room, finding.parameters, left)
        columns = [finding.pairs.index(p) for p in left]
        at_left = gap_at_pairs(simulated.at(measured).values, measured, relative=relative)
        gaps[model, n][:, columns] = at_left

    # A gap is not to be that of the tracing's noise. The paths of a seed are traced once for all models
    # in the stated geometry.
    stated = case.simulator.denser()
    with_added = [
        stated if best is None else corrected_geometry(case.only(half), best).simulator().denser()
        for half, best in zip(halves, added, strict=True)
    ]
    names = [*MODELS.values()]
    for n, seed in enumerate(seeds):
        trace_ahead(stated, stated.room.alpha, seed)
        as_stated = observe_pairs(stated, stated.room.alpha, finding.parameters, seed=seed)
        finished(names[0])
        for half, simulator in zip(halves, with_added, strict=True):
            compare(0, n, as_stated, half)
            for model, tracer in enumerate((stated, simulator), 1):
                compare(model, n, calibrated_at(case.only(half), tracer, finding, seed), half)
                finished(names[model])
    return gaps


def _halves_of(pairs: Sequence[Pair]) -> tuple[tuple[Pair, ...], ...]:
    """Return two halves with every source in both: every second receiver of each source.

    Sources begin in turn with the first and the second receiver, so that a half has all receivers
    where there are two sources.
    """
    sources = list(dict.fromkeys(s for s, _ in pairs))
    receivers = list(dict.fromkeys(r for _, r in pairs))
    even = tuple((s, r) for s, r in pairs if (sources.index(s) + receivers.index(r)) % 2 == 0)
    return even, tuple(p for p in pairs if p not in even)


def calibrated_at(
    fitted: PositionsCase, simulator: PathTracing, finding: Finding, seed: int
) -> Observations:
    """Return what is simulated at all positions by a model that is calibrated on the fitted pairs."""
    result = calibrate_positions(
        simulator,
        simulator.room,
        fitted.measured,
        finding.parameters,
        exclude=fitted.exclude,
        controls=finding.controls,
        more_paths=1,  # it is denser already
        seed=seed,
    )
    # Its tracer scatters as fitted, with which alpha was calibrated.
    return observe_pairs(result.tracer, result.alpha, finding.parameters, seed=seed)


# Two states.


def _verify_states(
    finding: Finding,
    *,
    before: Measurement | None = None,
    after: Measurement | None = None,
    seed: int = 0,
) -> Verification:
    checks.whole("seed", seed, 0)
    found: StatesCase = finding.case
    if not finding.detected:
        raise DataError(f'the verdict is "{finding.verdict}"; there is no change to verify')
    if (before is None) != (after is None):
        lacking = "before" if before is None else "after"
        raise DataError(f"{lacking} is missing: the change is verified in both states")
    if before is not None and after is not None:
        if seed:
            raise DataError("seed is of halves of the pairs: what was found predicts further pairs")
        found = _at_new_pairs(finding, before, after)
        return _of_states(finding, found, finding.shift, "the other pairs")
    _check_pairs(found.pairs)
    predicted = np.full(found.change.shape, np.nan)
    for half in range(2):
        fitted = _of_pairs(finding.case, found.pairs[half::2])
        effects = tuple(finding.effects.values())
        again = find_change(fitted, effects=effects, seed=seed, without=finding.left_out)
        predicted[1 - half :: 2] = again.shift
    return _of_states(finding, found, predicted, "the other half of the pairs")


def _of_pairs(case: StatesCase, pairs: Sequence[Pair]) -> StatesCase:
    """Return the case of some pairs, of which T alone is compared."""
    before, after = case.before.select(pairs), case.after.select(pairs)
    return replace(case, before=before, after=after, simulator=None, match=MATCH)


def _at_new_pairs(finding: Finding, before: Measurement, after: Measurement) -> StatesCase:
    """Return the case of the pairs that a finding had not; DataError for fewer than two."""
    fitted = finding.case.pairs
    if finding.case.of_means or before.is_summary or after.is_summary:
        raise DataError("means over positions have no pairs that were not fitted")
    new = [p for p in before.pairs if p in after.pairs and p not in fitted]
    if len(new) < _LEAST_NEW:
        raise DataError(
            f"{len(new)} pairs of before and after are not among the {len(fitted)} that were fitted; "
            f"{_LEAST_NEW} are needed"
        )
    return _of_pairs(replace(finding.case, before=before, after=after), new)


def _of_states(finding: Finding, held: StatesCase, predicted: Array, fitted: str) -> Verification:
    """Return what the gaps of T after say of a finding.

    ``predicted`` (n_bands,) or (n_pairs, n_bands) are shifts of ln T at the pairs ``held`` out, which
    the ``fitted`` pairs predict. A gap is as if nothing had changed, and as predicted.
    """
    found, ratio = finding.case, np.exp(held.change)
    gaps = np.stack([gap_jnd(np.ones_like(ratio), ratio), gap_jnd(np.exp(predicted), ratio)])
    # In steps of 1 JND each (ln T), so that states that are exchanged have the same means, gains and
    # misses: a JND of the longer T is another one than of the shorter.
    without, with_change = np.abs(np.log1p(TARGET.jnd * gaps) / np.log1p(TARGET.jnd))
    left = (finding.shift - found.change) / np.log1p(TARGET.jnd)
    return Verification(
        finding=finding,
        models=("if nothing changed", f"with what {fitted} found"),
        held_out=(f"pairs that {fitted} predict",),
        before=float(np.nanmean(without)),
        after=float(np.nanmean(with_change)),
        **_gain_over_pairs(np.nanmean(without - with_change, axis=1)[np.newaxis]),
        misses=_misses_over_pairs(
            {TARGET.key: (found.times[1], left)},
            found.pairs,
            found.room.centre_frequencies,
            # The geometric mean is the same of two states that are exchanged.
            np.sqrt(found.times[0] * found.times[1]),
            _prediction_error(finding),
        ),
        notes=() if found is held else held.notes,
        gaps=gaps[:, np.newaxis, np.newaxis],
        details={
            "pairs": [list(pair) for pair in held.pairs],
            "centre_frequencies": json_numbers(held.room.centre_frequencies),
            "before": json_numbers(gaps[0]),
            "after": json_numbers(gaps[1]),
        },
    )


def _prediction_error(finding: Finding) -> Array:
    """Return the standard deviation in JND of T after, by the interval of the change, (n_bands,).

    The state of the longer T is the first: two states that are exchanged have the same one.
    """
    case: StatesCase = finding.case
    total = case.room.total_area
    air = 4 * case.room.air_attenuation * case.room.volume
    area, sign = finding.area, 1.0
    if not case.falls:
        area, sign = case.equation.absorption_area(case.room, case.times[1]), -1.0
    areas = np.clip(area + sign * finding.change[1:], 0.0, 0.999 * total)
    low, high = total * case.equation.exponent(areas / total) + air
    out = np.abs(np.log(high / low)) / (2 * NORMAL_90 * np.log1p(TARGET.jnd))
    return np.asarray(np.nan_to_num(out))
