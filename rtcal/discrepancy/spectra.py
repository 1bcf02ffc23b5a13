"""What absorbers and the air absorb, by band; kept, since each is asked for in many sizes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.support.types import Array


def between(frequencies: Array, octaves: Sequence[float]) -> Array:
    """Read values at 63 Hz to 8 kHz between the octaves, over the logarithm of the frequency."""
    centres = np.log(62.5 * 2.0 ** np.arange(8))
    return np.asarray(np.interp(np.log(frequencies), centres, octaves))


@lru_cache(maxsize=256)
def porous(frequencies: tuple[float, ...], thickness: float, flow_resistivity: float) -> Array:
    """Return the statistical alpha of a layer, m and Pa s/m², (n_bands,) (Miki 1990)."""
    # Averaged over the octave: a narrow resonance of a thin layer is not measured as such.
    inside = np.array(frequencies)[:, None] * 2.0 ** np.array([-0.33, 0.0, 0.33])
    ratio = inside / flow_resistivity
    k = 2 * np.pi * inside / 343.2
    impedance = 1 + 0.0699 * ratio**-0.632 - 1j * 0.1071 * ratio**-0.632
    number = k * (1 + 0.1093 * ratio**-0.618 - 1j * 0.1597 * ratio**-0.618)
    z = -1j * impedance / np.tan(number * thickness)
    angles = np.linspace(0, np.radians(78), 40)
    normal, weight = z[..., None] * np.cos(angles), np.sin(2 * angles)
    absorbed = 1 - np.abs((normal - 1) / (normal + 1)) ** 2
    return _kept(np.clip((absorbed @ weight / weight.sum()).mean(-1), 0, 1))


@lru_cache(maxsize=256)
def resonator(frequencies: tuple[float, ...], resonance: float, quality: float) -> Array:
    """Return a resonator's alpha with a0 = 0.8, averaged over each octave, (n_bands,)."""
    x = np.array(frequencies)[:, None] * 2.0 ** np.linspace(-0.45, 0.45, 9) / resonance
    return _kept((0.8 / (1 + quality**2 * (x - 1 / x) ** 2)).mean(1))


@lru_cache(maxsize=256)
def air(frequencies: tuple[float, ...], temperature: float, humidity: float) -> Array:
    """Return the air's energy attenuation in 1/m, (n_bands,)."""
    return _kept(Air(temperature, humidity).attenuation(frequencies))


def _kept(values: Array) -> Array:
    values.setflags(write=False)  # the cache hands it out again
    return values
