"""Modes of impulse responses: a room's own modes, heard at all positions together.

Where modes overlap, responses alone do not say how many there are. The room does: its calculated modes
have poles, and patterns over the positions (`rtcal.modes.model`), which are fitted (`rtcal.modes.fit`).
What is returned of each mode is what the responses say of it: its posterior, less its own prior. A mode
of which they say too little is left out, and so is one that is nearer to another calculated mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.room import Room
from rtcal.io.sofa import Responses
from rtcal.io.wav import clipped_samples
from rtcal.modes.fit import AMPLITUDE, FARTHEST, Point, Spectra, fitted
from rtcal.modes.measured import DECAY_ERROR, MeasuredModes
from rtcal.modes.model import ABOVE, RoomPoles
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.speed import single_threaded_blas
from rtcal.support.types import Array

HIGHEST = 150.0  # Hz, where none is stated
LARGEST_ERROR = 0.5  # largest relative uncertainty of a decay that is used
UNEXPLAINED = 0.2
"""Share of the responses' power, or of the amplitudes', from which these are not the room's modes.

In seven rooms with their own positions at most 2 % of the amplitudes' were unexplained. With receivers
exchanged or a time axis 20 ms late it was 33 % or more.
"""
_INFLATED = 1.5  # uncertainty over what independent errors give: what is left is no white noise


@single_threaded_blas()
@checked
def find_modes(
    room: Room,
    responses: Array,
    rate: float,
    pairs: Sequence[tuple[str, str]],
    *,
    lowest: float = 20.0,
    highest: float = HIGHEST,
    geometry: Polyhedron | None = None,
) -> MeasuredModes:
    """Find the modes of a room in impulse responses at several positions.

    Parameters
    ----------
    room : Room
        It states geometry and positions. Its coefficients are where the search begins.
    responses : array (n_pairs, n_samples)
        All in one unit and on one time axis, which begins as the sound does.
    rate : float
        Samples per second.
    pairs : sequence of (source, receiver)
        Names of the positions in the room's scene.
    lowest, highest : float
        Hz within which modes are sought.
    geometry : Polyhedron, optional
        In place of the room's scene.

    Raises
    ------
    DataError
        For fewer than two pairs, a pair that stands there twice, a shape or value that breaks its rule,
        a clipped response, noise that leaves no decay, responses that the room's modes do not explain,
        frequencies at the end of what is sought, or no mode that is sure enough.
    """
    pairs = checks.pairs("pairs", pairs)
    signals = _checked(responses, rate, pairs, lowest, highest)
    # By a power of two, so that no digit changes.
    size = float(2.0 ** np.frexp(np.abs(signals).max())[1])
    model = RoomPoles.of(room, ABOVE * highest, geometry)
    heard = Spectra.of(signals / size, rate, lowest, highest)
    fit = fitted(heard, model.calculated, model.amplitudes(pairs))
    if max(fit.unexplained, fit.strange) > UNEXPLAINED:
        raise DataError(
            f"the room's modes leave {fit.unexplained:.0%} of the responses' power unexplained, and "
            f"{fit.strange:.0%} of the amplitudes over the positions: check dimensions, positions, "
            "temperature and that the time axis begins as the sound does"
        )
    if abs(fit.problem.scale - 1) > 0.99 * FARTHEST:
        raise DataError(
            f"frequencies are {fit.problem.scale:.3f} times those calculated or beyond, where the "
            "search ends: check dimensions and temperature"
        )
    told = _told(fit, model.modes.largest, lowest, highest)
    return replace(told, amplitudes=size * fit.own[told.calculated])


def modes_in(room: Room, responses: Responses, geometry: Polyhedron | None) -> MeasuredModes:
    """Return the modes of a SOFA file's responses, of the first channel; errors as `find_modes`.

    A pair that was measured several times counts once.
    """
    first: dict[tuple[str, str], Array] = {}
    placed, note = responses.placed(room.scene)
    for pair, samples in zip(placed.pairs, placed.samples, strict=True):
        first.setdefault(pair, samples[0])
    heard = np.array([*first.values()])
    rate, top = placed.sampling_rate, min(HIGHEST, placed.sampling_rate / 2.5)
    modes = find_modes(room, heard, rate, [*first], highest=top, geometry=geometry)
    return replace(modes, notes=[*modes.notes, *filter(None, [note])])


def _checked(
    responses: Array, rate: float, pairs: Sequence[tuple[str, str]], lowest: float, highest: float
) -> Array:
    signals = checks.array("responses", responses)
    rate = checks.positive("rate", rate, "Hz")
    if signals.ndim != 2 or signals.shape[0] != len(pairs):
        raise DataError(
            f"responses has shape {signals.shape}; with {len(pairs)} pairs it is ({len(pairs)}, "
            "n_samples)"
        )
    if len(pairs) < 2:
        raise DataError(f"responses has {len(pairs)} pair; modes need 2, of different positions")
    if len(set(pairs)) < len(pairs):
        twice = next(p for k, p in enumerate(pairs) if p in pairs[:k])
        raise DataError(f"pairs: {' to '.join(twice)} stands there twice; average its responses")
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
        if not signal.any():
            raise DataError(f"the response of {' to '.join(pair)} is silent")
        if clipped_samples(signal):
            raise DataError(f"the response of {' to '.join(pair)} is clipped")
    return signals


def _told(fit: Point, largest: float, lowest: float, highest: float) -> MeasuredModes:
    """Return what the responses say of each mode, without what was believed of it before."""
    n = len(fit.frequencies)
    variance = np.diag(fit.covariance)
    after, before = variance[n:], DECAY_ERROR**2
    precision = np.maximum(1 / after - 1 / before, 1e-9)
    log_decay = (fit.log_decays / after - fit.problem.prior[n:] / before) / precision
    relative = _INFLATED / np.sqrt(precision)
    sure = relative < LARGEST_ERROR
    own = _own(fit)
    inside = (fit.frequencies >= lowest) & (fit.frequencies <= highest)
    chosen = np.flatnonzero(sure & own & inside)
    if not len(chosen):
        raise DataError("no mode is sure enough: measure at more positions, or with less noise")
    chosen = chosen[np.argsort(fit.frequencies[chosen], kind="stable")]
    notes = [
        f"Modes of {fit.own.shape[1]} pairs: {len(chosen)} of {int(inside.sum())} calculated from "
        f"{lowest:g} to {highest:g} Hz were heard. Together they leave {fit.unexplained:.1%} of the "
        f"responses' power, and the patterns {fit.strange:.1%} of the amplitudes'."
    ]
    for some, why in (
        (inside & ~sure, "the responses say too little of them"),
        (inside & sure & ~own, "nearer to another calculated mode"),
    ):
        if some.any():
            where = ", ".join(f"{f:.1f}" for f in fit.frequencies[some])
            notes.append(f"Left out, since {why}: {where} Hz.")
    decays = np.exp(log_decay[chosen])
    return MeasuredModes(
        frequencies=fit.frequencies[chosen],
        decays=decays,
        decay_uncertainty=relative[chosen] * decays,
        frequency_uncertainty=np.maximum(_INFLATED * np.sqrt(variance[chosen]), 1e-3),
        calculated=chosen,
        largest=largest,
        notes=notes,
    )


def _own(fit: Point) -> NDArray[np.bool_]:
    """Return which modes are nearest to their own calculated one, by frequency and pattern."""
    psi, heard, n = fit.problem.psi, fit.own, len(fit.own)
    common = np.abs(heard.conj() @ psi.T) ** 2
    whole = np.outer(*((np.abs(a) ** 2).sum(axis=1) for a in (heard, psi)))
    missed = 1 - common / np.maximum(whole, 1e-300)
    off = (fit.frequencies[:, np.newaxis] - fit.problem.prior[:n]) / fit.problem.spread[:n]
    return np.asarray((off**2 + missed / AMPLITUDE**2).argmin(axis=1) == np.arange(n))
