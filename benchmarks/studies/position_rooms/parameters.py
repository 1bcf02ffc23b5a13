"""The parameters measured from an energy decay, and the noise that a measurement has. Nothing of rtcal.

The noise is that of real rooms. A response in a band of bandwidth B is noise-like: its energy in a
window of T seconds scatters by 1 / sqrt(B T). Each pair's reflections are multiplied by such noise
before anything is evaluated, so that T20, EDT, C80, Ts and level err together. The direct sound is
left. A further error is common to all pairs of a band: equipment and evaluation. Between the teams of
the round robin in the PTB's studio (Bork 2005) T30 differed by 4.6 % at 125 Hz and 1.3 % at 4 kHz, EDT
by 10 to 3.3 %, C80 by 0.83 to 0.35 dB, G by 2.0 to 0.55 dB. A share of it is taken as common.
"""

from __future__ import annotations

import numpy as np

PARAMETERS = ("t20", "edt", "c80", "ts", "g")
OCTAVES = np.array([63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0])
# Between teams; the edge bands continue their neighbours.
BETWEEN_TEAMS = {
    "t20": np.array([0.046, 0.046, 0.035, 0.027, 0.021, 0.017, 0.013, 0.013]),
    "edt": np.array([0.10, 0.10, 0.08, 0.06, 0.05, 0.04, 0.033, 0.033]),
    "c80": np.array([0.83, 0.83, 0.70, 0.58, 0.48, 0.41, 0.35, 0.35]),
    "g": np.array([2.0, 2.0, 1.5, 1.1, 0.85, 0.68, 0.55, 0.55]),
}
BETWEEN_TEAMS["ts"] = BETWEEN_TEAMS["edt"]


def line_time(level: np.ndarray, width: float, upper: float, lower: float) -> np.ndarray:
    """Return -60 dB over the least squares slope of decay curves (..., n) between two levels, in s."""
    within = ((level <= upper) & (level >= lower)).astype(float)
    t = width * np.arange(level.shape[-1])
    y = np.where(within > 0, level, 0.0)
    n = within.sum(-1)
    mean = (within * t).sum(-1) / n
    centred = within * (t - mean[..., np.newaxis])
    return -60 * (centred * t).sum(-1) / (centred * y).sum(-1)


def evaluate(energy: np.ndarray, width: float) -> dict[str, np.ndarray]:
    """Return T20, EDT in s, C80 in dB, Ts in s and G in dB of energy (..., n_bins)."""
    left = np.cumsum(energy[..., ::-1], axis=-1)[..., ::-1]
    level = 10 * np.log10(np.maximum(left / left[..., :1], 1e-12))
    split = round(0.08 / width)
    time = width * (np.arange(energy.shape[-1]) + 0.5)
    time[0] = 0.0  # nearly all of the first bin is the direct sound
    total = energy.sum(-1)
    return {
        "t20": line_time(level, width, -5, -25),
        "edt": line_time(level, width, 0, -10),
        "c80": 10 * np.log10(energy[..., :split].sum(-1) / energy[..., split:].sum(-1)),
        "ts": (energy * time).sum(-1) / total,
        "g": 10 * np.log10(4 * np.pi * 100 * total),
    }


def noise_like(
    rng: np.random.Generator, energy: np.ndarray, width: float, bands: np.ndarray
) -> np.ndarray:
    """Return energy (..., n_bands, n_bins) of noise-like responses with this mean, but for bin 0.

    The squared envelope of noise of bandwidth B has independent values each 1 / B, exponentially
    distributed (two degrees of freedom).
    """
    out = energy.copy()
    edges = width * np.arange(energy.shape[-1] + 1)
    for k, f in enumerate(bands):
        cell = 1 / (0.71 * f)  # an octave's bandwidth is f / sqrt(2)
        n = int(np.ceil(edges[-1] / cell)) + 1
        for index in np.ndindex(energy.shape[:-2]):
            summed = np.concatenate([[0.0], np.cumsum(rng.standard_exponential(n))])
            at = np.interp(edges / cell + rng.random(), np.arange(n + 1), summed)
            factor = np.diff(at) * cell / width
            out[(*index, k)][1:] *= factor[1:]
    return out


def measure(
    rng: np.random.Generator, energy: np.ndarray, width: float, bands: np.ndarray, share: float
) -> dict[str, np.ndarray]:
    """Return what a team measures where the mean energy is (n_pairs, n_bands, n_bins).

    ``share`` is that of the teams' differences which all pairs of a team have in common.
    """
    values = evaluate(noise_like(rng, energy, width, bands), width)
    which = np.searchsorted(OCTAVES, bands)
    for name in PARAMETERS:
        common = share * BETWEEN_TEAMS[name][which] * rng.standard_normal(len(bands))
        if name in ("c80", "g"):
            values[name] = values[name] + common
        else:
            values[name] = values[name] * np.exp(common)
    return values
