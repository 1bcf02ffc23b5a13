"""Which way surfaces face, from what a room states of it."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.directions import facing


def a_room(names, areas, **more) -> rt.Room:
    return rt.Room(
        name="box",
        volume=60,
        materials=names,
        areas=areas,
        alpha=[[0.1]] * len(names),
        sigma=[[0.02]] * len(names),
        centre_frequencies=[1000],
        **more,
    )


def test_a_box_says_the_same_by_mesh_by_axis_and_by_name() -> None:
    names = ["lino", "tile", "plaster"]
    room = a_room(names, [20, 20, 54])
    walls = dict.fromkeys(("west", "east", "south", "north"), "plaster")
    box = rt.simulators.Polyhedron.shoebox((4, 5, 3), {**walls, "floor": "lino", "ceiling": "tile"})
    by_mesh = facing(room, box)
    surfaces = [
        rt.Surface("s1", "lino", 20, "z"),
        rt.Surface("s2", "tile", 20, "z"),
        rt.Surface("s3", "plaster", 30, "x"),
        rt.Surface("s4", "plaster", 24, "y"),
    ]
    by_axis = facing(room.replace(surfaces=surfaces))
    named = a_room(["Floor", "suspended ceiling", "walls"], [20, 20, 54], dimensions=(4, 5, 3))
    expected = np.array([[0, 0, 1], [0, 0, 1], [30 / 54, 24 / 54, 0]])
    for found in (by_mesh, by_axis, facing(named)):
        assert found == pytest.approx(expected)
    # Without dimensions the walls are shared by halves.
    assert facing(named.replace(dimensions=None))[2] == pytest.approx([0.5, 0.5, 0])


def test_what_nothing_says_is_unknown() -> None:
    room = a_room(["lino", "plaster"], [20, 74])
    assert np.isnan(facing(room)).all()
    assert np.isnan(facing(room.replace(dimensions=(4, 5, 3)))).all()
    partly = [rt.Surface("a", "plaster", 30, "x"), rt.Surface("b", "plaster", 44)]
    found = facing(room.replace(surfaces=[*partly, rt.Surface("floor", "lino", 20)]))
    assert found[0].tolist() == [0, 0, 1]
    assert np.isnan(found[1]).all()
    # "floor" must stand for itself: neither a material that names both, nor a part of a word.
    both = a_room(["floor and ceiling edge", "walls of the floor"], [20, 74])
    assert facing(both)[0].tolist() == [0, 0, 1]
    assert np.isnan(facing(both)[1]).all()


def test_an_oblique_face_counts_by_its_normal() -> None:
    class Slope:
        materials = ("roof",)
        face_areas = np.array([10.0])
        normals = np.array([[0.6, 0.0, 0.8]])

    found = facing(a_room(["roof", "desk"], [10, 4]), Slope())
    assert found[0] == pytest.approx([0.36, 0, 0.64])
    assert np.isnan(found[1]).all()


def test_the_order_of_materials_and_surfaces_moves_nothing() -> None:
    names, areas = ["floor", "ceiling", "walls", "door"], [20, 20, 50, 4]
    room = a_room(names, areas, dimensions=(4, 5, 3))
    turned = a_room(names[::-1], areas[::-1], dimensions=(4, 5, 3))
    assert facing(turned)[::-1] == pytest.approx(facing(room), abs=1e-15)
