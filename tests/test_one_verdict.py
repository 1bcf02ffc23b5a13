"""One verdict: seeds, and the order of materials, change nothing of what a search by means says."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from benchmarks.studies.means.judged import read
from rtcal.finder import Case
from rtcal.finder.claim import too_weak
from rtcal.finder.means.engines import draw_alpha
from rtcal.finder.means.search import GapCheck, gap_against
from tests.conftest import also, in_order

SEEDS = range(8)
POPULATION = 57
KINDS = (0, 1, 3, 5, 8, 11)
ROOMS = [(1, kind) for kind in KINDS]
ROOMS += [(2, kind) for kind in ("nothing", "air", "furniture", "membrane")]


def reordered(case, order):
    """The case with its materials in another order."""
    return replace(case, room=in_order(case.room, order), facing=case.facing[order])


def orders(case):
    """Three orders of the materials."""
    n = case.room.n_materials
    return [list(range(n)), list(range(n))[::-1], np.random.default_rng(3).permutation(n).tolist()]


def drawn(world, kind):
    """A room of the first world, or the first of its kind that is stored of the second."""
    if world == 1:
        return Case.from_dict(read(1, POPULATION, "case")[KINDS.index(kind)])
    index = next(i for i, t in enumerate(read(2, 0, "truth")) if t["kind"] == kind)
    return Case.from_dict(read(2, 0, "case")[index])


def one_verdict(case, tmp_path, tried):
    """Yield what is said with these orders and seeds."""
    every = orders(case)
    for order, seed in tried:
        found = rt.find(reordered(case, every[order]), seed=seed, cache=tmp_path)
        yield found.verdict, found.family, found.names


ALL = [(order, seed) for order in range(3) for seed in SEEDS]


@pytest.mark.long
@pytest.mark.parametrize("tried", [[(0, 0), (1, 5)], *also(ALL)], ids=len)
def test_the_shipped_room_has_one_verdict(tried, kept):
    case = rt.datasets.hidden_room()[0]
    said = {*one_verdict(case, kept, tried)}
    assert len(said) == 1, said
    assert next(iter(said))[:2] == ("family", "added absorption")


@pytest.mark.long
@pytest.mark.parametrize(("world", "kind"), ROOMS)
def test_drawn_rooms_have_one_verdict(world, kind, tmp_path):
    said = {*one_verdict(drawn(world, kind), tmp_path, ALL)}
    assert len(said) == 1, said


def test_what_is_drawn_belongs_to_a_name():
    case = rt.datasets.hidden_room()[0]
    one = draw_alpha(case, np.random.default_rng(5), 6)
    for order in orders(case):
        other = draw_alpha(reordered(case, order), np.random.default_rng(5), 6)
        assert np.array_equal(other, one[:, :, order])
    # A further material changes nothing of the others.
    room = case.room
    fewer = room.replace(
        materials=room.materials[1:],
        areas=room.areas[1:],
        alpha=room.alpha[1:],
        sigma=room.sigma[1:],
        area_sigma=room.area_sigma[1:],
        surfaces=(),
    )
    configurations = [replace(c, changes={}) for c in case.configurations]
    less = replace(case, room=fewer, facing=case.facing[1:], configurations=configurations)
    whole = replace(case, configurations=configurations)
    one = draw_alpha(whole, np.random.default_rng(5), 6)
    assert np.array_equal(draw_alpha(less, np.random.default_rng(5), 6), one[:, :, 1:])


@pytest.mark.parametrize(
    ("before", "after", "uncertainty", "code"),
    [
        (0.5, 0.5, 0.1, None),
        (0.5, 0.59, 0.1, None),  # the limit itself is 0.1 JND
        (0.5, 0.61, 0.1, "gap may grow"),
        (0.5, 0.70, 0.1, "gap may grow"),
        (0.5, 0.75, 0.1, "gap grows"),
        (0.5, 0.61, 0.001, "gap grows"),
        (0.5, 0.59, 0.0, None),
        (np.nan, np.nan, np.nan, None),
    ],
)
def test_a_doubt_near_its_limit_is_a_probability(before, after, uncertainty, code):
    gap = GapCheck(before, after, uncertainty, 0.0)
    doubt = gap_against("furniture", gap)
    assert (doubt and doubt.code) == code


@pytest.mark.parametrize(
    ("none", "effect", "family", "weak"),
    [
        (0.34, 0.5, 0.6, True),
        (0.32, 0.5, 0.6, False),
        (0.1, 0.17, 0.3, True),
        (0.1, 0.17, 0.4, False),
        (0.0, 0.95, 0.95, False),
    ],
)
def test_where_nothing_has_a_fair_part_nothing_is_called_missing(none, effect, family, weak):
    probabilities = {"none": none, "opening": effect, "furniture": 0.1}
    assert bool(too_weak(probabilities, {"none": none, "added absorption": family})) is weak
