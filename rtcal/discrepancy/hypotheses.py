"""The hypotheses: every effect with every set of its parameters, and what the model then predicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.air import Air
from rtcal.acoustics.bands import correlation
from rtcal.discrepancy.case import AppliedEffect, Case
from rtcal.discrepancy.coefficients import directions, factors
from rtcal.discrepancy.configuration import Configuration
from rtcal.discrepancy.effects import Effect, Parameters
from rtcal.discrepancy.effects.checks import changed_states, checked_grid
from rtcal.discrepancy.model import FEATURES, Predicted, State, predict, sensitivities
from rtcal.discrepancy.prior import NONE, grid_weights
from rtcal.discrepancy.states import DISTANCE_ERROR, distances, state
from rtcal.errors import DataError
from rtcal.support.types import Array

SHAPE_CHANGE = (("edt", 0.12), ("t30", 0.06))
"""Standard deviation of ln EDT/T20 and ln T30/T20 per unit of change of ln T20. An absorber stands
somewhere, so that the field is less even than its formula assumes. Chosen on development rooms
(docs/discrepancy.md): twice these values lose one of 12 detections, half of them change no count."""
LARGEST_FEATURES = 1000
"""Values that can be compared. Time grows with their cube: 1000 take minutes (benchmarks/growth.py)."""
LARGEST_HYPOTHESES = 50_000
"""Sets of parameters: 12 per material and some 450 more, so that 4000 materials can be stated."""
_SMALL = 64
"""Rows of a covariance that is stored in any case."""
_ELEMENTS = 4_000_000
"""Numbers in an array by hypothesis, configuration, material and band: 32 MB."""


@dataclass(frozen=True, eq=False)
class Hypotheses:
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
    misfits : array (n, n_bands, n_bands)
        Covariance of the relative error of the effect's change, over bands.
    formula_errors : array (n,)
        Standard deviation of the relative error of the change of each feature by itself.
    applied_covariance : array (n_all, n_all)
        Covariance over all features, raveled, from the uncertainty of the effects that the model has
        already, and of distances that are not stated.
    effects : mapping of str to Effect
    """

    names: tuple[str, ...]
    parameters: tuple[Parameters, ...]
    weights: Array
    features: Array
    slopes: Array
    alpha_covariance: AlphaCovariance
    misfits: Array
    formula_errors: Array
    applied_covariance: Array
    effects: Mapping[str, Effect] = field(default_factory=dict)


def predict_hypotheses(
    case: Case, effects: Sequence[Effect], grids: Sequence[Sequence[Parameters]] | None = None
) -> Hypotheses:
    """Predict the case under every effect and set of parameters.

    ``grids`` has the sets of each effect; the effects' own grids if not given.

    Raises
    ------
    DataError
        If an effect breaks a rule, or T, C80 or G of a hypothesis is not finite.
    """
    base = [state(case, c) for c in case.configurations]
    if grids is None:
        grids = [checked_grid(effect, base[0]) for effect in effects]
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
    nothing = np.zeros((1, case.room.n_bands, case.room.n_bands))
    misfits = [
        np.repeat(error_over_bands(effect, frequencies)[None], len(grid), axis=0)
        for effect, grid in zip(effects, grids, strict=True)
    ]
    return Hypotheses(
        names=tuple(NONE if effect is None else effect.name for effect, _ in every),
        parameters=tuple(theta for _, theta in every),
        weights=np.concatenate([np.ones(1), *weights]),
        misfits=np.concatenate([nothing, *misfits]),
        formula_errors=np.array([0.0 if e is None else e.formula_error for e, _ in every]),
        features=features,
        slopes=slopes,
        alpha_covariance=covariance,
        applied_covariance=_applied_covariance(case) + _distance_covariance(case),
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
    part: Sequence[tuple[Effect | None, Parameters]], unchanged: State, configuration: Configuration
) -> list[State]:
    """Return the states of hypotheses in one configuration."""
    states: list[State] = []
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


def _applied_covariance(case: Case) -> Array:
    """Return the covariance over all features, raveled, from the applied effects' sizes and misfit."""
    if not case.applied:
        n = len(case.configurations) * len(FEATURES) * case.room.n_bands
        return np.zeros((n, n))

    def features(applied: Sequence[AppliedEffect]) -> Array:
        changed = replace(case, applied=applied)
        return np.array(
            [
                predict([state(changed, c)], distances(case, c)).features[0]
                for c in case.configurations
            ]
        ).ravel()

    base = features(case.applied)
    out = np.zeros((len(base), len(base)))
    for i, a in enumerate(case.applied):
        if a.size_sigma > 0:
            size = a.effect.size
            larger = {**a.parameters, size: a.parameters[size] + a.size_sigma}
            others = list(case.applied)
            others[i] = replace(a, parameters=larger)
            d = features(others) - base
            out += np.outer(d, d)
        without = features([other for other in case.applied if other is not a])
        d = (base - without).reshape(len(case.configurations), len(FEATURES), -1)
        amount = np.broadcast_to(d[:, :1], d.shape).ravel()
        feature = np.broadcast_to(np.arange(len(FEATURES))[:, None], d.shape).ravel()
        bands = np.broadcast_to(np.arange(d.shape[2]), d.shape).ravel()
        error = error_over_bands(a.effect, case.room.centre_frequencies)
        whole = error[np.ix_(bands, bands)]
        out += misfit(d.ravel(), amount, feature, whole, a.effect.formula_error)
    return out


def _distance_covariance(case: Case) -> Array:
    """Return the covariance over all features, raveled, of distances that are not stated."""
    shift = np.zeros((len(case.configurations), len(FEATURES), case.room.n_bands))
    for i, c in enumerate(case.configurations):
        if c.distances is None:
            at = distances(case, c)
            s = [state(case, c)]
            shift[i] = (
                predict(s, at * np.exp(DISTANCE_ERROR)).features[0] - predict(s, at).features[0]
            )
    flat = shift.ravel()
    return np.outer(flat, flat)


def error_over_bands(effect: Effect, frequencies: Array) -> Array:
    """Return the covariance of the relative error of an effect's change, (n_bands, n_bands)."""
    common, tilt, rough = effect.spectrum_error
    octaves = np.log2(frequencies / 1000)
    lag = np.abs(np.subtract.outer(octaves, octaves))
    return np.asarray(common**2 + tilt**2 * np.outer(octaves, octaves) + rough**2 * 0.5**lag)


def misfit(
    d: Array,
    amount: Array,
    feature: NDArray[np.intp],
    over_bands: Array,
    alone: Array | float,
) -> Array:
    """Return the covariance of the error of an effect's formula, (..., m, m).

    Parameters
    ----------
    d : array (..., m)
        The effect's changes of the features.
    amount : array (..., m)
        Change of ln T20 in the same band and configuration.
    feature : int array (m,)
        Rows of `FEATURES`.
    over_bands : array (..., m, m)
        Covariance of the relative error between the features' bands (`error_over_bands`).
    alone : array (...) or float
        Standard deviation of the relative error that no two features share.
    """
    shape = [share * amount * (feature == FEATURES.index(name)) for name, share in SHAPE_CHANGE]
    parts = np.sqrt(0.5) * np.stack(shape, axis=-2)
    out = d[..., :, None] * d[..., None, :] * over_bands
    out += np.swapaxes(parts, -1, -2) @ parts  # half of a shape's change is common to all bands
    diagonal = np.arange(d.shape[-1])
    out[..., diagonal, diagonal] += (parts**2).sum(-2) + (np.asarray(alone)[..., None] * d) ** 2
    return np.asarray(out)


class AlphaCovariance:
    """The prior's covariance of ln T20 under each hypothesis.

    d ln T20 = -(d k / d alpha) T20 / (6 ln 10) d alpha. A material that a configuration changed is
    independent of its coefficients elsewhere. Of many materials the covariances are stored, of many
    configurations their factors: memory grows with neither squared.
    """

    def __init__(self, case: Case, n: int) -> None:
        room = case.room
        self.count, self.n_bands = len(case.configurations), room.n_bands
        self._rho = correlation(room.centre_frequencies, room.band_correlation)
        self._sigma = np.stack([_sigma(case, c) for c in case.configurations])
        changed = [[m in c.changes for m in room.materials] for c in case.configurations]
        self._changed = np.array(changed)[:, :, None]
        self._directions = directions(case)
        self._climate = _climate(case)
        size = self.count * self.n_bands
        whole = size <= max(room.n_materials, _SMALL)
        self._stored = np.empty(
            (n, size, size) if whole else (n, self.count, room.n_materials, self.n_bands)
        )
        self._air = np.empty((n, size, self._climate.shape[1]))
        self._first = np.empty((2, *self._sigma.shape))
        self._off = np.empty((n, size, min(size, 2 + 2 * room.n_materials))) if whole else None

    def fill(
        self, rows: slice, states: Sequence[Sequence[State]], predicted: Sequence[Predicted]
    ) -> None:
        """Store some hypotheses, from their states and predictions by configuration."""
        slopes = np.empty((len(states[0]), *self._sigma.shape))
        air = np.empty((len(states[0]), *self._climate.shape))
        for c, (column, p) in enumerate(zip(states, predicted, strict=True)):
            time = p.reverberation_time[:, None, :] / (6 * np.log(10))
            slopes[:, c] = sensitivities(column) * time
            air[:, c] = self._climate[c] * time
        n = len(slopes)
        if rows.start == 0:
            self._first[: min(n, 2)] = slopes[:2]
        self._air[rows] = air.swapaxes(2, 3).reshape(n, self._air.shape[1], -1)
        if self._off is None:
            self._stored[rows] = slopes
        else:
            self._stored[rows] = self._covariance(slopes)
            self._off[rows] = factors(self._directions, slopes)

    def of(self, part: slice) -> Array:
        """Return the covariance of some hypotheses over configurations and bands, (n, size, size)."""
        stored, together = self._stored[part], self.off_together(part)
        parts = np.concatenate([self._air[part], together], axis=-1)
        alone = self._covariance(stored) if self._off is None else stored
        return np.asarray(alone + parts @ parts.swapaxes(1, 2))

    def slopes(self, i: int) -> Array:
        """Return -d ln T20 / d alpha of hypothesis 0 or 1, (n_configurations, n_materials, n_bands)."""
        return np.asarray(self._first[i])

    def off_together(self, part: slice) -> Array:
        """Return the usual changes of ln T20 in common, (n, size, n_directions).

        See `rtcal.discrepancy.coefficients.factors`.
        """
        if self._off is None:
            return factors(self._directions, self._stored[part])
        return self._off[part]

    def _covariance(self, slopes: Array) -> Array:
        factor = slopes * self._sigma
        n, count, _, n_bands = factor.shape
        size = count * n_bands
        common = np.where(self._changed, 0.0, factor).swapaxes(2, 3).reshape(n, size, -1)
        full = (common @ common.swapaxes(1, 2)).reshape(n, count, n_bands, count, n_bands)
        own = np.where(self._changed, factor, 0.0)
        for c in np.flatnonzero(self._changed.any((1, 2))):
            full[:, c, :, c] += own[:, c].swapaxes(1, 2) @ own[:, c]
        return np.asarray((full * self._rho[:, None, :]).reshape(n, size, size))


def _sigma(case: Case, configuration: Configuration) -> Array:
    """Return the prior's sigma in one configuration, (n_materials, n_bands)."""
    sigma = np.array(case.room.sigma)
    for material, change in configuration.changes.items():
        sigma[case.room.material_index(material)] = change.sigma
    return sigma


def _climate(case: Case) -> Array:
    """Return the change of k in 1/s by one standard deviation of temperature and of humidity.

    (n_configurations, n_columns, n_bands). Configurations without a climate of their own share the
    columns of the room's; without any climate they are 0.
    """
    room = case.room
    climates = [c.air or room.air for c in case.configurations]
    owners = [0 if c.air is None else i + 1 for i, c in enumerate(case.configurations)]
    place = {owner: i for i, owner in enumerate(dict.fromkeys(owners))}
    out = np.zeros((len(climates), 2 * len(place), room.n_bands))
    for c, (air, owner) in enumerate(zip(climates, owners, strict=True)):
        if air is not None:
            first = 2 * place[owner]
            out[c, first : first + 2] = room.speed_of_sound * _attenuation_changes(
                air, case.climate_uncertainty, room.centre_frequencies
            )
    return out


def _attenuation_changes(air: Air, by: tuple[float, float], frequencies: Array) -> Array:
    """Return the change of m in 1/m by so many K and by so many % of humidity, (2, n_bands)."""
    warm = min(air.temperature, 50 - by[0])
    damp = min(air.humidity, 100 - by[1])
    pairs = [
        (replace(air, temperature=warm), replace(air, temperature=warm + by[0])),
        (replace(air, humidity=damp), replace(air, humidity=damp + by[1])),
    ]
    return np.array([b.attenuation(frequencies) - a.attenuation(frequencies) for a, b in pairs])
