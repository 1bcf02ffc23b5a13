"""Priors: the terms that measure the shift of alpha from the stated coefficients. One is required."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from rtcal.acoustics.bands import correlation
from rtcal.calibration.compiled_qp import Context
from rtcal.calibration.layout import Layout
from rtcal.calibration.problem_data import ProblemData
from rtcal.calibration.terms.base import BaseTerm, half_squares
from rtcal.support import checks
from rtcal.support.errors import ModelError
from rtcal.support.kkt import Hessian
from rtcal.support.types import Array


def _positive(what: str, value: float | None) -> None:
    if value is None:
        return
    given = checks.number(what.replace("(", ": "), value, ModelError)
    if not (np.isfinite(given) and given > 0):
        raise ModelError(f"{what}={given:g}): it must be finite and above 0")


def _deviation(u: Array, data: ProblemData) -> Array:
    """(u - mu) / sigma of the coefficients, 0 where sigma = 0 and for further unknowns."""
    x = (u - data.mu) * data.inverse_sigma
    x[data.layout.n_alpha :] = 0.0
    return np.asarray(x)


@dataclass(frozen=True)
class PriorDeviation(BaseTerm):
    """½ x'R⁻¹x, x = (alpha - mu) / sigma: half the squared shift from the prior mean in sigmas.

    When to use it: always (or `HuberDeviation`); it makes the answer unique. The paper's
    maximum-likelihood estimate (Bellows & Katz 2025, Eq. 19) is this term, independent (R = 1),
    and `ExactMatch`; its least-squares estimate (Eq. 7) is the same with every sigma equal,
    ``PriorDeviation(sigma=1)``. Give correlations where errors go together: a data sheet that is
    too low at 500 Hz is likely too low at 1 kHz; two boards of one maker err alike. They change
    nothing with an exact match, no coefficient at a bound, one correlation for all materials, and
    sigmas that are a material's factor times a band's (see docs/modelling.md).

    Parameters
    ----------
    sigma : float, optional
        One standard deviation for every coefficient in place of the room's (but 0 stays 0), above 0.
    band_correlation : float, matrix (n_bands, n_bands), or a mapping of material to either
        A number r below 1 is the correlation of two bands an octave apart: r ** octaves. Materials
        that a mapping lacks are uncorrelated.
    material_correlation : matrix (n_materials, n_materials) or mapping of pairs to float
        Between the same bands of two materials: ``{("door", "panel"): 0.7}``.
    common : bool
        Whether all coefficients may be off together, by the room's ``common_alpha_sigma`` t: then the
        covariance is sigma R sigma + t² mu mu' over all materials and bands.

    Raises
    ------
    ModelError
        When built, for a correlation that is none (not symmetric with unit diagonal, not positive
        definite).
    """

    sigma: float | None = None
    band_correlation: float | Sequence[Sequence[float]] | Mapping[str, Any] = 0.0
    material_correlation: Sequence[Sequence[float]] | Mapping[tuple[str, str], float] = ()
    common: bool = False

    is_prior: ClassVar[bool] = True

    def __post_init__(self) -> None:
        checks.flag("PriorDeviation: common", self.common)
        _positive("PriorDeviation(sigma", self.sigma)
        # Kept as tuples: a term is hashable, so that weights can be given by term.
        given, pairs = self.band_correlation, self.material_correlation
        frozen: Any = _frozen("band_correlation", given)
        if isinstance(given, Mapping):
            frozen = tuple(
                (str(m), _frozen(f'band_correlation of "{m}"', r)) for m, r in given.items()
            )
        between: Any = _frozen("material_correlation", pairs)
        if isinstance(pairs, Mapping):
            between = tuple(_pair(names, r) for names, r in pairs.items())
        object.__setattr__(self, "band_correlation", frozen)
        object.__setattr__(self, "material_correlation", between)

    def correlated(self) -> bool:
        """Whether any correlation was stated, or a part that all coefficients have in common."""
        return bool(self.band_correlation) or bool(self.material_correlation) or self.common

    def factors(self, layout: Layout) -> tuple[list[Array], Array]:
        """Return Cholesky factors of R = B (C x 1) B': B per row of alpha (n_bands, n_bands), C's.

        Raises ModelError as the class says.
        """
        names = [layout.materials[i] for i in layout.first]
        return _factors(self, layout, tuple(names))

    def correlation(self, layout: Layout) -> Array:
        """Return R over all coefficients, (n_alpha, n_alpha)."""
        bands, between = self.factors(layout)
        stacked = np.array(bands)
        full = np.einsum("ij,iab,jcb->iajc", between @ between.T, stacked, stacked)
        return np.asarray(full.reshape(layout.n_alpha, layout.n_alpha))

    def correlate(self, columns: Array, layout: Layout) -> Array:
        """Return R @ columns; further unknowns are independent."""
        if not self.correlated():
            return columns
        bands, between = self.factors(layout)
        n, k = layout.n_rows, layout.n_bands
        stacked = np.array(bands)
        alpha = columns[: layout.n_alpha].reshape(n, k, -1)
        alpha = np.einsum("iab,ia...->ib...", stacked, alpha)
        alpha = np.einsum("ij,jb...->ib...", between @ between.T, alpha)
        alpha = np.einsum("iab,ib...->ia...", stacked, alpha).reshape(layout.n_alpha, -1)
        return np.concatenate([alpha, columns[layout.n_alpha :]])

    def expression(self, context: Context, weight: int) -> Any:
        """½ |W x|² in the whitened unknowns, W'W the inverse of R.

        Its weight is 1: the whole objective is scaled so. A parameter here would cost a slack
        variable for each unknown.
        """
        layout = context.layout
        n = layout.n_alpha
        x = context.x[:n] if layout.further else context.x
        if not self.correlated():
            return half_squares(x)
        together = context.variable(1) if self.common else None
        if not (self.band_correlation or self.material_correlation):
            # What is held off its mean tells of the common part alone: one square, not one each.
            common = context.parameter(
                (n, 1), lambda i: ((1 - _held(i)) * _together(i)[:n])[:, None]
            )
            told = context.parameter(2, _told)
            rest = cp.multiply(told[:1], together) - told[1:]
            return half_squares(x - common @ together) + half_squares(rest)
        # A coefficient held off its mean pulls at those that it is correlated with; one that is
        # known exactly (sigma = 0) says nothing of them, so there x stays free.
        keep = context.multiply(x, lambda i: 1.0 - _held(i))
        loose = half_squares(context.multiply(x, _held))
        own = keep + context.parameter(n, lambda i: _held(i) * _deviation(i.centre, i)[:n])
        if self.common:
            own = own - context.parameter((n, 1), lambda i: _together(i)[:n, None]) @ together
            loose = loose + half_squares(together)
        return half_squares(self._whitener(layout) @ own) + loose

    def value(self, u: Array, data: ProblemData) -> float:
        """Return ½ x'R⁻¹x over the coefficients with sigma > 0."""
        x = _deviation(u, data)
        return 0.5 * float(x @ self._apply(x, data))

    def gradient(self, u: Array, data: ProblemData) -> Array:
        """Return R⁻¹x / sigma, 0 where sigma = 0."""
        return self._apply(_deviation(u, data), data) * data.inverse_sigma

    def curvature(self, u: Array, data: ProblemData) -> Any:
        """Return R⁻¹ over sigma sigma': 1 / sigma² on a diagonal without correlations.

        What all coefficients have in common takes one square off (`rtcal.support.kkt.Hessian`).
        """
        inverse = data.inverse_sigma.copy()
        inverse[data.layout.n_alpha :] = 0.0
        plain: Any = inverse**2
        if self.band_correlation or self.material_correlation:
            scale = sp.diags_array(inverse)
            plain = sp.csr_array(scale @ self._padded(data) @ scale)
        if self.common:
            return Hessian(plain, less=(self._shared(data) * inverse)[np.newaxis])
        return plain

    def convexity(self, data: ProblemData) -> Array:
        """Return the least eigenvalue of R⁻¹ for every coefficient."""
        least = 1.0
        if self.correlated():
            bands, between = self.factors(data.layout)
            largest = np.linalg.norm(between, 2) ** 2
            spread = float(largest * max(np.linalg.norm(b, 2) ** 2 for b in bands))
            least = 1 / (spread + (np.sum(_together(data) ** 2) if self.common else 0.0))
        m = np.full(data.layout.size, least)
        m[data.layout.n_alpha :] = 0.0
        return m

    def _apply(self, x: Array, data: ProblemData) -> Array:
        precise = self._of_pairs(x, data)
        if self.common:
            shared = self._shared(data)
            precise = precise - shared * (shared @ x)
        return precise

    def _shared(self, data: ProblemData) -> Array:
        """s of (R + q q')⁻¹ = R⁻¹ - s s', q what all coefficients have in common in sigmas."""
        together = _together(data)
        precise = self._of_pairs(together, data)
        return np.asarray(precise / np.sqrt(1 + together @ precise))

    def _of_pairs(self, x: Array, data: ProblemData) -> Array:
        """R⁻¹x without the common part."""
        if not (self.band_correlation or self.material_correlation):
            return x
        return np.asarray(self._padded(data) @ x)

    def _padded(self, data: ProblemData) -> Any:
        """R⁻¹ over all unknowns, those with sigma = 0 integrated out."""
        known = data.sigma[: data.layout.n_alpha] == 0
        return _precision(self, data.layout, known.tobytes())

    def _whitener(self, layout: Layout) -> Any:
        bands, between = self.factors(layout)
        within = sp.block_diag([sp.csr_array(np.linalg.inv(b)) for b in bands])
        across = sp.kron(np.linalg.inv(between), sp.eye_array(layout.n_bands))
        whitener = sp.csr_array(across @ within)
        whitener.eliminate_zeros()
        return whitener


def _together(data: ProblemData) -> Array:
    """The change of all coefficients together by one standard deviation, in sigmas, (size,)."""
    return np.asarray(data.common_shift * data.inverse_sigma)


def _told(data: ProblemData) -> Array:
    """Return a and b: t'(1 + q'q)t/2 - t q'd is ½(a t - b)² but for a constant.

    d is how far held coefficients are off their mean, q their change with all others, in sigmas.
    """
    n = data.layout.n_alpha
    shift, off = _held(data) * _together(data)[:n], _deviation(data.centre, data)[:n]
    steep = np.sqrt(1 + shift @ shift)
    return np.array([steep, shift @ off / steep])


def _held(data: ProblemData) -> Array:
    """Return the mask of the pinned coefficients with sigma > 0, as floats."""
    n = data.layout.n_alpha
    return np.asarray((data.pinned[:n] & (data.sigma[:n] > 0)).astype(float))


def _frozen(what: str, value: Any) -> Any:
    if isinstance(value, Mapping):
        return ()
    array = checks.array(what, value, ModelError)
    if array.ndim == 0:
        return float(array)
    if array.size and array.ndim != 2:
        raise ModelError(f"{what} has shape {array.shape}; it is a number, a matrix or a mapping")
    return tuple(map(tuple, array.tolist()))


def _pair(names: Any, r: Any) -> tuple[str, str, float]:
    if not isinstance(names, tuple) or len(names) != 2:
        raise ModelError(f"material_correlation: {names!r} is not a pair of materials")
    a, b = str(names[0]), str(names[1])
    return a, b, checks.number(f'material_correlation["{a}", "{b}"]', r, ModelError)


def _named(given: Any) -> bool:
    """Whether a frozen correlation was given by names."""
    return isinstance(given, tuple) and bool(given) and isinstance(given[0][0], str)


@functools.lru_cache(maxsize=16)
def _factors(
    term: PriorDeviation, layout: Layout, names: tuple[str, ...]
) -> tuple[list[Array], Array]:
    given: Any = term.band_correlation
    by_material = dict(given) if _named(given) else None
    for name in by_material or ():
        layout.index(name)
    bands = []
    for name in names:
        r = given if by_material is None else by_material.get(name, 0.0)
        if isinstance(r, float):
            if not 0 <= r < 1:
                raise ModelError(f"band_correlation {r:g} is not in [0, 1)")
            table = correlation(np.array(layout.centre_frequencies), r)
        else:
            table = np.array(r)
        bands.append(_cholesky(table, layout.n_bands, f'band_correlation of "{name}"'))
    between = np.eye(layout.n_rows)
    pairs: Any = term.material_correlation
    if _named(pairs):
        for a, b, r in pairs:
            i, j = (layout.index(m)[0] // layout.n_bands for m in (a, b))
            if i == j:
                raise ModelError(f'material_correlation: "{a}" and "{b}" are one unknown')
            between[i, j] = between[j, i] = r
    elif pairs:
        between = np.array(pairs)
    return bands, _cholesky(between, layout.n_rows, "material_correlation")


def _cholesky(table: Array, n: int, what: str) -> Array:
    if table.shape != (n, n):
        raise ModelError(f"{what} has shape {table.shape}; it must be ({n}, {n})")
    if not np.allclose(table, table.T, rtol=0, atol=1e-12) or not np.allclose(np.diag(table), 1):
        raise ModelError(f"{what} is not symmetric with ones on its diagonal")
    try:
        return np.asarray(np.linalg.cholesky(table))
    except np.linalg.LinAlgError as error:
        raise ModelError(f"{what} is not positive definite") from error


@functools.lru_cache(maxsize=16)
def _precision(term: PriorDeviation, layout: Layout, known: bytes) -> Any:
    whitener = term._whitener(layout)
    precision = sp.csr_array(whitener.T @ whitener)
    out = np.frombuffer(known, dtype=bool)
    if out.any():
        # Integrating unknowns out of a Gaussian: the Schur complement of their block.
        keep = np.flatnonzero(~out)
        gone = np.flatnonzero(out)
        cross = precision[keep][:, gone]
        reduced = precision[keep][:, keep] - sp.csr_array(
            cross @ np.linalg.solve(precision[gone][:, gone].toarray(), cross.T.toarray())
        )
        spread = sp.csr_array(
            (np.ones(len(keep)), (keep, np.arange(len(keep)))), (layout.n_alpha, len(keep))
        )
        precision = spread @ sp.csr_array(reduced) @ spread.T
    padded = sp.csr_array(
        sp.block_diag([precision, sp.csr_array((layout.size - layout.n_alpha,) * 2)])
    )
    return padded


@dataclass(frozen=True)
class HuberDeviation(BaseTerm):
    """sum of e x²/2 + (1 - e) h(x): like `PriorDeviation` near mu, but straight beyond t sigmas.

    h(x) = x²/2 for |x| <= t, t |x| - t²/2 beyond (Huber 1964, Eq. 2.4).

    When to use it: when some stated sigma may be plain wrong (a material taken for another): one
    coefficient may then move far at a bounded price, and the others need not follow. Huber's own
    minimiser is not unique, so a small strictly convex part, e = 0.01 of the square, is mixed in.

    Parameters
    ----------
    threshold : float
        t, in sigmas, above 0; beyond it a coefficient counts as an outlier.
    convex : float
        e, above 0 and at most 1.
    sigma : float, optional
        One standard deviation for every coefficient in place of the room's.
    """

    threshold: float = 1.5
    convex: float = 0.01
    sigma: float | None = None

    is_prior: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _positive("HuberDeviation(sigma", self.sigma)
        _positive("HuberDeviation(threshold", self.threshold)
        checks.number("HuberDeviation: convex", self.convex, ModelError)
        if not 0 < self.convex <= 1:
            raise ModelError(f"HuberDeviation(convex={self.convex:g}): it must be in (0, 1]")

    def expression(self, context: Context, weight: int) -> Any:
        """½ e |x|² + (1 - e) (½ |x - s|² + t |s|), s the part beyond the threshold."""
        n = context.layout.n_alpha
        x = context.x[:n]
        beyond = context.variable(n)
        # The maximum makes the sum one helper variable. cvxpy compiles an objective that is linear in
        # n of them with memory for n numbers per parameter.
        near = half_squares(x - beyond) + self.threshold * cp.maximum(cp.norm1(beyond), 0)
        return self.convex * half_squares(x) + (1 - self.convex) * near

    def value(self, u: Array, data: ProblemData) -> float:
        """Return the sum over the coefficients with sigma > 0."""
        x = np.abs(_deviation(u, data))
        t = self.threshold
        huber = np.where(x <= t, x**2 / 2, t * x - t**2 / 2)
        return float(np.sum(self.convex * x**2 / 2 + (1 - self.convex) * huber))

    def gradient(self, u: Array, data: ProblemData) -> Array:
        """Return (e x + (1 - e) clip(x, -t, t)) / sigma."""
        x = _deviation(u, data)
        clipped = np.clip(x, -self.threshold, self.threshold)
        pull = self.convex * x + (1 - self.convex) * clipped
        return np.asarray(pull * data.inverse_sigma)

    def curvature(self, u: Array, data: ProblemData) -> Any:
        """Return 1 / sigma² within the threshold, e / sigma² beyond: a diagonal."""
        x = _deviation(u, data)
        inverse = data.inverse_sigma.copy()
        inverse[data.layout.n_alpha :] = 0.0
        return np.where(np.abs(x) <= self.threshold, 1.0, self.convex) * inverse**2

    def convexity(self, data: ProblemData) -> Array:
        """Return e for every coefficient."""
        m = np.full(data.layout.size, self.convex)
        m[data.layout.n_alpha :] = 0.0
        return m
