"""The KKT system of a quadratic step within linear equalities.

    H x + A'y = f,  A x = c,

with H positive definite, given as its diagonal, as a sparse matrix, or as a `Hessian` with rows F of
squares. Each of those is a further unknown s = F x, which has s'Fx / 2 in the objective's place. What a
`Hessian` has less, G'G, follows from the system without it (Woodbury 1950).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from rtcal.support.errors import SolverError
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class Squares:
    """The second derivative F'F of ½ |F u|², kept as F.

    F has few rows that couple many unknowns: a soft match one per T. F'F would hold every pair of them.

    Attributes
    ----------
    rows : array or sparse array (n_squares, size)
        F.
    """

    rows: Any

    def whole(self) -> Any:
        """Return F'F, a sparse matrix (size, size)."""
        return sp.csr_array(self.rows.T @ self.rows)


@dataclass(frozen=True, eq=False)
class Hessian:
    """H = plain + F'F - G'G.

    Attributes
    ----------
    plain : array (size,) or sparse array (size, size)
        A diagonal, or a matrix.
    rows : array or sparse array (n_squares, size), optional
        F.
    less : array (n_less, size), optional
        G: what unknowns have in common takes this much curvature off. H stays positive definite.
    """

    plain: Any
    rows: Any = None
    less: Array | None = None

    @classmethod
    def total(cls, parts: Iterable[tuple[float, Any]], size: int) -> Hessian:
        """Return the weighted sum of diagonals, sparse matrices, `Squares` and one with ``less``."""
        diagonal, matrix, rows, less = np.zeros(size), None, [], None
        for weight, part in parts:
            if isinstance(part, Hessian):
                less = np.sqrt(weight) * np.asarray(part.less)
                part = part.plain
            if isinstance(part, Squares):
                rows.append(np.sqrt(weight) * part.rows)
            elif sp.issparse(part):
                matrix = weight * part if matrix is None else matrix + weight * part
            else:
                diagonal = diagonal + weight * part
        plain = diagonal if matrix is None else sp.csr_array(matrix + sp.diags_array(diagonal))
        if not rows:
            return cls(plain, None, less)
        if any(map(sp.issparse, rows)):
            return cls(plain, sp.csr_array(sp.vstack(rows)), less)
        return cls(plain, np.vstack(rows), less)

    def diagonal(self) -> Array:
        """Return the diagonal of H, (size,)."""
        diagonal = self.plain.diagonal() if sp.issparse(self.plain) else self.plain
        if self.less is not None:
            diagonal = diagonal - (self.less**2).sum(axis=0)
        if self.rows is None:
            return np.asarray(diagonal)
        return np.asarray(diagonal + np.asarray((self.rows**2).sum(axis=0)).ravel())

    def magnitude(self, size: Array) -> Array:
        """Return |plain| x + |F|'|F| x + |G|'|G| x for x >= 0, (size,): no entry of |H| x is larger."""
        plain = abs(self.plain)
        product = plain @ size if sp.issparse(plain) else plain * size
        for part in (self.rows, self.less):
            if part is not None:
                rows = abs(part)
                product = product + rows.T @ (rows @ size)
        return np.asarray(product)

    def couples(self, group: NDArray[np.int_]) -> bool:
        """Whether an entry of H couples unknowns of two groups; ``group`` (size,)."""
        if sp.issparse(self.plain):
            entries = self.plain.tocoo()
            if (group[entries.row] != group[entries.col]).any():
                return True
        for rows in (self.rows, self.less):
            if rows is not None:
                row, column = rows.nonzero()
                first = np.full(rows.shape[0], -1)
                first[row] = group[column]
                if (first[row] != group[column]).any():
                    return True
        return False

    def part(self, free: NDArray[np.bool_], scale: Array) -> Hessian:
        """Return H over the free unknowns, each in units of its ``scale`` (n_free,)."""
        plain = self.plain[free]
        if sp.issparse(plain):
            plain = sp.diags_array(scale) @ plain[:, free] @ sp.diags_array(scale)
        else:
            plain = plain * scale**2
        rows, less = (
            None if part is None else part[:, free] * scale for part in (self.rows, self.less)
        )
        return Hessian(plain, rows, less)

    def whole(self) -> Any:
        """Return H as its diagonal (size,), or as a sparse matrix that holds every pair."""
        if self.rows is None and self.less is None:
            return self.plain
        whole = self.plain if sp.issparse(self.plain) else sp.diags_array(self.plain)
        if self.rows is not None:
            whole = whole + Squares(self.rows).whole()
        if self.less is not None:
            whole = whole - Squares(self.less).whole()
        return sp.csr_array(whole)


DENSE = 500_000
"""Largest number of coefficients for which rows are a dense array: in a usual room the overhead of
scipy.sparse exceeds the arithmetic."""
_SHIFT = 1e-11
"""Regularisation of the factored matrix; the refinement below removes its effect."""
_REFINEMENTS = 4
_DEPENDENT = 1e-12
"""Singular values below this share of the largest count as 0: those rows are dependent."""


def solve(hessian: Any, matrix: Any, force: Array, limit: Array) -> tuple[Array, Array]:
    """Return the step x and the multipliers y.

    Dependent rows have many multipliers; those of least norm are returned.

    Parameters
    ----------
    hessian : array (n,), sparse array (n, n) or Hessian
        H, or its diagonal.
    matrix : array or sparse array (n_rows, n)
        A, its rows of unit length.
    force : array (n,) or (n, n_columns)
        f; one column per system.
    limit : array (n_rows,) or (n_rows, n_columns)
        c.

    Raises
    ------
    SolverError
        If the system is singular.

    Examples
    --------
    Minimise x1² / 2 + x2² / 2 subject to x1 + x2 = 2:

    >>> step, multipliers = solve(np.ones(2), np.ones((1, 2)), np.zeros(2), np.array([2.0]))
    >>> print(step, multipliers)
    [1. 1.] [-1.]
    """
    if isinstance(hessian, Hessian):
        if hessian.less is not None:
            return _with_less(hessian, matrix, force, limit)
        if hessian.rows is not None:
            return _with_squares(hessian, matrix, force, limit)
        hessian = hessian.plain
    if sp.issparse(hessian):
        return _factored(hessian, matrix, force, limit)
    return _eliminated(hessian, matrix, force, limit)


def _with_less(hessian: Hessian, matrix: Any, force: Array, limit: Array) -> tuple[Array, Array]:
    """Solve without G'G for ``force`` and for G' together, and combine the two."""
    less = np.asarray(hessian.less)
    n = 1 if np.ndim(force) == 1 else np.shape(force)[1]
    forces, limits = (np.reshape(v, (len(v), n)) for v in (force, limit))
    forces = np.concatenate([forces, less.T], axis=1)
    limits = np.concatenate([limits, np.zeros((len(limits), len(less)))], axis=1)
    step, multipliers = solve(replace(hessian, less=None), matrix, forces, limits)
    try:
        share = np.linalg.solve(np.eye(len(less)) - less @ step[:, n:], less @ step[:, :n])
    except np.linalg.LinAlgError as error:
        raise SolverError("the optimality conditions are singular") from error
    step, multipliers = (v[:, :n] + v[:, n:] @ share for v in (step, multipliers))
    return step.reshape(np.shape(force)), multipliers.reshape(np.shape(limit))


def _with_squares(hessian: Hessian, matrix: Any, force: Array, limit: Array) -> tuple[Array, Array]:
    """Take each square as a further unknown s: F x - s = 0, with s² / 2 in the objective."""
    rows, (n_squares, n) = hessian.rows, hessian.rows.shape
    norm = np.sqrt(1 + np.asarray((rows**2).sum(axis=1)).ravel())
    if not (sp.issparse(rows) or sp.issparse(matrix) or sp.issparse(hessian.plain)):
        every = np.zeros((len(matrix) + n_squares, n + n_squares))
        every[: len(matrix), :n] = matrix
        every[len(matrix) :, :n] = rows / norm[:, np.newaxis]
        every[len(matrix) :, n:] = -np.diag(1 / norm)
        return _of_squares(np.concatenate([hessian.plain, np.ones(n_squares)]), every, force, limit)
    inverse = sp.diags_array(1 / norm)
    above = sp.hstack([sp.csr_array(matrix), sp.csr_array((matrix.shape[0], n_squares))])
    every = sp.csr_array(sp.vstack([above, sp.hstack([inverse @ rows, -inverse])]))
    if every.shape[0] * every.shape[1] <= DENSE:
        every = every.toarray()
    if sp.issparse(hessian.plain):
        plain = sp.block_diag([hessian.plain, sp.eye_array(n_squares)], format="csr")
    else:
        plain = np.concatenate([hessian.plain, np.ones(n_squares)])
    return _of_squares(plain, every, force, limit)


def _of_squares(plain: Any, every: Any, force: Array, limit: Array) -> tuple[Array, Array]:
    """Solve with the squares among the unknowns, and leave them out of the answer."""
    n, n_rows = len(force), len(limit)
    nothing = np.zeros((plain.shape[0] - n, *np.shape(force)[1:]))
    step, multipliers = solve(
        plain, every, np.concatenate([force, nothing]), np.concatenate([limit, nothing])
    )
    return step[:n], multipliers[:n_rows]


def _eliminated(diagonal: Array, matrix: Any, force: Array, limit: Array) -> tuple[Array, Array]:
    """Eliminate x: A H⁻¹ A' y = A H⁻¹ f - c. Rows that share unknowns are solved together."""
    weighted = matrix / diagonal
    schur = weighted @ matrix.T
    schur = schur.toarray() if sp.issparse(schur) else schur
    diagonals = schur.diagonal()
    if np.count_nonzero(schur) == np.count_nonzero(diagonals):
        multipliers = ((weighted @ force - limit).T / diagonals).T
        return ((force - matrix.T @ multipliers).T / diagonal).T, multipliers
    step, multipliers = (force.T / diagonal).T, np.zeros_like(limit)
    n_groups, group = 1, np.zeros(len(schur), dtype=int)
    if np.count_nonzero(schur) < schur.size:
        n_groups, group = connected_components(sp.csr_array(schur), directed=False)
    for number in range(n_groups):
        rows = np.flatnonzero(group == number)
        lines = matrix[rows]
        lines = lines.toarray() if sp.issparse(lines) else lines
        columns = np.flatnonzero(lines.any(axis=0))
        lines = lines[:, columns]
        residual = limit[rows] - lines @ step[columns]
        change, multipliers[rows] = _nearest(lines, diagonal[columns], residual)
        step[columns] += change
    return step, multipliers


def _nearest(matrix: Array, diagonal: Array, residual: Array) -> tuple[Array, Array]:
    """Return the smallest x with A x = c, x'H x / 2, and its multipliers: H x + A'y = 0.

    The singular values are those of A H^(-1/2). Those of A H⁻¹ A' are their squares, in which nearly
    dependent rows are lost at half the digits.
    """
    root = np.sqrt(diagonal)
    orthogonal, triangle = np.linalg.qr((matrix / root).T)
    try:
        left, values, right = np.linalg.svd(triangle, full_matrices=False)
    except np.linalg.LinAlgError as error:
        raise SolverError("the optimality conditions are singular") from error
    used = values > _DEPENDENT * values[0]
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=used)
    along = (inverse * (right @ residual).T).T
    step = orthogonal @ (left @ along)
    return (step.T / root).T, -right.T @ (inverse * along.T).T


def _factored(hessian: Any, matrix: Any, force: Array, limit: Array) -> tuple[Array, Array]:
    """Factor the whole system, regularised, and refine the solution."""
    from scipy.sparse.linalg import splu

    n, matrix = hessian.shape[0], sp.csr_array(matrix)
    system = sp.csc_array(sp.block_array([[hessian, matrix.T], [matrix, None]]))
    shift = _SHIFT * np.concatenate([np.ones(n), -np.ones(matrix.shape[0])])
    try:
        factor = splu(sp.csc_array(system + sp.diags_array(shift)))
    except RuntimeError as error:
        raise SolverError("the optimality conditions are singular") from error
    right = np.concatenate([force, limit])
    solution = factor.solve(right)
    for _ in range(_REFINEMENTS):
        solution = solution + factor.solve(right - system @ solution)
    return solution[:n], solution[n:]
