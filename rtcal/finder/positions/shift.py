"""A hypothesis: how it shifts what the positions hear, or which errors it widens.

One of the room shifts the parameters at every pair: `ShiftHypothesis`. One of the measurement widens
the errors of some pairs: `SpreadHypothesis`.

A hypothesis spreads an absorber over its surface. In truth it hangs somewhere: receivers near it lose
more than others, and T changes by more or less. Neither is known before the place is, so it is an error
of the hypothesis, in proportion to its change of the absorption. The shares come from patches on walls
of development boxes, which are weighed on the same paths (`python -m benchmarks.where_patches`). They
are over sqrt(1 / s - 1), s being the part of the surface that is covered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.observables import observable
from rtcal.finder.effects.base import Effect, Parameters
from rtcal.finder.effects.stated import HARD
from rtcal.finder.means.hypotheses import spectrum_errors
from rtcal.finder.prior import COEFFICIENTS
from rtcal.support.types import Array

POSITION, NOISE, UNKNOWN = "position", "noise", "unknown"
MEASUREMENT = "measurement"
ODDS = {
    POSITION: 0.5,
    NOISE: 0.5,
    UNKNOWN: 0.5,
    "air": 1.0,
    "volume": 1.0,
    COEFFICIENTS: 1.0,
}
"""Prior odds against an effect of odds 1; those of the absorbers are their classes'."""


@dataclass(frozen=True, eq=False)
class ShiftHypothesis:
    """Hypotheses of one effect in one place, with their sizes.

    Attributes
    ----------
    effect, family : str
    surface : int or None
        Number of the surface; None for the whole room.
    response : str
        Which of the responses is interpolated.
    weights : array (n_hypotheses, n_bands, n_nodes)
        Shift of band k is weights[:, k] @ the response's nodes of band k.
    odds : array (n_hypotheses,)
        Prior odds of each within its effect; over all surfaces they are normalised to 1.
    sizes : array (n_hypotheses,)
    unit : str
    parameters : sequence of mapping
    spectra : array (n_hypotheses, n_bands)
        Alpha of what stands on the surface; empty for the whole room.
    error : array (n_bands, n_bands)
        Covariance of the relative error of the change, band by band.
    uneven : array (n_hypotheses,)
        How far pairs may hear more or less of it; see `rtcal.finder.positions.shift.factor`.
    size_error : float
        Standard deviation of ln size that the effect's description leaves open.
    place : str
        The material whose coefficients are off.
    part : int or None
        Number of the part of the surface; None for all of it.
    divisible : bool
        Whether it may stand on a part of its surface alone.
    """

    effect: str
    family: str
    surface: int | None
    response: str
    weights: Array
    odds: Array
    sizes: Array
    unit: str
    parameters: Sequence[Parameters]
    spectra: Array
    error: Array
    uneven: Array
    size_error: float = 0.0
    place: str = ""
    part: int | None = None
    divisible: bool = False

    def some(self, which: slice) -> ShiftHypothesis:
        """Return some of the hypotheses."""
        return replace(
            self,
            weights=self.weights[which],
            odds=self.odds[which],
            sizes=self.sizes[which],
            parameters=self.parameters[which],
            spectra=self.spectra[which],
            uneven=self.uneven[which],
        )


@dataclass(frozen=True, eq=False)
class SpreadHypothesis:
    """A hypothesis that some values err by more: their covariance grows by ``covariance``.

    ``rows`` are the values' numbers in the order (band, parameter, pair). ``place`` names the
    source, receiver or pair.
    """

    effect: str
    place: str
    size: float
    unit: str
    rows: NDArray[np.int64]
    covariance: Array
    odds: float


def interpolation(nodes: Sequence[float], at: Array) -> Array:
    """Return the nodes' weights (..., n_nodes) in a linear interpolation that is 0 at 0.

    Beyond the nodes the value at the last one is taken.
    """
    every = np.array(sorted([*nodes, 0.0]))
    position = np.clip(at, every[0], every[-1])
    right = np.clip(np.searchsorted(every, position), 1, len(every) - 1)
    share = (position - every[right - 1]) / (every[right] - every[right - 1])
    out = np.zeros((*np.shape(at), len(every)))
    np.put_along_axis(out, right[..., np.newaxis], share[..., np.newaxis], -1)
    np.put_along_axis(out, right[..., np.newaxis] - 1, (1 - share)[..., np.newaxis], -1)
    kept = [int(np.flatnonzero(every == node)[0]) for node in nodes]
    return np.asarray(out[..., kept])


def error_over_bands(effect: Effect, frequencies: Array) -> Array:
    """Return the covariance of the relative error of an effect's change, (n_bands, n_bands)."""
    factor = spectrum_errors(effect, frequencies)
    return np.asarray(factor @ factor.T)


def towards(moved: Array, stated: Array) -> Array:
    """Return changes of alpha as shares of the way to 1, or (below 0) to a hard wall; see `SHARES`."""
    up = moved / np.maximum(1 - stated, 1e-6)
    down = moved / np.maximum(stated - HARD, 1e-6)
    return np.asarray(np.where(moved >= 0, up, np.maximum(down, -1.0)))


LEAST_COVERED = 1 / 9
"""Least part of a surface for which the shares were found; smaller ones have its error."""
COMMON_UNEVENNESS = {"late": 0.05, "early": 0.06, "level": 0.14}
"""Relative deviation that all pairs share, by `Observable.part`. That of T and of the early parameters
is the same one."""
OWN_UNEVENNESS = {"late": 0.06, "early": 0.06, "level": 0.24}
"""Relative deviation of each pair: one for T, one for all early parameters, one for the level."""


def sign(parameter: str) -> float:
    """Return whether a parameter's linear scale rises or falls with the absorption."""
    return 1.0 if observable(parameter).rises else -1.0


def unevenness(covered: Array) -> Array:
    """Return the size of the deviation where these parts of a surface are covered."""
    return np.asarray(np.sqrt(1 / np.clip(covered, LEAST_COVERED, 1.0) - 1))


def uneven_amount(parameters: Sequence[str], n_pairs: int) -> Array:
    """Return the weights of a mean change of the absorption, (n_parameters n_pairs,)."""
    signs = np.array([sign(name) for name in parameters])
    return np.repeat(signs, n_pairs) / (len(parameters) * n_pairs)


def uneven_columns(parameters: Sequence[str], n_pairs: int) -> Array:
    """Return the deviations at a change of 1, (n_parameters n_pairs, n_columns)."""
    signs = np.array([sign(name) for name in parameters])
    groups = [observable(name).part for name in parameters]
    out = []
    for shared in (("late", "early"), ("level",)):
        row = [COMMON_UNEVENNESS[g] if g in shared else 0.0 for g in groups]
        out.append(np.repeat(signs * row, n_pairs))
    for group in OWN_UNEVENNESS:
        own = np.array([OWN_UNEVENNESS[g] if g == group else 0.0 for g in groups])
        for pair in np.eye(n_pairs):
            out.append(np.outer(signs * own, pair).ravel())
    every = np.array(out).T
    return np.asarray(every[:, np.abs(every).max(axis=0) > 0])
