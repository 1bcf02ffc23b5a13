"""Hypotheses of the whole room: other air or volume, and one material."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.finder.effects.air import OmittedAir
from rtcal.finder.effects.base import Parameters
from rtcal.finder.effects.stated import WrongVolume
from rtcal.finder.model import State
from rtcal.finder.positions.case import Case
from rtcal.finder.positions.responses import AIR, SHARES, VOLUME
from rtcal.finder.positions.shift import (
    ODDS,
    Shift,
    error_over_bands,
    interpolation,
    towards,
)
from rtcal.finder.prior import COEFFICIENTS, grid_weights, relative_sigma
from rtcal.support.types import Array

FACTORS = np.array([-1.2, -0.9, -0.65, -0.45, -0.3, 0.3, 0.45, 0.65, 0.9, 1.2])
"""ln of the factors by which one material's coefficients may be off."""
FACTOR_SCALE = 0.35
"""Mean size of that logarithm. Carpets, plasters and glass of one name differ by 20 to 60 % between
tables, and now and then by a factor of three."""


def materials(case: Case) -> list[Shift]:
    """Return each material's coefficients off by a factor.

    Its surfaces then hear what an absorber on all of them would do, with the material's own spectrum.
    """
    room = case.room
    made_of = np.array([room.material_index(m) for m in case.geometry.materials])
    octaves = np.abs(np.subtract.outer(*(2 * [np.log2(room.centre_frequencies)])))
    density = np.exp(-np.abs(FACTORS) / FACTOR_SCALE)
    # Who states a small sigma knows the coefficients from a measurement (`off_together`).
    odds = ODDS[COEFFICIENTS] * relative_sigma(room) ** 2
    absorbed = room.areas * room.alpha.mean(axis=1)
    made = []
    for row, material in enumerate(room.materials):
        members = [
            j for j, faces in enumerate(case.faces.values()) if (made_of[faces] == row).all()
        ]
        if not members:
            continue
        alpha = room.alpha[row]
        moved = np.minimum(np.exp(FACTORS)[:, np.newaxis] * alpha, 1.0) - alpha
        every = interpolation(SHARES, towards(moved, alpha))
        made.append(
            Shift(
                effect=COEFFICIENTS,
                family=COEFFICIENTS,
                surface=None,
                response=f"material {row}",
                weights=np.tile(every, (1, 1, len(members))),
                odds=density / density.sum() * absorbed[row] / absorbed.sum() * odds,
                sizes=np.exp(FACTORS),
                unit="of what is stated",
                parameters=[{"factor": float(np.exp(f))} for f in FACTORS],
                spectra=np.zeros((len(FACTORS), 0)),
                error=0.1**2 + 0.15**2 * 0.7**octaves,
                uneven=np.zeros(len(FACTORS)),
                place=material,
            )
        )
    return made


def _whole(
    effect: str,
    family: str,
    at: Array,
    nodes: Sequence[float],
    *,
    odds: Array,
    sizes: Array,
    unit: str,
    parameters: Sequence[Parameters],
    error: Array,
) -> Shift:
    odds = odds * ODDS[effect] / odds.sum()
    return Shift(
        effect=effect,
        family=family,
        surface=None,
        response=effect,
        weights=interpolation(nodes, at),
        odds=odds,
        sizes=sizes,
        unit=unit,
        parameters=parameters,
        spectra=np.zeros((len(sizes), 0)),
        error=error,
        uneven=np.zeros(len(sizes)),
    )


def stated_room(case: Case) -> State:
    """Return the room as it is stated; which way its materials face changes no whole-room effect."""
    return State.of_room(case.room, np.full((case.room.n_materials, 3), 1 / 3))


def air(case: Case) -> Shift:
    """Return other climates, or air where none is stated."""
    effect, room = OmittedAir(), case.room
    f = room.centre_frequencies
    reference = Air(20, 50).attenuation(f)
    stated = stated_room(case)
    grid = effect.grid(stated)
    attenuation = np.array([Air(p["temperature"], p["humidity"]).attenuation(f) for p in grid])
    density = grid_weights(effect, grid, stated)
    return _whole(
        "air",
        effect.family,
        (attenuation - room.air_attenuation) / reference,
        AIR,
        odds=density * effect.prior_odds(room),
        sizes=np.array([p["humidity"] for p in grid]),
        unit=effect.unit,
        parameters=grid,
        error=error_over_bands(effect, f),
    )


def volume(case: Case) -> Shift:
    """Return other volumes, the geometry scaled."""
    effect, n_bands = WrongVolume(), case.room.n_bands
    stated = stated_room(case)
    grid = effect.grid(stated)
    logs = np.log([p["ratio"] for p in grid])
    density = grid_weights(effect, grid, stated)
    return _whole(
        "volume",
        effect.family,
        np.repeat(logs[:, np.newaxis], n_bands, axis=1),
        VOLUME,
        odds=density,
        sizes=np.exp(logs),
        unit=effect.unit,
        parameters=grid,
        error=np.full((n_bands, n_bands), 0.02**2) + 0.02**2 * np.eye(n_bands),
    )
