"""The corrected geometry: the patch on its surface, what simulators hear in it, what programs read."""

import re
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import PositionsCase
from rtcal.finder.apply import corrected_geometry
from rtcal.finder.claim import Candidate
from rtcal.finder.effects import library
from rtcal.finder.positions.problem import on_surfaces
from rtcal.finder.positions.surfaces import patched
from rtcal.io import catt, geometry_files, obj, odeon, pyroomacoustics
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.geometry import SHOEBOX_WALLS
from rtcal.support.errors import DataError
from tests.conftest import also, in_geometry, measurement_of

BANDS = (500.0, 1000.0)
SIZE = (7.0, 5.0, 3.0)
SOURCES = {"S": (1.2, 1.0, 1.5)}
RECEIVERS = {"R1": (5.5, 1.2, 1.2), "R2": (3.4, 3.6, 1.3)}
L_PLAN = [(0.0, 0.0), (9.0, 0.0), (9.0, 4.0), (5.0, 4.0), (5.0, 8.0), (0.0, 8.0)]
U_PLAN = [(0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (5.0, 5.0), (5.0, 1.0), (1.0, 1.0), (1.0, 5.0)]
U_PLAN += [(0.0, 5.0)]


def prism(plan, height=3.0):
    """Return the room on a plan: a floor, a ceiling and walls, each of its own material."""
    faces = [
        (name, name, [(x, y, z) for x, y in plan])
        for name, z in (("floor", 0.0), ("ceiling", height))
    ]
    for i, (a, b) in enumerate(zip(plan, [*plan[1:], plan[0]], strict=True)):
        corners = [(*a, 0.0), (*b, 0.0), (*b, height), (*a, height)]
        faces.append((f"wall {i}", f"wall {i}", corners))
    return Polyhedron.from_polygons(faces)


def triangulated(geometry):
    """Return the geometry with every face divided into triangles, as a mesh file has it."""
    polygons = []
    for i, name in enumerate(geometry.names):
        for k, corners in enumerate(geometry.triangles[geometry.triangle_faces == i]):
            own = name if k == 0 else f"{name} {k + 1}"
            polygons.append((own, geometry.materials[i], corners))
    return Polyhedron.from_polygons(polygons)


@pytest.mark.parametrize("geometry", [prism(L_PLAN), triangulated(prism(L_PLAN)), prism(U_PLAN)])
@pytest.mark.parametrize("surface", ["floor", "ceiling", "wall 1"])
@pytest.mark.parametrize("share", [0.02, 0.94, *also(0.5)])
def test_a_patch_has_its_area_on_any_surface(geometry, surface, share):
    faces = [i for i, m in enumerate(geometry.materials) if m == surface]
    area = share * geometry.areas[surface]
    corners = geometry.triangles[np.isin(geometry.triangle_faces, faces)]
    rng = np.random.default_rng(5)
    places = [None, *(rng.dirichlet(np.ones(3)) @ triangle for triangle in corners)]
    for at in places:
        made = patched(geometry, faces, area, "patch", "patch", at)
        assert made.areas["patch"] == pytest.approx(area, rel=1e-6)
        assert made.areas[surface] == pytest.approx(geometry.areas[surface] - area, rel=1e-6)
        assert made.volume == pytest.approx(geometry.volume)
        assert len(set(made.names)) == len(made.names)


def test_the_patch_stands_where_it_is_wanted():
    box = Polyhedron.shoebox(SIZE, "plaster")

    def middle(at):
        made = patched(box, [1], 4.0, "hole", "hole", None if at is None else np.array(at))
        hole = [i for i, m in enumerate(made.materials) if m == "hole"]
        return made.vertices[[v for i in hole for v in made.faces[i]]].mean(axis=0)

    assert middle(None) == pytest.approx([7.0, 2.5, 1.5])
    assert middle((7.0, 2.0, 1.4)) == pytest.approx([7.0, 2.0, 1.4])
    # A place is measured to some centimetres.
    assert middle((6.95, 2.0, 1.4)) == pytest.approx([7.0, 2.0, 1.4])
    assert middle((7.0, 5.0, 3.0))[1:] == pytest.approx([3.71, 2.225], abs=0.01)  # into the corner
    assert patched(box, [1], 14.5, "hole", "hole") is None  # no rim is left
    with pytest.raises(
        DataError, match=re.escape("at = (6, 2, 1.4) m is 1 m away from the surface")
    ):
        patched(box, [1], 4.0, "hole", "hole", np.array([6.0, 2.0, 1.4]))


def case_in(geometry, alpha=0.12, **options):
    tracer = PathTracing(
        geometry=geometry,
        room=in_geometry(geometry, BANDS, alpha, **options),
        sources=SOURCES,
        receivers=RECEIVERS,
        scattering=0.5,
        n_paths=6400,
    )
    return PositionsCase(
        simulator=tracer,
        measured=measurement_of(BANDS, tracer.pairs, t20=np.ones((2, 2))),
    )


def candidate(surface, size, alpha=0.8):
    return Candidate(
        effect="porous",
        family="added absorption",
        surface=surface,
        place=surface,
        probability=0.9,
        size=size,
        low=0.8 * size,
        high=1.2 * size,
        unit="m²",
        parameters={},
        spectrum=np.full(len(BANDS), alpha),
    )


@pytest.fixture(scope="module")
def box():
    geometry = Polyhedron.shoebox(SIZE, {w: f"{w} wall" for w in SHOEBOX_WALLS})
    return case_in(geometry, dimensions=SIZE, surfaces=geometry.surfaces)


def test_a_patch_of_alpha_1_is_drawn_larger(box):
    """So that a calibration can make it absorb more as well as less."""
    made = corrected_geometry(box, candidate("east", 6.0, 1.0))
    assert made.geometry.areas[made.material] == pytest.approx(6.0 / 0.9)
    assert made.room.dimensions is None  # simulators of boxes know one material per wall
    assert made.room.alpha[-1] == pytest.approx(np.full(2, 0.12 + 0.88 * 0.9))
    # The patch's own note of its source has both areas.
    assert {"6.67", "6"} <= set(re.findall(r"[\d.]+(?= m²)", made.room.sources[made.material]))


def test_a_patch_that_does_not_fit_is_the_whole_surface_and_says_so(box):
    made = corrected_geometry(box, candidate("east", 16.0))
    assert made.form == "material"
    assert made.room.dimensions == SIZE
    assert made.notes
    assert made.room.alpha[-1] == pytest.approx([0.8, 0.8])
    assert not corrected_geometry(box, candidate("east", 6.0), "material").notes


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"form": "patches"}, "patches"),
        ({"at": (7, 2)}, "at"),
        ({"at": (7, 2, float("nan"))}, "at"),
        ({"at": "here"}, "at"),
        ({"at": (3, 2, 1)}, "at"),
        ({"at": (7, 2, 1), "form": "material"}, "at"),
    ],
)
def test_a_wrong_place_is_refused(box, options, message):
    with pytest.raises(DataError, match=re.escape(message)):
        corrected_geometry(box, candidate("east", 6.0), **options)


# A patch or material absorbs what was found, in whatever size and on whatever wall it is drawn


@pytest.mark.parametrize("form", ["patch", "material"])
@pytest.mark.parametrize("wall_alpha", [0.6, *also(0.05, 0.9)])
@pytest.mark.parametrize("size", [0.5, 12.0])
@pytest.mark.parametrize("effect", on_surfaces(library()), ids=lambda effect: effect.name)
def test_the_corrected_room_has_the_change_that_was_found(form, wall_alpha, size, effect):
    """6 m² of opening on a wall of 0.6 added 2.00 in place of 2.40 m²."""
    geometry = Polyhedron.shoebox(SIZE, {wall: f"{wall} wall" for wall in SHOEBOX_WALLS})
    stated = case_in(geometry, alpha=wall_alpha)
    kinds = [spectrum for _, spectrum in effect.on_surface(np.array(BANDS))]
    for spectrum in (kinds[0], kinds[-1]):
        found = replace(candidate("east", size), effect=effect.name, spectrum=spectrum)
        made = corrected_geometry(stated, found, form)
        assert made.form == form
        assert made.room.total_area == pytest.approx(stated.room.total_area)
        assert np.array_equal(made.simulator().scattering, made.room.scattering)
        added = made.room.absorption_area - stated.room.absorption_area
        assert added == pytest.approx(size * (spectrum - wall_alpha), rel=1e-6)
        in_geometry = made.room.alpha.T @ [
            geometry_area(made.geometry, m) for m in made.room.materials
        ]
        of_stated = stated.room.alpha.T @ [geometry.areas[m] for m in stated.room.materials]
        assert in_geometry - of_stated == pytest.approx(added, rel=1e-6)


def geometry_area(geometry, material):
    return geometry.areas.get(material, 0.0)


# A law: what a corrected room's folder holds absorbs what the corrected room does, in every file

SHAPES = {"L": prism(L_PLAN), "triangles": triangulated(prism(L_PLAN))}
ROUNDED = 0.0005
"""Half of the last decimal of the coefficients in the lists."""


@pytest.mark.parametrize("form", ["patch", "material"])
@pytest.mark.parametrize("wall_alpha", [0.05, 0.6])
@pytest.mark.parametrize("surface", ["floor", "wall 5"])
@pytest.mark.parametrize("shape", SHAPES)
def test_every_file_has_the_patch(shape, surface, wall_alpha, form, tmp_path):
    case = case_in(SHAPES[shape], alpha=wall_alpha)
    made = corrected_geometry(case, candidate(surface, 4.0), form)
    made.save(tmp_path)
    room = rt.Room.from_file(str(tmp_path / "room.toml"))
    mesh = obj.read(tmp_path / "room.obj")
    assert isinstance(mesh, Polyhedron)
    for name in ("alpha", "sigma", "areas", "scattering"):
        stated, read = getattr(made.room, name), getattr(room, name)
        np.testing.assert_allclose(read, stated, rtol=1e-9)
    assert made.material in room.materials
    places = (room.scene.sources, room.scene.receivers)
    assert places == (dict(case.simulator.sources), dict(case.simulator.receivers))
    assert geometry_files.read(room).areas == mesh.areas
    sizes = np.array([mesh.areas[m] for m in room.materials])
    np.testing.assert_allclose(sizes, [made.geometry.areas[m] for m in room.materials], rtol=1e-6)
    absorbed = made.room.absorption_area
    np.testing.assert_allclose(sizes @ room.alpha, absorbed, rtol=1e-6)
    lists = {"catt.txt": catt, "odeon.txt": odeon, "pyroomacoustics.json": pyroomacoustics}
    for file, program in lists.items():
        listed = program.read(tmp_path / file).materials
        columns = [list(listed[0].centre_frequencies).index(f) for f in BANDS]
        alpha = np.array([np.asarray(m.alpha)[columns] for m in listed])
        np.testing.assert_allclose(sizes @ alpha, absorbed, atol=1.01 * ROUNDED * sizes.sum())
        for read, stated in zip(listed, room.materials, strict=True):
            assert read.name.endswith(stated)  # ODEON's names begin with a number
