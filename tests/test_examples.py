"""`rtcal example`: every command that it prints runs, in the folder that it wrote."""

import glob
import runpy
import shlex
from pathlib import Path

import pytest

import rtcal as rt
from rtcal.command.files import _PURPOSES
from tests.conftest import run


def run_line(line):
    words = [w for word in shlex.split(line) for w in (sorted(glob.glob(word)) or [word])]
    if words[0] == "python":
        runpy.run_path(words[1], run_name="__main__")
    else:
        assert run(*words[1:]) == 0, line


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[pytest.mark.long] if n in ("change", "responses", "compare") else [])
        for n in _PURPOSES
        if n not in ("missing-effect", "identified", "where", "diagnose")
    ],
)
def test_the_printed_commands_run(name, tmp_path, monkeypatch, capsys):
    for library in ("pyfar", "pyrato", "pyroomacoustics", "jinja2", "matplotlib"):
        pytest.importorskip(library)
    monkeypatch.chdir(tmp_path)
    assert run("example", name) == 0
    printed = capsys.readouterr().out
    shown = printed.split("Next:\n")[1].replace("\\\n", " ")
    lines = [line.strip() for line in shown.strip().splitlines()]
    assert lines[0] == f"cd {name}"
    monkeypatch.chdir(tmp_path / name)
    for line in lines[1:]:
        run_line(line)
    if name == "simulator":
        text = capsys.readouterr().out
        assert "converged" in text
        assert "not con" not in text  # neither "not converging" nor "not confirmed"
    if "rtcal report calibrated" in lines:
        assert Path("calibrated/report.html").exists()


def test_the_case_with_a_geometry_is_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("example", "where", "-q") == 0
    measured = rt.Measurement.from_file("where/pairs.csv")
    case = rt.finder.case_of(rt.Room.from_file("where/room.toml"), measured)
    assert len(case.pairs) == 12
    assert case.faces.keys() == case.areas.keys() >= {"floor", "ceiling"}
