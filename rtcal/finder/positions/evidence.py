"""The evidence of every hypothesis, linear in the shifts and Gaussian in the errors.

    y - f(mu) = d_h + J (alpha - mu) + e,   e of covariance R + D,

y is what was measured and f(mu) what the simulator hears as stated, d_h the shift of hypothesis h. The
prior of alpha and the error of d_h are integrated. All values are ordered (band, parameter, pair).

A shift of band k is a mixture of the shifts at the nodes of one response, and no parameter of a band
depends on another band. So each hypothesis needs products of nodes alone: N' K⁻¹ N and N' K⁻¹ r.

How much the room scatters is integrated, too: what it changes is no straight line, so it is heard at
several levels, and every density is their mean (`ScatteringLevels`).

The error of d_h has two parts. Each band's shift is larger or smaller by a factor
(`ShiftHypothesis.error`), and pairs hear more or less of it than if it were spread evenly
(`rtcal.finder.positions.hypotheses`).

All hypotheses share one covariance and differ in a product. Those on means
(`rtcal.finder.means.likelihood`) have a covariance each, since a closed form gives the derivatives by
alpha of every one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.finder.effects.base import Parameters
from rtcal.finder.prior import COEFFICIENTS, UNKNOWN
from rtcal.support.types import Array

POSITION, NOISE, MEASUREMENT = "position", "noise", "measurement"
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
        How far pairs may hear more or less of it; see `rtcal.finder.positions.hypotheses`.
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


_AT_ONCE = 256
"""Hypotheses in one product: their matrices fill some 10 MB."""


@dataclass(frozen=True, eq=False)
class ScatteringLevels:
    """Shifts of the whole room if it scatters more or less than is assumed.

    Attributes
    ----------
    shifts : array (n, n_levels)
        In the order (band, parameter, pair).
    log_weights : array (n_levels,)
        Log prior probabilities of the levels.
    """

    shifts: Array
    log_weights: Array

    @classmethod
    def assumed(cls, n: int) -> ScatteringLevels:
        """Return the assumed level alone, for ``n`` values."""
        return cls(np.zeros((n, 1)), np.zeros(1))

    @property
    def covariance(self) -> Array:
        """Covariance of the shifts over the levels, (n, n)."""
        weights = np.exp(self.log_weights)
        off = self.shifts - (self.shifts @ weights)[:, np.newaxis]
        return np.asarray((off * weights) @ off.T)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Sets of residuals as one likelihood takes them, at each level one after the other.

    Attributes
    ----------
    pull : array (n, n_levels n_draws)
        K⁻¹ r, K the covariance.
    square : array (n_levels n_draws,)
        r' K⁻¹ r.
    """

    pull: Array
    square: Array


@dataclass(eq=False)
class Likelihood:
    """The density of residuals (n,) under one covariance of everything but the hypothesis.

    Parameters
    ----------
    covariance : array (n, n)
        In the order (band, parameter, pair).
    used : bool array (n,)
        Which values were measured; the others say nothing.
    nodes : mapping of str to array (n_bands, n_values, n_nodes)
        Shifts at the nodes of each response, by band.
    uneven : array (n_values, n_columns)
        Deviations by pair at a change of 1 of the absorption; see `rtcal.finder.positions.hypotheses`.
    amount : array (n_values,)
        Weights of a band's shift in that change.
    levels : ScatteringLevels
    """

    covariance: Array
    used: NDArray[np.bool_]
    nodes: Mapping[str, Array]
    uneven: Array
    amount: Array
    levels: ScatteringLevels
    inverse: Array = field(init=False)
    log_determinant: float = field(init=False)
    _products: dict[str, Array] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        both = np.outer(self.used, self.used)
        kept = np.where(both, self.covariance, 0.0) + np.diag(np.where(self.used, 0.0, 1.0))
        factor = np.linalg.cholesky(kept)
        self.log_determinant = 2 * float(np.log(np.diag(factor)).sum())
        # A value that was not measured has a residual of any size: its row is 0.
        self.inverse = np.where(both, np.linalg.inv(kept), 0.0)

    @property
    def number(self) -> int:
        """Number of values that were measured."""
        return int(self.used.sum())

    def of(self, residuals: Array) -> Residuals:
        """Return residuals (n, n_draws) as the other methods take them."""
        by_level = residuals[:, np.newaxis] - self.levels.shifts[..., np.newaxis]
        measured = np.where(self.used[:, np.newaxis], by_level.reshape(len(residuals), -1), 0.0)
        pull = np.asarray(self.inverse @ measured)
        return Residuals(pull, np.asarray(np.einsum("nm,nm->m", measured, pull)))

    def with_one_level(self) -> Likelihood:
        """Return the normal likelihood whose covariance has that of the levels."""
        covariance = self.covariance + self.levels.covariance
        levels = ScatteringLevels.assumed(len(covariance))
        return Likelihood(
            covariance, self.used, self.nodes, uneven=self.uneven, amount=self.amount, levels=levels
        )

    def stated(self, residuals: Residuals) -> Array:
        """Return the log density if nothing is other than stated, (n_draws,)."""
        return self._log(residuals.square, 0.0)

    def shifted(self, shift: ShiftHypothesis, residuals: Residuals) -> Array:
        """Return the log density by hypothesis, (n_hypotheses, n_draws)."""
        if len(shift.weights) <= _AT_ONCE:
            return self._shifted(shift, residuals)
        parts = range(0, len(shift.weights), _AT_ONCE)
        return np.concatenate(
            [self._shifted(shift.some(slice(p, p + _AT_ONCE)), residuals) for p in parts]
        )

    def each_shifted(self, shifts: Sequence[ShiftHypothesis], residuals: Residuals) -> list[Array]:
        """Return `shifted` of each."""
        return [self.shifted(shift, residuals) for shift in shifts]

    def _shifted(self, shift: ShiftHypothesis, residuals: Residuals) -> Array:
        projected, forms = self._forms(shift, residuals)
        error = np.asarray(np.linalg.cholesky(shift.error + 1e-9 * np.eye(len(shift.error))))
        whole = residuals.square - 2 * projected.sum(1)
        whole = whole + forms.sum((1, 2))[:, np.newaxis]
        left = projected - forms.sum(2)[:, :, np.newaxis]
        inner = error.T @ forms @ error
        turned = error.T @ left
        if shift.uneven.any():
            inner, turned = self._with_uneven(shift, residuals, error, inner, turned)
        inner = inner + np.eye(inner.shape[-1])
        factor = np.linalg.cholesky(inner)
        gained = np.linalg.solve(factor, turned)
        whole = whole - np.einsum("hkm,hkm->hm", gained, gained)
        more = 2 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return self._log(whole, more[:, np.newaxis])

    def _with_uneven(
        self,
        shift: ShiftHypothesis,
        residuals: Residuals,
        error: Array,
        inner: Array,
        turned: Array,
    ) -> tuple[Array, Array]:
        """Return products with K⁻¹ of the errors' columns, those of the pairs after the bands'."""
        nodes = self.nodes[shift.response]
        n_columns = self.uneven.shape[1]
        change = np.einsum("hkn,kn->hk", shift.weights, np.einsum("v,kvn->kn", self.amount, nodes))
        change = change * shift.uneven[:, np.newaxis]
        both = (change[:, :, np.newaxis] * change[:, np.newaxis]).reshape(len(change), -1)
        pairs = (both @ self._uneven_products).reshape(-1, n_columns, n_columns)
        cross = self._uneven_node_products(shift.response)  # (k, c, l, n): band k, column c
        mixed = np.einsum("hk,kcln->hcln", change, cross, optimize=True)
        mixed = np.einsum("hcln,hln->hcl", mixed, shift.weights, optimize=True)
        pulled = residuals.pull.reshape(len(nodes), nodes.shape[1], -1)
        by_column = np.einsum("vc,kvm->kcm", self.uneven, pulled)
        toward = np.einsum("hk,kcm->hcm", change, by_column, optimize=True)
        toward = toward - mixed.sum(axis=2)[:, :, np.newaxis]
        side = mixed @ error
        joined = np.concatenate(
            [
                np.concatenate([inner, side.swapaxes(1, 2)], axis=2),
                np.concatenate([side, pairs], axis=2),
            ],
            axis=1,
        )
        return joined, np.concatenate([turned, toward], axis=1)

    def inverse_with_place(self, shift: ShiftHypothesis, row: int) -> Array:
        """Return the inverse of the covariance with the error of a hypothesis' place, (n, n)."""
        nodes = self.nodes[shift.response]
        change = np.einsum("kn,kvn,v->k", shift.weights[row], nodes, self.amount)
        columns = np.multiply.outer(change * shift.uneven[row], self.uneven)
        columns = columns.reshape(-1, self.uneven.shape[1])
        pulled = self.inverse @ columns
        inner = np.eye(columns.shape[1]) + columns.T @ pulled
        return np.asarray(self.inverse - pulled @ np.linalg.solve(inner, pulled.T))

    @cached_property
    def _uneven_products(self) -> Array:
        """W' K⁻¹ W by pairs of bands, (n_bands², n_columns²), W being `uneven`."""
        n_values, n_columns = self.uneven.shape
        n_bands = len(self.inverse) // n_values
        inverse = self.inverse.reshape(n_bands, n_values, n_bands, n_values)
        half = np.einsum("vc,kvlw->kclw", self.uneven, inverse, optimize=True)
        full = np.einsum("kclw,wd->klcd", half, self.uneven, optimize=True)
        return np.asarray(full.reshape(n_bands**2, n_columns**2))

    def _uneven_node_products(self, response: str) -> Array:
        """Return W' K⁻¹ N, (n_bands, n_columns, n_bands, n_nodes)."""
        key = f"uneven {response}"
        if key not in self._products:
            nodes = self.nodes[response]
            n_bands, n_values, _ = nodes.shape
            inverse = self.inverse.reshape(n_bands, n_values, n_bands, n_values)
            half = np.einsum("kvlw,lwn->kvln", inverse, nodes, optimize=True)
            self._products[key] = np.einsum("vc,kvln->kcln", self.uneven, half, optimize=True)
        return self._products[key]

    def spread(self, spread: SpreadHypothesis, residuals: Residuals) -> Array:
        """Return the log density with some errors wider, (n_draws,)."""
        rows = spread.rows[self.used[spread.rows]]
        if not len(rows):
            return self.stated(residuals)
        kept = self.used[spread.rows]
        added = spread.covariance[np.ix_(kept, kept)]
        inside = self.inverse[np.ix_(rows, rows)]
        pulled = residuals.pull[rows]
        inner = np.eye(len(rows)) + added @ inside
        gained = np.einsum("rm,rm->m", pulled, np.linalg.solve(inner, added @ pulled))
        return self._log(residuals.square - gained, float(np.linalg.slogdet(inner)[1]))

    def forms(self, shift: ShiftHypothesis) -> Array:
        """Return d' K⁻¹ d by pairs of bands, (n_hypotheses, n_bands, n_bands)."""
        products = self._node_products(shift.response)
        right = np.einsum("kmln,hln->hkml", products, shift.weights, optimize=True)
        return np.asarray((shift.weights[..., np.newaxis] * right).sum(axis=2))

    def _forms(self, shift: ShiftHypothesis, residuals: Residuals) -> tuple[Array, Array]:
        nodes = self.nodes[shift.response]
        pulled = residuals.pull.reshape(len(nodes), nodes.shape[1], -1)
        by_node = nodes.swapaxes(1, 2) @ pulled
        return np.asarray(shift.weights.swapaxes(0, 1) @ by_node).swapaxes(0, 1), self.forms(shift)

    def _node_products(self, response: str) -> Array:
        """Return N' K⁻¹ N, (n_bands, n_nodes, n_bands, n_nodes)."""
        if response not in self._products:
            nodes = self.nodes[response]
            n_bands, n_values, _ = nodes.shape
            inverse = self.inverse.reshape(n_bands, n_values, n_bands, n_values)
            half = np.einsum("krls,lsn->krln", inverse, nodes, optimize=True)
            self._products[response] = np.einsum("krm,krln->kmln", nodes, half, optimize=True)
        return self._products[response]

    def _log(self, square: Array, more: Array | float) -> Array:
        """Return the log density of chi-squares by level, ``more`` added to the log determinant.

        (..., n_levels n_draws) to (..., n_draws), the mean over the levels. Normal up to the number of
        values; beyond it as if the errors were larger throughout, since few control runs say how large
        they are.
        """
        n = self.number
        excess = np.log(np.maximum(square / n, 1.0))
        fit = np.where(square <= n, square / 2, n / 2 * (1 + excess))
        log = -fit - (self.log_determinant + more) / 2
        weights = self.levels.log_weights[:, np.newaxis]
        by_level = log.reshape(*log.shape[:-1], len(weights), -1) + weights
        return np.asarray(np.logaddexp.reduce(by_level, axis=-2))


Likelihoods = tuple[Likelihood, list[Likelihood], list[Likelihood]]
"""With coefficients as stated, off together, and of something that no effect explains."""


def flat(values: Array) -> Array:
    """Return values (n_parameters, n_pairs, n_bands) in the order (band, parameter, pair), (n,)."""
    return np.asarray(np.moveaxis(values, 2, 0).reshape(-1))


def band_first(values: Array) -> Array:
    """Return shifts (n_parameters, n_pairs, n_bands, n_nodes) by band, (n_bands, n_values, n_nodes)."""
    moved = np.moveaxis(values, 2, 0)
    return np.asarray(moved.reshape(len(moved), -1, values.shape[-1]))


def reordered(covariance: Array, shape: Sequence[int]) -> Array:
    """Return a covariance over (parameter, pair, band) in the order (band, parameter, pair)."""
    p, i, k = shape
    order = np.moveaxis(np.arange(p * i * k).reshape(p, i, k), 2, 0).reshape(-1)
    return np.asarray(covariance[np.ix_(order, order)])
