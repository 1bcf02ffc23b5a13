"""The result of a calibration to every position, and its printed tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics.change_files import Variant
from rtcal.acoustics.changes import Change
from rtcal.acoustics.observables import LEVEL, observable, parameter_label
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.quality import rms
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.scene import POSITION
from rtcal.calibration.certificate import Certificate
from rtcal.calibration.methods import gain, learned_materials
from rtcal.calibration.result import CalibrationResult
from rtcal.calibration.table import coefficients
from rtcal.loop.control_runs import ControlRuns
from rtcal.loop.matched import Beside, left, sentences
from rtcal.loop.measured_pairs import (
    MeasuredPairs,
    Pair,
    chi_square,
    contradicting,
    relative_misfit,
    rows_of_pairs,
)
from rtcal.loop.positions_prediction import (
    PositionsPrediction,
    Table,
    farther_in_words,
    gap_table,
    material_table,
)
from rtcal.loop.predicted_positions import WANTED, predict_positions
from rtcal.loop.prior_reach import BeyondPrior
from rtcal.loop.scattering import Scattering
from rtcal.simulators.base import Simulator
from rtcal.simulators.observations import Observations
from rtcal.support import text
from rtcal.support.files import json_numbers
from rtcal.support.saved import Result
from rtcal.support.types import Array

KIND = "positions 1"
"""Value of the key ``rtcal`` in a saved result."""
_REFUSED = (
    "No step led nearer to what was measured: the start is returned, and nothing was fitted. State "
    "larger sigmas or more paths, or look for what the room lacks (rtcal find)."
)
_FARTHER = 0.5
"""JND: the noise of a tracing. A larger rise of the mean gap is the calibration's."""


@dataclass(frozen=True, eq=False)
class GaussNewtonStep:
    """A Gauss-Newton step.

    ``alpha`` (n_materials, n_bands) is where the simulator was linearised, ``matrix`` (n_used,
    n_materials * n_bands) are the derivatives there, ``share`` is how much of the way to the
    ``answer`` of the QP was gone.
    """

    alpha: Array
    matrix: Array
    share: float
    answer: CalibrationResult


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsResult(Result):
    """A simulator calibrated to what every position heard.

    Attributes
    ----------
    prior : Room
        The room as it was given.
    room : Room
        With the coefficients for the simulator, their posterior sigma, and a record.
    simulator : str
        Name of the simulator and its scattering. The coefficients belong to no other.
    tracer : Simulator
        The simulator that the coefficients belong to: the one given, with the scattering fitted. Do not
        calibrate it on the same data again: its scattering comes from them.
    weighed : Simulator
        The same with as many paths as were weighed.
    seed : int
    scattering : Scattering or None
        The scattering that was fitted; None where the one stated was kept.
    simulations : int
        Number of all evaluations of the simulator or its derivatives, without control runs.
        `PathTracing` weighs the same traced paths in each.
    measured : MeasuredPairs
        What was matched; its ``observations`` name parameters and pairs.
    beside : Beside
        What was measured and not matched, before and after.
    held_out : Beside or None
        What was measured at the pairs that were excluded, before and after; without the level.
    before, after : Observations
        What the simulator given and its ``tracer`` give, with the prior and with the coefficients
        returned, with as many paths as were weighed.
    predicted : Observations
        What all positions of the simulator hear with the coefficients returned, also those that
        were not measured. Where control runs tell the simulator's error, its mean given what was
        measured is added: what all pairs have in common, such as other scattering.
    controls : ControlRuns or None
        The simulator's error, to be given to a second calibration. None if it is not known.
    unexplained : array (n_parameters,)
        Standard deviation in JND by which each value of a parameter differs from the simulator beyond
        all stated errors, under which what was measured is likeliest.
    innovation, covariance : array (n_used,), (n_used, n_used)
        What was measured less what the simulator hears at ``steps[-1].alpha``, linearly
        extrapolated to the prior; covariance of the errors of measurement and simulator.
    prior_covariance : array (n_materials * n_bands, n_materials * n_bands)
    steps : tuple of Step
    settled : bool
        Whether the last step, before any shortening, changed alpha by less than 0.05 of its prior
        sigma.
    notes : tuple of str
        What was left out, and why.
    start : array (n_materials, n_bands) or None
        The scattering at which the fit started; None of a simulator that has none.
    refused : bool
        Whether no step led nearer to what was measured, so that the room is the one that was given.
    beyond : BeyondPrior or None
        The measured T, where the stated coefficients and their sigma cannot explain it.
    """

    record_kind: ClassVar[str] = KIND

    prior: Room
    room: Room
    simulator: str
    tracer: Simulator
    weighed: Simulator
    seed: int
    scattering: Scattering | None
    simulations: int
    measured: MeasuredPairs
    beside: Beside
    before: Observations
    after: Observations
    predicted: Observations
    controls: ControlRuns | None
    unexplained: Array
    innovation: Array
    covariance: Array
    prior_covariance: Array
    steps: tuple[GaussNewtonStep, ...]
    settled: bool
    notes: tuple[str, ...]
    refused: bool = False
    beyond: BeyondPrior | None = None
    held_out: Beside | None = None
    start: Array | None = None

    def predict(
        self,
        changes: Change | Sequence[Change],
        *,
        wanted: Sequence[str] = WANTED,
        name: str = "",
        assumptions: Assumptions | None = None,
        position_uncertainty: float = POSITION,
    ) -> PositionsPrediction:
        """Predict what every position hears after a change of this room.

        The arguments and errors are those of `rtcal.loop.predicted_positions.predict_positions`, which
        takes several variants at once.
        """
        made = (changes,) if isinstance(changes, Change) else tuple(changes)
        variant = Variant(name or "; ".join(map(str, made)) or "no change", made)
        return predict_positions(
            self,
            [variant],
            wanted=wanted,
            assumptions=assumptions,
            position_uncertainty=position_uncertainty,
        ).predictions[0]

    @property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return self.room.alpha

    @property
    def sigma(self) -> Array:
        """Posterior standard deviation of alpha, (n_materials, n_bands); it does not count bounds."""
        return self.steps[-1].answer.posterior_sigma

    @property
    def certificate(self) -> Certificate:
        """Error bounds of the last step's QP."""
        return self.steps[-1].answer.certificate

    @property
    def interval(self) -> tuple[Array, Array] | None:
        """Ends of the 90 % interval of alpha within [0, 1], each (n_materials, n_bands).

        None if the simulator's error is not known: no control runs.
        """
        if self.controls is None:
            return None
        half = NORMAL_90 * self.sigma
        return np.clip(self.alpha - half, 0, 1), np.clip(self.alpha + half, 0, 1)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters that were matched."""
        return self.measured.observations.parameters

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The pairs that were matched."""
        return self.measured.observations.pairs

    @cached_property
    def gap_before(self) -> Array:
        """Simulated less measured, with the prior, in JND, (n_parameters, n_pairs, n_bands)."""
        return self.measured.gap(self.before)

    @cached_property
    def gap_after(self) -> Array:
        """Simulated less measured, in JND, (n_parameters, n_pairs, n_bands)."""
        return self.measured.gap(self.after)

    @property
    def farther(self) -> tuple[str, ...]:
        """Parameters in which ``tracer`` is farther from what was measured than the simulator given.

        Of what was matched, the root mean square gap over pairs and bands is larger by over half a JND.
        Of what was not, that over the pairs is larger by over a JND in some band.
        """
        return (*(name for name, _, _ in self._farther_matched), *left(self.beside.gaps))

    @property
    def _farther_matched(self) -> list[tuple[str, float, float]]:
        """Those of them that were matched, with the gap before and after."""
        ends = (rms(gap, axis=(1, 2)) for gap in (self.gap_before, self.gap_after))
        every = zip(self.parameters, *ends, strict=True)
        return [(name, old, new) for name, old, new in every if new > old + _FARTHER]

    @property
    def shift(self) -> Array:
        """Change of alpha, in prior sigmas, (n_materials, n_bands); 0 where sigma is 0."""
        sigma = np.where(self.prior.sigma > 0, self.prior.sigma, np.inf)
        return np.asarray((self.alpha - self.prior.alpha) / sigma)

    @cached_property
    def pulls(self) -> Array:
        """Change of each coefficient by each pair, in prior sigmas, (n_pairs, n_materials, n_bands).

        Of the linear estimate without bounds: the sum over the pairs is its whole shift.
        """
        of_values = gain(self.prior_covariance, self.steps[-1].matrix, self.covariance)
        sigma = np.where(self.prior.sigma > 0, self.prior.sigma, np.inf).ravel()
        shape = self.prior.alpha.shape
        return np.stack(
            [
                (of_values[:, rows] @ self.innovation[rows] / sigma).reshape(shape)
                for rows in rows_of_pairs(self.measured.used)
            ]
        )

    @cached_property
    def misfit(self) -> Array:
        """Misfit of each pair with what all others let expect, (n_pairs,): 1 is usual.

        chi-square over its degrees of freedom, relative to the upper quartile over the pairs where that
        is above 1. What the simulator misses differs between pairs; up to a quarter may be wrong.
        """
        return relative_misfit(*self._chi_square)

    @property
    def contradictions(self) -> tuple[Pair, ...]:
        """Pairs that contradict all others. Check their positions and names, or ``exclude`` them."""
        return tuple(self.pairs[i] for i in contradicting(self.misfit, self._chi_square[1]))

    @cached_property
    def _chi_square(self) -> tuple[Array, Array]:
        matrix = self.steps[-1].matrix
        # One wrong pair makes the unexplained error larger, and would then be explained by it.
        deviation = self.measured.in_values(self.unexplained)
        stated = self.covariance - np.diag(deviation**2)
        expected = matrix @ self.prior_covariance @ matrix.T + stated
        return chi_square(self.innovation, expected, rows_of_pairs(self.measured.used))

    @cached_property
    def learned(self) -> tuple[tuple[str, float, float], ...]:
        """Materials with prior and posterior sigma (rms over bands), most learned first."""
        return learned_materials(self.prior, self.sigma)

    def __repr__(self) -> str:
        return f"<{self._description}>"

    @property
    def _description(self) -> str:
        return (
            f'PositionsResult of "{text.shortened(self.simulator)}": {len(self.pairs)} pairs, '
            f"{', '.join(map(parameter_label, self.parameters))}, {len(self.steps)} steps"
        )

    def __str__(self) -> str:
        lines = [*text.wrapped(self.warning, hanging="    "), ""] if self.warning else []
        lines.append(f"Coefficients only for {self.simulator}")
        tables = [gap_table(self.parameters, self.pairs, self.gap_before, self.gap_after)]
        if more := self.beside.parameters:
            ends = self.beside.gap_before, self.beside.gap_after
            tables.append(gap_table(more, self.pairs, *ends, title="not matched: gap / JND"))
        for header, rows in (*tables, self._material_table()):
            lines += [
                "",
                *text.table([(r[0], r[1:]) for r in rows], header=(header[0], header[1:])),
            ]
        lines.append("")
        for note in self.every_note[bool(self.warning) :]:  # the warning leads
            lines += text.wrapped(note, hanging="    ")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Return the table of the materials, darker where more was learned."""
        header, rows = self._material_table()
        cells: list[list[str | text.Cell]] = [[*row] for row in rows]
        for row, (_, before, after) in zip(cells, self.learned, strict=True):
            share = 1 - after / before if before > 0 else 0.0
            row[2] = text.Cell(str(row[2]), float(np.clip(share, 0, 1)))
        return text.html_table(self._description, header, cells, self.every_note)

    def _material_table(self) -> Table:
        return material_table(
            self.prior, self.learned, self.shift, self.pulls, self.pairs, self.scattering
        )

    @property
    def warning(self) -> str:
        """Sentences that stand first: start returned, T beyond the prior, gap grown; "" if none."""
        farther = self._farther_matched
        return " ".join(
            [
                *([_REFUSED] if self.refused else []),
                *([str(self.beyond)] if self.beyond else []),
                *(
                    [farther_in_words(farther, fitted=self.scattering is not None)]
                    if farther
                    else []
                ),
            ]
        )

    @property
    def every_note(self) -> list[str]:
        """The ``notes``, and what the result says against itself."""
        notes = list(self.notes)
        notes[:0] = sentences(self.beside.gaps, self.prior.centre_frequencies)
        if self.warning:
            notes.insert(0, self.warning)
        if LEVEL.key in self.parameters:
            notes.append(
                "Level: absolute, G of a calibrated source."
                if self.measured.level == "absolute"
                else "Level: relative between the positions of a source. The measured one is shown "
                "with the mean of the simulated one."
            )
        if self.scattering is not None:
            notes += self.scattering.notes(self.prior.materials)
        if self.controls is None:
            notes.append(
                "No interval: no control run tells this simulator's error. It is assumed to be 5 % of "
                "a time and 0.5 dB of a level."
            )
        if unexplained := self.unexplained_in_words:
            notes.append(
                "Simulator and prior miss what was measured by more than their errors let expect. A "
                f"value differs by a further {unexplained} (standard deviation)."
            )
        for pair in self.contradictions:
            notes.append(
                f"{' to '.join(pair)} contradicts all other pairs: check its names and positions, or "
                "leave it out (exclude)."
            )
        if not self.settled:
            notes.append(
                "Not settled: the last step moved alpha, or was refused. Calibrate with more paths."
            )
        return notes

    @property
    def unexplained_in_words(self) -> str:
        """The unexplained errors of half a JND and more, by parameter; "" without any."""
        return ", ".join(
            f"{of:.1f} JND of {parameter_label(p)}"
            for p, of in zip(self.parameters, self.unexplained, strict=True)
            if of >= _FARTHER
        )

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, lists and text; None where a value is missing."""
        entries = coefficients(self.prior, self.alpha, self.sigma, self.interval)
        return {
            "rtcal": KIND,
            "room": self.prior.name,
            "author": self.prior.author,
            "simulator": self.simulator,
            "simulations": self.simulations,
            "scattering": self.scattering and self.scattering.to_dict(),
            "centre_frequencies": json_numbers(self.prior.centre_frequencies),
            "parameters": list(self.parameters),
            "units": [observable(p).unit for p in self.parameters],
            "level": self.measured.level,
            "pairs": [list(pair) for pair in self.pairs],
            "measured": [json_numbers(v) for v in self._natural(self.measured.observations)],
            "before": [json_numbers(v) for v in self._natural(self.before)],
            "after": [json_numbers(v) for v in self._natural(self.after)],
            "gap_before_jnd": json_numbers(self.gap_before),
            "gap_after_jnd": json_numbers(self.gap_after),
            "not_matched": {
                "parameters": list(self.beside.parameters),
                "gap_before_jnd": json_numbers(self.beside.gap_before),
                "gap_after_jnd": json_numbers(self.beside.gap_after),
            },
            "held_out": self.held_out
            and {
                "parameters": list(self.held_out.parameters),
                "pairs": [list(pair) for pair in self.held_out.measured.pairs],
                "gap_before_jnd": json_numbers(self.held_out.gap_before),
                "gap_after_jnd": json_numbers(self.held_out.gap_after),
            },
            "materials": [
                {
                    "name": entry["name"],
                    "area": float(self.prior.areas[i]),
                    **entry,
                    "pulls": json_numbers(self.pulls[:, i]),
                }
                for i, entry in enumerate(entries)
            ],
            "misfit": json_numbers(self.misfit),
            "contradictions": [list(pair) for pair in self.contradictions],
            "control_runs": 0 if self.controls is None else len(self.controls.errors),
            "unexplained_jnd": json_numbers(self.unexplained),
            "refused": self.refused,
            "beyond_prior": self.beyond and vars(self.beyond),
            "steps": [step.share for step in self.steps],
            "settled": self.settled,
            "worst_certificate": self.certificate.worst,
            "notes": self.every_note,
        }

    def _natural(self, heard: Observations) -> list[Array]:
        return [heard.natural(p) for p in self.parameters]
