"""The unknowns of a calibration: the rooms that share them, their order, and the numbers of a solve.

The unknowns u are one flat vector: alpha row by row with the bands last, then the sizes of effects. One
room is one of several configurations, which share the coefficients of their materials.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from rtcal.acoustics import bands
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import target_changes
from rtcal.prediction.changed_time import refuse_other_priors
from rtcal.support import checks, deferred
from rtcal.support.errors import DataError
from rtcal.support.text import shortened
from rtcal.support.types import Array, put, read_only

Integers = NDArray[np.intp]
Flags = NDArray[np.bool_]

if TYPE_CHECKING:
    import cvxpy

    cp = cvxpy
else:

    class _Cvxpy:
        """Stand-in for the module cvxpy, which imports it when one of its names is first used."""

        def __getattr__(self, name: str) -> Any:
            if "cvxpy" not in sys.modules:
                # cvxpy 1.9 takes 0.4 of its time for scipy.stats, which only the entropy of quantum
                # states needs.
                with deferred("scipy.stats", "entropy"):
                    import_module("cvxpy")
            return getattr(import_module("cvxpy"), name)

    cp = _Cvxpy()


@dataclass(frozen=True, eq=False)
class Configurations:
    """Several measured configurations of one room, which share their materials' coefficients.

    Parameters
    ----------
    rooms : sequence of Room
        Room of each configuration, with its volume, air and areas. A material must have the same alpha
        and sigma in all rooms, because it has one coefficient per band.
    names : sequence of str, optional
        Names of the configurations; the rooms' names by default.

    Raises
    ------
    DataError
        If the bands differ, or a material has different coefficients or sigmas.

    Examples
    --------
    >>> import numpy as np
    >>> room = Room(name="bare", volume=60, materials=["wall", "floor"], areas=[74, 20],
    ...             alpha=[[0.1], [0.3]], sigma=[[0.02], [0.1]], centre_frequencies=[1000])
    >>> covered = Room(name="mat on floor", volume=60, materials=["wall", "mat"], areas=[74, 20],
    ...             alpha=[[0.1], [0.6]], sigma=[[0.02], [0.01]], centre_frequencies=[1000])
    >>> Configurations([room, covered]).areas.tolist()
    [[74.0, 20.0, 0.0], [74.0, 0.0, 20.0]]
    """

    rooms: Sequence[Room]
    names: Sequence[str] = ()

    def __repr__(self) -> str:
        materials = {material for room in self.rooms for material in room.materials}
        return (
            f"<Configurations: {shortened(', '.join(self.names))}, {len(materials)} materials, "
            f"{bands.span(self.rooms[0].centre_frequencies)}>"
        )

    def __post_init__(self) -> None:
        rooms = checks.listed("rooms", self.rooms)
        if not rooms:
            raise DataError("rooms is empty; give at least one configuration")
        for i, room in enumerate(rooms):
            if not isinstance(room, Room):
                raise DataError(f"rooms[{i}] = {room!r} must be an rtcal.Room")
        stated = tuple(str(n) for n in checks.listed("names", self.names))
        names = stated or tuple(r.name for r in rooms)
        if len(names) != len(rooms):
            raise DataError(
                f"{len(names)} names are given for {len(rooms)} configurations; give one for each"
            )
        if len(set(stated)) < len(stated):
            raise DataError(
                f"names = {names} has a name twice; give each configuration a name of its own"
            )
        put(self, rooms=rooms, names=names)
        if len(rooms) > 1:
            refuse_other_priors(rooms, [f'configuration "{name}"' for name in names])
            self._compare_priors()

    def _compare_priors(self) -> None:
        pairs = self._pairs()
        for name, room in zip(self.names, self.rooms, strict=True):
            if room.band_correlation != self.rooms[0].band_correlation:
                raise DataError(
                    f'configuration "{name}": band_correlation = {room.band_correlation:g}, but '
                    f'configuration "{self.names[0]}" has {self.rooms[0].band_correlation:g}; '
                    "they must be equal"
                )
            for key in ("volume_sigma", "common_area_sigma", "common_alpha_sigma"):
                stated, other = getattr(room, key), getattr(self.rooms[0], key)
                if stated != other:
                    raise DataError(
                        f'configuration "{name}": {key} = {stated:g}, but configuration '
                        f'"{self.names[0]}" has {other:g}; they must be equal, because it is the '
                        "same room"
                    )
            for (a, b), value in pairs.items():
                stated = room.material_correlation.get(
                    (a, b), room.material_correlation.get((b, a), 0.0)
                )
                if a in room.materials and b in room.materials and stated != value:
                    raise DataError(
                        f'configuration "{name}": material_correlation["{a}", "{b}"] = '
                        f"{stated:g}, but another configuration has {value:g}; they must be equal"
                    )

    def _pairs(self) -> dict[tuple[str, str], float]:
        """The correlations of two materials, from all configurations."""
        pairs: dict[tuple[str, str], float] = {}
        for room in self.rooms:
            for (a, b), value in room.material_correlation.items():
                pairs.setdefault((b, a) if (b, a) in pairs else (a, b), value)
        return pairs

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of all materials of all configurations, in order of appearance."""
        return tuple(dict.fromkeys(m for room in self.rooms for m in room.materials))

    @cached_property
    def areas(self) -> Array:
        """Areas in m², (n_configurations, n_materials); 0 where a configuration lacks a material."""
        if len(self.rooms) == 1:
            return self.rooms[0].areas[np.newaxis]
        materials = self.materials
        areas = np.zeros((len(self.rooms), len(materials)))
        for c, room in enumerate(self.rooms):
            areas[c, [materials.index(m) for m in room.materials]] = room.areas
        return areas

    def target_changes(self, equation: LinearEquation, times: Array) -> Array:
        """Return the changes of b - S'alpha in m² by one standard deviation of each error of the rooms.

        b is the absorption area that T needs, and S'alpha is that of the input coefficients. The shape
        is (n_errors, n_configurations * n_bands), 0 errors if all rooms are exact. The errors are those
        of volume, all areas together, the area of each material, and temperature and humidity of each
        configuration. ``times`` (n_configurations, n_bands) are the measured T in s.

        ``equation`` is the reverberation equation.
        """
        checks.instance("equation", equation, LinearEquation)
        times = checks.array("times", times)
        if times.shape != (shape := (len(self.rooms), self.rooms[0].alpha.shape[1])):
            raise DataError(
                f"times has shape {times.shape}; it must be (n_configurations, n_bands) = {shape}"
            )
        if not any(room.is_uncertain for room in self.rooms):
            return np.zeros((0, times.size))
        n, (c, k) = len(self.materials), times.shape
        changes = np.zeros((2 + n + 2 * c, c, k))
        for i, (room, t) in enumerate(zip(self.rooms, times, strict=True)):
            of_room = target_changes(equation, room, t)
            changes[:2, i] = of_room[:2]
            changes[[2 + self.materials.index(m) for m in room.materials], i] = of_room[2:-2]
            changes[2 + n + 2 * i : 4 + n + 2 * i, i] = of_room[-2:]
        return changes.reshape(len(changes), c * k)

    @cached_property
    def union(self) -> Room:
        """Room with every material once: its coefficients, largest area and that area's error."""
        if len(self.rooms) == 1:
            return self.rooms[0]
        first = self.rooms[0]

        def of_rooms(name: str) -> list[list[Array]]:
            """Return the rows of a table that the rooms with each material have."""
            return [
                [getattr(r, name)[r.materials.index(m)] for r in self.rooms if m in r.materials]
                for m in self.materials
            ]

        return Room(
            name=first.name,
            volume=first.volume,
            materials=self.materials,
            areas=self.areas.max(axis=0),
            alpha=np.array([rows[0] for rows in of_rooms("alpha")]),
            sigma=np.array([rows[0] for rows in of_rooms("sigma")]),
            centre_frequencies=first.centre_frequencies,
            air=next((r.air for r in self.rooms if r.air is not None), None),
            alpha_min=np.array([np.max(rows, axis=0) for rows in of_rooms("least_alpha")]),
            pieces=tuple({name: None for r in self.rooms for name in r.pieces}),
            band_correlation=first.band_correlation,
            material_correlation=self._pairs(),
            volume_sigma=first.volume_sigma,
            area_sigma=np.array([max(rows) for rows in of_rooms("area_sigma")]),
            common_area_sigma=first.common_area_sigma,
            common_alpha_sigma=first.common_alpha_sigma,
            climate_sigma=tuple(np.max([r.climate_sigma for r in self.rooms], axis=0).tolist()),
        )


@dataclass(frozen=True, repr=False)
class Layout:
    """Order of a calibration's unknowns in one vector (size,): coefficients, then sizes of effects.

    The coefficients are in the order of the materials, those of one material in the order of the bands.
    An effect is an `rtcal.terms.AddedAbsorption`. ``alpha_rows`` has one number per material, from 0,
    which is the same for materials that share their coefficients. ``further`` are names of effects.
    """

    materials: tuple[str, ...]  # all of them
    alpha_rows: tuple[
        int, ...
    ]  # each material's row of unknowns; those that share a coefficient have one
    centre_frequencies: tuple[float, ...]  # Hz
    n_configurations: int = 1
    further: tuple[str, ...] = ()  # names of the unknowns beside alpha (sizes of effects)

    def __repr__(self) -> str:
        return (
            f"<Layout: {self.n_alpha_rows} rows of coefficients, {self.n_bands} bands, "
            f"{len(self.further)} further unknowns, {self.n_configurations} configurations>"
        )

    @cached_property
    def n_alpha_rows(self) -> int:
        """Number of materials with different coefficients."""
        return max(self.alpha_rows) + 1

    @property
    def n_bands(self) -> int:
        """Number of bands."""
        return len(self.centre_frequencies)

    @cached_property
    def n_alpha(self) -> int:
        """Number of unknowns that are absorption coefficients."""
        return self.n_alpha_rows * self.n_bands

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.n_alpha + len(self.further)

    @cached_property
    def first(self) -> Integers:
        """Index of the first material of each row of coefficients, (n_alpha_rows,)."""
        return np.array([self.alpha_rows.index(row) for row in range(self.n_alpha_rows)])

    def index(self, material: str | None = None, band: float | None = None) -> Integers:
        """Return the indices, among the unknowns, of the coefficients of one material in one band.

        ``material`` is a name, and None for all materials. ``band`` is a centre frequency in Hz, and
        None for all bands. Raises DataError for an unknown material or band.
        """
        rows, columns = np.arange(self.n_alpha_rows), np.arange(self.n_bands)
        if material is not None:
            if checks.text("material", material) not in self.materials:
                raise DataError(
                    f'"{material}" is not a material of the room, which has {", ".join(self.materials)}'
                )
            rows = np.array([self.alpha_rows[self.materials.index(material)]])
        if band is not None:
            frequency = checks.number("band", band)
            place = (
                bands.index(np.array(self.centre_frequencies), frequency) if frequency > 0 else None
            )
            if place is None:
                has = ", ".join(bands.labels(self.centre_frequencies))
                raise DataError(
                    f"band = {frequency:g} Hz is not the centre frequency of a band of the room, which "
                    f"has {has}"
                )
            columns = np.array([place])
        return np.asarray((rows[:, np.newaxis] * self.n_bands + columns).ravel())

    def sharing(self, group: Iterable[str]) -> Layout:
        """Return the layout in which the materials ``group`` share their coefficients.

        Materials that already shared theirs with one of the group share them with all of it.
        """
        merged = {int(self.index(name)[0]) // self.n_bands for name in group}
        heads = [min(merged) if row in merged else row for row in self.alpha_rows]
        order = list(dict.fromkeys(heads))
        return replace(self, alpha_rows=tuple(order.index(head) for head in heads))

    def place(self, unknown: int) -> str:
        """Return the name of an unknown in messages, such as ``alpha["carpet", 500 Hz]``."""
        if unknown >= self.n_alpha:
            return f'size of "{self.further[unknown - self.n_alpha]}"'
        row, band = divmod(int(unknown), self.n_bands)
        names = " = ".join(
            m for m, r in zip(self.materials, self.alpha_rows, strict=True) if r == row
        )
        return f'alpha["{names}", {bands.label(self.centre_frequencies[band])}]'

    def band_label(self, row: int) -> str:
        """Return the name of a band for messages, with its configuration if there are several.

        ``row`` is the number of the band, from 0, counted over all bands of all configurations.
        """
        configuration, band = divmod(int(row), self.n_bands)
        label = bands.label(self.centre_frequencies[band])
        return (
            label if self.n_configurations == 1 else f"{label}, configuration {configuration + 1}"
        )

    def expand(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the part of ``values`` that belongs to coefficients, (n_materials, n_bands, ...).

        ``values`` (size, ...) has one row per unknown. Materials that share their coefficients get the
        same values.
        """
        by_row = values[: self.n_alpha].reshape(-1, self.n_bands, *values.shape[1:])
        return np.asarray(by_row[list(self.alpha_rows)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Observed:
    """Values of a `LinearObservations` term: values = matrix @ alpha + errors of zero mean.

    Parameters
    ----------
    matrix : array (n_observations, n_materials * n_bands)
        Derivatives of the values by alpha. The columns are ordered as ``alpha.ravel()``: all bands of
        the first material, then those of the second. Materials that share a coefficient have separate
        columns.
    values : array (n_observations,)
        Observed values.
    covariance : array (n_observations, n_observations)
        Covariance of the errors; positive definite.

    Raises
    ------
    DataError
        For shapes that do not fit, a number that is not finite, or a matrix that is no covariance.
    """

    matrix: Array
    values: Array
    covariance: Array
    factor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n = checks.array("observed values", self.values).size
        if n == 0:
            raise DataError("observed values is empty; give at least one")
        for name, shape in (("values", (n,)), ("covariance", (n, n)), ("matrix", (n, "any"))):
            array = checks.shaped(f"observed {name}", getattr(self, name), *shape)
            if not np.isfinite(array).all():
                raise DataError(f"observed {name} has a number that is not finite")
            put(self, **{name: array})
        # Beside the diagonal: a covariance near 0 may be the rounding of a difference.
        sigma = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        if (np.abs(self.covariance - self.covariance.T) > 1e-9 * np.outer(sigma, sigma)).any():
            raise DataError("observed covariance is not symmetric")
        try:
            factor = np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError as error:
            raise DataError("observed covariance is not positive definite") from error
        put(self, factor=read_only(factor))

    def __repr__(self) -> str:
        return f"<Observed: {self.values.size} observations of {self.matrix.shape[1]} coefficients>"

    def over(self, layout: Layout, mu: Array, sigma: Array) -> Array:
        """Return the observations as R and z of the term ½ |R x - z|² that is minimised.

        x are the deviations of the coefficients from their input ``mu`` (n_alpha,), in units of
        ``sigma`` (n_alpha,). The returned array is (n_alpha, n_alpha + 1): the upper triangular matrix
        R of a QR decomposition, and z as its last column. Derivatives by materials that share their
        coefficients are added up. ``layout`` has the order of the coefficients; raises DataError if
        ``matrix`` has not one column for each of its materials and bands.
        """
        n, k = len(layout.materials) * layout.n_bands, layout.n_bands
        if self.matrix.shape[1] != n:
            raise DataError(
                f"observed matrix has {self.matrix.shape[1]} columns; {len(layout.materials)} "
                f"materials in {layout.n_bands} bands need {n}"
            )
        summed = np.zeros((len(self.matrix), layout.n_alpha_rows, k))
        for material, row in enumerate(layout.alpha_rows):
            summed[:, row] += self.matrix[:, material * k : (material + 1) * k]
        seen = summed.reshape(len(self.matrix), -1)
        white = solve_triangular(self.factor, np.column_stack([seen, self.values]), lower=True)
        seen, values = white[:, :-1], white[:, -1]
        factor = np.linalg.qr(np.column_stack([seen * sigma, values - seen @ mu]), mode="r")
        full = np.zeros((layout.n_alpha, layout.n_alpha + 1))
        full[: min(len(factor), len(full))] = factor[: len(full)]
        return full


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Numbers:
    """Values of room and measurement for one solve of a calibration, in the order of its unknowns.

    Input values ``mu``, standard deviations ``sigma`` and the bounds ``lower`` and ``upper`` of the
    unknowns are (size,), in the order of ``layout``. ``time`` is the measured T in s and ``target`` the
    absorption area b in m² that T needs, with its standard uncertainty in m² and its sensitivity
    |db/dT| in m²/s. All four are (n_configurations, n_bands), NaN where T is missing.

    ``areas`` (n_configurations, n_alpha_rows) are in m², 0 where a configuration lacks the material.
    ``gains`` (n_configurations, n_bands, n_further) are the m² that one unit of each effect adds.
    ``target_uncertainty`` and ``target_sensitivity`` are that uncertainty and that sensitivity; the
    latter is infinite where T does not determine b. ``equation`` turned T into b. ``rooms`` has one
    room per configuration. ``observed`` has the values of `LinearObservations` terms. ``room_changes``
    (n_changes, n_times) are the changes of b in m² by one standard deviation of each error of the
    rooms. ``common`` is the relative standard deviation that all coefficients have in common.
    """

    layout: Layout
    mu: Array
    sigma: Array
    lower: Array
    upper: Array
    areas: Array  # (n_configurations, n_alpha_rows), m²; 0 if a configuration lacks the material
    gains: Array  # (n_configurations, n_bands, n_further), m² that one unit of each effect adds
    time: Array  # measured T in s
    target: Array  # b in m²
    target_uncertainty: Array  # its standard uncertainty in m²
    target_sensitivity: (
        Array  # |db/dT| in m²/s, infinite where T does not determine b (Kuttruff's peak)
    )
    equation: LinearEquation  # it turned T into b
    rooms: tuple[Room, ...]  # one per configuration
    observed: Mapping[object, Array] = field(default_factory=dict)  # as `Observed.over`, by term
    # `rtcal.acoustics.room_errors.target_changes` of all configurations in m², (n_changes, n_times).
    room_changes: Array = field(default_factory=lambda: np.zeros((0, 0)))
    common: float = 0.0  # relative standard deviation that all coefficients have in common

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray) and value.flags.writeable:
                vars(self)[name] = view = value.view()
                view.flags.writeable = False

    def __repr__(self) -> str:
        return f"<Numbers: {self.layout!r}>"

    @cached_property
    def matched(self) -> Flags:
        """Whether a band has a T to match, (n_configurations, n_bands)."""
        return np.isfinite(self.target)

    @cached_property
    def movable(self) -> Flags:
        """Whether the calibration may change each unknown, (size,)."""
        return (self.sigma > 0) & (self.lower < self.upper)

    @cached_property
    def inverse_sigma(self) -> Array:
        """Inverse standard deviation of each unknown, 0 where sigma = 0, (size,)."""
        return np.divide(1.0, self.sigma, out=np.zeros_like(self.sigma), where=self.sigma > 0)

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the unknowns, (size,) each; both are mu where sigma = 0."""
        exact = self.sigma == 0
        return np.where(exact, self.mu, self.lower), np.where(exact, self.mu, self.upper)

    @property
    def largest_target(self) -> Array:
        """Largest absorption area in m² that the equation can give for a T, (n_configurations, 1)."""
        return np.array([[self.equation.largest_mean * room.total_area] for room in self.rooms])

    def target_of(self, times: Array) -> Array:
        """Return the absorption area in m² that T in s needs, both (n_configurations, n_bands).

        ``times`` are these T.
        """
        pairs = zip(self.rooms, times, strict=True)
        return np.array([self.equation.target(room, t) for room, t in pairs])

    @cached_property
    def match_matrix(self) -> Any:
        """Areas by unknown, as a sparse matrix with one row per configuration and band, 0 without T."""
        layout = self.layout
        c, n, k = layout.n_configurations, layout.n_alpha_rows, layout.n_bands
        areas = np.where(self.matched[:, :, np.newaxis], self.areas[:, np.newaxis, :], 0.0)
        columns = np.arange(n) * k + np.arange(k)[:, np.newaxis]
        columns = np.broadcast_to(columns, (c, k, n)).ravel()
        starts = np.arange(0, c * k * n + 1, n)
        gains = np.where(self.matched[:, :, np.newaxis], self.gains, 0.0).reshape(c * k, -1)
        alpha = sp.csr_array((areas.ravel(), columns, starts), shape=(c * k, n * k))
        return sp.csr_array(sp.hstack([alpha, sp.csr_array(gains)]))

    @cached_property
    def target_covariance(self) -> Array:
        """Covariance in m⁴ of b - S'alpha, where b is the absorption area that T needs.

        S'alpha is the absorption area of the coefficients. The covariance has n_configurations *
        n_bands rows and columns, and follows from the errors of T, volume, areas and climate. An
        unknown uncertainty of T counts as 0.
        """
        noise = np.diag(np.nan_to_num(self.target_uncertainty).ravel() ** 2)
        changes = self.room_changes
        return noise + changes.T @ changes if changes.size else noise

    @cached_property
    def match_whitener(self) -> Array:
        """Lower triangular matrix W in 1/m² for which W'W is the inverse of `target_covariance`.

        W has n_configurations * n_bands rows and columns; those of a band without T are 0.
        """
        used = np.flatnonzero(self.matched.ravel())
        whitener = np.zeros_like(self.target_covariance)
        block = np.ix_(used, used)
        factor = np.linalg.cholesky(self.target_covariance[block])
        whitener[block] = np.tril(np.linalg.inv(factor))
        return whitener

    @cached_property
    def common_shift(self) -> Array:
        """Change of each unknown by one standard deviation of all coefficients together, (size,)."""
        shift = np.where(self.sigma > 0, self.common * self.mu, 0.0)
        shift[self.layout.n_alpha :] = 0.0
        return shift

    def alpha(self, u: Array) -> Array:
        """Return the absorption coefficients among the unknowns, (n_alpha_rows, n_bands)."""
        return u[: self.layout.n_alpha].reshape(self.layout.n_alpha_rows, self.layout.n_bands)

    def further(self, u: Array) -> Array:
        """Return the sizes of effects among the unknowns, (n_further,)."""
        return u[self.layout.n_alpha :]
