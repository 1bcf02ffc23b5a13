"""The reach of the stated coefficients: a measured reverberation time may lie beyond it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from rtcal.acoustics.bands import label
from rtcal.acoustics.observables import EARLY, REVERBERATION, parameter_label
from rtcal.acoustics.room import Room
from rtcal.support.types import Array

CONTRADICTION = 0.001
"""Probability, divided among the bands, of a T that is farther than the stated coefficients explain."""
_REACH = 2.0
"""Standard deviations of the stated coefficients that a sentence counts as within reach."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BeyondPrior:
    """A measured T that the stated coefficients, within their sigma, do not explain.

    Attributes
    ----------
    parameter : str
        Which T: that which was matched.
    frequency : float
        Band in Hz in which it is farthest.
    measured, simulated, reached : float
        Means over the pairs in s: measured, simulated with the stated coefficients, and with all of
        them two sigma towards what was measured.
    stated, needed : float
        Mean coefficient over the areas, as stated, and with the absorption that gives the measured T.
    z : float
        The difference over its standard deviation.
    bands, of_bands : int
        Bands that are as far, and bands with a measured T.
    """

    parameter: str
    frequency: float
    measured: float
    simulated: float
    reached: float
    stated: float
    needed: float
    z: float
    bands: int
    of_bands: int

    def __str__(self) -> str:
        name = parameter_label(self.parameter)
        ratio = self.simulated / self.measured
        times = f"{ratio:.1f} times as long" if ratio > 1 else f"{1 / ratio:.1f} times shorter"
        sigma = abs(self.z) / _REACH
        needed = (
            f"a mean coefficient of {self.needed:.2f} where {self.stated:.2f} is stated"
            if self.needed > 0
            else "a mean coefficient below 0"
        )
        return (
            f"The stated coefficients and their sigma cannot explain the measured {name}: at "
            f"{label(self.frequency)} it is {self.measured:.2f} s, the simulation of the stated room "
            f"has {self.simulated:.2f} s, {times}, and coefficients within {_REACH:g} sigma reach "
            f"{self.reached:.2f} s ({self.bands} of {self.of_bands} bands are beyond). Needed would be "
            f"{needed}, {abs(self.z):.0f} standard deviations away: state a sigma "
            f"{sigma:.0f} times as large where the coefficients are guesses, or look for what the room "
            "lacks (rtcal find)."
        )


def beyond_prior(
    room: Room,
    parameters: Sequence[str],
    measured: Array,
    simulated: Array,
    matrix: Array,
    prior: Array,
    error: Array,
) -> BeyondPrior | None:
    """Return how far the measured T is from the stated coefficients; None if they explain it.

    Absorption is inverse to T, so that T itself says how much more is needed, also where the
    derivatives at the stated coefficients do not reach so far. They say how uncertain the stated
    absorption is.

    Parameters
    ----------
    room : Room
    parameters : sequence of str
        Those that are matched. T20 or T30 is judged, else EDT.
    measured, simulated : array (n_parameters, n_pairs, n_bands)
        As in `rtcal.simulators.Observations`; ``simulated`` with the stated coefficients.
    matrix : array (n_parameters, n_pairs, n_bands, n_unknowns)
        Derivatives of ``simulated``, NaN-free.
    prior : array (n_unknowns, n_unknowns)
    error : array (n_values, n_values)
        Covariance of the errors of measurement and simulator, of all values.
    """
    known = [o.key for o in (*REVERBERATION, EARLY) if o.key in parameters]
    if not known:
        return None
    p = parameters.index(known[0])
    there = np.isfinite(measured[p])
    number = there.sum(axis=0)
    bands = np.flatnonzero(number)
    weight = np.where(there, 1.0 / np.maximum(number, 1), 0.0)
    goal = np.exp((weight * np.where(there, measured[p], 0.0)).sum(axis=0))[bands]
    has = np.exp((weight * simulated[p]).sum(axis=0))[bands]
    more = has / goal - 1
    slopes = np.einsum("ik,iku->ku", weight, matrix[p])[bands]
    of_stated = np.sqrt(np.einsum("ku,uv,kv->k", slopes, prior, slopes))
    _, n_pairs, n_bands = measured.shape
    of_values = error.reshape(len(parameters), n_pairs, n_bands, len(parameters), n_pairs, n_bands)
    of_mean = np.sqrt([weight[:, k] @ of_values[p, :, k, p, :, k] @ weight[:, k] for k in bands])
    z = more / np.hypot(of_stated, (1 + more) * of_mean)
    beyond = np.abs(z) > norm.isf(CONTRADICTION / 2 / max(len(bands), 1))
    if not beyond.any():
        return None
    worst = int(np.argmax(np.abs(z)))
    k = bands[worst]
    area = room.areas @ room.alpha[:, k]
    whole = area + 4 * room.air_attenuation[k] * room.volume
    limit = 1 + np.sign(more[worst]) * _REACH * of_stated[worst]
    return BeyondPrior(
        parameter=known[0],
        frequency=float(room.centre_frequencies[k]),
        measured=float(goal[worst]),
        simulated=float(has[worst]),
        reached=float(has[worst] / limit),
        stated=float(area / room.total_area),
        needed=float((area + more[worst] * whole) / room.total_area),
        z=float(z[worst]),
        bands=int(beyond.sum()),
        of_bands=len(bands),
    )
