"""`rtcal table`: options without use, spellings, positions; and the errors of the native file."""

from __future__ import annotations

from pathlib import Path

import pytest

import rtcal as rt
from rtcal.support.errors import DataError
from tests.test_io_commands import run


@pytest.mark.parametrize(
    "content",
    ["RT60 500 Hz,1k\n1,2\n", "parameter,500\nRT60,1\n"],
)
def test_a_decay_time_is_used_wherever_rt60_stands(tmp_path: Path, content: str) -> None:
    path = tmp_path / "in.csv"
    path.write_text(content.replace("1k", "RT60 1k"))
    assert run("table", path, "--decay-time", "T30") == 0


def test_parameters_are_taken_in_both_cases(tmp_path: Path, capsys) -> None:
    path, out = tmp_path / "in.csv", tmp_path / "t.csv"
    path.write_text("position,500,1k\nA,1.5,1.4\n")
    assert run("table", path, "--parameter", "C80", "--out", out) == 0
    assert rt.Measurement.from_file(str(out)).values["c80"].tolist() == [[1.5, 1.4]]
    path.write_text("f,RT60\n500,1\n")
    assert run("table", path, "--decay-time", "T20", "--out", out) == 0
    assert [*rt.Measurement.from_file(str(out)).values] == ["t20"]
    capsys.readouterr()
    assert run("table", "--help") == 0
    assert "[t20|t30]" in capsys.readouterr().out


def test_a_native_measurement_says_separator_and_line(tmp_path: Path, capsys) -> None:
    """It had said that a column is missing, and D50 = 45 without its line."""
    path, room = tmp_path / "v.csv", rt.datasets.path("bras_cr2/room.toml")
    path.write_text("source;receiver;parameter;band;value\nS1;R1;T20;500;1,5\n")
    assert run("calibrate", room, path) == 2
    said = capsys.readouterr().err
    assert 'v.csv, line 1: column "source" is missing, since columns are separated by ";"' in said
    assert f"`rtcal table {path}` reads other tables" in said
    path.write_text("source,receiver,parameter,band,value\nS1,R1,T20,125,1\nS1,R1,D50,125,45\n")
    assert run("calibrate", room, path) == 2
    assert (
        "v.csv, line 3: D50 = 45 is not from 0 to 1: is it in percent?" in capsys.readouterr().err
    )


def test_the_cure_for_a_value_that_is_given_twice_is_accepted(tmp_path: Path) -> None:
    """For means it was "*#2", which no measurement may be called."""
    path = tmp_path / "t.csv"
    head = "source,receiver,parameter,band,value\n"
    path.write_text(f"{head}S1,R1,T20,500,1\nS1,R1,T20,500,2\n")
    with pytest.raises(DataError, match="repeats at one place are R1 and R1#2"):
        rt.Measurement.from_file(str(path))
    path.write_text(f"{head}S1,R1,T20,500,1\nS1,R1#2,T20,500,2\n")
    assert rt.Measurement.from_file(str(path)).values["t20"].tolist() == [[1.5]]
    path.write_text(f"{head}*,*,T20,500,1\n*,*,T20,500,2\n")
    with pytest.raises(DataError, match="leave one mean out"):
        rt.Measurement.from_file(str(path))
