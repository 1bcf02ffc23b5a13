"""A room's areas and its mesh are two statements of one room: every entrance says where they differ."""

import re

import numpy as np
import pytest

import rtcal as rt
from rtcal.datasets.examples import example
from rtcal.io import geometry_files
from rtcal.support.errors import DataError
from tests.conftest import measurement_of, run


@pytest.fixture
def files(tmp_path):
    for name, content in example("where").files.items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def larger_floor(files):
    """Give the floor 86 m² in the room's file, and return the file's path."""
    path = files / "room.toml"
    stated = path.read_text()
    assert stated.count("area = 56.0") == 2
    path.write_text(stated.replace("area = 56.0", "area = 86.0", 1))
    return str(path)


def test_calibrate_says_where_an_area_is_not_the_meshs(files, capsys):
    assert run("calibrate", files / "room.toml", files / "pairs.csv") == 0
    assert capsys.readouterr().err == ""
    said = "parquet has 86 m², but 56 m² in the geometry"
    room = larger_floor(files)
    assert run("calibrate", room, files / "pairs.csv") == 0
    assert said in capsys.readouterr().err
    # A path tracing of the same file says the same.
    tracer = geometry_files.path_tracing(rt.Room.from_file(room), n_paths=160)
    assert said in tracer.notes[0]


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("S1", 'source "S1" and receiver "R1" are at the same point'),
        ("99, 1, 1", 'receiver "R1" = (99, 1, 1) m is outside the room'),
    ],
)
def test_a_position_that_cannot_be_is_refused_before_anything_is_simulated(
    files, rtcal, place, said
):
    path = files / "room.toml"
    scene = rt.Room.from_file(str(path)).scene
    of_source = ", ".join(f"{x:g}" for x in scene.sources["S1"])
    point = of_source if place == "S1" else place
    path.write_text(re.sub(r"(?m)^R1 = .*$", f"R1 = [{point}]", path.read_text()))
    for command in ("fit", "find"):
        assert said in rtcal.refused(command, path, files / "pairs.csv")
        assert not (files / ".rtcal_cache").exists()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('mesh = "room.obj"', 'mesh = "room.obj"\nunit = 0.001', "179 m³ in m (unit = 1)"),
        ('mesh = "room.obj"', 'mesh = "room.obj"\nunit = 0.3048', "with unit = 1 in [geometry]"),
        ("volume = 179.20000000000002", "volume = 179200", "volume = 1.792e+05 m³ is 1000 times"),
        (r"area = ([\d.]+)", r"area = \g<1>e2", 'area of "parquet" = 5600 m² is 100 times'),
        ("area = 12.8", "area = 128", 'area of "glass" = 128 m² is 10 times the 12.8 m²'),
    ],
)
def test_another_unit_between_room_and_mesh_is_refused(files, rtcal, old, new, said):
    """A wrong unit or decimal point: no figure that follows from it could be right."""
    path = files / "room.toml"
    text = path.read_text()
    changed = re.sub(old, new, text)
    assert changed != text
    path.write_text(changed)
    made = ["--out", str(files / "made")]
    commands = {
        "calibrate": made,
        "fit": made,
        "find": made,
        "predict": ["--change", str(path), *made],
        "loop start": ["--state", str(files / "state.json"), *made],
    }
    for command, options in commands.items():
        assert said in rtcal.refused(*command.split(), path, files / "pairs.csv", *options)
        assert not (files / "made").exists()


# `tracing` belongs to a search that traces the room's scene, and is refused elsewhere

TRACING = {"n_paths": 300, "scattering": 0.3}


@pytest.fixture
def scene(tmp_path):
    """A room with a scene, a measurement of each pair, and its mean."""
    for name, content in example("where").files.items():
        (tmp_path / name).write_bytes(content)
    room = rt.Room.from_file(tmp_path / "room.toml")
    pairs = [(s, r) for s in room.scene.sources for r in room.scene.receivers]
    times = np.tile(np.linspace(0.8, 0.6, room.n_bands), (len(pairs), 1))
    of_pairs = measurement_of(room.centre_frequencies, pairs, t20=times)
    return room, of_pairs, rt.Measurement.from_values(room.centre_frequencies, t20=times[0])


def test_it_is_refused_elsewhere_and_why_is_true(scene):
    room, of_pairs, mean = scene
    bare = room.replace(scene=type(room.scene)())
    simulator = rt.finder.case_of(room, of_pairs, tracing=TRACING)
    needs = (
        "^tracing needs positions: a room with sources and receivers, and a measurement with values"
    )
    for stated, measured in ((room, mean), (bare, of_pairs), (bare, mean)):
        for before in (None, measured):
            with pytest.raises(DataError, match=needs) as refused:
                rt.find(stated, measured, before=before, tracing=TRACING)
            assert ("before and after" in str(refused.value)) == (before is not None)
    with pytest.raises(DataError, match=r"^tracing and simulator are both given"):
        rt.find(room, of_pairs, simulator.simulator, tracing=TRACING)
    with pytest.raises(DataError, match="tracing cannot be given with a case"):
        rt.find(simulator, tracing=TRACING)
