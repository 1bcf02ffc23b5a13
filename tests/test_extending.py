"""Each block of docs/extending.md is a program that adds to rtcal from outside."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SECTIONS = re.findall(
    r"^## (.+?)$.*?^```python\n(.*?)^```$",
    (ROOT / "docs" / "extending.md").read_text(encoding="utf-8"),
    re.M | re.S,
)


def test_there_are_six_extensions() -> None:
    kinds = [title.split()[1] for title, _ in SECTIONS]
    assert kinds == ["equation", "term", "observable", "effect", "format", "simulator"]


@pytest.mark.long  # six programs, each with its own start
@pytest.mark.parametrize(("title", "program"), SECTIONS, ids=[t for t, _ in SECTIONS])
def test_an_extension_works_from_outside(title: str, program: str, tmp_path: Path) -> None:
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


@pytest.mark.long
def test_a_program_that_prints_otherwise_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AssertionError):
        test_an_extension_works_from_outside("wrong", "print(1)  # 2", tmp_path)
