"""Meshes with a hole: what leaves, V and S by rays, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.io import geometry_files
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.path_tracing import MOST_LEAKED, Chords, by_chords
from rtcal.support.errors import DataError
from tests.conftest import run

SIDES = (9.0, 7.0, 3.2)
VOLUME = 9 * 7 * 3.2
AREA = 2 * (9 * 7 + 9 * 3.2 + 7 * 3.2)


def with_hole(side: float) -> list[tuple[str, str, np.ndarray]]:
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
def test_rays_say_how_large_hole_and_room_are(side: float) -> None:
    leaking = Polyhedron.from_polygons(with_hole(side), leaks=True)
    found = by_chords(leaking)
    drawn = AREA - side**2
    chance = np.sqrt(side**2 / drawn / 100_000)
    assert found.lost == pytest.approx(side**2 / drawn, abs=4 * chance)
    assert abs(found.area - AREA) < 4 * max(found.area_uncertainty, drawn / 100_000)
    assert abs(found.volume - VOLUME) < 3 * found.volume_uncertainty
    assert found.volume_uncertainty < 0.04 * VOLUME
    assert leaking.contains([(4, 3, 1.5), (4, 3, -1)]).tolist() == [True, False]


def test_rays_in_several_seeds_scatter_as_they_say() -> None:
    leaking = Polyhedron.from_polygons(with_hole(0.5), leaks=True)
    each = [by_chords(leaking, 5000, seed) for seed in range(40)]
    for value, u, true in (
        ([c.volume for c in each], [c.volume_uncertainty for c in each], VOLUME),
        ([c.area for c in each], [c.area_uncertainty for c in each], AREA),
    ):
        z = (np.array(value) - true) / np.array(u)
        assert abs(z.mean()) < 0.7
        assert 0.5 < z.std() < 1.5


def room(tmp_path: Path, side: float, *, leaks: bool) -> rt.Room:
    mesh = tmp_path / "box.obj"
    Polyhedron.from_polygons(with_hole(side), leaks=True).save(mesh)
    scene = rt.Scene(
        mesh=mesh, leaks=leaks, sources={"S1": (1, 1, 1.5)}, receivers={"R1": (7, 5, 1.2)}
    )
    return rt.Room(
        name="box",
        volume=VOLUME,
        materials=["wall", "floor"],
        areas=[AREA - 63, 63],
        alpha=[[0.1], [0.3]],
        sigma=[[0.02], [0.1]],
        centre_frequencies=[1000],
        scattering=[[0.3], [0.3]],
        scene=scene,
    )


def test_a_tracing_of_a_leaking_box_has_the_t_of_the_closed_one(tmp_path: Path) -> None:
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
def test_a_room_loses_the_paths_that_its_holes_foretell(tmp_path: Path, side: float) -> None:
    """At the least mean alpha that `Chords` states, a tracing is taken; at two thirds of it, not."""
    leaking = geometry_files.path_tracing(room(tmp_path, side, leaks=True), n_paths=4000)
    least = by_chords(leaking.geometry, 4_000_000).least_alpha
    leaking.simulate(np.full((2, 1), least))
    assert 0.5 * MOST_LEAKED < leaking.lost_share <= MOST_LEAKED
    with pytest.raises(DataError, match="at most 2 % may"):
        leaking.simulate(np.full((2, 1), least / 1.5))


def test_a_proposal_holds_in_every_band_of_a_room_that_its_ceiling_absorbs(tmp_path: Path) -> None:
    """All absorption on one surface, and little scattering: T is longer than Eyring's there."""
    one = room(tmp_path, 0.12, leaks=True)
    geometry = geometry_files.read(one)
    least = by_chords(geometry).least_alpha
    soft = (least * one.total_area - 0.02 * one.areas[0]) / one.areas[1]
    uneven = one.replace(
        alpha=[[0.02, least], [soft, least]],
        sigma=np.full((2, 2), 0.01),
        centre_frequencies=[125, 1000],
        scattering=np.full((2, 2), 0.1),
    )
    tracer = geometry_files.path_tracing(uneven, n_paths=4000)
    found = tracer.simulate(uneven.alpha)
    assert np.isfinite(found.values["t20"]).all()
    assert 0 < tracer.lost_share <= MOST_LEAKED


def test_a_mesh_taken_open_states_what_its_hole_leaves_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh, out = tmp_path / "box.obj", tmp_path / "room.toml"
    Polyhedron.from_polygons(with_hole(2.0), leaks=True).save(mesh)
    assert run("import", "check", mesh, "--open", "--json") == 0
    checked = json.loads(capsys.readouterr().out)
    assert [d["kind"] for d in checked["defects"]] == ["open hole"]
    assert checked["area_uncertainty"] == pytest.approx({"floor": 4 / np.sqrt(3)})
    assert sum(checked["areas"].values()) == pytest.approx(AREA - 4)
    materials = ["--catalogue", "floor=carpet_cotton", "--catalogue", "wall=hard_surface"]
    assert run("import", "catalogue", "--mesh", mesh, "--open", *materials, "--out", out) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "open hole: 1 left as drawn and not in S, 4 m²" in said
    assert "by what was mended and left open: floor to" in said
    made = rt.Room.from_file(str(out))
    row = made.materials.index("floor")
    assert made.area_sigma[row] * made.areas[row] == pytest.approx(4 / np.sqrt(3), rel=0.05)
    assert made.volume_sigma * made.volume == pytest.approx(checked["volume_uncertainty"], rel=0.05)


def test_closed_stays_the_default_and_large_holes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="the walls do not close"):
        geometry_files.path_tracing(room(tmp_path, 0.12, leaks=False))
    large = geometry_files.path_tracing(room(tmp_path, 1.0, leaks=True), n_paths=800)
    with pytest.raises(
        DataError, match=r"hit no wall, but at most 2 % may, .* import \.\.\. --open"
    ):
        large.simulate(large.room.alpha)
    with pytest.raises(DataError, match="leaks = true can be given only with a mesh"):
        rt.Scene(leaks=True)


def test_the_room_file_keeps_that_its_mesh_leaks(tmp_path: Path) -> None:
    stated = room(tmp_path, 0.12, leaks=True)
    stated.save(str(tmp_path / "room.toml"))
    assert "leaks = true" in (tmp_path / "room.toml").read_text()
    assert rt.Room.from_file(str(tmp_path / "room.toml")).scene.leaks
    assert "leaks" not in room(tmp_path, 0.12, leaks=False).to_text()


def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`import check` names the option, `import` takes it, and a missing wall is refused with it."""
    mesh, out = tmp_path / "box.obj", tmp_path / "room.toml"
    Polyhedron.from_polygons(with_hole(0.06), leaks=True).save(mesh)
    assert run("import", "check", mesh, "--hole", "0.001") == 2
    said = " ".join(capsys.readouterr().err.split())
    assert re.search(r"mean alpha of the room is at least 0\.0\d+ in every band", said)
    assert "less absorption in any band needs `rtcal import ... --open`" in said
    assert run("import", "check", mesh, "--hole", "0.001", "--leaks") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "open hole: 1 left as drawn and not in S, 0.0036 m²" in said
    assert "Defects: none" not in said
    options = ["--mesh", mesh, "--hole", "0.001", "--leaks", "--scattering", "0.3", "--out", out]
    materials = ["--catalogue", "floor=carpet_cotton", "--catalogue", "wall=hard_surface"]
    assert run("import", "catalogue", *options, *materials) == 0
    assert "taken with its holes: by rays V = " in capsys.readouterr().out
    made = rt.Room.from_file(str(out))
    assert made.scene.leaks
    assert geometry_files.read(made).leaks
    assert made.volume == pytest.approx(VOLUME, rel=0.01)
    hard = ["--catalogue", "floor=unpainted_concrete", "--catalogue", "wall=unpainted_concrete"]
    assert run("import", "catalogue", *options, *hard) == 2
    assert "the mean absorption coefficient is 0.01 at 125 Hz" in capsys.readouterr().err
    walls = [face for face in with_hole(0.06) if face[0] != "west"]
    Polyhedron.from_polygons(walls, leaks=True).save(mesh)
    assert run("import", "check", mesh, "--leaks") == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "because the holes are too large" in said
    assert (
        "whatever the absorption coefficients: the mesh cannot be traced. Use `rtcal import" in said
    )
    assert "is at least 1 " not in said
    assert run("import", "check", mesh, "--leaks", "--open") == 2
    assert "are both given" in capsys.readouterr().err


def test_chords_in_words() -> None:
    assert str(Chords(201.6, 0.4, 228.4, 0.02, 1e-4)).startswith(
        "by rays V = 201.6 ± 0.4 m³, S = 228.4"
    )
