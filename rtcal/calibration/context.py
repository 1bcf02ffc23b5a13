"""The interface through which terms build cvxpy expressions.

Its derived parameters keep the problem DPP (disciplined parametrized programming).

In the whitened unknowns x (u = centre + scale x) a coefficient such as area times sigma would be a
product of two parameters, which is not DPP. A term therefore states how its coefficients of alpha
follow from a `ProblemData`, and the context computes the coefficients of x and the constant outside
cvxpy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from rtcal.calibration.layout import Integers, Layout
from rtcal.calibration.problem_data import ProblemData
from rtcal.support.types import Array

_BLOCK = 256
"""Number of factors compiled together: 2 MB of memory, and few enough blocks to compile quickly."""

Coefficients = Callable[[ProblemData], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Factors:
    """Parameters that multiply a cvxpy vector elementwise, and the product.

    cvxpy compiles a product of n factors with memory for n² numbers, so long vectors are cut.
    """

    blocks: list[Any]
    product: Any

    @classmethod
    def of(cls, vector: Any) -> Factors:
        """Return the factors of a vector (n,)."""
        starts = range(0, vector.size, _BLOCK)
        if len(starts) == 1:
            blocks = [cp.Parameter(vector.size)]
            return cls(blocks, cp.multiply(blocks[0], vector))
        parts = [vector[start : start + _BLOCK] for start in starts]
        blocks = [cp.Parameter(part.size) for part in parts]
        products = [cp.multiply(*pair) for pair in zip(blocks, parts, strict=True)]
        return cls(blocks, cp.hstack(products))

    def fill(self, values: Array) -> None:
        """Set the factors, (n,)."""
        for i, block in enumerate(self.blocks):
            # save_value: the setter's checks of shape and kind cost more than the numbers.
            block.save_value(values[i * _BLOCK : (i + 1) * _BLOCK])


@dataclass(frozen=True, eq=False)
class Affine:
    """Rows that are affine in the unknowns: the cvxpy expression (n_rows,) and how to refresh it."""

    expression: Any
    rows: Integers
    columns: Integers
    n_rows: int
    compute: Coefficients
    coefficients: Factors
    constant: Any

    def update(self, data: ProblemData) -> None:
        """Set the derived parameters for ``data``."""
        values, constant = self.compute(data)
        self.coefficients.fill(values * data.scale[self.columns])
        moved = values * data.centre[self.columns]
        self.constant.save_value(constant + np.bincount(self.rows, moved, minlength=self.n_rows))


class Context:
    """The unknowns of a problem under construction, and its derived parameters."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.x = cp.Variable(layout.size, name="x")
        self._affine: list[Affine] = []
        self._factors: list[tuple[Factors, Callable[[ProblemData], Array]]] = []
        self._parameters: list[tuple[Any, Callable[[ProblemData], Array]]] = []

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.layout.size

    def variable(self, size: int) -> Any:
        """Return helper variables for a term's expression, such as positive and negative parts."""
        return cp.Variable(size)

    def affine(
        self, rows: Integers, columns: Integers, n_rows: int, compute: Coefficients
    ) -> Affine:
        """Return rows that are affine in the unknowns.

        Parameters
        ----------
        rows, columns : array (n_entries,)
            Positions of the coefficients, fixed when the problem is built.
        n_rows : int
        compute : function of ProblemData
            Returns the coefficients of the unknowns (n_entries,) and the constants (n_rows,).
        """
        constant = cp.Parameter(n_rows)
        picked = self.x
        if not np.array_equal(columns, np.arange(self.size)):
            entries = np.arange(len(columns))
            ones = np.ones(len(columns))
            picked = sp.csr_array((ones, (entries, columns)), (len(columns), self.size)) @ self.x
        factors = Factors.of(picked)
        terms = factors.product
        if not np.array_equal(rows, np.arange(n_rows)):
            entries = np.arange(len(rows))
            terms = sp.csr_array((np.ones(len(rows)), (rows, entries)), (n_rows, len(rows))) @ terms
        affine = Affine(
            terms + constant,
            np.asarray(rows),
            np.asarray(columns),
            n_rows,
            compute,
            factors,
            constant,
        )
        self._affine.append(affine)
        return affine

    def multiply(self, vector: Any, compute: Callable[[ProblemData], Array]) -> Any:
        """Return a cvxpy vector times ``compute(data)``, elementwise."""
        factors = Factors.of(vector)
        self._factors.append((factors, compute))
        return factors.product

    def parameter(
        self,
        shape: int | tuple[int, ...],
        compute: Callable[[ProblemData], Array],
        **attributes: bool,
    ) -> Any:
        """Return a cvxpy parameter with the value ``compute(data)``."""
        parameter = cp.Parameter(shape, **attributes)
        self._parameters.append((parameter, compute))
        return parameter

    def match_pattern(self) -> tuple[Integers, Integers, int]:
        """Return rows, columns and number of rows of S'alpha, one row per configuration and band.

        The coefficients come in the order (configuration, row of alpha, band), then
        (configuration, further unknown, band).
        """
        layout = self.layout
        c, n, k, p = layout.n_configurations, layout.n_rows, layout.n_bands, len(layout.further)
        configuration, unknown, band = np.meshgrid(
            np.arange(c), np.arange(n), np.arange(k), indexing="ij"
        )
        rows, columns = configuration * k + band, unknown * k + band
        configuration, unknown, band = np.meshgrid(
            np.arange(c), np.arange(p), np.arange(k), indexing="ij"
        )
        more_rows, more_columns = configuration * k + band, layout.n_alpha + unknown
        return (
            np.concatenate([rows.ravel(), more_rows.ravel()]),
            np.concatenate([columns.ravel(), more_columns.ravel()]),
            c * k,
        )

    def update(self, data: ProblemData) -> None:
        """Set every derived parameter for ``data``."""
        for affine in self._affine:
            affine.update(data)
        for factors, compute in self._factors:
            factors.fill(compute(data))
        for parameter, compute in self._parameters:
            parameter.save_value(compute(data))
