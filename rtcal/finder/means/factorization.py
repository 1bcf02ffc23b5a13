"""Cholesky factors of many covariances: of whole matrices, or of blocks and a part of low rank."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from rtcal.support.types import Array


class Factorization:
    """The factors of n covariances C = B + U U', B with blocks on its diagonal.

    With L L' = B, W = L⁻¹ U and G G' = I + W' W, it is C⁻¹ = L⁻ᵀ (I - W (G G')⁻¹ W') L⁻¹ and
    |C| = |B| |G|² (Woodbury 1950). Without U the time grows with the cube of a block's rows; with U,
    with the rows of C times the square of U's columns.

    Parameters
    ----------
    blocks : sequence of arrays (n, m_c, m_c)
        They are overwritten.
    places : sequence of slices
        Rows of C that the blocks belong to.
    low_rank : array (n, r, m), optional
        U'.

    Attributes
    ----------
    half_log_determinant : array (n,)
        ln sqrt|C|.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is not positive definite.
    """

    def __init__(
        self,
        blocks: Sequence[Array],
        places: Sequence[slice],
        low_rank: Array | None = None,
    ) -> None:
        self._blocks, self._places = blocks, places
        self.half_log_determinant = np.zeros(len(blocks[0]))
        for block in blocks:
            self.half_log_determinant += _cholesky(block)
        self._whitened: Array | None = None
        if low_rank is not None:
            self._whitened = self._by_blocks(low_rank)
            self._inner = self._whitened @ self._whitened.swapaxes(1, 2)
            diagonal = np.arange(low_rank.shape[1])
            self._inner[:, diagonal, diagonal] += 1.0
            self.half_log_determinant += _cholesky(self._inner)

    @classmethod
    def whole(cls, covariance: Array) -> Factorization:
        """Return the factors of covariances (n, m, m), which are overwritten."""
        return cls([covariance], [slice(None)])

    def inner(self, rows: Array, first: int) -> tuple[Array, Array, Array]:
        """Return products x C⁻¹ y' of rows (n, d, m); ``rows`` may be overwritten.

        The squares of the ``first`` rows (n, first), their products with the others
        (n, first, d - first), and those of the others with one another.
        """
        whitened = self._by_blocks(rows)
        square, across, others = _products(whitened, first)
        if self._whitened is not None:
            along = np.ascontiguousarray(whitened @ self._whitened.swapaxes(1, 2))
            _solve(self._inner, along)
            less = _products(along, first)
            square, across, others = square - less[0], across - less[1], others - less[2]
        return square, across, others

    def _by_blocks(self, rows: Array) -> Array:
        """Return rows times L⁻ᵀ."""
        if len(self._blocks) == 1:
            rows = np.ascontiguousarray(rows)
            _solve(self._blocks[0], rows)
            return rows
        out = np.empty(rows.shape)
        for block, place in zip(self._blocks, self._places, strict=True):
            part = np.ascontiguousarray(rows[:, :, place])
            _solve(block, part)
            out[:, :, place] = part
        return out


def _products(rows: Array, first: int) -> tuple[Array, Array, Array]:
    z, w = rows[:, :first], rows[:, first:]
    turned = w.swapaxes(1, 2)
    return np.einsum("ndm,ndm->nd", z, z), z @ turned, w @ turned


def _cholesky(matrices: Array) -> Array:
    """Replace the lower triangles of (n, m, m) by their Cholesky factors; return ln sqrt|C|, (n,).

    LAPACK sees the transpose of a matrix in C order, so its upper factor is the lower one.
    """
    for i, matrix in enumerate(matrices):
        _, info = dpotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
        if info:
            raise np.linalg.LinAlgError(f"covariance {i} is not positive definite")
    return np.asarray(np.log(np.diagonal(matrices, axis1=1, axis2=2)).sum(1))


def _solve(factors: Array, rows: Array) -> None:
    """Replace rows (n, d, m), in C order, by rows times L⁻ᵀ; L (n, m, m) as `_cholesky` leaves it."""
    if rows.size:
        for matrix, right in zip(factors, rows, strict=True):
            dtrtrs(matrix.T, right.T, lower=0, trans=1, overwrite_b=1)
