"""Linear observations of alpha: the numbers of `rtcal.terms.LinearObservations`."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from rtcal.calibration.layout import Layout
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Observed:
    """Numbers of a `LinearObservations`: values = matrix @ alpha and an error of zero mean.

    Parameters
    ----------
    matrix : array (n_observations, n_materials * n_bands)
        Alpha row by row, the bands last. Materials that share a coefficient have their own columns.
    values : array (n_observations,)
    covariance : array (n_observations, n_observations)
        Of the errors; positive definite.

    Raises
    ------
    DataError
        For shapes that do not fit, a number that is not finite, or a covariance that is none.
    """

    matrix: Array
    values: Array
    covariance: Array
    factor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("matrix", "values", "covariance"):
            array = read_only(checks.array(f"observed {name}", getattr(self, name)))
            if not np.isfinite(array).all():
                raise DataError(f"observed {name} has a number that is not finite")
            object.__setattr__(self, name, array)
        n = self.values.size
        for name, shape in (("values", (n,)), ("covariance", (n, n))):
            if getattr(self, name).shape != shape:
                raise DataError(
                    f"observed {name} has shape {getattr(self, name).shape}, not {shape}"
                )
        if n == 0 or self.matrix.ndim != 2 or len(self.matrix) != n:
            raise DataError(
                f"observed matrix has shape {self.matrix.shape}; it has a row for each of the {n} "
                "values, of which there is at least one"
            )
        # Beside the diagonal: a covariance near 0 may be the rounding of a difference.
        sigma = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        if (np.abs(self.covariance - self.covariance.T) > 1e-9 * np.outer(sigma, sigma)).any():
            raise DataError("observed covariance is not symmetric")
        try:
            factor = np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError as error:
            raise DataError("observed covariance is not positive definite") from error
        object.__setattr__(self, "factor", read_only(factor))

    def __repr__(self) -> str:
        return f"<Observed: {self.values.size} observations of {self.matrix.shape[1]} coefficients>"

    def over(self, layout: Layout) -> Whitened:
        """Return the numbers over the unknowns of a problem, those of shared materials added up.

        Raises DataError if the matrix has columns of other materials or bands.
        """
        n = len(layout.materials) * layout.n_bands
        if self.matrix.shape[1] != n:
            raise DataError(
                f"observed matrix has {self.matrix.shape[1]} columns; {len(layout.materials)} "
                f"materials in {layout.n_bands} bands have {n}"
            )
        by_material = self.matrix.reshape(len(self.matrix), -1, layout.n_bands)
        summed = np.zeros((len(self.matrix), layout.n_rows, layout.n_bands))
        for material, row in enumerate(layout.rows):
            summed[:, row] += by_material[:, material]
        both = np.column_stack([summed.reshape(len(self.matrix), -1), self.values])
        white = solve_triangular(self.factor, both, lower=True)
        return Whitened(white[:, :-1], white[:, -1])


@dataclass(frozen=True, eq=False)
class Whitened:
    """Matrix over the unknowns, and values, in units in which the errors are independent."""

    matrix: Array
    values: Array

    @cached_property
    def information(self) -> Array:
        """J' C⁻¹ J, (n_alpha, n_alpha)."""
        return np.asarray(self.matrix.T @ self.matrix)
