"""Modes of a room of plane walls: of a box in closed form, of any other by finite elements.

Quadratic tetrahedra of scikit-fem (Gustafsson & McBain 2020) on a mesh that fills the room exactly
(`rtcal.modes.tetrahedra`). Their frequencies err by the fourth power of the spacing; in a room with
edges that stand out into it, by its power of 4/3 (Strang & Fix 1973, Ch. 6 and 8). No other module
imports scikit-fem (``rtcal[modes]``).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rtcal.modes.box import BEYOND, box_modes, refuse_many
from rtcal.modes.room_modes import RoomModes
from rtcal.modes.tetrahedra import fill
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.triangles import distances
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.types import Array

PER_WAVELENGTH = 3.5
"""Grid lines per wavelength of the highest mode that is wanted."""
_PLANE = 1e-3
"""Distance in m from a wall within which the boundary of the mesh belongs to it."""
_PATTERN = 0.3
"""Share of the largest power of the modes' patterns on a wall, from which one is answered."""
_APART = 1e-3
"""Share of the largest power of the answers, from which one is not a mixture of the others."""
_MOST_KEPT = 4
_kept: dict[tuple[Any, ...], RoomModes] = {}
"""Modes of the last rooms: a second calibration of a room does not calculate them again."""


@checked
def modes_of(
    geometry: Polyhedron,
    largest: float,
    speed_of_sound: float = 343.2,
    *,
    spacing: float | None = None,
) -> RoomModes:
    """Return the modes of a room with rigid walls up to a frequency.

    Parameters
    ----------
    geometry : Polyhedron
        A box from the origin on, as `Polyhedron.shoebox` makes it, has closed forms.
    largest : float
        Hz.
    speed_of_sound : float
        m/s.
    spacing : float, optional
        Of the mesh in m: then finite elements are used for a box, too.

    Raises
    ------
    DataError
        For an argument that breaks its rule.
    ModelError
        For a geometry of too many planes.
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
        raise DataError("a wall of the mesh overlaps another: the mesh's boundary is not its faces")
    owner = geometry.triangle_faces[off.argmin(axis=1)]
    walls = (boundary[owner == k] for k in range(len(geometry.faces)))
    bases = (fem.FacetBasis(mesh, basis.elem, facets=facets, intorder=4) for facets in walls)
    return [fem.models.poisson.mass.assemble(basis) for basis in bases]


def _library() -> Any:
    try:
        import skfem.models.poisson
    except ImportError as error:
        raise MissingDependencyError(
            "modes of a room that is no box need scikit-fem: pip install 'rtcal[modes]'"
        ) from error
    return skfem
