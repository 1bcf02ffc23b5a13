"""The corrected geometry: the patch on its surface, what simulators hear in it, what programs read."""

import re

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import PositionsCase
from rtcal.finder.apply import corrected_geometry
from rtcal.finder.claim import Candidate
from rtcal.finder.positions.surfaces import patched
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.geometry import SHOEBOX_WALLS
from rtcal.support.errors import DataError
from tests.conftest import also, in_geometry

BANDS = (500.0, 1000.0)
SIZE = (7.0, 5.0, 3.0)
SOURCES = {"S": (1.2, 1.0, 1.5)}
RECEIVERS = {"R1": (5.5, 1.2, 1.2), "R2": (3.4, 3.6, 1.3)}
L_PLAN = [(0.0, 0.0), (9.0, 0.0), (9.0, 4.0), (5.0, 4.0), (5.0, 8.0), (0.0, 8.0)]
U_PLAN = [(0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (5.0, 5.0), (5.0, 1.0), (1.0, 1.0), (1.0, 5.0)]
U_PLAN += [(0.0, 5.0)]


def prism(plan: list[tuple[float, float]], height: float = 3.0) -> Polyhedron:
    """Return the room on a plan: a floor, a ceiling and walls, each of its own material."""
    faces = [
        (name, name, [(x, y, z) for x, y in plan])
        for name, z in (("floor", 0.0), ("ceiling", height))
    ]
    for i, (a, b) in enumerate(zip(plan, [*plan[1:], plan[0]], strict=True)):
        corners = [(*a, 0.0), (*b, 0.0), (*b, height), (*a, height)]
        faces.append((f"wall {i}", f"wall {i}", corners))
    return Polyhedron.from_polygons(faces)


def triangulated(geometry: Polyhedron) -> Polyhedron:
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

    def middle(at: object) -> np.ndarray:
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


def case_in(geometry: Polyhedron, alpha: float = 0.12, **options: object) -> PositionsCase:
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
        measured=rt.Measurement(
            centre_frequencies=BANDS, pairs=tracer.pairs, values={"t20": np.ones((2, 2))}
        ),
    )


def candidate(surface: str, size: float, alpha: float = 0.8) -> Candidate:
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
    assert made.room.alpha[-1] == pytest.approx(np.full(2, 0.12 + 0.88 * 0.9))
    # The patch's own note of its source has both areas.
    assert {"6.67", "6"} <= set(re.findall(r"[\d.]+(?= m²)", made.room.sources[made.material]))


def test_a_patch_that_does_not_fit_is_the_whole_surface_and_says_so(box):
    made = corrected_geometry(box, candidate("east", 16.0))
    assert made.form == "material"
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
