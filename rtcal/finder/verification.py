"""Whether the model predicts better with what was found, at data that it was not fitted to.

Calibration changes alpha until T fits, whatever effect is missing, so the gap is that of data that were
held out. A gap that shrinks there shows that the model is better, not that the name is right.

Of means over positions these are C80 and G, and each configuration but the first: the effect is fitted
anew to the rest, both models are calibrated to the rest, and the part is predicted. Of a case with
further parameters or bands these are held out, and the effect stays as it was found. At positions and
of two states half of the pairs search again, and the others are predicted: at positions by a model that
is traced and calibrated anew, of two states by the shift of ln T.

What the user's program gives of the corrected model may take the place of that model. Each run is moved
by what a calibration changes, of means by the equation and at positions by the tracer: the coefficients
of the program are wrong whatever is missing.
"""

from __future__ import annotations

import inspect
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import (
    LEVEL,
    TARGET,
    DecaySlope,
    observable,
    parameter_label,
)
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.run import Run
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.finder.apply import corrected_geometry
from rtcal.finder.case import Case, PositionsCase, StatesCase
from rtcal.finder.claim import DISTINCT_NATS, Candidate, Reason
from rtcal.finder.evidence import probability_off
from rtcal.finder.finding import DATA, LEAST_PAIRS, Finding, feature_names
from rtcal.finder.means.problem import (
    MeansProblem,
    ObservedFeatures,
    covariance_of_run,
    evaluate,
    features_of,
    features_of_values,
    observe,
    predict_hypotheses,
    predict_in,
    state,
)
from rtcal.finder.means.recalibration import LogTimes, Recalibrated, plain, recalibrate
from rtcal.finder.means.search import LITTLE, fit, gap_check
from rtcal.finder.model import FEATURES, LEVELS
from rtcal.finder.positions.search import find_by_positions
from rtcal.finder.states import find as find_change
from rtcal.loop.measured_pairs import ControlRuns, Pair, gap_at_pairs, trace_ahead
from rtcal.loop.positions import calibrate_positions
from rtcal.simulators.base import Observations
from rtcal.simulators.base import observe as observe_pairs
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.normal import symmetric_root
from rtcal.support.speed import TaskProgress, single_threaded_blas
from rtcal.support.text import listed
from rtcal.support.types import Array
from rtcal.support.workers import workforce

LEAST_SHRINKAGE = 0.2
"""Smallest decrease of the mean deviation in JND that supports a finding, however certain the decrease
is."""
_CONFIDENCE = 0.95
"""Of a gap over pairs that is said to shrink or to grow: one-sided, by Student's t."""
SURE = 1.645
"""Standard errors by which a gap of means must shrink: the same confidence, of a normal error."""
_DRAWS = 256  # draws of the noise of measurement and runs
_PREDICTED = 1.0
"""Mean gap in JND at what was held out, up to which the corrected model of means predicts it."""
_LEAST_NEW = 2
"""Fewest pairs that a finding of two states had not: their scatter tells how sure the gain is."""
_T20 = FEATURES.index(TARGET.key)
_LEVEL_ROWS = [FEATURES.index(name) for name in LEVELS]
WORDS = "rtcal.report.verification_words"
"""The module that makes the words of a verification."""
MISSES = "misses"
"""Code of the reason that the corrected model does not have the values to which it was calibrated."""


@dataclass(frozen=True)
class Miss:
    """Hold a band in which the corrected model does not reproduce the values it was calibrated to."""

    quantity: str
    place: str
    """Name of the parameter, such as "T20", and name of the configuration; "" if there is only one."""
    frequency: float
    """Centre frequency in Hz."""
    model: float
    measured: float
    uncertainty: float
    """Modelled and measured value, and the standard uncertainty of the measurement, in ``unit``."""
    jnd: float
    """Modelled minus measured value in JND."""
    unit: str

    def __str__(self) -> str:
        # `report` stands above this package, so its words are looked up when they are printed.
        words: str = import_module(WORDS).of_miss(self)
        return words


def _misses(
    quantity: str,
    place: str,
    frequencies: Array,
    model: Array,
    measured: Array,
    uncertainty: Array,
    unit: str,
    step: Array,
) -> list[Miss]:
    """Return the bands that differ by more than the uncertainty and a ``step`` of 1 JND, (n_bands,)."""
    jnd = (model - measured) / step
    far = np.abs(jnd) > np.maximum(1.0, np.nan_to_num(uncertainty / step))
    columns = (of[far].tolist() for of in (frequencies, model, measured, uncertainty, jnd))
    return [
        Miss(quantity, place, f, value, wanted, u, by, unit)
        for f, value, wanted, u, by in zip(*columns, strict=True)
    ]


def mean_of_known(values: Array, axis: int | tuple[int, ...]) -> Array:
    """Return the mean over ``axis`` of the values that are known; NaN without any."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmean(values, axis=axis))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Verification(Result):
    """Hold the deviations with and without the effect that was found, at data that were held out.

    ``finding`` is the verified result of `rtcal.find`.
    """

    record_kind: ClassVar[str] = "verification 9"
    words_in: ClassVar[str] = WORDS
    in_file: ClassVar[str] = (
        "verdict sentence finding held_out before_jnd=before after_jnd=after gain_jnd=gain "
        "uncertainty_jnd=uncertainty predictive_nats=predictive models quantities places counted added"
    )

    finding: Finding
    models: tuple[str, ...]
    """Names of the compared models. The last one has the effect that was found; the one before it has
    not."""
    held_out: tuple[str, ...]
    """Data that were held out, in words; () if no data could be."""
    quantities: tuple[str, ...]
    places: tuple[str, ...]
    """Names of the compared parameters, and of the pairs or configurations."""
    gaps: Array
    """Deviations, modelled minus measured, in JND, (n_models, n_seeds, n_quantities, n_places,
    n_bands). NaN where nothing was measured. For two states they are in equal steps of ln T."""
    counted: NDArray[np.bool_]
    """Whether the values were held out from every calibration, (n_quantities, n_places)."""
    uncertainty: float
    """Standard error of ``gain`` in JND."""
    needed: float
    endured: float
    """Decrease in JND from which the finding is supported, and increase from which it is withdrawn."""
    predictive: float = float("nan")
    """ln Bayes factor of the effect by the held-out values, for means; NaN of a second run."""
    misses: tuple[Miss, ...] = ()
    """Values to which the model with the effect was calibrated and which it still does not have."""
    halves: tuple[tuple[Pair, ...], ...] = ()
    """Pairs to which each model was fitted, at positions."""
    added: tuple[Candidate | None, ...] = ()
    """Effects that each half of the pairs added to its model, at positions; None for none."""
    notes: tuple[str, ...] = ()
    """Notes on the case that was held out, and on what a second run lacks."""
    uncorrected: Recalibrated | None = None
    corrected: Recalibrated | None = None
    """Calibrations to all data without and with the effect, for means."""
    runs: tuple[str, ...] = ()
    """Names of those ``models`` that are a program's run, which no calibration has moved."""
    features: Array = field(default_factory=partial(np.zeros, 0))
    """Features of the last model with its bias, for means, (n_configurations, n_features, n_bands)."""
    again: Array = field(default_factory=partial(np.zeros, 0))
    """Deviations in JND of a program's second run as it is, (n_quantities, n_places, n_bands)."""
    effect: str = ""
    """Name of the effect that is verified, for means."""
    contained: Candidate | None = None
    """Candidate that a program's second run contains, at positions."""

    @property
    def sizes(self) -> Array:
        """Mean absolute deviation in JND over bands, (n_models, n_seeds, n_quantities, n_places)."""
        return mean_of_known(np.abs(self.gaps), 4)

    @property
    def by_seed(self) -> Array:
        """Mean absolute deviation in JND at held-out data, by model and seed, (n_models, n_seeds)."""
        return mean_of_known(np.where(self.counted, self.sizes, np.nan), (2, 3))

    @property
    def before(self) -> float:
        """Mean absolute deviation in JND without the effect; NaN if no data were held out."""
        return float(self.by_seed[-2].mean())

    @property
    def after(self) -> float:
        """Mean absolute deviation in JND with the effect."""
        return float(self.by_seed[-1].mean())

    @property
    def gain(self) -> float:
        """Decrease of the mean absolute deviation in JND by the effect, negative if it grows."""
        return self.before - self.after

    @property
    def calibrations(self) -> tuple[Recalibrated, ...]:
        """Calibrations to all means, without and with the effect; () for pairs and two states."""
        return tuple(c for c in (self.uncorrected, self.corrected) if c is not None)

    @property
    def verdict(self) -> str:
        """Result in one word: "supported", "withdrawn", "unproven" or "not tested".

        "supported": the deviation decreases by more than `needed`, and there are no `objections`.
        "withdrawn": the deviation grows by more than `endured`, and not `only_scaled`. "unproven": it
        does neither, or there are objections. "not tested": no data could be held out, or calibration
        alone leaves a deviation so small that a second run of your program cannot support the finding.
        """
        if np.isnan(self.before):
            return "not tested"
        if -self.gain > self.endured and not self.only_scaled:
            return "withdrawn"
        if self.again.size and self.little_left:
            return "not tested"
        return "unproven" if self.objections else "supported"

    @property
    def only_scaled(self) -> bool:
        """Whether a second run deviates more than the first only where rtcal has calibrated both.

        As simulated, it deviates less. Image sources in an uneven room have a T that the equation does
        not scale.
        """
        if not self.again.size or self.models[1] in self.runs or self.gain >= 0:
            return False
        held = self.counted[..., np.newaxis] & np.isfinite(self.again)
        first, second = (np.abs(of)[held] for of in (self.gaps[0].mean(axis=0), self.again))
        return bool(np.nanmean(second) < np.nanmean(first))

    @property
    def little_left(self) -> bool:
        """Whether the first run deviates too little for a second test, once it is calibrated."""
        means_or_run = self.uncorrected is not None or self.again.size > 0
        return means_or_run and self.finding.case.has_run and self.before <= self.needed

    @property
    def objections(self) -> tuple[Reason, ...]:
        """Reasons why the finding is not supported; () if it is."""
        code = "little left" if self.little_left else "gains little"
        limits = {"least": self.needed, "before": self.before}
        out = [] if self.gain > self.needed else [Reason(code, limits)]
        if self.uncorrected is not None:
            if self.after > _PREDICTED:
                out.append(Reason("still missed", {"gap": self.after}))
            held_out = mean_of_known(np.where(self.counted, self.sizes[-2:, 0], np.nan), 2)
            for quantity, (one, other) in zip(self.quantities, held_out.T, strict=True):
                if other - one > LEAST_SHRINKAGE:
                    values = {"quantity": quantity, "before": one, "after": other}
                    out.append(Reason("grows", values))
            if self.predictive < DISTINCT_NATS:
                needed = {"nats": self.predictive, "least": DISTINCT_NATS}
                out.append(Reason("not predicted", needed))
            if self.finding.verdict not in ("named", "family"):
                out.append(Reason("nothing claimed"))
        out += [Reason("halves differ")] if self.found_elsewhere[1] else ()
        return (*out, *([Reason(MISSES)] if self.misses else ()))

    @property
    def found_elsewhere(self) -> tuple[list[Candidate | None], bool]:
        """Other effects that halves of the pairs found, and whether they contradict the finding.

        They do if their group is another one, or if the finding identifies a surface and they are
        on one that these positions distinguish from it.
        """
        found = (self.contained or self.finding.likeliest) if self.added else None
        if found is None:
            return [], False
        claimed = self.finding.surface
        alike = {claimed}.union(*(g for g in self.finding.groups if claimed in g))
        differing = [
            c
            for c in self.added
            if c is None or c.kind != found.kind or not (claimed is None or c.surface in alike)
        ]
        if differing:
            return differing, True
        return [c for c in self.added if c is not None and c.surface != found.surface], False

    @property
    def sentence(self) -> str:
        """Verdict, change of the deviation with its standard error, and objections, as a sentence."""
        words: str = import_module(WORDS).sentence(self)
        return words

    def __repr__(self) -> str:
        name = self.effect or self.finding.best_effect
        return (
            f"<Verification {self.verdict}: {name}; gap {self.before:.2f} to {self.after:.2f} JND>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the verification as plain values for JSON; deviations are means over the seeds."""
        calibrated = {"uncorrected": self.uncorrected, "corrected": self.corrected}
        return {
            **super().to_dict(),
            "misses": [dict(vars(miss)) for miss in self.misses],
            "least_shrinkage_jnd": LEAST_SHRINKAGE,
            "objections": [] if np.isnan(self.before) else [str(o) for o in self.objections],
            "gaps_jnd": json_numbers(self.sizes.mean(axis=1)),
            **{name: of.to_dict() for name, of in calibrated.items() if of is not None},
        }


def verify(finding: Finding, case: Case | None = None, **options: Any) -> Verification:
    """Check whether the effect that was found improves the model at data that were held out.

    The model without and with the effect is calibrated to a part of the data. The effect is supported
    if the model with it deviates less from the other, held-out part. Which arguments apply depends on
    the data that `rtcal.find` compared with the model: means over positions, values at positions, or
    two measurements of the room.

    Parameters
    ----------
    finding : Finding
        Result of `rtcal.find`.
    case : Case, optional
        Case with further parameters or bands of the same configurations, which are then held out; for
        means only. By default parts of the finding's case are held out in turn.

    Other Parameters
    ----------------
    effect : str
        For means: name of a candidate in place of the most probable one. For values at positions: the
        name that you gave to `Finding.apply`.
    at : (x, y, z)
        For values at positions: the position that you gave to `Finding.apply`.
    simulated : Measurement
        If a program's values were given to `rtcal.find`: its values for the corrected model, in the
        first configuration.
    calibrated : Measurement
        With ``simulated``: the program's values for the model that was calibrated without the
        correction. By default rtcal scales the program's values to the measured T (means), or
        calibrates them by path tracing to half of the pairs (positions).
    seeds : sequence of int
        For values at positions: seeds of the simulator, whose spread shows its noise; (0,) by default.
    cache, progress, scheduler : path, function, str
        For values at positions: arguments as for `rtcal.find`.
    before, after : Measurement
        For two measurements of the room: measurements with further pairs, which the finding predicts.
    seed : int
        For two measurements of the room: seed of the random numbers, 0 by default.

    Returns
    -------
    Verification
        Deviations of both models from the held-out data, and the ``verdict``, such as "supported".

    Raises
    ------
    DataError
        If the finding has no effect to add, or two or more; for fewer than four pairs, or fewer than
        two new ones; if only one of ``before`` and ``after`` is given; if ``case`` has other
        configurations or bands; if ``simulated`` equals the first simulation; if ``effect`` is not a
        candidate; for an option that does not apply to the finding.

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
    of_kind: dict[str, Callable[..., Verification]] = {
        "means": _of_means,
        "positions": _at_positions,
        "states": _of_states,
    }
    compare = of_kind[checks.instance("finding", finding, Finding).kind]
    options |= {} if case is None else {"case": case}
    for name in options.keys() - inspect.signature(compare).parameters.keys():
        raise DataError(f"{name} cannot be used with a finding from {DATA[finding.kind]}")
    return compare(finding, **options)


# Means over positions.


class _Part(NamedTuple):
    """A part of the data that the effect is not fitted to: what is hidden, and what of it counts."""

    words: str
    hidden: NDArray[np.bool_]
    counted: NDArray[np.bool_]
    configurations: tuple[int, ...] = ()


def _parts_of(case: Case, used: NDArray[np.bool_], fitted: NDArray[np.bool_]) -> list[_Part]:
    """Return the parts of the data that can be held out of what the finding was ``fitted`` to."""
    further = used & ~fitted
    further[0, 0] = False  # alpha fits T20 of the first configuration, whatever is missing
    if further.any():
        return [_Part("what was not in the search", further, further)]
    out = []
    levels = np.zeros_like(used)
    levels[:, _LEVEL_ROWS] = used[:, _LEVEL_ROWS]
    if levels[0].any():
        counted = np.zeros_like(used)
        counted[0] = levels[0]
        rows = zip(LEVELS, _LEVEL_ROWS, strict=True)
        names = [name.upper() for name, row in rows if used[0, row].any()]
        out.append(_Part(" and ".join(names), levels, counted))
    for c, configuration in enumerate(case.configurations[1:], 1):
        whole = np.zeros_like(used)
        whole[c] = used[c]
        out.append(_Part(f'configuration "{configuration.name}"', whole, whole, (c,)))
    return out


MODELS = ("input", "calibrated", "corrected and calibrated")
"""Names of the models whose deviations are compared."""
OF_RUNS = ("as simulated", "calibrated", "corrected")
"""Names of the models whose deviations are compared, if your program simulated the corrected model."""


@single_threaded_blas()
def _of_means(
    finding: Finding,
    case: Case | None = None,
    *,
    simulated: Measurement | None = None,
    calibrated: Measurement | None = None,
    effect: str | None = None,
) -> Verification:
    """Compare the model with and without the best effect, or another one."""
    if not finding.can_be_added and effect is None:
        raise DataError(f'nothing was found that can be verified (verdict "{finding.verdict}")')
    if simulated is not None and effect is None and finding.undecided is not None:
        raise DataError(
            "effect is missing: name the effect that the second simulation contains. "
            f"{finding.undecided}"
        )
    (name, *others) = finding.members if effect is None else finding.chosen(effect)
    if others:
        n = len(finding.members)
        raise DataError(f"{n} effects were found together; only one can be verified (most = 1)")
    own: Case = finding.case
    case = own if case is None else case
    observed, fitted = observe(case)[0], np.array(observe(own)[0].used, dtype=bool)
    used = np.array(observed.used, dtype=bool)
    if fitted.shape != used.shape:
        raise DataError(
            f"case has {len(case.configurations)} configurations in {case.room.n_bands} bands; "
            f"it must have those of the finding, {len(own.configurations)} in {own.room.n_bands}"
        )
    start, *further = case.configurations
    given = {"calibrated": calibrated, "simulated": simulated}
    second, notes = _second_runs(start.simulated, start.measured, FEATURES, given)
    if further:
        named = ", ".join(f'"{c.name}"' for c in further)
        notes += (
            f"Configurations that were not compared: {named}. The second run counts as one of "
            f'"{start.name}" alone.',
        )
    runs = [
        None if whole is None else _features_of_run(case, of, second[of], whole)
        for of, whole in given.items()
    ]
    best = next(c for c in finding.candidates if c.effect == name)
    before = plain(case)
    after = recalibrate(finding.with_effects(case, [best]), finding.discrepancy)
    bias = finding.discrepancy.bias.reshape(used.shape)
    bias = bias if simulated is None else 0.0 * bias  # a run has none: it is what the program gave
    # Plain calibration has bent alpha for the model's bias in T as well.
    usual = before.features + np.where(np.arange(len(FEATURES)) == _T20, 0.0, 1.0)[:, None] * bias
    usual = usual if runs[0] is None else runs[0]
    measured, stated = np.where(used, observed.features, np.nan), features_of(case) + bias
    for run in runs:
        measured = measured if run is None else np.where(np.isnan(run), np.nan, measured)
    moved = runs[1]
    if moved is not None and runs[0] is None:  # both are moved to the measured T, or neither is
        moved = _moved(after, moved)

    def last(corrected: Recalibrated) -> Array:
        return corrected.features + bias if moved is None else moved

    def gaps_of(corrected: Recalibrated) -> Array:
        """Return the gaps in JND, (3, n_configurations, n_features, n_bands)."""
        return _in_jnd(np.array([stated, usual, last(corrected)]) - measured)

    gaps, counted = gaps_of(after), np.zeros_like(used)
    parts = _parts_of(case, used, fitted)
    errors, nats, held_out = list[float](), list[float](), list[str]()
    first = start.simulated
    without = calibrated if first is None or calibrated is not None else first.simulated
    compared = [of for of in (without, simulated) if of is not None]
    effects = [finding.effects[name]] if name in finding.effects else []
    problem = MeansProblem(case, observed, predict_hypotheses(case, effects), finding.discrepancy)
    for part in parts:
        held = part.counted & np.isfinite(measured)  # a second run may lack it
        if not held.any():
            continue
        held_out.append(part.words)
        found = best
        # The effect as the data without this part have it, unless it was simulated.
        if (part.hidden & fitted).any() and simulated is None:
            rest = replace(problem, observed=observed.only(used & ~part.hidden))
            (evidence,) = evaluate(rest, probability_off(case.room))
            found = fit(evidence, name, precise=True)
        again = recalibrate(
            finding.with_effects(case, [found]),
            finding.discrepancy,
            left_out=part.configurations,
        )
        gaps = np.where(part.counted, gaps_of(again), gaps)
        counted |= part.counted
        if simulated is None:
            check = gap_check(problem, found, held[used])
            error = check.uncertainty
            nats.append(check.predictive)
        else:
            error = _noise_of_gain(case, gaps[1:, 0], held[0], compared)
        errors += [error] * int(held.any(axis=2).sum())
    error = float(np.mean(errors or [np.nan]))
    made = Verification(
        finding=finding,
        models=MODELS,
        held_out=tuple(held_out or [part.words for part in parts]),
        quantities=tuple(
            " or ".join(dict.fromkeys(each))
            for each in zip(*(feature_names(c.measured) for c in case.configurations), strict=True)
        ),
        places=tuple(c.name for c in case.configurations),
        gaps=np.ascontiguousarray(gaps.swapaxes(1, 2)[:, np.newaxis]),
        counted=np.asarray((counted & np.isfinite(measured)).any(axis=2)).T,
        uncertainty=error,
        needed=max(LEAST_SHRINKAGE, SURE * error),
        endured=max(LITTLE, error),
        predictive=sum(nats) if simulated is None else np.nan,
        misses=tuple(_misses_of_means(case, observed, last(after))),
        uncorrected=before,
        corrected=after,
        features=last(after),
        effect=name,
    )
    if runs[1] is None:
        return made
    return replace(
        made,
        models=OF_RUNS,
        endured=made.needed,  # the program has a noise of its own
        runs=OF_RUNS[:1] if runs[0] is None else OF_RUNS,
        notes=notes,
        again=_in_jnd(runs[1] - measured).swapaxes(0, 1),
    )


def _moved(corrected: Recalibrated, run: Array) -> Array:
    """Return a second run's features, moved to the measured T with their offset from the model."""
    data = LogTimes.of(corrected.case, [0], exact=True)
    offset = run - replace(data, measured=run[:1, _T20]).calibrated().features
    return data.calibrated().features + offset


def _noise_of_gain(
    case: Case, gaps: Array, held: NDArray[np.bool_], runs: Sequence[Measurement]
) -> float:
    """Return the standard error in JND of the change of the gap between two runs.

    The program simulated the correction, so that no model's error of a change counts: that of the
    measurement is common to both ``gaps`` (2, n_features, n_bands), each run has its own noise.
    """
    f, b = np.nonzero(held)
    jnd = np.array([observable(name).jnd for name in FEATURES])[f]
    bare = replace(case.configurations[0], simulated=None)
    measured = observe(replace(case, configurations=[bare], program=""))[0]
    blocks = map(covariance_of_run, runs)
    of_runs = [np.where(b[:, None] == b, of[b[:, None], f[:, None], f], 0.0) for of in blocks]
    rng, drawn = np.random.default_rng(0), list[Array]()
    for covariance in (measured.only(held[None]).covariance, *of_runs):
        drawn.append(rng.standard_normal((_DRAWS, len(f))) @ symmetric_root(covariance) / jnd)
    before, after = (
        np.abs(gap[held] + of_run - drawn[0]).mean(1)
        for gap, of_run in zip(gaps, drawn[1:], strict=True)
    )
    return float(np.std(after - before))


def _second_runs(
    first: Run | None,
    measured: Measurement,
    keys: Sequence[str],
    given: Mapping[str, Measurement | None],
    *,
    by_pair: bool = False,
) -> tuple[dict[str, Measurement], tuple[str, ...]]:
    """Return a program's further runs, by name, with what was measured alone; and what they lack.

    Raises DataError without a first run, for "calibrated" without "simulated", and for a run that has
    nothing in common with the measurement or is the first one again.
    """
    runs, notes = dict[str, Measurement](), list[str]()
    for name, of in given.items():
        if of is None:
            continue
        if given["simulated"] is None:
            raise DataError("calibrated is given without simulated, the run of the corrected model")
        if first is None:
            raise DataError(f"{name} is given, but the search had no simulation to compare it with")
        both = Run(first.room, of).beside(measured, by_pair=by_pair)
        if not {*keys} & both.measured.values.keys():
            raise Run(first.room, of).nothing_common(measured)
        one = first.beside(measured, by_pair=by_pair).run
        if name == "simulated" and all(
            p in one.values and np.array_equal(one.values[p], values, equal_nan=True)
            for p, values in both.run.values.items()
        ):
            raise DataError("simulated is the same simulation as that of the search")
        runs[name] = both.run
        notes += both.left_out(keys)
    return runs, tuple(dict.fromkeys(notes))


def _features_of_run(case: Case, name: str, run: Measurement, given: Measurement) -> Array:
    """Return a second run's features of a case, (n_configurations, n_features, n_bands)."""
    out = np.full((len(case.configurations), len(FEATURES), case.room.n_bands), np.nan)
    out[0] = features_of_values(run)
    time = case.configurations[0].measured.time_label
    if run.time_label != time or np.isnan(out[0, _T20]).all():
        has = ", ".join(map(parameter_label, given.values))
        raise DataError(f"{name} has no {time}, but {time} was measured; {name} has only {has}")
    return out


def _in_jnd(off: Array) -> Array:
    """Return model less measured in JND, signed, of features (..., n_features, n_bands)."""
    jnd = np.array([[observable(name).jnd] for name in FEATURES])
    relative = np.array([[name not in LEVELS] for name in FEATURES])  # these are logarithms
    return np.asarray(np.where(relative, np.expm1(np.where(relative, off, 0.0)), off) / jnd)


def _misses_of_means(case: Case, observed: ObservedFeatures, features: Array) -> list[Miss]:
    """Return the T to which the corrected model was matched and which it misses."""
    u = np.full(observed.used.shape, np.nan)
    u[observed.used] = np.sqrt(np.diag(observed.covariance))
    out, several = list[Miss](), len(case.configurations) > 1
    for c, configuration in enumerate(case.configurations):
        time = np.exp(np.where(observed.used[c, _T20], observed.features[c, _T20], np.nan))
        label, place = configuration.measured.time_label, configuration.name if several else ""
        stated = time, time * u[c, _T20], "s", time * TARGET.jnd
        model = np.exp(features[c, _T20])
        out += _misses(label, place, case.room.centre_frequencies, model, *stated)
    return out


def residual_map(verified: Verification) -> Array:
    """Return deviations of the last model over their standard deviations, as `Finding.residuals`."""
    finding = verified.finding
    added = [c for c in finding.candidates if c.effect == verified.effect]
    case, bias = finding.with_effects(added=added), finding.discrepancy.bias
    features = verified.features - bias.reshape(verified.features.shape)
    predicted = replace(predict_hypotheses(case, []), features=features[None])
    problem = MeansProblem(case, observe(case)[0], predicted, finding.discrepancy)
    return problem.standardized_residuals()


def reverberation_times(
    finding: Finding, before: Recalibrated, after: Recalibrated
) -> dict[str, Array]:
    """Return T in s of the first configuration, (n_bands,): measured, input, calibrated, corrected."""
    case, first = finding.case, finding.case.configurations[0]
    bias = finding.discrepancy.bias.reshape(finding.residuals.shape)
    return {
        "measured": first.measured.reverberation_time,
        "input": np.exp(predict_in(case, first, [state(case, first)]).features[0, _T20]),
        "calibrated": np.exp(before.features[0, _T20]),
        "corrected": np.exp(after.features[0, _T20] + bias[0, _T20]),
    }


# Pairs of positions.


def at_pairs(
    finding: Finding,
    pairs: Sequence[Pair],
    gaps: Array,
    held: NDArray[np.bool_] | None = None,
    **said: Any,
) -> Verification:
    """Return a verification by deviations (n_models, n_seeds, n_parameters, n_pairs, n_bands) in JND.

    The effect must reduce those that were ``held`` (n_parameters,) by `LEAST_SHRINKAGE`, and
    significantly by Student's t over the pairs.
    """
    held = np.ones(gaps.shape[2], dtype=bool) if held is None else held
    of_pairs = mean_of_known(np.abs(gaps[:, :, held]), (2, 4))
    gains = of_pairs[-2] - of_pairs[-1]  # (n_seeds, n_pairs)
    gains = gains[:, np.isfinite(gains).all(axis=0)]  # a second run may lack a pair
    n_seeds, n_pairs = gains.shape
    error = gains.mean(axis=0).std(ddof=1) / np.sqrt(n_pairs) if n_pairs > 1 else np.nan
    of_seeds = gains.mean(axis=1).std(ddof=1) / np.sqrt(n_seeds) if n_seeds > 1 < n_pairs else 0.0
    error = float(np.hypot(error, of_seeds))
    needed = max(LEAST_SHRINKAGE, error * float(stdtrit(n_pairs - 1, _CONFIDENCE)))
    return Verification(
        finding=finding,
        places=tuple(" to ".join(pair) for pair in pairs),
        gaps=gaps,
        counted=np.repeat(held[:, np.newaxis], gaps.shape[3], axis=1),
        uncertainty=error,
        needed=needed,
        endured=needed,
        **said,
    )


def _halves_of(pairs: Sequence[Pair]) -> tuple[tuple[Pair, ...], ...]:
    """Return two halves with every source in both, and with every receiver if sources are two.

    Raises DataError for fewer than `LEAST_PAIRS`.
    """
    if len(pairs) < LEAST_PAIRS:
        raise DataError(
            f"the measurement has {len(pairs)} source-receiver pairs, but a verification needs at "
            f"least {LEAST_PAIRS}, because half of them must predict the others"
        )
    sources = list(dict.fromkeys(s for s, _ in pairs))
    receivers = list(dict.fromkeys(r for _, r in pairs))
    even = tuple((s, r) for s, r in pairs if (sources.index(s) + receivers.index(r)) % 2 == 0)
    return even, tuple(p for p in pairs if p not in even)


def _misses_over_pairs(
    name: str,
    measured: Array,
    gaps: Array,
    pairs: Sequence[Pair],
    frequencies: Array,
    times: Array | None,
    prediction: Array | float = 0.0,
) -> list[Miss]:
    """Return the means over pairs that a model misses, by ``gaps`` (n_pairs, n_bands) in JND.

    Their variance is the larger of that over as many pairs as there are sources or receivers, and
    of noise in responses of ``times`` (ISO 3382-2), plus that of a ``prediction``.
    """
    independent = max(len({s for s, _ in pairs}), len({r for _, r in pairs}))
    of, mean = observable(name), mean_of_known(gaps, 0)
    step = of.jnd * measured if of.relative_jnd else np.full(len(measured), of.jnd)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a band without a value
        error = np.nanstd(gaps, axis=0, ddof=1) / np.sqrt(independent)
    if times is not None:
        one = of.scatter(frequencies, times) * (measured if of.logarithmic else 1.0)
        error = np.fmax(error, one / step / np.sqrt(len(pairs)))
    error = np.hypot(error, prediction)
    stated = measured, step * np.nan_to_num(error), of.unit, step
    return _misses(of.label, "", frequencies, measured + step * mean, *stated)


# Every position.


class _Model(NamedTuple):
    """A model, by its tracer or by a run of that tracer's, or another's, room."""

    number: int
    tracer: PathTracing
    halves: Sequence[tuple[Pair, ...]]
    run: Measurement | None = None
    of_run: PathTracing | None = None


def _at_positions(
    finding: Finding,
    *,
    simulated: Measurement | None = None,
    calibrated: Measurement | None = None,
    effect: str | None = None,
    at: Sequence[float] | None = None,
    seeds: Sequence[int] = (0,),
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
    scheduler: str | None = None,
) -> Verification:
    chosen = tuple(checks.whole("seeds", s, 0) for s in checks.listed("seeds", seeds))
    if not chosen:
        raise DataError("seeds is empty; give at least one")
    if len(set(chosen)) < len(chosen):
        raise DataError(f"seeds has a value twice: {', '.join(map(str, chosen))}")
    if finding.refusal is not None and effect is None and at is None:
        raise DataError(str(finding.refusal))
    halves, tried = _halves_of(finding.pairs), tuple(finding.effects.values())
    case: PositionsCase = finding.case
    runs = {"calibrated": calibrated, "simulated": simulated}
    keys = [observable(name).key_in(case.measured.values) for name in case.match]
    first = None if case.simulated is None else Run(case.room, case.simulated)
    second, notes = _second_runs(first, case.measured, keys, runs, by_pair=True)
    simulated, calibrated = second.get("simulated"), second.get("calibrated")
    made = None
    if simulated is not None:
        made = finding.apply(effect=effect, at=at)
    elif not (effect is None and at is None):
        name = "effect" if at is None else "at"
        raise DataError(f"{name} is given without simulated, the run that contains this effect")
    added = list[Candidate | None]()
    for half in halves:
        again = find_by_positions(
            case.only(half),
            tried,
            finding.controls,
            cache,
            chosen[0],
            finding.left_out,
            scheduler=scheduler,
        )
        added.append(next((c for c in again.candidates if c.can_be_added), None))
        if progress is not None:
            progress("search in half of the pairs", len(added), len(halves))
    # A gap is not to be that of the tracing's noise. The paths of a seed are traced once for all models
    # in the stated geometry.
    stated, models = case.simulator.denser(), list[_Model]()
    if calibrated is None:
        models.append(_Model(1, stated, halves, case.simulated))
    if made is None:
        for half, best in zip(halves, added, strict=True):
            if best is not None:
                corrected = corrected_geometry(case.only(half), best).simulator().denser()
                models.append(_Model(2, corrected, [half], case.simulated, stated))
    elif calibrated is None:
        models.append(_Model(2, made.simulator().denser(), halves, simulated))
    gaps = np.full((len(MODELS), len(chosen), *finding.map.shape), np.nan)

    def compare(model: int, n: int, values: Observations, fitted: Sequence[Pair]) -> None:
        """Keep the gaps at the pairs beside those that were fitted."""
        left = [p for p in finding.pairs if p not in fitted]
        columns = [finding.pairs.index(p) for p in left]
        gaps[model, n][:, columns] = _gaps_at(finding, values, left)

    jobs = [(n, seed, model) for n, seed in enumerate(chosen) for model in models]
    task = partial(_simulated, case, finding.parameters, finding.controls)
    told = progress and partial(progress, "models")
    with workforce(scheduler, threads=1) as workers:  # a tracing takes all cores
        each = zip(jobs, workers.in_order(task, jobs, told), strict=True)
        for (n, _, model), values in each:
            for half, (before, after) in zip(model.halves, values, strict=True):
                if model.number == 1:
                    compare(0, n, before, half)
                compare(model.number, n, after, half)
                if model.number == 1 and made is None and added[halves.index(half)] is None:
                    compare(2, n, after, half)
    if made is None:
        found = at_positions(finding, gaps, added, halves)
        names = (OF_RUNS[0], *MODELS[1:])
        return replace(found, models=names, runs=names[:1]) if case.has_run else found
    given = [case.simulated, calibrated, simulated]
    as_given = [
        np.full(finding.map.shape, np.nan) if of is None else _gaps_at(finding, of, finding.pairs)
        for of in given
    ]
    if calibrated is not None:
        gaps = np.array(as_given)[:, np.newaxis]
    # What any of the models lacks is compared of none.
    gaps = np.where(np.isfinite(gaps).all(axis=0), gaps, np.nan)
    found = at_positions(finding, gaps, added, halves, fitted_times=calibrated is not None)
    return replace(
        found,
        models=OF_RUNS,
        runs=OF_RUNS[:1] if calibrated is None else OF_RUNS,
        notes=notes,
        again=as_given[-1],
        contained=made.added,
    )


def _gaps_at(
    finding: Finding, simulated: Observations | Measurement, pairs: Sequence[Pair]
) -> Array:
    """Return the gaps at some pairs in JND; of a relative level less each source's mean."""
    case: PositionsCase = finding.case
    if isinstance(simulated, Measurement):
        simulated = Observations.of_measurement(simulated, finding.parameters, pairs)
    measured = Observations.of_measurement(case.in_room, finding.parameters, pairs)
    relative = LEVEL.key in case.measured.values
    return gap_at_pairs(simulated.at(measured).values, measured, relative=relative)


def _less(
    measured: Measurement, parameters: Sequence[str], pairs: Sequence[Pair], offset: Array
) -> Measurement:
    """Return a measurement less an ``offset``: to calibrate to it is to calibrate with the offset."""
    values, own = dict(measured.values), dict(measured.uncertainty)
    common = dict(measured.common_uncertainty)  # by band alone
    at = [i for i, pair in enumerate(measured.pairs) if pair in pairs]
    rows = [pairs.index(measured.pairs[i]) for i in at]
    for name, by in zip(parameters, offset, strict=True):
        kind = observable(name)
        key = kind.key_in(values)
        if key not in values:
            continue
        moved = np.array(values[key])
        moved[at] = kind.natural(kind.observed(moved[at]) - by[rows])
        factor = moved / values[key] if kind.logarithmic else np.ones_like(moved)
        if key in own:  # a share of the value stays that share
            own[key] = own[key] * factor
        if key in common:
            common[key] = common[key] * np.nan_to_num(mean_of_known(factor, 0), nan=1.0)
        values[key] = moved
    return replace(measured, values=values, uncertainty=own, common_uncertainty=common)


def _simulated(
    case: PositionsCase,
    parameters: Sequence[str],
    controls: ControlRuns,
    job: tuple[int, int, _Model],
) -> list[tuple[Observations, Observations]]:
    """Return what a model gives as it is, and calibrated to each of its halves of the pairs."""
    _, seed, model = job
    tracer, made = replace(model.tracer), []  # without the paths of another job
    trace_ahead(tracer, tracer.room.alpha, seed)
    before = observe_pairs(tracer, tracer.room.alpha, parameters, seed=seed)
    offset = np.zeros_like(before.values)
    if model.run is not None:
        own = before
        if (of_run := model.of_run) is not None:
            own = observe_pairs(replace(of_run), of_run.room.alpha, parameters, seed=seed)
        given = Observations.of_measurement(model.run, parameters, before.pairs)
        offset = given.values - own.values
    for half in model.halves:
        fitted = case.only(half)
        measured = fitted.measured
        if model.run is not None:
            measured = _less(measured, parameters, before.pairs, offset)
        result = calibrate_positions(
            tracer,
            tracer.room,
            measured,
            parameters,
            exclude=fitted.exclude,
            controls=controls,
            more_paths=1,  # it is denser already
            seed=seed,
        )
        # Its tracer scatters as fitted, with which alpha was calibrated.
        after = observe_pairs(result.tracer, result.alpha, parameters, seed=seed)
        one, other = (replace(of, values=of.values + offset) for of in (before, after))
        made.append((one, other))
    return made


def at_positions(
    finding: Finding,
    gaps: Array,
    added: Sequence[Candidate | None],
    halves: Sequence[Sequence[Pair]],
    *,
    fitted_times: bool = False,
) -> Verification:
    """Return the verification of a finding by the deviations of `MODELS` at pairs that were not fitted.

    If ``fitted_times``, all T were fitted, and only the other parameters were held out.
    """
    pairs, parameters = finding.pairs, finding.parameters
    measured = Observations.of_measurement(finding.case.in_room, parameters, pairs)
    relative = LEVEL.key if LEVEL.key in finding.case.measured.values else ""
    means = {n: mean_of_known(measured.natural(n), 0) for n in parameters if n != relative}
    times = next((m for n, m in means.items() if isinstance(observable(n), DecaySlope)), None)
    left, frequencies = mean_of_known(gaps[-1], 0), finding.case.room.centre_frequencies
    misses = [
        miss
        for n, mean in means.items()  # the mean of a relative level is taken off
        for miss in _misses_over_pairs(
            n, mean, left[parameters.index(n)], pairs, frequencies, times
        )
    ]
    late = [observable(n).part == "late" for n in parameters]
    held = np.array([not (fitted_times and of) for of in late])
    words = "each half of the pairs, by a fit to the other half"
    if fitted_times:
        words = listed([parameter_label(n) for n, at in zip(parameters, held, strict=True) if at])
    return at_pairs(
        finding,
        pairs,
        gaps,
        held,
        models=MODELS,
        held_out=(words,) if held.any() else (),
        quantities=tuple(map(parameter_label, parameters)),
        misses=tuple(misses),
        halves=tuple(map(tuple, halves)),
        added=tuple(added),
    )


# Two states.


def _of_states(
    finding: Finding,
    *,
    before: Measurement | None = None,
    after: Measurement | None = None,
    seed: int = 0,
) -> Verification:
    checks.whole("seed", seed, 0)
    case: StatesCase = finding.case
    found = held = case
    if not finding.detected:
        raise DataError(f'no change was found that can be verified (verdict "{finding.verdict}")')
    if (before is None) != (after is None):
        lacking = "before" if before is None else "after"
        raise DataError(f"{lacking} is missing: measure further pairs before and after the change")
    if before is not None and after is not None:
        if seed:
            raise DataError("seed cannot be given with before and after: leave seed out")
        if case.of_means or before.is_summary or after.is_summary:
            raise DataError("before and after cannot be used with means over positions")
        new = [p for p in before.pairs if p in after.pairs and p not in case.pairs]
        if len(new) < _LEAST_NEW:
            have = f"before and after have {len(new)} pairs that were not fitted"
            raise DataError(f"{have}, and at least {_LEAST_NEW} are needed")
        held, fitted = _of_pairs(replace(case, before=before, after=after), new), "the other pairs"
        predicted = np.broadcast_to(finding.shift, held.change.shape)
    else:
        halves, effects = _halves_of(found.pairs), tuple(finding.effects.values())
        predicted, fitted = np.full(found.change.shape, np.nan), "the other half of the pairs"
        for half in halves:
            part = _of_pairs(case, half)
            again = find_change(part, effects=effects, seed=seed, without=finding.left_out)
            predicted[[pair not in half for pair in found.pairs]] = again.shift
    # A gap is as if nothing had changed, and as predicted: in steps of 1 JND each of ln T.
    steps = np.stack([-held.change, predicted - held.change]) / np.log1p(TARGET.jnd)
    # The geometric mean is the same of two states that are exchanged.
    times = np.sqrt(found.times[0] * found.times[1])
    left = (finding.shift - found.change) / np.log1p(TARGET.jnd)
    # The error of T after in JND, by the change's interval. The state of the longer T is the first.
    total, area, sign = case.room.total_area, finding.area, 1.0
    if not case.falls:
        area, sign = case.equation.absorption_area(case.room, case.times[1]), -1.0
    areas = np.clip(area + sign * finding.change[1:], 0.0, 0.999 * total)
    air = 4 * case.room.air_attenuation * case.room.volume
    low, high = total * case.equation.exponent(areas / total) + air
    error = np.abs(np.log(high / low)) / (2 * NORMAL_90 * np.log1p(TARGET.jnd))
    at = (found.pairs, found.room.centre_frequencies, times, np.nan_to_num(error))
    return at_pairs(
        finding,
        held.pairs,
        steps[:, np.newaxis, np.newaxis],
        models=("if nothing changed", f"with what {fitted} found"),
        held_out=(f"pairs whose change is predicted from {fitted}",),
        quantities=(parameter_label(TARGET.key),),
        misses=tuple(_misses_over_pairs(TARGET.key, found.times[1], left, *at)),
        notes=() if held is found else held.notes,
    )


def _of_pairs(case: StatesCase, pairs: Sequence[Pair]) -> StatesCase:
    """Return the case of some pairs, of which T alone is compared."""
    before, after = case.before.select(pairs), case.after.select(pairs)
    return replace(case, before=before, after=after, simulator=None)
