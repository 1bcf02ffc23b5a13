"""One name for one thing: modules, functions, classes and the public lists are walked."""

import ast
import inspect
import re
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType

import click
import pytest

import rtcal as rt
from rtcal.command.main import cli


def test_no_two_classes_have_one_name():
    modules = [ast.parse(path.read_bytes()) for path in Path(rt.__file__).parent.rglob("*.py")]
    names = [n.name for m in modules for n in m.body if isinstance(n, ast.ClassDef)]
    assert [n for n, times in Counter(names).items() if times > 1 and n[0] != "_"] == []


def public_paths():
    """Return every public object by each path below `rtcal` by which a user reaches it."""
    paths = {}

    def walk(module, path):
        for name in module.__all__:
            value = paths[f"{path}.{name}"] = getattr(module, name)
            if isinstance(value, ModuleType):
                walk(value, f"{path}.{name}")

    walk(rt, "rtcal")
    return paths


FORMULA = re.compile(r"[²½]|⁻¹|\^")
SOURCE = re.compile(r"(18|19|20)\d\d|ISO|IEC|Eqs?\.|docs/\w+\.md")


def test_every_formula_has_a_source():
    """The source is a publication, a standard, or the page that derives it."""
    with_formula = []
    for name, value in public_paths().items():
        if not (inspect.isclass(value) or inspect.isfunction(value)):
            continue
        text = inspect.getdoc(value) or ""
        prose = re.split(r"\n(?:Parameters|Attributes|Returns|Raises|Examples)\n-+", text)[0]
        if FORMULA.search(re.sub("m²|m³|s²", "", prose)):
            with_formula.append(name)
            module = sys.modules[value.__module__].__doc__ or ""
            assert SOURCE.search(text) or SOURCE.search(module), f"{name} has no source"
    assert len(with_formula) > 10


def options_by_name():
    """Return what each option is in each command that has it."""
    found = {}

    def walk(command, name):
        for key, inner in getattr(command, "commands", {}).items():
            walk(inner, f"{name} {key}")
        for option in command.params:
            if isinstance(option, click.Option):
                stated = option.to_info_dict()
                stated.pop("name")  # the argument of the function in Python
                for said in option.opts:
                    found.setdefault(said, {})[name.strip()] = stated

    walk(cli, "")
    return found


OPTIONS = options_by_name()


@pytest.mark.parametrize("option", sorted(OPTIONS.keys() - {"--out"}))
def test_an_option_is_the_same_in_every_command(option):
    first, *others = OPTIONS[option].values()
    for other in others:
        assert other == first
    assert first["help"].endswith("."), option
    assert not first["hidden"], option


def test_every_command_that_prints_prints_json_and_can_be_quiet():
    commands = {command for stated in OPTIONS.values() for command in stated} - {""}
    assert {*OPTIONS["--json"]} == {*OPTIONS["--quiet"]} == {*OPTIONS["-q"]} == commands


def test_every_public_object_has_one_path():
    """`rtcal.calibrate`, `rtcal.calibration.calibrate`: a reader asks how they differ."""
    paths = {path: value for path, value in public_paths().items() if callable(value)}
    assert len(paths) > 100
    times = Counter(map(id, paths.values()))
    assert [name for name, value in paths.items() if times[id(value)] > 1] == []
    assert len(rt.__all__) <= 45
