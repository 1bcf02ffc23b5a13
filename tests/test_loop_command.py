"""`rtcal loop start` and `next`: a program run by hand, between runs of the command."""

import numpy as np
import pytest

import rtcal as rt
from tests.conftest import also, measurement_of, run


def test_a_program_run_by_hand_is_calibrated(cr2, tmp_path, rtcal):
    room, measured = cr2
    step, back = begun(room, measured, tmp_path, "--decimals", "2")
    for _ in range(5):
        simulated = rt.Room.from_file(str(tmp_path / "next.toml"))
        assert np.array_equal(simulated.alpha, np.round(simulated.alpha, 2))
        table = simulate(tmp_path, 1.3)
        said = rtcal(*step, table)
        if "Done." in said:
            break
    assert said.count("converged") == room.n_bands
    kept = written(tmp_path)
    for factor, status in ((1.5, "not confirmed"), (1.31, "converged")):
        # As the page says, the end is simulated once more; a program with noise may deny it.
        said = rtcal(*step, simulate(tmp_path, factor))
        assert rt.load(tmp_path / "loop.json").status[0] == status
        assert ("Not confirmed at 125 Hz" in said) == (factor == 1.5)
        assert "the loop is finished" in rtcal.refused(*step, table)
        rtcal(*back)
        assert written(tmp_path) == kept
    final = 1.3 * rt.Eyring().reverberation_time(rt.Room.from_file(str(tmp_path / "next.toml")))
    wanted = measured.reverberation_time
    assert np.abs(final / wanted - 1).max() < 0.05
    assert np.abs(1.3 * rt.Eyring().reverberation_time(room) / wanted - 1).max() > 0.2


def begun(room, measured, folder, *more):
    """Start a loop in the folder; return `next`, but for its table, and `back`."""
    room.save(str(folder / "room.toml"))
    measured.save(str(folder / "t.csv"))
    files = (folder / "room.toml", "--state", folder / "loop.json", "--out", folder / "next.toml")
    assert run("loop", "start", *files, folder / "t.csv", *more) == 0
    return ("loop", "next", *files), ("loop", "back", *files)


def written(folder):
    return [(folder / name).read_bytes() for name in ("loop.json", "next.toml")]


def test_the_measurement_is_not_taken_for_what_was_simulated(cr2, tmp_path, rtcal):
    room, measured = cr2
    values = {"t20": measured.values["t30"]}
    t20 = measurement_of(room.centre_frequencies, [("S", "R")], **values)
    step, _ = begun(room, t20, tmp_path)
    before = written(tmp_path)
    assert "this table is the measurement" in rtcal.refused(*step, tmp_path / "t.csv")
    assert written(tmp_path) == before
    assert "Done" in rtcal(*step, tmp_path / "t.csv", "--again")


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
    cr2, tmp_path, values, place, rtcal
):
    room, measured = cr2
    step, _ = begun(room, measured, tmp_path)
    before = written(tmp_path)
    n_bands = len(next(iter(values.values())))
    table = tmp_path / "s.csv"
    rt.Measurement.from_values(room.centre_frequencies[:n_bands], **values).save(str(table))
    assert place in rtcal.refused(*step, table)
    assert written(tmp_path) == before


@pytest.mark.parametrize(
    ("factor", "step"), [(10, 2), (0.1, 1), *also(*((f, s) for f in (0.05, 20) for s in (1, 2)))]
)
def test_a_simulation_in_another_unit_is_named_first(cr2, tmp_path, factor, step, rtcal):
    room, measured = cr2
    following, _ = begun(room, measured, tmp_path)
    for _ in range(1, step):
        rtcal(*following, simulate(tmp_path))
    before = written(tmp_path)
    table = simulate(tmp_path, 1.4 * factor)
    assert ": Likely a typing error: simulated T is " in rtcal.refused(*following, table)
    assert written(tmp_path) == before
    assert ("simulated T is" in rtcal(*following, table, "--again")) == (step == 1)


def test_a_simulator_may_be_far_from_the_equation(cr2, tmp_path, rtcal):
    step, _ = begun(*cr2, tmp_path)
    rtcal(*step, simulate(tmp_path, 3))


def test_the_last_step_is_taken_back(cr2, tmp_path, rtcal):
    room, measured = cr2
    step, back = begun(room, measured, tmp_path)
    kept = [written(tmp_path)]
    for factor in (1.4, 1.5):
        rtcal(*step, simulate(tmp_path, factor))
        kept.append(written(tmp_path))
    assert kept[0] != kept[1] != kept[2]
    for left in (1, 0):
        assert f"now holds {left} simulation" in rtcal(*back)
        assert written(tmp_path) == kept[left]
    assert "no simulation yet" in rtcal.refused(*back)


def test_t_of_other_coefficients_is_refused(cr2, tmp_path, rtcal):
    room, measured = cr2
    step, _ = begun(room, measured, tmp_path)
    _, first = written(tmp_path)
    rtcal(*step, simulate(tmp_path))
    state, second = written(tmp_path)
    # The room of the first step is there again, and was simulated with other random numbers.
    (tmp_path / "next.toml").write_bytes(first)
    table = simulate(tmp_path, 1.41)
    assert "no longer has the coefficients" in rtcal.refused(*step, table, "--force")
    assert written(tmp_path) == [state, first]
    (tmp_path / "next.toml").write_bytes(second)
    assert "T is about the same as in the last run" in rtcal.refused(*step, table)
    rtcal(*step, simulate(tmp_path))
