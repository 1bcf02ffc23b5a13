"""Every command runs, and its output fits the terminal; a long step says what it does."""

import re
import time

import pytest

from rtcal.support import speed
from tests.conftest import run

pytest.importorskip("matplotlib", reason="needs the extra report")
pytest.importorskip("jinja2", reason="needs the extra report")

pytestmark = pytest.mark.usefixtures("runs_kept")


def test_an_error_is_one_line_where_no_one_looks(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    name = "a-file-that-does-not-exist-" * 4
    assert run("calibrate", f"{name} and blanks.toml", "t.csv") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("rtcal: ")
    assert len(line) > 80


def test_a_long_task_says_how_far_it_is_without_a_terminal(monkeypatch):
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
