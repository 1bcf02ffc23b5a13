"""A study's folder: a piece that is damaged, or of another study, is computed again."""

from __future__ import annotations

import json
import os
import random
import shutil
import tracemalloc
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from rtcal import studies
from rtcal.files import disk
from rtcal.studies.runner import _open
from rtcal.support.errors import DataError
from tests import faults


def run(folder: Path | None, seed: int = 3) -> list[object]:
    areas = [35, 35, 21, 21, 15, 15]
    table: list[object] = studies.run(areas, 0.05, 250, 20, seed, folder=folder).scores().tolist()
    return table


def piece_of(folder: Path, number: int) -> Path:
    (piece,) = folder.glob(f"piece-{number:08d}-*.sums")
    return piece


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A finished study of three pieces."""
    run(tmp_path / "study")
    return tmp_path / "study"


def test_a_piece_with_any_bit_turned_is_computed_again(folder: Path) -> None:
    """697 of 6,278 such pieces ended in a traceback, others changed the table."""
    store = _open(folder, json.loads((folder / "study.json").read_text()))
    piece = piece_of(folder, 1)
    good = piece.read_bytes()
    assert store.read(1) is not None
    rng = random.Random(0)
    for bit in rng.sample(range(8 * len(good)), 300):
        damaged = bytearray(good)
        damaged[bit // 8] ^= 1 << bit % 8
        piece.write_bytes(damaged)
        assert store.read(1) is None


def copied(folder: Path) -> None:
    shutil.copy(piece_of(folder, 0), piece_of(folder, 1))


def of_another_study(folder: Path) -> None:
    run(folder / "other", seed=4)
    shutil.copy(piece_of(folder / "other", 1), piece_of(folder, 1))


def doubled(folder: Path) -> None:
    piece = piece_of(folder, 1)
    piece.write_bytes(2 * piece.read_bytes())


def missing(folder: Path) -> None:
    piece_of(folder, 2).unlink()


def large(folder: Path) -> None:
    """100 kB that unpack to 100 MB."""
    packer = zlib.compressobj(9)
    zeros = bytes(2**20)
    packed = b"".join(packer.compress(zeros) for _ in range(100)) + packer.flush()
    piece_of(folder, 1).write_bytes(b"rtcal piece\n" + packed)


@pytest.mark.parametrize("damage", [copied, of_another_study, doubled, large, missing])
def test_a_piece_that_is_another_is_computed_again(
    damage: Callable[[Path], None], folder: Path
) -> None:
    whole = run(None)
    damage(folder)
    tracemalloc.start()
    assert run(folder) == whole
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


@pytest.mark.long
def test_a_study_goes_on_after_a_fault_at_any_event(tmp_path: Path) -> None:
    whole = run(None)
    with faults.faulty(None) as layer:
        run(tmp_path / "counted")
    assert layer.count > 10
    for nth in range(1, layer.count + 1, 3):
        place = tmp_path / f"fault {nth}"
        with faults.faulty(nth), suppress(DataError):
            assert run(place) == whole
        faults.killed(lambda p=place: run(p), nth)
        assert run(place) == whole


def test_a_kept_array_that_is_damaged_or_another_counts_as_missing(tmp_path: Path) -> None:
    """A header that asks for 500 GB ended in a traceback, and a NaN was taken."""
    place = tmp_path / "folder" / "a.array"
    disk.write(place, np.arange(6.0).reshape(2, 3))
    again = disk.read(place)
    assert again is not None
    np.testing.assert_array_equal(again, [[0, 1, 2], [3, 4, 5]])
    good = place.read_bytes()
    for damaged in (
        good.replace(b"(2, 3)", b"(9**19, 3)"),
        good[:-8] + np.array([np.nan]).tobytes(),
        good[:50],
        b"",
    ):
        place.write_bytes(damaged)
        assert disk.read(place) is None
    other = place.with_name("b.array")
    other.write_bytes(good)
    assert disk.read(other) is None
    pipe = place.with_name("c.array")
    os.mkfifo(pipe)
    assert disk.read(pipe) is None
    disk.write(other / "no folder" / "a.array", np.zeros(3))
