"""The hypotheses: every effect with every set of its parameters, and what the model then predicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from rtcal.finder.case import Case, Configuration
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.effects.checks import AppliedEffect, changed_states, checked_grid
from rtcal.finder.means.features import DISTANCE_ERROR, AlphaCovariance, distances, state
from rtcal.finder.model import FEATURES, RoomState, predict
from rtcal.finder.prior import NONE, grid_weights
from rtcal.support.errors import DataError
from rtcal.support.types import Array

SHAPE_CHANGE = (("edt", 0.12), ("t30", 0.06))
"""Standard deviation of ln EDT/T20 and ln T30/T20 per unit of change of ln T20. An absorber stands
somewhere, so that the field is less even than its formula assumes. Chosen on development rooms
(docs/discrepancy.md): twice these values lose one of 12 detections, half of them change no count."""
LARGEST_FEATURES = 1000
"""Values that can be compared. Time grows with their cube: 1000 take minutes (benchmarks/growth.py)."""
LARGEST_HYPOTHESES = 50_000
"""Sets of parameters: 12 per material and some 450 more, so that 4000 materials can be stated."""
_ELEMENTS = 4_000_000
"""Numbers in an array by hypothesis, configuration, material and band: 32 MB."""


@dataclass(frozen=True, eq=False)
class LowRank:
    """A covariance F F' + diag(v): ``factor`` F (..., m, r), ``diagonal`` v (..., m)."""

    factor: Array
    diagonal: Array

    @property
    def covariance(self) -> Array:
        """The whole matrix, (..., m, m)."""
        out = self.factor @ np.swapaxes(self.factor, -1, -2)
        rows = np.arange(out.shape[-1])
        out[..., rows, rows] += self.diagonal
        return np.asarray(out)


@dataclass(frozen=True, eq=False)
class MeansHypotheses:
    """Every effect with every set of its parameters, and the predictions of the case's model.

    Attributes
    ----------
    names : tuple of str (n,)
        The effects; the first hypothesis is "none".
    parameters : tuple of mappings (n,)
    weights : array (n,)
        Prior probability of the parameters, given the effect.
    features : array (n, n_configurations, n_features, n_bands)
    slopes : array, same shape
        d features / d ln T20.
    alpha_covariance : AlphaCovariance
        The prior's covariance of ln T20.
    spectrum_errors : array (n, n_bands, n_errors)
        Relative errors of the effect's change over bands, one standard deviation each.
    formula_errors : array (n,)
        Standard deviation of the relative error of the change of each feature by itself.
    applied : LowRank
        Covariance over all features, raveled, from the uncertainty of the effects that the model has
        already, of stated changes of materials, and of distances that are not stated.
    effects : mapping of str to Effect
    """

    names: tuple[str, ...]
    parameters: tuple[Parameters, ...]
    weights: Array
    features: Array
    slopes: Array
    alpha_covariance: AlphaCovariance
    spectrum_errors: Array
    formula_errors: Array
    applied: LowRank
    effects: Mapping[str, Effect] = field(default_factory=dict)


def predict_hypotheses(
    case: Case, effects: Sequence[Effect], grids: Sequence[Sequence[Parameters]] | None = None
) -> MeansHypotheses:
    """Predict the case under every effect and set of parameters.

    ``grids`` has the sets of each effect; the effects' own grids if not given.

    Raises
    ------
    DataError
        If an effect breaks a rule, or T, C80 or G of a hypothesis is not finite.
    """
    base = [state(case, c) for c in case.configurations]
    if grids is None:
        grids = [checked_grid(effect, base[0], case.room) for effect in effects]
        weights = [grid_weights(e, grid, base[0]) for e, grid in zip(effects, grids, strict=True)]
    else:
        weights = [np.full(len(grid), 1 / len(grid)) for grid in grids]
    n = 1 + sum(map(len, grids))
    check_size(case, n)
    every: list[tuple[Effect | None, Parameters]] = [(None, {})]
    for effect, grid in zip(effects, grids, strict=True):
        every += [(effect, theta) for theta in grid]
    shape = (n, len(base), len(FEATURES), case.room.n_bands)
    features, slopes = np.empty(shape), np.empty(shape)
    covariance = AlphaCovariance(case, n)
    # So many hypotheses at once that the arrays by material stay small.
    step = max(1, _ELEMENTS // (len(base) * case.room.alpha.size))
    for begin in range(0, n, step):
        part = every[begin : begin + step]
        rows = slice(begin, begin + len(part))
        states = [
            _states(part, unchanged, c)
            for c, unchanged in zip(case.configurations, base, strict=True)
        ]
        with np.errstate(all="ignore"):  # values that are not finite get an error by name
            predicted = [
                predict(column, distances(case, c))
                for c, column in zip(case.configurations, states, strict=True)
            ]
        features[rows] = np.stack([p.features for p in predicted], axis=1)
        slopes[rows] = np.stack([p.slopes for p in predicted], axis=1)
        _check_finite(case, part, features[rows], slopes[rows])
        covariance.fill(rows, states, predicted)
    frequencies = case.room.centre_frequencies
    nothing = np.zeros((1, case.room.n_bands, case.room.n_bands + 2))
    errors = [
        np.repeat(effect.errors_over_bands(frequencies)[None], len(grid), axis=0)
        for effect, grid in zip(effects, grids, strict=True)
    ]
    return MeansHypotheses(
        names=tuple(NONE if effect is None else effect.name for effect, _ in every),
        parameters=tuple(theta for _, theta in every),
        weights=np.concatenate([np.ones(1), *weights]),
        spectrum_errors=np.concatenate([nothing, *errors]),
        formula_errors=np.array([0.0 if e is None else e.formula_error for e, _ in every]),
        features=features,
        slopes=slopes,
        alpha_covariance=covariance,
        applied=_applied(case),
        effects={e.name: e for e in effects},
    )


def check_size(case: Case, n_hypotheses: int) -> None:
    """Raise DataError for a case larger than `LARGEST_FEATURES` or `LARGEST_HYPOTHESES`."""
    room, n = case.room, len(case.configurations)
    measured = sum(len(set(c.measured.values) & set(FEATURES)) for c in case.configurations)
    if (size := measured * room.n_bands) > LARGEST_FEATURES:
        raise DataError(
            f"{n} configurations have {size} values (parameters and bands); at most "
            f"{LARGEST_FEATURES} can be compared: leave some out with Case.only"
        )
    if n_hypotheses > LARGEST_HYPOTHESES:
        raise DataError(
            f"{n_hypotheses} sets of parameters are to be tried in a room of {room.n_materials} "
            f"materials; at most {LARGEST_HYPOTHESES} can be: state fewer effects or materials"
        )


def _states(
    part: Sequence[tuple[Effect | None, Parameters]],
    unchanged: RoomState,
    configuration: Configuration,
) -> list[RoomState]:
    """Return the states of hypotheses in one configuration."""
    states: list[RoomState] = []
    for effect, members in groupby(part, key=lambda member: member[0]):
        grid = [theta for _, theta in members]
        absent = effect is None or (configuration.suspect_removed and effect.removable)
        if effect is None or absent:
            states += [unchanged] * len(grid)
        else:
            states += changed_states(effect, unchanged, grid)
    return states


def _check_finite(
    case: Case,
    part: Sequence[tuple[Effect | None, Parameters]],
    features: Array,
    slopes: Array,
) -> None:
    finite = np.isfinite(features).all((1, 2, 3)) & np.isfinite(slopes).all((1, 2, 3))
    if finite.all():
        return
    effect, parameters = part[int(np.argmin(finite))]
    culprit = "the case's model" if effect is None else f'effect "{effect.name}" with {parameters}'
    raise DataError(
        f"{culprit} has no finite T, C80 and G in a room of {case.room.volume:g} m³ with "
        f"{case.room.total_area:g} m² of walls"
    )


def _applied(case: Case) -> LowRank:
    """Return the covariance over all features, raveled.

    Of distances, of stated changes, and of applied sizes and misfits.
    """

    def features(applied: Sequence[AppliedEffect]) -> Array:
        changed = replace(case, applied=applied)
        return np.array(
            [
                predict([state(changed, c)], distances(case, c)).features[0]
                for c in case.configurations
            ]
        ).ravel()

    changed = _change_errors(case)
    columns, diagonal = [_distance_errors(case), changed.factor], changed.diagonal
    base = features(case.applied) if case.applied else np.zeros_like(diagonal)
    for i, a in enumerate(case.applied):
        if a.size_sigma > 0:
            most, larger = a.effect.size_limits(case.room)[1], a.size + a.size_sigma
            # Near the end of what is possible, the size by as much smaller: only the square counts.
            others = list(case.applied)
            others[i] = a.resized(larger if larger <= most else a.size - a.size_sigma)
            columns.append((features(others) - base)[:, None])
        without = features([other for other in case.applied if other is not a])
        d = (base - without).reshape(len(case.configurations), len(FEATURES), -1)
        amount = np.broadcast_to(d[:, :1], d.shape).ravel()
        feature = np.broadcast_to(np.arange(len(FEATURES))[:, None], d.shape).ravel()
        bands = np.broadcast_to(np.arange(d.shape[2]), d.shape).ravel()
        errors = a.effect.errors_over_bands(case.room.centre_frequencies)[bands]
        error = misfit(d.ravel(), amount, feature, errors, a.effect.formula_error)
        columns.append(error.factor)
        diagonal = diagonal + error.diagonal
    return LowRank(np.concatenate(columns, axis=1), diagonal)


def _distance_errors(case: Case) -> Array:
    """Return the changes of all features, raveled, by the errors of distances that are not stated.

    (n_features, n_configurations): positions may differ between configurations, so each has its own.
    """
    count = len(case.configurations)
    shift = np.zeros((count, len(FEATURES), case.room.n_bands, count))
    for i, c in enumerate(case.configurations):
        if c.distances is None:
            at = distances(case, c)
            s = [state(case, c)]
            far = predict(s, at * np.exp(DISTANCE_ERROR)).features[0]
            shift[i, ..., i] = far - predict(s, at).features[0]
    return shift.reshape(-1, count)


def _change_errors(case: Case) -> LowRank:
    """Return the covariance over all features, raveled, of what stated changes of materials cause.

    A changed material stands somewhere, as an effect does, and the formula errs in proportion to what
    it changes, as for any effect. Configurations with the same changes share the common part.
    """
    made: dict[tuple[tuple[str, bytes], ...], Array] = {}
    shape = (len(case.configurations), len(FEATURES), case.room.n_bands)
    diagonal = np.zeros(shape)
    feature = np.repeat(np.arange(len(FEATURES)), case.room.n_bands)
    common, _, _ = Effect.spectrum_error
    errors = np.full((feature.size, 1), common)
    for i, c in enumerate(case.configurations):
        if not c.changes:
            continue
        both = [state(case, replace(c, changes=changes)) for changes in ({}, c.changes)]
        before, after = predict(both, distances(case, c)).features
        d = after - before
        amount = np.broadcast_to(d[:1], d.shape).ravel()
        error = misfit(d.ravel(), amount, feature, errors, Effect.formula_error)
        diagonal[i] = error.diagonal.reshape(d.shape)
        key = tuple(sorted((m, change.alpha.tobytes()) for m, change in c.changes.items()))
        columns = made.setdefault(key, np.zeros((*shape, error.factor.shape[1])))
        columns[i] = error.factor.reshape(*d.shape, -1)
    factor = [columns.reshape(diagonal.size, -1) for columns in made.values()]
    return LowRank(
        np.concatenate([np.zeros((diagonal.size, 0)), *factor], axis=1), diagonal.ravel()
    )


def misfit(
    d: Array,
    amount: Array,
    feature: NDArray[np.intp],
    errors: Array,
    alone: Array | float,
) -> LowRank:
    """Return the covariance of the error of an effect's formula.

    Parameters
    ----------
    d : array (..., m)
        The effect's changes of the features.
    amount : array (..., m)
        Change of ln T20 in the same band and configuration.
    feature : int array (m,)
        Rows of `FEATURES`.
    errors : array (..., m, n_errors)
        Relative errors in the features' bands (`Effect.errors_over_bands`).
    alone : array (...) or float
        Standard deviation of the relative error that no two features share.
    """
    shape = [share * amount * (feature == FEATURES.index(name)) for name, share in SHAPE_CHANGE]
    parts = np.sqrt(0.5) * np.stack(shape, axis=-1)  # half of it is common to all bands
    factor = np.concatenate([d[..., None] * errors, parts], axis=-1)
    diagonal = (parts**2).sum(-1) + (np.asarray(alone)[..., None] * d) ** 2
    return LowRank(factor, diagonal)
