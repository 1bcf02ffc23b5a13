"""Every kind of result is written to a folder and read back bit by bit, with its data and methods."""

from __future__ import annotations

import dataclasses
import functools
import json
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.loop.control_runs import ControlRuns
from rtcal.simulators import EquationSimulator, PathTracing
from rtcal.support import results
from rtcal.support.errors import DataError
from rtcal.support.results import NUMBERS, Result
from tests.test_positions import HALL, MATCH, heard, tracing
from tests.test_where_page import finding_of, verification_of
from tests.typed import types_by_attribute, wrongly_typed


def same(one: Any, other: Any) -> bool:
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
    if isinstance(one, Mapping):
        return same(list(one.items()), list(other.items()))
    if dataclasses.is_dataclass(one):
        names = [f.name for f in dataclasses.fields(one) if f.metadata != results.NOT_SAVED]
        return all(same(getattr(one, n), getattr(other, n)) for n in names)
    if isinstance(one, functools.partial):
        return same((one.func, one.args, one.keywords), (other.func, other.args, other.keywords))
    if isinstance(one, types.MethodType):
        return same((one.__self__, one.__name__), (other.__self__, other.__name__))
    return bool(one == other)


def back(result: Result, folder: Path) -> Any:
    """Return a result after it was saved and loaded; what it says and holds must be the same.

    And every attribute is of the type that its class states.
    """
    assert wrongly_typed(result) == []
    result.save(folder)
    again = rt.load(folder)
    assert same(again, result)
    assert str(again) == str(result)
    numbers, as_before = (json.loads(r.to_json()) for r in (again, result))
    del numbers["object"], as_before["object"]
    assert numbers == as_before
    return again


def test_a_comparison_sees_one_bit() -> None:
    """The other tests rest on it."""
    result = rt.calibrate(*rt.datasets.bras_cr2())
    other = dataclasses.replace(result.joint, measured_times=())
    assert same(result.joint, result.joint)
    assert not same(result.joint, other)
    changed = result.alpha.copy()
    changed[0, 0] = np.nextafter(changed[0, 0], 1)
    assert same(result.alpha, result.alpha.copy())
    assert not same(result.alpha, changed)


@pytest.mark.parametrize("method", ["mle", "lse", "soft", "smooth", "robust"])
def test_calibrations_are_read_back(method: str, tmp_path: Path) -> None:
    room, measured = rt.datasets.bras_cr2()
    result = rt.calibrate(room, measured, method=method)
    again = back(result, tmp_path)
    for name in ("alpha", "posterior_sigma", "gap_after", "multipliers"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))
    assert again.room.to_text() == result.room.to_text()


def test_joint_calibrations_are_read_back(tmp_path: Path) -> None:
    room, measured = rt.datasets.bras_cr2()
    rooms = rt.Configurations([room, room.replace(name="larger", volume=1.02 * room.volume)])
    terms = rt.terms.PriorDeviation() + rt.terms.SoftMatch(0.03)
    times = rt.calibrate(room, measured).measured
    result = rt.Calibration(terms).build(rooms).solve([times, 1.02 * times])
    again = back(result, tmp_path)
    np.testing.assert_array_equal(again.results[1].alpha, result.results[1].alpha)


def test_loops_are_read_back(tmp_path: Path) -> None:
    room, measured = rt.datasets.bras_cr2()
    simulator = EquationSimulator(rt.Kuttruff(path_variance=0.9), room)
    result = rt.calibrate_simulator(simulator, room, measured, rule="secant")
    again = back(result, tmp_path)
    assert (
        again.loop.next_alpha.tobytes() == result.loop.next_alpha.tobytes()
    )  # it still calibrates


def test_studies_are_read_back(tmp_path: Path) -> None:
    result = rt.studies.run([60, 74, 20.0], 0.05, realisations=50, trials=20, seed=1)
    assert back(result, tmp_path).scores().tobytes() == result.scores().tobytes()


def test_positions_are_read_back(tmp_path: Path) -> None:
    pytest.importorskip("numba", reason="the paths are traced by compiled code (extra fast)")
    room = HALL.room.replace(sigma=0.3 * HALL.room.alpha)
    measured = heard(room, room.alpha, n_paths=2000)
    simulator = tracing(room)
    shape = (4, len(MATCH), len(simulator.pairs), room.n_bands)
    errors = 0.1 * np.random.default_rng(1).normal(size=shape)
    runs = ControlRuns(parameters=MATCH, pairs=simulator.pairs, errors=errors)
    result = rt.calibrate_positions(
        simulator, room, measured, match=MATCH, controls=runs, fit_scattering=False
    )
    again = back(result, tmp_path)
    assert isinstance(again.tracer, PathTracing)
    np.testing.assert_array_equal(again.pulls, result.pulls)
    rt.report.pages.page_of(tmp_path)


def test_findings_are_read_back(tmp_path: Path, kept: Path) -> None:
    case, _ = rt.datasets.hidden_room()
    finding = rt.find(case, cache=kept)
    again = back(finding, tmp_path / "finding")
    assert again.apply().to_json() == finding.apply().to_json()
    back(rt.finder.verify(finding), tmp_path / "verification")
    back(rt.finder.recalibrate(finding.apply()), tmp_path / "recalibrated")
    back(rt.finder.plan(case), tmp_path / "plan")


def test_findings_in_a_geometry_are_read_back(tmp_path: Path) -> None:
    pytest.importorskip("numba", reason="the paths are traced by compiled code (extra fast)")
    finding = finding_of({"wall 5": 0.6, "ceiling": 0.4})
    again = back(finding, tmp_path / "finding")
    assert again.case.faces.keys() == finding.case.faces.keys()
    gaps = {"before": 3.0, "plain": 2.0, "corrected": 1.0}
    back(verification_of(finding, gaps), tmp_path / "verification")


def test_what_no_file_can_hold_is_said(tmp_path: Path) -> None:
    """A user's own simulator is code; the numbers are still written, and loading says why."""
    room, measured = rt.datasets.bras_cr2()
    result = rt.calibrate(room, measured)
    object.__setattr__(result.joint, "method", lambda: None)
    with pytest.raises(DataError, match=r"cannot be saved: .*function is no dataclass of rtcal"):
        result.save(tmp_path)
    assert not list(tmp_path.iterdir())


BROKEN = [
    ("objects", 0, "class", "os.system", "is no class that rtcal saves"),
    ("objects", 0, "class", "rtcal.support.files.write_text", "is no class that rtcal saves"),
    ("objects", 0, "class", "rtcal.acoustics.air.Wind", "is no class that rtcal saves"),
    ("objects", 0, "fields", {"depth": 1.0}, "calculate the result again"),
    ("arrays", 0, "type", "|O", "no type of numbers"),
    ("arrays", 0, "shape", [-1], "is no array"),
    ("arrays", 0, "bytes", "AAAA", "arrays[0]"),
]


@pytest.mark.parametrize(("table", "row", "key", "value", "said"), BROKEN)
def test_what_was_changed_is_refused(table, row, key, value, said) -> None:
    record = json.loads(rt.calibrate(*rt.datasets.bras_cr2()).to_json())["object"]
    record[table][row][key] = value
    content = {name: record[name] for name in ("objects", "arrays", "value")}
    with pytest.raises(DataError) as caught:
        results.decode(content)
    assert said in str(caught.value)


def test_a_field_that_came_later_has_its_default() -> None:
    """Results of positions were saved before they had `held_out`."""
    content = results.encode(rt.datasets.bras_cr2()[0])
    fields = content["objects"][-1]["fields"]
    del fields["author"]
    assert results.decode(content).author == ""
    del fields["volume"]
    with pytest.raises(DataError, match=r"Room has the fields .* calculate the result again"):
        results.decode(content)


def test_a_changed_file_is_refused(tmp_path: Path) -> None:
    path = rt.calibrate(*rt.datasets.bras_cr2()).save(tmp_path)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"method": "mle"', '"method": "lse"'), encoding="utf-8")
    with pytest.raises(DataError, match="was changed") as caught:
        rt.load(tmp_path)
    assert str(path) in str(caught.value)
    for content, said in (
        ("{}", "no saved result"),
        ("[", "not JSON"),
        ("[1]", "not a JSON object"),
    ):
        path.write_text(content)
        with pytest.raises(DataError, match=said):
            rt.load(path)
    rt.datasets.hidden_room()[0].save(str(path))
    with pytest.raises(DataError, match=r"but a case: rtcal\.finder\.Case"):
        rt.load(path)
    for name, reader in (("a.csv", "Measurement.from_file"), ("a.toml", "Room.from_file or")):
        with pytest.raises(DataError, match=rf"{name}: no saved result but a .*{reader}"):
            rt.load(tmp_path / name)
    path.unlink()
    with pytest.raises(DataError, match=f"has no {NUMBERS}"):
        rt.load(tmp_path)


@pytest.mark.parametrize("kind", ["finding 1", "several effects 1", "where 1", "verification 1"])
def test_a_kind_that_went_says_what_to_do(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps({"rtcal": kind, "object": {}}), encoding="utf-8")
    with pytest.raises(DataError, match=f'"{kind}" of an earlier version.*search again with rtcal'):
        rt.load(tmp_path)


@pytest.mark.parametrize(
    ("name", "own", "shared"),
    [
        ("Finding", {"case"}, {"verdict", "family", "effect", "size", "sets", "detection"}),
        ("Verification", {"finding"}, {"verdict", "sentence", "before", "after", "gaps"}),
    ],
)
def test_every_kind_has_one_type_for_one_name(name: str, own: set[str], shared: set[str]) -> None:
    """A name has one type, but that of what was searched, or found.

    `finding.parameters` was a mapping of numbers, or a tuple of names, by what was measured; `before`
    of a verification a number, or the gaps of the model as it is stated, or those of no change.
    """
    finder = rt.finder
    types = types_by_attribute(
        getattr(finder, f"Means{name}"),
        getattr(finder.positions, f"Positions{name}"),
        getattr(finder.states, f"States{name}"),
    )
    assert {n for n, stated in types.items() if len(stated) > 1} == own
    assert shared <= types.keys()
