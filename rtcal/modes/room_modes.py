"""The modes of a room: rigid-wall modes, and the poles of the room with absorbing walls.

With p = sum_m x_m phi_m e^{st} over the rigid-wall modes phi_m, of angular frequency omega_m and
∫ phi_m phi_n dV = 1 for m = n and else 0, the Helmholtz equation with locally reacting walls,
dp/dn = -(s / c) beta_i p on wall i, is the eigenproblem

    (s² + omega_m²) x_m + s c sum_i beta_i(s) sum_n B_imn x_n = 0,    B_imn = ∫_i phi_m phi_n dS.

The pole s = -delta + j omega has the decay delta in 1/s: the pressure falls as exp(-delta t), and the
decay time of the mode is 3 ln 10 / delta. To the first order delta_m = c sum_i Re(beta_i) B_imm / 2.

The modes of rigid walls are those of a box in closed form, of any other room by finite elements:
quadratic tetrahedra of scikit-fem (Gustafsson & McBain 2020), which fill the room exactly. The grid of
its bounding box has lines through every corner of the room, and each cell is six tetrahedra (Kuhn
1960). A plane of a wall that no grid line holds bisects the edges that cross it: a flat tetrahedron
costs no accuracy, since the functions of the whole one stay among those of its parts. What lies outside
the room is left out. The frequencies err by the fourth power of the spacing; in a room with edges that
stand out into it, by its power of 4/3 (Strang & Fix 1973, Ch. 6 and 8). No other module imports
scikit-fem (``rtcal[modes]``).

A coefficient is smooth over frequency. Its error in prior sigmas, x(f) = (alpha(f) - mu(f)) / sigma(f),
is a Gaussian process whose correlation is r ** octaves. Between the bands mu and sigma are interpolated
over log f; outside they are those of the nearest band. Given x in the bands, x(f) has the mean W x and
a remainder of covariance R (kriging; Rasmussen & Williams 2006, Eq. 2.19). So a mode's decay is an
observation of the bands' own coefficients, and the remainder is an error of it.

A pole is moved by the walls' specific admittance beta = 1 / z. A locally reacting wall absorbs, at the
angle of incidence t,

    alpha(t) = 4 Re(beta) cos t / |cos t + beta|²,

and Paris' integral of alpha(t) sin 2t over t from 0 to 90° is the random-incidence coefficient. A real
beta reaches at most 0.951, at beta = 0.638; `admittance` returns the smaller of the two that have an
alpha.

References
----------
Morse & Ingard 1968, Theoretical Acoustics, Sect. 9.4; Kuttruff 2009, Room Acoustics, Sect. 3.1 to 3.3
and Eq. 2.41 and 2.42; Paris 1928, Phil. Mag. 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.room import Room
from rtcal.io import geometry_files
from rtcal.simulators.geometry import SHOEBOX_WALLS, WELD, Polyhedron, distances
from rtcal.simulators.path_tracing import area_doubt, check_walls
from rtcal.support import checks
from rtcal.support.errors import DataError, MissingDependencyError, ModelError
from rtcal.support.types import Array

DECAY = 3 * float(np.log(10))
"""Product of a mode's decay time T and its decay constant delta, for a fall of the level by 60 dB."""

_ROUNDS = 12
_CONVERGED = 1e-7
_SETTLED = 1e-4
"""Largest share of another shape that the last step mixed in."""
_MIXED = 0.3
"""Share of another shape that one step mixes in at most."""

Complex = NDArray[np.complex128]
Integers = NDArray[np.intp]

Admittances = Callable[[float], Complex]
"""Function that returns the specific admittance of each wall, (n_walls,), at a frequency in Hz."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RoomModes:
    """Hold the modes of a room with rigid walls, from which those with absorbing walls are calculated.

    `modes_of` returns them. A mode of the room with absorbing walls is a mixture of the modes with
    rigid walls (module docstring).

    Examples
    --------
    >>> import rtcal as rt
    >>> rt.modes.modes_of(rt.simulators.Polyhedron.shoebox((5, 4, 2.5), "wall"), 60).wanted
    3
    """

    frequencies: Array
    """Frequencies in Hz, rising, without that of constant pressure (0 Hz), (n_modes,)."""
    coupling: Array
    """Integrals of the products of two modes over each wall in 1/m, (n_walls, n_modes + 1, n_modes +
    1). The last mode is that of frequency 0, the constant pressure."""
    materials: Sequence[str]
    """Name of the material of each wall, (n_walls,)."""
    speed_of_sound: float
    """Speed of sound in m/s."""
    largest: float
    """Frequency in Hz up to which modes are wanted. Modes above it improve the others' shapes."""
    shapes: Callable[[Array], Array]
    """Function that returns the modes' values in m^(-3/2), (n_points, n_modes + 1), at points
    (n_points, 3) in m."""
    known: dict[bytes, Poles] = field(default_factory=dict, repr=False)
    """Poles that were calculated last, by the coefficients, for use with further responses."""

    @property
    def wanted(self) -> int:
        """Number of modes up to ``largest``."""
        return int(np.searchsorted(self.frequencies, self.largest, side="right"))

    def poles(self, admittances: Admittances, like: Complex | None = None) -> Poles:
        """Return the poles (complex frequencies) of the modes up to ``largest`` with absorbing walls.

        ``admittances`` is a function that returns the specific admittance of each wall, (n_walls,), at
        a frequency in Hz. ``like`` (n_modes + 1, n_poles) are mixtures of rigid modes, such as
        ``mixtures`` of earlier `Poles`: the poles with the most similar shapes are then returned, in
        this order, which matters where two modes are close together. By default there is one pole per
        mode up to ``largest``. Raises ModelError if a pole does not converge, because a wall absorbs
        too much.
        """
        from scipy.optimize import linear_sum_assignment

        def at(frequencies: Array) -> Complex:
            return np.stack([admittances(float(f)) for f in frequencies], axis=1)

        omega, c = 2 * np.pi * np.append(self.frequencies, 0.0), self.speed_of_sound
        squares = omega[:, np.newaxis] ** 2
        root = np.sqrt(at(np.append(self.frequencies, self.frequencies[0])))
        # Without what couples to negative frequencies the problem is an ordinary one.
        start = np.diag(1j * omega) - c / 2 * np.einsum(
            "im,imn,in->mn", root, self.coupling, root, optimize=True
        )
        first, vectors = np.linalg.eig(start)
        alike = vectors[: self.wanted] if like is None else like.conj().T @ vectors
        # For each mode the vector that has most of it, each once.
        chosen = np.asarray(linear_sum_assignment(-(np.abs(alike) ** 2))[1])
        inverse, own = np.linalg.inv(vectors), first[:, np.newaxis]
        poles, shapes, left = first[chosen], vectors[:, chosen], np.arange(len(chosen))

        def refined(left: Integers) -> tuple[Complex, Complex, Complex]:
            """Set poles by Rayleigh's functional; return the last, c beta, and the walls' pull."""
            x, last = shapes[:, left] / np.sqrt((shapes[:, left] ** 2).sum(axis=0)), poles[left]
            beta = c * at(last.imag / (2 * np.pi))
            _, pull = self._walls(x, beta)
            # The root s of x'(s² + s W + omega²) x = 0 that is nearest to the last.
            half, square = (x * pull).sum(axis=0) / 2, (x**2 * squares).sum(axis=0)
            root = np.sqrt(half**2 - square)
            near = np.abs(root - half - last) < np.abs(root + half + last)
            poles[left], shapes[:, left] = np.where(near, root, -root) - half, x
            return last, beta, pull

        def corrected(left: Integers, beta: Complex, pull: Complex) -> Array:
            """Take off the residual by the vectors, among which the matrix is almost diagonal."""
            s, x = poles[left], shapes[:, left]
            residual, apart = (s**2 + squares) * x + s * pull, (s - own) * (s - own.conj())
            apart[chosen[left], np.arange(len(left))] = np.inf  # a shape takes nothing of its own
            mixed = inverse @ residual / apart
            mixed /= np.maximum(np.abs(mixed) / _MIXED, 1.0)
            shapes[:, left] = x - vectors @ mixed
            return np.asarray(np.abs(mixed).max(axis=0))

        def solved(left: Integers, beta: Complex, pull: Complex) -> Array:
            """Take a step of inverse iteration, where correction did not settle."""
            for k, b in zip(left, beta.T, strict=True):
                matrix = poles[k] * np.tensordot(b, self.coupling, 1)
                shapes[:, k] = np.linalg.solve(
                    matrix + np.diag(poles[k] ** 2 + omega**2), shapes[:, k]
                )
            return np.zeros(len(left))

        for step in (corrected, solved):
            poles[left], shapes[:, left] = first[chosen[left]], vectors[:, chosen[left]]
            moved = np.zeros(len(left))
            for _ in range(_ROUNDS if len(left) else 0):
                last, beta, pull = refined(left)
                off = np.abs(poles[left] - last)
                far = ~((off < _CONVERGED * np.abs(last)) & (moved < _SETTLED))
                left = left[far]
                if not len(left):
                    break
                moved = step(left, beta[:, far], pull[:, far])
        if len(left):
            raise ModelError(
                f"the mode at {poles[left[0]].imag / (2 * np.pi):.1f} Hz cannot be followed from "
                "rigid walls, because a wall absorbs too much: lower its coefficients"
            )
        of_walls, pull = self._walls(shapes, c * at(poles.imag / (2 * np.pi)))
        norms = (shapes * (2 * poles * shapes + pull)).sum(axis=0)
        return Poles(poles, shapes, (-poles * c * of_walls / norms).T, norms)

    def _walls(self, shapes: Complex, weights: Complex) -> tuple[Complex, Complex]:
        """Return x' B_i x of each column x, (n_walls, n_columns), and sum_i weights_i B_i x."""
        n, own, pull = shapes.shape[1], [], np.zeros_like(shapes)
        parts = np.hstack([shapes.real, shapes.imag])
        for wall, weight in zip(self.coupling, weights, strict=True):
            both = wall @ parts
            on_wall = both[:, :n] + 1j * both[:, n:]
            own.append((shapes * on_wall).sum(axis=0))
            pull += weight * on_wall
        return np.array(own), pull


@dataclass(frozen=True, eq=False)
class Poles:
    """Hold the poles (complex frequencies) of the modes of a room with absorbing walls.

    Each mode is a mixture x of rigid modes. It contributes a b / norm to the transfer function from a
    source to a receiver, where a and b are the mode's values at these points. The norm of a pole s is
    x' (2 s + c sum_i beta_i B_i) x, with the admittance beta_i and the `RoomModes.coupling` B_i of wall
    i and the speed of sound c.

    ``values`` (n_poles,) are the poles s in 1/s, ``mixtures`` (n_modes, n_poles) the x, ``slopes``
    (n_poles, n_walls) the derivatives of s by each wall's admittance in 1/s, and ``norms`` (n_poles,)
    the norms.
    """

    values: Complex
    mixtures: Complex
    slopes: Complex
    norms: Complex

    @property
    def frequencies(self) -> Array:
        """Frequencies of the modes in Hz."""
        return np.asarray(self.values.imag / (2 * np.pi))

    @property
    def decays(self) -> Array:
        """Decay constants delta of the modes in 1/s."""
        return np.asarray(-self.values.real)


PER_WAVELENGTH = 3.5
"""Number of grid lines per wavelength at the highest wanted frequency."""
_PLANE = 1e-3
"""Distance in m from a wall within which the boundary of the mesh belongs to it."""
_PATTERN = 0.3
"""Share of the largest power of the modes' patterns on a wall, from which one is answered."""
_APART = 1e-3
"""Share of the largest power of the answers, from which one is not a mixture of the others."""
_MOST_KEPT = 4
_kept: dict[tuple[Any, ...], RoomModes] = {}
"""Modes of the last rooms: a second calibration of a room does not calculate them again."""


def modes_of(
    geometry: Polyhedron,
    largest: float,
    speed_of_sound: float = 343.2,
    *,
    spacing: float | None = None,
) -> RoomModes:
    """Return the modes of a room with rigid walls, up to a frequency.

    Parameters
    ----------
    geometry : Polyhedron
        Geometry of the room. A box, as `Polyhedron.shoebox` returns it, is calculated in closed form.
    largest : float
        Frequency in Hz up to which modes are wanted.
    speed_of_sound : float
        Speed of sound in m/s.
    spacing : float, optional
        Edge length of the finite elements in m, by default 1/3.5 of the wavelength at ``largest``. If
        it is given, a box is also calculated with finite elements.

    Raises
    ------
    DataError
        For an argument that breaks a rule, and for a room with more than about 600 modes.
    ModelError
        For a geometry that needs more than 150,000 finite elements (tetrahedra).
    MissingDependencyError
        If scikit-fem is needed and not installed.

    Examples
    --------
    >>> box = Polyhedron.shoebox((5, 4, 2.5), "plaster")
    >>> print(modes_of(box, 50).frequencies[:2])
    [34.32 42.9 ]
    """
    largest = checks.positive("largest", largest, "Hz")
    c = checks.positive("speed_of_sound", speed_of_sound, "m/s")
    box = spacing is None and tuple(geometry.names) == SHOEBOX_WALLS
    box = box and not geometry.vertices.min(axis=0).any()
    spacing = c / largest / PER_WAVELENGTH if spacing is None else spacing
    spacing = checks.positive("spacing", spacing, "m")
    key = (geometry.to_text(), geometry.names, largest, c, None if box else spacing)
    if key not in _kept:
        if len(_kept) >= _MOST_KEPT:
            _kept.pop(next(iter(_kept)))
        if box:
            sides = np.ptp(geometry.vertices, axis=0)
            _kept[key] = box_modes(sides, geometry.materials, largest, c)
        else:
            _kept[key] = _by_elements(geometry, largest, c, spacing)
    return _kept[key]


def _by_elements(geometry: Polyhedron, largest: float, c: float, spacing: float) -> RoomModes:
    top = BEYOND * largest
    refuse_many(_expected(geometry, top / c), largest, np.ptp(geometry.vertices, axis=0))
    fem = _library()
    points, tetrahedra = fill(geometry, spacing)
    mesh = fem.MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tetrahedra.T))
    basis = fem.Basis(mesh, fem.ElementTetP2(), intorder=4)
    stiffness, mass = (getattr(fem.models.poisson, n).assemble(basis) for n in ("laplace", "mass"))
    frequencies, vectors = _eigenmodes(stiffness, mass, _expected(geometry, top / c), top / c)
    walls = _integrals(basis, geometry)
    more, answers = _answers(stiffness, mass, vectors, walls)
    frequencies, more = c * frequencies, c * more
    # The constant one, of frequency 0, is the first that was found, and stands last.
    vectors = np.hstack([vectors[:, 1:], answers, vectors[:, :1]])
    frequencies = np.concatenate([frequencies, more])
    coupling = np.stack([vectors.T @ (wall @ vectors) for wall in walls])

    def shapes(points: Array) -> Array:
        inside = np.ascontiguousarray(np.asarray(points, dtype=float).T)
        try:
            return np.asarray(basis.probes(inside) @ vectors)
        except ValueError as error:
            raise DataError("a position lies outside the room's walls") from error

    return RoomModes(
        frequencies=frequencies,
        coupling=coupling,
        materials=tuple(geometry.materials),
        speed_of_sound=c,
        largest=largest,
        shapes=shapes,
    )


def _eigenmodes(stiffness: Any, mass: Any, count: int, top: float) -> tuple[Array, Array]:
    """Return f / c up to ``top`` in 1/m, of ``count`` or more; and the vectors, first that of 0."""
    from scipy.sparse.linalg import eigsh

    size, limit = stiffness.shape[0], (2 * np.pi * top) ** 2
    while True:
        count = min(count, size - 2)
        values, vectors = eigsh(stiffness, count, mass, sigma=-1.0, v0=np.ones(size))
        if values.max() > limit or count >= size - 2:
            break
        count = int(1.3 * count) + 5
    order = np.argsort(values)
    order = order[values[order] <= limit]
    return np.sqrt(values[order[1:]]) / (2 * np.pi), np.asarray(vectors[:, order])


def _answers(stiffness: Any, mass: Any, vectors: Array, walls: list[Any]) -> tuple[Array, Array]:
    """Return what the walls' pressures excite beyond the modes: f / c in 1/m, and vectors.

    The static answers to the modes' largest patterns on each wall, orthogonal to the modes
    (Ritz vectors; MacNeal 1971). An infinite number of modes would add little to them.
    """
    from scipy.linalg import eigh
    from scipy.sparse.linalg import splu

    loads = []
    for wall in walls:
        on_wall = wall @ vectors
        power, patterns = np.linalg.eigh(vectors.T @ on_wall)
        loads.append(on_wall @ patterns[:, power > _PATTERN * power[-1]])
    solved = splu((stiffness + mass).tocsc()).solve(np.hstack(loads))
    solved -= vectors @ (vectors.T @ (mass @ solved))
    solved /= np.sqrt((solved * (mass @ solved)).sum(axis=0))
    power, turn = np.linalg.eigh(solved.T @ (mass @ solved))
    apart = power > _APART * power[-1]
    solved = solved @ (turn[:, apart] / np.sqrt(power[apart]))
    values, turn = eigh(solved.T @ (stiffness @ solved))
    return np.sqrt(values) / (2 * np.pi), solved @ turn


def _expected(geometry: Polyhedron, wavenumber: float) -> int:
    """Return somewhat more than the number of modes up to f / c in 1/m (Weyl; Kuttruff, Eq. 3.20)."""
    area = float(np.sum(geometry.face_areas))
    number = 4 / 3 * np.pi * geometry.volume * wavenumber**3 + np.pi / 4 * area * wavenumber**2
    return int(1.1 * number + 3 * geometry.volume ** (1 / 3) * wavenumber) + 8


def _integrals(basis: Any, geometry: Polyhedron) -> list[Any]:
    """Return the matrix of ∫ u v dS over each wall."""
    fem = _library()
    mesh = basis.mesh
    boundary = mesh.boundary_facets()
    off = distances(mesh.p[:, mesh.facets[:, boundary]].mean(axis=1).T, geometry.triangles)
    if (off.min(axis=1) > _PLANE).any():
        raise DataError("walls of the mesh overlap; draw each wall once")
    owner = geometry.triangle_faces[off.argmin(axis=1)]
    walls = (boundary[owner == k] for k in range(len(geometry.faces)))
    bases = (fem.FacetBasis(mesh, basis.elem, facets=facets, intorder=4) for facets in walls)
    return [fem.models.poisson.mass.assemble(basis) for basis in bases]


def _library() -> Any:
    try:
        import skfem.models.poisson
    except ImportError as error:
        raise MissingDependencyError(
            "modes of a room that is not a box need scikit-fem: pip install 'rtcal[modes]'"
        ) from error
    return skfem


BEYOND = 1.1
"""Factor of the largest wanted frequency up to which modes are calculated, for more exact shapes."""
MOST = 600
"""Approximate largest number of modes."""
_LARGEST_SIDE = 500.0
"""m. A longer room is likely in mm."""
_SUMMED = 200
"""Modes of a pair of orders that stand for an infinite number."""


def box_modes(sides: Array, materials: Sequence[str], largest: float, c: float) -> RoomModes:
    """Return the modes of a rigid box from the origin to ``sides`` (3,) in m, in closed form.

    The modes are phi = prod cos(n_i pi x_i / L_i) / norm, and their frequencies f = c / 2 |n / L|
    (Kuttruff 2009, Eq. 3.15 and 3.17).

    ``materials`` (6,) are those of west (x = 0), east, south, north, floor and ceiling; ``c`` is the
    speed of sound in m/s. Raises DataError for too many modes up to ``largest`` in Hz.
    """
    top = BEYOND * largest
    counts = np.floor(2 * top * sides / c).astype(int)
    # About half of these orders lie within the ellipsoid.
    refuse_many(float(np.prod(counts + 1.0)) / 2, largest, sides)
    orders = np.stack(np.meshgrid(*(np.arange(n + 1) for n in counts), indexing="ij"), -1)
    orders = orders.reshape(-1, 3)
    frequencies = c / 2 * np.linalg.norm(orders / sides, axis=1)
    # The constant one, of frequency 0, stands last.
    order = np.roll(np.flatnonzero(frequencies <= top), -1)
    own, frequencies = orders[order], frequencies[order]
    if len(own) < 2:
        raise DataError(f"the room has no mode up to {largest:g} Hz")
    beyond = [_beyond(own, sides, axis) for axis in range(3)]
    orders = np.concatenate([own[:-1], *(pairs for pairs, _, _ in beyond), own[-1:]])
    more = [wavenumbers * c / (2 * np.pi) for _, _, wavenumbers in beyond]
    frequencies = np.concatenate([frequencies[:-1], *more])
    rows = np.split(np.arange(len(own) - 1, len(orders) - 1), np.cumsum([len(f) for f in more])[:2])
    norms = np.sqrt(np.where(orders == 0, 1.0, 2.0) / sides)

    def along(points: Array) -> Array:
        """Return the factor of each axis, (n_points, n_modes + 1, 3)."""
        angle = np.pi * np.asarray(points)[:, np.newaxis, :] / sides
        out = np.cos(angle * orders)
        for axis, (_, series, _) in enumerate(beyond):
            waves = np.cos(angle[:, :, axis] * np.arange(series.shape[1]))
            out[:, rows[axis], axis] = waves @ series.T
        return np.asarray(out * norms)

    def shapes(points: Array) -> Array:
        if ((points < 0) | (points > sides)).any():
            raise DataError("a position lies outside the room's walls")
        return np.asarray(along(points).prod(axis=2))

    at_walls = along(np.array([np.zeros(3), sides]))
    coupling = np.empty((6, len(orders), len(orders)))
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        same = (orders[:, np.newaxis, others] == orders[np.newaxis, :, others]).all(axis=2)
        for end, values in enumerate(at_walls[:, :, axis]):
            coupling[2 * axis + end] = np.outer(values, values) * same
    rising = np.argsort(frequencies, kind="stable")
    every = np.append(rising, len(rising))
    return RoomModes(
        frequencies=frequencies[rising],
        coupling=coupling[:, every[:, np.newaxis], every],
        materials=tuple(materials),
        speed_of_sound=c,
        largest=float(largest),
        shapes=lambda points: shapes(points)[:, every],
    )


def refuse_many(count: float, largest: float, sides: Array) -> None:
    """Raise DataError for more than `MOST` modes up to ``largest`` in Hz in a box of ``sides`` in m."""
    if count > MOST:
        size = " x ".join(f"{side:.3g}" for side in sides)
        raise DataError(
            f"the room of {size} m has about {count:.0f} modes up to {largest:g} Hz, but at most "
            f"{MOST} are calculated: give a lower largest frequency"
            + (", or check whether the room is in mm" if np.max(sides) > _LARGEST_SIDE else "")
        )


def _beyond(
    orders: NDArray[np.int64], sides: Array, axis: int
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return what the walls across an axis excite beyond the modes of these orders.

    For each pair of orders along the other axes these are two static answers, an even and an odd one:
    sums of all higher modes of the pair, weighed by 1 / wavenumber². Returned are orders, of which the
    axis' own is -2 (even) or -1 (odd), the series over the axis' modes, and wavenumbers in 1/m.
    """
    others = [a for a in range(3) if a != axis]
    pairs, place = np.unique(orders[:, others], axis=0, return_inverse=True)
    last = np.zeros(len(pairs), dtype=int)
    np.maximum.at(last, place.ravel(), orders[:, axis])
    along = np.arange(_SUMMED)
    squares = (along / sides[axis]) ** 2 + ((pairs / sides[others]) ** 2).sum(axis=1)[:, np.newaxis]
    higher = (along > last[:, np.newaxis]) / np.maximum(squares, 1e-9)
    series = np.concatenate([higher * (along % 2 == 0), higher * (along % 2 == 1)])
    series /= np.linalg.norm(series, axis=1)[:, np.newaxis]
    own = np.repeat([-2, -1], len(pairs))
    wavenumbers = np.pi * np.sqrt((series**2 * np.tile(squares, (2, 1))).sum(axis=1))
    return np.insert(np.tile(pairs, (2, 1)), axis, own, axis=1), series, wavenumbers


Plane = tuple[Array, float]
"""Normal of a plane, and its offset in m."""

MOST_TETRAHEDRA = 150_000
"""Largest number of tetrahedra of finite elements."""
_TOO_MANY = (
    f"the room's {{}} need over {MOST_TETRAHEDRA} tetrahedra: give a mesh without small objects"
)
_NEAR = 1e-7
"""Distance in m within which a vertex lies on a plane."""
_FLAT = 1e-12
"""Six times the volume in m³ of a tetrahedron that is left out."""
_AXIAL = 1 - 1e-9
_EDGES = np.array([*combinations(range(4), 2)])


def fill(geometry: Polyhedron, spacing: float) -> tuple[Array, Integers]:
    """Return a mesh of tetrahedra that fills a room, for finite elements.

    The mesh consists of vertices (n_vertices, 3) in m, and of the numbers of each tetrahedron's
    vertices, (n_tetrahedra, 4). ``spacing`` is the largest distance of grid lines in m. Raises
    ModelError for more than `MOST_TETRAHEDRA` tetrahedra.
    """
    lines = [_lines(geometry.vertices[:, axis], spacing) for axis in range(3)]
    if 6 * np.prod([len(line) - 1.0 for line in lines]) > MOST_TETRAHEDRA:
        raise ModelError(_TOO_MANY.format("corners"))
    grid = _library().MeshTet.init_tensor(*lines)
    points, tetrahedra = grid.p.T, grid.t.T
    planes = _oblique(geometry)
    for plane in planes:
        points, tetrahedra = _cut(points, tetrahedra, plane)
        if len(tetrahedra) > MOST_TETRAHEDRA:
            raise ModelError(_TOO_MANY.format(f"{len(planes)} oblique planes"))
    corners = points[tetrahedra]
    six_volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    tetrahedra = tetrahedra[six_volumes > _FLAT]
    tetrahedra = tetrahedra[geometry.contains(points[tetrahedra].mean(axis=1))]
    used, numbers = np.unique(tetrahedra, return_inverse=True)
    return points[used], numbers.reshape(-1, 4)


def _lines(corners: Array, spacing: float) -> Array:
    """Return grid lines through all corners, at most ``spacing`` apart."""
    own = np.sort(corners)
    own = own[np.r_[True, np.diff(own) > WELD / 2]]
    parts = [
        np.linspace(a, b, max(int(np.ceil((b - a) / spacing - 1e-9)), 1) + 1)[:-1]
        for a, b in pairwise(own)
    ]
    return np.concatenate([*parts, own[-1:]])


def _oblique(geometry: Polyhedron) -> list[Plane]:
    """Return planes that cut: oblique walls, and edges between coplanar walls."""
    planes: list[Plane] = []

    def add(normal: Array, point: Array) -> None:
        offset = float(normal @ point)
        for other, distance in planes:
            same = abs(other @ normal) > _AXIAL
            if same and abs(distance - offset * np.sign(other @ normal)) < 1e-6:
                return
        if np.abs(normal).max() < _AXIAL:
            planes.append((normal, offset))

    faces = [geometry.vertices[list(face)] for face in geometry.faces]
    for normal, corners in zip(geometry.normals, faces, strict=True):
        add(normal, corners[0])
    for i, (normal, corners) in enumerate(zip(geometry.normals, faces, strict=True)):
        along = (j for j in range(i) if normal @ geometry.normals[j] >= _AXIAL)
        if any(abs(normal @ (faces[j][0] - corners[0])) <= 1e-6 for j in along):
            for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                across = np.cross(b - a, normal)
                add(across / np.linalg.norm(across), a)
    return planes


def _cut(points: Array, tetrahedra: Integers, plane: Plane) -> tuple[Array, Integers]:
    """Divide each edge that crosses a plane there, and the tetrahedra that have it.

    Of a tetrahedron's edges that with the highest vertices is first: neighbours agree on their face.
    """
    n, distance = len(points), points @ plane[0] - plane[1]
    side = np.where(np.abs(distance) < _NEAR, 0, np.sign(distance))
    ends = np.sort(tetrahedra[:, _EDGES])
    codes = np.unique((ends @ [n, 1])[side[ends].prod(axis=2) < 0])
    a, b = np.divmod(codes, n)
    share = (distance[a] / (distance[a] - distance[b]))[:, np.newaxis]
    points = np.vstack([points, points[a] + share * (points[b] - points[a])])
    side = np.append(side, np.zeros(len(codes)))
    while True:
        ends = np.sort(tetrahedra[:, _EDGES])
        order = np.where(side[ends].prod(axis=2) < 0, ends.sum(axis=2), -1)
        cut = order.max(axis=1) >= 0
        if not cut.any():
            return points, tetrahedra
        whole, edge = tetrahedra[cut], ends[cut, order[cut].argmax(axis=1)]
        new = n + np.searchsorted(codes, edge @ [n, 1])[:, np.newaxis]
        halves = [np.where(whole == end[:, np.newaxis], new, whole) for end in edge.T]
        tetrahedra = np.vstack([tetrahedra[~cut], *halves])


LARGEST = 0.856
"""Coefficient alpha above which the admittance follows its tangent: nine tenths of the largest alpha of
a real admittance, near which the admittance does not determine alpha."""
_NEWTON = 8
"""Steps: the last ones change no digit, at `LARGEST` either."""


def absorption(beta: Complex | Array) -> Array:
    """Return the random-incidence absorption coefficients of walls with given specific admittances.

    Walls react locally, and the coefficient is Paris' integral over all angles of incidence.
    ``beta`` is rho c over the wall's impedance, a number or an array, real or complex; the
    coefficients have the same shape. Raises DataError for an admittance that is not finite or whose
    real part is below 0.

    Examples
    --------
    >>> print(absorption([0.01, 0.638, 0.02 + 0.05j]).round(3))
    [0.073 0.951 0.133]
    """
    value = np.asarray(beta, dtype=complex)
    if not np.isfinite(value).all() or (value.real < 0).any():
        raise DataError(f"beta = {checks.shown(beta)} must be finite with a real part of 0 or more")
    # The integral is even in b, and has its limit where b is 0.
    g, b = value.real, np.maximum(np.abs(value.imag), 1e-12)
    # With cos t = x it is 8 g times that of x² / ((x + g)² + b²) over x from 0 to 1.
    log = np.log(((1 + g) ** 2 + b**2) / (g**2 + b**2))
    arc = np.arctan2(b, g * (1 + g) + b**2) / b
    return np.asarray(8 * g * (1 - g * log + (g**2 - b**2) * arc))


def admittance(alpha: Array) -> Array:
    """Return the real specific admittances of walls with given random-incidence coefficients.

    It is the inverse of `absorption`. ``alpha``, a number or an array, must be from 0 to 1; the
    admittances have its shape. A real admittance gives at most alpha = 0.951. Above alpha = 0.856 the
    admittance is therefore continued along its tangent, and no longer gives alpha exactly. Raises
    DataError for other coefficients.

    Examples
    --------
    >>> print(admittance(0.1).round(4), absorption(admittance(0.5)).round(6))
    0.014 0.5
    """
    value = checks.array("alpha", alpha)
    if not ((value >= 0) & (value <= 1)).all():
        raise DataError(f"alpha = {checks.shown(alpha)} must be from 0 to 1")
    return _with_slope(value)[0]


def admittance_slope(alpha: Array) -> Array:
    """Return the derivative of the real specific admittance by alpha; errors as `admittance`."""
    return _with_slope(np.asarray(alpha, dtype=float))[1]


def _with_slope(alpha: Array) -> tuple[Array, Array]:
    """Return beta and its slope over alpha.

    The slope of alpha(beta) falls from 8: Newton's steps from alpha / 8 do not overshoot.
    """
    inside = np.minimum(alpha, LARGEST)
    beta = inside / 8
    for _ in range(_NEWTON):
        beta = beta - (absorption(beta) - inside) / _rise(beta)
    slope = 1 / _rise(beta)
    return beta + (alpha - inside) * slope, slope


def _rise(beta: Array) -> Array:
    """Return d alpha / d beta of a real admittance."""
    share, log = beta / (1 + beta), np.log1p(1 / np.maximum(beta, 1e-300))
    return np.asarray(8 * (1 + share * (4 - share) - 4 * beta * log))


CORRELATION = 0.8
"""Correlation of a coefficient's errors an octave apart if the room's ``band_correlation`` is 0."""
ABOVE = 1.08
"""Factor of the highest frequency in use up to which modes are calculated."""
_STEP = 10.0
_MOST_POLES = 12


@dataclass(frozen=True, eq=False)
class AtFrequencies:
    """Hold coefficients of a room's materials at single frequencies, interpolated between bands.

    ``mean`` and ``sigma`` (n_materials, n_frequencies) are the input coefficients at these frequencies
    and their standard deviations. ``weights`` (n_frequencies, n_bands) interpolate changes of the
    coefficients, in sigmas, from the bands. ``remainder`` (n_frequencies, n_frequencies) is the
    covariance, in sigmas squared, of what interpolation leaves unknown.
    """

    mean: Array
    sigma: Array
    weights: Array
    remainder: Array
    prior: Room

    @classmethod
    def of(cls, room: Room, frequencies: Array) -> AtFrequencies:
        """Return the coefficients of a room at single frequencies in Hz."""
        n, places = room.n_bands, np.log2(frequencies)
        every = np.concatenate([room.centre_frequencies, frequencies])
        correlation = bands.correlation(every, room.band_correlation)
        across = correlation[n:, :n]
        weights: Array = np.asarray(np.linalg.solve(correlation[:n, :n], across.T).T)
        mean, sigma = (
            np.asarray([np.interp(places, np.log2(room.centre_frequencies), row) for row in rows])
            for rows in (room.alpha, room.sigma)
        )
        remainder: Array = np.asarray(correlation[n:, n:] - weights @ across.T)
        return cls(mean, sigma, weights, remainder, room)

    def alpha(self, alpha: Array) -> Array:
        """Return coefficients at the frequencies, (n_materials, n_frequencies), from those in bands."""
        room = self.prior
        shift = np.divide(
            alpha - room.alpha, room.sigma, out=np.zeros_like(alpha), where=room.sigma > 0
        )
        # A Gaussian process knows no bounds; alpha has them.
        return np.asarray(np.clip(self.mean + self.sigma * (shift @ self.weights.T), 0.0, 1.0))

    def slope(self) -> Array:
        """Return derivatives of `alpha` by alpha in bands, (n_materials, n_frequencies, n_bands)."""
        sigma = self.prior.sigma
        inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
        return np.asarray(self.sigma[:, :, np.newaxis] * self.weights * inverse[:, np.newaxis, :])


@dataclass(frozen=True, eq=False)
class RoomPoles:
    """Compute the poles (complex frequencies) of a room's modes for coefficients in bands.

    ``room`` must have a correlation between its bands.
    """

    room: Room
    modes: RoomModes

    @classmethod
    def of(cls, room: Room, largest: float, geometry: Polyhedron | None = None) -> RoomPoles:
        """Return the poles of a room's modes up to a frequency ``largest`` in Hz, or somewhat higher.

        ``geometry`` is that of the room; None means the mesh or box of the room's scene. Errors are
        those of `rtcal.calibrate_modes`.
        """
        geometry = geometry_files.read(room) if geometry is None else geometry
        if geometry.leaks:
            raise DataError("the modes of a room need a closed mesh, and this one leaks")
        check_walls(geometry, room)
        if doubt := area_doubt(geometry, room):
            raise DataError(doubt)
        # In steps, so that another measurement of the room needs the same modes.
        top = _STEP * float(np.ceil(largest / _STEP - 1e-9))
        modes = modes_of(geometry, top, (room.air or Air()).speed_of_sound)
        if not modes.wanted:
            raise DataError(f"the room has no mode up to {modes.largest:g} Hz")
        return cls(room.replace(band_correlation=room.band_correlation or CORRELATION), modes)

    @cached_property
    def at(self) -> AtFrequencies:
        """Coefficients at the modes' frequencies, also of the modes above the wanted frequencies."""
        return AtFrequencies.of(self.room, self.modes.frequencies)

    @cached_property
    def rows(self) -> list[int]:
        """Number of the material of each wall."""
        return [self.room.material_index(m) for m in self.modes.materials]

    @cached_property
    def calculated(self) -> Poles:
        """Poles of all modes with the input coefficients of the room."""
        return self.poles(self.room.alpha)

    def poles(self, alpha: Array) -> Poles:
        """Return the poles of all modes for coefficients ``alpha``, in the order of `calculated`."""
        own = np.array_equal(alpha, self.room.alpha)
        walls = [of[self.rows].tobytes() for of in (self.at.mean, self.at.alpha(alpha))]
        known, key = self.modes.known, walls[0] if own else b"".join(walls)
        if key not in known:
            like = None if own else self.calculated.mixtures
            if len(known) >= _MOST_POLES:
                known.pop(next(iter(known)))
            f, beta = self.modes.frequencies, admittance(self.at.alpha(alpha))

            def admittances(frequency: float) -> Complex:
                """Return the walls', interpolated between the modes' frequencies."""
                return np.array([np.interp(frequency, f, row) for row in beta])[self.rows]

            known[key] = self.modes.poles(admittances, like)
        return known[key]

    def amplitudes(self, pairs: Sequence[tuple[str, str]]) -> Complex:
        """Return the amplitude of each mode at each source-receiver pair, (n_poles, n_pairs).

        The source has the same strength at all frequencies, and the walls have the room's input
        coefficients.
        """
        scene, poles = self.room.scene, self.calculated
        for source, receiver in pairs:
            if source not in scene.sources or receiver not in scene.receivers:
                raise DataError(
                    f"pairs: {source} to {receiver} has no position; the room has the sources "
                    f"{', '.join(scene.sources) or 'none'} and receivers "
                    f"{', '.join(scene.receivers) or 'none'}"
                )
        values = {}
        for side, of in enumerate((scene.sources, scene.receivers)):
            for name in {pair[side] for pair in pairs}:
                try:
                    shapes = self.modes.shapes(np.array([of[name]], dtype=float))
                except DataError as error:
                    place = ", ".join(f"{x:g}" for x in of[name])
                    raise DataError(f"{name} at ({place}) m: {error}") from error
                values[side, name] = shapes[0] @ poles.mixtures
        at = [np.array([values[side, pair[side]] for pair in pairs]) for side in (0, 1)]
        return np.asarray((at[0] * at[1] / poles.norms).T)

    def linear(self, alpha: Array, chosen: Integers) -> tuple[Array, Array, Array]:
        """Return decays of chosen modes, their derivatives by alpha, and their remaining covariance.

        Their shapes are (n_modes,), (n_modes, n_materials * n_bands) and (n_modes, n_modes), for decays
        in 1/s. ``chosen`` are the numbers of the modes. The remaining covariance is due to the unknown
        coefficients between the bands' centre frequencies.
        """
        poles, columns = self.poles(alpha), chosen.tolist()
        beta_slope = admittance_slope(self.at.alpha(alpha)[:, columns])
        by_material = np.zeros((len(columns), self.room.n_materials), dtype=complex)
        for wall, row in enumerate(self.rows):
            by_material[:, row] += poles.slopes[columns, wall]
        # Of delta by alpha at the mode's own frequency.
        slope = -(by_material * beta_slope.T).real
        matrix = slope[:, :, np.newaxis] * self.at.slope()[:, columns].transpose(1, 0, 2)
        in_sigmas = slope * self.at.sigma[:, columns].T
        remainder = (in_sigmas @ in_sigmas.T) * self.at.remainder[np.ix_(columns, columns)]
        air = self.room.air_attenuation * self.modes.speed_of_sound / 2
        air = np.interp(poles.frequencies, self.room.centre_frequencies, air)
        return (poles.decays + air)[columns], matrix.reshape(len(columns), -1), remainder
