"""Arrays that are kept beside a case: a damaged one, or another, is computed again."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from rtcal.files import disk


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
