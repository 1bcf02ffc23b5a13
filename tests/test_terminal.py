"""Every command runs, and its output fits the terminal; a long step says what it does."""

import re
import time

import pytest

from rtcal.support import speed, text
from rtcal.support.blocks import Row, Table, notebook
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
    lines = []

    def another_line():
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
    with speed.bar(1, "response", wanted=False, say=lines.append) as shown:
        assert re.fullmatch(r"0 of 1 response done in 00:\d\d", another_line())
        shown.update(1)
    assert re.fullmatch(r"1 of 1 response done in 00:\d\d", lines[-1])
    lines.clear()
    with speed.bar(2, "figure", wanted=False, say=lines.append) as shown:
        speed.following(shown)(2, 2)
    time.sleep(0.1)
    assert shown.n == 2
    assert lines == []


# Printed text and notebook tables: widths, wrapping, control characters, escapes


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.mark.parametrize(("columns", "expected"), [("20", 40), ("60", 60), ("120", 120)])
def test_a_line_has_the_terminals_width_and_at_least_40(monkeypatch, columns, expected):
    monkeypatch.setenv("COLUMNS", columns)
    assert text.width() == expected
    rows = [(f"row {i}", [f"{i}.{j:04d}" for j in range(40)]) for i in range(3)]
    lines = text.table(rows, header=("", [f"{j} Hz" for j in range(40)]))
    assert max(map(len, lines)) <= expected
    cells = " ".join(lines).split()
    assert all(f"{i}.{j:04d}" in cells for i in range(3) for j in range(40))


def test_sentences_are_wrapped_but_no_path_is_broken():
    path = "/a" * 60
    lines = text.wrapped(f"the room is written to {path} as it is", indent="  ")
    assert path in [line.strip() for line in lines]
    assert [line for line in lines if len(line) > 80] == ["    " + path]


def test_no_terminal_obeys_what_is_printed():
    hostile = "wall\x1b[2J\x07\x9b1m\u202e\ud800\tend\n"
    assert text.printable(hostile) == "wall\\x1b[2J\\x07\\x9b1m\\u202e\\ud800\tend\n"
    assert text.printable("Wände: 0,05 m² – 4 €") == "Wände: 0,05 m² – 4 €"


def test_an_html_table_escapes_and_shades():
    table = Table(["125"], [Row("a & b", ["<3"], shade=[-2.0])], note="x < y")
    page = notebook("<T>", [table])
    assert "&lt;T&gt;" in page
    assert "a &amp; b" in page
    assert "rgba(0, 114, 178, 0.45)" in page
    assert "&lt;3" in page
    assert "<p>x &lt; y</p>" in page
