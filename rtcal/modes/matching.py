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
from rtcal.support.errors import DataError
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
_RANGE = 3.0
"""Largest factor that all frequencies share and that is sought, in its standard deviations."""
_DRAWS = 40
"""Sets of random frequencies that tell how many matches are by chance."""
_BY_CHANCE = 0.05
"""Share of the random sets with as many matches from which these are doubtful."""
_ODD = 0.01
"""Probability of as many modes without a partner below which these are doubtful."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Measured modes and the calculated ones that they are.

    ``measured`` and ``calculated`` (n_matches,) are indices of the modes that belong together, with
    their ``probability``. ``scale`` is the factor of the calculated frequencies under which those
    measured are likeliest. ``doubts`` say what speaks against the matches.
    """

    measured: NDArray[np.intp]
    calculated: NDArray[np.intp]
    probability: Array
    scale: float
    doubts: tuple[str, ...] = ()


def match(measured: MeasuredModes, frequencies: Array, decays: Array) -> Matches:
    """Match measured modes to calculated ones.

    Parameters
    ----------
    measured : MeasuredModes
    frequencies, decays : array (n_calculated,)
        Hz and 1/s.

    Raises
    ------
    DataError
        For no more matches than random frequencies have, or a common factor at the end of its range.
    """
    from scipy.special import bdtrc

    own = measured.calculated
    if own is not None:
        # The modes of responses were found as the room's own.
        scale, sure = float(np.median(measured.frequencies / frequencies[own])), np.ones(len(own))
        return Matches(np.arange(len(own)), own, sure, scale)
    scale, strange, both = _likely(measured, measured.frequencies, frequencies, decays)
    best, probability = both.argmax(axis=1), both.max(axis=1)
    sure, n = probability >= SURE, len(both)
    count, strangers = int(sure.sum()), int((strange > 0.5).sum())
    if count and abs(scale - 1) > (_RANGE - 0.01) * COMMON_ERROR:
        raise DataError(
            f"measured frequencies are {scale:.3f} times those calculated or beyond, where the search "
            "ends: check dimensions and temperature"
        )
    rng, lowest = np.random.default_rng(0), float(min(frequencies[0], measured.frequencies[0]))
    highest = float(max(measured.frequencies[-1], lowest + 1))
    drawn = (rng.uniform(lowest, highest, n) for _ in range(_DRAWS))
    chance = np.array(
        [(_likely(measured, f, frequencies, decays)[2].max(axis=1) >= SURE).sum() for f in drawn]
    )
    if not count or count < chance.mean():
        raise DataError(
            f"{count or 'none'} of the {n} measured modes is surely one calculated mode: none is near, "
            f"or two are. Of random frequencies {chance.mean():.1f} are. Check frequencies, dimensions "
            "and temperature, then stated coefficients and uncertainties"
        )
    doubts = []
    if (chance >= count).mean() > _BY_CHANCE:
        doubts.append(
            f"Doubtful: {count} of {n} modes were matched, and of random frequencies "
            f"{chance.mean():.1f} are in the mean, up to {chance.max()}: they may be of another room."
        )
    if strangers and bdtrc(strangers - 1, n, _STRANGER) < _ODD:
        doubts.append(
            f"Doubtful: {strangers} of {n} measured modes have no partner among those calculated: "
            "check dimensions, and whether each frequency is a mode."
        )
    return Matches(np.flatnonzero(sure), best[sure], probability[sure], scale, tuple(doubts))


def _likely(
    measured: MeasuredModes, at: Array, frequencies: Array, decays: Array
) -> tuple[float, Array, Array]:
    """Return how likely measured modes, were they ``at`` these frequencies in Hz, are which.

    The factor of the calculated frequencies, the probability of each to be none, (n_modes,), and that
    of each to be each calculated one, seen from either side, (n_modes, n_calculated).
    """
    from scipy.special import logsumexp

    relative = measured.decay_uncertainty / measured.decays
    of_decay = np.hypot(DECAY_ERROR, relative)[:, np.newaxis]
    # Relative to a stranger's decay, of which nothing is known but its order of magnitude.
    plain = -((np.log(measured.decays[:, np.newaxis] / decays) / of_decay) ** 2) / 2 - np.log(
        of_decay
    )
    stated = np.asarray(measured.frequency_uncertainty)[:, np.newaxis]
    spread = np.hypot(stated, frequency_error(frequencies, decays))
    tried = 1 + COMMON_ERROR * np.linspace(-_RANGE, _RANGE, 121)
    # The modes per Hz of a stranger's frequency: those of the room itself.
    span = max(float(frequencies[-1] - frequencies[0]), 1.0)
    stranger = math.log(_STRANGER * len(frequencies) / span)

    def joint(scale: float) -> Array:
        off = (at[:, np.newaxis] - scale * frequencies) / spread
        near = plain - off**2 / 2 - np.log(spread * np.sqrt(2 * np.pi))
        return np.column_stack([near, np.full(len(near), stranger)])

    likely = [logsumexp(joint(s), axis=1).sum() - ((s - 1) / COMMON_ERROR) ** 2 / 2 for s in tried]
    scale = float(tried[int(np.argmax(likely))])
    table = joint(scale)
    by_row = np.exp(table - logsumexp(table, axis=1, keepdims=True))
    # Seen from the calculated mode: which measured one is it?
    by_column = by_row[:, :-1] / np.maximum(by_row[:, :-1].sum(axis=0), 1e-300)
    return scale, by_row[:, -1], by_row[:, :-1] * by_column


def frequency_error(frequencies: Array, decays: Array) -> Array:
    """Return the standard deviation of each calculated frequency's own error in Hz, same shape."""
    return np.asarray(np.hypot(OWN_ERROR * frequencies, _REACTANCE * decays / (2 * np.pi)))
