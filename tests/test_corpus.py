"""Files with the oddities of real exports: each gives what it means, or one line that says why not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rtcal.io import bras, catt, obj, odeon, pyroomacoustics, tables
from rtcal.support.errors import DataError
from tests import corpus

READERS: dict[str, Any] = {
    "bras": bras,
    "catt": catt,
    "obj": obj,
    "odeon": odeon,
    "pyroomacoustics": pyroomacoustics,
    "tables": tables,
}


def test_there_are_a_hundred_and_their_names_differ() -> None:
    assert len({c.name for c in corpus.CASES}) == len(corpus.CASES) >= 100


@pytest.mark.parametrize("case", corpus.CASES, ids=lambda c: c.name)
def test_each_file_gives_what_it_means(case: corpus.Case, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(case.content)
    if case.error is not None:
        with pytest.raises(DataError, match=case.error) as refusal:
            READERS[case.reader].read(path, **case.options)
        assert str(path) in str(refusal.value)
        assert "\n" not in str(refusal.value)
        return
    result = READERS[case.reader].read(path, **case.options)
    if case.volume is not None:
        assert result.volume == pytest.approx(case.volume, rel=1e-12)
    elif case.alpha is not None:
        assert {m.name: list(m.alpha) for m in result.materials} == case.alpha
        copy = tmp_path / "copy"
        room = result.room(name="", volume=60, areas=dict.fromkeys(result.names, 10.0))
        READERS[case.reader].write(room, copy, template=path)
        assert copy.read_bytes() == case.content
    else:
        assert values(result.measurement) == pytest.approx(case.values, rel=1e-12)
        assert case.said is None or case.said in str(result)


def values(measured: Any) -> dict[tuple[str, str, int], float]:
    """All values of a measurement by receiver, parameter and band."""
    held = {}
    for parameter, table in measured.values.items():
        for (_, receiver), row in zip(measured.pairs, table, strict=True):
            for f, value in zip(measured.centre_frequencies, row, strict=True):
                if np.isfinite(value):
                    held[receiver, parameter, int(f)] = float(value)
    return held
