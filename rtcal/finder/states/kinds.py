"""The kinds of change between two states: absorption added or removed, or the air."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.air import Air
from rtcal.acoustics.bands import is_middle
from rtcal.acoustics.room import Room
from rtcal.finder.effects import Effect
from rtcal.finder.means.hypotheses import spectrum_errors
from rtcal.finder.model import RoomState
from rtcal.finder.prior import UNKNOWN, UNKNOWN_ODDS
from rtcal.support.types import Array

ADDED, REMOVED, AIR = "added", "removed", "air"
_FAMILY = "added absorption"
WALK = 0.5
"""Standard deviation per octave of ln absorption, of a spectrum that no effect of the library has."""
LEAST, MOST = 0.02, 6.0
"""Sizes that are tried, over the absorption area before at 500 to 2000 Hz."""
SIZES = 25
_HUMIDITIES = (20.0, 30.0, 40.0, 50.0, 60.0, 70.0)
_WARMER = (-4.0, 0.0, 4.0)
AIR_ODDS = 0.5
"""Prior odds that the climate changed and nothing else, against an effect of odds 1 on either side."""
_AIR_ERROR = 0.03


@dataclass(frozen=True, eq=False)
class Shape:
    """A spectrum of what changed: relative absorption area by band, and its errors.

    Attributes
    ----------
    name : str
        Of the effect; "unknown" of a spectrum that no effect has.
    family : str
        As the effect's, after "added absorption, ": "rising", "flat", "low"; "" of none.
    weight : float
        Prior odds.
    spectrum : array (n_bands,)
        Above 0; its mean over the bands is 1.
    covariance : array (n_bands, n_bands)
        Of the error of ln spectrum.
    """

    name: str
    family: str
    weight: float
    spectrum: Array
    covariance: Array


def shapes(room: Room, effects: Sequence[Effect]) -> list[Shape]:
    """Return the spectra of all effects that add absorption, and one that no effect has."""
    frequencies = room.centre_frequencies
    base = RoomState.of_room(room, np.zeros(len(room.areas)))
    out = []
    for effect in effects:
        if not effect.family.startswith(f"{_FAMILY}, "):
            continue
        spectra = [alpha for _, alpha in effect.on_surface(frequencies)] or [
            _of_objects(effect, base)
        ]
        error = spectrum_errors(effect, frequencies)
        for alpha in spectra:
            out.append(
                Shape(
                    effect.name,
                    effect.family.removeprefix(f"{_FAMILY}, "),
                    effect.prior_odds(room) / len(spectra),
                    _scaled(alpha),
                    error @ error.T,
                )
            )
    free = WALK**2 * _walk(np.log2(frequencies / 1000))
    out.append(Shape(UNKNOWN, "", UNKNOWN_ODDS, np.ones(len(frequencies)), free))
    return out


def _of_objects(effect: Effect, base: RoomState) -> Array:
    """Return what one size of an effect of objects adds in m², (n_bands,)."""
    added = effect.added_absorption(base, effect.change(base, effect.grid(base)[0]))
    return np.ones(len(base.frequencies)) if added is None else added


def _scaled(spectrum: Array) -> Array:
    """Return a spectrum with mean 1; a coefficient of 0 is a thousandth of the largest."""
    raised = np.maximum(spectrum, 1e-3 * spectrum.max())
    return np.asarray(raised / raised.mean())


def _walk(octaves: Array) -> Array:
    """Return the covariance of a random walk from 0 in both directions, of variance 1 per octave."""
    far = np.abs(octaves)
    return np.asarray((far[:, None] + far - np.abs(np.subtract.outer(octaves, octaves))) / 2)


@dataclass(frozen=True, eq=False)
class Grid:
    """Every hypothesis: a spectrum with a size, added or removed; or another climate.

    Attributes
    ----------
    names, families : tuple of str (n,)
    log_weight : array (n,)
        Log prior probabilities, given that something changed; they sum to 1.
    size : array (n, n_bands)
        Absorption area in m² before saturation, above 0 where added and below 0 where removed. Of the
        climate, what the air absorbs more.
    covariance : array (n, n_bands, n_bands)
        Of the error of ln |size|.
    of_air : array (n,) of bool
    """

    names: tuple[str, ...]
    families: tuple[str, ...]
    log_weight: Array
    size: Array
    covariance: Array
    of_air: NDArray[np.bool_]


def grid(room: Room, before: Array, bands: NDArray[np.bool_], effects: Sequence[Effect]) -> Grid:
    """Return every hypothesis of a room with this absorption area before, in these bands.

    Parameters
    ----------
    room : Room
    before : array (n_bands,)
        The surfaces' absorption area in m²; NaN where unknown.
    bands : array (n_bands,) of bool
        Bands to take.
    """
    middle = bands & is_middle(room.centre_frequencies)
    area = float(before[middle if middle.any() else bands].mean())
    names, families, weights, sizes, covariances, of_air = [], [], [], [], [], []
    levels = area * np.geomspace(LEAST, MOST, SIZES)
    of_room = shapes(room, effects)
    odds = sum(shape.weight for shape in of_room)
    n = int(bands.sum())
    for side, sign in ((ADDED, 1.0), (REMOVED, -1.0)):
        for shape in of_room:
            spectrum = shape.spectrum[bands]
            for level in levels:
                names.append(f"{side} {shape.name}")
                families.append(", ".join(filter(None, [f"{side} absorption", shape.family])))
                weights.append(shape.weight / len(levels))
                sizes.append(sign * level * spectrum / spectrum.mean())
                covariances.append(shape.covariance[np.ix_(bands, bands)])
                of_air.append(False)
    climates = [4 * room.volume * m[bands] for m in _other_air(room)]
    for more in climates:
        names.append(AIR)
        families.append("climate")
        weights.append(2 * odds * AIR_ODDS / odds / len(climates))
        sizes.append(more)
        covariances.append(_AIR_ERROR**2 * np.eye(n))
        of_air.append(True)
    weight = np.array(weights)
    return Grid(
        tuple(names),
        tuple(families),
        np.log(weight / weight.sum()),
        np.array(sizes),
        np.array(covariances),
        np.array(of_air),
    )


def _other_air(room: Room) -> Iterator[Array]:
    """Yield by how much the attenuation of other climates differs in 1/m, (n_bands,)."""
    stated = room.air or Air()
    frequencies = room.centre_frequencies
    here = stated.attenuation(frequencies)
    for warmer in _WARMER:
        for humidity in _HUMIDITIES:
            temperature = float(np.clip(stated.temperature + warmer, -20, 50))
            other = Air(temperature, humidity, stated.pressure)
            if other != stated:
                yield other.attenuation(frequencies) - here
