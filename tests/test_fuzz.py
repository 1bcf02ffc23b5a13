"""Broken files give a typed error that names the place, or a right reading; nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from rtcal.io import text
from tests import fuzz
from tests.conftest import also

EXAMPLES = 500


@pytest.mark.long
@settings(
    max_examples=EXAMPLES,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(fuzz.broken())
def test_broken_files(tmp_path: Path, case: tuple[str, bytes]) -> None:
    fuzz.check(*case, tmp_path)


@pytest.mark.parametrize("name", sorted(fuzz.READERS))
def test_the_good_files_are_read(name: str, tmp_path: Path) -> None:
    for seed in fuzz.READERS[name].seeds:
        assert fuzz.check(name, seed, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(fuzz.READERS))
def test_what_the_fuzzer_kept_is_read_or_refused(name: str, tmp_path: Path) -> None:
    contents = fuzz.kept(name)
    assert contents
    for content in contents:
        fuzz.check(name, content, tmp_path)


def large() -> dict[str, tuple[str, bytes]]:
    """Files as large as is let pass, of what costs most."""
    mb, n = text.MAX_TEXT, 900_000
    pairs = "".join(f"S{i},R,T20,{20 + i},1\n" for i in range(8000))
    rng = np.random.default_rng(0)
    return {
        "json depth": ("pyroomacoustics", b"[" * mb),
        "table digits": ("tables", b"f;T20\n500;" + b"9" * (mb - 20)),
        "table header": ("tables", b"f;" + b"T20 " * (mb // 4 - 20) + b"\n500;1\n"),
        "measurement": ("measurement", ("source,receiver,parameter,band,value\n" + pairs).encode()),
        "room depth": ("room", b"a = " + b"[" * (mb - 10)),
        "wav": ("wav", fuzz.wav(rng.uniform(-1, 1, n) * np.exp(-np.arange(n) / 48000), 48000)),
    }


LARGE = large()


@pytest.mark.parametrize("case", ["table digits", *also(*sorted({*LARGE} - {"table digits"}))])
def test_memory_and_time(case: str, tmp_path: Path) -> None:
    name, content = LARGE[case]
    peak = fuzz.peak_memory(name, content, tmp_path)
    assert peak < 10 * len(content) + 64 * 2**20
