"""G."""

from __future__ import annotations

import numpy as np

from rtcal.acoustics.observables.base import DB, Observable, Scale, register
from rtcal.support.types import Array


class OfEnergy(Observable):
    """A level of the whole energy in dB: what `G` and `Level` have in common."""

    unit = "dB"
    decimals = 1
    jnd = 1.0
    limits = -200.0, 200.0
    doubt = "is it in dB?"
    minimum_range = None
    part = "level"
    # In dB, of G; see `rtcal.acoustics.observables.decay_times.TEAMS`.
    teams = (2.0, 1.55, 1.20, 0.92, 0.72, 0.55)
    unknown_error = 0.5
    remeasured = 0.2
    averaging = Scale(
        lambda level: 10 ** (level / 10),
        lambda energy: 10 * np.log10(energy),
        lambda level: np.log(10) / 10 * 10 ** (level / 10),
    )

    def value(self, energy: Array, bin_width: float) -> Array:
        """Return the level of a source of unit energy relative to 10 m in the free field, in dB."""
        with np.errstate(divide="ignore"):
            return np.asarray(10 * np.log10(400 * np.pi * energy.sum(-1)))

    def gradient(self, energy: Array, level: Array, bin_width: float) -> Array:
        """Return DB / sum(E)."""
        return np.broadcast_to(DB / energy.sum(-1, keepdims=True), energy.shape)

    def linear(self, values: Array, stated: Array) -> Array:
        """Return 1 - E_stated / E: the inverse of the energy is linear in the absorption area."""
        return np.asarray(1 - np.exp(-(values - stated) * (1 / DB)))

    def linear_slope(self, values: Array, stated: Array) -> Array:
        """Return the derivative of `linear` by the level."""
        unit = 1 / DB
        return np.asarray(unit * np.exp(-(values - stated) * unit))


@register
class Level(OfEnergy):
    """The level, relative to any reference that all receivers of a source share.

    It is what G is without a calibrated source, and G serves in its place.
    """

    key, label, rank = "level", "level", 90
    stand_in = "g"
    matched = True


@register
class G(OfEnergy):
    """Sound strength: the level relative to 10 m in the free field (ISO 3382-1:2009, A.2.1)."""

    key, label, rank = "g", "G", 80
    spellings = ("strength", "soundstrength")
    # Far outdoors, and at 0.1 m from a source.
    usual = -40.0, 45.0
