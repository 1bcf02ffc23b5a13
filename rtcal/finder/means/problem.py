"""Likelihood of every effect and of combinations of effects, and the threshold for a detection.

A hypothesis is an effect with one set of parameter values, in each configuration of the room. The
compared values y (features) are ln T20, ln EDT/T20, ln T30/T20, C80 and G by configuration and band.
docs/discrepancy_method.md has the marginal likelihood, with the covariance

    C = J Sigma J' + R + D + M + B.

M is the error of the effect's equation, in proportion to the change by the effect (after Kennedy &
O'Hagan 2001): `_misfit`. B is the change of the decay's shape by the effect's position
(`SHAPE_CHANGE`). The density is `rtcal.finder.evidence.student`. Each hypothesis is evaluated twice:
with the usual error F F' that all coefficients have in common, and with s² F F' for several s.

The threshold is the score that rooms with nothing missing reach by chance (parametric bootstrap). One
half of the reference rooms gives bias and D, and the rooms are drawn from the other half; the few rooms
of image sources are not divided. T20 of the first configuration and all data have a threshold each
(`steps`), because a single score of all data would dilute what T20 shows. 5 % of the rooms exceed one
of the two (smallest p-value, Westfall & Young 1993).

There are some 200,000 pairs of effects, so all are first evaluated approximately, from the changes that
each effect causes alone (`Screen`). The best parameter values of each two effects are then evaluated
with both in the model. The likelihood of combinations has its full power, whereas the search for a
single effect reduces the power (`rtcal.finder.evidence.COARSENING`) as a reserve for other effects that
may be missing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import combinations
from math import factorial
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import chdtrc, logsumexp

from rtcal.acoustics import bands
from rtcal.acoustics.bands import correlation
from rtcal.acoustics.measurement import MAX_POSITIONS, Measurement
from rtcal.acoustics.observables import observable, parameter_label
from rtcal.finder.case import Case, Configuration
from rtcal.finder.claim import (
    FIELD,
    Key,
    Names,
    Reason,
    families_of,
    family_of,
    most_probable_first,
    summed,
    wide,
)
from rtcal.finder.effects import (
    AppliedEffect,
    Effect,
    Parameters,
    added,
    beyond,
    changed_states,
    checked_grid,
)
from rtcal.finder.evidence import (
    COEFFICIENTS,
    EXPECTED,
    NONE,
    NULL_POWER,
    SCALES,
    UNKNOWN,
    Prior,
    directions,
    drawn,
    factors,
    grid_weights,
    leading_products,
    log_mixture,
    student,
    with_columns,
)
from rtcal.finder.means.engines import ControlRooms, bias_estimates, draw_alpha, recentred
from rtcal.finder.model import FEATURES, LEVELS, TIMES, Predicted, RoomState, predict, sensitivities
from rtcal.support.errors import DataError
from rtcal.support.normal import symmetric_root
from rtcal.support.types import Array, read_only

Indices = slice | NDArray[np.intp]
SHAPE_CHANGE = (("edt", 0.12), ("t30", 0.06))
"""Standard deviation of ln EDT/T20 and ln T30/T20 per unit of change of ln T20. An absorber is at one
place, so that the field is less even than its equation assumes. Chosen on simulated rooms
(docs/discrepancy.md)."""
LARGEST_FEATURES = 1000
"""Values that can be compared. Time grows with their cube: 1000 take minutes (benchmarks/growth.py in
commit 2621e9c7)."""
LARGEST_HYPOTHESES = 5000
"""Largest number of hypotheses: 12 per material and some 450 more, so that 370 materials are
possible."""


@dataclass(frozen=True, eq=False)
class _PredictedFeatures:
    """Hold the features that a model predicts for n states of a case's room, and their derivatives."""

    case: Case
    features: Array  # (n, n_configurations, 5, n_bands), of `FEATURES`
    slopes: Array  # its derivatives by ln T20
    jacobian: Array  # -d ln T20 / d alpha, (n, n_configurations, n_materials, n_bands)

    def log_time_errors(self, rows: Indices) -> tuple[Array, Array]:
        """Return the covariance (n, size, size) of ln T20, and its errors in common.

        The size is the number of configurations times that of bands. Errors in common (n, size,
        n_directions) are the changes by one standard deviation of each; the covariance includes
        them.
        """
        sigma, changed, rho, of_alpha, of_climate = _uncertain(self.case)
        factor = self.jacobian[rows] * sigma
        n, count, _, n_bands = factor.shape
        size = count * n_bands
        common = np.where(changed, 0.0, factor).swapaxes(2, 3).reshape(n, size, -1)
        full = (common @ common.swapaxes(1, 2)).reshape(n, count, n_bands, count, n_bands)
        own = np.where(changed, factor, 0.0)
        for c in np.flatnonzero(changed.any((1, 2))):
            full[:, c, :, c] += own[:, c].swapaxes(1, 2) @ own[:, c]
        alone = (full * rho[:, None, :]).reshape(n, size, size)
        together = factors(of_alpha, self.jacobian[rows])
        offset = [np.nan_to_num(offset_of(self.case, c)[0]) for c in self.case.configurations]
        times = np.exp(self.features[rows, :, 0] - np.array(offset))[:, :, None] / _RATE
        air = (of_climate * times).swapaxes(2, 3).reshape(n, size, -1)
        parts = np.concatenate([air, together], axis=-1)
        return alone + parts @ parts.swapaxes(1, 2), together


_RATE = 6 * np.log(10)  # k T of an exponential decay


def predict_in(
    case: Case, configuration: Configuration, states: Sequence[RoomState], far: float = 1.0
) -> Predicted:
    """Return what a case's model predicts in one configuration, by states; a run's offset is added."""
    made = predict(states, far * distances(case, configuration))
    if configuration.simulated is None:
        return made
    offset = np.nan_to_num(offset_of(case, configuration))
    return replace(made, features=made.features + offset)


@lru_cache(maxsize=8)
def offset_of(case: Case, configuration: Configuration) -> Array:
    """Return a run's features minus the equation's at its alpha, (5, n_bands); 0 without a run."""
    run = configuration.simulated
    if run is None:
        return read_only(np.zeros((len(FEATURES), case.room.n_bands)))
    at = state(replace(case, applied=()), configuration, run.room.alpha)
    return read_only(
        features_of_values(run.simulated)
        - predict([at], distances(case, configuration)).features[0]
    )


def _predict_states(case: Case, states: Sequence[Sequence[RoomState]]) -> _PredictedFeatures:
    """Return the predictions of states, a list for each configuration."""
    with np.errstate(all="ignore"):  # the caller refuses, or leaves out, what is not finite
        made = [
            predict_in(case, c, column)
            for column, c in zip(states, case.configurations, strict=True)
        ]
        # d ln T20 = -(d k / d alpha) T20 / (6 ln 10) d alpha.
        times = [p.reverberation_time[:, None, :] / _RATE for p in made]
        jacobian = [sensitivities(s) * time for s, time in zip(states, times, strict=True)]
    return _PredictedFeatures(
        case,
        np.stack([p.features for p in made], axis=1),
        np.stack([p.slopes for p in made], axis=1),
        np.stack(jacobian, axis=1),
    )


@lru_cache(maxsize=1)
def _uncertain(case: Case) -> tuple[Array, NDArray[np.bool_], Array, Array, Array]:
    """Return what alpha and the climate may be off by, for `_PredictedFeatures.log_time_errors`.

    Sigma (n_configurations, n_materials, n_bands), which materials changed (n_configurations,
    n_materials, 1), the bands' correlation, `directions`, and the change of k in 1/s by one
    standard deviation of temperature and of humidity, (n_configurations, n_columns, n_bands). The
    0.17 % per K of the speed of sound are left out.
    """
    room, (kelvin, percent) = case.room, case.climate_uncertainty
    owners = [0 if c.air is None else i + 1 for i, c in enumerate(case.configurations)]
    place = {owner: 2 * i for i, owner in enumerate(dict.fromkeys(owners))}
    climate = np.zeros((len(owners), 2 * len(place), room.n_bands))
    for i, (c, owner) in enumerate(zip(case.configurations, owners, strict=True)):
        if (air := c.air or room.air) is None:
            continue
        warm, damp = min(air.temperature, 50 - kelvin), min(air.humidity, 100 - percent)
        ends = (("temperature", warm, warm + kelvin), ("humidity", damp, damp + percent))
        for k, (name, *both) in enumerate(ends):
            one, other = (
                replace(air, **{name: v}).attenuation(room.centre_frequencies) for v in both
            )
            climate[i, place[owner] + k] = air.speed_of_sound * (other - one)
    sigma = np.stack([c.coefficients(room)[1] for c in case.configurations])
    changed = np.array([[m in c.changes for m in room.materials] for c in case.configurations])
    rho = correlation(room.centre_frequencies, room.band_correlation)
    return sigma, changed[:, :, None], rho, directions(case), climate


@dataclass(frozen=True, eq=False, kw_only=True)
class MeansHypotheses(_PredictedFeatures):
    """Hold what a model predicts with each effect, for each set of its parameter values."""

    names: tuple[str, ...]
    parameters: tuple[Parameters, ...]
    """Effect and parameter values of each hypothesis, (n,); the first is "none", without an effect."""
    possible: NDArray[np.bool_]
    """Whether T, C80 and G are finite, (n,). A room whose sound ends within 80 ms has no C80, and the
    measurement excludes it: its weight is 0, and its predictions are those of "none"."""
    spectrum_errors: Array
    """Relative errors of the effect's change over bands, one standard deviation each, (n, n_bands,
    n_errors)."""
    formula_errors: Array
    """Standard deviation of the relative error of the change of each feature by itself, (n,)."""
    applied: Array
    """Covariance of all values, (size, size), from the uncertainty of the effects that are in the model
    already, of materials that configurations change, and of unknown distances."""
    effects: Mapping[str, Effect] = field(default_factory=dict)

    @cached_property
    def rows(self) -> dict[str, NDArray[np.intp]]:
        """Numbers of the hypotheses of each effect, and of "none"."""
        names = np.array(self.names)
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(self.names)}

    def grid(self, name: str) -> list[Parameters]:
        """Return the sets of parameters of an effect."""
        return [self.parameters[i] for i in self.rows[name]]

    @cached_property
    def log_weights(self) -> Array:
        """Log prior probability of the parameters, given the effect, (n,)."""
        base = state(self.case, self.case.configurations[0])
        weights = [grid_weights(e, self.grid(name), base) for name, e in self.effects.items()]
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.possible * np.concatenate([np.ones(1), *weights])))


def predict_hypotheses(
    case: Case, effects: Sequence[Effect], grids: Sequence[Sequence[Parameters]] | None = None
) -> MeansHypotheses:
    """Return the predictions of a case's model with each effect, by default on its own grid.

    Raises DataError if an effect breaks a rule, or has no finite T, C80 and G.
    """
    base = [state(case, c) for c in case.configurations]
    if grids is None:
        grids = [checked_grid(effect, base[0], case.room) for effect in effects]
    check_size(case, 1 + sum(map(len, grids)))
    names, states = [NONE], [[b] for b in base]
    parameters: list[Parameters] = [{}]
    frequencies, n_bands = case.room.centre_frequencies, case.room.n_bands
    errors, alone = [np.zeros((1, n_bands, n_bands + 2))], [0.0]
    for effect, grid in zip(effects, grids, strict=True):
        names += [effect.name] * len(grid)
        parameters += grid
        alone += [effect.formula_error] * len(grid)
        errors.append(np.repeat(effect.errors_over_bands(frequencies)[None], len(grid), axis=0))
        for c, unchanged, column in zip(case.configurations, base, states, strict=True):
            absent = c.suspect_removed and effect.removable
            column += [unchanged] * len(grid) if absent else changed_states(effect, unchanged, grid)
    predicted = _predict_states(case, states)
    finite = np.isfinite(predicted.features) & np.isfinite(predicted.slopes)
    possible = np.asarray(finite.all((1, 2, 3)))
    if not possible.all():
        alive = {name for name, of in zip(names, possible, strict=True) if of}
        lost = next((i for i, name in enumerate(names) if name not in alive), None)
        if lost is not None:
            culprit = "the case's model" if lost == 0 else f'effect "{names[lost]}"'
            raise DataError(
                f"{culprit} gives no finite T, C80 and G with "
                f"{parameters[lost] or 'the input'} in a room of {case.room.volume:g} m³ "
                f"with {case.room.total_area:g} m² of surfaces. Check volume, areas and "
                "coefficients"
            )
        for array in (predicted.features, predicted.slopes, predicted.jacobian):
            array[~possible] = array[0]
    return MeansHypotheses(
        **vars(predicted),
        names=tuple(names),
        parameters=tuple(parameters),
        possible=possible,
        spectrum_errors=np.concatenate(errors),
        formula_errors=np.array(alone),
        applied=_applied(case),
        effects={e.name: e for e in effects},
    )


def check_size(case: Case, n_hypotheses: int) -> None:
    """Raise DataError for more than 1000 measured values or 5000 hypotheses."""
    room, n = case.room, len(case.configurations)
    measured = sum(len(set(c.measured.values) & set(FEATURES)) for c in case.configurations)
    if (size := measured * room.n_bands) > LARGEST_FEATURES:
        raise DataError(
            f"the {n} configurations have {size} values (parameters times bands), but at "
            f"most {LARGEST_FEATURES} are possible: leave some configurations out"
        )
    if n_hypotheses > LARGEST_HYPOTHESES:
        raise DataError(
            f"the search would try {n_hypotheses} sets of parameters with "
            f"{room.n_materials} materials, but at most {LARGEST_HYPOTHESES} are possible: "
            "use fewer effects or materials"
        )


def features_of(
    case: Case,
    applied: Sequence[AppliedEffect] | None = None,
    *,
    changed: bool = True,
    far: Array | float = 1.0,
) -> Array:
    """Return what a case's model predicts in each configuration, (n_configurations, 5, n_bands).

    ``applied`` replaces the effects in the model. With ``changed`` False materials keep their input
    coefficients, and ``far`` is a factor on the distances, one number or (n_configurations,).
    """
    case = case if applied is None else replace(case, applied=applied)
    out = []
    for c, factor in zip(
        case.configurations, far + np.zeros(len(case.configurations)), strict=True
    ):
        made = state(case, c if changed else replace(c, changes={}))
        out.append(predict_in(case, c, [made], factor).features[0])
    return np.array(out)


@lru_cache(maxsize=1)
def _applied(case: Case) -> Array:
    """Return the covariance of all features by distances, changes and applied effects, raveled."""
    base = features_of(case)
    count, n_bands = len(case.configurations), case.room.n_bands
    # Positions may differ between configurations, so each has an error of its distance.
    unknown = np.array([c.distances is None for c in case.configurations])
    far = features_of(case, far=np.where(unknown, np.exp(DISTANCE_ERROR), 1.0)) - base
    columns = (far[..., None] * np.eye(count)[:, None, None]).reshape(-1, count)
    covariance = columns @ columns.T
    # A changed material stands somewhere, as an effect does, and the formula errs in proportion to
    # what it changes. Configurations with the same changes share the common part.
    if any(c.changes for c in case.configurations):
        moved = base - features_of(case, changed=False)
        keys = [
            tuple(sorted((m, change.alpha.tobytes()) for m, change in c.changes.items()))
            for c in case.configurations
        ]
        errors = np.full((n_bands, 1), Effect.spectrum_error[0])
        for key in dict.fromkeys(filter(None, keys)):
            same = np.array([k == key for k in keys])[:, None, None]
            covariance = covariance + _misfit_of_all(
                np.where(same, moved, 0.0), errors, Effect.formula_error
            )
    for i, a in enumerate(case.applied):
        if a.size_sigma > 0:
            most, larger = a.effect.size_limits(case.room)[1], a.size + a.size_sigma
            # Near the end of what is possible, the size by as much smaller: only the square counts.
            others = list(case.applied)
            others[i] = a.resized(larger if larger <= most else a.size - a.size_sigma)
            resized = (features_of(case, others) - base).ravel()
            covariance = covariance + np.outer(resized, resized)
        change = base - features_of(case, [other for other in case.applied if other is not a])
        errors = a.effect.errors_over_bands(case.room.centre_frequencies)
        covariance = covariance + _misfit_of_all(change, errors, a.effect.formula_error)
    return read_only(covariance)


def _misfit_of_all(change: Array, errors: Array, alone: float) -> Array:
    """Return the `_misfit` of a change of all features, (n_configurations, n_features, n_bands)."""
    amount = np.broadcast_to(change[:, :1], change.shape)
    _, feature, band = np.indices(change.shape).reshape(3, -1)
    return _misfit(change.ravel(), amount.ravel(), feature, errors[band], alone)


def _misfit(
    d: Array, amount: Array, feature: NDArray[np.intp], errors: Array, alone: Array | float
) -> Array:
    """Return the covariance (..., m, m) of the error of an effect's equation, for m values.

    ``d`` (..., m) are the changes by the effect, and ``amount`` those of ln T20 in the same band
    and configuration; ``feature`` (m,) are rows of `FEATURES`. ``errors`` (..., m, n_errors) are
    relative errors in common (`Effect.errors_over_bands`), ``alone`` (...) that of each value by
    itself.
    """
    columns = _misfit_columns(d, amount, feature, errors)
    own = columns[..., errors.shape[-1] :]  # of the decay's shape: half of it is each band's own
    out = columns @ columns.swapaxes(-1, -2)
    rows = np.arange(out.shape[-1])
    out[..., rows, rows] += (own**2).sum(-1) + (np.asarray(alone)[..., None] * d) ** 2
    return np.asarray(out)


def _misfit_columns(d: Array, amount: Array, feature: NDArray[np.intp], errors: Array) -> Array:
    """Return the errors in common, (..., m, n_errors + 2), the last two of the decay's shape."""
    shape = [share * amount * (feature == FEATURES.index(name)) for name, share in SHAPE_CHANGE]
    parts = np.sqrt(0.5) * np.stack(shape, axis=-1)
    return np.concatenate([d[..., None] * errors, parts], axis=-1)


LARGEST_UNCERTAINTY = 0.15
"""Relative standard uncertainty of T beyond which a band is dropped: three JND of T (5 % each).

The evidence takes ln T as normal. With u = 15 % the mean of ln T is off by u²/2 = 1.1 %, which is 0.08
of its standard deviation; the error grows with u."""
SHARED_BY_T20_AND_T30 = 0.75
"""Correlation of that error between T20 and T30 of one decay, which share most of their range."""
ONE_LEVEL = 1.0
"""Standard deviation of C80 and G in dB over the positions of a room, where a single value has none."""


@dataclass(frozen=True, eq=False)
class ObservedFeatures:
    """Hold the measured values that are compared with a model, and their covariance."""

    features: Array  # (n_configurations, 5, n_bands); NaN where nothing was measured
    used: Array  # which of them are compared
    covariance: Array  # (n_used, n_used), of the measurement
    origin: Reason  # where its uncertainties come from

    @cached_property
    def values(self) -> Array:
        """The features in use, (n_used,)."""
        return np.asarray(self.features[self.used])

    def only(self, used: Any) -> ObservedFeatures:
        """Return the features with fewer of them in use."""
        kept = used[self.used]
        return replace(self, used=used, covariance=self.covariance[np.ix_(kept, kept)])


def steps(case: Case, used: Array) -> dict[int, str]:
    """Return names by number of values of two steps: T of the first configuration, then all data."""
    first = int(np.argmax(used.any((1, 2))))
    configuration = case.configurations[first]
    time = parameter_label(_amount(configuration.measured))
    of = f' of "{configuration.name}"' if len(case.configurations) > 1 else ""
    return {int(used[first, 0].sum()): f"{time}{of}", int(used.sum()): "all data"}


def observe(case: Case) -> tuple[ObservedFeatures, list[Reason]]:
    """Return the measured values that are compared, and notes; DataError if T has no band."""
    notes: list[Reason] = []
    origins: dict[str, list[str]] = {"stated": [], "made": []}
    n, k = len(case.configurations), case.room.n_bands
    table = np.full((n, len(FEATURES), k), np.nan)
    blocks = np.zeros((n, k, len(FEATURES), len(FEATURES)))
    for c, configuration in enumerate(case.configurations):
        table[c], blocks[c] = _features(configuration, origins)
        if configuration.simulated is not None:
            blocks[c] += covariance_of_run(configuration.simulated.simulated)
        for b, f in enumerate(configuration.measured.centre_frequencies):
            where = {"configuration": configuration.name, "band": bands.label(f)}
            if blocks[c, b, 0, 0] > LARGEST_UNCERTAINTY**2:
                u = 100 * float(np.sqrt(blocks[c, b, 0, 0]))
                notes.append(Reason("T uncertain", {**where, "u": u}))
                table[c, :, b] = np.nan
            elif np.isnan(table[c, 0, b]):
                notes.append(Reason("no T", where))
                table[c, :, b] = np.nan
    used = np.isfinite(table)
    full = np.zeros((n, len(FEATURES), k, n, len(FEATURES), k))
    for c, b in np.ndindex(n, k):
        full[c, :, b, c, :, b] = np.nan_to_num(blocks[c, b])
    flat = used.ravel()
    if not used.any():
        raise DataError(
            "T cannot be used in any band of any configuration: "
            + "; ".join(str(note).removesuffix(".") for note in notes)
        )
    covariance = full.reshape(flat.size, flat.size)[np.ix_(flat, flat)]
    origin = Reason("uncertainties", {"origins": origins})
    return ObservedFeatures(table, used, covariance, origin), notes


def _features(configuration: Configuration, origins: dict[str, list[str]]) -> tuple[Array, Array]:
    """Return the features (n_features, n_bands) and their covariance in each band."""
    m = configuration.measured
    amount, k = _amount(m), len(m.centre_frequencies)
    block, common = np.zeros((k, 5, 5)), {}
    for row, p in enumerate((amount, "edt", "t30", *LEVELS)):
        if p not in m.values:
            continue
        alone, common[p], origin = _uncertainty(m, p)
        block[:, row, row] = alone**2 + common[p] ** 2
        if (label := parameter_label(p)) not in origins[origin]:
            origins[origin].append(label)
    if amount == "t20" and "t30" in m.values:
        both = SHARED_BY_T20_AND_T30 * common["t20"] * common["t30"]
        block[:, 0, 2] = block[:, 2, 0] = both
    return features_of_values(m), np.asarray(_RATIOS @ block @ _RATIOS.T)


_RATIOS = np.eye(5)
"""From ln T20, ln EDT, ln T30, C80, G to the ratios, which have T20 in the denominator."""
_RATIOS[1:3, 0] = -1.0


def _amount(m: Measurement) -> str:
    return "t20" if "t20" in m.values else "t30"


def features_of_values(m: Measurement) -> Array:
    """Return the features of a measurement or a run, (n_features, n_bands)."""
    amount = _amount(m)
    mean = {p: m.mean(p) for p in FEATURES}
    time, levels = mean[amount], [mean[p] for p in LEVELS]
    with np.errstate(divide="ignore", invalid="ignore"):
        table = np.stack([*np.log([time, mean["edt"] / time, mean["t30"] / time]), *levels])
    if amount == "t30":
        # T20 is missing and T30 stands in for it: the ratio would be 0 by construction.
        table[2] = np.nan
    return table


def values_of_features(
    features: Array, frequencies: Array, parameters: Collection[str]
) -> Measurement:
    """Return predictions (5, n_bands) as a measurement with the named ``parameters``."""
    log_time, edt, t30, c80, g = features
    with np.errstate(over="ignore"):
        values = {
            "t20": np.exp(log_time),
            "edt": np.exp(log_time + edt),
            "t30": np.exp(log_time + t30 if "t20" in parameters else log_time),
            "c80": c80,
            "g": g,
        }
    known = {p: np.where(np.isfinite(v), v, np.nan) for p, v in values.items() if p in parameters}
    return Measurement.from_values(frequencies, **known)


def covariance_of_run(run: Measurement) -> Array:
    """Return the covariance of a program's result, (n_bands, 5, 5); 0 without an uncertainty."""
    block = np.zeros((len(run.centre_frequencies), 5, 5))
    for row, p in enumerate((_amount(run), "edt", "t30", *LEVELS)):
        if p in run.uncertainty:
            scale = run.mean(p) if p in TIMES else 1.0
            block[:, row, row] = np.nan_to_num(run.mean_uncertainty(p) / scale) ** 2
    return np.asarray(_RATIOS @ block @ _RATIOS.T)


def _uncertainty(m: Measurement, p: str) -> tuple[Array, Array, str]:
    """Return the uncertainty of a mean by itself, the part that all pairs share, and their origin.

    Both (n_bands,), relative for a time and in dB for a level.
    """
    mean = m.mean(p)
    scale = mean if p in TIMES else np.ones_like(mean)
    nothing = np.full(len(mean), np.nan)
    present = np.isfinite(m.values[p])
    stated = np.isfinite(np.where(present, m.uncertainty.get(p, nothing), 0.0)).all(0)
    common = m.common_uncertainty.get(p, nothing) / scale
    whole = m.mean_uncertainty(p) / scale
    alone = np.sqrt(np.maximum(np.nan_to_num(whole) ** 2 - np.nan_to_num(common) ** 2, 0.0))
    if stated.all():
        return alone, np.nan_to_num(common), "stated"
    n = np.maximum(present.sum(0), 1)
    if m.is_summary:
        n = np.full(len(mean), (m.n_sources or 1) * (m.n_receivers or 1))
    if p in TIMES:
        one = observable(p).scatter(m.centre_frequencies, mean)
    else:
        one = np.full(len(mean), ONE_LEVEL)
    alone = np.where(stated, alone, np.fmax(alone, one / np.sqrt(np.minimum(n, MAX_POSITIONS))))
    shared = np.where(stated, 0.0, observable(p).between_teams(m.centre_frequencies))
    return np.nan_to_num(alone), np.where(np.isfinite(common), common, shared), "made"


USUAL_DISTANCE = 0.66
"""Source-receiver distance over the cube root of the volume, if no distance is given: the mean distance
between two points of a cube (Robbins 1978)."""
DISTANCE_ERROR = 0.35
"""Standard deviation of its logarithm: that of the distance between two points of a cube is 0.45 of one
pair, less of a mean over pairs."""


def state(case: Case, configuration: Configuration, alpha: Array | None = None) -> RoomState:
    """Return the state of a case's room in one configuration, by default with the room's alpha."""
    return states(case, configuration, [case.room.alpha if alpha is None else alpha])[0]


def states(case: Case, configuration: Configuration, alphas: Sequence[Array]) -> list[RoomState]:
    """Return the states of a case's room in one configuration, one for each alpha."""
    room = case.room
    changed = {room.material_index(m): c.alpha for m, c in configuration.changes.items()}
    unchanged = RoomState.of_room(room, case.facing, case.equation)
    if air := configuration.air:
        unchanged = replace(
            unchanged,
            air=air.attenuation(room.centre_frequencies),
            speed_of_sound=air.speed_of_sound,
        )
    out = []
    for alpha in alphas:
        values = np.array(alpha)
        for row, of_material in changed.items():
            values[row] = of_material
        values.setflags(write=False)
        made = replace(unchanged, alpha=values)
        out.append(with_applied(made, case.applied, configuration) if case.applied else made)
    return out


def with_applied(
    unchanged: RoomState, applied: Sequence[AppliedEffect], configuration: Configuration
) -> RoomState:
    """Return a state with effects, without what a ``configuration`` was measured without."""
    for p in applied:
        if not (configuration.suspect_removed and p.effect.removable):
            (unchanged,) = changed_states(p.effect, unchanged, [p.parameters])
    return unchanged


def distances(case: Case, configuration: Configuration) -> Array:
    """Return the source-receiver distances in m, (n_pairs,); one usual distance if none are given."""
    if configuration.distances is not None:
        return configuration.distances
    return np.array([USUAL_DISTANCE * case.room.volume ** (1 / 3)])


COMMON_UNCERTAINTY: Mapping[str, float] = {"edt": 0.05, "t30": 0.018, "c80": 0.5, "g": 0.5}
"""Standard uncertainty of the model common to all bands and configurations, in ln and dB. The scatter
of one engine does not show it; that between engines does."""
COMMON_CORRELATION = 0.85
"""Its correlation from octave to octave."""
SHRINKAGE = 0.4
"""Weight of the diagonal in the model's covariance, which is estimated from few reference rooms."""
INFLATION = 1.2
"""Factor on the model's covariance. Chosen on development rooms, so that the threshold also holds on an
engine that it was not estimated from (docs/discrepancy.md)."""


@dataclass(frozen=True, eq=False)
class ModelDiscrepancy:
    """Bias and covariance of the model's error, over all features raveled.

    ``bias`` (n,) and ``covariance`` (n, n) have n = n_configurations * n_features * n_bands, in this
    order. ``engines`` are the names of the simulators whose reference rooms gave them.
    """

    bias: Array
    covariance: Array
    engines: tuple[str, ...] = ()


def estimate_discrepancy(case: Case, controls: Sequence[ControlRooms]) -> ModelDiscrepancy:
    """Return mean and covariance of the error of a case's equation, estimated from reference rooms.

    The covariance is the scatter between rooms plus that between simulators, averaged with its own
    diagonal because the rooms are few. Of a geometrical program's result the sign of an error is
    not known: the mean is then 0, and each simulator's mean error is added to the covariance.
    """
    n, k = len(case.configurations), case.room.n_bands
    size, either = n * len(FEATURES) * k, _of_either(case)
    estimates = np.where(either, 0.0, bias_estimates(controls))
    bias = estimates.mean(axis=0)
    degrees = max(len(estimates) - 1, 1)
    rows = [((estimates - bias) / np.sqrt(degrees)).reshape(len(estimates), size)]
    for c in controls:
        centred = np.nan_to_num(c.errors - c.mean).reshape(-1, size)
        rows.append(centred / np.sqrt(max(len(centred) - 1, 1) * len(controls)))
    over_bands = correlation(case.room.centre_frequencies, COMMON_CORRELATION)
    root = np.linalg.cholesky(over_bands).T
    for name, uncertainty in COMMON_UNCERTAINTY.items():
        common = np.zeros((k, n, len(FEATURES), k))
        common[:, :, FEATURES.index(name)] = uncertainty * root[:, None]
        rows.append(np.where(either, 0.0, common).reshape(k, size))
    factor = np.concatenate(rows).T * np.sqrt(INFLATION)
    full = factor @ factor.T
    shrunk = (1 - SHRINKAGE) * full + SHRINKAGE * np.diag(np.diag(full))
    means = np.array([np.where(either, c.mean, 0.0).ravel() for c in controls])
    shrunk += INFLATION * means.T @ means / len(controls)
    return ModelDiscrepancy(bias.ravel(), shrunk, tuple(c.engine for c in controls))


def _of_either(case: Case) -> NDArray[np.bool_]:
    """Return which configurations, (n, 1, 1), a geometrical program ran: it errs either way."""
    by_run = [bool(case.program) and c.simulated is not None for c in case.configurations]
    return np.array(by_run)[:, None, None]


@dataclass(frozen=True, eq=False)
class Moments:
    """Hold mean and covariance of m compared values under n hypotheses, and r errors in common."""

    mean: Array  # (n, m)
    covariance: Array  # (n, m, m)
    common: Array  # (n, r, m), by one standard deviation of each error


@dataclass(frozen=True, eq=False)
class MeansProblem:
    """Hold all that a search by means compares: measured values, predictions and their errors."""

    case: Case
    observed: ObservedFeatures
    predicted: MeansHypotheses
    discrepancy: ModelDiscrepancy
    cells: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    """Standard deviation of each value between the parameter values that are tried, (n_hypotheses,
    n_used, n_parameters); empty for single effects."""

    @cached_property
    def mask(self) -> NDArray[np.bool_]:
        """Mask of the features in use, raveled."""
        return np.asarray(self.observed.used.ravel())

    @cached_property
    def places(self) -> tuple[NDArray[np.intp], ...]:
        """Configurations, rows of `FEATURES` and bands of the features in use, (n_used,) each."""
        return np.nonzero(self.observed.used)

    @cached_property
    def changes(self) -> Array:
        """Changes of the features in use by each hypothesis, (n_hypotheses, n_used)."""
        c, f, b = self.places
        return np.asarray((self.predicted.features - self.predicted.features[0])[:, c, f, b])

    @cached_property
    def amounts(self) -> Array:
        """Change of ln T20 in the same band and configuration, (n_hypotheses, n_used)."""
        c, _, b = self.places
        return np.asarray((self.predicted.features - self.predicted.features[0])[:, c, 0, b])

    @property
    def bias(self) -> Array:
        """The model's bias of the features in use, (n_used,)."""
        return np.asarray(self.discrepancy.bias[self.mask])

    def residual(self, i: int, values: Array | None = None) -> Array:
        """Return measured or other ``values`` (..., n_used) minus those of hypothesis ``i``."""
        y = self.observed.values if values is None else values
        return np.asarray(y - self.predicted.features[i].ravel()[self.mask] - self.bias)

    def by_log_time(self, predicted: _PredictedFeatures, rows: Indices, changes: Array) -> Array:
        """Return changes (n, n_used, n_columns) by those of ln T20, (n, size, n_columns)."""
        c, f, b = self.places
        slopes = predicted.slopes[rows][:, c, f, b]
        return np.asarray(changes.take(c * predicted.case.room.n_bands + b, 1) * slopes[:, :, None])

    def moments(
        self,
        rows: Indices,
        members: Sequence[Indices] | None = None,
        predicted: _PredictedFeatures | None = None,
    ) -> Moments:
        """Return mean and covariance of the compared values under n hypotheses.

        For combinations of effects, ``predicted`` has the predictions with all effects of each,
        ``rows`` are its numbers, and ``members`` those of its first effect (n,), of its second, and
        so on.
        """
        made, alone = predicted or self.predicted, [rows] if members is None else members
        c, f, b = self.places
        covariance, together = self.of_alpha(rows, made)
        covariance += self.without_alpha
        for member in alone:
            covariance += self.error_of_change(member)
        mean = made.features[rows][:, c, f, b] + self.bias
        return Moments(mean, covariance, together.swapaxes(1, 2))

    @cached_property
    def without_alpha(self) -> Array:
        """R + D + the covariance from the applied effects, of the features in use."""
        both = self.discrepancy.covariance + self.predicted.applied
        return np.asarray(self.observed.covariance + both[np.ix_(self.mask, self.mask)])

    def of_alpha(
        self, rows: Indices, predicted: _PredictedFeatures | None = None
    ) -> tuple[Array, Array]:
        """Return the covariance (n, n_used, n_used) from alpha and climate, and its common errors."""
        made = predicted or self.predicted
        of_time, together = made.log_time_errors(rows)
        half = self.by_log_time(made, rows, of_time).swapaxes(1, 2)
        return self.by_log_time(made, rows, half), self.by_log_time(made, rows, together)

    def error_of_change(self, rows: Indices) -> Array:
        """Return the covariance of the error of the effects' equations, (n, n_used, n_used)."""
        _, f, b = self.places
        errors = self.predicted.spectrum_errors[rows]
        errors = errors[:, :, errors.any((0, 1))].take(b, 1)
        alone = self.predicted.formula_errors[rows]
        out = _misfit(self.changes[rows], self.amounts[rows], f, errors, alone)
        if self.cells.size:
            cells = self.cells[rows]
            out += cells @ cells.swapaxes(1, 2)
        return out

    def covariance_of(self, i: int, scale: float = 1.0) -> tuple[Array, Array]:
        """Return covariances (n_used, n_used) of hypothesis ``i``, by alpha and by the rest."""
        row = slice(i, i + 1)
        (alpha,), (common,) = self.of_alpha(row)
        if scale != 1:
            alpha = alpha + (scale**2 - 1) * common @ common.T
        return alpha, self.without_alpha + self.error_of_change(row)[0]

    def goodness_of_fit(self, i: int, scale: float = 1.0) -> tuple[float, float]:
        """Return the distance sqrt(r' C⁻¹ r / n) of hypothesis ``i`` and its p-value by chi-square."""
        alpha, other = self.covariance_of(i, scale)
        residual = self.residual(i)
        square = float(residual @ np.linalg.solve(alpha + other, residual))
        return float(np.sqrt(square / len(residual))), float(chdtrc(len(residual), square))

    def standardized_residuals(self) -> Array:
        """Return modelled less measured over its standard deviation, as `ObservedFeatures.features`."""
        model = (
            self.of_alpha(slice(0, 1))[0][0] + self.discrepancy.covariance[self.mask][:, self.mask]
        )
        out = np.full(self.observed.used.shape, np.nan)
        spread = np.sqrt(np.diag(model) + np.diag(self.observed.covariance))
        out[self.observed.used] = -self.residual(0) / spread
        return out


_AT_ONCE = 32  # hypotheses
_ELEMENTS = 4_000_000  # numbers in an array of covariances: 32 MB


def _log_likelihoods(
    parts: Iterable[Moments],
    values: Array,
    ends: Sequence[int],
    *,
    off: bool,
    coarsened: bool = True,
) -> tuple[Array, Array]:
    """Return log densities of data (n_draws, n), without and with a common error F of coefficients.

    Both are (n_ends, n_hypotheses, n_draws), of the leading features up to each of ``ends``. With
    it the density is the mean over the factors s in `SCALES`, with C + (s² - 1) F F'; -inf if
    ``off`` is False. For ``coarsened`` see `rtcal.finder.evidence.student`.
    """
    scales = np.array(SCALES)
    more, log_probability = (scales[:, 0] ** 2 - 1)[:, None, None], np.log(scales[:, 1])
    stated, together = [], []
    for of in parts:
        rows = values - of.mean[:, None]
        if off:
            rows = np.concatenate([rows, of.common], axis=1)
        leading = leading_products(of.covariance, rows, len(values), ends)
        as_stated, scaled = [], []
        for m, (half, square, across, inner) in zip(ends, leading, strict=True):
            as_stated.append(student(square, half, m, coarsened=coarsened))
            if off:
                wider = with_columns(
                    square[:, None],
                    half[:, None],
                    np.sqrt(more) * across[:, None],
                    more * inner[:, None],
                )
                log = log_probability[:, None] + student(*wider, m, coarsened=coarsened)
                # Of two numbers this is much quicker than logsumexp.
                scaled.append(np.logaddexp.reduce(log, axis=1))
        stated.append(np.array(as_stated))
        together.append(np.array(scaled) if off else np.full_like(stated[-1], -np.inf))
    return np.concatenate(stated, axis=1), np.concatenate(together, axis=1)


def log_density(residual: Array, covariance: Array) -> Array:
    """Return the log density of a residual (m,) by Student's t with n covariances (n, m, m), (n,)."""
    n = len(covariance)
    of = Moments(np.zeros((n, len(residual))), covariance.copy(), np.zeros((n, 0, len(residual))))
    (log,), _ = _log_likelihoods([of], residual[None], [len(residual)], off=False)
    return np.asarray(log[:, 0])


UNKNOWN_SIZES = (0.03, 0.08, 0.2)
"""Standard deviations of ln T20 that an unknown effect causes."""
UNKNOWN_FEATURES = (1.0, 0.4, 0.4, 8.0, 8.0)
"""Standard deviation of each feature that an unknown effect causes, per unit of that of ln T20."""
UNKNOWN_SMOOTH, UNKNOWN_CORRELATION = 0.6, 0.75
"""Share of an unknown effect that is smooth over bands, and its correlation from band to band."""
NEGLIGIBLE = 8.0
"""Evidence in nats below the best from which a size is negligible (odds of 3000 to one)."""


@dataclass(frozen=True, eq=False)
class MeansEvidence:
    """Hold log likelihoods by hypothesis, (n,), or (n, n_draws) of random data."""

    problem: MeansProblem
    stated: Array  # with the input coefficients
    off: Array  # with an error that all coefficients have in common
    unknown: Array  # under an effect that is not in the library
    prior_off: float  # prior probability of that error

    def by_effect(self) -> dict[str, Array]:
        """Return the log marginal likelihood of each effect, "none", "coefficients" and "unknown"."""
        rows = self.problem.predicted.rows  # one after the other
        log = self._weighted(self.by_hypothesis())
        sums = np.logaddexp.reduceat(log, [of_one[0] for of_one in rows.values()], axis=0)
        out = dict(zip(rows, sums, strict=True))
        return out | {NONE: self.stated[0], COEFFICIENTS: self.off[0], UNKNOWN: self.unknown}

    def by_hypothesis(self) -> Array:
        """Return the log likelihoods, averaged over an error in common being there or not."""
        return log_mixture(self.stated, self.off, self.prior_off)

    def off_given(self, name: str) -> Array:
        """Return the probability of an error in common, given an effect or "none"."""
        rows = self.problem.predicted.rows[name]
        with np.errstate(divide="ignore"):
            off = self._weighted(self.off)[rows] + np.log(self.prior_off)
        both = self._weighted(self.by_hypothesis())[rows]
        return np.asarray(np.exp(logsumexp(off, axis=0) - logsumexp(both, axis=0)))

    def _weighted(self, log: Array) -> Array:
        """Return log likelihoods plus the log of the parameters' prior, given the effect."""
        weights = self.problem.predicted.log_weights
        return np.asarray(weights.reshape(-1, *[1] * (log.ndim - 1)) + log)

    def nats(self, name: str) -> float:
        """Return the ln Bayes factor of an effect against "none"."""
        table = self.by_effect()
        return float(table[name] - table[NONE])

    def beside(self, name: str, others: Sequence[AppliedEffect] = ()) -> MeansEvidence:
        """Return the log likelihoods of one effect with ``others`` added to the model."""
        case = self.problem.case
        case = replace(case, applied=(*case.applied, *others))
        predicted = predict_hypotheses(case, [self.problem.predicted.effects[name]])
        problem = replace(self.problem, case=case, predicted=predicted)
        return evaluate_beyond(problem, self.prior_off)[-1]


def evaluate(
    problem: MeansProblem,
    prior_off: float,
    values: Array | None = None,
    ends: Sequence[int] = (),
) -> list[MeansEvidence]:
    """Return the log likelihoods of all hypotheses and of an unknown effect, for each leading part.

    ``values`` (n_draws, n_used) replace the measured ones. The last entry is that of all values.
    """
    ends = [*ends, len(problem.observed.values)]
    y = np.atleast_2d(problem.observed.values if values is None else values)
    alpha, other = problem.covariance_of(0)
    unknown = _unknown_evidence(problem.residual(0, y), alpha + other, problem.observed.used, ends)
    n, (draws, m) = len(problem.predicted.names), y.shape
    # A few hypotheses at a time, so that their covariances stay in the processor's cache.
    step = max(1, min(_AT_ONCE, _ELEMENTS // (m + draws) ** 2))
    of_rows = (problem.moments(slice(begin, begin + step)) for begin in range(0, n, step))
    likelihoods = _log_likelihoods(of_rows, y, ends, off=prior_off > 0)
    for likelihood in likelihoods:
        likelihood[:, ~problem.predicted.possible] = _IMPOSSIBLE
    parts = [*likelihoods, unknown]
    if values is None:
        parts = [part[..., 0] for part in parts]
    return [
        MeansEvidence(problem, stated, off, unknown, prior_off)
        for stated, off, unknown in zip(*parts, strict=True)
    ]


_IMPOSSIBLE = -1e4
"""Log likelihood in nats of a hypothesis that the data exclude. It is finite: sizes have a density."""


def evaluate_beyond(
    problem: MeansProblem, prior_off: float, ends: Sequence[int] = ()
) -> list[MeansEvidence]:
    """Return what `evaluate` does, with further sizes where the last one fits best, while it rises."""
    case = problem.case
    evidence, reached = evaluate(problem, prior_off, ends=ends), dict[str, float]()
    for _ in range(_ROUNDS):
        predicted, likelihood = problem.predicted, evidence[-1].by_hypothesis()
        least, grids = max(likelihood[0], likelihood.max() - NEGLIGIBLE), []
        for name, effect in predicted.effects.items():
            rows, grid = predicted.rows[name], predicted.grid(name)
            likeliest = rows[np.argmax(likelihood[rows])]
            rises = likelihood[likeliest] > reached.get(name, -np.inf) + _FLAT
            reached[name] = float(likelihood[likeliest])
            if rises and reached[name] > least:
                grid = beyond(effect, grid, predicted.parameters[likeliest], case.room)
            grids.append(grid)
        if sum(map(len, grids)) == len(predicted.names) - 1:
            break
        predicted = predict_hypotheses(case, list(predicted.effects.values()), grids)
        problem = replace(problem, predicted=predicted)
        evidence = evaluate(problem, prior_off, ends=ends)
    return evidence


_ROUNDS = 5  # times that a grid may go on, by four steps each
_FLAT = 0.1  # evidence in nats that the last four steps must have gained for a grid to go on


def _unknown_evidence(
    residual: Array,
    covariance: Array,
    used: Array,
    ends: Sequence[int],
    *,
    coarsened: bool = True,
) -> Array:
    """Return the log evidence of an unknown effect, (n_ends, n_draws), of residuals (n_draws, n_used).

    Its change of the features is random and partly smooth over bands.
    """
    count, _, n_bands = used.shape
    lag = np.abs(np.subtract.outer(np.arange(n_bands), np.arange(n_bands)))
    smooth = UNKNOWN_SMOOTH * UNKNOWN_CORRELATION**lag
    over_bands = smooth + (1 - UNKNOWN_SMOOTH) * np.eye(n_bands)
    # Common to all configurations; independent between features.
    of_one = np.kron(np.diag(np.square(UNKNOWN_FEATURES)), over_bands)
    mask = used.ravel()
    extra = np.tile(of_one, (count, count))[np.ix_(mask, mask)]
    of = Moments(
        np.zeros((len(UNKNOWN_SIZES), residual.shape[1])),
        covariance + np.square(UNKNOWN_SIZES)[:, None, None] * extra,
        np.zeros(0),
    )
    log, _ = _log_likelihoods([of], residual, ends, off=False, coarsened=coarsened)
    return np.asarray(logsumexp(log, axis=1) - np.log(len(UNKNOWN_SIZES)))


QUANTILE = 0.95
"""Share of the null rooms that exceed no threshold: 5 % false alarms."""
MINIMUM = 0.0
"""Smallest threshold in nats: below it, nothing missing explains the data better."""


def null_scores(
    case: Case,
    observed: ObservedFeatures,
    predicted: MeansHypotheses,
    controls: Sequence[ControlRooms],
    prior: Prior,
    draws: int = 400,
) -> Array:
    """Return the `score` of random rooms from whose model nothing is missing, (n_draws, n_steps)."""
    rng = np.random.default_rng([0, 3])
    ends, scores, either = list(steps(case, observed.used))[:-1], [], _of_either(case)
    signs = (1, -1) if either.any() else (1,)  # without a run the rooms drawn stay the same
    for fold in (0, 1):
        training = [_part(c, fold) for c in controls]
        other = [_part(c, 1 - fold) for c in controls]
        test = [
            np.concatenate([np.where(either, sign * c.errors, r.errors) for sign in signs])
            for c, r in zip(other, recentred(other), strict=True)
        ]
        values = draw_null_features(case, observed, predicted.applied, test, rng, draws // 2)
        learnt = MeansProblem(case, observed, predicted, estimate_discrepancy(case, training))
        parts = evaluate(learnt, prior.off, values, ends)
        scores.append(np.stack([score(part, prior) for part in parts], axis=1))
    return np.concatenate(scores)


def thresholds(scores: Array) -> Array:
    """Return the scores (n_steps,) at one level of which 5 % of the rooms exceed one or more."""
    raised = np.maximum(scores, MINIMUM)
    below = [np.searchsorted(np.sort(column), column) for column in raised.T]
    level = np.quantile(np.max(below, axis=0) / max(len(scores) - 1, 1), QUANTILE)
    return np.asarray(np.quantile(raised, level, axis=0))


_FEW = 16  # number of an engine's reference rooms below which they are not divided


def _part(controls: ControlRooms, fold: int) -> ControlRooms:
    errors = controls.errors
    return ControlRooms(controls.engine, errors[fold::2] if len(errors) >= _FEW else errors)


def score(evidence: MeansEvidence, prior: Prior) -> Array:
    """Return the ln Bayes factor that something is missing from the model.

    An uneven sound field is nothing missing from a geometrical program, which simulates it.
    """
    table: Mapping[str, Array] = evidence.by_effect()
    program, effects = evidence.problem.case.program, evidence.problem.predicted.effects
    nothing = [k for k in table if k == NONE or (program and family_of(k, effects) == FIELD)]

    def of(names: Sequence[str]) -> Array:
        log = np.array([prior.log_probability[k] for k in names])
        log -= np.logaddexp.reduce(log)
        every = np.array([table[k] for k in names])
        return np.asarray(np.logaddexp.reduce((every.T + log).T))

    return of([k for k in table if k not in nothing]) - of(nothing)


def draw_null_features(
    case: Case,
    observed: ObservedFeatures,
    applied: Array,
    errors: Sequence[Array],
    rng: np.random.Generator,
    n: int,
) -> Array:
    """Return random measured values (n, n_used) of rooms from whose model nothing is missing.

    ``errors`` has the equation's errors in each simulator's reference rooms, and ``applied`` the
    covariance from effects in the model and unknown distances.
    """
    in_common = drawn(directions(case, NULL_POWER), case.room.materials, rng, n)
    alphas = draw_alpha(case, rng, n) + in_common
    alphas = np.clip(alphas, 0.001, 0.99 * case.room.most_alpha)
    rows = [
        predict_in(case, c, states(case, c, [a[i] for a in alphas])).features
        for i, c in enumerate(case.configurations)
    ]
    values = np.stack(rows, axis=1)
    engine = rng.integers(len(errors), size=n)
    picked = np.stack([errors[e][rng.integers(len(errors[e]))] for e in engine])
    values = values + np.nan_to_num(picked)
    mask = observed.used.ravel()
    covariance = observed.covariance + applied[np.ix_(mask, mask)]
    noise = rng.standard_normal((n, len(covariance))) @ symmetric_root(covariance)
    return np.asarray(values[:, observed.used] + noise)


def compare(problem: MeansProblem) -> MeansProblem:
    """Return a problem for combinations of effects, with two further errors.

    Those of the direct sound's level (`DIRECT_SOUND`), and of the change between neighbouring
    parameter values (`MeansProblem.cells`), would look like a second effect.
    """
    case, predicted = problem.case, problem.predicted
    columns = np.zeros((*predicted.features.shape[1:], case.room.n_bands))
    over_bands = np.linalg.cholesky(correlation(case.room.centre_frequencies, COMMON_CORRELATION))
    for i, c in enumerate(case.configurations):
        base, at = state(case, c), distances(case, c)
        levels = (base.direct_db + 1.0, base.direct_db - 1.0)
        up, down = predict([replace(base, direct_db=level) for level in levels], at).features
        columns[i] = 0.5 * DIRECT_SOUND * (up - down)[:, :, None] * over_bands
    flat = columns.reshape(-1, columns.shape[-1])
    # Changes over each hypothesis's cell of the grid. The standard deviation of an even distribution is
    # the step over sqrt(12). Without it, what lies between the grid's points would look like a second
    # effect.
    which, f, b = problem.places
    features = predicted.features[:, which, f, b]
    steps: list[Array] = []
    for name, effect in predicted.effects.items():
        rows, grid = predicted.rows[name], predicted.grid(name)
        for k, parameter in enumerate(p for p in grid[0] if p not in effect.discrete):
            if k == len(steps):
                steps.append(np.zeros_like(features))
            others = [p for p in grid[0] if p != parameter]
            keys = list(map(itemgetter(*others), grid)) if others else [()] * len(grid)
            lines: dict[Any, list[int]] = {}
            for j in np.argsort(list(map(itemgetter(parameter), grid))):
                lines.setdefault(keys[j], []).append(rows[j])
            for line in lines.values():
                if len(line) > 1:
                    steps[k][line] = np.gradient(features[line], axis=0)
    cells = np.stack(steps, axis=-1) / np.sqrt(12) if steps else np.zeros((*features.shape, 0))
    predicted = replace(predicted, applied=predicted.applied + flat @ flat.T)
    return replace(problem, predicted=predicted, cells=cells)


DIRECT_SOUND = 6.0
"""Standard deviation of the direct sound's level in dB, in every set; alike in neighbouring octaves.
Objects between source and receiver shade it, and the directivity of a source may be 6 dB (ISO 3382-1,
Table 1, 4 kHz). No formula has either in it, so that C80 and G would speak for a second effect."""
Members = tuple[int, ...]
"""A set of effects with their parameters: rows of `MeansHypotheses`, in the order in which they act."""
_SETS_AT_ONCE = 256


def applied_effects(predicted: MeansHypotheses, rows: Members) -> tuple[AppliedEffect, ...]:
    """Return the effects of a set with their parameters."""
    names, parameters = predicted.names, predicted.parameters
    return tuple(AppliedEffect(predicted.effects[names[i]], parameters[i]) for i in rows)


def acting_order(case: Case, predicted: MeansHypotheses) -> tuple[list[str], frozenset[str]]:
    """Return names of effects in the order in which they act, and of those that shape the decay.

    Another equation comes first, because absorbers are added in its terms; then effects that
    replace input values; then all others. A combination has only one that shapes the decay.
    """
    base = state(case, case.configurations[0])
    changed = {
        name: changed_states(effect, base, predicted.grid(name)[:1])[0]
        for name, effect in predicted.effects.items()
    }

    def rank(name: str) -> tuple[bool, bool]:
        contradicts = predicted.effects[name].contradicts(case.room)
        return changed[name].equation == base.equation, not contradicts

    bends = frozenset(name for name, made in changed.items() if made.shape is not None)
    return sorted(changed, key=rank), bends


class Screen:
    """Compute approximate log likelihoods of pairs, or of triples with the pair ``base``."""

    def __init__(self, compared: MeansProblem, base: Members = ()) -> None:
        predicted, change, amount = compared.predicted, compared.changes, compared.amounts
        _, f, b = compared.places
        alpha, other = compared.covariance_of(0)
        smooth = predicted.spectrum_errors[:, :, :2].take(b, 1)
        error = _misfit_columns(change, amount, f, smooth)
        residual = compared.residual(0)
        for i in base:
            residual = residual - change[i]
            other = other + compared.error_of_change(slice(i, i + 1))[0]
        factor = np.linalg.cholesky(alpha + other)
        self._half = float(np.log(np.diag(factor)).sum())
        self._m = len(factor)

        def whitened(rows: Array) -> Array:
            flat = rows.reshape(-1, self._m)
            return np.asarray(solve_triangular(factor, flat.T, lower=True).T.reshape(rows.shape))

        self._z = whitened(residual[None])[0]
        self._v = whitened(change)
        self._w = whitened(np.concatenate([error, compared.cells], axis=2).swapaxes(1, 2))
        self._own = self._w @ self._w.swapaxes(1, 2)

    def pairs(self, first: NDArray[np.intp], second: NDArray[np.intp]) -> Array:
        """Return the log likelihoods of pairs of hypotheses by their numbers, (n_first, n_second)."""
        a, b, r = len(first), len(second), self._w.shape[1]
        left = self._z - self._v[first]
        v, w1, w2 = self._v[second], self._w[first], self._w[second]
        # I + W' W, bordered by W' r and r' r: one Cholesky factor has its determinant and, squared in
        # its last element, what the misfit leaves of r' r.
        bordered = np.empty((a, b, 2 * r + 1, 2 * r + 1))
        bordered[:, :, :r, :r] = self._own[first][:, None]
        bordered[:, :, r:-1, r:-1] = self._own[second]
        bordered[:, :, r:-1, :r] = np.tensordot(w2, w1, axes=(2, 2)).transpose(2, 0, 1, 3)
        diagonal = np.arange(2 * r)
        bordered[:, :, diagonal, diagonal] += 1.0
        bordered[:, :, -1, :r] = (w1 @ left[:, :, None])[:, None, :, 0] - np.einsum(
            "arm,bm->abr", w1, v, optimize=True
        )
        bordered[:, :, -1, r:-1] = (
            np.einsum("am,brm->abr", left, w2, optimize=True) - (w2 @ v[:, :, None])[None, :, :, 0]
        )
        bordered[:, :, -1, -1] = (left**2).sum(1)[:, None] - 2 * left @ v.T + (v**2).sum(1)
        roots = np.diagonal(np.linalg.cholesky(bordered), axis1=2, axis2=3)
        half, square = np.log(roots[..., :-1]).sum(-1), roots[..., -1] ** 2
        return student(square, self._half + half, self._m, coarsened=False)


def evaluate_sets(compared: MeansProblem, sets: Sequence[Members], *, off: bool) -> Array:
    """Return the log likelihoods of sets, (n_sets, 2): as stated, and with an error in common."""
    begins, possible = range(0, len(sets), _SETS_AT_ONCE), list[NDArray[np.bool_]]()

    def parts() -> Iterator[Moments]:
        for begin in begins:
            of, finite = moments(compared, sets[begin : begin + _SETS_AT_ONCE])
            possible.append(finite)
            yield of

    values = compared.observed.values[None]
    both = _log_likelihoods(parts(), values, [values.shape[1]], off=off, coarsened=False)
    log = np.stack([of_all[0, :, 0] for of_all in both], axis=1)
    return np.where(np.concatenate(possible)[:, None], log, -np.inf)


def moments(compared: MeansProblem, sets: Sequence[Members]) -> tuple[Moments, NDArray[np.bool_]]:
    """Return `Moments` with sets of effects in the model, and which sets give finite values."""
    most = max(map(len, sets))
    members = [np.array([rows[k] if k < len(rows) else 0 for rows in sets]) for k in range(most)]
    if most < 2:
        # These are predicted already.
        of = compared.moments(members[0] if most else np.zeros(len(sets), dtype=int), members)
    else:
        made = _predict_states(compared.case, _states_of(compared, sets))
        of = compared.moments(np.arange(len(sets)), members, made)
    possible = np.asarray(np.isfinite(of.mean).all(1) & np.isfinite(of.covariance).all((1, 2)))
    of.mean[~possible], of.covariance[~possible] = 0.0, np.eye(of.mean.shape[1])
    of.common[~possible] = 0.0
    return of, possible


def _states_of(compared: MeansProblem, sets: Sequence[Members]) -> list[list[RoomState]]:
    """Return the room's states with the effects of each combination, for every configuration."""
    predicted, out = compared.predicted, []
    for where in compared.case.configurations:
        made: dict[Members, RoomState] = {(): state(compared.case, where)}
        for length in range(1, max(map(len, sets)) + 1):
            groups: dict[tuple[Members, str], list[int]] = {}
            for rows in dict.fromkeys(s[:length] for s in sets if len(s) >= length):
                groups.setdefault((rows[:-1], predicted.names[rows[-1]]), []).append(rows[-1])
            for (before, name), last in groups.items():
                effect = predicted.effects[name]
                states = [made[before]] * len(last)
                if not (where.suspect_removed and effect.removable):
                    grid = [predicted.parameters[i] for i in last]
                    states = added(effect, made[before], grid)
                made |= {(*before, i): s for i, s in zip(last, states, strict=True)}
        out.append([made[rows] for rows in sets])
    return out


def _unknown_beside(compared: MeansProblem, rows: NDArray[np.intp]) -> Array:
    """Return the log likelihood, (n_rows,), of single effects together with an unknown effect."""
    of, _ = moments(compared, [(i,) for i in rows.tolist()])
    residual, ends = compared.observed.values - of.mean, [of.mean.shape[1]]
    used = compared.observed.used
    return np.array(
        [
            _unknown_evidence(r[None], covariance, used, ends, coarsened=False)[0, 0]
            for r, covariance in zip(residual, of.covariance, strict=True)
        ]
    )


def averaged_alpha(compared: MeansProblem, likely: Sequence[tuple[Members, float]]) -> Array:
    """Return the mean of alpha, (n_materials, n_bands), over the probable combinations of effects.

    Under each, the compared values y and alpha are jointly normal (Hoeting et al. 1999): E[alpha |
    y] = mu + Sigma G' C⁻¹ (y - mean), with G = d y / d alpha. T changes alpha only as far as no
    effect and no error of the equation explains T.
    """
    sets = [rows for rows, _ in likely]
    of, possible = moments(compared, sets)
    room, (c, f, b) = compared.case.room, compared.places
    made = _predict_states(compared.case, _states_of(compared, sets))
    _, changed, rho, *_ = _uncertain(compared.case)
    # What stands where a configuration changed a material is another one.
    per_alpha = -np.where(changed, 0.0, made.jacobian)
    slopes = made.slopes[:, c, f, b][..., None] * per_alpha[:, c, :, b].swapaxes(0, 1)
    weights = np.array([p for _, p in likely]) * possible
    out = np.array(room.alpha)
    for k in np.flatnonzero(weights):
        explained = np.linalg.solve(of.covariance[k], compared.observed.values - of.mean[k])
        pull = np.zeros(out.shape)  # G' C^-1 (y - mean)
        np.add.at(pull.T, b, explained[:, None] * slopes[k])
        out += weights[k] / weights.sum() * room.sigma * ((room.sigma * pull) @ rho)
    return np.clip(out, 0.0, compared.case.room.most_alpha)


MOST = 3
KEPT = ((0.0, 0.5, 16), (1e-3, 0.99, 96))
"""Which parameters of two effects are evaluated: least probability of the pair among all pairs, share
of the pair's probability that the most probable parameters must hold, and their greatest number."""
UNEXPLAINED = 0.05
"""Probability of the residuals under the best pair below which three effects are tried: the usual level
of a test of fit."""
_BESIDE = 60  # single hypotheses that are evaluated with an unknown effect beside them
_PAIRS_OF_THREE = 3  # pairs that a third effect is added to
_LIKELY = 100  # hypotheses with their parameters that a plan goes on from
_KEPT_THIRD = 8  # parameters of the third effect that are evaluated
DISTINCT = 0.1
"""Odds against the best combination of effects from which two effects can no longer replace each
other."""


@dataclass(frozen=True, eq=False)
class SetPosterior:
    """Hold the probabilities of combinations of effects after the measurement."""

    sets: Mapping[Names, float]  # the most probable first; () is that nothing is missing
    off: Mapping[Names, float]  # probability of an error in common, given the set
    rows: Mapping[Names, Members]  # the most probable hypotheses of each set
    likely: Sequence[tuple[Members, float]]  # the most probable of all, with probabilities

    def best(self, effects: Mapping[str, Effect], families: Names = ()) -> Names:
        """Return the most probable combination without "unknown", of ``families`` if given."""
        return next(
            s
            for s in self.sets
            if s and UNKNOWN not in s and (not families or families_of(s, effects) == families)
        )

    def effects(self) -> dict[str, float]:
        """Return the probability of each effect, of "none", and of an error in common, falling."""
        out = summed((name, p) for names, p in self.sets.items() for name in names)
        out[COEFFICIENTS] = sum(p * self.off[names] for names, p in self.sets.items())
        out[NONE] = self.sets[()] * (1 - self.off[()])
        return most_probable_first(out)

    def families(self, effects: Mapping[str, Effect]) -> dict[str, float]:
        """Return the probability that an effect of each group is missing, falling."""
        every, parts = self.effects(), list[tuple[str, float]]()
        for names, p in self.sets.items():
            narrow = {family_of(name, effects) for name in names}
            parts += [(family, p) for family in narrow | set(map(wide, narrow))]
        out = {name: every[name] for name in (COEFFICIENTS, NONE)}
        return most_probable_first(out | summed(parts))

    def stand_ins(self, best: Names) -> dict[str, tuple[str, ...]]:
        """Return the effects that may replace each one of ``best`` at a tenth of its probability."""
        out = {}
        for name in best:
            others = set(best) - {name}
            out[name] = tuple(
                next(iter(set(names) - others))
                for names, p in self.sets.items()
                if len(names) == len(best) and names != best and others < set(names)
                if p >= DISTINCT * self.sets[best]
            )
        return out


def single_posterior(evidence: MeansEvidence, probabilities: Mapping[str, float]) -> SetPosterior:
    """Return the probabilities of combinations of at most one effect, from those of single effects."""
    nothing = probabilities[NONE] + probabilities[COEFFICIENTS]
    sets: dict[Names, float] = {(): nothing}
    off = {(): probabilities[COEFFICIENTS] / nothing if nothing else 0.0, (UNKNOWN,): 0.0}
    rows: dict[Names, Members] = {(): (), (UNKNOWN,): ()}
    likely: list[tuple[Members, float]] = [((), nothing)]
    log, predicted = evidence.by_hypothesis(), evidence.problem.predicted
    for name, p in probabilities.items():
        if name in (NONE, COEFFICIENTS):
            continue
        sets[name,] = p
        if name == UNKNOWN:
            continue
        places = predicted.rows[name]
        weighted = log[places] + predicted.log_weights[places]
        share = p * np.exp(weighted - logsumexp(weighted))
        off[name,] = float(evidence.off_given(name))
        rows[name,] = (int(places[np.argmax(log[places])]),)
        likely += [((int(i),), float(w)) for i, w in zip(places, share, strict=True)]
    likely = sorted(likely, key=itemgetter(1), reverse=True)[:_LIKELY]
    total = sum(p for _, p in likely)
    return SetPosterior(most_probable_first(sets), off, rows, [(r, p / total) for r, p in likely])


def posterior_of_sets(
    compared: MeansProblem,
    prior: Prior,
    *,
    expected: float = EXPECTED,
    most: int = MOST,
) -> SetPosterior:
    """Return the probabilities of all combinations of up to ``most`` effects.

    ``expected`` is the mean of the Poisson distribution of their number. Three are tried only if
    the best two leave residuals with a p-value below 0.05.
    """
    tables = _Tables(compared, prior)
    if most > 1:
        tables.add_pairs()
    if most > 2 and not tables.explained():
        tables.add_triples()
    weight = log_prior(prior, tables.order, expected, most)
    probability = _normalised({s: v + weight(s) for s, v in tables.log.items()})
    return SetPosterior(
        most_probable_first(probability), tables.off, tables.best, tables.likely(weight)
    )


def _normalised(log: Mapping[Key, float]) -> dict[Key, float]:
    """Return probabilities of their logs, but for a factor."""
    norm = float(logsumexp(list(log.values())))
    return {key: float(np.exp(v - norm)) for key, v in log.items()}


class _Tables:
    """Log evidence of each set, its probability of coefficients off together, and its best rows."""

    def __init__(self, compared: MeansProblem, prior: Prior) -> None:
        self._compared = compared
        predicted = compared.predicted
        self.order, self._apart = acting_order(compared.case, predicted)
        self._rows = {n: predicted.rows[n] for n in self.order}
        self._weights = predicted.log_weights
        with np.errstate(divide="ignore"):
            self._prior_off = np.log([1 - prior.off, prior.off])
        self._log_odds = prior.log_probability
        self._unknown = bool(np.isfinite(prior.log_probability[UNKNOWN]))
        self.log: dict[Names, float] = {}
        self.off: dict[Names, float] = {}
        self.best: dict[Names, Members] = {}
        self._by_rows: dict[Members, float] = {}
        self._evaluated: dict[Members, Array] = {}
        alone: dict[Names, list[Members]] = {(): [()]}
        alone |= {(n,): [(int(i),) for i in rows] for n, rows in self._rows.items()}
        self._evaluate(alone, dict.fromkeys(alone, 0.0))
        if self._unknown:
            self.log[UNKNOWN,] = float(_unknown_beside(compared, np.array([0]))[0])
            self.off[UNKNOWN,], self.best[UNKNOWN,] = self.off[()], ()

    def likely(self, weight: Callable[[Names], float]) -> list[tuple[Members, float]]:
        """Return the most probable rows with their probabilities."""
        names = self._compared.predicted.names
        log = {rows: v + weight(tuple(names[i] for i in rows)) for rows, v in self._by_rows.items()}
        most = sorted(log, key=lambda rows: -log[rows])[:_LIKELY]
        return [*_normalised({rows: log[rows] for rows in most}).items()]

    def add_pairs(self) -> None:
        """Add every two effects, and every effect with an unknown one beside it."""
        screen = Screen(self._compared)
        screened: dict[Names, tuple[Array, list[Members]]] = {}
        for a, b in combinations(self.order, 2):
            if {a, b} <= self._apart:
                continue
            first, second = self._rows[a], self._rows[b]
            table = screen.pairs(first, second)
            table = table + self._weights[first][:, None] + self._weights[second]
            likeliest = np.argsort(-table, axis=None)[: KEPT[-1][2]]
            i, j = np.unravel_index(likeliest, table.shape)
            rows: list[Members] = list(zip(first[i].tolist(), second[j].tolist(), strict=True))
            # Of each row, ln of the evidence of all over that of the rows up to it.
            share = logsumexp(table) - np.logaddexp.accumulate(table[i, j])
            screened[a, b] = np.asarray(share), rows
        for least, share, most in KEPT:
            last = {}
            for s in self._likely_pairs(least) if least else list(screened):
                enough = np.flatnonzero(screened[s][0] <= -np.log(share))
                last[s] = min(int(enough[0]) if len(enough) else len(screened[s][0]) - 1, most - 1)
            self._evaluate(
                {s: screened[s][1][: i + 1] for s, i in last.items()},
                {s: float(screened[s][0][i]) for s, i in last.items()},
            )
        if self._unknown:
            self._add_unknown()

    def _likely_pairs(self, least: float) -> list[Names]:
        """Return the pairs that have at least this probability among the pairs."""
        log = {
            s: v + float(self._log_odds[s[0]] + self._log_odds[s[1]])
            for s, v in self.log.items()
            if len(s) == 2 and UNKNOWN not in s
        }
        norm = float(logsumexp(list(log.values())))
        return [s for s, v in log.items() if v >= norm + np.log(least)]

    def _add_unknown(self) -> None:
        log = np.array([self._by_rows.get((i,), -np.inf) for i in range(len(self._weights))])
        beside = np.argsort(-log)[:_BESIDE]
        values = _unknown_beside(self._compared, beside)
        for n in self.order:
            at = np.flatnonzero(np.isin(beside, self._rows[n]))
            if len(at):
                i = beside[at]
                others = self.log[n,] - float(logsumexp(log[i]))
                self.log[n, UNKNOWN] = float(logsumexp(values[at] + self._weights[i])) + others
                self.off[n, UNKNOWN], self.best[n, UNKNOWN] = self.off[n,], self.best[n,]

    def explained(self) -> bool:
        """Return whether the most probable two effects explain the measurement."""
        names = self._likeliest_pairs(1)[0]
        case, predicted = self._compared.case, self._compared.predicted
        both = applied_effects(predicted, self.best[names])
        with_both = replace(case, applied=(*case.applied, *both))
        predicted = predict_hypotheses(with_both, [])
        compared = compare(replace(self._compared, case=with_both, predicted=predicted))
        return compared.goodness_of_fit(0)[1] >= UNEXPLAINED

    def _likeliest_pairs(self, n: int) -> list[Names]:
        pairs: list[Names] = [s for s in self.log if len(s) == 2 and UNKNOWN not in s]
        return sorted(pairs, key=lambda s: -self.log[s])[:n]

    def add_triples(self) -> None:
        """Add a third effect to the likeliest pairs, at the pairs' best parameters."""
        for pair in self._likeliest_pairs(_PAIRS_OF_THREE):
            base = self.best[pair]
            screen = Screen(self._compared, base)
            chosen: dict[Names, list[Members]] = {}
            share: dict[Names, float] = {}
            for n in self.order:
                if n in pair or (n in self._apart and self._apart & set(pair)):
                    continue
                table = screen.pairs(self._rows[n], np.array([0]))[:, 0]
                table = table + self._weights[self._rows[n]]
                kept = np.argsort(-table)[:_KEPT_THIRD]
                names = tuple(sorted((*pair, n), key=self.order.index))
                place = names.index(n)
                chosen[names] = [
                    (*base[:place], int(i), *base[place:]) for i in self._rows[n][kept]
                ]
                share[names] = float(logsumexp(table) - logsumexp(table[kept]))
            weight = float(self._weights[list(base)].sum())
            at_best = float(self._values([base])[0].max()) + weight
            self._evaluate(chosen, {k: v + self.log[pair] - at_best for k, v in share.items()})

    def _values(self, sets: Sequence[Members]) -> Array:
        """Return ln likelihood times prior of "off", (n_sets, 2): as stated, and off together."""
        new = [rows for rows in dict.fromkeys(sets) if rows not in self._evaluated]
        if new:
            off = bool(np.isfinite(self._prior_off[1]))
            both = evaluate_sets(self._compared, new, off=off) + self._prior_off
            self._evaluated |= dict(zip(new, both, strict=True))
        return np.array([self._evaluated[rows] for rows in sets])

    def _evaluate(
        self, chosen: Mapping[Names, Sequence[Members]], share: Mapping[Names, float]
    ) -> None:
        """Evaluate sets of rows; ``share`` is ln of all parameters' evidence over the chosen ones'."""
        every = [rows for sets in chosen.values() for rows in sets]
        if not every:
            return
        values = self._values(every)
        weighted = values + np.array([self._weights[list(rows)].sum() for rows in every])[:, None]
        start = 0
        for names, sets in chosen.items():
            part = slice(start, start + len(sets))
            start = part.stop
            self._by_rows |= {
                rows: float(v) + share[names]
                for rows, v in zip(sets, np.logaddexp(*weighted[part].T), strict=True)
            }
            evidence = float(logsumexp(weighted[part])) + share[names]
            # A third effect is tried beside several pairs; the best stays.
            if np.isfinite(evidence) and (
                len(names) < 3 or evidence > self.log.get(names, -np.inf)
            ):
                self.log[names] = evidence
                self.off[names] = float(
                    np.exp(logsumexp(weighted[part, 1]) - logsumexp(weighted[part]))
                )
                self.best[names] = sets[int(np.argmax(np.logaddexp(*values[part].T)))]


def log_prior(
    prior: Prior, order: Sequence[str], expected: float, most: int
) -> Callable[[Names], float]:
    """Return the function from a set to its prior log probability."""
    listed = [*order, UNKNOWN]
    odds = {n: float(np.exp(prior.log_probability[n])) for n in listed}
    # Elementary symmetric polynomials: the sum over sets of so many effects.
    sums = np.zeros(most + 1)
    sums[0] = 1.0
    for n in listed:
        sums[1:] += odds[n] * sums[:-1]
    number = np.array([expected**n / factorial(n) for n in range(most + 1)])
    number /= number.sum()

    def of(names: Names) -> float:
        with np.errstate(divide="ignore"):
            log_odds = sum(float(np.log(odds[n])) for n in names)
            return float(np.log(number[len(names)]) + log_odds - np.log(sums[len(names)]))

    return of
