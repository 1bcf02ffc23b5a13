"""The second derivative of an objective, with sums of squares kept as their rows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

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
