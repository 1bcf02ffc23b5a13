"""Every answer against exact rational arithmetic, over all the kinds that have tripped a solver."""

import functools
from dataclasses import dataclass

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.methods import preset
from rtcal.support.errors import InfeasibleError, SolverError
from tests import rational
from tests.conftest import room_of
from tests.problems import Problem, problems

COUNTS = [160, pytest.param(2000, marks=pytest.mark.long)]
OFFSET = 1e4


@dataclass(frozen=True)
class Shifted(rt.Sabine):
    """T = b + an offset: lets any b, also one below 0, be asked for by a T above 0."""

    name = "Shifted"

    def time(self, room, absorption_area):
        return np.asarray(absorption_area) + OFFSET

    def target(self, room, t):
        return np.asarray(t) - OFFSET

    def target_sensitivity(self, room, t):
        return np.ones_like(t)


def as_room(p):
    each = zip(p.areas, p.mu, p.sigma, strict=True)
    return room_of({f"m{i}": of for i, of in enumerate(each)}, [1000])


@functools.cache
def compiled(n):
    return preset("mle").build(as_room(Problem("", *np.ones((3, n)), 0.5)), Shifted())


@functools.cache
def cases(count):
    """The problems, b as the equation gives it, and the exact answer."""
    found = []
    for p in problems(count):
        t = p.target + OFFSET
        b = t - OFFSET
        found.append((p, t, rational.solve(list(p.mu), list(p.sigma), list(p.areas), b)))
    return found


def is_end(p, t):
    """b within 16 n eps sum |S bound| of an end is that end (see the definitions)."""
    n, b = len(p.mu), t - OFFSET
    tolerance = 16 * n * np.finfo(float).eps * (p.areas @ np.where(p.sigma == 0, p.mu, 1.0))
    return bool(min(abs(b - end) for end in p.ends) <= tolerance)


def error(alpha, exact):
    return max(abs(float(e) - a) for e, a in zip(exact, alpha[:, 0], strict=True))


@pytest.mark.parametrize("count", COUNTS)
def test_clarabel_polished_is_exact_and_every_infeasible_problem_is_refused(count):
    worst = 0.0
    for p, t, exact in cases(count):
        problem = compiled(len(p.mu))
        room = as_room(p)
        if isinstance(exact, str) and not is_end(p, t):
            with pytest.raises(InfeasibleError, match="cannot be reached"):
                problem.solve([t], room=room)
            continue
        result = problem.solve([t], room=room)
        if isinstance(exact, str):
            exact = [0.0 if exact == "below" else 1.0] * len(p.mu)
            exact = [m if s == 0 else e for e, m, s in zip(exact, p.mu, p.sigma, strict=True)]
        off = error(result.alpha, exact)
        worst = max(worst, off)
        assert off <= 1e-8, (p, off)
        if not is_end(p, t):  # there the answer is the end, which b only rounds to
            bound = result.certificate.alpha_error_bound[:, 0]
            off_by = np.abs([float(e) for e in exact] - result.alpha[:, 0])
            assert np.all(off_by <= bound + 2e-16), p
    assert worst > 0


@pytest.mark.parametrize("count", COUNTS)
def test_osqp_is_right_or_says_that_it_failed(count):
    refused = well_inside = 0
    for p, t, exact in cases(count):
        if isinstance(exact, str):
            continue
        well_inside += p.well_inside
        try:
            result = compiled(len(p.mu)).solve([t], room=as_room(p), solver="osqp")
        except SolverError:
            refused += p.well_inside
            continue
        assert error(result.alpha, exact) <= 1e-6, p
    assert well_inside > count // 3
    assert refused <= 0.01 * well_inside
