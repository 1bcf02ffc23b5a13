"""What tracers share: from energy decays in batches to a measurement that states its noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rtcal.acoustics import decay
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.support.types import Array

LONGEST = 60.0
"""s; a tracer follows no decay for longer: what is not over then is `TooShortError`."""


def jackknife(estimate: Callable[[Array], Array], batches: Array) -> Array:
    """Return the standard error of ``estimate(mean over batches)``; batches on axis 0.

    Leave-one-out (Efron & Stein 1981): sqrt((n - 1)/n sum (estimate_i - mean)²). NaN where leaving
    one out leaves no finite estimate: so few paths cannot tell their noise.
    """
    n = len(batches)
    total = batches.sum(axis=0)
    left_out = np.stack([estimate((total - batch) / (n - 1)) for batch in batches])
    left_out[~np.isfinite(left_out)] = np.nan
    spread = left_out - left_out.mean(axis=0)
    return np.asarray(np.sqrt((n - 1) / n * np.sum(spread**2, axis=0)))


def measurement(
    energy: Array, bin_width: float, centre_frequencies: Array, pairs: Sequence[tuple[str, str]]
) -> Measurement:
    """Return what energy decays in independent batches, (n_batches, n_pairs, n_bands, n_bins), mean.

    The uncertainty of EDT, T20, C50 and C80 is the batches' jackknife: the tracer's noise.
    """
    estimates: dict[str, Callable[[Array], Array]] = {
        "edt": lambda e: decay.decay_time(e, bin_width, "edt"),
        "t20": lambda e: decay.decay_time(e, bin_width, "t20"),
        "c50": lambda e: decay.clarity(e, bin_width, 0.05),
        "c80": lambda e: decay.clarity(e, bin_width, 0.08),
    }
    noise = {name: jackknife(estimate, energy) for name, estimate in estimates.items()}
    return decay.measurement(
        energy.mean(axis=0), bin_width, centre_frequencies, pairs, uncertainty=noise
    )


def decay_long_enough(simulate: Callable[[float], Array], room: Room, alpha: Array) -> Array:
    """Return ``simulate(seconds)``, (n_batches, ...), with seconds doubled until T20 fits in.

    Starts with Eyring's T of alpha and goes no further than `LONGEST`.
    """
    times = Eyring().reverberation_time(room.replace(alpha=alpha, calibration=None))
    seconds = float(np.clip(np.max(times), 0.2, LONGEST))
    while True:
        energy = simulate(seconds)
        if seconds >= LONGEST or not decay.too_short(energy.mean(axis=0)).any():
            return energy
        seconds = min(2 * seconds, LONGEST)
