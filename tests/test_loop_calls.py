"""The closed loop's calls of its simulator: all counted, none beyond the limit, none lost."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.simulators.external import External
from rtcal.support.errors import DataError, SimulatorError


class Program:
    """A function for `External` that counts its calls; ``times(alpha, seed)`` gives T in s."""

    def __init__(self, room, times):
        self.room, self.times = room, times
        self.calls = []

    def __call__(self, alpha, seed):
        self.calls.append((alpha, seed))
        return self.times(alpha, seed)


def eyring(room, alpha):
    return rt.Eyring().time(room, room.areas @ alpha)


def simulator(program, **options):
    return External(room=program.room, run=program, name="counted", **options)


@pytest.mark.parametrize("limit", [2, 3, 5, 12])
@pytest.mark.parametrize("deterministic", [True, False])
def test_all_calls_are_counted_and_none_is_beyond_the_limit(cr2, limit, deterministic):
    """Bands that jump about: they are best at different steps, and are simulated once more."""
    room, measured = cr2
    rng = np.random.default_rng(1)

    def times(alpha, seed):
        wanted = measured.mean("t30")
        return wanted * rng.uniform(1.3, 2.0, room.n_bands) * np.where(rng.random(6) < 0.5, 1, 0.4)

    program = Program(room, times)
    result = rt.calibrate_simulator(
        simulator(program, deterministic=deterministic), room, measured, max_simulations=limit
    )
    assert result.simulations == len(program.calls) <= limit
    assert len(result.steps) >= max(limit - 1, 1)
    if limit >= 5:
        assert len(set(result.best.tolist())) > 1
        assert np.array_equal(program.calls[-1][0], result.best_alpha)
        assert any(np.array_equal(alpha, result.alpha) for alpha, _ in program.calls)


def test_one_call_suffices_for_a_deterministic_simulator_only(cr2):
    room, measured = cr2
    program = Program(room, lambda alpha, seed: 1.2 * eyring(room, alpha))
    result = rt.calibrate_simulator(simulator(program), room, measured, max_simulations=1)
    assert result.simulations == len(program.calls) == 1
    assert set(result.status) == {"not converging"}
    with pytest.raises(DataError, match="max_simulations = 1 must be a whole number of at least 2"):
        rt.calibrate_simulator(
            simulator(program, deterministic=False), room, measured, max_simulations=1
        )


@pytest.mark.parametrize("deterministic", [True, False])
@pytest.mark.parametrize("time", [0.02, 2.5, 30.0])
def test_a_simulator_that_does_not_depend_on_alpha_is_called_three_times(cr2, deterministic, time):
    room, measured = cr2
    program = Program(room, lambda alpha, seed: np.full(room.n_bands, time))
    result = rt.calibrate_simulator(simulator(program, deterministic=deterministic), room, measured)
    assert result.simulations == len(program.calls) <= 3
    assert set(result.status) == {"unreachable"}
    assert result.confirmation is None  # there is nothing to confirm


@pytest.mark.parametrize("failing", [1, 2, 3])
def test_an_error_carries_the_loop(cr2, failing):
    """The third call is the confirmation: the loop is finished by then."""
    room, measured = cr2

    def times(alpha, seed):
        if len(program.calls) == failing:
            raise RuntimeError("licence server gone")
        return 1.1 * eyring(room, alpha)

    program = Program(room, times)
    with pytest.raises(SimulatorError, match="licence server gone") as caught:
        rt.calibrate_simulator(simulator(program, deterministic=False), room, measured)
    loop = caught.value.loop
    assert len(loop.steps) == min(failing - 1, 2)
    assert loop.finished == (failing == 3)


def test_a_band_without_t20_is_simulated_again_within_the_limit(cr2):
    """An alpha without T20 costs a second call: it counts, and is not made beyond the limit."""
    room, measured = cr2
    prior = room.areas @ room.alpha[:, 0] / room.total_area

    def times(alpha, seed):
        found = 1.5 * eyring(room, alpha)
        if room.areas @ alpha[:, 0] / room.total_area > 1.25 * first:
            found[0] = np.nan
        return found

    first = rt.loop.start(room, measured).next_alpha[:, 0] @ room.areas / room.total_area
    assert first > prior / 2
    seen = set()
    for limit in range(2, 9):
        program = Program(room, times)
        result = rt.calibrate_simulator(simulator(program), room, measured, max_simulations=limit)
        assert result.simulations == len(program.calls) <= limit
        seen.add(result.simulations - len(result.steps))
    assert max(seen) >= 1  # steps that needed a second call
