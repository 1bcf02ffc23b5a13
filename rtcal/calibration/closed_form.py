"""The paper's closed forms: least squares, maximum likelihood and scaling. No bounds, no solver.

They are the QP's reference in the tests, and share no code with it. Each answer satisfies S'alpha = b
exactly and may lie outside [0, 1].

Shapes: one band ``(n_materials,)`` with a scalar target, or ``(n_materials, n_bands)`` with
``(n_bands,)``.
"""

from __future__ import annotations

import numpy as np

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["least_squares", "maximum_likelihood", "multiplier", "scaling"]
__dir__ = __all__.copy


def least_squares(mu: Array, areas: Array, target: Array | float) -> Array:
    """Return the coefficients nearest to ``mu`` with S'alpha = b (Bellows & Katz 2025, Eqs. 9, 10).

    alpha = mu - C S,  C = (S'mu - b) / S'S.

    Examples
    --------
    >>> print(least_squares([0.4, 0.6], [20, 74], 33.6).round(2))
    [0.34 0.36]
    """
    return maximum_likelihood(mu, np.ones_like(_finite("mu", mu)), areas, target)


def maximum_likelihood(mu: Array, sigma: Array, areas: Array, target: Array | float) -> Array:
    """Return the likeliest coefficients with S'alpha = b (Bellows & Katz 2025, Eqs. 22 to 25).

    alpha = mu - D S sigma²,  D = (S'mu - b) / sum S² sigma².

    Parameters
    ----------
    mu, sigma : array (n_materials,) or (n_materials, n_bands)
        Prior means and standard deviations; a coefficient with sigma = 0 does not change.
    areas : array (n_materials,)
        m².
    target : float or array (n_bands,)
        b in m².

    Raises
    ------
    DataError
        If shapes do not fit, a value is not finite, or all sigma of a band are 0.

    Examples
    --------
    >>> print(maximum_likelihood([0.6, 0.5], [0.05, 0.1], [47, 47], 37.6).round(2))
    [0.54 0.26]
    """
    mu, areas, target = _checked(mu, areas, target)
    sigma = _finite("sigma", sigma)
    if sigma.shape != mu.shape:
        raise DataError(f"sigma has shape {sigma.shape}; mu has {mu.shape}")
    if (sigma < 0).any():
        raise DataError(f"sigma has {sigma.min():g}, which is not 0 or more")
    weight = _along(areas, mu) * sigma**2
    room_to_move = areas @ weight
    if np.any(room_to_move == 0):
        raise DataError("all sigma of a band are 0; no coefficient there can move")
    return np.asarray(mu - multiplier(mu, sigma, areas, target) * weight)


def multiplier(mu: Array, sigma: Array, areas: Array, target: Array | float) -> Array:
    """Return D = (S'mu - b) / sum S² sigma² in 1/m², a scalar or (n_bands,) (Eqs. 23 to 25)."""
    mu, areas, target = _checked(mu, areas, target)
    sigma = _finite("sigma", sigma)
    if sigma.shape != mu.shape or (sigma < 0).any():
        raise DataError(f"sigma has not the shape {mu.shape} of mu, or a value below 0")
    spread = areas**2 @ sigma**2
    if np.any(spread == 0):
        raise DataError("all sigma of a band are 0; no coefficient there can move")
    return np.asarray((areas @ mu - target) / spread)


def scaling(mu: Array, areas: Array, target: Array | float) -> Array:
    """Return all coefficients scaled alike, alpha = mu b / S'mu (Bellows & Katz 2025, Eqs. 36, 37).

    Raises
    ------
    DataError
        If shapes do not fit, or S'mu = 0: no factor then gives b.

    Examples
    --------
    >>> print(scaling([0.2, 0.4], [20, 20], 6.0).round(2))
    [0.1 0.2]
    """
    mu, areas, target = _checked(mu, areas, target)
    absorption_area = areas @ mu
    if np.any(absorption_area == 0):
        raise DataError("S'mu = 0: scaling cannot reach any target from there")
    return np.asarray(mu * (target / absorption_area))


def _checked(mu: Array, areas: Array, target: Array | float) -> tuple[Array, Array, Array]:
    mu, areas = _finite("mu", mu), _finite("areas", areas)
    target = _finite("target", target)
    if mu.ndim not in (1, 2) or areas.shape != mu.shape[:1] or target.shape != mu.shape[1:]:
        raise DataError(
            f"mu {mu.shape}, areas {areas.shape} and target {target.shape} do not fit: "
            "(n_materials,) and a scalar target, or (n_materials, n_bands) and (n_bands,)"
        )
    if (areas <= 0).any():
        raise DataError(f"areas has {areas.min():g} m², which is not above 0")
    return mu, areas, target


def _finite(name: str, values: object) -> Array:
    array = checks.array(name, values)
    if not np.isfinite(array).all():
        raise DataError(f"{name} has a value that is not finite")
    return array


def _along(areas: Array, mu: Array) -> Array:
    return areas if mu.ndim == 1 else areas[:, np.newaxis]
