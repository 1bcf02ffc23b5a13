"""Every command runs, and its output fits the terminal; a long step says what it does."""

from __future__ import annotations

import re
import shutil
import time
from pathlib import Path
from typing import Any

import pytest

import rtcal as rt
from rtcal.command.main import cli, main
from rtcal.datasets import halls
from rtcal.support import speed

pytest.importorskip("matplotlib", reason="needs the extra report")
pytest.importorskip("jinja2", reason="needs the extra report")

pytestmark = pytest.mark.usefixtures("runs_kept")
COLUMNS = 60


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    assert isinstance(stop.value.code, int)
    return stop.value.code


def command_names() -> list[str]:
    names = []
    for name, command in cli.commands.items():
        parts = getattr(command, "commands", {"": None})
        names += [f"{name} {part}".strip() for part in parts]
    return names


@pytest.fixture(scope="module")
def projects(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The projects of `rtcal example`, with what a user adds to them."""
    folder = tmp_path_factory.mktemp("projects")
    for name in ("room", "change", "responses", "simulator", "missing-effect"):
        assert run("example", name, "--out", str(folder / name), "--quiet") == 0
    hall = halls.lecture_hall()
    mesh = folder / "simulator" / "room.obj"
    scene = rt.Scene(mesh=mesh, sources=hall.sources, receivers=hall.receivers)
    hall.room.replace(scene=scene).save(str(folder / "simulator" / "hall.toml"))
    (folder / "room" / "dirac.csv").write_text(
        "Frequenz [Hz];RT60 [s];EDT [s]\n500;1,32;1,21\n1000;1,30;1,25\n"
    )
    (folder / "room" / "hall.geo").write_text(
        "".join(f"ABS material_{i} = <10 20 30 40 50 60>\n" for i in range(12))
    )
    room, _ = rt.datasets.bras_cr2()
    simulated = rt.Measurement.from_values(room.centre_frequencies, t20=[1.0] * room.n_bands)
    simulated.save(str(folder / "room" / "simulated.csv"))
    return folder


AREAS = [x for i in range(11) for x in ("--area", f"material_{i}={10 + i}")]
STATE = ["--state", "loop.json", "--out", "next.toml"]
FIT = ["fit", "hall.toml", "t.csv", "--paths", "160", "--match", "t20", "--out", "fitted"]
CALLS: list[tuple[str, list[str], int]] = [
    ("room", ["example", "optimisation", "--out", "a-rather-long-name-of-a-folder"], 0),
    ("room", ["example", "optimisation", "--out", "a-rather-long-name-of-a-folder"], 2),
    ("room", ["calibrate", "room.toml", "t.csv", "--out", "calibrated"], 0),
    ("room", ["calibrate", "room.toml", "t.csv", "--solver", "simplex"], 2),
    ("room", ["report", "calibrated"], 0),
    ("room", ["learn", "calibrated"], 2),
    ("change", ["predict", "room.toml", "t.csv", "--change", "variants.toml"], 0),
    ("change", ["predict", "room.toml", "t.csv", "--change", "treatments.toml"], 2),
    ("change", ["design", "room.toml", "t.csv", "--treatments", "treatments.toml"], 0),
    ("change", ["design", "room.toml", "t.csv", "--treatments", "variants.toml"], 2),
    ("room", ["table", "dirac.csv"], 2),
    ("room", ["table", "dirac.csv", "--decay-time", "t30", "--out", "u.csv"], 0),
    ("room", ["import", "catt", "hall.geo", "--volume", "900", *AREAS, "--out", "hall.toml"], 0),
    ("room", ["import", "catt", "hall.geo", "--volume", "9", "--area", "wod=1", "--out", "x"], 2),
    ("room", ["export", "catt", "hall.toml", "hall.geo"], 0),
    ("room", ["loop", "start", "room.toml", "t.csv", *STATE], 0),
    ("room", ["loop", "next", "room.toml", "simulated.csv", *STATE], 0),
    ("room", ["loop", "next", "room.toml", "simulated.csv", *STATE], 2),
    ("room", ["report", "loop.json"], 0),
    ("room", ["loop", "back", "room.toml", *STATE], 0),
    ("responses", ["measure", "S1_R1.wav", "S2_R1.wav", "--minimum-range", "t30=60"], 0),
    ("responses", ["measure", "S1_R1.wav", "--bands", "third-octave", "--out", "t.csv"], 0),
    ("room", ["compare", "room.toml", "t.csv"], 0),
    ("simulator", FIT, 0),
    ("missing-effect", ["plan", "case.json"], 0),
    ("missing-effect", ["find", "case.json"], 0),
    ("missing-effect", ["find", "case.json", "--out", "gap"], 0),
    ("missing-effect", ["verify", "gap"], 0),
    ("missing-effect", ["verify", "case.json"], 2),
    ("missing-effect", ["apply", "gap", "--out", "c"], 0),
    ("missing-effect", ["diagnose", "case.json", "--out", "d"], 0),
    (
        "room",
        ["study", "--trials", "9", "--realisations", "30", "--kind", "shoebox", "--kind", "halls"],
        0,
    ),
]


@pytest.fixture(scope="module")
def computed() -> Any:
    """The slow part of each command, once for all widths: what is tested is their text."""
    from rtcal import finder
    from rtcal.finder import search, verification  # noqa: F401 (before what it uses is replaced)
    from rtcal.loop import measured_pairs
    from rtcal.loop import positions as loop_positions
    from rtcal.prediction import designed
    from rtcal.report import document, figures, of_finding

    def once(function: Any) -> Any:
        results: list[Any] = []

        def first(*arguments: Any, **options: Any) -> Any:
            if not results:
                results.append(function(*arguments, **options))
            return results[0]

        return first

    with pytest.MonkeyPatch.context() as patch:
        for module, name in (
            (search, "find"),
            (finder, "verify"),
            (finder, "plan"),
            (designed, "design"),
            (loop_positions, "calibrate_positions"),
        ):
            patch.setattr(module, name, once(getattr(module, name)))
        patch.setattr(measured_pairs, "RUNS", 2)
        drawn = [document.Picture(lambda: None, "", name="residuals")]
        patch.setattr(of_finding, "pictures", lambda *_: drawn)
        patch.setattr(document, "source", lambda *_: "data:,")
        patch.setattr(figures, "rendered", lambda *_: b"")
        yield


def longest(text: str) -> str:
    return max(text.splitlines() or [""], key=len)


def test_every_command_is_called() -> None:
    called = {" ".join(arguments) for _, arguments, _ in CALLS}
    assert [n for n in command_names() if not any(f"{c} ".startswith(f"{n} ") for c in called)] == [
        f"import {n}" for n in ("check", "odeon", "pyroomacoustics", "bras", "library", "catalogue")
    ]


@pytest.mark.long
def test_no_line_is_longer_than_the_terminal(
    projects: Path, computed: None, monkeypatch, capsys, tmp_path
) -> None:
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    folder = tmp_path / "p"
    shutil.copytree(projects, folder)
    widest = 0
    for project, arguments, code in CALLS:
        monkeypatch.chdir(folder / project)
        assert run(*arguments) == code, capsys.readouterr().err
        said = capsys.readouterr()
        assert said.out if code == 0 else said.err
        for stream in said:
            line = longest(stream)
            assert len(line) <= COLUMNS, f"rtcal {' '.join(arguments)}: {line}"
            widest = max(widest, len(line))
    assert widest > COLUMNS - 8


def test_an_error_is_one_line_where_no_one_looks(monkeypatch, capsys) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    name = "a-file-that-does-not-exist-" * 4
    assert run("calibrate", f"{name} and blanks.toml", "t.csv") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("rtcal: ")
    assert len(line) > 80


def test_a_long_task_says_how_far_it_is_without_a_terminal(monkeypatch) -> None:
    """`fit` was silent for fifteen minutes in a log."""
    lines: list[str] = []

    def another_line() -> str:
        number, until = len(lines), time.monotonic() + 20
        while len(lines) == number and time.monotonic() < until:
            time.sleep(0.01)
        return lines[-1]

    monkeypatch.setattr(speed, "PATIENCE", 0.05)
    with speed.bar(0, "model", wanted=False, say=lines.append) as shown:
        assert another_line() == "no model is done yet"
        shown.reset(total=4)
        shown.set_description("weighing")
        assert re.match(r"weighing: 0 of 4 models done in 00:\d\d", another_line())
        shown.update(1)
        assert re.match(r"weighing: 1 of 4 models done in 00:\d\d, about 00:", another_line())
    lines.clear()
    with speed.bar(2, "figure", wanted=False, say=lines.append) as shown:
        speed.following(shown)(2, 2)
    time.sleep(0.1)
    assert shown.n == 2
    assert lines == []
