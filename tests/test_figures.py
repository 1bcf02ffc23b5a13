"""Every figure is legible on a phone, and its lines are told apart without colours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import Finding
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from tests.test_docs import blocks

pytest.importorskip("matplotlib", reason="needs the extra report")
from matplotlib.text import Text

from rtcal.report import figures, study_report

ROOT = Path(__file__).resolve().parents[1]
PHONE = 370  # px: a screen of 400 px less the page's margins
LEAST = 7.0  # px: size of the smallest text


@pytest.fixture(scope="module")
def drawn(found: Finding) -> dict[str, Any]:
    """Every figure by name: those of the gallery, a finding's, and those of every position."""
    figures_of = {}
    names: dict[str, Any] = {}
    for block in blocks(ROOT / "docs" / "gallery.md", "python"):
        exec(block, names)
        figures_of[block.rsplit("figure = ", 1)[1].split("(")[0]] = names["figure"]
    verification = rt.finder.verify(found)
    for draw in (figures.corrected_times, figures.corrected_shifts):
        figures_of[f"of a finding: {draw.__name__}"] = draw(verification)
    fitted = SimpleNamespace(
        pairs=[("S1", "R1"), ("S1", "R2")],
        gap_before=np.full((2, 2, 3), 3.0),
        gap_after=np.full((2, 2, 3), 1.0),
        shift=np.linspace(-2, 2, 21).reshape(3, 7),
        prior=SimpleNamespace(
            materials=["a", "b", "c"],
            centre_frequencies=[125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0],
        ),
    )
    box = Polyhedron.shoebox((5, 4, 3), dict.fromkeys(SHOEBOX_WALLS, "a"))
    receivers = {"R1": (1, 1, 1), "R2": (4, 3, 1)}
    figures_of["plan of gaps"] = figures.position_gaps(fitted, box, {"S1": (2, 2, 1)}, receivers)
    figures_of["priors of six"] = study_report.priors(
        [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [0.05] * 6, ""
    )
    return figures_of


def texts(figure: Any) -> Iterator[Text]:
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip():
            yield text


@pytest.mark.long
def test_text_is_legible_on_a_phone(drawn: dict[str, Any]) -> None:
    small = {
        name: round(size, 1)
        for name, figure in drawn.items()
        if (
            size := min(t.get_fontsize() for t in texts(figure))
            / 72
            * PHONE
            / figure.get_figwidth()
        )
        < LEAST
    }
    assert not small, f"px of the smallest text: {small}"
    assert len(drawn) >= 11


def look(line: Any) -> tuple[object, ...]:
    """Return the look of a line in grey: marker, whether it is filled, dashes and width."""
    hollow = line.get_fillstyle() == "none" or line.get_markerfacecolor() in ("none", "white")
    dashes = str(line._unscaled_dash_pattern) if line.get_linestyle() != "None" else "none"
    return (line.get_marker(), hollow, dashes, line.get_linewidth())


def twins(figure: Any) -> list[str]:
    """Return lines of one panel that nothing but their colour tells apart."""
    found = []
    for axes in figure.axes:
        seen: dict[tuple[object, ...], str] = {}
        for line in axes.get_lines():
            label = str(line.get_label())
            if not label.startswith("_") and look(line) in seen:
                found.append(f"{seen[look(line)]} and {label}")
            seen.setdefault(look(line), label)
    return found


def test_lines_are_told_apart_in_grey(drawn: dict[str, Any]) -> None:
    for name, figure in drawn.items():
        assert not twins(figure), name


def test_lines_that_differ_in_colour_alone_are_seen() -> None:
    figure, axes = figures.new_figure()
    axes.plot([0, 1], color="C0", label="one")
    axes.plot([1, 0], color="C1", label="another")
    assert twins(figure) == ["one and another"]
