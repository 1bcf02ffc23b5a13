"""A problem is compiled once for its shape and terms, whoever asks, and threads share it."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import rtcal as rt
from tests.conftest import random_room, true_times

EYRING = rt.Eyring()


def cases(count: int, n: int = 6, k: int = 4) -> list[tuple[rt.Room, np.ndarray]]:
    """Rooms of one shape; in every other one, T pushes coefficients to their bounds."""
    made = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        room = random_room(rng, n, k, rt.Air())
        t = true_times(rng, room, EYRING)
        made.append((room, EYRING.time(room, 0.15 * room.absorption_area) if seed % 2 else t))
    return made


@pytest.mark.parametrize("solver", ["clarabel", "osqp"])
def test_rooms_of_one_shape_are_compiled_once(solver, compilations):
    answers = [rt.calibrate(room, t, solver=solver).alpha for room, t in cases(4)]
    assert len(compilations) == 1
    for (room, t), alpha in zip(cases(4), answers, strict=True):
        rt.calibration.forget()
        np.testing.assert_array_equal(rt.calibrate(room, t, solver=solver).alpha, alpha)


def test_threads_share_one_problem(compilations):
    given = cases(24)
    ready = threading.Barrier(8)

    def solve(some: list[tuple[rt.Room, np.ndarray]]) -> list[np.ndarray]:
        ready.wait(30)
        return [rt.calibrate(room, t, "soft").alpha for room, t in some]

    with ThreadPoolExecutor(8) as threads:
        found = list(threads.map(solve, [given[i::8] for i in range(8)]))
    assert len(compilations) == 1
    for i, answers in enumerate(found):
        for (room, t), alpha in zip(given[i::8], answers, strict=True):
            np.testing.assert_array_equal(rt.calibrate(room, t, "soft").alpha, alpha)
