"""The hypotheses: every effect with every set of its parameters, and what the model then predicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.bands import correlation
from rtcal.discrepancy.case import AppliedEffect, Case
from rtcal.discrepancy.configuration import Configuration
from rtcal.discrepancy.effects import Effect, Parameters
from rtcal.discrepancy.effects.checks import changed_states, checked_grid
from rtcal.discrepancy.model import FEATURES, Predicted, State, predict, sensitivities
from rtcal.discrepancy.states import distances, state
from rtcal.errors import DataError
from rtcal.support.types import Array

KAPPA = 0.15
"""Standard deviation of an effect's change, relative to the change that its formula gives."""
SHAPE_CHANGE = (("edt", 0.12), ("t30", 0.06))
"""Standard deviation of ln EDT/T20 and ln T30/T20 per unit of change of ln T20. An absorber stands
somewhere, so that the field is less even than its formula assumes."""
NONE = "none"


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Every effect with every set of its parameters, and the predictions of the case's model.

    Attributes
    ----------
    names : tuple of str (n,)
        The effects; the first hypothesis is "none".
    parameters : tuple of mappings (n,)
    features : array (n, n_configurations, n_features, n_bands)
    slopes : array, same shape
        d features / d ln T20.
    alpha_variance : array (n, n_configurations, n_bands, n_configurations, n_bands)
        The prior's covariance of ln T20.
    applied_covariance : array (n_all, n_all)
        Covariance over all features, raveled, from the uncertainty of the effects that the model has
        already.
    effects : mapping of str to Effect
    """

    names: tuple[str, ...]
    parameters: tuple[Parameters, ...]
    features: Array
    slopes: Array
    alpha_variance: Array
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
    names: list[str] = [NONE]
    parameters: list[Parameters] = [{}]
    states: list[list[State]] = [[unchanged] for unchanged in base]  # by configuration
    for effect, grid in zip(effects, grids, strict=True):
        names += [effect.name] * len(grid)
        parameters += grid
        for c, unchanged, column in zip(case.configurations, base, states, strict=True):
            absent = c.suspect_removed and effect.removable
            column += [unchanged] * len(grid) if absent else changed_states(effect, unchanged, grid)
    with np.errstate(all="ignore"):  # what is not finite is refused by name
        predicted = [
            predict(column, distances(case, c))
            for c, column in zip(case.configurations, states, strict=True)
        ]
    for p in predicted:
        if not (
            finite := np.isfinite(p.features).all((1, 2)) & np.isfinite(p.slopes).all((1, 2))
        ).all():
            i = int(np.argmin(finite))
            culprit = "the case's model" if i == 0 else f'effect "{names[i]}" with {parameters[i]}'
            raise DataError(
                f"{culprit} has no finite T, C80 and G in a room of {case.room.volume:g} m³ with "
                f"{case.room.total_area:g} m² of walls"
            )
    return Hypotheses(
        names=tuple(names),
        parameters=tuple(parameters),
        features=np.stack([p.features for p in predicted], axis=1),
        slopes=np.stack([p.slopes for p in predicted], axis=1),
        alpha_variance=alpha_variance(case, states, predicted),
        applied_covariance=_applied_covariance(case),
        effects={e.name: e for e in effects},
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
        out += misfit(d.ravel(), amount, feature, KAPPA)
    return out


def misfit(d: Array, amount: Array, feature: NDArray[np.intp], kappa: float) -> Array:
    """Return the covariance of the error of an effect's formula, (..., m, m).

    Parameters
    ----------
    d : array (..., m)
        The effect's changes of the features.
    amount : array (..., m)
        Change of ln T20 in the same band and configuration.
    feature : int array (m,)
        Rows of `FEATURES`.
    kappa : float
        As `KAPPA`.
    """
    parts = [kappa * d]
    parts += [share * amount * (feature == FEATURES.index(name)) for name, share in SHAPE_CHANGE]
    return _half_common(np.stack(parts, axis=-2))


def _half_common(parts: Array) -> Array:
    """Return the sum over parts e (..., n, m) of ½ e e' + ½ diag e²: half of each error is common."""
    parts = np.sqrt(0.5) * parts
    out = np.swapaxes(parts, -1, -2) @ parts
    diagonal = np.arange(parts.shape[-1])
    out[..., diagonal, diagonal] += (parts**2).sum(-2)
    return np.asarray(out)


def alpha_variance(
    case: Case, states: Sequence[Sequence[State]], predicted: Sequence[Predicted]
) -> Array:
    """Return the prior's covariance of ln T20, (n, n_configurations, n_bands, same, same).

    d ln T20 = -(d k / d alpha) T20 / (6 ln 10) d alpha. A material that a configuration changed is
    independent of its coefficients elsewhere. ``states`` and ``predicted`` are by configuration.
    """
    room = case.room
    rho = correlation(room.centre_frequencies, room.band_correlation)
    slope = np.stack(
        [
            sensitivities(column) * p.reverberation_time[:, None, :] / (6 * np.log(10))
            for column, p in zip(states, predicted, strict=True)
        ],
        axis=1,
    )  # (n, configurations, materials, bands)
    n, count, _, n_bands = slope.shape
    out = np.zeros((n, count, n_bands, count, n_bands))
    sigma = np.stack([_sigma(case, c) for c in case.configurations])
    scaled = slope * sigma
    for a in range(count):
        for b in range(count):
            first, second = case.configurations[a].changes, case.configurations[b].changes
            shared = np.array(
                [a == b or (m not in first and m not in second) for m in room.materials],
                dtype=float,
            )
            product = np.swapaxes(scaled[:, a] * shared[:, None], 1, 2) @ scaled[:, b]
            out[:, a, :, b, :] = product * rho
    return out


def _sigma(case: Case, configuration: Configuration) -> Array:
    """Return the prior's sigma in one configuration, (n_materials, n_bands)."""
    sigma = np.array(case.room.sigma)
    for material, change in configuration.changes.items():
        sigma[case.room.material_index(material)] = change.sigma
    return sigma
