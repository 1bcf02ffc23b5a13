"""`rtcal loop start` and `next`: a program run by hand, between runs of the command."""

import numpy as np
from click.testing import CliRunner

import rtcal as rt
from rtcal.cli import cli


def test_a_program_run_by_hand_is_calibrated(cr2, tmp_path):
    room, measured = cr2
    names = {
        n: str(tmp_path / n) for n in ("room.toml", "t.csv", "loop.json", "next.toml", "s.csv")
    }
    room.save(names["room.toml"])
    measured.save(names["t.csv"])
    files = ["--state", names["loop.json"], "--out", names["next.toml"]]
    runner = CliRunner()
    done = runner.invoke(
        cli, ["loop", "start", names["room.toml"], names["t.csv"], "--decimals", "2", *files]
    )
    assert done.exit_code == 0, done.output
    for _ in range(5):
        simulated = rt.Room.from_file(names["next.toml"])
        assert np.array_equal(simulated.alpha, np.round(simulated.alpha, 2))
        times = 1.3 * rt.Eyring().reverberation_time(simulated)  # the program
        rt.Measurement.from_values(room.centre_frequencies, t20=times).save(names["s.csv"])
        done = runner.invoke(cli, ["loop", "next", names["room.toml"], names["s.csv"], *files])
        assert done.exit_code == 0, done.output
        if "Done." in done.output:
            break
    assert done.output.count("converged") == room.n_bands
    kept = [(tmp_path / n).read_bytes() for n in ("loop.json", "next.toml")]
    again = runner.invoke(cli, ["loop", "next", names["room.toml"], names["s.csv"], *files])
    assert "the loop is done" in str(again.exception)
    assert [(tmp_path / n).read_bytes() for n in ("loop.json", "next.toml")] == kept
    final = 1.3 * rt.Eyring().reverberation_time(rt.Room.from_file(names["next.toml"]))
    wanted = measured.decay_time().mean
    assert np.abs(final / wanted - 1).max() < 0.05
    assert np.abs(1.3 * rt.Eyring().reverberation_time(room) / wanted - 1).max() > 0.2


def test_another_rooms_state_is_refused(cr2, tmp_path):
    room, measured = cr2
    room.save(str(tmp_path / "a.toml"))
    room.replace(volume=2 * room.volume).save(str(tmp_path / "b.toml"))
    measured.save(str(tmp_path / "t.csv"))
    files = ["--state", str(tmp_path / "loop.json"), "--out", str(tmp_path / "next.toml")]
    runner = CliRunner()
    runner.invoke(cli, ["loop", "start", str(tmp_path / "a.toml"), str(tmp_path / "t.csv"), *files])
    done = runner.invoke(
        cli, ["loop", "next", str(tmp_path / "b.toml"), str(tmp_path / "t.csv"), *files]
    )
    assert done.exit_code != 0
    assert "another room" in str(done.exception)


def begun(room, measured, tmp_path, *more):
    """A loop that was started in the folder; its runner, and the arguments of `next`."""
    room.save(str(tmp_path / "room.toml"))
    measured.save(str(tmp_path / "t.csv"))
    files = ["--state", str(tmp_path / "loop.json"), "--out", str(tmp_path / "next.toml")]
    runner = CliRunner()
    start = [str(tmp_path / "room.toml"), str(tmp_path / "t.csv"), *files, *more]
    done = runner.invoke(cli, ["loop", "start", *start])
    return done, runner, ["loop", "next", str(tmp_path / "room.toml")], files


def test_a_t_that_the_program_did_not_give_is_no_band_without_t(cr2, tmp_path):
    room, measured = cr2
    done, runner, command, files = begun(room, measured, tmp_path)
    assert "next.toml first" in done.output
    before = (tmp_path / "loop.json").read_text()
    times = measured.decay_time().mean.copy()
    times[2] = np.nan
    lacking = tmp_path / "s.csv"
    rt.Measurement.from_values(room.centre_frequencies, t20=times).save(str(lacking))
    done = runner.invoke(cli, [*command, str(lacking), *files])
    assert "simulated T20[* to *, 500 Hz] is missing" in str(done.exception)
    rt.Measurement.from_values(room.centre_frequencies[:3], t20=[1, 1, 1]).save(str(lacking))
    done = runner.invoke(cli, [*command, str(lacking), *files])
    assert "other bands than the room" in str(done.exception)
    rt.Measurement.from_values(room.centre_frequencies, t30=np.ones(room.n_bands)).save(
        str(lacking)
    )
    done = runner.invoke(cli, [*command, str(lacking), *files])
    assert "has no T20" in str(done.exception)
    assert (tmp_path / "loop.json").read_text() == before


def test_a_t_beyond_reach_is_said_at_the_start(cr2, tmp_path):
    room, _ = cr2
    far = rt.Measurement.from_values(room.centre_frequencies, t20=[1.4, 1.7, 90, 1.9, 1.7, 1.5])
    done, *_ = begun(room, far, tmp_path)
    assert done.exit_code == 0
    assert "T[500 Hz] = 90 s is beyond reach" in done.output


def test_a_state_is_written_with_its_room_or_not_at_all(cr2, tmp_path):
    room, measured = cr2
    room.save(str(tmp_path / "room.toml"))
    measured.save(str(tmp_path / "t.csv"))
    done = CliRunner().invoke(cli, [
        "loop", "start", str(tmp_path / "room.toml"), str(tmp_path / "t.csv"),
        "--state", str(tmp_path / "none" / "loop.json"), "--out", str(tmp_path / "next.toml"),
    ])  # fmt: skip
    assert "cannot be written" in str(done.exception)
    assert not (tmp_path / "next.toml").exists()


def test_what_is_no_state_is_said_plainly(cr2, tmp_path):
    room, measured = cr2
    _, runner, command, files = begun(room, measured, tmp_path)
    state = tmp_path / "loop.json"
    good = state.read_text()
    for content, message in (
        (good[:150], "is no state of a loop"),
        ("[1]", "lacks the mark of one"),
        ("{}", "lacks the mark of one"),
        (good.replace('"rule": "safeguarded"', '"rule": "huh"'), "'rule' is missing or unknown"),
        (good.replace('"wanted"', '"wnated"'), "'wanted' is missing or unknown"),
    ):
        state.write_text(content)
        done = runner.invoke(cli, [*command, str(tmp_path / "t.csv"), *files])
        assert message in str(done.exception)
