"""A level that is off alike in all bands is told first; one that is tilted is not."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import Case, library
from rtcal.finder.means.problem import observe, predict_hypotheses
from rtcal.finder.means.search import _off_levels


def problem(case: Case) -> Any:
    """Return what the notes ask of a problem of means."""
    observed, predicted = observe(case)[0], predict_hypotheses(case, library())
    return SimpleNamespace(case=case, observed=observed, predicted=predicted)


def notes(off: float, slope: float = 0.0) -> list[str]:
    """Return the notes of the shipped room with G off and tilted over the bands."""
    case, _ = rt.datasets.hidden_room()
    configurations = []
    for each in case.configurations:
        values = dict(each.measured.values)
        tilt = slope * np.linspace(-1, 1, np.shape(values["g"])[-1])
        values["g"] = np.asarray(values["g"]) + off + tilt
        configurations.append(replace(each, measured=replace(each.measured, values=values)))
    case = replace(case, configurations=tuple(configurations))
    return _off_levels(problem(case))


@pytest.mark.parametrize("off", [-30, -5, 5, 20])
def test_a_level_that_is_off_is_said(off):
    said = notes(off)
    assert len(said) == 2
    for note in said:
        assert note.values["side"] == ("above" if off > 0 else "below")
        assert note.values["by"] == pytest.approx(abs(off), abs=0.5)


def test_what_a_room_may_do_is_not_said():
    assert notes(0) == []
    assert notes(5, slope=6) == []


def test_a_level_that_fits_the_stated_room_is_not_said():
    case, _ = rt.datasets.hidden_room("identified")
    assert _off_levels(problem(case)) == []
