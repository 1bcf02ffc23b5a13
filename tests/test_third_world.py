"""The third hidden world as it is stored: made by another group's engine, before a finder read it."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import Case
from tests.third_world import generate
from tests.third_world.rooms import COUNTS, KINDS

CASES, TRUTHS = (
    [room for population in COUNTS for room in generate.read(population, part)]
    for part in ("case", "truth")
)


LONGER = ([3, 1, 2], [13, 1, 0])
"""Rooms whose T20 is longer than Eyring's without their absorber, which stands on one wall, by 0.07."""


def eyring(case: Case, truth: dict) -> np.ndarray:
    """T of the true coefficients, without what is hidden."""
    room = case.room.replace(alpha=np.clip(truth["alpha"], 0, 1))
    return rt.Eyring().reverberation_time(room)


def test_every_kind_is_there_as_often_as_it_was_frozen() -> None:
    for population, counts in COUNTS.items():
        some = [t for t in TRUTHS if t["seed"][0] == population]
        assert Counter(t["kind"] for t in some) == Counter({k: counts[k] for k in KINDS})
        assert [t["seed"] for t in some] == [
            [population, k, i] for k, kind in enumerate(KINDS) for i in range(counts[kind])
        ]


@pytest.mark.parametrize("index", range(len(CASES)))
def test_a_finder_can_read_each_room(index: int) -> None:
    case = Case.from_dict(CASES[index])
    assert len(case.configurations) == 1 + TRUTHS[index]["seed"][2] % 2
    assert set(case.configurations[0].measured.values) == {"t20", "edt", "t30", "c80", "g"}


def test_where_nothing_is_hidden_t_is_that_of_the_true_coefficients() -> None:
    """Eyring's equation fits another engine's rooms within a tenth."""
    ratios = []
    for stated, truth in zip(CASES, TRUTHS, strict=True):
        if truth["kind"] == "nothing":
            case = Case.from_dict(stated)
            t = np.nanmean(case.configurations[0].measured.values["t20"], axis=0)
            ratios.append(np.exp(np.nanmean(np.log(t / eyring(case, truth)))))
    assert np.median(ratios) == pytest.approx(1, abs=0.03)
    assert min(ratios) > 0.9
    assert sorted(ratios)[-3] < 1.1
    assert max(ratios) < 1.11  # of two rooms it is 1.101


def test_what_absorbs_shortens_t_and_a_noise_floor_lengthens_t30() -> None:
    for stated, truth in zip(CASES, TRUTHS, strict=True):
        case = Case.from_dict(stated)
        values = case.configurations[0].measured.values
        t20, t30 = (np.nanmean(values[p], axis=0) for p in ("t20", "t30"))
        without = eyring(case, truth)
        if truth["kind"] in ("opening", "porous") and truth["seed"] not in LONGER:
            assert np.nanmean(np.log(t20 / without)) < 0, truth["seed"]
        if truth["kind"] == "noise floor" and truth["level"] > -40:
            assert np.nanmean(np.log(t30 / t20)) > 0.1, truth["seed"]
