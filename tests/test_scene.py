"""The scene that a room's file states: mesh, sources, receivers, and what scattering means."""

from pathlib import Path

import numpy as np

import rtcal as rt
from tests.conftest import room_of

STATED = rt.Scene(
    mesh="meshes/room.obj",
    unit=0.001,
    sources={"S1": (1, 2, 1.5), 'Bühne "links"': (3, 2, 1.5)},
    receivers={"R1": [4, 2.2, 1.2]},
    position_uncertainty=0.05,
    surfaces={"south wall": ["face 3", "face 7"]},
)


def room(**stated):
    return room_of(
        {"floor": (20, 0.4, 0.1), "rest": (74, 0.6, 0.1)},
        [1000],
        60,
        scattering=[[0.3], [0.2]],
        sources={"floor": "a book"},
        **stated,
    )


def test_the_mesh_is_the_same_file_wherever_the_room_is_saved(tmp_path, monkeypatch):
    (tmp_path / "project").mkdir()
    (tmp_path / "project" / "fitted").mkdir()
    stated = room(scene=STATED)
    (tmp_path / "project" / "room.toml").write_text(stated.to_text(), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for folder in (Path("project"), tmp_path / "project"):
        read = rt.Room.from_file(str(folder / "room.toml"))
        assert Path(read.scene.mesh or "") == folder / "meshes" / "room.obj"
        read.save(str(folder / "fitted" / "room.toml"))
        text = (folder / "fitted" / "room.toml").read_text(encoding="utf-8")
        assert 'mesh = "../meshes/room.obj"' in text
        again = rt.Room.from_file(str(folder / "fitted" / "room.toml")).scene.mesh
        assert Path(again or "").resolve() == tmp_path / "project" / "meshes" / "room.obj"


def test_a_path_tracer_takes_the_meaning_of_scattering_from_its_room():
    hall = rt.datasets.halls.lecture_hall()
    stated = hall.room.replace(scattering_model="vector")
    places = {"geometry": hall.geometry, "sources": hall.sources, "receivers": hall.receivers}
    tracing = rt.simulators.PathTracing
    assert tracing(room=stated, **places).scattering_model == "vector"
    assert tracing(room=hall.room, **places).scattering_model == "random"
    assert tracing(room=stated, scattering_model="random", **places).scattering_model == "random"
    np.testing.assert_array_equal(tracing(room=stated, **places).scattering, stated.scattering)
