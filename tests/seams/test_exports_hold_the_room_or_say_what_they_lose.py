"""A law: what is written and read again is the same, or the export says what the file lacks."""

import dataclasses
import functools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.apply import corrected_geometry
from rtcal.io import bras, catt, geometry_files, odeon, pyroomacoustics, tables
from rtcal.report import of_positions
from rtcal.simulators import of_equation
from tests.conftest import also
from tests.test_where_corrected import candidate


def same(one, other):
    """Return whether two objects hold the same, arrays bit by bit."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return (
            one.dtype == other.dtype
            and one.shape == other.shape
            and one.tobytes() == other.tobytes()
        )
    if isinstance(one, float):
        return np.float64(one).tobytes() == np.float64(other).tobytes()
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return same(list(one.items()), list(other.items()))
    if dataclasses.is_dataclass(one):
        names = [f.name for f in dataclasses.fields(one)]
        return all(same(getattr(one, n), getattr(other, n)) for n in names)
    return bool(one == other)


FORMATS = {"catt": catt, "odeon": odeon, "pyroomacoustics": pyroomacoustics, "bras": bras}
OCTAVES = [63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0]
STATED = (Path(__file__).parents[1] / "native" / "everything.toml").read_text("utf-8")
"""A room that states everything that a room can, but a record."""
PERSONS = f"""
[[object]]
name = "persons"
number = 20
area_per_piece = {[0.5] * 8}
sigma = {[0.05] * 8}
"""


def stated(**others):
    return rt.Room.from_text(STATED, "everything.toml").replace(**others)


def peopled():
    """Return a room with persons, which are pieces and no surface."""
    return rt.Room.from_text(STATED + PERSONS, "everything.toml")


def calibrated():
    room = stated()
    times = rt.Eyring().reverberation_time(room) * 0.95
    return rt.calibrate(room, rt.Measurement.from_values(OCTAVES, t20=times)).room


def looped():
    room = stated(alpha=np.full((2, 8), 0.2))
    simulator = of_equation(rt.Sabine(), room)
    measured = rt.Measurement.from_values(
        OCTAVES, t20=0.95 * simulator.simulate(room.alpha).mean("t20")
    )
    return rt.calibrate_simulator(simulator, room, measured).room


@functools.cache
def fitted():
    """Return a fit of scattering that the prior does not state."""
    room = stated(scattering=None, scattering_model="random", alpha=np.full((2, 8), 0.2))
    tracer = geometry_files.path_tracing(room, scattering=0.1, n_paths=400)
    heard = geometry_files.path_tracing(room, scattering=0.5, n_paths=4000)
    seen = heard.observe(1.2 * room.alpha, ("t20", "edt"), seed=5)
    values = {name: seen.natural(name) for name in ("t20", "edt")}
    measured = rt.Measurement(centre_frequencies=OCTAVES, pairs=seen.pairs, values=values)
    result = rt.calibrate_positions(tracer, room, measured, ("t20", "edt"))
    assert result.scattering is not None
    return result


@functools.cache
def patched():
    ones = {"t20": np.ones((2, 8))}
    pairs = [("S1", "R1"), ("S1", "R2")]
    measured = rt.Measurement(centre_frequencies=OCTAVES, pairs=pairs, values=ones)
    case = rt.finder.case_of(stated(scattering_model="random"), measured, tracing={"n_paths": 800})
    return corrected_geometry(case, replace(candidate("floor", 4.0), spectrum=np.full(8, 0.8)))


ROOMS = {
    "stated": stated,
    "pieces": peopled,
    "calibrated": calibrated,
    "loop": looped,
    "fit": lambda: fitted().room,
    "patch": lambda: patched().room,
}
SAID = {
    "name": "name",
    "author": "author",
    **dict.fromkeys(("volume", "areas", "surfaces", "dimensions"), "areas and volume"),
    "sigma": "sigma",
    **dict.fromkeys(
        ("volume_sigma", "area_sigma", "common_area_sigma", "common_alpha_sigma", "climate_sigma"),
        "uncertainties of areas, volume and climate",
    ),
    "alpha_min": "alpha_min",
    "band_correlation": "correlations",
    "material_correlation": "correlations",
    "air": "air",
    "scene": "sources and receivers",
    "scattering": "scattering",
    "scattering_model": "what scattering means",
    "sources": "where coefficients are from",
    "clipped": "coefficients that were above 1",
    "calibration": "the record of the calibration",
}
"""What a report says of a field that the file does not hold."""


def test_the_rooms_state_everything():
    """The law rests on it: a field that comes later is stated here, too."""
    usual = {f.name: f.default for f in dataclasses.fields(rt.Room)}
    for room in (stated(), calibrated()):
        not_stated = {n for n, value in usual.items() if same(getattr(room, n), value)}
        # Simulators and loops take no pieces: a room of its own states them.
        assert not_stated <= {"pieces"} | ({"calibration"} if room.calibration is None else set())
    assert stated().scene
    assert peopled().pieces


def differing(one, other):
    names = [f.name for f in dataclasses.fields(rt.Room)]
    return {n for n in names if not same(getattr(one, n), getattr(other, n))}


@pytest.mark.parametrize("kind", ROOMS)
def test_the_native_file_holds_everything(kind, tmp_path):
    room = ROOMS[kind]()
    room.save(str(tmp_path / "room.toml"))
    assert differing(rt.Room.from_file(str(tmp_path / "room.toml")), room) == set()
    assert differing(rt.Room.from_dict(json.loads(json.dumps(room.to_dict()))), room) == set()


LISTS = Path(__file__).parents[1] / "lists"
"""Lists of the two materials as each program has them, with and without scattering."""


@pytest.mark.parametrize("kind", ["stated", "fit", *also("calibrated", "loop", "patch")])
@pytest.mark.parametrize("given", ["new", "without scattering", "with scattering"])
@pytest.mark.parametrize("name", FORMATS)
def test_a_list_holds_what_it_does_not_say(name, given, kind, tmp_path):
    module, room, path = FORMATS[name], ROOMS[kind](), tmp_path / "out"
    if name == "catt" and " " in "".join(room.materials):
        room = room.replace(materials=[m.replace(" ", "_") for m in room.materials], surfaces=())
    if given != "new" and kind == "patch":
        pytest.skip("no list has the patch's material")
    template = None if given == "new" else LISTS / f"{name} {given}"
    report = module.write(room, path, template=template)
    read = module.read(path)
    frequencies = read.materials[0].centre_frequencies
    others = dict.fromkeys(room.materials, 1.0)
    again = read.room(name="another", volume=500.0, areas=others, scattering=None)
    said = " ".join(str(report).split())
    lost = said.split("The file cannot hold ")[1]
    assert (
        differing(again, report.room) - {n for n, words in SAID.items() if words in lost} == set()
    )
    missing = set(room.centre_frequencies) - set(frequencies)
    assert set(report.bands_not_written) == missing
    assert missing == set() or "does not have the bands 63 Hz" in said
    shared = [list(room.centre_frequencies).index(f) for f in frequencies]
    off = {n: getattr(again, n) for n in ("alpha", "scattering")}
    for field, values in off.items():
        if values is None:
            assert f"The file cannot hold {field}," in said
        else:
            assert np.abs(values - getattr(room, field)[:, shared]).max() <= 0.00051
    assert ("count the measurement twice" in said) == (room.calibration is not None)
    if kind == "fit" and again.scattering is not None:
        assert np.abs(again.scattering - 0.1).max() > 0.02  # fitted, not what it began with


def test_the_page_of_a_fit_names_the_command_that_made_it():
    result = replace(fitted(), tracer=replace(fitted().tracer, scattering_model="vector"))
    assert "--scattering-model" not in str(of_positions.command(result))
    kept = replace(result, scattering=None)
    assert "--scattering-model vector" in str(of_positions.command(kept))


def test_a_patchs_folder_holds_the_mesh_and_its_surfaces(tmp_path):
    made = patched()
    made.save(tmp_path)
    room = rt.Room.from_file(str(tmp_path / "room.toml"))
    assert differing(room, made.room) == {"scene"}
    mesh = geometry_files.read(room)
    assert (mesh.names, mesh.materials) == (made.geometry.names, made.geometry.materials)
    np.testing.assert_array_equal(mesh.vertices, made.geometry.vertices)
    stated = made.case.room.scene
    for field in ("sources", "receivers", "position_uncertainty"):
        assert getattr(room.scene, field) == getattr(stated, field)
    assert same(room.scene.directivity, stated.directivity)
    again = rt.finder.case_of(room, made.case.measured)
    whole = dict(made.case.areas)
    assert again.areas.keys() == {*whole, made.material}
    assert again.areas["floor"] == pytest.approx(whole.pop("floor") - 4.0, rel=1e-6)
    assert {n: again.areas[n] for n in whole} == pytest.approx(whole, rel=1e-9)
    for name, report in made.reports.items():
        words = {SAID[n] for n in SAID if n not in ("dimensions", "clipped", "scattering", "scene")}
        assert {"mesh", "sources and receivers"} <= {*report.lost}
        assert words - {"what scattering means", SAID["calibration"]} <= set(report.lost), name


@pytest.mark.parametrize("ending", ["csv", "xlsx"])
def test_a_measurement_is_read_back(ending, tmp_path):
    rng = np.random.default_rng(3)
    values = {n: rng.uniform(0.5, 2.0, (3, 8)) for n in ("t20", "edt")} | {
        "d50": rng.random((3, 8))
    }
    values["t20"][1, 2] = np.nan
    measured = rt.Measurement(
        centre_frequencies=OCTAVES,
        values=values,
        pairs=[("S1", "R1"), ("S1", "R1#2"), ("S1", "R2")],
        uncertainty={"t20": np.where(np.isnan(values["t20"]), np.nan, 0.05)},
        common_uncertainty={"edt": rng.uniform(0.01, 0.02, 8)},
    )
    tables.write(measured, tmp_path / f"t.{ending}")
    again = tables.measurement(tmp_path / f"t.{ending}").measurement
    if ending == "csv":
        assert same(again, measured)
    assert again.pairs == measured.pairs
    for field in ("values", "uncertainty", "common_uncertainty"):
        one, other = getattr(again, field), getattr(measured, field)
        assert one.keys() == other.keys()
        for name in other:  # a workbook keeps 16 digits
            np.testing.assert_allclose(one[name], other[name], rtol=1e-15)


def apart(names, **rows):
    """Return a room of the named materials, all alike but for the rows that are given."""
    shape = (len(names), 6)
    return rt.Room(
        name="two names",
        volume=200.0,
        materials=names,
        areas=[40.0 + 10 * i for i in range(len(names))],
        sigma=np.full(shape, 0.05),
        centre_frequencies=OCTAVES[1:7],
        **{"alpha": np.full(shape, 0.2), "scattering": np.full(shape, 0.1)} | rows,
    )


@pytest.mark.parametrize("parted", [("alpha",), ("scattering",), ("alpha", "scattering")])
@pytest.mark.parametrize("scattering", [b"", b" L <15 15 15 15 15 15>"])
def test_two_names_of_one_material_hold_the_rooms_values(scattering, parted, tmp_path):
    """An alias of CATT that the room has otherwise gets values of its own."""
    path, names = tmp_path / "list.geo", ["floor", "door", "walls"]
    given = b"ABS floor = <10 20 30 40 50 60>" + scattering + b" {1 2 3}\r\n"
    path.write_bytes(given + b"ABS walls = floor ; brick\r\nABS door = floor\r\n")
    other = np.repeat([[0.2], [0.2], [0.3]], 6, axis=1)
    room = apart(names, **dict.fromkeys(parted, other))
    catt.write(room, path)
    read = catt.read(path)
    again = read.room(
        name="two names",
        volume=200.0,
        areas=dict(zip(names, room.areas, strict=True)),
        scattering=None,
    )
    np.testing.assert_allclose(again.alpha, room.alpha, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.scattering, room.scattering, rtol=0, atol=1e-12)
    assert b"> {1 2 3} ; brick\r\n" in path.read_bytes()
