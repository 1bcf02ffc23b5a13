"""Other programs as simulators: callables, commands, and how they fail."""

import sys
import time

import numpy as np
import pytest

import rtcal as rt
from rtcal.errors import DataError, SimulatorError
from rtcal.simulators import base
from rtcal.simulators.external import External, command

PROGRAM = """
import sys
import rtcal as rt
given, found, seed = sys.argv[1:]
room = rt.Room.from_file(given)
t = rt.Eyring().reverberation_time(room)
rt.Measurement.from_values(room.centre_frequencies, t20=t).save(found)
"""


def external(room, run, **options):
    return External(room=room, run=run, name="other program", **options)


def test_a_callable_may_return_times_or_a_measurement(cr2):
    room, measured = cr2
    times = external(room, lambda alpha, seed: rt.Eyring().time(room, room.areas @ alpha))
    assert isinstance(times, base.Simulator)
    expected = rt.Eyring().reverberation_time(room)
    assert base.run(times, room.alpha).mean("t20") == pytest.approx(expected)
    whole = external(room, lambda alpha, seed: measured)
    assert whole.simulate(room.alpha) is measured


def test_a_command_exchanges_files(cr2):
    room, _ = cr2
    simulator = external(room, command([sys.executable, "-c", PROGRAM], room))
    alpha = np.minimum(1.3 * room.alpha, 1)
    expected = rt.Eyring().reverberation_time(room.replace(alpha=alpha))
    assert base.run(simulator, alpha).mean("t20") == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("raise SystemExit('no licence')", "ended with status 1: no licence"),
        ("pass", "wrote no measured.csv"),
        ("import time; time.sleep(30)", "ran for longer than"),
    ],
)
def test_a_command_that_fails(cr2, program, message):
    room, _ = cr2
    run = command([sys.executable, "-c", program], room, time_limit=1.0)
    with pytest.raises(SimulatorError, match=message):
        external(room, run).simulate(room.alpha)


def test_a_command_that_is_not_there(cr2):
    room, _ = cr2
    with pytest.raises(SimulatorError, match="cannot be started"):
        external(room, command(["no-such-program-here"], room)).simulate(room.alpha)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.full(3, 1.0), "shape"),
        (None, "shape|neither"),
        ("soon", "neither a Measurement nor times"),
        (np.nan, "shape"),
    ],
)
def test_answers_that_are_none(cr2, answer, message):
    room, _ = cr2
    with pytest.raises(SimulatorError, match=message):
        external(room, lambda alpha, seed: answer).simulate(room.alpha)
    for bad in (np.nan, np.inf, 0.0, -1.0):
        times = np.ones(room.n_bands)
        times[1] = bad
        with pytest.raises(SimulatorError, match="finite time above 0"):
            external(room, lambda alpha, seed, times=times: times).simulate(room.alpha)


def test_a_callable_that_raises_or_takes_too_long(cr2):
    room, _ = cr2

    def fails(alpha, seed):
        raise RuntimeError("out of tapes")

    for limit in (None, 5.0):
        with pytest.raises(SimulatorError, match="other program raised RuntimeError: out of tapes"):
            base.run(external(room, fails, time_limit=limit), room.alpha)
    slow = external(room, lambda alpha, seed: time.sleep(2), time_limit=0.1)
    with pytest.raises(SimulatorError, match=r"longer than 0\.1 s"):
        slow.simulate(room.alpha)
    with pytest.raises(DataError, match="time_limit"):
        external(room, fails, time_limit=0.0)
