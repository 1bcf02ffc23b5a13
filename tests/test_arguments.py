"""Constructors, readers and writers name a wrong argument; functions leave types to Python."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.support.errors import DataError

PACKAGE = Path(rt.__file__).parent


class _Room:
    """Not a rtcal.Room."""


CALLS: list[Callable[[Any], Any]] = [
    lambda wrong: rt.io.catt.write(wrong, "x.txt"),
    lambda wrong: rt.io.odeon.write(wrong, "x.txt"),
    lambda wrong: rt.io.bras.write(wrong, "x.txt"),
    lambda wrong: rt.io.tables.write(wrong, "x.csv"),
    lambda wrong: rt.io.obj.write(wrong, "x.obj"),
    lambda wrong: rt.io.catt.parse(wrong),
    lambda wrong: rt.io.odeon.parse(wrong),
    lambda wrong: rt.io.bras.parse(wrong),
    lambda wrong: rt.io.obj.parse(wrong),
    lambda wrong: rt.io.pyroomacoustics.parse(wrong),
]


@pytest.mark.parametrize("number", range(len(CALLS)))
@pytest.mark.parametrize(
    "wrong",
    [None, object(), 3, {"a": 1}, [object()], _Room()],
    ids=["None", "object", "number", "dict", "list", "_Room"],  # the same in each process
)
def test_writers_and_parsers_raise_typed_errors(
    number: int, wrong: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(rt.errors.RtcalError):
        CALLS[number](wrong)
    assert list(tmp_path.iterdir()) == []


def test_what_tells_progress_has_one_name() -> None:
    """It was called report, beside the package's reports."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.arg):
                tells = "Progress" in ast.unparse(node)
                assert node.arg == "progress" if tells else node.arg != "report", (
                    f"{path}:{node.lineno}"
                )


def test_what_would_have_no_end_is_refused() -> None:
    hall = rt.datasets.halls.corridor()
    tracer = rt.simulators.PathTracing(
        geometry=hall.geometry,
        room=hall.room,
        sources=hall.sources,
        receivers=hall.receivers,
        n_paths=32,
    )
    with pytest.raises(DataError, match=r"seconds = 1e\+300 s is above 60 s"):
        tracer.traced(0, 1e300)
    with pytest.raises(DataError, match="seconds = 61 s is above 60 s"):
        tracer.energy(hall.room.alpha, 61)
    with pytest.raises(DataError, match="band = 99 is not from 0 to 6"):
        tracer.traced(99, 0.1)
    with pytest.raises(DataError, match="Observations: parameters = None is not a list"):
        rt.simulators.Observations(
            parameters=None, pairs=(), centre_frequencies=np.ones(1), values=np.ones(1)
        )
    with pytest.raises(DataError, match=r"by = .* is not .*material"):
        tracer.jacobian(hall.room.alpha, by=np.ones(3))
    for scores in (
        lambda n: rt.studies.analytic_scores([10, 20], 0.05, n),
        lambda n: rt.studies.run([10, 20], 0.05, n, 10).scores(),
    ):
        with pytest.raises(DataError, match=r"realisations = .* is above 2\*\*53"):
            scores(10**400)


def test_the_figures_and_names_of_places_are_checked() -> None:
    figures, room = rt.report.figures, rt.datasets.bras_cr2()[0]
    with pytest.raises(DataError, match="height = -1"):
        figures.new_figure(height=-1)
    with pytest.raises(DataError, match="text: a figure ends with"):
        figures.rendered(figures.new_figure()[0], "text")
    with pytest.raises(DataError, match="band = 99 is not from 0 to 5"):
        room.place("alpha", 0, 99)
    with pytest.raises(DataError, match="is none of rtcal's errors"):
        rt.errors.of_bands(None, [1])
    with pytest.raises(DataError, match="is not a list of whole numbers"):
        rt.errors.of_bands(rt.errors.ModelError("no T"), ["a"])
