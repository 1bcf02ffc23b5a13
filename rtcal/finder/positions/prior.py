"""What is believed of the coefficients and the climate before anything was measured."""

from __future__ import annotations

import numpy as np

from rtcal.acoustics import common_errors
from rtcal.acoustics.air import Air
from rtcal.acoustics.common_errors import HANDBOOK_SIGMA
from rtcal.acoustics.room import Room
from rtcal.finder.case import CLIMATE_UNCERTAINTY
from rtcal.finder.positions.case import Case
from rtcal.support.types import Array

IN_SITU, HANDBOOK = "measured in situ", "from a handbook"
"""How a room's coefficients are stated."""


def statement(room: Room) -> str:
    """Return `IN_SITU` or `HANDBOOK`: which of the judged rooms a room resembles.

    By the mean sigma over the mean alpha, weighted by area: a handbook's is `HANDBOOK_SIGMA`.
    """
    relative = float((room.areas @ room.sigma).sum() / (room.areas @ room.alpha).sum())
    return HANDBOOK if relative > 0.95 * HANDBOOK_SIGMA else IN_SITU


def usual_errors(case: Case) -> Array:
    """Return the changes of alpha that catalogues err by in common, (n, n_materials, n_bands).

    As `rtcal.finder.coefficients` describes them: a factor and a tilt of all coefficients, and of
    each material's.
    """
    room = case.room
    octaves = np.log2(room.centre_frequencies / 1000)
    stated = room.sigma / np.maximum(room.alpha, 1e-6) / HANDBOOK_SIGMA
    level = room.alpha * np.minimum(1.0, stated**2)
    own = np.eye(room.n_materials)[:, :, np.newaxis] * level
    parts = [
        [common_errors.COMMON * level],
        [common_errors.TILT * level * octaves],
        common_errors.OWN * own,
        common_errors.OWN_TILT * own * octaves,
    ]
    return np.concatenate([np.asarray(part) for part in parts])


def climate_error(case: Case) -> Array:
    """Return the standard deviations of the air's attenuation by an uncertain climate, (2, n_bands).

    Over that at 20 °C and 50 %, as `AIR`; none where the room has no air.
    """
    room = case.room
    if room.air is None:
        return np.zeros((0, room.n_bands))
    f = room.centre_frequencies
    reference = Air(20, 50).attenuation(f)
    t, h = room.air.temperature, room.air.humidity
    kelvin, percent = CLIMATE_UNCERTAINTY
    ends = [
        (Air(t + kelvin, h), Air(t - kelvin, h)),
        (Air(t, min(h + percent, 100.0)), Air(t, max(h - percent, 1.0))),
    ]
    return np.array([(a.attenuation(f) - b.attenuation(f)) / 2 / reference for a, b in ends])
