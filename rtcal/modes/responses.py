"""Modes of impulse responses: common poles of all positions, in narrow bands.

Each band is shifted to 0 Hz, filtered and thinned out, so that it holds a few modes and few samples.
All pairs share the poles, and each pair has its own amplitudes:

    y_r(t) = sum_n A_nr exp(s_n t) + noise.

ESPRIT (Roy & Kailath 1989) takes the poles of all pairs' Hankel matrices side by side, for each order
up to 12. A non-linear fit by Gauss-Newton steps refines them with their amplitudes. The order is that
of the least Bayesian information criterion (Schwarz 1978). The information matrix of the fit gives the
uncertainty of the poles (Kay 1993, Ch. 3). Bands overlap by half, and a mode is taken from the band in
whose middle half it lies. Left out are modes whose decay is too uncertain, weak modes, and
modes closer to another than half the sum of their widths.

References
----------
Roy & Kailath 1989, IEEE Trans. ASSP 37; Laakso et al. 2002, frequency-zooming ARMA for modal analysis;
Kay 1993, Fundamentals of Statistical Signal Processing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.errors import DataError
from rtcal.io.sofa import Responses
from rtcal.modes.measured import MeasuredModes
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.types import Array

Complex = NDArray[np.complex128]

LEAST_PAIRS = 2
BANDWIDTH = 16.0
"""Hz of each band; 1.7 times as many complex samples per second are kept."""
_SAMPLES_PER_HZ = 1.7
_MOST_ORDER = 12
_MOST_SAMPLES = 120
_STEPS = 8
LARGEST_ERROR = 0.35
"""Largest relative uncertainty of a decay that is used."""
_WEAK = 0.03
"""Amplitude of a mode, of the strongest beside it, below which it may be what a filter let through."""
_CLIPPED = 4
"""Samples in a row at the largest value from which a response is clipped."""
_LEAST_RANGE = 15.0
"""dB between the start of a band and its noise."""


@checked
def find_modes(
    responses: Array,
    rate: float,
    pairs: Sequence[tuple[str, str]],
    *,
    lowest: float = 20.0,
    highest: float = 150.0,
) -> MeasuredModes:
    """Find the modes of a room in impulse responses at several positions.

    Parameters
    ----------
    responses : array (n_pairs, n_samples)
        All in one unit and on one time axis, in which the sound starts at the same moment.
    rate : float
        Samples per second.
    pairs : sequence of (source, receiver)
        Names of the positions.
    lowest, highest : float
        Hz within which modes are sought.

    Raises
    ------
    DataError
        For fewer than two pairs, a shape or value that breaks its rule, a clipped response, noise that
        leaves no decay, or no mode that is sure enough.

    Examples
    --------
    >>> t = np.arange(4000) / 1000
    >>> rng = np.random.default_rng(1)
    >>> one, other = (np.exp(-d * t) * np.cos(2 * np.pi * f * t) for f, d in ((40, 4), (55, 6)))
    >>> heard = np.array([one + other, one - 2 * other, other]) + 1e-3 * rng.standard_normal((3, 4000))
    >>> modes = find_modes(heard, 1000, [("S", "R1"), ("S", "R2"), ("S", "R3")], highest=80)
    >>> print(modes.frequencies.round(1), modes.decays.round(1))
    [40. 55.] [4. 6.]
    """
    signals = _checked(responses, rate, pairs, lowest, highest)
    found: list[_Mode] = []
    orders = []
    centres = np.arange(lowest + BANDWIDTH / 4, highest + BANDWIDTH / 4, BANDWIDTH / 2)
    silent = 0
    for centre in centres:
        low, thin, noise = _band(signals, rate, float(centre))
        if low is None:
            silent += 1
            continue
        modes, order = _modes(low, thin, float(centre), noise)
        orders.append(order)
        found += [
            m
            for m in modes
            if abs(m.frequency - centre) <= BANDWIDTH / 4 and lowest <= m.frequency <= highest
        ]
    if silent == len(centres):
        raise DataError(
            f"no band has a decay of {_LEAST_RANGE:g} dB above its noise: measure with more signal"
        )
    kept, notes = _resolved(sorted(found, key=lambda m: m.frequency))
    if not kept:
        raise DataError("no mode is sure enough: measure at more positions, or with less noise")
    notes.insert(
        0,
        f"Modes of {len(pairs)} pairs by ESPRIT in {len(orders)} bands of {BANDWIDTH:g} Hz; order "
        f"{min(orders)} to {max(orders)} by the Bayesian information criterion.",
    )
    if silent:
        notes.append(
            f"Left out: {silent} bands without a decay of {_LEAST_RANGE:g} dB above noise."
        )
    return MeasuredModes(
        frequencies=np.array([m.frequency for m in kept]),
        decays=np.array([m.decay for m in kept]),
        decay_uncertainty=np.array([m.decay_uncertainty for m in kept]),
        frequency_uncertainty=np.array([m.frequency_uncertainty for m in kept]),
        pairs=pairs,
        amplitudes=np.array([m.amplitudes for m in kept]),
        notes=notes,
    )


def modes_in(responses: Responses) -> MeasuredModes:
    """Return the modes of a SOFA file's responses, of the first channel; errors as `find_modes`.

    A pair that was measured several times counts once.
    """
    first: dict[tuple[str, str], Array] = {}
    for pair, samples in zip(responses.pairs, responses.samples, strict=True):
        first.setdefault(pair, samples[0])
    return find_modes(np.array([*first.values()]), responses.sampling_rate, [*first])


@dataclass(frozen=True, eq=False)
class _Mode:
    """A mode found: frequency in Hz, decay in 1/s, their uncertainty, and amplitude at each pair."""

    frequency: float
    decay: float
    frequency_uncertainty: float
    decay_uncertainty: float
    amplitudes: Complex


def _checked(
    responses: Array, rate: float, pairs: Sequence[tuple[str, str]], lowest: float, highest: float
) -> Array:
    signals = checks.array("responses", responses)
    rate = checks.positive("rate", rate, "Hz")
    pairs = checks.pairs("pairs", pairs)
    if signals.ndim != 2 or signals.shape[0] != len(pairs):
        raise DataError(
            f"responses has shape {signals.shape}; with {len(pairs)} pairs it is ({len(pairs)}, "
            "n_samples)"
        )
    if len(pairs) < LEAST_PAIRS:
        raise DataError(
            f"responses has {len(pairs)} pair; modes need {LEAST_PAIRS}, of different positions"
        )
    if not np.isfinite(signals).all():
        raise DataError("responses has a value that is not finite")
    if not 0 < lowest < highest <= rate / 2.5:
        raise DataError(
            f"lowest = {lowest:g} Hz and highest = {highest:g} Hz are not in order above 0 and up to "
            f"rate / 2.5 = {rate / 2.5:g} Hz"
        )
    if signals.shape[1] < rate:
        raise DataError(
            f"responses are {signals.shape[1] / rate:.2f} s long; low modes need at least 1 s"
        )
    for pair, signal in zip(pairs, signals, strict=True):
        top = np.abs(signal).max()
        if top == 0:
            raise DataError(f"the response of {' to '.join(pair)} is silent")
        at_top = (np.abs(signal) >= top * (1 - 1e-9)).astype(int)
        if (np.convolve(at_top, np.ones(_CLIPPED, dtype=int), "valid") == _CLIPPED).any():
            raise DataError(f"the response of {' to '.join(pair)} is clipped")
    return signals


def _band(signals: Array, rate: float, centre: float) -> tuple[Complex | None, float, float]:
    """Return a band's complex samples (n_pairs, n), their rate, and the noise's variance.

    None if its decay does not stand above the noise.
    """
    from scipy.signal import firwin, oaconvolve

    n = signals.shape[1]
    down = signals * np.exp(-2j * np.pi * centre * np.arange(n) / rate)
    step = max(int(rate / (BANDWIDTH * _SAMPLES_PER_HZ)), 1)
    taps = firwin(int(2.2 * rate / BANDWIDTH) | 1, 0.62 * BANDWIDTH, fs=rate)
    low = oaconvolve(down, taps[np.newaxis], mode="full", axes=1)
    # From where the filter has the whole start of the response within it.
    low = low[:, len(taps) - 1 : n : step]
    thin = rate / step
    power = (np.abs(low) ** 2).mean(axis=0)
    tail = max(len(power) // 8, 4)
    noise = float(power[-tail:].mean())
    start = float(power[:4].mean())
    if start < noise * 10 ** (_LEAST_RANGE / 10):
        return None, thin, noise
    above = np.flatnonzero(power > 2 * noise)
    length = int(min(above[-1] + 1, _MOST_SAMPLES)) if len(above) else len(power)
    return low[:, : max(length, 16)], thin, noise


def _modes(low: Complex, rate: float, centre: float, noise: float) -> tuple[list[_Mode], int]:
    """Return the modes of a band, and the order that describes it best."""
    n_pairs, n = low.shape
    rows = n // 2
    # (rows, columns of all pairs side by side)
    hankel = np.concatenate(
        [np.lib.stride_tricks.sliding_window_view(y, rows).T for y in low], axis=1
    )
    left = np.linalg.svd(hankel, full_matrices=False)[0]
    best: tuple[float, Complex, Complex, float] | None = None
    order = 0
    for p in range(1, min(_MOST_ORDER, rows - 2) + 1):
        steps = np.linalg.eigvals(np.linalg.lstsq(left[:-1, :p], left[1:, :p], rcond=None)[0])
        tried = np.log(steps.astype(complex)) * rate
        tried = tried[(tried.real < 0) & np.isfinite(tried)]
        if not len(tried):
            continue
        poles, amplitudes, error = _fitted(low, rate, tried)
        # Two reals for each pole and for each amplitude; 2 n values of each pair.
        values = 2 * n * n_pairs
        criterion = values * np.log(max(error, noise)) + np.log(values) * 2 * len(poles) * (
            1 + n_pairs
        )
        if best is None or criterion < best[0]:
            best, order = (float(criterion), poles, amplitudes, error), len(poles)
    if best is None:
        return [], 0
    _, poles, amplitudes, error = best
    spread = np.sqrt(_covariance(n, rate, poles, amplitudes, max(error, noise)))
    return [
        _Mode(
            frequency=float(centre + s.imag / (2 * np.pi)),
            decay=float(-s.real),
            frequency_uncertainty=float(max(u / (2 * np.pi), 1e-3)),
            decay_uncertainty=float(max(u, 1e-3)),
            amplitudes=a,
        )
        for s, u, a in zip(poles, spread, amplitudes, strict=True)
    ], order


def _powers(n: int, rate: float, poles: Complex) -> Complex:
    return np.asarray(np.exp(np.arange(n)[:, np.newaxis] / rate * poles))


def _fitted(low: Complex, rate: float, poles: Complex) -> tuple[Complex, Complex, float]:
    """Return poles and amplitudes (n_poles, n_pairs) of the least squares, and the mean error²."""
    n = low.shape[1]
    time = np.arange(n)[:, np.newaxis] / rate

    def solved(at: Complex) -> tuple[Complex, Complex, float]:
        powers = _powers(n, rate, at)
        amplitudes = np.asarray(np.linalg.lstsq(powers, low.T, rcond=None)[0], dtype=np.complex128)
        off = low.T - powers @ amplitudes
        return amplitudes, off, float((np.abs(off) ** 2).mean())

    amplitudes, off, error = solved(poles)
    for _ in range(_STEPS):
        powers = _powers(n, rate, poles)
        slope = _projected(powers, time, amplitudes)
        move = np.linalg.lstsq(slope, off.T.reshape(-1), rcond=1e-9)[0]
        moved: Complex = np.asarray(poles + move, dtype=np.complex128)
        if (moved.real >= 0).any() or not np.isfinite(moved).all():
            break
        trial = solved(moved)
        if trial[2] > error * (1 - 1e-6):
            break
        poles, (amplitudes, off, error) = moved, trial
    return poles, amplitudes, error


def _projected(powers: Complex, time: Array, amplitudes: Complex) -> Complex:
    """Return derivatives of all pairs by the poles, (n_pairs n, n_poles), free of the amplitudes."""
    base = np.linalg.qr(powers)[0]
    slope = (time * powers)[np.newaxis] * amplitudes.T[:, np.newaxis, :]
    slope = slope - base @ (base.conj().T @ slope)
    return np.asarray(slope.reshape(-1, powers.shape[1]))


def _covariance(n: int, rate: float, poles: Complex, amplitudes: Complex, error: float) -> Array:
    """Return the variance of the real part of each pole, (n_poles,), from the information matrix.

    The filter lets 1.24 bands of noise through, of 1.7 that the samples have: fewer are independent.
    """
    time = np.arange(n)[:, np.newaxis] / rate
    slope = _projected(_powers(n, rate, poles), time, amplitudes)
    information = (slope.conj().T @ slope).real / error
    scaled = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(scaled, scaled), hermitian=True)
    return np.asarray(np.diag(inverse) / scaled**2 / 2 * (_SAMPLES_PER_HZ / 1.24))


def _resolved(modes: list[_Mode]) -> tuple[list[_Mode], list[str]]:
    """Return the modes that stand apart and are sure, and notes of the others."""
    notes: list[str] = []
    kept: list[_Mode] = []
    size = np.array([np.linalg.norm(m.amplitudes) for m in modes])
    f = np.array([m.frequency for m in modes])
    beside_it = np.abs(f[:, np.newaxis] - f) < 1.5 * BANDWIDTH
    strong = size > _WEAK * np.where(beside_it, size, 0.0).max(axis=1, initial=0.0)
    if not strong.all():
        where = ", ".join(f"{x:.1f}" for x in f[~strong])
        notes.append(f"Left out, since too weak: {where} Hz.")
    modes = [m for m, s in zip(modes, strong, strict=True) if s]
    unsure = [m for m in modes if m.decay_uncertainty > LARGEST_ERROR * m.decay]
    sure = [m for m in modes if m.decay_uncertainty <= LARGEST_ERROR * m.decay]
    close: list[_Mode] = []
    for k, mode in enumerate(sure):
        beside = [*sure[max(k - 1, 0) : k], *sure[k + 1 : k + 2]]
        width = [(m.decay + mode.decay) / (2 * np.pi) / 2 for m in beside]
        apart = all(
            abs(m.frequency - mode.frequency) > w for m, w in zip(beside, width, strict=True)
        )
        (kept if apart else close).append(mode)
    for some, why in ((unsure, "too uncertain"), (close, "closer than their widths")):
        if some:
            where = ", ".join(f"{m.frequency:.1f}" for m in some)
            notes.append(f"Left out, since {why}: {where} Hz.")
    return kept, notes
