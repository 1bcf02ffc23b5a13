"""rtcal's own files for the fuzzers: good ones of each kind, how they are read, and what must hold."""

import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from rtcal.files import disk
from rtcal.files.disk import read_text
from rtcal.files.saved import MAX_BYTES, plain, restored
from rtcal.files.schema import json_object
from rtcal.finder import Case
from rtcal.finder.effects import AppliedEffect
from rtcal.loop import Loop, start
from rtcal.report import of_calibration
from rtcal.support.errors import DataError
from tests.test_discrepancy import opened

_ROOM, _MEASURED = rt.datasets.bras_cr2()

_SCENE = rt.Scene(
    mesh="room.obj",
    unit=0.001,
    sources={"S1": (1, 2, 1.5)},
    receivers={"R1": (4, 2.2, 1.2), "R 2": (5, 1, 1.2)},
    position_uncertainty=0.05,
    surfaces={"south wall": ("face 3", "face 7")},
)
ROOM = (
    _ROOM.to_text().encode(),
    _ROOM.replace(scene=_SCENE, scattering_model="vector", author="A. Consultant")
    .to_text()
    .encode(),
)
MEASURED = (_MEASURED.to_text().encode(),)


def room_holds(room: rt.Room) -> None:
    """A room's numbers are possible ones, and its text is the same room."""
    assert ((room.alpha >= 0) & (room.alpha <= 1)).all()
    assert (np.isfinite(room.sigma) & (room.sigma >= 0)).all()
    assert (np.isfinite(room.areas) & (room.areas > 0)).all()
    assert 0 < room.volume < np.inf
    again = rt.Room.from_text(room.to_text(), "again")
    assert {**again.to_dict(), **room.to_dict()} == again.to_dict()


def measurement_holds(measured: rt.Measurement) -> None:
    """No value is infinite, and the plain values are the same measurement."""
    for values in (*measured.values.values(), *measured.uncertainty.values()):
        assert not np.isinf(values).any()
    plain = measured.to_dict()
    assert rt.Measurement.from_dict(plain).to_dict() == plain


def _case() -> bytes:
    case = replace(opened(), applied=(AppliedEffect("opening", {"area": 2.0}, (1.0, 3.0)),))
    return case.to_json().encode()


CASE = (_case(),)
CASE_TOML = (
    b'room = "room.toml"\nequation = "sabine"\n[uncertainty]\ntime = 0.02\nlevel = 0.3\n'
    b'[[configuration]]\nname = "empty"\nmeasured = "measured.csv"\ndistances = [3.0]\n'
    b'[[configuration]]\nname = "planned"\nparameters = ["t20", "edt"]\npositions = 4\n'
    b"air = { temperature = 21, humidity = 60 }\nsuspect_removed = true\n"
    b'[configuration.changes."plaster"]\nalpha = [0.1, 0.1, 0.1, 0.1, 0.1, 0.1]\n'
    b"sigma = [0.1, 0.1, 0.1, 0.1, 0.1, 0.1]\n",
)
BESIDE_CASE = {"room.toml": ROOM[0], "measured.csv": MEASURED[0]}


def case_holds(case: Case) -> None:
    """Assert that a case holds what is possible, and that its text is the same case."""
    room_holds(case.room)
    for configuration in case.configurations:
        measurement_holds(configuration.measured)
    assert Case.from_dict(json.loads(case.to_json())).to_dict() == case.to_dict()


def _loop() -> Loop:
    loop = start(_ROOM, _MEASURED, decimals=3)
    for factor in (1.3, 1.1):
        times = factor * rt.Eyring().time(_ROOM, _ROOM.areas @ loop.next_alpha)
        simulated = rt.Measurement.from_values(_ROOM.centre_frequencies, t20=times)
        loop = loop.record(loop.next_alpha, simulated)
    return loop


_LOOP = _loop()
LOOP = (_LOOP.to_json().encode(), start(_ROOM, _MEASURED).to_json().encode())


def loop_holds(loop: Loop) -> None:
    """A state's targets and coefficients are possible, and its text is the same loop."""
    room_holds(loop.prior)
    for step in loop.steps:
        assert ((step.alpha >= 0) & (step.alpha <= 1)).all()
        assert not (step.target <= 0).any()
    if loop.steps:  # else there is no calibrated room yet
        room_holds(loop.room)
        assert len(loop.status) == loop.room.n_bands
    assert restored(plain(loop)).to_json() == loop.to_json()


RESULT = (
    rt.calibrate(_ROOM, _MEASURED).to_json().encode(),
    rt.calibrate(_ROOM.replace(air=None), _MEASURED, method="lse").to_json().encode(),
)


def read_objects(path: str) -> Any:
    """Read the plain objects of a result."""
    try:
        return restored(json_object(read_text(path, MAX_BYTES))["objects"])
    except KeyError as error:
        raise DataError(f"{path}: no objects") from error
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def result_holds(result: Any) -> None:
    """The page can say it."""
    assert of_calibration.page(result).blocks


OBJECTS = (json.dumps({"objects": plain(rt.calibrate(_ROOM, _MEASURED))}).encode(),)


RECORD = (b'{"sets": [{"command": "x", "whole": true, "files": {"a": "0"}}]}',)


def read_record(path: str) -> bytes:
    """Read a file in a folder whose record of written files this is."""
    folder = Path(path).parent / "folder"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    Path(path).rename(folder / disk.RECORD)
    (folder / "a").write_text("kept")
    try:
        return disk.read_bytes(folder / "a", 100)
    except DataError as error:
        if "was interrupted while it wrote" not in str(error):
            raise
        return b""


def _kept_array() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "kept.array"
        disk.write(place, np.arange(12.0).reshape(2, 6))
        return place.read_bytes()


KEPT_ARRAY = (_kept_array(),)


def read_kept_array(path: str) -> np.ndarray:
    """Read a file as an array that was kept under the name kept.array."""
    array = disk.read(Path(path).rename(Path(path).with_name("kept.array")))
    if array is None:
        raise DataError(f"{path}: computed again")
    return array


def kept_array_holds(array: np.ndarray) -> None:
    """Nothing but the good array is read."""
    np.testing.assert_array_equal(array, np.arange(12.0).reshape(2, 6))
