"""One name for one thing: modules, functions, classes and the public lists are walked."""

import ast
import inspect
import re
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import pytest

import rtcal as rt
from rtcal.command.main import cli

PACKAGE = Path(rt.__file__).parent
MODULES = {
    ".".join(("rtcal", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(
        ".__init__"
    ): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
Trees = dict[str, ast.Module]


@pytest.fixture(scope="module")
def trees():
    """Every module, parsed. It goes with these tests: millions of nodes slow what collects garbage."""
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}


def definitions(trees: Trees, kind: type[ast.FunctionDef | ast.ClassDef]) -> list[tuple[str, str]]:
    """Return (module, name) of what stands at the head of every module."""
    return [
        (module, node.name)
        for module, tree in trees.items()
        for node in tree.body
        if isinstance(node, kind)
    ]


def test_no_two_classes_have_one_name(trees):
    names = (name for _, name in definitions(trees, ast.ClassDef) if not name.startswith("_"))
    assert {name for name, n in Counter(names).items() if n > 1} == set()


def public_objects() -> dict[str, Any]:
    """Return the public classes and functions by the name of their module and their own."""
    found, modules = {}, [rt]
    for module in modules:
        for value in (getattr(module, name) for name in module.__all__):
            if isinstance(value, ModuleType):
                modules += [value] * (value not in modules)
            elif inspect.isclass(value) or inspect.isfunction(value):
                found[f"{value.__module__}.{value.__name__}"] = value
    return found


FORMULA = re.compile(r"[²½]|⁻¹|\^")
SOURCE = re.compile(r"(18|19|20)\d\d|ISO|IEC|Eqs?\.|docs/\w+\.md")


def test_every_formula_has_a_source():
    """The source is a publication, a standard, or the page that derives it."""
    with_formula = []
    for name, value in public_objects().items():
        text = inspect.getdoc(value) or ""
        prose = re.split(r"\n(?:Parameters|Attributes|Returns|Raises|Examples)\n-+", text)[0]
        if FORMULA.search(re.sub("m²|m³|s²", "", prose)):
            with_formula.append(name)
            module = sys.modules[value.__module__].__doc__ or ""
            assert SOURCE.search(text) or SOURCE.search(module), f"{name} has no source"
    assert len(with_formula) > 10


def options_by_name() -> dict[str, dict[str, dict[str, Any]]]:
    """Return what each option is in each command that has it."""
    found: dict[str, dict[str, dict[str, Any]]] = {}

    def walk(command: click.Command, name: str) -> None:
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


def public_paths() -> dict[str, Any]:
    """Return every public object by each path below `rtcal` by which a user reaches it."""
    paths: dict[str, Any] = {}

    def walk(module: ModuleType, path: str) -> None:
        for name in module.__all__:
            value = getattr(module, name)
            if isinstance(value, ModuleType) or inspect.isclass(value) or callable(value):
                paths[f"{path}.{name}"] = value
            if isinstance(value, ModuleType):
                walk(value, f"{path}.{name}")

    walk(rt, "rtcal")
    return paths


def test_every_public_object_has_one_path():
    """`rtcal.calibrate`, `rtcal.calibration.calibrate`: a reader asks how they differ."""
    paths = public_paths()
    assert len(paths) > 100
    times = Counter(map(id, paths.values()))
    assert [name for name, value in paths.items() if times[id(value)] > 1] == []
    assert len(rt.__all__) <= 45
