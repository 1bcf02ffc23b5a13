"""The API pages show what is public, each name once, and nothing else (`mkdocs_public.py`)."""

import inspect
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

import rtcal as rt
from tests.test_names import public_paths

griffe = pytest.importorskip("griffe", reason="needs the extra docs")
ROOT = Path(__file__).resolve().parents[1]
if not (ROOT / "docs").is_dir():
    pytest.skip("needs the source tree", allow_module_level=True)

import mkdocs_public  # noqa: E402


@cache
def package():
    extensions = griffe.load_extensions(mkdocs_public.PublicNames)
    return griffe.load("rtcal", extensions=extensions, docstring_parser="numpy")


def entries():
    return re.findall(r"^::: rtcal\.(\S+)$", "\n".join(mkdocs_public.API), re.M)


def shown(entry):
    """Return the names at the head of modules that an entry of a page shows."""
    entered = package()[entry]
    one = entered.final_target if entered.is_alias else entered
    heads = [one]
    if one.is_module:
        own = (head for head in one.members.values() if not head.is_alias)
        heads = [head for head in own if head.public and not head.is_module]
    return [head.path for head in heads if head.has_docstrings]


def test_every_public_name_is_on_one_page():
    times = Counter(name for entry in entries() for name in shown(entry))
    assert {name for name, n in times.items() if n > 1} == set()
    public = mkdocs_public.public_names(package())
    documented = {path for path, one in public.items() if one.has_docstrings}
    assert {path for path in documented - times.keys() if "rtcal.command." not in path} == set()
    for path, value in public_paths().items():
        if inspect.isclass(value) or inspect.isfunction(value):
            assert f"{value.__module__}.{value.__qualname__}" in times, path


def test_a_page_shows_nothing_that_is_neither_exported_nor_named():
    """A name stands in a public list, in a page's text, or in the signature of a public function."""
    text = re.sub("^:::.*", "", "\n".join(mkdocs_public.API + mkdocs_public.GUIDES), flags=re.M)
    values = public_paths()
    signatures = [
        str(inspect.signature(value)) for value in values.values() if inspect.isfunction(value)
    ]
    known = set(re.findall(r"\w+", " ".join([*values, text, *signatures])))
    names = [name for entry in entries() for name in shown(entry)]
    assert len(names) > 200
    assert [name for name in names if name.rpartition(".")[2] not in known] == []


def test_every_entry_shows_something():
    assert [entry for entry in entries() if not shown(entry)] == []


def test_the_overview_has_every_name_of_the_top_level():
    overview = (ROOT / "docs" / "api" / "index.md").read_text(encoding="utf-8")
    assert [name for name in rt.__all__ if f"`rt.{name}`" not in overview] == []


def test_a_member_that_needs_what_no_user_has_is_not_shown():
    room = package()["acoustics.room.Room"]
    assert room["absorption_area"].public
    assert not room["of_table"].public  # it takes a `RoomFile`
    assert "rt.Room" in room.labels
