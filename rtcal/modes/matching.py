"""Which calculated mode is which one of a table: by frequency and decay, with a probability.

All calculated frequencies share an error (speed of sound, size) and each has one of its own. A measured
mode is a calculated one, or none. The probability of each weighs the normal density of the frequencies'
difference, and that of the logarithm of the decays' ratio.

No measured mode and no calculated one is used twice: a match counts where its probability is large seen
from either side. Modes of responses need no matching: they were found as the room's own
(`rtcal.modes.responses`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.modes.measured import MeasuredModes
from rtcal.support.types import Array

SURE = 0.9
"""Probability from which a match is used."""
COMMON_ERROR = 0.012
"""Standard deviation of the error that all calculated frequencies share, relative: 1 % of the size, and
some 4 K of temperature."""
OWN_ERROR = 0.004
"""Standard deviation of each calculated frequency's own error, relative: reactance, shape."""
DECAY_ERROR = 0.5
"""Standard deviation of the logarithm of a calculated decay: the walls are not calibrated yet."""
_REACTANCE = 0.7
"""Standard deviation of a frequency's shift by reactance, of half the mode's width delta / (2 pi)."""
_STRANGER = 0.05
"""Prior probability that a measured mode is none of those calculated."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Measured modes and the calculated ones that they are.

    ``measured`` and ``calculated`` (n_matches,) are indices of the modes that belong together, with
    their ``probability``. ``scale`` is the factor of the calculated frequencies under which those
    measured are likeliest. ``ambiguous`` are measured modes that could be several, or none.
    """

    measured: NDArray[np.intp]
    calculated: NDArray[np.intp]
    probability: Array
    scale: float
    ambiguous: NDArray[np.intp]


def match(measured: MeasuredModes, frequencies: Array, decays: Array) -> Matches:
    """Match measured modes to calculated ones.

    Parameters
    ----------
    measured : MeasuredModes
    frequencies, decays : array (n_calculated,)
        Hz and 1/s.

    Examples
    --------
    >>> modes = MeasuredModes(frequencies=[34.6, 43.1], decays=[5, 6], decay_uncertainty=[0.3, 0.4])
    >>> found = match(modes, np.array([34.3, 42.9, 54.9]), np.array([5.0, 5.0, 7.0]))
    >>> print(found.calculated, round(found.scale, 3))
    [0 1] 1.004
    """
    from scipy.special import logsumexp

    own = measured.calculated
    if own is not None:
        # The modes of responses were found as the room's own.
        scale, sure = float(np.median(measured.frequencies / frequencies[own])), np.ones(len(own))
        return Matches(np.arange(len(own)), own, sure, scale, np.array([], dtype=int))
    relative = measured.decay_uncertainty / measured.decays
    of_decay = np.hypot(DECAY_ERROR, relative)[:, np.newaxis]
    # Relative to a stranger's decay, of which nothing is known but its order of magnitude.
    plain = -((np.log(measured.decays[:, np.newaxis] / decays) / of_decay) ** 2) / 2 - np.log(
        of_decay
    )
    stated = np.asarray(measured.frequency_uncertainty)[:, np.newaxis]
    spread = np.hypot(stated, frequency_error(frequencies, decays))
    tried = 1 + COMMON_ERROR * np.linspace(-3, 3, 121)
    # The modes per Hz of a stranger's frequency: those of the room itself.
    span = max(float(frequencies[-1] - frequencies[0]), 1.0)
    stranger = math.log(_STRANGER * len(frequencies) / span)

    def joint(scale: float) -> Array:
        off = (measured.frequencies[:, np.newaxis] - scale * frequencies) / spread
        near = plain - off**2 / 2 - np.log(spread * np.sqrt(2 * np.pi))
        return np.column_stack([near, np.full(len(near), stranger)])

    likely = [logsumexp(joint(s), axis=1).sum() - ((s - 1) / COMMON_ERROR) ** 2 / 2 for s in tried]
    scale = float(tried[int(np.argmax(likely))])
    table = joint(scale)
    by_row = np.exp(table - logsumexp(table, axis=1, keepdims=True))
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


def frequency_error(frequencies: Array, decays: Array) -> Array:
    """Return the standard deviation of each calculated frequency's own error in Hz, same shape."""
    return np.asarray(np.hypot(OWN_ERROR * frequencies, _REACTANCE * decays / (2 * np.pi)))
