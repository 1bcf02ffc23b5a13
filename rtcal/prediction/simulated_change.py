"""What a program gave before and after a change: its ratio of T in place of the equation's.

The program's ratio is that of its own room. Where the real room has another T before, it has another
absorption, with which the same change has another ratio: by the equation, at the evenness u of the
field at which it has the program's ratio. Where both have the same T before, T after is the program's.

What the ratio errs by: the coefficients of the change and of what stays; the field, since the program
knows of it no more than its scattering, so that u has its usual spread about the program's; a share of
the change, as between two measured states; and the noise that both runs state. Nothing changed has none
of these errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.acoustics.run import Run
from rtcal.prediction import words
from rtcal.prediction.changed_time import DRAWS, TimeChange, normal_of
from rtcal.support import checks
from rtcal.support.errors import DataError, RtcalError
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class SimulatedChange:
    """Hold T in s that a program simulated before and after a change, (n_bands,) each.

    T is NaN in a band in which one of the two runs has none. ``log_uncertainty`` (n_bands,) is the
    program's standard uncertainty of ln(T after / T before), 0 if it gives none.
    """

    before: Array
    after: Array
    log_uncertainty: Array

    @classmethod
    def of(cls, room: Room, run: Run, after: Measurement) -> SimulatedChange:
        """Return the T that both runs of a program have: T20, or else T30, as means over common pairs.

        ``run`` is before the change, ``after`` after it. Raises DataError if ``run`` is of another room
        than ``room``, and if the runs share no T.
        """
        checks.instance("run", run, Run).refuse_other(room)
        checks.instance("run after the change", after, Measurement)
        try:
            both = run.beside(after)
            runs = both.run, both.measured
            times = [of.reverberation_time for of in runs]
            if not np.isfinite(times).any():
                raise run.nothing_common(after, "T20 or T30")
        except DataError as error:
            raise DataError(f"simulation after the change: {error}") from error
        relative = [
            of.reverberation_time_uncertainty / t for of, t in zip(runs, times, strict=True)
        ]
        stated = [
            np.where([p in of.uncertainty for p in of.reverberation_parameter], u, 0.0)
            for of, u in zip(runs, relative, strict=True)
        ]
        return cls(times[0], times[1], np.hypot(*np.nan_to_num(stated)))

    @property
    def log_ratio(self) -> Array:
        """Natural logarithm of T after over T before by the program, (n_bands,)."""
        return np.asarray(np.log(self.after / self.before))

    def draws(self, change: TimeChange) -> Array:
        """Return random values of ln(T after / measured T before), (n_bands, n_draws).

        Raises DataError if no coefficients give T before the change in a band.
        """
        assumed, unknowns = change.assumptions, change.unknowns
        of_program = self._reference(change)
        at_ends = [_central(change, of_program, np.full(len(self.before), u)) for u in _KNOTS]
        evenness = _evenness(np.array(at_ends), self.log_ratio)
        real = _central(change, change.known_alpha.alpha, evenness)
        moved = self.log_ratio + real - _central(change, of_program, evenness)
        at = replace(
            unknowns,
            factor=np.zeros_like(unknowns.factor),
            evenness=np.broadcast_to(evenness[:, np.newaxis], unknowns.evenness.shape),
        )
        drawn = change.log_time(1, at) - change.log_time(0, at)
        sigma = np.linalg.norm(
            [
                assumed.own * self.log_ratio,
                assumed.evenness_sigma * (at_ends[1] - at_ends[0]),
                self.log_uncertainty,
            ],
            axis=0,
        )
        own = sigma[:, np.newaxis] * normal_of(words.PROGRAM, DRAWS)
        return np.asarray(moved[:, np.newaxis] + drawn - drawn.mean(axis=1, keepdims=True) + own)

    def _reference(self, change: TimeChange) -> Array:
        """Return alpha of the program's room: the equation's T is the program's before the change.

        (n_bands, n_materials, 1). All of the room's materials are so many times the calibrated ones;
        those that it does not have before are as stated.
        """
        known, room = change.known, change.known.room
        try:
            area = known.equation.absorption_area(room, self.before)
        except RtcalError as error:
            raise DataError(f"simulation before the change: {error}") from error
        own = known.equation.absorption_area(room, known.time)
        alpha = np.array(change.known_alpha.alpha)
        for i, name in enumerate(change.materials):
            if name in room.materials:
                alpha[:, i, 0] *= area / own
            elif name in change.after.materials:
                alpha[:, i, 0] = change.after.alpha[change.after.materials.index(name)]
        return alpha


_KNOTS = (0.0, 1.0, 2.0)
"""Values of u between which ln T is linear in it."""


def _central(change: TimeChange, alpha: Array, evenness: Array) -> Array:
    """Return ln (T after / T before) of some coefficients at u, (n_bands,), without any error."""
    alone = change.unknowns.alone
    u = np.broadcast_to(evenness[:, np.newaxis], alone.shape)
    at = replace(change.known_alpha, alpha=alpha, evenness=u, alone=alone)
    return np.asarray((change.log_time(1, at) - change.log_time(0, at)).mean(axis=1))


def _evenness(at_knots: Array, wanted: Array) -> Array:
    """Return u, (n_bands,), at which a ratio, (3, n_bands) at `_KNOTS`, is nearest to another."""
    best, least = np.zeros_like(wanted), np.full_like(wanted, np.inf)
    for i in range(len(_KNOTS) - 1):
        low, rise = at_knots[i], at_knots[i + 1] - at_knots[i]
        share = np.clip((wanted - low) / np.where(rise == 0, 1.0, rise), 0.0, 1.0)
        off = np.abs(low + share * rise - wanted)
        better = off < least
        best, least = np.where(better, _KNOTS[i] + share, best), np.where(better, off, least)
    return best
