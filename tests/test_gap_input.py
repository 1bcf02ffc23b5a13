"""The input of the discrepancy library: effects of one's own, cases, rooms used before."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import Absorber, Case, Effect, library, plan, recalibrate, verify
from rtcal.finder.effects import Opening
from rtcal.finder.means.problem import ModelDiscrepancy, state
from rtcal.finder.model import Decay
from rtcal.finder.search import find
from rtcal.support.errors import DataError
from tests.test_discrepancy import F, Organ, case_with, controls_of, opened


def with_organ():
    bare = state(opened(), opened().configurations[0])
    t20 = 6 * np.log(10) / bare.covered(40.0, Organ().spectrum(F, {})).rate
    case = case_with(t20, edt=t20, t30=t20)
    (without,) = case_with(6 * np.log(10) / bare.rate).configurations
    return replace(
        case,
        configurations=[
            *case.configurations,
            replace(without, name="without", suspect_removed=True),
        ],
    )


def refused(call, *words):
    with pytest.raises(DataError) as caught:
        call()
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_room_calibrated_on_the_case_s_data_is_refused(tmp_path):
    case = opened()
    used = rt.calibrate(case.room, case.configurations[0].measured).room
    twice = Case(room=used, configurations=case.configurations)
    for call in (
        lambda: rt.calibrate(used, case.configurations[0].measured),
        lambda: find(twice, controls=controls_of(case)),
        lambda: recalibrate(twice),
    ):
        refused(call, "already calibrated on these data")
    # The record is kept in a saved case.
    twice.save(str(tmp_path / "twice.json"))
    refused(lambda: find(Case.from_file(str(tmp_path / "twice.json"))), "already calibrated")
    other = case_with(1.2 * case.configurations[0].measured.mean("t20"))
    fresh = Case(room=used, configurations=other.configurations)
    assert np.isfinite(find(fresh, effects=[Opening()], controls=controls_of(case)).score)


@pytest.mark.long
def test_an_effect_of_one_s_own_is_added_verified_and_simulated(tmp_path):
    case = with_organ()
    effects = [Organ()]
    finding = find(case, effects=effects, controls=controls_of(case, 0.01))
    assert finding.effect == "organ"
    seen = verify(finding)
    assert seen.verdict == "supported"
    assert seen.after < 0.5 * seen.before
    assert seen.corrected.sizes["organ"] == pytest.approx(40.0, rel=0.4)
    assert seen.corrected.to_dict()["effects"][0]["unit"] == "m²"
    corrected = finding.apply()
    room = corrected.room
    assert room.materials[-1] == "organ"
    t20 = corrected.simulator().simulate(room.alpha).mean("t20")
    np.testing.assert_allclose(t20, case.configurations[0].measured.mean("t20"), rtol=0.1)
    assert find(corrected.case, controls=controls_of(case, 0.01)).verdict == "none"
    target = tmp_path / "own.json"
    refused(lambda: corrected.save(str(target)), '"organ"', "cannot be saved")
    assert not target.exists()


def test_one_s_own_of_a_library_s_name_is_not_taken_for_the_library_s(tmp_path):
    class Wide(Opening):
        most = 3.0

    case = opened(25.0)
    finding = find(case, effects=[Wide()], controls=controls_of(case))
    save = finding.apply().case.save
    refused(lambda: save(str(tmp_path / "a.json")), '"opening"', "cannot be saved")


def absorber(called, spectrum):
    made = type("Own", (Absorber,), {"name": called, "spectrum": spectrum})()
    return made


@pytest.mark.parametrize(
    ("spectrum", "place"),
    [
        (lambda s, f, p: np.full(3, 0.5), "(3,)"),
        (lambda s, f, p: "much", "spectrum"),
        (lambda s, f, p: f * (0.0001 + 1j), "complex"),
        (lambda s, f, p: None, "spectrum"),
        (lambda s: np.ones(7), "TypeError"),
        (lambda s, f, p: np.where(f == 500, np.nan, 0.5), "500 Hz"),
        (lambda s, f, p: np.where(f == 250, -1.0, 0.5), "250 Hz"),
        (lambda s, f, p: np.full(len(f), 50.0), "125 Hz"),
        (lambda s, f, p: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_a_spectrum_that_breaks_a_rule_is_named(spectrum, place):
    case = opened()
    effects = [*library(), absorber("piano", spectrum)]
    refused(lambda: find(case, effects=effects, controls=controls_of(case)), '"piano"', place)
    refused(lambda: plan(case, effects=effects), '"piano"', place)


def on_state(**parts):
    members = {
        "name": "mine",
        "size": "x",
        "unit": "",
        "grid": lambda s, state: [{"x": 1.0}],
        "change": lambda s, state, p: state,
    }
    made = type("Mine", (Effect,), members | parts)()
    return made


def changing(**fields):
    return on_state(change=lambda s, state, p: replace(state, **fields))


@pytest.mark.parametrize(
    ("effects", "place"),
    [
        ("air", "must be a list"),
        (["air"], "effects[0]"),
        ([], "effects is empty"),
        ([Opening(), Organ], "effects[1]"),
        ([absorber(None, None)], "name = None"),
        ([*library(), Opening()], '"opening" twice'),
        ([on_state(name="none")], "must not be the name of a verdict"),
        ([on_state(size_error=-1.0)], "size_error"),
        ([on_state(grid=lambda s, state: [])], "grid is empty"),
        ([on_state(grid=lambda s, state: [{"y": 1.0}])], 'grid: the parameter "x"'),
        ([on_state(grid=lambda s: [])], "TypeError"),
        ([on_state(change=lambda s, state, p: None)], "change returns NoneType"),
        ([changing(volume=-3.0)], "volume = -3 must be"),
        ([changing(areas=np.ones(2))], "areas has shape (2,)"),
        ([changing(alpha=np.full((4, 7), 1.5))], "alpha = 1.5 must be"),
        ([changing(covering=np.ones(3))], "covering has shape (3,)"),
        ([changing(floor_db=np.inf)], "floor_db = inf must be"),
        ([changing(equation="norris")], "equation"),
        ([changing(shape=lambda s: 3)], "shape returns = 3"),
        ([changing(shape=lambda s: Decay(np.ones((3, 1)), np.ones((3, 1))))], "(3, 1)"),
        ([changing(shape=lambda s: Decay(np.ones((7, 1)), -np.ones((7, 1))))], "rates"),
    ],
)
def test_what_is_no_effect_is_refused(effects, place):
    case = opened()
    refused(lambda: find(case, effects=effects, controls=controls_of(case)), place)


def test_the_discrepancy_of_another_case_is_refused():
    case = opened()
    finding = find(case, effects=[Opening()], controls=controls_of(case))
    for shape in (6, 70):
        other = ModelDiscrepancy(np.zeros(shape), np.eye(shape))
        refused(lambda d=other: recalibrate(case, d), "another case")
    assert np.isfinite(plan(case, finding=finding).change)
