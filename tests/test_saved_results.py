"""Every kind of result is written to a folder and read back: it prints, states and shows the same."""

import json

import numpy as np
import pytest

import rtcal as rt
from rtcal.files.saved import NUMBERS, plain, restored
from rtcal.loop.measured_pairs import ControlRuns
from rtcal.report.pages import page_of
from rtcal.simulators import of_equation
from rtcal.support.errors import DataError
from tests.test_discrepancy import controls_of
from tests.test_positions import HALL, MATCH, heard, tracing
from tests.test_where_page import finding_of, verification_of


def back(result, folder):
    """Return a result after it was saved and loaded; its text and its numbers are the same."""
    result.save(folder)
    again = rt.load(folder)
    assert str(again) == str(result)
    numbers, as_before = (json.loads(r.to_json()) for r in (again, result))
    del numbers["object"], as_before["object"]
    assert numbers == as_before
    return again


@pytest.mark.long
@pytest.mark.parametrize("method", ["mle", "lse", "soft", "smooth", "robust"])
def test_calibrations_are_read_back(method, tmp_path):
    room, measured = rt.datasets.bras_cr2()
    result = rt.calibrate(room, measured, method=method)
    again = back(result, tmp_path)
    for name in ("alpha", "posterior_sigma", "gap_after", "multipliers"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))
    assert again.room.to_text() == result.room.to_text()
    np.testing.assert_array_equal(*(rt.posterior.sensitivity(r) for r in (again, result)))
    page = page_of(tmp_path)
    again.save(tmp_path)
    assert page_of(tmp_path) == page


@pytest.mark.long
def test_joint_calibrations_are_read_back(tmp_path):
    room, measured = rt.datasets.bras_cr2()
    rooms = rt.Configurations([room, room.replace(name="larger", volume=1.02 * room.volume)])
    terms = rt.terms.PriorDeviation() + rt.terms.SoftMatch(0.03)
    times = rt.calibrate(room, measured).measured
    result = rt.Calibration(terms).build(rooms).solve([times, 1.02 * times])
    again = back(result, tmp_path)
    np.testing.assert_array_equal(again.results[1].alpha, result.results[1].alpha)
    back(result.results[0].predict([]), tmp_path / "prediction")


def test_loops_are_read_back(tmp_path):
    room, measured = rt.datasets.bras_cr2()
    simulator = of_equation(rt.Kuttruff(path_variance=0.9), room)
    result = rt.calibrate_simulator(simulator, room, measured, rule="secant")
    loop = back(result, tmp_path)
    np.testing.assert_array_equal(loop.next_alpha, result.next_alpha)  # it still calibrates


@pytest.mark.long
def test_positions_are_read_back(tmp_path):
    room = HALL.room.replace(sigma=0.3 * HALL.room.alpha)
    measured = heard(room, room.alpha, n_paths=2000)
    simulator = tracing(room)
    shape = (4, len(MATCH), len(simulator.pairs), room.n_bands)
    errors = 0.1 * np.random.default_rng(1).normal(size=shape)
    runs = ControlRuns(parameters=MATCH, pairs=simulator.pairs, errors=errors)
    result = rt.calibrate_positions(
        simulator, room, measured, match=MATCH, controls=runs, fit_scattering=False
    )
    np.testing.assert_array_equal(back(result, tmp_path).pulls, result.pulls)
    page_of(tmp_path)


def test_findings_are_read_back(tmp_path):
    case = rt.datasets.hidden_room()[0]
    found = rt.find(case, only=["opening", "furniture", "volume"], controls=controls_of(case))
    again = back(found, tmp_path / "finding")
    assert again.apply().to_dict() == found.apply().to_dict()
    back(rt.finder.verify(found), tmp_path / "verification")
    back(rt.finder.recalibrate(found.apply().case), tmp_path / "recalibrated")
    back(rt.finder.plan(found.case), tmp_path / "plan")


def test_findings_in_a_geometry_are_read_back(tmp_path):
    finding = finding_of({"wall 5": 0.6, "ceiling": 0.4})
    again = back(finding, tmp_path / "finding")
    assert again.case.faces.keys() == finding.case.faces.keys()
    gaps = {"before": 3.0, "plain": 2.0, "corrected": 1.0}
    back(verification_of(finding, gaps), tmp_path / "verification")


def test_an_object_of_no_class_of_rtcal_is_refused_and_its_numbers_are_written(tmp_path):
    class Own(rt.Eyring):
        """In a function no program can import it."""

    result = rt.calibrate(*rt.datasets.bras_cr2(), equation=Own())
    with pytest.raises(DataError, match="cannot be saved"):
        result.save(tmp_path)
    assert not list(tmp_path.iterdir())
    (tmp_path / NUMBERS).write_text(result.to_json(), encoding="utf-8")
    with pytest.raises(DataError, match="cannot be saved"):
        rt.load(tmp_path)


BROKEN = [
    ("class", "os.system", "os.system"),
    ("class", "rtcal.files.disk.write_text", "write_text"),
    ("class", "rtcal.acoustics.air.Wind", "Wind"),
    ("fields", {"depth": 1.0}, "Result"),
    ("dtype", "|O", "array"),
    ("shape", [-1], "array"),
    ("content", "AAAA", "array"),
]


@pytest.mark.parametrize(("key", "value", "place"), BROKEN)
def test_what_is_no_plain_data_is_refused(key, value, place):
    objects = plain(rt.calibrate(*rt.datasets.bras_cr2()))
    i = max(i for i, entry in enumerate(objects) if key in entry)
    objects[i] = {**objects[i], key: value}
    with pytest.raises(DataError, match=rf"objects\[{i}\].*{place}"):
        restored(objects)


def test_a_field_that_came_later_has_its_default():
    objects = plain(rt.datasets.bras_cr2()[0])
    del objects[-1]["fields"]["author"]
    assert restored(objects).author == ""
    del objects[-1]["fields"]["volume"]
    with pytest.raises(DataError, match="volume"):
        restored(objects)


OTHER_FILES = [
    (NUMBERS, "{}", "not a result that rtcal saved"),
    (NUMBERS, "[", "not valid JSON"),
    (NUMBERS, "[1]", "must hold one JSON object"),
    (NUMBERS, '{"rtcal": "finding 1", "object": {"sha256": "0"}}', "finding 1.*Calculate"),
    (NUMBERS, '{"rtcal": "x", "object": {"version": "0.0.7", "objects": []}}', "0.0.7.*Calculate"),
    ("x.json", "[" * 100_000, "the JSON cannot be read"),
    ("a.csv", "f,T20\n500,1\n", "is a table of values, .* Make one first, such as `rtcal"),
    ("a.toml", "volume = 1", "is a room, but a saved result is needed"),
]


@pytest.mark.parametrize(("name", "content", "rule"), OTHER_FILES)
def test_another_file_is_refused_by_name(name, content, rule, tmp_path):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(DataError, match=f"(?s){name}.*{rule}"):
        rt.load(path)
