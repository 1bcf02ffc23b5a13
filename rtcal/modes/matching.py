"""Which calculated mode is which measured one: by frequency, decay and pattern, with a probability.

All calculated frequencies share an error (speed of sound, size) and each has one of its own. A measured
mode is a calculated one, or none. The probability of each weighs

- the normal density of the frequencies' difference,
- the normal density of the logarithm of the decays' ratio, and
- the pattern: with P pairs and the share x of the measured pattern that the calculated one does not
  explain, x is chance with density (P - 1) x^(P - 2), and of the right mode with one proportional to
  x^(P - 2) exp(-x / t²), t² the relative variance of a pattern's error.

No measured mode and no calculated one is used twice: a match counts where its probability is large seen
from either side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.modes.measured import MeasuredModes
from rtcal.support.types import Array

SURE = 0.95
"""Probability from which a match is used."""
COMMON_ERROR = 0.012
"""Standard deviation of the error that all calculated frequencies share, relative: 1 % of the size, and
some 4 K of temperature."""
OWN_ERROR = 0.004
"""Standard deviation of each calculated frequency's own error, relative: reactance, shape."""
_DECAY = 0.5
"""Standard deviation of the logarithm of a mode's decay: the walls are not calibrated yet."""
_PATTERN = 0.35
"""Relative error of a mode's pattern: positions, neighbouring modes."""
_STRANGER = 0.05
"""Prior probability that a measured mode is none of those calculated."""
_SCALES = 121


@dataclass(frozen=True, eq=False)
class Matches:
    """Measured modes and the calculated ones that they are.

    Attributes
    ----------
    measured, calculated : int arrays (n_matches,)
        Indices of the modes that belong together.
    probability : array (n_matches,)
    scale : float
        Factor of the calculated frequencies under which the measured ones are likeliest.
    ambiguous : int array
        Measured modes that could be several, or none.
    """

    measured: NDArray[np.intp]
    calculated: NDArray[np.intp]
    probability: Array
    scale: float
    ambiguous: NDArray[np.intp]


def match(
    measured: MeasuredModes,
    frequencies: Array,
    decays: Array,
    patterns: NDArray[np.complex128] | None = None,
) -> Matches:
    """Match measured modes to calculated ones.

    Parameters
    ----------
    measured : MeasuredModes
    frequencies, decays : array (n_calculated,)
        Hz and 1/s.
    patterns : complex array (n_calculated, n_pairs), optional
        Of the calculated modes at the measured pairs.

    Examples
    --------
    >>> modes = MeasuredModes(frequencies=[34.6, 43.1], decays=[5, 6], decay_uncertainty=[0.3, 0.4])
    >>> found = match(modes, np.array([34.3, 42.9, 54.9]), np.array([5.0, 5.0, 7.0]))
    >>> print(found.calculated, round(found.scale, 3))
    [0 1] 1.007
    """
    plain = _without_frequency(measured, decays, patterns)
    spread = _spread(measured, frequencies)
    tried = 1 + COMMON_ERROR * np.linspace(-3, 3, _SCALES)
    # The modes per Hz of a stranger's frequency: those of the room itself.
    span = max(float(frequencies[-1] - frequencies[0]), 1.0)
    stranger = math.log(_STRANGER * len(frequencies) / span)

    def joint(scale: float) -> Array:
        off = (measured.frequencies[:, np.newaxis] - scale * frequencies) / spread
        near = plain - off**2 / 2 - np.log(spread * np.sqrt(2 * np.pi))
        return np.column_stack([near, np.full(len(near), stranger)])

    likely = [float(_log_sum(joint(s)).sum()) - ((s - 1) / COMMON_ERROR) ** 2 / 2 for s in tried]
    scale = float(tried[int(np.argmax(likely))])
    table = joint(scale)
    by_row = np.exp(table - _log_sum(table)[:, np.newaxis])
    # Seen from the calculated mode: which measured one is it?
    by_column = by_row[:, :-1] / np.maximum(by_row[:, :-1].sum(axis=0), 1e-300)
    both = by_row[:, :-1] * by_column
    best = both.argmax(axis=1)
    probability = both[np.arange(len(both)), best]
    sure = probability >= SURE
    return Matches(
        measured=np.flatnonzero(sure),
        calculated=best[sure],
        probability=probability[sure],
        scale=scale,
        ambiguous=np.flatnonzero(~sure),
    )


def _spread(measured: MeasuredModes, frequencies: Array) -> Array:
    """Return the standard deviation of each difference in Hz, (n_measured, n_calculated)."""
    own = OWN_ERROR * frequencies
    return np.asarray(np.hypot(np.asarray(measured.frequency_uncertainty)[:, np.newaxis], own))


def _without_frequency(
    measured: MeasuredModes, decays: Array, patterns: NDArray[np.complex128] | None
) -> Array:
    """Return the logarithm of all likelihoods but the frequency's, (n_measured, n_calculated)."""
    relative = measured.decay_uncertainty / measured.decays
    spread = np.hypot(_DECAY, relative)[:, np.newaxis]
    off = np.log(measured.decays[:, np.newaxis] / decays) / spread
    # Relative to a stranger's decay, of which nothing is known but its order of magnitude.
    out = -(off**2) / 2 - np.log(spread)
    pairs = len(measured.pairs)
    if patterns is None or measured.amplitudes is None or pairs < 2:
        return np.asarray(out)
    heard, model = measured.amplitudes, patterns
    common = np.abs(heard.conj() @ model.T) ** 2
    whole = np.outer(*((np.abs(a) ** 2).sum(axis=1) for a in (heard, model)))
    missed = 1 - np.clip(common / np.maximum(whole, 1e-300), 0.0, 1.0)
    variance = _PATTERN**2
    chance = math.lgamma(pairs) + (pairs - 1) * math.log(variance)
    return np.asarray(out - missed / variance - chance)


def _log_sum(table: Array) -> Array:
    top = table.max(axis=1)
    return np.asarray(top + np.log(np.exp(table - top[:, np.newaxis]).sum(axis=1)))
