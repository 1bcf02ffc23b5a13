"""Broken files give a typed error that names the place, or a right reading; nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from rtcal.io import text
from tests import fuzz

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
    number = "ABS a{} = <1 2 3 4 5 6>\n"
    pairs = "".join(f"S{i},R,T20,{20 + i},1\n" for i in range(8000))
    rng = np.random.default_rng(0)
    return {
        "catt statements": ("catt", "".join(number.format(i) for i in range(40000)).encode()[:mb]),
        "catt one line": ("catt", b"ABS a = <" + b"1 " * (mb // 2 - 100) + b">"),
        "catt blanks": ("catt", b"ABS a = <1 2 3 4 5 6>" + b" " * (mb - 30) + b"x"),
        "catt names": ("catt", b"a" * (mb - 1)),
        "odeon": (
            "odeon",
            "".join(f"{i} x\n0 0 0 0 0 0 0 0\n" for i in range(45000)).encode()[:mb],
        ),
        "json depth": ("pyroomacoustics", b"[" * mb),
        "json numbers": ("pyroomacoustics", b'{"coeffs": [' + b"0," * (mb // 2 - 50) + b"0]}"),
        "json texts": ("pyroomacoustics", b'{"a": "' + b"\\" * (mb - 20)),
        "bras": ("bras", b"1," * (mb // 2)),
        "bras lines": ("bras", b"1\n" * (mb // 2)),
        "obj vertices": ("obj", b"v 0 0 0\n" * (mb // 8)),
        "obj face": ("obj", b"v 0 0 0\nusemtl a\nf " + b"1 " * (mb // 2 - 100)),
        "table pairs": ("tables", ("source,receiver,parameter,band,value\n" + pairs).encode()),
        "table cells": ("tables", b"T20,125\n" + b"," * (mb - 20)),
        "table digits": ("tables", b"f;T20\n500;" + b"9" * (mb - 20)),
        "table header": ("tables", b"f;" + b"T20 " * (mb // 4 - 20) + b"\n500;1\n"),
        "table blanks": ("tables", b'f;T20\n500;"1' + b" " * (mb - 30) + b'1"\n'),
        "measurement": ("measurement", ("source,receiver,parameter,band,value\n" + pairs).encode()),
        "measurement cells": ("measurement", fuzz.MEASURED[0] + b"," * (mb - 5000)),
        "room surfaces": (
            "room",
            fuzz.ROOM[0] + b'[[surface]]\nmaterial="plaster"\narea=1\n' * 4900,
        ),
        "room materials": (
            "room",
            fuzz.ROOM[0]
            + b"".join(
                b'[[material]]\nname="m%d"\narea=1\nalpha=[0,0,0,0,0,0]\n' % i for i in range(4000)
            ),
        ),
        "room depth": ("room", b"a = " + b"[" * (mb - 10)),
        "room keys": ("room", b".".join([b"a"] * (mb // 2 - 10)) + b" = 1"),
        "wav": ("wav", fuzz.wav(rng.uniform(-1, 1, n) * np.exp(-np.arange(n) / 48000), 48000)),
    }


LARGE = large()


# The others cost half a minute under the memory tracer and are run by `make study`.
IN_THE_SUITE = (
    "catt statements",
    "json depth",
    "measurement",
    "room depth",
    "room surfaces",
    "table blanks",
    "table digits",
    "table header",
    "wav",
)


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=() if c in IN_THE_SUITE else pytest.mark.study) for c in sorted(LARGE)],
)
def test_memory_and_time(case: str, tmp_path: Path) -> None:
    name, content = LARGE[case]
    peak = fuzz.peak_memory(name, content, tmp_path)
    assert peak < 10 * len(content) + 64 * 2**20
