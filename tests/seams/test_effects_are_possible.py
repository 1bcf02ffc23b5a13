"""Law: no effect that a model states, and no size that a search gives, is outside what is possible."""

from dataclasses import fields, replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import Case
from rtcal.finder.effects import AppliedEffect, checked_grid, columns, library
from rtcal.finder.means.problem import state
from rtcal.finder.model import RoomState, covered
from rtcal.support.errors import DataError


@pytest.fixture(scope="module")
def case():
    return rt.datasets.hidden_room()[0]


@pytest.mark.parametrize("effect", library(), ids=lambda e: str(e.name))
def test_each_parameter_has_limits_and_values_beyond_them_are_refused(effect, case):
    grid = checked_grid(effect, state(case, case.configurations[0]), case.room)
    limits = effect.limits(case.room)
    assert set(limits) == set(grid[0])
    for theta in grid:
        replace(case, applied=[AppliedEffect(effect.name, theta)])
    for name, ends in limits.items():
        for end, step in zip(ends, (-1.0, 1.0), strict=True):
            beyond = end + step * max(1e-6 * abs(end), 1e-9)
            values = (np.nan, step * np.inf, beyond) if np.isfinite(end) else (np.nan,)
            for value in values:
                with pytest.raises(DataError, match=f'effect "{effect.name}": {name} = '):
                    replace(case, applied=[AppliedEffect(effect.name, {**grid[0], name: value})])
        lacking = {k: v for k, v in grid[0].items() if k != name}
        with pytest.raises(DataError, match=f'has no "{name}"'):
            AppliedEffect(effect.name, lacking)


@pytest.mark.parametrize("effect", library(), ids=lambda e: str(e.name))
def test_a_grid_at_once_is_each_set_by_itself(effect, case):
    before = state(case, case.configurations[0])
    grid = checked_grid(effect, before, case.room)
    made = effect.changes(before, grid)
    assert len(made) == len(grid)
    for theta, after in zip(grid, made, strict=True):
        alone = effect.change(before, theta)
        for f in fields(RoomState):
            one, other = getattr(after, f.name), getattr(alone, f.name)
            same = one == other if f.name == "shape" else np.array_equal(one, other)
            assert same, f"{effect.name}: {f.name}"
    one = [effect.density({k: np.array([v]) for k, v in theta.items()}, before) for theta in grid]
    alone = [float(np.squeeze(density)) for density in one]
    together = np.ones(len(grid)) * effect.density(columns(grid), before)
    np.testing.assert_allclose(together, alone, rtol=1e-14)


def test_many_states_are_covered_as_one_is(case):
    # 1 m² adds alpha by Eyring's equation and -ln(1 - alpha) by Millington's; the wall below it goes.
    one = replace(state(case, case.configurations[0]), equation="eyring")
    other = replace(one, equation="millington", alpha=0.5 * one.alpha)
    areas, alpha = np.array([2.0, 30.0]), np.array([np.full(len(one.air), a) for a in (0.3, 0.6)])
    first, second = covered([one, other], areas, alpha)
    wall = one.areas @ one.alpha / one.total_area
    np.testing.assert_allclose(first.covering, 2.0 * (0.3 - wall), rtol=1e-12)
    wall = other.areas @ other.alpha / other.total_area
    np.testing.assert_allclose(second.covering, 30.0 * np.log((1 - wall) / 0.4), rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "parameters", "interval"),
    [
        ("opening", {"area": -5.0}, None),
        ("opening", {"area": 10_000.0}, None),
        ("covered surface", {"material": -1.0, "share": 0.5}, None),
        ("covered surface", {"material": 6.0, "share": 0.5}, None),
        ("covered surface", {"material": 0.5, "share": 0.5}, None),
        ("covered surface", {"material": 0.0, "share": -3.0}, None),
        ("covered surface", {"material": 0.0, "share": 0.875}, (0.468, 1.43)),
        ("area", {"material": 0.0, "ratio": 0.0}, None),
        ("formula", {"equation": 1.5}, None),
    ],
)
def test_what_no_room_can_have_is_no_part_of_a_case(case, name, parameters, interval):
    with pytest.raises(DataError, match=f'effect "{name}"'):
        replace(case, applied=[AppliedEffect(name, parameters, interval)])
    data = case.to_dict() | {
        "applied": [{"effect": name, "parameters": parameters, "size_interval": interval}]
    }
    with pytest.raises(DataError, match=f'effect "{name}"'):
        Case.from_dict(data)
