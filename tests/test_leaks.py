"""Meshes with a hole: what leaves, V and S by rays, and what is refused."""

import json
import re

import numpy as np
import pytest

import rtcal as rt
from rtcal.io import geometry_files
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.path_tracing import MOST_LEAKED, by_chords
from rtcal.support.errors import DataError
from tests.conftest import room_of

SIDES = (9.0, 7.0, 3.2)
VOLUME = 9 * 7 * 3.2
AREA = 2 * (9 * 7 + 9 * 3.2 + 7 * 3.2)


def with_hole(side):
    """The faces of a box whose floor has a square hole."""
    box = Polyhedron.shoebox(
        SIDES, {w: w for w in ("west", "east", "south", "north", "floor", "ceiling")}
    )
    faces = [
        (n, "wall", box.vertices[list(f)])
        for n, f in zip(box.names, box.faces, strict=True)
        if n != "floor"
    ]
    x, y = 2.0, 3.0
    for i, (a, b, c, d) in enumerate(
        ((0, 0, 9, y), (0, y + side, 9, 7), (0, y, x, y + side), (x + side, y, 9, y + side))
    ):
        corners = np.array([[a, b, 0], [a, d, 0], [c, d, 0], [c, b, 0]], dtype=float)
        faces.append((f"floor {i}", "floor", corners))
    return faces


@pytest.mark.parametrize("side", [0.15, 0.5, 2.0])
def test_rays_say_how_large_hole_and_room_are(side):
    leaking = Polyhedron.from_polygons(with_hole(side), leaks=True)
    found = by_chords(leaking)
    drawn = AREA - side**2
    chance = np.sqrt(side**2 / drawn / 100_000)
    assert found.lost == pytest.approx(side**2 / drawn, abs=4 * chance)
    assert abs(found.area - AREA) < 4 * max(found.area_uncertainty, drawn / 100_000)
    assert abs(found.volume - VOLUME) < 3 * found.volume_uncertainty
    assert found.volume_uncertainty < 0.04 * VOLUME
    assert leaking.contains([(4, 3, 1.5), (4, 3, -1)]).tolist() == [True, False]


def room(tmp_path, side, *, leaks):
    mesh = tmp_path / "box.obj"
    Polyhedron.from_polygons(with_hole(side), leaks=True).save(mesh)
    scene = rt.Scene(
        mesh=mesh, leaks=leaks, sources={"S1": (1, 1, 1.5)}, receivers={"R1": (7, 5, 1.2)}
    )
    materials = {"wall": (AREA - 63, 0.1, 0.02), "floor": (63, 0.3, 0.1)}
    return room_of(materials, [1000], VOLUME, scattering=[[0.3], [0.3]], scene=scene)


def test_a_tracing_of_a_leaking_box_has_the_t_of_the_closed_one(tmp_path):
    leaking = geometry_files.path_tracing(room(tmp_path, 0.12, leaks=True), n_paths=4000)
    found = leaking.simulate(leaking.room.alpha)
    assert 0 < leaking.lost_share <= MOST_LEAKED
    closed = PathTracing(
        geometry=Polyhedron.shoebox(
            SIDES,
            {
                w: "floor" if w == "floor" else "wall"
                for w in ("west", "east", "south", "north", "floor", "ceiling")
            },
        ),
        room=leaking.room,
        sources=leaking.sources,
        receivers=leaking.receivers,
        n_paths=4000,
    ).simulate(leaking.room.alpha)
    noise = np.hypot(found.uncertainty["t20"], closed.uncertainty["t20"])
    assert (np.abs(found.values["t20"] - closed.values["t20"]) < 4 * noise).all()


@pytest.mark.parametrize("side", [0.12, 0.2])
def test_a_room_loses_the_paths_that_its_holes_foretell(tmp_path, side):
    """At the least mean alpha that `Chords` states, a tracing is taken; at two thirds of it, not."""
    leaking = geometry_files.path_tracing(room(tmp_path, side, leaks=True), n_paths=4000)
    least = by_chords(leaking.geometry, 4_000_000).least_alpha
    leaking.simulate(np.full((2, 1), least))
    assert 0.5 * MOST_LEAKED < leaking.lost_share <= MOST_LEAKED
    with pytest.raises(DataError, match="at most 2 % may"):
        leaking.simulate(np.full((2, 1), least / 1.5))


def test_a_mesh_taken_open_states_what_its_hole_leaves_unknown(tmp_path, rtcal):
    mesh, out = tmp_path / "box.obj", tmp_path / "room.toml"
    Polyhedron.from_polygons(with_hole(2.0), leaks=True).save(mesh)
    checked = json.loads(rtcal("import", "check", mesh, "--open", "--json"))
    assert [d["kind"] for d in checked["defects"]] == ["open hole"]
    assert checked["area_uncertainty"] == pytest.approx({"floor": 4 / np.sqrt(3)})
    assert sum(checked["areas"].values()) == pytest.approx(AREA - 4)
    materials = ["--catalogue", "floor=carpet_cotton", "--catalogue", "wall=hard_surface"]
    rtcal("import", "catalogue", "--mesh", mesh, "--open", *materials, "--out", out)
    made = rt.Room.from_file(str(out))
    row = made.materials.index("floor")
    assert made.area_sigma[row] * made.areas[row] == pytest.approx(4 / np.sqrt(3), rel=0.05)
    assert made.volume_sigma * made.volume == pytest.approx(checked["volume_uncertainty"], rel=0.05)


def test_closed_stays_the_default_and_large_holes_are_refused(tmp_path):
    with pytest.raises(DataError, match="the walls do not close"):
        geometry_files.path_tracing(room(tmp_path, 0.12, leaks=False))
    large = geometry_files.path_tracing(room(tmp_path, 1.0, leaks=True), n_paths=800)
    with pytest.raises(DataError, match="at most 2 % may"):
        large.simulate(large.room.alpha)
    with pytest.raises(DataError, match="leaks = True is of a mesh, but no mesh is given"):
        rt.Scene(leaks=True)


def test_commands(tmp_path, rtcal):
    """`import check` names the option, `import` takes it, and a missing wall is refused with it."""
    mesh, out = tmp_path / "box.obj", tmp_path / "room.toml"
    Polyhedron.from_polygons(with_hole(0.06), leaks=True).save(mesh)
    said = rtcal.refused("import", "check", mesh, "--hole", "0.001")
    assert re.search(r"mean alpha of the room is at least 0\.0\d+ in every band", said)
    said = rtcal("import", "check", mesh, "--hole", "0.001", "--leaks")
    assert "open hole: 1 left as drawn and not in S, 0.0036 m²" in said
    options = ["--mesh", mesh, "--hole", "0.001", "--leaks", "--scattering", "0.3", "--out", out]
    materials = ["--catalogue", "floor=carpet_cotton", "--catalogue", "wall=hard_surface"]
    assert "by rays V = " in rtcal("import", "catalogue", *options, *materials)
    made = rt.Room.from_file(str(out))
    assert made.scene.leaks
    assert geometry_files.read(made).leaks
    assert made.volume == pytest.approx(VOLUME, rel=0.01)
    hard = ["--catalogue", "floor=unpainted_concrete", "--catalogue", "wall=unpainted_concrete"]
    assert "0.01 at 125 Hz" in rtcal.refused("import", "catalogue", *options, *hard)
    walls = [face for face in with_hole(0.06) if face[0] != "west"]
    Polyhedron.from_polygons(walls, leaks=True).save(mesh)
    assert "because the holes are too large" in rtcal.refused("import", "check", mesh, "--leaks")
    assert "are both given" in rtcal.refused("import", "check", mesh, "--leaks", "--open")
