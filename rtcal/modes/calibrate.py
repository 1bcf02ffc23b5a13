"""Calibrate a room to the decays of its modes: Gauss-Newton steps that are each a QP.

    minimise ½ (d - D(alpha))' C⁻¹ (d - D(alpha)) + the prior
    subject to T matched above the Schroeder frequency,

with d the measured decays and D those of the room's poles (`rtcal.modes.room_modes`), which are
linearised at the last answer. Below the Schroeder frequency no field is diffuse, and T is not used:
there it is some 1.3 times an equation's, since modes along walls decay slowly. C is the sum
of what was measured, of the model, and of what admittance does between the bands (`rtcal.modes.model`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import band_conversion, repeats
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.acoustics.trust import mid_frequency_time, schroeder_frequency
from rtcal.calibration.nonlinear import gauss_newton
from rtcal.calibration.presets import preset
from rtcal.calibration.problem import Calibration, CalibrationProblem, Times
from rtcal.calibration.problem_data import MeasuredTimes, no_times, times_in_room
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.terms import LinearObservations, Observed, as_objective
from rtcal.io.sofa import Responses
from rtcal.modes.measured import Matches, MeasuredModes, match
from rtcal.modes.model import ABOVE, RoomPoles
from rtcal.modes.responses import modes_in
from rtcal.modes.result import ModesResult
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.types import Array

MODES = LinearObservations("modes")

MODEL_ERROR = 0.05
"""Relative standard deviation of a calculated decay: geometry, admittance that varies over a wall.
Beside it stands delta / omega."""
_STEPS = 5
_SETTLED = 0.1
"""Share of a decay's uncertainty by which the linearised decay may be off the model's own."""


@checked
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
    if isinstance(modes, Responses):
        modes = modes_in(room, modes, geometry)
    model = RoomPoles.of(room, max(ABOVE * modes.frequencies[-1], modes.largest), geometry)
    known = modes.calculated
    if known is not None and len(known) and known.max() >= model.modes.wanted:
        raise DataError(
            f"calculated has mode {known.max()}; the room has {model.modes.wanted} modes"
        )
    every = model.calculated
    found = match(modes, every.frequencies, every.decays)
    times = no_times(room) if measured is None else times_in_room(room, measured)
    of_modes = repeats.of_modes(modes.frequencies, modes.decays)
    repeats.refuse_repeated_data(room, of_modes, *times.fingerprint.split())
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
        notes=_notes(modes, found, path.settled),
    )


@dataclass(frozen=True, eq=False)
class _Linearised:
    """The decays, linearised at ``alpha``, beside those measured; T above the Schroeder frequency.

    ``covariance`` is that of measured less modelled decays in 1/s², with the prior's slopes.
    """

    problem: CalibrationProblem
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


def _notes(modes: MeasuredModes, found: Matches, settled: bool) -> tuple[str, ...]:
    notes = [*modes.notes, *found.doubts]
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
