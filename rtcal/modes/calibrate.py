"""Calibrate a room to the decays of its modes, which are read, or found in impulse responses.

Gauss-Newton steps are each a QP:

    minimise ½ (d - D(alpha))' C⁻¹ (d - D(alpha)) + the prior
    subject to T matched above the Schroeder frequency,

with d the measured decays and D those of the room's poles (`rtcal.modes.room_modes`), which are
linearised at the last answer. Below the Schroeder frequency no field is diffuse, and T is not used:
there it is some 1.3 times an equation's, since modes along walls decay slowly. C is the sum
of what was measured, of the model, and of what admittance does between the bands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.bands import mid_frequency_time, schroeder_frequency
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.marks import Plausibility, TrustMark, cautions, mark, plausibility
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room, refuse_repeated_data
from rtcal.acoustics.room_errors import prior_covariance
from rtcal.calibration.measured import MeasuredTimes, data_history, no_times, times_in_room
from rtcal.calibration.methods import preset
from rtcal.calibration.problem import Calibration, Times, fit
from rtcal.calibration.qp import Certificate
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.table import coefficients
from rtcal.calibration.terms import LinearObservations, Observed
from rtcal.files.saved import Result
from rtcal.io.sofa import Responses
from rtcal.modes.measured import MeasuredModes, match, modes_in
from rtcal.modes.room_modes import ABOVE, DECAY, RoomPoles
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks, text
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence, with_uncertainty
from rtcal.support.types import Array

MODES = LinearObservations("modes")

MODEL_ERROR = 0.05
"""Relative standard deviation of a mode's calculated decay, from geometry and from an admittance that
varies over a wall. An error of delta / omega is added."""
_STEPS = 5


def calibrate_modes(
    room: Room,
    modes: MeasuredModes | Responses,
    measured: Measurement | Sequence[float] | Array | None = None,
    *,
    geometry: Polyhedron | None = None,
    equation: LinearEquation | None = None,
) -> ModesResult:
    """Calibrate a room's coefficients to the decays of its modes at low frequencies, and to T above.

    Parameters
    ----------
    room : Room
        Room with the input coefficients, and with a mesh, or dimensions and a surface for each wall.
        The errors of a material's coefficients an octave apart have the room's ``band_correlation``, or
        a correlation of 0.8 if that is 0.
    modes : MeasuredModes or Responses
        Measured modes, from `rtcal.modes.read` or `rtcal.modes.find_modes`; or impulse responses, from
        `rtcal.io.sofa.read`, in which rtcal finds the modes.
    measured : Measurement, or array (n_bands,) of T in s, optional
        Measured reverberation time. It is matched exactly in bands above the Schroeder frequency
        (method ``mle`` of `rtcal.calibrate`), and not used below. Its uncertainty widens the intervals
        of the coefficients. By default only the modes are used.
    geometry : Polyhedron, optional
        Geometry of the room, if the room's scene has no mesh or a different one.
    equation : LinearEquation, optional
        Reverberation equation with which T is matched; `rtcal.Eyring` by default.

    Returns
    -------
    ModesResult
        Calibrated coefficients with their uncertainty, and the modes that were used.

    Raises
    ------
    DataError
        If an argument breaks a rule, the room has no geometry, or no measured mode could be assigned to
        a calculated mode.
    ModelError, InfeasibleError, SolverError
        For the reasons that `rtcal.calibrate` names.
    MissingDependencyError
        If the room is not a box and scikit-fem is not installed (``rtcal[modes]``).
    """
    checks.instance("room", room, Room).refuse_pieces("a calibration to modes")
    if isinstance(modes, Responses):
        modes = modes_in(room, modes, geometry)
    checks.instance("modes", modes, MeasuredModes)
    model = RoomPoles.of(room, max(ABOVE * modes.frequencies[-1], modes.largest), geometry)
    known = modes.calculated
    if known is not None and len(known) and known.max() >= model.modes.wanted:
        raise DataError(
            f"calculated has mode {known.max()}, but the room has only {model.modes.wanted} modes"
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
    problem = Calibration(plain.objective + MODES, plain.constraints if exact else ()).build(
        model.room, Eyring() if equation is None else equation
    )
    used, lowest = found.measured, room.centre_frequencies[0] / 2
    if modes.frequencies[used].max() < lowest:
        raise DataError(
            f"all modes used lie below {lowest:g} Hz, an octave below the room's lowest "
            "band: measure modes at higher frequencies, or add a lower band to the room"
        )
    decays, _, remainder = model.linear(room.alpha, found.calculated)
    of_model = np.hypot(MODEL_ERROR, modes.decays / (2 * np.pi * modes.frequencies))[used]
    covariance = remainder + np.diag(modes.decay_uncertainty[used] ** 2 + (of_model * decays) ** 2)

    path = fit(
        problem,
        Decays(model, found.calculated, modes.decays[used], covariance),
        room.alpha,
        term=MODES,
        method="modes",
        times=t,
        most=_STEPS,
    )
    notes = [*map(as_sentence, filter(None, [times.caution])), *modes.notes, *found.doubts]
    if len(unsure := np.delete(modes.frequencies, used)):
        where = ", ".join(f"{f:.1f}" for f in unsure)
        notes.append(
            f"Modes that cannot be assigned to one calculated mode are not used: {where} Hz."
        )
    if not path.settled:
        notes.append(
            "The fit has not settled: its last step moved a coefficient by a twentieth of its sigma."
        )
    return ModesResult(
        prior=room,
        alpha=np.clip(path.alpha, 0.0, 1.0),
        answer=path.answer,
        modes=modes,
        used=used,
        matched=found.calculated,
        probability=found.probability,
        scale=found.scale,
        frequencies=every.frequencies,
        decays_before=every.decays,
        decays_after=model.poles(path.alpha).decays,
        below=low,
        data=times,
        steps=len(path.steps),
        settled=path.settled,
        notes=tuple(notes),
    )


@dataclass(frozen=True, eq=False)
class Decays:
    """Hold the measured decays of modes in 1/s, with the model that predicts them (an `Observation`).

    ``chosen`` (n_used,) are the numbers of the calculated modes that were measured. ``covariance``
    (n_used, n_used) is that of measured minus modelled decays, for the input coefficients.
    """

    model: RoomPoles
    chosen: NDArray[np.intp]
    values: Array
    covariance: Array

    def predict(self, alpha: Array) -> Array:
        """Return the modelled decays in 1/s for coefficients, (n_used,)."""
        return self.model.linear(alpha, self.chosen)[0]

    def jacobian(self, alpha: Array) -> Array:
        """Return the derivatives of the modelled decays by alpha, (n_used, n_materials * n_bands)."""
        return self.model.linear(alpha, self.chosen)[1]


def above_schroeder(measured: Measurement, room: Room, low: NDArray[np.bool_]) -> Measurement:
    """Return a measurement without the bands ``low`` of the room, with its uncertainty."""
    wanted = room.centre_frequencies[~low]
    possible = bands.obtainable(measured.centre_frequencies, wanted)
    return measured.in_bands(possible)


def below_schroeder(room: Room, times: MeasuredTimes) -> NDArray[np.bool_]:
    """Return whether each band is below the Schroeder frequency; True for all without a measured T."""
    t = times.reverberation_time
    middle = mid_frequency_time(t, room.centre_frequencies)
    limit = float(schroeder_frequency(np.array(middle), room.volume))
    return np.asarray(~(room.centre_frequencies >= limit))  # without T the limit is NaN


CARRIED = 3
"""Number of modes that a band needs to have no caution: in the band, or up to an octave below for the
lowest one."""
_HEADER = [
    "mode / Hz",
    "T measured / s",
    "T input / s",
    "T calibrated / s",
    "walls that matter most",
]
P_MODES = 0.01
"""p-value below which measured modes and input coefficients contradict each other."""
_ALIKE = 0.02  # share of the largest by which walls that a mode tells as much of may differ
_FACTOR_Z = 3.0  # standard deviations of all decays together from what was stated, that are told


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ModesResult(Result):
    """Room that is calibrated to the decays of its modes, with the modes that were used.

    ``modes`` are the measured modes and ``used`` the numbers of those that were used. ``frequencies``
    and ``decays_before`` belong to the calculated modes. ``steps`` is the number of linearisations,
    ``settled`` is True if the last one changed no coefficient by a twentieth of its sigma or more, and
    ``notes`` are cautions.
    """

    record_kind: ClassVar[str] = "modes 1"
    in_file: ClassVar[str] = (
        "room=prior.name centre_frequencies=prior.centre_frequencies modes=each frequency_scale=scale "
        "q=plausibility.q p_value=plausibility.p_value materials below_schroeder=below carried steps "
        "settled worst_certificate=certificate.worst notes=every_note"
    )

    prior: Room
    """Room before the calibration."""
    alpha: Array
    """Calibrated coefficients, (n_materials, n_bands)."""
    answer: CalibrationResult
    """Calibration of the last step, with linearised modes."""
    modes: MeasuredModes
    used: NDArray[np.intp]
    matched: NDArray[np.intp]
    """Numbers of the measured modes that were used (``used``), and of the calculated modes to which
    they were assigned, (n_used,)."""
    probability: Array
    """Probability that each used mode is assigned to the right calculated mode, (n_used,)."""
    scale: float
    """Ratio of measured to calculated frequencies that all modes have in common."""
    frequencies: Array
    decays_before: Array
    decays_after: Array
    """Frequency in Hz of all calculated modes, and their decays in 1/s with the input coefficients and
    with the calibrated coefficients, (n_calculated,)."""
    below: NDArray[np.bool_]
    """Whether each band is below the Schroeder frequency, where T is not used, (n_bands,)."""
    data: MeasuredTimes
    """Measured T with its uncertainty."""
    steps: int
    settled: bool
    notes: tuple[str, ...]

    @property
    def measured(self) -> Array:
        """Measured decays in 1/s of the modes that were used, (n_used,)."""
        return self.modes.decays[self.used]

    @property
    def before(self) -> Array:
        """Decays in 1/s of the used modes with the input coefficients, (n_used,)."""
        return self.decays_before[self.matched]

    @property
    def after(self) -> Array:
        """Decays in 1/s of the used modes with the calibrated coefficients, (n_used,)."""
        return self.decays_after[self.matched]

    @cached_property
    def linearised(self) -> Observed:
        """Decays in 1/s linearised in alpha at the last step, with the covariance of their errors."""
        return (self.answer.joint.observed or {})[MODES]

    @property
    def sigma(self) -> Array:
        """Standard deviation of the calibrated coefficients, (n_materials, n_bands), without bounds."""
        return self.answer.posterior_sigma

    @property
    def interval(self) -> tuple[Array, Array]:
        """Ends of the 90 % interval of each coefficient, (n_materials, n_bands) each."""
        low, high = self.answer.interval
        return np.minimum(low, self.alpha), np.maximum(high, self.alpha)

    @property
    def certificate(self) -> Certificate:
        """Residuals of the last step's answer, and a bound of its distance from the optimum."""
        return self.answer.certificate

    @cached_property
    def room(self) -> Room:
        """Room with calibrated coefficients, their standard deviations and a record."""
        data = f"{data_history(self.prior, self.data)} {self.modes.fingerprint}"
        record = replace(self.answer.record, measured=data)
        return self.prior.replace(
            alpha=self.alpha, sigma=np.minimum(self.sigma, 1.0), calibration=record
        )

    @cached_property
    def plausibility(self) -> Plausibility:
        """Agreement of measured decays with the input coefficients, with a score z of each used mode.

        The modelled decays are linear in alpha about the calibrated coefficients. The covariance has
        parts of the input coefficients and of the errors of the decays.
        """
        return plausibility(*self._off, bound_active=False)

    @property
    def _off(self) -> tuple[Array, Array]:
        """Measured less prior decays in 1/s, (n_used,), and their covariance."""
        matrix = self.linearised.matrix
        moved = matrix @ (self.alpha - self.prior.alpha).ravel()
        spread = matrix @ prior_covariance(self.answer.prior) @ matrix.T
        return self.measured - self.after + moved, spread + self.linearised.covariance

    @cached_property
    def sensitivity(self) -> Array:
        """Sensitivity of each used mode's decay to each material, (n_used, n_materials).

        It is the change of the decay divided by its uncertainty, if the material's coefficients change
        by one input sigma in all bands.
        """
        by_sigma = self.linearised.matrix.reshape(-1, *self.prior.alpha.shape) * self.prior.sigma
        own = np.sqrt(np.diag(self.linearised.covariance))
        return np.asarray(np.abs(by_sigma.sum(axis=2)) / own[:, np.newaxis])

    @cached_property
    def reach(self) -> tuple[Array, Array]:
        """Lower and upper frequency in Hz of the modes that determine each band, (n_bands,) each."""
        centres = self.prior.centre_frequencies
        between = np.sqrt(centres[1:] * centres[:-1])
        ends = np.concatenate([[centres[0] / 2], between, [centres[-1] * np.sqrt(2)]])
        return ends[:-1], ends[1:]

    @cached_property
    def carried(self) -> NDArray[np.bool_]:
        """Whether three or more used modes determine a band below the Schroeder frequency."""
        (low, high), f = self.reach, self.modes.frequencies[self.used]
        near = (f >= low[:, np.newaxis]) & (f < high[:, np.newaxis])
        own = near & (f >= self.prior.centre_frequencies[:, np.newaxis] / np.sqrt(2))
        return np.asarray(self.below & (near.sum(axis=1) >= CARRIED) & own.any(axis=1))

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Cautions about bands; a band below the Schroeder frequency has one only if it lacks modes."""
        centres = self.prior.centre_frequencies
        # The QP had no T of these.
        low = self.below & np.isfinite(self.data.reverberation_time)
        marks = [
            m
            for m in self.answer.trust_marks
            if not (m.kind == "missing" and m.frequency in centres[low | self.carried])
        ]
        return (*self.own_marks, *marks, *self.uncarried(low & ~self.carried))

    def uncarried(self, chosen: NDArray[np.bool_]) -> tuple[TrustMark, ...]:
        """Return cautions about chosen bands, (n_bands,), that too few modes determine."""
        ends = zip(self.prior.centre_frequencies, *self.reach, strict=True)
        return tuple(
            mark(
                "below_schroeder",
                float(f),
                "below the Schroeder frequency, and fewer than three of the modes used lie from "
                f"{low:.0f} to {high:.0f} Hz, or none in the band itself",
            )
            for (f, low, high), few in zip(ends, chosen, strict=True)
            if few
        )

    @property
    def own_marks(self) -> tuple[TrustMark, ...]:
        """Cautions about the measured modes."""
        found, (off, covariance) = self.plausibility, self._off
        pulled = np.linalg.solve(covariance, self.before)
        together = float(pulled @ off / (pulled @ self.before))
        z = together * float(np.sqrt(pulled @ self.before))
        if found.p_value is None or (found.p_value >= P_MODES and abs(z) < _FACTOR_Z):
            return ()
        inverse = np.linalg.inv(covariance)
        # Without it Q falls most.
        strangest = int(np.argmax((inverse @ off) ** 2 / np.diag(inverse)))
        f, p = float(self.modes.frequencies[self.used[strangest]]), found.p_value
        text = (
            f"decays of {len(self.used)} modes have Q = {found.q:.1f}, p = {p:.1g}; {f:.1f} Hz "
            f"contributes most; together they are {1 + together:.2g} times as fast as the input "
            f"coefficients make them (z = {z:.1f})"
        )
        return (mark("implausible_modes", None, text),)

    def in_loop(self, measured: Measurement) -> ModesResult:
        """Return the result for `rtcal.calibrate_simulator`, in which it replaces T in the low bands.

        A band is low if it is below the Schroeder frequency, which follows from the T of ``measured``.
        Raises DataError if the modes were calibrated together with T, or if all measured bands are low.
        """
        if np.isfinite(self.data.reverberation_time).any():
            raise DataError(
                "modes is already calibrated to T, and T would count twice. Calibrate the "
                "modes without T: calibrate_modes(room, modes)"
            )
        room = self.prior
        times = times_in_room(room, measured)
        below = below_schroeder(room, times)
        if not np.isfinite(times.reverberation_time[~below]).any():
            raise DataError(
                "every measured band lies below the Schroeder frequency, so no band is left to "
                "simulate: use `rtcal calibrate ROOM MEASURED --modes MODES` "
                "(rt.calibrate_modes) instead"
            )
        return replace(self, below=below)

    @property
    def loop_marks(self) -> tuple[TrustMark, ...]:
        """Cautions about the measured modes, and about low bands that no modes determine."""
        return (*self.own_marks, *self.uncarried(self.below & ~self.carried))

    @property
    def loop_note(self) -> str:
        """Sentences on the room modes that replace the measured T, and on their cautions."""
        said = "No band lies below the Schroeder frequency; the modes are part of the prior."
        if self.below.any():
            low = bands.labels(self.prior.centre_frequencies[self.below])
            said = (
                f"Below the Schroeder frequency ({', '.join(low)}) {len(self.used)} room "
                "modes replace the measured T."
            )
            if without := [bands.label(m.frequency) for m in self.loop_marks if m.frequency]:
                few = ", ".join(without)
                said += f" Fewer than three modes determine {few}: do not use these bands."
        return " ".join([said, *self.doubts])

    @property
    def doubts(self) -> list[str]:
        """Cautions about the assignment of measured to calculated modes."""
        return [note for note in self.notes if note.startswith("Doubtful")]

    def __repr__(self) -> str:
        return (
            f'<ModesResult of "{text.shortened(self.prior.name)}": {len(self.used)} of '
            f"{len(self.modes.frequencies)} measured modes used, {self.steps} steps>"
        )

    def blocks(self) -> list[Block]:
        """Return the tables that the result prints.

        For each used mode they have the frequency in Hz, T measured, before and after in s, and the
        material to which the mode is most sensitive.
        """
        most = self.sensitivity >= (1 - _ALIKE) * self.sensitivity.max(axis=1, keepdims=True)
        shown = zip(self.used, self.measured, self.before, self.after, most, strict=True)
        rows = [
            Row(
                f"{self.modes.frequencies[i]:.1f}",
                [
                    with_uncertainty(DECAY / d, DECAY / d**2 * self.modes.decay_uncertainty[i], 2),
                    f"{DECAY / before:.2f}",
                    f"{DECAY / after:.2f}",
                    ", ".join(self.prior.materials[int(m)] for m in np.flatnonzero(walls)),
                ],
            )
            for i, d, before, after, walls in shown
        ]
        ends = (x[:, self.below] for x in (self.prior.alpha, self.alpha, *self.interval))
        low = [
            Row(
                name,
                [f"{a:.2f} → {b:.2f} ({c:.2f} to {d:.2f})" for a, b, c, d in zip(*of, strict=True)],
            )
            for name, *of in zip(self.prior.materials, *ends, strict=True)
        ]
        said = map(Note, self.every_note)
        columns = bands.labels(self.prior.centre_frequencies[self.below])
        tables = [
            Table(_HEADER[1:], rows, corner=_HEADER[0]),
            Table(
                columns,
                low,
                "Alpha below the Schroeder frequency: input → calibrated (90 % interval)",
            ),
        ]
        return [*said, *tables]

    @property
    def every_note(self) -> list[str]:
        """Notes and cautions about the result."""
        q = self.plausibility
        first = (
            f"{len(self.used)} of {len(self.modes.frequencies)} measured modes determine alpha below "
            "the Schroeder frequency. If the input coefficients and their sigma are right, decays "
            f"deviate from them at least as much as these with a probability of {q.p_value:.2g} "
            f"(chi-square {q.q:.1f})."
        )
        scale = f"The measured mode frequencies are {self.scale:.3f} times the calculated ones."
        return [first, *cautions(self.trust_marks, lettered=False), scale, *self.notes]

    @property
    def each(self) -> list[dict[str, Any]]:
        """Measured and calculated values of each used mode, with decays in 1/s, for JSON."""
        columns = {
            "frequency": self.modes.frequencies[self.used],
            "calculated_frequency": self.frequencies[self.matched],
            "probability": self.probability,
            "decay": self.measured,
            "decay_uncertainty": self.modes.decay_uncertainty[self.used],
            "decay_before": self.before,
            "decay_after": self.after,
            "z": self.plausibility.z,
            "sensitivity": self.sensitivity,
        }
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    @property
    def materials(self) -> list[dict[str, Any]]:
        """Alpha and sigma of each material before and after, with the interval, for JSON."""
        return coefficients(self.prior, self.alpha, self.sigma, self.interval)
