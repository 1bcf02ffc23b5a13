"""What a calibration is composed of: objective terms and constraints.

Objective terms add with ``+`` and scale with ``*``; constraints stand in a list. Each gives two
independent descriptions of itself: an expression for cvxpy, and a plain-NumPy twin in alpha (value,
gradient and curvature of an objective term; rows of a constraint). The certificate is computed from
the twins, so a wrong expression cannot certify itself; the tests compare the two.

In a twin ``alpha`` has shape (n_materials, n_bands); rows and curvatures are over its flattened
form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from rtcal.acoustics.room import Room
from rtcal.calibration.context import Context
from rtcal.calibration.instance import Instance, Integers
from rtcal.errors import DataError, ModelError
from rtcal.types import Array


@runtime_checkable
class ObjectiveTerm(Protocol):
    """A convex function of alpha: quadratic, or piecewise quadratic."""

    def expression(self, context: Context, weight: int) -> Any:
        """Return the cvxpy expression, its weight (number ``weight`` of the instance) folded in."""
        ...

    def value(self, alpha: Array, instance: Instance) -> float:
        """Return the unweighted value at alpha."""
        ...

    def gradient(self, alpha: Array, instance: Instance) -> Array:
        """Return the unweighted gradient, (n_materials, n_bands)."""
        ...

    def curvature(self, alpha: Array, instance: Instance) -> Any:
        """Return the unweighted second derivative: its diagonal (size,), or a sparse matrix."""
        ...

    def __add__(self, other: Any) -> Objective: ...

    def __rmul__(self, factor: float) -> Objective: ...


@dataclass(frozen=True)
class Objective:
    """A weighted sum of objective terms."""

    terms: tuple[ObjectiveTerm, ...]
    weights: tuple[float, ...]

    def __add__(self, other: Any) -> Objective:
        other = as_objective(other)
        return Objective(self.terms + other.terms, self.weights + other.weights)

    def __rmul__(self, factor: float) -> Objective:
        if not (np.isfinite(factor) and factor >= 0):
            raise ModelError(f"a weight of {factor:g} is not finite and 0 or more: not convex")
        return Objective(self.terms, tuple(float(factor) * w for w in self.weights))

    __mul__ = __rmul__


def as_objective(term: ObjectiveTerm | Objective) -> Objective:
    """Return a term, or a sum of them, as an `Objective`; ModelError for anything else."""
    if isinstance(term, Objective):
        return term
    if isinstance(term, ObjectiveTerm):
        return Objective((term,), (1.0,))
    raise ModelError(f"{term!r} is not an objective term")


class _Sums:
    """Lets a term be added and scaled."""

    def __add__(self, other: Any) -> Objective:
        mine: Any = self
        return as_objective(mine).__add__(other)

    def __rmul__(self, factor: float) -> Objective:
        mine: Any = self
        return as_objective(mine) * factor

    __mul__ = __rmul__


@dataclass(frozen=True)
class PriorDeviation(_Sums):
    """½ sum ((alpha - mu) / sigma)²: stay near what was known, weighted by how well it was known.

    When to use it: always; it makes the answer unique. The paper's maximum-likelihood estimate
    (Bellows & Katz 2025, Eq. 19) is this term and `ExactMatch`; its least-squares estimate (Eq. 7)
    is the same with every sigma equal, ``PriorDeviation(sigma=1)``.

    Parameters
    ----------
    sigma : float, optional
        One standard deviation for every coefficient in place of the room's, above 0.
    """

    sigma: float | None = None

    def __post_init__(self) -> None:
        if self.sigma is not None and not (np.isfinite(self.sigma) and self.sigma > 0):
            raise ModelError(f"PriorDeviation(sigma={self.sigma:g}): sigma must be above 0")

    def expression(self, context: Context, weight: int) -> Any:
        """½ |x|² in the whitened unknowns.

        Its weight is 1: the whole objective is scaled so. A parameter here would cost a slack
        variable for each unknown.
        """
        return 0.5 * cp.sum_squares(context.x)

    def value(self, alpha: Array, instance: Instance) -> float:
        """Return ½ sum ((alpha - mu) / sigma)² over the coefficients with sigma > 0."""
        return 0.5 * float(np.sum(self._deviation(alpha, instance) ** 2))

    def gradient(self, alpha: Array, instance: Instance) -> Array:
        """Return (alpha - mu) / sigma², 0 where sigma = 0."""
        return self._deviation(alpha, instance) * _reciprocal(instance.sigma)

    def curvature(self, alpha: Array, instance: Instance) -> Any:
        """Return 1 / sigma², 0 where sigma = 0: a diagonal."""
        return (_reciprocal(instance.sigma) ** 2).ravel()

    @staticmethod
    def _deviation(alpha: Array, instance: Instance) -> Array:
        return (alpha - instance.mu) * _reciprocal(instance.sigma)


def _reciprocal(sigma: Array) -> Array:
    return np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)


@dataclass(frozen=True)
class Rows:
    """lower <= matrix @ alpha <= upper, in alpha's units; an equality where the two are equal."""

    matrix: Any
    lower: Array
    upper: Array


@runtime_checkable
class RowConstraint(Protocol):
    """A constraint that adds rows to the problem."""

    def constraints(self, context: Context) -> list[tuple[Any, int]]:
        """Return cvxpy constraints, each with the sign of its dual in the rows' multipliers."""
        ...

    def row_scale(self, instance: Instance) -> Array:
        """Return by what each row is multiplied in the cvxpy constraint, (n_rows,)."""
        ...

    def rows(self, instance: Instance) -> Rows:
        """Return the rows' NumPy twin; one that does not apply is all zero and without limits."""
        ...


@runtime_checkable
class BoundConstraint(Protocol):
    """A constraint that narrows the box; it costs nothing."""

    def box(self, room: Room, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return the narrowed box, both (n_materials, n_bands)."""
        ...


@dataclass(frozen=True)
class ExactMatch:
    """S'alpha = b in every band that has a measured T (Bellows & Katz 2025, Eq. 4).

    When to use it: as the paper does, or when the uncertainty of T is not known. It forces the
    noise of T into alpha; `SoftMatch` does not.
    """

    def constraints(self, context: Context) -> list[tuple[Any, int]]:
        """One equality a band, scaled by k = |S sigma| so that all bands weigh alike."""
        rows, columns, n_rows = context.match_pattern()

        def compute(instance: Instance) -> tuple[Array, Array]:
            scale = self.row_scale(instance)
            values = _match_values(instance) * scale[rows]
            target = np.where(instance.matched, instance.target, 0.0).ravel()
            return values, -target * scale

        return [(context.affine(rows, columns, n_rows, compute).expression == 0, 1)]

    def row_scale(self, instance: Instance) -> Array:
        """Return 1 / |S sigma| over the coefficients that can move; 0 where there is no row."""
        size = np.sqrt(instance.areas**2 @ instance.scale**2)
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=instance.matched & (size > 0))
        return np.asarray(scale.ravel())

    def rows(self, instance: Instance) -> Rows:
        """S'alpha = b; bands without T have a row of zeros without limits."""
        matched = instance.matched.ravel()
        target = instance.target.ravel()
        return Rows(
            match_matrix(instance),
            np.where(matched, target, -np.inf),
            np.where(matched, target, np.inf),
        )


def _match_values(instance: Instance) -> Array:
    """Coefficients of alpha in S'alpha, in the order of `Context.match_pattern`."""
    c, n, k = instance.shape
    areas = np.broadcast_to(instance.areas[:, :, np.newaxis], (c, n, k))
    return np.where(instance.matched[:, np.newaxis, :], areas, 0.0).ravel()


def match_matrix(instance: Instance) -> Any:
    """Return S' as a sparse matrix, one row a configuration and band, over the flattened alpha."""
    c, n, k = instance.shape
    areas = np.broadcast_to(instance.areas[:, np.newaxis, :], (c, k, n))
    values = np.where(instance.matched[:, :, np.newaxis], areas, 0.0)
    columns = np.arange(n) * k + np.arange(k)[:, np.newaxis]
    columns = np.broadcast_to(columns, (c, k, n))
    starts = np.arange(0, c * k * n + 1, n)
    return sp.csr_array((values.ravel(), columns.ravel(), starts), shape=(c * k, n * k))


@dataclass(frozen=True)
class Bounds:
    """lower <= alpha <= upper, for all materials and bands or for some.

    When to use it: where physics or a data sheet gives limits tighter than 0 to 1.

    Parameters
    ----------
    lower, upper : float
    material : str, optional
        Only this material.
    band : float, optional
        Only this band, by its centre frequency in Hz.
    """

    lower: float = 0.0
    upper: float = 1.0
    material: str | None = None
    band: float | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.lower <= self.upper <= 1:
            raise DataError(
                f"Bounds({self.lower:g}, {self.upper:g}) is not within 0 <= lower <= upper <= 1"
            )

    def box(self, room: Room, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return the box cut to these bounds."""
        where = selection(room, self.material, self.band)
        lower, upper = lower.copy(), upper.copy()
        lower[where] = np.maximum(lower[where], self.lower)
        upper[where] = np.minimum(upper[where], self.upper)
        return lower, upper


def selection(
    room: Room, material: str | None, band: float | None
) -> tuple[Integers | slice, Integers | slice]:
    """Return the index of a material (all if None) and a band (all if None) into alpha."""
    from rtcal.acoustics import bands

    rows: Integers | slice = slice(None)
    columns: Integers | slice = slice(None)
    if material is not None:
        rows = np.array([room.material_index(material)])
    if band is not None:
        place = bands.index(room.centre_frequencies, band)
        if place is None:
            has = ", ".join(bands.label(f) for f in room.centre_frequencies)
            raise DataError(f"band {bands.label(band)} is no band of the room; it has {has}")
        columns = np.array([place])
    return rows, columns
