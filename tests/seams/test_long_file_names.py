"""A law: a file's name that the system refuses, above 255 bytes, is unusable input in every command."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import pytest

import rtcal as rt
from rtcal.command.main import cli, main

LONG = "a" * 300 + ".toml"
"""A name that no file system of today takes."""
FIRST = {"export": "catt", "example": "room"}
"""A command's argument that is a choice."""
OTHERS = {"measured": "t.csv", "simulated": "t.csv", "state": "state.json"}
REFUSED_BEFORE = {
    ("predict", "measured"),
    ("predict", "also"),
    ("loop next", "simulated"),
    ("find", "simulated"),
    ("find", "at"),
    ("compare", "at"),
    ("loop start", "at"),
    ("verify", "simulated"),
    ("verify", "calibrated"),
    ("verify", "before"),
    ("verify", "after"),
    ("plan", "further"),
    ("measure", "positions"),
    *(
        (f"import {program}", path)
        for program in ("check", "bras", "catt", "catalogue", "library", "odeon", "pyroomacoustics")
        for path in ("mesh", "mended", "picture", "sigma_table")
    ),
    ("learn", "room"),
}
"""Paths that are not opened, since another argument is refused before."""


def commands(group: click.Group, *above: str) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Yield each command with the words that call it."""
    for name in group.list_commands(click.Context(group)):
        command = group.get_command(click.Context(group), name)
        if isinstance(command, click.Group):
            yield from commands(command, *above, name)
        elif command is not None:
            yield (*above, name), command


def is_path(parameter: click.Parameter) -> bool:
    return isinstance(parameter.type, click.Path)


def code(words: list[str]) -> object:
    """Return the exit code of a command; another exception is a crash."""
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code


CASES = [
    pytest.param(words, command, parameter, id=" ".join((*words, parameter.name or "")))
    for words, command in commands(cli)
    for parameter in command.params
    if is_path(parameter) and parameter.name != "out"
]


@pytest.mark.parametrize(("words", "command", "long"), CASES)
def test_of_what_is_read(
    words: tuple[str, ...],
    command: click.Command,
    long: click.Parameter,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each path in turn is too long; the needed others are a room and its measurement."""
    monkeypatch.chdir(tmp_path)
    room, measured = rt.datasets.bras_cr2()
    room.save("room.toml")
    measured.save("t.csv")
    options: list[str] = []
    arguments: list[str] = []
    for parameter in command.params:
        needed = parameter.required or parameter.name == "measured"
        if parameter is not long and (not needed or parameter.name == "out"):
            continue
        value = LONG if parameter is long else OTHERS.get(parameter.name or "", "room.toml")
        if isinstance(parameter, click.Argument):
            arguments.append(value if is_path(parameter) else FIRST[words[0]])
        else:
            options += [parameter.opts[-1], *[value] * parameter.nargs]
    if any(p.name == "out" and p.required for p in command.params):
        options += ["--out", "new.toml"]
    before = sorted(tmp_path.iterdir())
    assert code([*words, *arguments, *options]) == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert "cannot print" not in said
    if (" ".join(words), long.name) not in REFUSED_BEFORE:
        assert "too long" in said or "does not exist" in said
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "words",
    [
        ["calibrate", "room.toml", "t.csv"],
        ["table", "t.csv"],
        ["example", "room"],
        ["loop", "start", "room.toml", "t.csv", "--state", "state.json"],
    ],
    ids=lambda words: words[0],
)
def test_of_what_is_written(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    room, measured = rt.datasets.bras_cr2()
    room.save("room.toml")
    measured.save("t.csv")
    before = sorted(tmp_path.iterdir())
    name = LONG.replace(".toml", ".csv") if words[0] == "table" else LONG
    assert code([*words, "--out", name]) == 2
    assert "too long" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before
