"""A size is sought until the evidence falls or physics ends, and a doubt about it leaves the family."""

from dataclasses import replace

import numpy as np
import pytest

from rtcal.finder import Case
from rtcal.finder.claim import MISTAKE
from rtcal.finder.effects import (
    Effect,
    NoiseFloor,
    NonDiffuse,
    Opening,
    Porous,
    WrongArea,
    checked_grid,
)
from rtcal.finder.means.problem import predict_hypotheses, state
from rtcal.finder.positions.problem import LEAST, RATIO, areas_tried
from rtcal.finder.search import find
from tests.test_discrepancy import case_with, controls_of, opened

FAR: list[tuple[Effect, dict[str, float]]] = [
    (Opening(), {"area": 75.0}),
    (Porous(), {"area": 75.0, "thickness": 0.06, "flow_resistivity": 12e3}),
    (NonDiffuse(), {"scattering": 0.003}),
    (NoiseFloor(), {"level": -25.0, "record": 2.5}),
    (WrongArea(), {"material": 1.0, "ratio": 5.0}),
]
"""Effects with a size beyond their grids."""


def case_of(effect: Effect, theta: dict[str, float]) -> Case:
    """Return a case whose measurement is the model's own with the effect in it.

    Its walls along x hardly absorb, so that a lack of scattering bends the decay.
    """
    room = opened().room
    room = room.replace(alpha=room.alpha * np.array([1.5, 1.5, 0.2, 1.0])[:, None])
    facing = np.array([[0, 0, 1], [0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=float)
    empty = replace(opened(), room=room, facing=facing)
    ln = predict_hypotheses(empty, [effect], [[theta]]).features[1, 0]
    t20 = np.exp(ln[0])
    measured = case_with(t20, edt=t20 * np.exp(ln[1]), t30=t20 * np.exp(ln[2]))
    return replace(empty, configurations=measured.configurations)


@pytest.mark.parametrize(("effect", "theta"), FAR, ids=[effect.name for effect, _ in FAR])
def test_a_size_beyond_the_grid_is_found(effect, theta):
    case = case_of(effect, theta)
    sizes = [t[effect.size] for t in checked_grid(effect, state(case, case.configurations[0]))]
    true = theta[effect.size]
    assert not min(sizes) <= true <= max(sizes)
    finding = find(case, effects=[effect], controls=controls_of(case))
    if effect.name == "area":  # T is 0.29 times the model's in all bands, as by other units
        assert finding.verdict == "hint"
        assert finding.reasons[0].code == MISTAKE
    else:
        assert finding.verdict in ("named", "family"), finding.reasons
    assert finding.best_effect == effect.name
    size = finding.size
    assert not min(sizes) <= size.mean <= max(sizes)
    if size.end:  # the data bound it on one side only
        assert size.low < true if size.end == "least" else true < size.high
        assert size.words.startswith(f"at {size.end} ")
        assert any(size.words in str(reason) for reason in finding.reasons)
    else:
        assert size.low < true < size.high


@pytest.mark.parametrize("area", [0.04, 3.0, 5.0 * LEAST * RATIO**20, 1000.0])
def test_areas_on_a_surface_go_on_to_its_own(area):
    tried = areas_tried(5.0, area)
    assert (len(tried) == 0) == (area < 5.0 * LEAST)
    assert all(area / RATIO * (1 - 1e-12) < last <= area for last in tried[-1:])
    before = np.geomspace(0.05, 1.4, 14) * 5.0
    n = min(len(tried), len(before))
    np.testing.assert_allclose(tried[:n], before[:n], rtol=1e-12)
    assert n == len(before[before <= area * (1 + 1e-12)])
