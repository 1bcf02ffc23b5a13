"""The result of a calibration to every position: what was fitted, what was learned, and its doubts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.stats import chi2

from rtcal.acoustics.changes import Change, Variant
from rtcal.acoustics.marks import rms
from rtcal.acoustics.observables import LEVEL, parameter_label
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.scene import POSITION
from rtcal.calibration.fit import GaussNewtonStep
from rtcal.calibration.qp import Certificate
from rtcal.calibration.table import coefficients
from rtcal.files.saved import Result
from rtcal.loop.control_runs import ControlRuns, Scattering
from rtcal.loop.measured_pairs import (
    CONTRADICTION,
    BeyondPrior,
    Compared,
    MeasuredPairs,
    Pair,
    left,
    rows_of_pairs,
    sentences,
)
from rtcal.loop.predicted import WANTED, PositionsPrediction, predict_positions
from rtcal.simulators.base import Observations, Simulator
from rtcal.support import text
from rtcal.support.blocks import Block, Note, Row, Table, lines, notebook
from rtcal.support.types import Array


def gap_table(
    parameters: Sequence[str],
    pairs: Sequence[Pair],
    before: Array,
    after: Array,
    title: str = "rms gap / JND",
    misfit: Array | None = None,
) -> Table:
    """Return the rms gap before and after by parameter, of each pair and of all.

    Gaps are (n_parameters, n_pairs, n_bands) in JND; ``misfit`` (n_pairs,) has a column of its own.
    """
    columns = [parameter_label(p) for p in parameters]
    own: list[list[str]] = [[]] * (len(pairs) + 1)
    if misfit is not None:
        columns, own = [*columns, "misfit"], [[m] for m in (*text.numbers(misfit, ".1f"), "-")]
    rows = []
    for i, more in enumerate(own):
        name, chosen = ("all", slice(None)) if i == len(pairs) else (" to ".join(pairs[i]), [i])
        ends = zip(*(rms(gap[:, chosen], axis=(1, 2)) for gap in (before, after)), strict=True)
        rows.append(Row(name, [*(" to ".join(text.numbers(e, ".1f")) for e in ends), *more]))
    return Table(columns, rows, corner=title)


_REFUSED = (
    "No step led nearer to what was measured: the start is returned, and nothing was fitted. State "
    "larger sigmas or more paths, or look for what the room lacks (rtcal find)."
)
_MISFIT = 2.0
"""Misfit from which a pair is named: twice the chi-square that is usual in this room."""
_FARTHER = 0.5
"""JND: the noise of a tracing. A larger rise of the mean gap is the calibration's."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsResult(Result):
    """A simulator calibrated to the values at every position.

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
    beside : Compared
        What was measured and not matched, before and after.
    held_out : Compared or None
        What was measured at the pairs that were excluded, before and after; without the level.
    before, after : Observations
        What the simulator given and its ``tracer`` give, with the prior and with the coefficients
        returned, with as many paths as were weighed.
    predicted : Observations
        The values at all positions of the simulator with the coefficients returned, also those that
        were not measured. Where control runs tell the simulator's error, its mean given what was
        measured is added: what all pairs have in common, such as other scattering.
    controls : ControlRuns or None
        The simulator's error, to be given to a second calibration. None if it is not known.
    unexplained : array (n_parameters,)
        Standard deviation in JND by which each value of a parameter differs from the simulator beyond
        all stated errors, under which what was measured is likeliest.
    innovation, covariance : array (n_used,), (n_used, n_used)
        What was measured less the simulated values at ``steps[-1].alpha``, linearly
        extrapolated to the prior; covariance of the errors of measurement and simulator.
    prior_covariance : array (n_materials * n_bands, n_materials * n_bands)
    steps : tuple of GaussNewtonStep
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

    record_kind: ClassVar[str] = "positions 1"
    numbers: ClassVar[str] = (
        "room=prior.name author=prior.author simulator simulations scattering "
        "centre_frequencies=prior.centre_frequencies parameters pairs level=measured.level matched "
        "not_matched=beside held_out materials pulls misfit contradictions "
        "unexplained_jnd=unexplained refused beyond_prior=beyond settled "
        "worst_certificate=certificate.worst notes=every_note"
    )

    prior: Room
    room: Room
    simulator: str
    tracer: Simulator
    weighed: Simulator
    seed: int
    scattering: Scattering | None
    simulations: int
    measured: MeasuredPairs
    beside: Compared
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
    held_out: Compared | None = None
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
        """Predict the values at every position after a change of this room.

        The arguments and errors are those of `rtcal.loop.positions_result.predict_positions`, which
        takes several variants at once.
        """
        made = (changes,) if isinstance(changes, Change) else tuple(changes)
        variant = Variant(name or "; ".join(map(str, made)) or "no change", made)
        predicted: PositionsPrediction = predict_positions(
            self,
            [variant],
            wanted=wanted,
            assumptions=assumptions,
            position_uncertainty=position_uncertainty,
        ).predictions[0]
        return predicted

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

    @property
    def matched(self) -> Compared:
        """What was matched: measured, before and after."""
        return Compared(
            measured=self.measured.observations,
            before=self.before,
            after=self.after,
            relative=self.measured.level == "relative",
        )

    @cached_property
    def gap_before(self) -> Array:
        """Simulated less measured, with the prior, in JND, (n_parameters, n_pairs, n_bands)."""
        return self.matched.gap_before

    @cached_property
    def gap_after(self) -> Array:
        """Simulated less measured, in JND, (n_parameters, n_pairs, n_bands)."""
        return self.matched.gap_after

    @property
    def materials(self) -> list[dict[str, Any]]:
        """Alpha and sigma before and after, with the interval, of each material."""
        return coefficients(self.prior, self.alpha, self.sigma, self.interval)

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

        Of the linear estimate without bounds: the sum over the pairs is its whole shift. The change by
        the values is K J' (J K J' + C)⁻¹, with K the prior's covariance, J their derivatives and C that
        of their errors (Tarantola 2005, Inverse Problem Theory, Sect. 3.2).
        """
        matrix = self.steps[-1].matrix
        across, n = self.prior_covariance @ matrix.T, len(matrix)
        of_values = across @ np.linalg.solve(matrix @ across + self.covariance, np.eye(n))
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
        square, degrees = self._chi_square
        ratio = square / degrees
        return np.asarray(ratio / max(1.0, float(np.quantile(ratio, 0.75, method="lower"))))

    @property
    def contradictions(self) -> tuple[Pair, ...]:
        """Pairs that contradict all others. Check their positions and names, or ``exclude`` them."""
        degrees = self._chi_square[1]
        chance = chi2.sf(self.misfit * degrees, degrees)
        worst_first = np.argsort(-self.misfit).tolist()
        return tuple(self.pairs[i] for i in worst_first if chance[i] < CONTRADICTION / len(chance))

    @cached_property
    def _chi_square(self) -> tuple[Array, Array]:
        """The chi-square of each pair given all others, and its degrees of freedom, (n_pairs,)."""
        matrix = self.steps[-1].matrix
        # One wrong pair makes the unexplained error larger, and would then be explained by it.
        deviation = self.measured.in_values(self.unexplained)
        stated = self.covariance - np.diag(deviation**2)
        expected = matrix @ self.prior_covariance @ matrix.T + stated
        precision, rows = np.linalg.inv(expected), rows_of_pairs(self.measured.used)
        pull = precision @ self.innovation
        values = [float(pull[r] @ np.linalg.solve(precision[np.ix_(r, r)], pull[r])) for r in rows]
        return np.array(values), np.array([max(len(r), 1) for r in rows])

    @cached_property
    def learned(self) -> tuple[tuple[str, float, float], ...]:
        """Materials with prior and posterior sigma (rms over bands), most learned first."""
        before, after = (rms(s, axis=1) for s in (self.prior.sigma, self.sigma))
        share = np.divide(after, before, out=np.ones_like(after), where=before > 0)
        return tuple(
            (self.prior.materials[i], float(before[i]), float(after[i]))
            for i in np.argsort(share, kind="stable")
        )

    def __repr__(self) -> str:
        return f"<{self._description}>"

    @property
    def _description(self) -> str:
        return (
            f'PositionsResult of "{text.shortened(self.simulator)}": {len(self.pairs)} pairs, '
            f"{', '.join(map(parameter_label, self.parameters))}, {len(self.steps)} steps"
        )

    def __str__(self) -> str:
        return "\n".join(lines(self.blocks()))

    def _repr_html_(self) -> str:
        """Return the tables; that of the materials is darker where more was learned."""
        return notebook(self._description, self.blocks()[bool(self.warning) :])

    def blocks(self) -> list[Block]:
        """Return what the calibration says."""
        ends = self.beside.gap_before, self.beside.gap_after
        more = self.beside.parameters
        return [
            *([Note(self.warning, hanging="    "), Note("")] if self.warning else []),
            Note(f"Coefficients only for {self.simulator}"),
            gap_table(
                self.parameters, self.pairs, self.gap_before, self.gap_after, misfit=self.misfit
            ),
            *([gap_table(more, self.pairs, *ends, "not matched: gap / JND")] if more else []),
            self._material_table(),
            *(Note(note, hanging="    ") for note in self.every_note[bool(self.warning) :]),
        ]

    def _material_table(self) -> Table:
        """Return what was learned of each material, most first, shaded by how much."""
        columns = ["sigma before", "after", "shift / sigma", "pulled most by"]
        strength = np.abs(self.pulls).mean(axis=2)
        moved = np.sqrt((self.shift**2).mean(axis=1))
        rows = []
        for name, before, after in self.learned:
            i = self.prior.material_index(name)
            pair = "-"
            if strength[:, i].any():
                pair = " to ".join(self.pairs[int(np.argmax(strength[:, i]))])
            cells = [f"{before:.3f}", f"{after:.3f}", f"{moved[i]:.1f}", pair]
            if (fitted := self.scattering) is not None:
                s, sigma = (a[i].mean() for a in (fitted.coefficients, fitted.sigma))
                cells.append(f"{s:.2f} ± {sigma:.2f}")
            share = max(1 - after / before, 0.0) if before > 0 else 0.0
            rows.append(Row(name, cells, shade=[0.0, share, *[0.0] * (len(cells) - 2)]))
        return Table(columns + ["scattering"] * (self.scattering is not None), rows)

    @property
    def warning(self) -> str:
        """Sentences that stand first: start returned, T beyond the prior, gap grown; "" if none."""
        said = [_REFUSED] if self.refused else []
        if self.beyond:
            said.append(str(self.beyond))
        if farther := self._farther_matched:
            names = ", ".join(
                f"{parameter_label(p)} ({old:.1f} to {new:.1f} JND)" for p, old, new in farther
            )
            said.append(
                f"In {names} the calibrated simulator is farther from what was measured than before: "
                "do not simulate with it."
            )
            start = "The"
            if self.scattering is not None:
                start = (
                    "The fitted scattering may have ended at a poor fit: try another seed, or state "
                    "other scattering. Else the"
                )
            said.append(f"{start} model misses something, or a constraint keeps alpha away.")
        return " ".join(said)

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
        doubts = [f"{row.name}: {' '.join(row.values)}" for row in self.doubts]
        return notes + doubts

    @property
    def doubts(self) -> list[Row]:
        """Reservations: what, where, and what to do."""
        odd = [
            f"{' to '.join(pair)} ({misfit:.1f})"
            for pair, misfit in zip(self.pairs, self.misfit, strict=True)
            if misfit > _MISFIT and pair not in self.contradictions
        ]
        bound = [
            f"{self.prior.materials[i]} at {self.prior.centre_frequencies[k]:g} Hz"
            for i, k in np.argwhere((self.alpha <= 0) | (self.alpha >= 1))
        ]
        unexplained = ", ".join(
            f"{of:.1f} JND of {parameter_label(p)}"
            for p, of in zip(self.parameters, self.unexplained, strict=True)
            if of >= _FARTHER
        )
        found = [
            (
                "Contradicts all other pairs",
                ", ".join(" to ".join(pair) for pair in self.contradictions),
                "Check names and positions, or leave it out (exclude).",
            ),
            ("Fits the others badly", ", ".join(odd), "1 is usual. Look at the decays there."),
            (
                "Misses more than expected",
                unexplained and f"A value differs by a further {unexplained} (standard deviation).",
                "Check volume, mesh and stated sigma. Something may be missing in the room.",
            ),
            (
                "No interval",
                "" if self.controls else "No control run tells this simulator's error.",
                "It is assumed to be 5 % of a time and 0.5 dB of a level. Use one with a geometry.",
            ),
            (
                "Coefficient at a bound",
                text.first_of(bound, 5),
                "That is a warning and no result. State a smaller sigma or a floor.",
            ),
            (
                "Not settled",
                "" if self.settled else "The last step moved alpha, or was refused.",
                "Calibrate again with more paths.",
            ),
        ]
        return [Row(title, [where, advice]) for title, where, advice in found if where]
