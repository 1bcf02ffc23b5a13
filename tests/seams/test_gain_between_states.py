"""Law: a gain that changed between two states is said, and changes no result."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.finding import Finding
from rtcal.support.types import Array
from tests.test_two_states_surfaces import PLACES, POINT, simulator, two_states


@pytest.fixture(scope="module")
def states():
    """Return two states whose level has a reference that nobody states."""
    before, after = (of_values(state, state.values) for state in two_states())
    return before, after


def of_values(state: rt.Measurement, values: Mapping[str, Array]) -> rt.Measurement:
    renamed = {"level" if name == "g" else name: of for name, of in values.items()}
    return replace(state, values=renamed, uncertainty={}, common_uncertainty={})


def with_gain(state: rt.Measurement, gain: Mapping[str, float]) -> rt.Measurement:
    off = np.array([[gain.get(source, 0.0)] for source, _ in state.pairs])
    return of_values(state, {**state.values, "level": state.values["level"] + off})


def without_level(state: rt.Measurement) -> rt.Measurement:
    return of_values(state, {k: v for k, v in state.values.items() if k != "level"})


def found(before: rt.Measurement, after: rt.Measurement) -> Finding:
    model = simulator(dict.fromkeys(PLACES, POINT))
    return rt.find(model.room, after, model, before=before)


@pytest.mark.long
def test_another_gain_in_one_state_is_said_first_and_the_level_left_out(states):
    before, after = states
    wanted = found(without_level(before), without_level(after))
    for gain in (-3.0, 3.0, 37.0):
        got = found(with_gain(before, dict.fromkeys(PLACES, gain)), after)
        assert got.reasons[0].code == "gains differ"
        assert got.surfaces == pytest.approx(wanted.surfaces, abs=1e-6)


@pytest.mark.long
def test_one_gain_in_both_states_changes_nothing(states):
    gain = {source: 20.0 * i for i, source in enumerate(PLACES)}
    plain, both = found(*states), found(*(with_gain(state, gain) for state in states))
    assert not any("level" in str(note) for note in plain.notes)
    assert (both.reasons, both.notes) == ((), plain.notes)
    assert both.surfaces == pytest.approx(plain.surfaces, abs=1e-6)
