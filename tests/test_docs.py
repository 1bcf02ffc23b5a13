"""The documents' code runs: the blocks of README and docs."""

import ast
import contextlib
import inspect
import io
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import rtcal as rt
from tests.test_names import public_paths

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]

pytestmark = pytest.mark.skipif(not PAGES[0].exists(), reason="needs the source tree")


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)


def shown_after(block, statement):
    """Return the comment behind a statement of a block, on its last line."""
    line = block.splitlines()[statement.end_lineno - 1].encode()
    return line[statement.end_col_offset :].decode().strip().removeprefix("#").strip()


def run_and_compare(block, where, names):
    """Run a block; each top-level print has to print the comment behind it, whole."""
    tree = ast.parse(block)
    for statement in tree.body:
        module = ast.Module([statement], type_ignores=[])
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            exec(compile(module, where, "exec"), names)
        printed, shown = output.getvalue(), ""
        if printed:
            shown = shown_after(block, statement)
            assert shown, f"{where}: line {statement.lineno} prints, and no comment shows what"
        if shown != "...":
            assert " ".join(printed.split()) == " ".join(shown.split()), f"{where}: {shown}"


LONG = {
    f"docs/{name}.md"
    for name in (
        "positions",
        "discrepancy",
        "closed_loop",
        "modes",
        "report",
        "where",
        "design",
        "qp",
        "prediction",
        "two_states",
        *(f"api/{n}" for n in ("discrepancy", "independent_solvers", "other", "simulators")),
    )
}
"""Pages whose blocks take more than two seconds of processor time."""


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(p, id=name, marks=[pytest.mark.long] if name in LONG else [])
        for p in PAGES
        for name in [p.relative_to(ROOT).as_posix()]
        if name != "docs/extending.md"  # each block runs by itself
    ],
)
def test_python_blocks_run_and_print_what_they_say(page, tmp_path, monkeypatch):
    """The blocks of a page run one after the other, in one namespace and an empty folder."""
    monkeypatch.chdir(tmp_path)
    names = {}
    text = page.read_text(encoding="utf-8")
    for name, content in re.findall(r'^```\w+ title="([^"\n]+)"\n(.*?)^```', text, re.M | re.S):
        Path(name).write_text(content, encoding="utf-8")
    for block in blocks(page, "python"):
        if f"{block}```\n\n```text\n" in text:  # tests/test_shown.py compares what it prints
            with contextlib.redirect_stdout(io.StringIO()):
                exec(block, names)
        else:
            run_and_compare(block, str(page), names)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_a_command_of_the_benchmarks_is_there_or_has_its_commit():
    command = re.compile(
        r"`python\s(?:-m\s)?(benchmarks[\w./]*)[^`]*`(?:\s\([^)]*\))?(\sin\scommit\s\w{8})?"
    )
    found = 0
    for page in (*PAGES, *(ROOT / "benchmarks").glob("**/*.md")):
        for named, commit in command.findall(page.read_text(encoding="utf-8")):
            path = ROOT / named.removesuffix(".py").replace(".", "/")
            found += 1
            there = path.with_suffix(".py").exists() or (path / "__main__.py").exists()
            assert there or commit, f"{page}: {named}"
    assert found > 30


def test_the_files_page_shows_files_that_are_read(tmp_path):
    page = ROOT / "docs" / "files.md"
    (tmp_path / "room.toml").write_text(blocks(page, "toml")[0], encoding="utf-8")
    (tmp_path / "t.csv").write_text(blocks(page, "csv")[0], encoding="utf-8")
    room = rt.Room.from_file(tmp_path / "room.toml")
    assert room.areas.tolist() == [34.93, 49.3]
    result = rt.calibrate(room, rt.Measurement.from_file(tmp_path / "t.csv"))
    assert abs(result.gap_after).max() < 1e-9


def test_version_and_citation_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["project"]["name"] == "rtcal"
    assert f"version: {rt.__version__}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert "10.1051/aacus/2025011" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {rt.__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


NEEDS_NO_EXAMPLE = {
    "page_of": "as page.page, from a folder",
    "from_sweep": "as rtcal measure --sweep, from recordings",
    "interrupted": "as rtcal measure --interrupted, from recordings",
}


def test_every_public_name_has_an_example_that_runs():
    shown = "\n".join(
        block for page in (ROOT / "docs").glob("**/*.md") for block in blocks(page, "python")
    )
    words = set(re.findall(r"\w+", shown))
    names = public_paths()
    assert len(names) > 120
    missing = [
        name
        for name, value in names.items()
        if (inspect.isclass(value) or inspect.isfunction(value))
        and (last := name.rpartition(".")[2]) not in words | {*NEEDS_NO_EXAMPLE}
        and ">>> " not in (inspect.getdoc(value) or "")
        and not (inspect.isclass(value) and last in _mentioned())
    ]
    assert not missing
    assert {n.rpartition(".")[2] for n in names} >= {*NEEDS_NO_EXAMPLE}


def _mentioned():
    """Classes that are never called by name: the page says which line of its example returns one."""
    pages = (ROOT / "docs" / "api").glob("*.md")
    return {w for page in pages for w in re.findall(r"`(\w+)`", page.read_text(encoding="utf-8"))}


SECTIONS = re.findall(
    r"^## (.+?)$.*?^```python\n(.*?)^```$",
    (ROOT / "docs" / "extending.md").read_text(encoding="utf-8"),
    re.M | re.S,
)


def test_there_are_six_extensions():
    kinds = [title.split()[1] for title, _ in SECTIONS]
    assert kinds == ["equation", "term", "observable", "effect", "format", "simulator"]


@pytest.mark.long  # six programs, each with its own start
@pytest.mark.parametrize(("title", "program"), SECTIONS, ids=[t for t, _ in SECTIONS])
def test_an_extension_works_from_outside(title, program, tmp_path):
    """The package's own files stay as they are, and the last line prints what it says."""
    package = sorted((ROOT / "rtcal").rglob("*.py"))
    before = [path.stat().st_mtime_ns for path in package]
    (tmp_path / "mine.py").write_text(program, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "mine.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == program.strip().rpartition("  # ")[2]
    assert [path.stat().st_mtime_ns for path in package] == before
