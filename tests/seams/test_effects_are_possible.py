"""Law: no effect that a model states, and no size that a search gives, is outside what is possible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import AppliedEffect, Case
from rtcal.finder.effects import Effect, library
from rtcal.finder.effects.checks import checked_grid
from rtcal.finder.means.features import state
from rtcal.support.errors import DataError


@pytest.fixture(scope="module")
def case() -> Case:
    return rt.datasets.hidden_room()[0]


@pytest.mark.parametrize("effect", library(), ids=lambda e: str(e.name))
def test_each_parameter_has_limits_and_values_beyond_them_are_refused(
    effect: Effect, case: Case
) -> None:
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
def test_what_no_room_can_have_is_no_part_of_a_case(
    case: Case,
    name: str,
    parameters: dict[str, float],
    interval: tuple[float, float] | None,
) -> None:
    with pytest.raises(DataError, match=f'effect "{name}"'):
        replace(case, applied=[AppliedEffect(name, parameters, interval)])
    data = case.to_dict() | {
        "present": [{"effect": name, "parameters": parameters, "size_interval": interval}]
    }
    with pytest.raises(DataError, match=f'effect "{name}"'):
        Case.from_dict(data)
