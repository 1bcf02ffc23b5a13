"""The unknowns of a compiled problem, their order, and linear observations of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from rtcal.acoustics import bands
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only

Integers = NDArray[np.intp]


@dataclass(frozen=True, repr=False)
class Layout:
    """The unknowns: one flat vector, alpha row by row with the bands last, then further ones.

    Attributes
    ----------
    materials : tuple of str
        All materials.
    rows : tuple of int
        For each material its row of unknowns; materials that share a coefficient have one row.
    centre_frequencies : tuple of float
        Hz.
    n_configurations : int
    further : tuple of str
        Names of the unknowns beside alpha (sizes of effects).
    """

    materials: tuple[str, ...]
    rows: tuple[int, ...]
    centre_frequencies: tuple[float, ...]
    n_configurations: int = 1
    further: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return (
            f"<Layout: {self.n_rows} rows of coefficients, {self.n_bands} bands, "
            f"{len(self.further)} further unknowns, {self.n_configurations} configurations>"
        )

    @cached_property
    def n_rows(self) -> int:
        """Number of unknown rows of alpha."""
        return max(self.rows) + 1

    @property
    def n_bands(self) -> int:
        """Number of bands."""
        return len(self.centre_frequencies)

    @cached_property
    def n_alpha(self) -> int:
        """Number of unknowns that are absorption coefficients."""
        return self.n_rows * self.n_bands

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.n_alpha + len(self.further)

    @cached_property
    def first(self) -> Integers:
        """Index of the first material of each row, (n_rows,)."""
        return np.array([self.rows.index(row) for row in range(self.n_rows)])

    def by_band(self, values: Array, reduce: Callable[..., Any]) -> Array:
        """Reduce over the rows of alpha, (n_bands,); a further unknown counts in every band."""
        alpha = values[: self.n_alpha].reshape(self.n_rows, self.n_bands)
        if self.further:
            further = np.repeat(values[self.n_alpha :, np.newaxis], self.n_bands, axis=1)
            alpha = np.concatenate([alpha, further])
        return np.asarray(reduce(alpha, axis=0))

    def index(self, material: str | None = None, band: float | None = None) -> Integers:
        """Return the indices of the coefficients of one material in one band; None stands for all.

        Raises DataError for a material or a band that the layout lacks.
        """
        rows, columns = np.arange(self.n_rows), np.arange(self.n_bands)
        if material is not None:
            if material not in self.materials:
                raise DataError(
                    f'"{material}" is no material of the room; it has {", ".join(self.materials)}'
                )
            rows = np.array([self.rows[self.materials.index(material)]])
        if band is not None:
            place = bands.index(np.array(self.centre_frequencies), band)
            if place is None:
                has = ", ".join(bands.labels(self.centre_frequencies))
                raise DataError(f"band {bands.label(band)} is no band of the room; it has {has}")
            columns = np.array([place])
        return np.asarray((rows[:, np.newaxis] * self.n_bands + columns).ravel())

    def place(self, unknown: int) -> str:
        """Return the name of an unknown in messages: ``alpha["carpet", 500 Hz]``."""
        if unknown >= self.n_alpha:
            return f'size of "{self.further[unknown - self.n_alpha]}"'
        row, band = divmod(int(unknown), self.n_bands)
        names = " = ".join(m for m, r in zip(self.materials, self.rows, strict=True) if r == row)
        return f'alpha["{names}", {bands.label(self.centre_frequencies[band])}]'

    def band_label(self, row: int) -> str:
        """Return the name of a matched row: its band, and its configuration if there are several."""
        configuration, band = divmod(int(row), self.n_bands)
        label = bands.label(self.centre_frequencies[band])
        return (
            label if self.n_configurations == 1 else f"{label}, configuration {configuration + 1}"
        )

    def expand(self, values: Array) -> Array:
        """Return flat values of the unknowns as (n_materials, n_bands)."""
        return np.asarray(values[: self.n_alpha].reshape(self.n_rows, -1)[list(self.rows)])


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
