"""A law: room -> program's file -> room is the same room, or the export says what it lost."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.io import bras, catt, odeon, pyroomacoustics
from rtcal.support.errors import DataError

FORMATS = {"catt": catt, "odeon": odeon, "pyroomacoustics": pyroomacoustics, "bras": bras}
OCTAVES = [63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0]
NAMES = ["floor", "walls"]
AREAS = {"floor": 40.0, "walls": 150.0}


def calibrated(bands: list[float], *, scattering: bool = True) -> rt.Room:
    """Return a calibrated room that states everything that a room can."""
    rng = np.random.default_rng(7)
    shape = (2, len(bands))
    room = rt.Room(
        name="hall",
        volume=200.0,
        materials=NAMES,
        areas=list(AREAS.values()),
        alpha=rng.uniform(0.1, 0.4, shape),
        sigma=np.full(shape, 0.05),
        alpha_min=np.full(shape, 0.01),
        scattering=rng.uniform(0.05, 0.6, shape) if scattering else None,
        centre_frequencies=bands,
        air=rt.Air(),
        band_correlation=0.3,
        material_correlation={("floor", "walls"): 0.2},
        sources={"floor": "laboratory"},
    )
    times = rt.Eyring().reverberation_time(room) * 0.95
    measured = rt.Measurement.from_values(bands, t20=times)
    return rt.calibrate(room, measured).room


def bands_of(name: str) -> list[float]:
    return OCTAVES[1:7] if name == "catt" else OCTAVES


def template(name: str, folder: Path, kind: str) -> Path | None:
    """Return a list of the two materials as a program has it, or None for a new list."""
    if kind == "new":
        return None
    with_scattering = kind == "with scattering"
    path = folder / f"given.{name}"
    flat = {
        "catt": "ABS floor = <1 2 3 4 5 6>{s} {{9 9 9}}\r\nABS walls = <6 5 4 3 2 1>{s}\r\n",
        "odeon": "101 floor\r\n" + "\t0.1" * 8 + "\r\n102 walls\r\n" + "\t0.2" * 8 + "\r\n",
        "bras": "material," + ",".join(f"{f:g}" for f in OCTAVES) + "\nfloor" + ",0.1" * 8
        + "\nwalls" + ",0.2" * 8 + "\n",
    }  # fmt: skip
    if name == "pyroomacoustics":
        numbers = {n: {"description": "", "coeffs": [0.2] * 8} for n in NAMES}
        data: dict[str, Any] = {"center_freqs": OCTAVES, "absorption": {"mine": numbers}}
        if with_scattering:
            data["scattering"] = {"mine": numbers}
        path.write_text(json.dumps(data), encoding="utf-8")
    elif name == "catt":
        text = flat[name].format(s=" L <10 10 10 10 10 10>" if with_scattering else "")
        path.write_bytes(text.encode())
    else:
        path.write_bytes(flat[name].encode())
    return path


@pytest.mark.parametrize("kind", ["new", "without scattering", "with scattering"])
@pytest.mark.parametrize("name", FORMATS)
def test_what_is_written_is_read_and_what_is_not_is_said(
    name: str, kind: str, tmp_path: Path
) -> None:
    module: ModuleType = FORMATS[name]
    room = calibrated(bands_of(name))
    path = tmp_path / "out"
    report = module.write(room, path, template=template(name, tmp_path, kind))
    again = module.read(path).room(
        name="hall", volume=200.0, areas=AREAS, centre_frequencies=bands_of(name), air=room.air
    )
    np.testing.assert_array_equal(again.alpha, report.room.alpha)
    assert np.abs(again.alpha - room.alpha).max() <= 0.00051
    said = " ".join(str(report).split())
    held = name == "catt" or (name == "pyroomacoustics" and kind != "without scattering")
    assert (again.scattering is not None) == held
    assert (report.room.scattering is None) == (again.scattering is None)
    if held:
        np.testing.assert_array_equal(again.scattering, report.room.scattering)
        assert np.abs(again.scattering - room.scattering).max() <= 0.00051
    assert ("Not in the file: scattering," in said) == (not held)
    # Whatever else the room states and the file's room lacks stands in the report.
    lost = said.split("Not in the file:")[1]
    for words, attribute in (
        ("alpha_min", "alpha_min"),
        ("correlations", "band_correlation"),
        ("record of the calibration", "calibration"),
    ):
        assert not getattr(again, attribute)
        assert words in lost
    for words in ("sigma", "sources", "air", "areas and volume"):
        assert words in lost
    assert "would count them twice" in said


@pytest.mark.parametrize("name", FORMATS)
def test_nothing_is_lost_in_silence_that_is_not_stated(name: str, tmp_path: Path) -> None:
    """A report names only what the room has."""
    bands = bands_of(name)
    plain = rt.Room(
        name="plain",
        volume=200.0,
        materials=NAMES,
        areas=list(AREAS.values()),
        alpha=np.full((2, len(bands)), 0.2),
        sigma=np.full((2, len(bands)), 0.05),
        centre_frequencies=bands,
    )
    report = FORMATS[name].write(plain, tmp_path / "out")
    assert report.lost == ("areas and volume", "sigma")


def test_the_own_bytes_of_a_list_stay(tmp_path: Path) -> None:
    given = template("catt", tmp_path, "without scattering")
    assert given is not None
    catt.write(calibrated(bands_of("catt")), tmp_path / "out", template=given)
    written = (tmp_path / "out").read_bytes()
    first, second = written.split(b"\r\n")[:2]
    assert first.endswith(b"> {9 9 9}")
    assert b"> L <" in first
    assert second.endswith(b">")


def test_a_single_material_of_bras_gets_its_scattering(tmp_path: Path) -> None:
    given = tmp_path / "floor.csv"
    given.write_text("125, 250\n0.1, 0.2\n0.1, 0.1\n", encoding="utf-8")
    room = rt.Room(
        name="one",
        volume=20.0,
        materials=["floor"],
        areas=[50.0],
        alpha=[[0.3, 0.4]],
        sigma=[[0.1, 0.1]],
        scattering=[[0.5, 0.6]],
        centre_frequencies=[125, 250],
    )
    bras.write(room, given)
    assert given.read_text(encoding="utf-8") == "125, 250\n0.300, 0.400\n0.500, 0.600\n"


def test_two_names_of_one_material_agree_in_scattering(tmp_path: Path) -> None:
    path = tmp_path / "list.geo"
    path.write_bytes(b"ABS floor = <10 20 30 40 50 60>\r\nABS walls = floor\r\n")
    bands = bands_of("catt")
    room = rt.Room(
        name="two names",
        volume=200.0,
        materials=NAMES,
        areas=list(AREAS.values()),
        alpha=np.full((2, 6), 0.2),
        sigma=np.full((2, 6), 0.05),
        scattering=[[0.1] * 6, [0.2] * 6],
        centre_frequencies=bands,
    )
    with pytest.raises(DataError, match="is the same material"):
        catt.write(room, path)
