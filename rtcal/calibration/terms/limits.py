"""Terms that smooth alpha across bands, bound it, hold it, share it or put it in order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from rtcal.acoustics.room import Room
from rtcal.calibration.compiled_qp import Context
from rtcal.calibration.layout import Integers, Layout
from rtcal.calibration.problem_data import ProblemData
from rtcal.calibration.terms.base import BaseTerm, Rows, half_squares, limited, reciprocal
from rtcal.support import checks
from rtcal.support.errors import DataError, ModelError
from rtcal.support.types import Array


@dataclass(frozen=True)
class BandSmoothness(BaseTerm):
    """½ sum (x_k+1 - x_k)² / d_k, x = (alpha - mu) / sigma, d_k octaves from band k to k+1.

    When to use it: with `SoftMatch` or bands without T, when a material's error is expected to
    change slowly over frequency. It smooths the *shift* in sigmas, not alpha: a resonant absorber
    keeps its peak. With an exact match and separable sigma it changes nothing (see
    docs/modelling.md).
    """

    def expression(self, context: Context, weight: int) -> Any:
        """½ |w^½ differences|²; coefficients with sigma = 0 stand apart."""
        layout = context.layout
        if layout.n_bands < 2:
            raise ModelError("BandSmoothness needs two bands or more")
        left = self._left(layout)
        n_rows = len(left)
        rows = np.tile(np.arange(n_rows), 2)
        columns = np.concatenate([left, left + 1])

        def compute(data: ProblemData) -> tuple[Array, Array]:
            sigma = data.sigma
            both = (sigma[left] > 0) & (sigma[left + 1] > 0)
            steep = np.sqrt(data.weights[weight] / self._octaves(layout)) * both
            low, high = -steep * reciprocal(sigma[left]), steep * reciprocal(sigma[left + 1])
            constant = -(low * data.mu[left] + high * data.mu[left + 1])
            return np.concatenate([low, high]), constant

        return half_squares(context.affine(rows, columns, n_rows, compute).expression)

    def value(self, u: Array, data: ProblemData) -> float:
        """Return ½ sum (x_k+1 - x_k)² / d_k."""
        x = (u - data.mu) * data.inverse_sigma
        return 0.5 * float(np.sum((self._differences(data) @ x) ** 2))

    def gradient(self, u: Array, data: ProblemData) -> Array:
        """Return D'D x / sigma."""
        inverse = data.inverse_sigma.copy()
        differences = self._differences(data)
        x = (u - data.mu) * inverse
        return np.asarray(differences.T @ (differences @ x) * inverse)

    def curvature(self, u: Array, data: ProblemData) -> Any:
        """Return D'D over sigma sigma': a sparse matrix."""
        scaled = self._differences(data) @ sp.diags_array(data.inverse_sigma)
        return sp.csr_array(scaled.T @ scaled)

    def _differences(self, data: ProblemData) -> Any:
        """D over the whitened unknowns; a difference with a sigma of 0 is left out."""
        layout = data.layout
        n, k = layout.n_rows, layout.n_bands
        one = sp.diags_array([-1.0, 1.0], offsets=[0, 1], shape=(k - 1, k))
        over_all = sp.hstack(
            [sp.kron(sp.eye_array(n), one), sp.csr_array((n * (k - 1), layout.size - n * k))]
        )
        exact = np.asarray(data.alpha(data.sigma) == 0)
        both = ~(exact[:, 1:] | exact[:, :-1]).ravel()
        return sp.csr_array(sp.diags_array(both / np.sqrt(self._octaves(layout))) @ over_all)

    @staticmethod
    def _left(layout: Layout) -> Integers:
        places = np.arange(layout.n_alpha).reshape(layout.n_rows, layout.n_bands)
        return np.asarray(places[:, :-1].ravel())

    @staticmethod
    def _octaves(layout: Layout) -> Array:
        return np.tile(np.diff(np.log2(np.array(layout.centre_frequencies))), layout.n_rows)


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
        checks.number("Bounds: lower", self.lower)
        checks.number("Bounds: upper", self.upper)
        _named("Bounds", self.material, self.band)
        if not 0 <= self.lower <= self.upper <= 1:
            raise DataError(
                f"Bounds({self.lower:g}, {self.upper:g}) is not within 0 <= lower <= upper <= 1"
            )

    def box(self, room: Room, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return the box cut to these bounds."""
        where = _selection(room, self.material, self.band)
        lower, upper = lower.copy(), upper.copy()
        lower[where] = np.maximum(lower[where], self.lower)
        upper[where] = np.minimum(upper[where], self.upper)
        return lower, upper


@dataclass(frozen=True)
class Fixed:
    """alpha = value (its prior mean if not given): a coefficient that the measurement may not move.

    When to use it: for a material that was measured in the laboratory, or whose answer must stay
    comparable. Alpha is as with sigma = 0 in the room. Unlike there, its stated sigma still counts in z
    and Q, in correlations with other bands, and in the coefficients' uncertainty.

    Parameters
    ----------
    material : str
    value : float, optional
    band : float, optional
        Only this band, by its centre frequency in Hz.
    """

    material: str
    value: float | None = None
    band: float | None = None

    def __post_init__(self) -> None:
        _named("Fixed", self.material, self.band)
        if self.value is not None and not 0 <= checks.number("Fixed: value", self.value) <= 1:
            raise DataError(f'Fixed("{self.material}", {self.value:g}) is not in [0, 1]')

    def box(self, room: Room, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return the box with both sides at the value."""
        where = _selection(room, self.material, self.band)
        value = room.alpha[where] if self.value is None else self.value
        lower, upper = lower.copy(), upper.copy()
        lower[where] = np.maximum(lower[where], value)
        upper[where] = np.minimum(upper[where], value)
        return lower, upper


@dataclass(frozen=True)
class Shared:
    """The coefficients of several materials are the same unknowns: ``Shared("wall", "wall 2")``.

    When to use it: when one material goes by several names. Their rows become one, with the sum of
    their areas; their common prior counts once.
    """

    materials: tuple[str, ...]

    def __init__(self, *materials: str) -> None:
        for name in materials:
            _named("Shared", name)
        if len(set(materials)) < 2:
            raise ModelError("Shared needs two different materials or more")
        object.__setattr__(self, "materials", tuple(materials))

    def groups(self, materials: tuple[str, ...]) -> Iterable[tuple[str, ...]]:
        """Return the one group."""
        return [self.materials]


@dataclass(frozen=True)
class AtMost:
    """alpha of one material <= alpha of another: ``AtMost("glazing", "curtain")``.

    When to use it: when the order is certain though neither value is.

    Parameters
    ----------
    lesser, greater : str
        Materials.
    band : float, optional
        Only this band, by its centre frequency in Hz.
    """

    lesser: str
    greater: str
    band: float | None = None

    def __post_init__(self) -> None:
        _named("AtMost", self.lesser, self.band)
        _named("AtMost", self.greater)
        if self.lesser == self.greater:
            raise ModelError(f'AtMost: "{self.lesser}" stands on both sides')

    @property
    def sides(self) -> tuple[bool, bool]:
        """Only an upper limit."""
        return False, True

    def constraints(self, context: Context) -> list[tuple[Any, int]]:
        """One inequality per band."""
        lesser, greater = self._places(context.layout)
        n = len(lesser)
        return limited(
            context, np.tile(np.arange(n), 2), np.concatenate([lesser, greater]), n, self
        )

    def coefficients(self, data: ProblemData) -> Array:
        """Return 1 for the lesser, -1 for the greater."""
        n = len(self._places(data.layout)[0])
        return np.repeat([1.0, -1.0], n)

    def limits(self, data: ProblemData) -> tuple[Array, Array]:
        """Return no lower limit and 0."""
        n = len(self._places(data.layout)[0])
        return np.full(n, -np.inf), np.zeros(n)

    def row_scale(self, data: ProblemData) -> Array:
        """Return 1 / |sigma| of the two; 0 if neither can move."""
        lesser, greater = self._places(data.layout)
        return reciprocal(np.hypot(data.scale[lesser], data.scale[greater]))

    def rows(self, data: ProblemData) -> Rows:
        """The difference is at most 0."""
        lesser, greater = self._places(data.layout)
        matrix = np.zeros((len(lesser), data.layout.size))
        for row, (i, j) in enumerate(zip(lesser, greater, strict=True)):
            matrix[row, i] += 1
            matrix[row, j] -= 1
        return Rows(sp.csr_array(matrix), np.full(len(lesser), -np.inf), np.zeros(len(lesser)))

    def label(self, row: int, layout: Layout) -> str:
        """Return the order and its band."""
        lesser, greater = self._places(layout)
        return f"{layout.place(int(lesser[row]))} at most {layout.place(int(greater[row]))}"

    def _places(self, layout: Layout) -> tuple[Integers, Integers]:
        return layout.index(self.lesser, self.band), layout.index(self.greater, self.band)


@dataclass(frozen=True)
class GroupAbsorption:
    """least <= S'alpha over a group of materials <= most, in m².

    When to use it: when the total of a group is known better than its members, such as all seating
    from a table of audience absorption.

    Parameters
    ----------
    materials : sequence of str
    least, most : float, optional
        m²; at least one of them.
    band : float, optional
        Only this band, by its centre frequency in Hz.
    configuration : int
        Whose areas count.
    """

    materials: Sequence[str]
    least: float | None = None
    most: float | None = None
    band: float | None = None
    configuration: int = 0

    def __post_init__(self) -> None:
        if isinstance(self.materials, str) or not isinstance(self.materials, Iterable):
            raise ModelError(
                f"GroupAbsorption: materials = {self.materials!r} is not a list of names"
            )
        object.__setattr__(self, "materials", tuple(self.materials))
        for name in self.materials:
            _named("GroupAbsorption", name, self.band)
        given = [
            checks.number(f"GroupAbsorption: {name}", v, ModelError)
            for name, v in (("least", self.least), ("most", self.most))
            if v is not None
        ]
        checks.whole("GroupAbsorption: configuration", self.configuration, 0, ModelError)
        if not given or min(given) < 0 or given != sorted(given) or not np.isfinite(given).all():
            raise ModelError(
                f"GroupAbsorption: least = {self.least}, most = {self.most} m²; it needs "
                "0 <= least <= most, one of them at least"
            )
        if not self.materials:
            raise ModelError("GroupAbsorption needs a material")

    @property
    def sides(self) -> tuple[bool, bool]:
        """Which of ``least`` and ``most`` are stated."""
        return self.least is not None, self.most is not None

    def constraints(self, context: Context) -> list[tuple[Any, int]]:
        """One or two inequalities per band, or one equality if the two limits are the same."""
        rows, columns, n_rows = self._pattern(context.layout)
        if self.least != self.most:
            return limited(context, rows, columns, n_rows, self)

        def compute(data: ProblemData) -> tuple[Array, Array]:
            scale = self.row_scale(data)
            return self.coefficients(data) * scale[rows], -self.limits(data)[0] * scale

        return [(context.affine(rows, columns, n_rows, compute).expression == 0, 1)]

    def coefficients(self, data: ProblemData) -> Array:
        """Return the areas of the group's rows, each for every band."""
        _, columns, _ = self._pattern(data.layout)
        return np.asarray(self._areas(data)[columns // data.layout.n_bands])

    def limits(self, data: ProblemData) -> tuple[Array, Array]:
        """Return the limits in m², the same for every band."""
        _, _, n = self._pattern(data.layout)
        least = -np.inf if self.least is None else self.least
        most = np.inf if self.most is None else self.most
        return np.full(n, least), np.full(n, most)

    def row_scale(self, data: ProblemData) -> Array:
        """Return 1 / |S sigma| over the group; 0 if none of it can move."""
        rows, columns, n_rows = self._pattern(data.layout)
        moved = self.coefficients(data) * data.scale[columns]
        return reciprocal(np.sqrt(np.bincount(rows, weights=moved**2, minlength=n_rows)))

    def rows(self, data: ProblemData) -> Rows:
        """The group's absorption area, one row per band."""
        layout = data.layout
        areas = self._areas(data)
        columns = layout.index(None, self.band).reshape(layout.n_rows, -1)
        matrix = np.zeros((columns.shape[1], layout.size))
        for row in range(columns.shape[1]):
            matrix[row, columns[:, row]] = areas
        return Rows(sp.csr_array(matrix), *self.limits(data))

    def label(self, row: int, layout: Layout) -> str:
        """Return the group and the band."""
        places = self._pattern(layout)[1].reshape(-1, self._pattern(layout)[2])[0]
        band = layout.place(int(places[row])).rsplit(", ", 1)[1].rstrip("]")
        return f"absorption of {', '.join(self.materials)} at {band} (m²)"

    def _areas(self, data: ProblemData) -> Array:
        """The group's own areas by row of alpha."""
        layout = data.layout
        if not 0 <= self.configuration < layout.n_configurations:
            raise ModelError(
                f"GroupAbsorption(configuration={self.configuration}): there are "
                f"{layout.n_configurations}"
            )
        members = np.isin(np.arange(layout.n_rows), self._members(layout))
        return np.where(members, data.areas[self.configuration], 0.0)

    def _members(self, layout: Layout) -> list[int]:
        members = sorted({int(layout.index(m)[0]) // layout.n_bands for m in self.materials})
        for name, row in zip(layout.materials, layout.rows, strict=True):
            if row in members and name not in self.materials:
                raise ModelError(
                    f'GroupAbsorption: "{name}" shares its coefficients with a member; name it too'
                )
        return members

    def _pattern(self, layout: Layout) -> tuple[Integers, Integers, int]:
        members = self._members(layout)
        places = layout.index(None, self.band).reshape(layout.n_rows, -1)[members]
        n_rows = places.shape[1]
        return np.tile(np.arange(n_rows), len(members)), places.ravel(), n_rows


def _named(term: str, material: object, band: object = None) -> None:
    """Raise DataError if a material is no text or a band no frequency; None is all of them."""
    if material is not None and not isinstance(material, str):
        raise DataError(f"{term}: {material!r} is not the name of a material")
    if band is not None and not 0 < checks.number(f"{term}: band", band) < np.inf:
        raise DataError(f"{term}: band = {band} Hz is not finite and above 0")


def _selection(
    room: Room, material: str | None, band: float | None
) -> tuple[Integers | slice, Integers | slice]:
    """The index of a material (all if None) and a band (all if None) into alpha."""
    from rtcal.acoustics import bands

    rows: Integers | slice = slice(None)
    columns: Integers | slice = slice(None)
    if material is not None:
        rows = np.array([room.material_index(material)])
    if band is not None:
        place = bands.index(room.centre_frequencies, band)
        if place is None:
            has = ", ".join(bands.labels(room.centre_frequencies))
            raise DataError(f"band {bands.label(band)} is no band of the room; it has {has}")
        columns = np.array([place])
    return rows, columns
