"""Which calculated mode is which measured one: by frequency, decay and pattern, with a probability.

All calculated frequencies share an error (speed of sound, size) and each has one of its own. A measured
mode is a calculated one, or none. The probability of each weighs

- the normal density of the frequencies' difference,
- the normal density of the logarithm of the decays' ratio, and
- the pattern: with P pairs and the share x of the measured pattern that the calculated one does not
  explain, x is chance with density (P - 1) x^(P - 2), and of the right mode with one proportional to
  x^(P - 2) exp(-x / t²), t² the relative variance of a pattern's error.

A mode found may be two in one: it is left out where another calculated mode as strong lies within half
the width of both, and was not found itself. No measured mode and no calculated one is used twice: a
match counts where its probability is large seen from either side.
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
_DECAY = 0.5
"""Standard deviation of the logarithm of a mode's decay where the walls are not calibrated yet."""
_CALIBRATED = 0.3
"""The same of calibrated walls."""
_REACTANCE = 0.7
"""Standard deviation of a frequency's shift by reactance, of half the mode's width delta / (2 pi)."""
_PATTERN = 0.35
"""Relative error of a mode's pattern: positions, neighbouring modes."""
_INDEPENDENT = 4
"""Pairs whose errors of a pattern count as independent; those of more go together."""
_APART = 0.5
"""Distance in widths within which a mode that was not found may be part of one that was."""
_STRONG = 0.2
"""Power of such a mode over the positions, of that which was found."""
_WHOLE = 0.05
"""Share of a pattern that one mode may miss where it is no mixture of two."""
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
    *,
    calibrated: bool = False,
) -> Matches:
    """Match measured modes to calculated ones.

    Parameters
    ----------
    measured : MeasuredModes
    frequencies, decays : array (n_calculated,)
        Hz and 1/s.
    patterns : complex array (n_calculated, n_pairs), optional
        Of the calculated modes at the measured pairs.
    calibrated : bool
        Whether the decays are those of calibrated walls.

    Examples
    --------
    >>> modes = MeasuredModes(frequencies=[34.6, 43.1], decays=[5, 6], decay_uncertainty=[0.3, 0.4])
    >>> found = match(modes, np.array([34.3, 42.9, 54.9]), np.array([5.0, 5.0, 7.0]))
    >>> print(found.calculated, round(found.scale, 3))
    [0 1] 1.004
    """
    plain = _without_frequency(measured, decays, patterns, _CALIBRATED if calibrated else _DECAY)
    spread = _spread(measured, frequencies, decays)
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
    sure &= ~_merged(best, sure, frequencies, decays, patterns, _missed(measured, patterns))
    return Matches(
        measured=np.flatnonzero(sure),
        calculated=best[sure],
        probability=probability[sure],
        scale=scale,
        ambiguous=np.flatnonzero(~sure),
    )


def _spread(measured: MeasuredModes, frequencies: Array, decays: Array) -> Array:
    """Return the standard deviation of each difference in Hz, (n_measured, n_calculated)."""
    own = np.hypot(OWN_ERROR * frequencies, _REACTANCE * decays / (2 * np.pi))
    stated = np.asarray(measured.frequency_uncertainty)
    return np.asarray(np.hypot(stated[:, np.newaxis], own))


def _merged(
    best: NDArray[np.intp],
    sure: NDArray[np.bool_],
    frequencies: Array,
    decays: Array,
    patterns: NDArray[np.complex128] | None,
    missed: Array | None,
) -> NDArray[np.bool_]:
    """Return which matches may be two modes in one: a mode nearby was not found, and is as strong.

    A pattern that the one mode explains whole is no mixture.
    """
    width = (decays[best][:, np.newaxis] + decays) / (2 * np.pi)
    near = np.abs(frequencies[best][:, np.newaxis] - frequencies) < _APART * width
    near[:, np.unique(best[sure])] = False
    near[np.arange(len(best)), best] = False
    if patterns is not None and missed is not None:
        power = (np.abs(patterns) ** 2).sum(axis=1)
        near &= power > _STRONG * power[best][:, np.newaxis]
        near &= (missed[np.arange(len(best)), best] > _WHOLE)[:, np.newaxis]
    return np.asarray(near.any(axis=1))


def _without_frequency(
    measured: MeasuredModes, decays: Array, patterns: NDArray[np.complex128] | None, error: float
) -> Array:
    """Return the logarithm of all likelihoods but the frequency's, (n_measured, n_calculated)."""
    relative = measured.decay_uncertainty / measured.decays
    spread = np.hypot(error, relative)[:, np.newaxis]
    off = np.log(measured.decays[:, np.newaxis] / decays) / spread
    # Relative to a stranger's decay, of which nothing is known but its order of magnitude.
    out = -(off**2) / 2 - np.log(spread)
    missed = _missed(measured, patterns)
    if missed is None:
        return np.asarray(out)
    pairs, variance = min(len(measured.pairs), _INDEPENDENT), _PATTERN**2
    chance = math.lgamma(pairs) + (pairs - 1) * math.log(variance)
    return np.asarray(out - missed / variance - chance)


def _missed(measured: MeasuredModes, patterns: NDArray[np.complex128] | None) -> Array | None:
    """Return the share of each measured pattern that each calculated one does not explain.

    None where patterns are not known, or of a single pair.
    """
    if patterns is None or measured.amplitudes is None or len(measured.pairs) < 2:
        return None
    heard = measured.amplitudes
    common = np.abs(heard.conj() @ patterns.T) ** 2
    whole = np.outer(*((np.abs(a) ** 2).sum(axis=1) for a in (heard, patterns)))
    return np.asarray(1 - np.clip(common / np.maximum(whole, 1e-300), 0.0, 1.0))


def _log_sum(table: Array) -> Array:
    top = table.max(axis=1)
    return np.asarray(top + np.log(np.exp(table - top[:, np.newaxis]).sum(axis=1)))
