"""Calibrate a room to the decays of its modes, which are read, or found in impulse responses.

Gauss-Newton steps are each a QP:

    minimise ½ (d - D(alpha))' C⁻¹ (d - D(alpha)) + the prior
    subject to T matched above the Schroeder frequency,

with d the measured decays and D those of the room's poles (`rtcal.modes.room_modes`), which are
linearised at the last answer. Below the Schroeder frequency no field is diffuse, and T is not used:
there it is some 1.3 times an equation's, since modes along walls decay slowly. C is the sum
of what was measured, of the model, and of what admittance does between the bands (`rtcal.modes.model`).

Where modes overlap, responses alone do not say how many there are. The room does: its calculated modes
have poles, and patterns over the positions (`rtcal.modes.model`), which are fitted (`rtcal.modes.fit`).
What is returned of each mode is what the responses say of it: its posterior, less its own prior. A mode
of which they say too little is left out, and so is one that is nearer to another calculated mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import band_conversion
from rtcal.acoustics.bands import mid_frequency_time, schroeder_frequency
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room, refuse_repeated_data
from rtcal.calibration.measured import MeasuredTimes, no_times, times_in_room
from rtcal.calibration.methods import gauss_newton, preset
from rtcal.calibration.problem import Calibration, CalibrationProblem, Times
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.terms import LinearObservations, Observed, as_objective
from rtcal.io.sofa import Responses
from rtcal.io.sound import clipped_samples
from rtcal.modes.fit import AMPLITUDE, FARTHEST, Point, Spectra, fitted
from rtcal.modes.measured import DECAY_ERROR, Matches, MeasuredModes, match
from rtcal.modes.model import ABOVE, RoomPoles
from rtcal.modes.result import ModesResult
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import single_threaded_blas
from rtcal.support.text import as_sentence
from rtcal.support.types import Array

MODES = LinearObservations("modes")

MODEL_ERROR = 0.05
"""Relative standard deviation of a calculated decay: geometry, admittance that varies over a wall.
Beside it stands delta / omega."""
_STEPS = 5
_SETTLED = 0.1
"""Share of a decay's uncertainty by which the linearised decay may be off the model's own."""


def calibrate_modes(
    room: Room,
    modes: MeasuredModes | Responses,
    measured: Measurement | Sequence[float] | Array | None = None,
    *,
    geometry: Polyhedron | None = None,
    equation: LinearEquation | None = None,
) -> ModesResult:
    """Calibrate a room's coefficients to the decays of its modes, together with T.

    Parameters
    ----------
    room : Room
        Its alpha and sigma are the prior. It states a mesh, or dimensions and a surface per wall. A
        coefficient's errors an octave apart have its ``band_correlation``, or 0.8 where that is 0.
    modes : MeasuredModes or Responses
        As `rtcal.modes.read` reads them, or `rtcal.modes.find_modes` finds them; or responses as
        `rtcal.io.sofa.read` reads them.
    measured : Measurement, or T in s, (n_bands,), optional
        Matched above the Schroeder frequency as method ``mle`` of `rtcal.calibrate` matches it, and
        not used below it. Its uncertainty counts in the intervals.
    geometry : Polyhedron, optional
        In place of the room's scene.
    equation : Equation, optional
        `rtcal.Eyring` if not given.

    Returns
    -------
    ModesResult

    Raises
    ------
    DataError
        If an argument breaks its rule, the room has no geometry, or no mode could be matched.
    ModelError, InfeasibleError, SolverError
        As `rtcal.calibrate`.
    MissingDependencyError
        If the room is no box and scikit-fem is not installed (``rtcal[modes]``).
    """
    checks.instance("room", room, Room)
    if isinstance(modes, Responses):
        modes = modes_in(room, modes, geometry)
    checks.instance("modes", modes, MeasuredModes)
    model = RoomPoles.of(room, max(ABOVE * modes.frequencies[-1], modes.largest), geometry)
    known = modes.calculated
    if known is not None and len(known) and known.max() >= model.modes.wanted:
        raise DataError(
            f"calculated has mode {known.max()}; the room has {model.modes.wanted} modes"
        )
    every = model.calculated
    found = match(modes, every.frequencies, every.decays)
    times = no_times(room) if measured is None else times_in_room(room, measured)
    refuse_repeated_data(room, modes.fingerprint, *times.fingerprint.split())
    low = below_schroeder(room, times)
    exact = np.isfinite(times.reverberation_time[~low]).any()
    t: Times | None = np.where(low, np.nan, times.reverberation_time) if exact else None
    if exact and isinstance(measured, Measurement):
        t = above_schroeder(measured, room, low)
    plain = preset("mle", model.room)
    problem = Calibration(
        as_objective(plain.objective) + MODES, plain.constraints if exact else ()
    ).build(model.room, Eyring() if equation is None else equation)
    used, lowest = found.measured, room.centre_frequencies[0] / 2
    if modes.frequencies[used].max() < lowest:
        raise DataError(
            f"no mode used reaches {lowest:g} Hz, an octave below the room's lowest band"
        )
    own = replace(model, chosen=tuple(found.calculated.tolist()))
    decays, _, remainder = own.linear(room.alpha)
    of_model = np.hypot(MODEL_ERROR, modes.decays / (2 * np.pi * modes.frequencies))[used]
    covariance = remainder + np.diag(modes.decay_uncertainty[used] ** 2 + (of_model * decays) ** 2)

    path = gauss_newton(
        room.alpha,
        lambda alpha: _Linearised(problem, own, modes.decays[used], covariance, t, alpha),
        most=_STEPS,
        halvings=3,
        settled=lambda step: step.model.error(step.model.towards(step.share)) < _SETTLED,
    )
    last = path.steps[-1].model
    return ModesResult(
        prior=room,
        alpha=np.clip(path.end, 0.0, 1.0),
        answer=last.answer,
        modes=modes,
        used=used,
        matched=found.calculated,
        probability=found.probability,
        scale=found.scale,
        frequencies=every.frequencies,
        decays_before=every.decays,
        decays_after=model.poles(path.end).decays,
        matrix=last.observed.matrix,
        covariance=last.observed.covariance,
        below=low,
        data=times,
        steps=len(path.steps),
        settled=path.settled,
        notes=_notes(modes, found, times, path.settled),
    )


@dataclass(frozen=True, eq=False)
class _Linearised:
    """The decays, linearised at ``alpha``, beside those measured; T above the Schroeder frequency.

    ``covariance`` is that of measured less modelled decays in 1/s², with the prior's slopes.
    """

    problem: CalibrationProblem[CalibrationResult]
    model: RoomPoles
    measured: Array
    covariance: Array
    times: Times | None
    alpha: Array

    @cached_property
    def observed(self) -> Observed:
        """The linearised decays as an observation of alpha."""
        decays, matrix, _ = self.model.linear(self.alpha)
        values = self.measured - decays + matrix @ self.alpha.ravel()
        return Observed(matrix=matrix, values=values, covariance=self.covariance)

    @cached_property
    def answer(self) -> CalibrationResult:
        """The answer of the QP."""
        return self.problem.solve(self.times, observed={MODES: self.observed}, method="modes")

    def towards(self, share: Array) -> Array:
        """Return alpha at this share of the way to the answer."""
        return np.asarray(self.alpha + float(share[0]) * (self.answer.alpha - self.alpha))

    def worse(self, end: Array) -> NDArray[np.bool_]:
        """Return whether the decays themselves are farther from those measured than at the start.

        The prior pulls too: the misfit may rise to the linear answer's own.
        """
        now, there = (self.measured - self.model.linear(a)[0] for a in (self.alpha, end))
        off = np.column_stack([now, self._left(end), there])
        misfit = (off * np.linalg.solve(self.covariance, off)).sum(axis=0) / 2
        return np.array([misfit[2] > max(misfit[:2]) + 0.5])

    def error(self, end: Array) -> float:
        """Return the largest error of the linearised decays at ``end``, in their uncertainty."""
        off = np.abs(self.measured - self.model.linear(end)[0] - self._left(end))
        return float((off / np.sqrt(np.diag(self.covariance))).max())

    def _left(self, end: Array) -> Array:
        """Return measured less linearised decays at ``end``."""
        return np.asarray(self.observed.values - self.observed.matrix @ end.ravel())


def _notes(
    modes: MeasuredModes, found: Matches, times: MeasuredTimes, settled: bool
) -> tuple[str, ...]:
    notes = [*map(as_sentence, filter(None, [times.caution])), *modes.notes, *found.doubts]
    if len(unsure := np.delete(modes.frequencies, found.measured)):
        where = ", ".join(f"{f:.1f}" for f in unsure)
        notes.append(f"Not used, since not surely one calculated mode: {where} Hz.")
    if not settled:
        notes.append(
            "Not settled: the last step still moved decays by a tenth of their uncertainty."
        )
    return tuple(notes)


def above_schroeder(measured: Measurement, room: Room, low: NDArray[np.bool_]) -> Measurement:
    """Return a measurement, with its uncertainty, without the bands ``low`` of the room."""
    wanted = room.centre_frequencies[~low]
    possible = band_conversion.obtainable(measured.centre_frequencies, wanted)
    return band_conversion.measurement(measured, possible)


def below_schroeder(room: Room, times: MeasuredTimes) -> NDArray[np.bool_]:
    """Return which bands lie below the Schroeder frequency; all where no T was measured."""
    t = times.reverberation_time
    middle = mid_frequency_time(t, room.centre_frequencies)
    limit = float(schroeder_frequency(np.array(middle), room.volume))
    return np.asarray(~(room.centre_frequencies >= limit))  # without T the limit is NaN


HIGHEST = 150.0  # Hz, where none is stated
LARGEST_ERROR = 0.5  # largest relative uncertainty of a decay that is used
UNEXPLAINED = 0.2
"""Share of the responses' power, or of the amplitudes', from which these are not the room's modes.

In seven rooms with their own positions at most 2 % of the amplitudes' were unexplained. With receivers
exchanged or a time axis 20 ms late it was 33 % or more.
"""
_INFLATED = 1.5  # uncertainty over what independent errors give: what is left is no white noise


@single_threaded_blas()
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
