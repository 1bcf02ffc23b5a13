"""Questions whose answer is known without a calculation: twice as long, exchanged, copied, in ms."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.loop.measured_pairs import BeyondPrior
from rtcal.simulators import External
from tests.conftest import also, run

BANDS = [250.0, 500.0, 1000.0]
ALPHA = np.array([[0.04, 0.05, 0.06], [0.15, 0.2, 0.35], [0.3, 0.4, 0.5]])


def box(alpha=ALPHA, sigma=None, **stated):
    return rt.Room(
        name="box",
        volume=90.0,
        materials=["plaster", "carpet", "tile"],
        areas=[66.0, 30.0, 30.0],
        alpha=alpha,
        sigma=0.3 * alpha if sigma is None else sigma,
        centre_frequencies=BANDS,
        air=rt.Air(temperature=20, humidity=50),
        **stated,
    )


def times(room):
    return rt.Eyring().reverberation_time(room)


def means(**values):
    return rt.Measurement.from_values(BANDS, **values)


@pytest.mark.parametrize("rule", ["secant", "safeguarded"])
@pytest.mark.parametrize("factor", [0.3, 0.45, 0.5, 0.9, 1.0, 1.1, 2.0, 3.0])
def test_a_program_with_a_multiple_of_the_equations_t_is_calibrated(rule, factor):
    room = box()

    def program(alpha, seed):
        return factor * rt.Eyring().time(room, room.areas @ alpha)

    found = rt.calibrate_simulator(
        External(room=room, run=program, name="multiple"), room, means(t20=times(room)), rule=rule
    )
    assert set(found.status) == {"converged"}
    again = found.room.replace(calibration=None)
    at_answer = rt.calibrate_simulator(
        External(room=room, run=program, name="multiple"), again, means(t20=times(room)), rule=rule
    )
    assert at_answer.simulations == 1
    assert np.array_equal(at_answer.alpha, found.alpha)


@pytest.mark.parametrize("rule", ["secant", "safeguarded"])
def test_a_program_that_always_gives_the_same_t_is_not_asked_for_ever(rule):
    room = box()
    program = External(room=room, run=lambda alpha, seed: np.full(3, 0.9), name="constant")
    found = rt.calibrate_simulator(program, room, means(t20=times(room)), rule=rule)
    assert set(found.status) == {"unreachable"}
    assert found.simulations <= 4


def begun(folder, factor):
    """Start a loop whose program has a multiple of the equation's T, and return `next`."""
    room = box()
    room.save(str(folder / "room.toml"))
    means(t20=times(room)).save(str(folder / "t.csv"))
    files = [folder / "room.toml", "--state", folder / "loop.json", "--out", folder / "next.toml"]
    simulated = means(t20=factor * times(room))
    simulated.save(str(folder / "run.csv"))
    assert (
        run("loop", "start", *files, folder / "t.csv", "--simulated", folder / "run.csv", "-q") == 0
    )
    return ["loop", "next", *files]


def simulated(folder, factor):
    room = rt.Room.from_file(str(folder / "next.toml"))
    means(t20=factor * times(room)).save(str(folder / "s.csv"))
    return folder / "s.csv"


def test_coefficients_that_were_simulated_together_are_not_to_be_simulated_for_that(
    tmp_path, rtcal
):
    following = begun(tmp_path, 1.2)
    said = rtcal(*following, simulated(tmp_path, 1.2))
    assert "Done." in said
    assert "which were simulated together. If your program uses random numbers" in said


@pytest.mark.parametrize("command", ["next", "back"])
def test_a_copied_state_goes_on(command, tmp_path, rtcal):
    _, _, *files = begun(tmp_path, 1.2)
    state = tmp_path / "copied.json"
    state.write_bytes((tmp_path / "loop.json").read_bytes())
    files[2] = state
    table = [simulated(tmp_path, 1.2)] if command == "next" else []
    rtcal("loop", command, *files, *table)
    assert len(rt.loop.Loop.load(str(state)).steps) == (2 if command == "next" else 0)


@pytest.mark.parametrize("factor", [0.05, 0.1, 10.0, 1000.0])
@pytest.mark.parametrize("tilt", [0.0, 0.1])
def test_a_run_in_another_unit_is_said_before_its_causes(factor, tilt):
    measured = times(box())
    off = factor * (1 + tilt * np.arange(3))
    found = rt.compare(box(), means(t20=measured), rt.Run(box(), means(t20=off * measured)))
    text = " ".join(str(found).split())
    cause = text.find("No coefficients within the sigma")
    assert 0 < max(text.find("times the"), text.find("typing error")) < cause
    assert "e+" not in text


@pytest.mark.parametrize("factor", [0.25, 0.5, 1.9])
@pytest.mark.parametrize("parameter", ["t20", "t30", "edt"])
def test_other_coefficients_of_a_run_explain_what_they_cause(factor, parameter):
    """The program had a multiple of the input coefficients, and the room has those of the input."""
    room, other = box(sigma=0.1 * ALPHA), box(factor * ALPHA, sigma=0.1 * ALPHA)
    simulated = means(**{parameter: times(other)})
    found = rt.compare(room, means(**{parameter: times(room)}), rt.Run(other, simulated))
    assert found.disagrees[parameter].all()
    assert found.explained[parameter].all()
    assert "The program had other coefficients than the input" in " ".join(str(found).split())
    # The same values of a program that had the input coefficients are not explained by them.
    own = rt.compare(room, means(**{parameter: times(room)}), rt.Run(room, simulated))
    assert not own.explained[parameter].any()
    said = " ".join(str(own).split())
    assert "other coefficients than" not in said
    assert "something else is wrong" in said


def test_other_coefficients_explain_nothing_else():
    """The program has a third of the measured T although its coefficients are the smaller ones."""
    room, other = box(), box(0.6 * ALPHA)
    simulated = means(t20=times(room) / 3)
    found = rt.compare(room, means(t20=times(room)), rt.Run(other, simulated))
    assert not found.explained["t20"].any()


@pytest.mark.parametrize(
    ("needed", "said", "advice"),
    [
        (0.3, "of 0.30 instead of the input's 0.17", "Enter a sigma 4 times as large"),
        (-0.1, "below 0,", "Check the unit of T"),
        (0.97, "above 0.9,", "Check the unit of T"),
        (np.nan, "above 0.9,", "Check the unit of T"),
    ],
)
def test_no_sigma_is_advised_for_a_t_that_no_coefficients_give(needed, said, advice):
    beyond = BeyondPrior(
        parameter="t20",
        frequency=500.0,
        measured=0.1,
        simulated=0.7,
        reached=0.5,
        stated=0.17,
        needed=needed,
        z=8.0,
        bands=2,
        of_bands=2,
    )
    assert said in str(beyond)
    assert advice in str(beyond)
    exact = str(
        replace(beyond, reached=beyond.simulated)
    )  # of a sigma of 0, which no factor raises
    assert "times as large" not in exact
    assert ("Enter a sigma above 0" in exact) == (needed == 0.3)


@pytest.mark.parametrize("factor", [0.5, *also(0.25, 1.9)])
def test_a_search_beside_a_run_of_other_coefficients_finds_nothing(factor, kept):
    room, other = box(), box(factor * ALPHA)
    simulated = rt.Run(other, means(t20=1.03 * times(other)))
    found = rt.find(room, means(t20=times(room)), simulated=simulated, cache=kept)
    assert found.verdict == "none"
    said = " ".join(str(found).split())
    assert "but the program differs from the measurement" in said
    assert "The program's coefficients, which are not the input's" in said


STATED = rt.Air(temperature=20, humidity=50)
OTHER = rt.Air(temperature=24, humidity=25)
HIGH = [500.0, 1000.0, 2000.0, 4000.0, 8000.0]


def between(volume, factor, air, *, exchanged=False):
    """Find what changed in a room: its coefficients by a factor, and the climate."""
    walls, alpha = (volume / 90) ** (2 / 3), np.outer([0.05, 0.2, 0.3], np.ones(5))

    def room(by, air):
        return rt.Room(
            name="states",
            volume=volume,
            materials=["plaster", "carpet", "tile"],
            areas=[66 * walls, 30 * walls, 30 * walls],
            alpha=by * alpha,
            sigma=0.3 * by * alpha,
            centre_frequencies=HIGH,
            air=air,
        )

    first = room(1.0, STATED)
    states = [rt.Measurement.from_values(HIGH, t20=times(r)) for r in (first, room(factor, air))]
    before, after = states[::-1] if exchanged else states
    return rt.find(first, after, before=before)


@pytest.mark.parametrize("exchanged", [False, True])
@pytest.mark.parametrize("air", [STATED, OTHER], ids=["same air", "other air"])
@pytest.mark.parametrize("factor", [1.2, *also(0.8, 1.5, 0.6)])
@pytest.mark.parametrize("volume", [9000.0, *also(90.0)])
def test_a_change_is_said_in_its_direction(volume, factor, air, exchanged):
    found = between(volume, factor, air, exchanged=exchanged)
    said = " ".join(str(found).split())
    more = (factor > 1) != exchanged
    assert f" {'more' if more else 'less'} absorption at 500 to 2000 Hz than before" in said
    assert f" {'less' if more else 'more'} absorption at" not in said
    # A caution about the climate stands where the data show one, and not where they show nothing.
    if air is STATED:
        assert "climate" not in said
    elif volume == 9000.0:
        assert "A change of the climate explains a part" in said


@pytest.mark.parametrize("exchanged", [False, True])
@pytest.mark.parametrize("humidity", [25, *also(30, 40, 70)])
def test_a_change_of_the_climate_alone_is_said_first(humidity, exchanged):
    found = between(9000.0, 1.0, rt.Air(temperature=20, humidity=humidity), exchanged=exchanged)
    said = " ".join(str(found).split())
    assert said.startswith("The climate of the air changed, and nothing else")
    interval = (found.size.low, found.size.high)
    shorter = found.shift[-1] < 0
    if interval[0] * interval[1] < 0:
        assert "more absorption at" not in said
        assert "less absorption at" not in said
    else:
        assert ("more absorption at" in said) == shorter
