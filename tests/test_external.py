"""Other programs as simulators: callables, commands, and how they fail."""

import pathlib
import sys
import time

import numpy as np
import pytest

import rtcal as rt
from rtcal.simulators import base
from rtcal.simulators.external import External, command
from rtcal.support.errors import DataError, SimulatorError

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


def test_a_command_exchanges_files(cr2):
    room, _ = cr2
    simulator = external(room, command([sys.executable, "-c", PROGRAM], room))
    alpha = np.minimum(1.3 * room.alpha, 1)
    expected = rt.Eyring().reverberation_time(room.replace(alpha=alpha))
    assert base.run(simulator, alpha).mean("t20") == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ([sys.executable, "-c", "raise SystemExit('no licence')"], "status 1: no licence"),
        ([sys.executable, "-c", "pass"], "did not write measured.csv"),
        ([sys.executable, "-c", "import time; time.sleep(30)"], "ran for longer than"),
        (["no-such-program-here"], "cannot be started"),
    ],
)
def test_a_command_that_fails(cr2, program, message):
    room, _ = cr2
    run = command(program, room, time_limit=1.0)
    with pytest.raises(SimulatorError, match=message):
        external(room, run).simulate(room.alpha)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.full(3, 1.0), "shape"),
        (None, "T20, which.*return a Measurement"),
        ("soon", "T20, which.*return a Measurement"),
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


def test_a_callable_that_raises(cr2):
    room, _ = cr2

    def fails(alpha, seed):
        raise RuntimeError("out of tapes")

    with pytest.raises(SimulatorError, match="other program raised RuntimeError: out of tapes"):
        base.run(external(room, fails), room.alpha)


@pytest.mark.long
@pytest.mark.skipif(not pathlib.Path("/proc").exists(), reason="asks for a process by its number")
def test_what_a_command_started_is_ended_with_it(cr2, tmp_path):
    room, _ = cr2
    number = tmp_path / "number"
    program = (
        "import subprocess, sys\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        f"open({str(number)!r}, 'w').write(str(child.pid)); child.wait()"
    )
    run = command([sys.executable, "-c", program], room, time_limit=3.0)
    with pytest.raises(SimulatorError, match="ran for longer than 3 s"):
        external(room, run).simulate(room.alpha)
    assert ends_soon(int(number.read_text()))


def ends_soon(process):
    """Whether a process is gone within five seconds, or dead and not yet fetched by its parent."""
    state = pathlib.Path(f"/proc/{process}/stat")
    for _ in range(50):
        if not state.exists() or state.read_text().rsplit(")", 1)[1].split()[0] == "Z":
            return True
        time.sleep(0.1)
    return False


class Scaling:
    """A simulator of one's own, which changes the array that it is given."""

    name, deterministic = "scaling", True

    def __init__(self, room):
        self.room = room
        self.materials, self.centre_frequencies = room.materials, room.centre_frequencies

    def simulate(self, alpha, *, seed=0):
        alpha *= 0.5
        times = rt.Eyring().time(self.room, self.room.areas @ alpha)
        return rt.Measurement.from_values(self.centre_frequencies, t20=times)


def test_a_simulator_cannot_change_the_coefficients_of_its_caller(cr2):
    room, _ = cr2
    alpha = room.alpha.copy()
    with pytest.raises(SimulatorError, match="read-only"):
        base.run(Scaling(room), alpha)
    assert np.array_equal(alpha, room.alpha)


@pytest.mark.parametrize("seed", [-1, 1.5, "one", None, True])
def test_a_seed_is_a_whole_number(cr2, seed):
    room, _ = cr2
    for simulator in (external(room, lambda alpha, seed: alpha[0] + 1), Scaling(room)):
        with pytest.raises(DataError, match=r"seed = .* must be a whole number of at least 0"):
            base.run(simulator, room.alpha, seed=seed)
