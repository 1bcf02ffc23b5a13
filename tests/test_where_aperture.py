"""The energy that a second room returns through an aperture."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.observables import observable
from rtcal.finder.positions.weighing import SECOND_ROOMS, Aperture

WIDTH = 0.002


def room() -> rt.Room:
    return rt.Room(
        name="box",
        volume=120.0,
        materials=["walls"],
        areas=[150.0],
        alpha=[[0.3, 0.2]],
        sigma=[[0.03, 0.02]],
        centre_frequencies=(500.0, 1000.0),
    )


@pytest.mark.parametrize("parameter", ["t20", "t30"])
def test_the_decay_with_a_second_room_holds_a_decay_time(parameter: str) -> None:
    """Even where the paths end before the decay does."""
    t = WIDTH * np.arange(220)
    energy = np.exp(-13.8 * t / np.array([[0.4], [0.6]]))[np.newaxis].repeat(2, axis=0)
    for volume, alpha in SECOND_ROOMS:
        aperture = Aperture(2.0, volume * 120.0, alpha)
        heard = aperture.returned_to(energy, room(), WIDTH, 2)
        assert not observable(parameter).too_short(heard).any()
