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
