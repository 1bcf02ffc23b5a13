"""The term that ties alpha to linear observations of it, such as what each position hears."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from rtcal.calibration.compiled_qp import Context
from rtcal.calibration.layout import Observed, Whitened
from rtcal.calibration.problem_data import ProblemData
from rtcal.calibration.terms.base import BaseTerm, half_squares
from rtcal.support.errors import ModelError
from rtcal.support.types import Array

__all__ = ["LinearObservations", "Observed"]
__dir__ = __all__.copy


@dataclass(frozen=True)
class LinearObservations(BaseTerm):
    """½ (y - J alpha)' C⁻¹ (y - J alpha): linear observations y of alpha; C is the errors' covariance.

    The numbers are an `Observed`, and are given to `rtcal.Calibration`'s problem when it is solved:
    ``problem.solve(measured, observed={term: Observed(...)})``. So the problem is compiled once,
    whatever the number of observations, and solved for each of them.

    When to use it: where measurements tell more of alpha than one T per band does. J and y come from
    a simulator's derivatives in `rtcal.calibrate_positions`; weight 1 is then the right one.

    Parameters
    ----------
    name : str
        Tells several of them apart.

    References
    ----------
    Aitken 1935, generalised least squares.
    """

    name: str = "observations"

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ModelError(f"LinearObservations: name = {self.name!r} is not a text")

    def expression(self, context: Context, weight: int) -> Any:
        """½ |w^½ (R alpha - z)|², R the upper triangle of the QR of the whitened J.

        R has as many rows as there are coefficients, however many observations there are. Those of
        its rows that lack observations are 0. What J alpha cannot reach of y is a constant.
        """
        n = context.layout.n_alpha
        rows, columns = np.triu_indices(n)

        def compute(data: ProblemData) -> tuple[Array, Array]:
            matrix, values = self._of(data).matrix, self._of(data).values
            triangle = np.linalg.qr(np.column_stack([matrix, values]), mode="r")
            full = np.zeros((n, n + 1))
            full[: min(len(triangle), n)] = triangle[:n]
            full *= np.sqrt(data.weights[weight])
            return full[rows, columns], -full[:, n]

        return half_squares(context.affine(rows, columns, n, compute).expression)

    def value(self, u: Array, data: ProblemData) -> float:
        """Return ½ (y - J alpha)' C⁻¹ (y - J alpha)."""
        return 0.5 * float(np.sum(self._residual(u, data) ** 2))

    def gradient(self, u: Array, data: ProblemData) -> Array:
        """Return J' C⁻¹ (J alpha - y)."""
        gradient = np.zeros_like(u)
        gradient[: data.layout.n_alpha] = self._of(data).matrix.T @ self._residual(u, data)
        return gradient

    def curvature(self, u: Array, data: ProblemData) -> Any:
        """Return J' C⁻¹ J: a matrix that couples materials and bands."""
        further = data.layout.size - data.layout.n_alpha
        return sp.csr_array(np.pad(self._of(data).information, (0, further)))

    def _residual(self, u: Array, data: ProblemData) -> Array:
        return np.asarray(self._of(data).matrix @ u[: data.layout.n_alpha] - self._of(data).values)

    def _of(self, data: ProblemData) -> Whitened:
        return data.observed[self]
