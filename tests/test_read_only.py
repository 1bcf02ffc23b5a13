"""Code of one's own gets arrays that it cannot change: else its caller's numbers would change."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

import rtcal as rt
from rtcal import terms
from rtcal.finder.case import Case, Configuration
from rtcal.finder.effects import Effect, changed_states
from rtcal.finder.means.problem import state
from rtcal.support.errors import DataError


def test_a_loop_cannot_be_changed_from_after_step(cr2):
    room, measured = cr2

    def meddles(loop):
        for name in ("alpha", "simulated", "target", "noise"):
            array = getattr(loop.steps[-1], name)
            with pytest.raises(ValueError, match="read-only"):
                array *= 0.5
        with pytest.raises(ValueError, match="read-only"):
            loop.wanted[:] = 1.0

    program = rt.simulators.External(
        room=room,
        name="x",
        run=lambda alpha, seed: 1.2 * rt.Eyring().time(room, room.areas @ alpha),
    )
    rt.calibrate_simulator(program, room, measured, after_step=meddles)


def test_a_result_s_numbers_cannot_be_changed(cr2):
    result = rt.calibrate(*cr2)
    names = (
        "alpha active multipliers target measured measured_uncertainty reverberation_time_before "
    )
    names += (
        "reverberation_time_after added_absorption air_share posterior_sigma target_uncertainty"
    )
    for name in names.split():
        with pytest.raises(ValueError, match="read-only"):
            getattr(result, name)[:] = 0


class Painted(Effect):
    """An effect of one's own that changes the state it is given."""

    name: ClassVar[str] = "paint"
    size: ClassVar[str] = "share"
    unit: ClassVar[str] = ""

    def grid(self, state):
        return [{"share": 0.5}, {"share": 0.9}]

    def change(self, state, parameters):
        alpha = state.alpha
        alpha *= parameters["share"]
        return replace(state, alpha=alpha)


def test_an_effect_cannot_change_the_state(cr2):
    room, measured = cr2
    case = Case(room=room, configurations=[Configuration(name="empty", measured=measured)])
    unchanged = state(case, case.configurations[0])
    kept = unchanged.alpha.copy()
    with pytest.raises(DataError, match=r'effect "paint": change.*read-only'):
        changed_states(Painted(), unchanged, Painted().grid(unchanged))
    assert np.array_equal(unchanged.alpha, kept)


@pytest.mark.parametrize("what", ["mu", "sigma", "areas", "target", "lower"])
def test_a_term_cannot_change_the_numbers(cr2, what):
    def meddling(m):
        """A term of one's own whose parameter changes what it is computed of."""

        def meddle(numbers):
            values = getattr(numbers, what)
            values *= 1.01
            return 1.0

        return m.parameter((), meddle) * m.deviation[0, 0]

    room, measured = cr2
    problem = rt.Calibration(terms.PriorDeviation() + meddling, [terms.ExactMatch()]).build(room)
    with pytest.raises(ValueError, match="read-only"):
        problem.solve(measured)
