"""`rtcal loop start` and `next`: a program run by hand, between runs of the command."""

import numpy as np
import pytest
from click.testing import CliRunner

import rtcal as rt
from rtcal.command.main import cli
from rtcal.support.errors import DataError
from tests.conftest import also


def unwrapped(output: str) -> str:
    """Return what is printed, whatever its lines: they are as long as the terminal is wide."""
    return " ".join(output.split())


def test_a_program_run_by_hand_is_calibrated(cr2, tmp_path):
    room, measured = cr2
    done, runner, command, files = begun(room, measured, tmp_path, "--decimals", "2")
    assert done.exit_code == 0, done.output
    for _ in range(5):
        simulated = rt.Room.from_file(str(tmp_path / "next.toml"))
        assert np.array_equal(simulated.alpha, np.round(simulated.alpha, 2))
        table = simulate(tmp_path, 1.3)
        done = runner.invoke(cli, [*command, table, *files])
        assert done.exit_code == 0, done.output
        if "Done." in unwrapped(done.output):
            break
    assert done.output.count("converged") == room.n_bands
    kept = [(tmp_path / n).read_bytes() for n in ("loop.json", "next.toml")]
    for factor, status in ((1.5, "not confirmed"), (1.31, "converged")):
        # As the page says, the end is simulated once more; a program with noise may deny it.
        done = runner.invoke(cli, [*command, simulate(tmp_path, factor), *files])
        assert rt.load(tmp_path / "loop.json").status[0] == status, done.output
        assert ("Not confirmed at 125 Hz" in unwrapped(done.output)) == (factor == 1.5)
        again = runner.invoke(cli, [*command, table, *files])
        assert "the loop is finished" in str(again.exception)
        back = runner.invoke(cli, ["loop", "back", str(tmp_path / "room.toml"), *files])
        assert back.exit_code == 0, back.output
        assert [(tmp_path / n).read_bytes() for n in ("loop.json", "next.toml")] == kept
    final = 1.3 * rt.Eyring().reverberation_time(rt.Room.from_file(str(tmp_path / "next.toml")))
    wanted = measured.reverberation_time
    assert np.abs(final / wanted - 1).max() < 0.05
    assert np.abs(1.3 * rt.Eyring().reverberation_time(room) / wanted - 1).max() > 0.2


def begun(room, measured, tmp_path, *more):
    """A loop that was started in the folder; its runner, and the arguments of `next`."""
    room.save(str(tmp_path / "room.toml"))
    measured.save(str(tmp_path / "t.csv"))
    files = ["--state", str(tmp_path / "loop.json"), "--out", str(tmp_path / "next.toml")]
    runner = CliRunner()
    start = [str(tmp_path / "room.toml"), str(tmp_path / "t.csv"), *files, *more]
    done = runner.invoke(cli, ["loop", "start", *start])
    return done, runner, ["loop", "next", str(tmp_path / "room.toml")], files


def test_the_measurement_is_not_taken_for_what_was_simulated(cr2, tmp_path):
    room, measured = cr2
    values = {"t20": measured.values["t30"]}
    t20 = rt.Measurement(
        centre_frequencies=room.centre_frequencies, values=values, pairs=[("S", "R")]
    )
    _, runner, command, files = begun(room, t20, tmp_path)
    before = (tmp_path / "loop.json").read_text()
    done = runner.invoke(cli, [*command, str(tmp_path / "t.csv"), *files])
    assert "Probably this table is the measurement" in str(done.exception)
    assert (tmp_path / "loop.json").read_text() == before
    done = runner.invoke(cli, [*command, str(tmp_path / "t.csv"), *files, "--again"])
    assert "Done" in done.output


def simulate(tmp_path, factor=1.4):
    """A program: what it makes of next.toml, in s.csv."""
    room = rt.Room.from_file(str(tmp_path / "next.toml"))
    times = factor * rt.Eyring().reverberation_time(room)
    rt.Measurement.from_values(room.centre_frequencies, t20=times).save(str(tmp_path / "s.csv"))
    return str(tmp_path / "s.csv")


@pytest.mark.parametrize(
    ("values", "place"),
    [
        ({"t20": [1.4, 1.7, np.nan, 1.9, 1.7, 1.5]}, "500 Hz"),
        ({"t20": [1, 1, 1]}, "3 bands"),
        ({"edt": [1.0] * 6}, "no T30, but T30 was measured. The simulation has EDT"),
        ({"t20": [1000.0] * 6}, "line 2: T20 = 1000 s"),
        ({"t20": [0.0014] * 6}, "line 2: T20 = 0.0014 s"),
    ],
)
def test_a_table_that_lacks_something_is_refused_and_nothing_is_written(
    cr2, tmp_path, values, place
):
    room, measured = cr2
    _, runner, command, files = begun(room, measured, tmp_path)
    before = [(tmp_path / n).read_bytes() for n in ("loop.json", "next.toml")]
    n_bands = len(next(iter(values.values())))
    table = tmp_path / "s.csv"
    rt.Measurement.from_values(room.centre_frequencies[:n_bands], **values).save(str(table))
    done = runner.invoke(cli, [*command, str(table), *files])
    assert isinstance(done.exception, DataError)
    assert place in str(done.exception)
    assert [(tmp_path / n).read_bytes() for n in ("loop.json", "next.toml")] == before


@pytest.mark.parametrize(
    ("factor", "step"), [(10, 2), (0.1, 1), *also(*((f, s) for f in (0.05, 20) for s in (1, 2)))]
)
def test_a_simulation_in_another_unit_is_named_first(cr2, tmp_path, factor, step):
    """It was taken in silence: alpha went to its bounds to follow a decimal point."""
    room, measured = cr2
    _, runner, command, files = begun(room, measured, tmp_path)
    for _ in range(1, step):
        assert runner.invoke(cli, [*command, simulate(tmp_path), *files]).exit_code == 0
    before = (tmp_path / "loop.json").read_bytes()
    table = simulate(tmp_path, 1.4 * factor)
    done = runner.invoke(cli, [*command, table, *files])
    assert ": Likely a typing error: simulated T is " in str(done.exception)
    assert (tmp_path / "loop.json").read_bytes() == before
    done = runner.invoke(cli, [*command, table, *files, "--again"])
    assert done.exit_code == 0, done.output
    assert ("simulated T is" in unwrapped(done.output)) == (step == 1)
    # A simulator in which T is three times the equation's is none.
    begun_anew = tmp_path / "anew"
    begun_anew.mkdir()
    _, runner, command, files = begun(room, measured, begun_anew)
    assert runner.invoke(cli, [*command, simulate(begun_anew, 3), *files]).exit_code == 0


def test_the_last_step_is_taken_back(cr2, tmp_path):
    room, measured = cr2
    _, runner, command, files = begun(room, measured, tmp_path)
    names = ("loop.json", "next.toml")
    kept = [[(tmp_path / n).read_bytes() for n in names]]
    for factor in (1.4, 1.5):
        assert runner.invoke(cli, [*command, simulate(tmp_path, factor), *files]).exit_code == 0
        kept.append([(tmp_path / n).read_bytes() for n in names])
    assert kept[0] != kept[1] != kept[2]
    back = ["loop", "back", str(tmp_path / "room.toml"), *files]
    for left in (1, 0):
        done = runner.invoke(cli, back)
        assert f"now holds {left} simulation" in unwrapped(done.output)
        assert [(tmp_path / n).read_bytes() for n in names] == kept[left]
    assert "no simulation yet, so there is no step to take back" in str(
        runner.invoke(cli, back).exception
    )


def test_t_of_other_coefficients_is_refused(cr2, tmp_path):
    """A table that belongs to the room of another step was taken in: "converged" at a wrong T."""
    room, measured = cr2
    _, runner, command, files = begun(room, measured, tmp_path)
    first = (tmp_path / "next.toml").read_bytes()
    table = simulate(tmp_path)
    assert runner.invoke(cli, [*command, table, *files]).exit_code == 0
    state, second = (tmp_path / "loop.json").read_bytes(), (tmp_path / "next.toml").read_bytes()
    # The room of the first step is there again, and was simulated with other random numbers.
    (tmp_path / "next.toml").write_bytes(first)
    table = simulate(tmp_path, 1.41)
    done = runner.invoke(cli, [*command, table, *files])
    assert "no longer has the coefficients that" in str(done.exception)
    assert (tmp_path / "loop.json").read_bytes() == state
    (tmp_path / "next.toml").write_bytes(second)
    done = runner.invoke(cli, [*command, table, *files])
    assert "T is about the same as in the last run" in str(done.exception)
    assert runner.invoke(cli, [*command, simulate(tmp_path), *files]).exit_code == 0
