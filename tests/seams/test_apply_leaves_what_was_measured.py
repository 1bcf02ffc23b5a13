"""Law: what is added leaves the stated areas and volume alone."""

import math
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.apply import corrected_case
from rtcal.finder.effects import AppliedEffect, checked_grid, library
from rtcal.finder.means.problem import state
from rtcal.report import of_finding
from rtcal.support.errors import DataError
from tests.conftest import also
from tests.test_discrepancy import controls_of
from tests.test_where_page import finding_of

ABOUT = {"area", "volume"}
"""Effects that are about a stated number itself."""


@pytest.fixture(scope="module")
def case():
    return rt.datasets.hidden_room()[0]


def at(case, effect, place):
    """Return an effect at this place of its grid, with an interval where it has a size."""
    grid = checked_grid(effect, state(case, case.configurations[0]), case.room)
    p = AppliedEffect(effect, grid[round(place * (len(grid) - 1))])
    if not np.isfinite(effect.neutral) or effect.size in effect.discrete:
        return p
    low, high = sorted((0.6 * p.size, p.size))
    return replace(p, size_interval=(low, high))


@pytest.mark.parametrize("equation", ["millington", *also("eyring", "sabine", "kuttruff")])
@pytest.mark.parametrize("effect", library(), ids=lambda e: str(e.name))
def test_stated_areas_and_volume_stay(case, effect, equation):
    stated = case.room
    for place in (0.0, 0.3, 0.7, 1.0):
        with_it = replace(case, equation=equation, applied=[at(case, effect, place)])
        room = corrected_case(with_it).room
        n = stated.n_materials
        assert room.materials[:n] == stated.materials
        assert effect.name in ABOUT or room.volume == stated.volume
        assert effect.name in ABOUT or np.array_equal(room.areas[:n], stated.areas)
        if effect.name == "area":
            assert np.sum(room.areas[:n] != stated.areas) == 1
        if effect.family.startswith("added absorption"):
            gain = room.absorption_area - stated.absorption_area
            assert (gain >= 0).all()
            # A panel that absorbs less than the wall it hides, in every band, is no material.
            hides = any(n.code == "takes absorption" for n in corrected_case(with_it).notes)
            assert gain.max() > 0 or hides
        if effect.name not in ABOUT:
            assert room.dimensions == stated.dimensions
            assert [s for s in room.surfaces if s.material in stated.materials] == list(
                stated.surfaces
            )


def test_a_volume_is_changed_only_where_its_error_is_claimed(case):
    hidden = AppliedEffect("volume", {"ratio": 1.3})
    found = rt.find(case, only=["volume", "opening"], controls=controls_of(case))
    fit = {"effect": "volume", "parameters": hidden.parameters, "size": math.nan}
    candidate = replace(found.candidates[0], probability=0.6, **fit)
    guess = replace(
        found,
        verdict="ambiguous",
        named=(),
        members=("volume",),
        candidates=(candidate,),
        probabilities={"volume": 0.6, "none": 0.4},
    )
    for stated in (None, "volume"):
        with pytest.raises(DataError, match="volume only from 90 % upwards"):
            guess.apply(effect=stated)
    assert of_finding._corrected(guess, None) == []
    claimed = replace(guess, verdict="named", named=("volume",), probabilities={"volume": 0.95})
    assert claimed.apply().room.volume == pytest.approx(1.3 * case.room.volume)


def torn_at_positions(first, verdict="ambiguous"):
    """Return a finding whose best candidate has a probability, two of one family on another wall."""
    found = finding_of({"wall 5": 1.0, "wall 0": 1.0, "ceiling": 1.0})
    wall, other, ceiling = found.candidates
    every = [
        replace(wall, probability=first),
        replace(other, probability=0.16),
        replace(other, effect="curtain", family="added absorption, rising", probability=0.1),
        replace(ceiling, effect="area", family="scale", probability=0.14),
    ]
    return replace(found, verdict=verdict, named=(), family=None, candidates=tuple(every))


def test_at_positions_an_improbable_candidate_is_added_only_where_it_is_stated():
    unsure = torn_at_positions(0.29)
    assert unsure.can_be_added
    with pytest.raises(DataError, match=r"less than 30 %.*effect = NAME, or its place") as refused:
        unsure.apply()
    assert all(
        f"{c.title} ({100 * c.probability:.0f} %)" in str(refused.value) for c in unsure.candidates
    )
    assert unsure.apply(effect="porous").added.surface == "wall 5"
    assert unsure.apply(effect="curtain").added.surface == "wall 0"
    with pytest.raises(DataError, match='effect = "organ" is not a candidate'):
        unsure.apply(effect="organ")
    geometry = unsure.case.geometry
    corners = geometry.vertices[list(geometry.faces[unsure.case.faces["wall 0"][0]])]
    there = unsure.apply(at=tuple(corners.mean(axis=0)))
    assert there.added.title == 'porous on "wall 0"'
    with pytest.raises(DataError, match=r'effect = "area" is not a candidate\. Candidates: porous'):
        unsure.apply(at=tuple(corners.mean(axis=0)), effect="area")
    assert torn_at_positions(0.31).apply().added.surface == "wall 5"
