"""The directions of a room's surfaces, and what a search says where nothing tells them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rtcal as rt
from rtcal.acoustics.changes import enough_known, facing, kind_of
from rtcal.acoustics.room import Surface
from rtcal.simulators.geometry import Polyhedron
from tests.conftest import room_of

SIDES = (6.4, 8.2, 3.4)
X, Y, Z = 8.2 * 3.4, 6.4 * 3.4, 6.4 * 8.2
"""Area of one face of the box along each axis."""
F = [250, 500, 1000, 2000]
FLOOR, CEILING = [0.12, 0.35, 0.6, 0.7], [0.5, 0.6, 0.6, 0.5]
WALLS = [0.03, 0.03, 0.03, 0.04]
AXES = [[0, 0, 1], [0, 0, 1], [X / (X + Y), Y / (X + Y), 0]]


def room(names=None, **stated):
    """A room with an absorbing floor and ceiling and hard walls."""
    alpha = np.array([FLOOR, CEILING, WALLS])
    return rt.Room(
        **{
            "name": "office",
            "volume": float(np.prod(SIDES)),
            "materials": names or ["m1", "m2", "m3"],
            "areas": [Z, Z, 2 * (X + Y)],
            "alpha": alpha,
            "sigma": 0.15 * alpha,
            "centre_frequencies": F,
            "air": rt.Air(20, 50),
            **stated,
        }
    )


def surfaces(names, axes=""):
    of_each = [("m1", Z), ("m2", Z), ("m3", 2 * X), ("m3", 2 * Y)]
    return [
        Surface(name, material, area, axis or None)
        for name, (material, area), axis in zip(names, of_each, axes or [""] * 4, strict=True)
    ]


WAYS = {
    "axes": room(surfaces=surfaces(["s1", "s2", "s3", "s4"], "zzxy")),
    "dimensions alone": room(dimensions=SIDES),
    "names of materials and dimensions": room(
        ["carpet floor", "ceiling", "walls"], dimensions=SIDES
    ),
    "names of surfaces": room(surfaces=surfaces(["Boden", "Decke", "Wand Ost", "Wand Nord"])),
    "names of floor and ceiling": room(["suelo", "techo acústico", "yeso"]),
    "name of the floor, and walls": room(["plancher", "dalles", "murs"]),
}


@pytest.mark.parametrize("way", WAYS)
def test_what_says_directions_says_the_same(way):
    found = facing(WAYS[way])
    assert enough_known(WAYS[way], found)
    # Without dimensions half of the walls is taken to face along x.
    assert np.allclose(found, AXES, atol=0.01 if "dimensions" in way or way == "axes" else 0.1)


def test_a_mesh_says_them_even_where_it_is_turned():
    walls = dict.fromkeys(("west", "east", "south", "north"), "m3")
    box = Polyhedron.shoebox(SIDES, {**walls, "floor": "m1", "ceiling": "m2"})
    assert np.allclose(facing(room(), box), AXES)
    turn = Rotation.from_euler("z", 30, degrees=True)
    turned = replace(box, vertices=turn.apply(np.array(box.vertices)))
    assert np.allclose(facing(room(), turned)[:2], AXES[:2])


@pytest.mark.parametrize(
    ("areas", "known"),
    [
        ([Z, Z, 2 * (X + Y)], [True, True, True]),
        ([Z, 12.0, Z + 2 * (X + Y) - 12.0], [True, False, False]),  # 12 m² anywhere
        ([X, Y, 2 * Z + X + Y], [True, True, True]),
        ([31.0, 47.0, 2 * (X + Y + Z) - 78.0], [False, False, False]),
        ([Z, Z, 4 * (X + Y)], [False, False, False]),  # not those of the box
    ],
)
def test_areas_are_matched_to_the_faces_of_the_box(areas, known):
    stated = room(dimensions=SIDES, areas=areas)
    assert np.isfinite(facing(stated)).all(axis=1).tolist() == known


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("Floor 2", "floor"),
        ("Holzfußboden", "floor"),
        ("deckenplatten_hinten", "ceiling"),
        ("pared norte", "wall"),
        ("Leinwand", None),
        ("solid wood", None),
        ("wall, ground floor", None),
        ("floor-to-ceiling curtain", None),
        ("floor and ceiling", "floor and ceiling"),
        ("", None),
    ],
)
def test_names_that_say_floor_ceiling_or_wall(name, kind):
    assert kind_of(name) == kind


def a_room(names, areas, **more):
    materials = {name: (area, 0.1, 0.02) for name, area in zip(names, areas, strict=True)}
    return room_of(materials, [1000], 60, **more)


def test_an_oblique_face_counts_by_its_normal():
    class Slope:
        materials = ("roof",)
        face_areas = np.array([10.0])
        normals = np.array([[0.6, 0.0, 0.8]])

    found = facing(a_room(["roof", "desk"], [10, 4]), Slope())
    assert found[0] == pytest.approx([0.36, 0, 0.64])
    assert np.isnan(found[1]).all()
