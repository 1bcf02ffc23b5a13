"""`rtcal table`: options without use, spellings, positions; and the errors of the native file."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import run


@pytest.mark.parametrize(
    "content",
    ["RT60 500 Hz,1k\n1,2\n", "parameter,500\nRT60,1\n"],
)
def test_a_decay_time_is_used_wherever_rt60_stands(tmp_path: Path, content: str) -> None:
    path = tmp_path / "in.csv"
    path.write_text(content.replace("1k", "RT60 1k"))
    assert run("table", path, "--decay-time", "T30") == 0
