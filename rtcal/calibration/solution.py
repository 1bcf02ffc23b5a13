"""A certified answer, and the numbers and the QP that it belongs to.

`Solution` is the answer over the unknowns, `RawSolution` the solver's own before polishing.
`JointSolution` ties a `Solution` to its rooms and measurements: what `uncertainty` reads.
`rtcal.calibration.result.JointResult` adds what `uncertainty` derives of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from rtcal.acoustics.equations import LinearEquation
from rtcal.calibration import qp, table
from rtcal.calibration.composition import Composition
from rtcal.calibration.feasibility import Unreachable
from rtcal.calibration.measured import MeasuredTimes
from rtcal.calibration.qp import QP, Active, Certificate, Iterate, SolverAnswer
from rtcal.calibration.terms import LinearObservations, Observed, SoftMatch
from rtcal.calibration.unknowns import Configurations, Numbers
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False, repr=False)
class RawSolution:
    """The solver's answer before polishing, to compare solvers.

    ``unknowns`` (size,), ``alpha`` (n_materials, n_bands); ``seconds`` is the time of the solver's
    call; ``settings`` are those that it ran with, beside its defaults.
    """

    unknowns: Array
    alpha: Array
    certificate: Certificate
    status: str
    iterations: int
    seconds: float
    settings: Mapping[str, Any]

    def __repr__(self) -> str:
        return (
            f"<RawSolution: {len(self.unknowns)} unknowns, status {self.status}, "
            f"{self.iterations} iterations>"
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Solution:
    """An answer over the unknowns, and the solver's own.

    Attributes
    ----------
    unknowns : array (size,)
    active : array (size,)
        -1 at the lower bound, 1 at the upper, 0 free.
    target : array (n_configurations, n_bands)
        b in m²; the nearest within reach where the measured T is beyond it.
    point : Iterate
        The answer over the variables of the QP, with its multipliers.
    certificate : Certificate
    raw : SolverAnswer
        The solver's own.
    polished : bool
        Whether the answer is that of the active-set method (from the solver's guess, or from the closed
        form); else the solver's own passed the certificate.
    settings : mapping
        Those that the solver ran with.
    unreachable : tuple of Unreachable
    """

    unknowns: Array
    active: Active
    target: Array
    point: Iterate
    certificate: Certificate
    raw: SolverAnswer
    polished: bool
    settings: Mapping[str, Any]
    unreachable: tuple[Unreachable, ...]

    def __repr__(self) -> str:
        return (
            f"<Solution: {len(self.unknowns)} unknowns, {np.count_nonzero(self.active)} at a bound, "
            f"{self.certificate!r}>"
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointSolution:
    """The calibrated coefficients of all configurations of a room, over one set of unknowns.

    Attributes
    ----------
    configurations : Configurations
    composition : Composition
        The objective, the constraints and the equation.
    solution : Solution
    method, solver : str
        As stated in the call.
    measured_times : tuple of MeasuredTimes
        One per configuration.
    observed : mapping, optional
        The numbers of linear observations.
    versions : mapping of str to str
        Of rtcal, Python and the libraries that made it.
    """

    configurations: Configurations
    composition: Composition
    solution: Solution
    method: str
    solver: str
    measured_times: tuple[MeasuredTimes, ...]
    observed: Mapping[LinearObservations, Observed] | None = None
    versions: Mapping[str, str] = field(default_factory=table.versions)

    @property
    def equation(self) -> LinearEquation:
        """The equation that turned T into b."""
        return self.composition.equation

    @property
    def materials(self) -> tuple[str, ...]:
        """Every material of any configuration."""
        return self.configurations.materials

    @cached_property
    def numbers(self) -> Numbers:
        """The numbers of the solve, with a b beyond reach moved to the nearest within it."""
        return replace(self.numbers_of(self.measured_times), target=self.solution.target)

    def numbers_of(self, measured: Sequence[MeasuredTimes]) -> Numbers:
        """Return the numbers of the same problem for other measurements."""
        return self.composition.numbers(self.configurations, measured, self.observed)

    @cached_property
    def qp(self) -> QP:
        """The QP that was solved."""
        return self.composition.qp(self.numbers)

    @cached_property
    def raw(self) -> RawSolution:
        """The solver's own answer, whose error is bounded by its distance from the final one."""
        answer, final, layout = self.solution.raw, self.solution, self.composition.layout
        u = self.qp.unknowns(self.numbers, answer.point.v)
        certificate = final.certificate
        if final.polished:
            certificate = qp.certify(self.qp, answer.point, 0.0)
            moved = layout.expand(np.abs(u - final.unknowns))
            bound = moved + final.certificate.alpha_error_bound
            certificate = replace(certificate, alpha_error_bound=bound)
        return RawSolution(
            u,
            layout.expand(u),
            certificate,
            answer.status,
            answer.iterations,
            answer.seconds,
            final.settings,
        )

    @cached_property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return self.composition.layout.expand(self.solution.unknowns)

    @cached_property
    def active(self) -> Active:
        """-1 at the lower bound, 1 at the upper, 0 free, (n_materials, n_bands)."""
        layout = self.composition.layout
        return layout.expand(self.solution.active.astype(float)).astype(np.int8)

    @property
    def certificate(self) -> Certificate:
        """Error bounds of the answer: its distance from the optimum."""
        return self.solution.certificate

    @cached_property
    def match_multipliers(self) -> Array:
        """D of the match, (n_configurations, n_bands) in 1/m²; NaN where nothing was matched."""
        matched = np.isfinite(self.solution.target)
        for term, rows in self.composition.rows_of:
            if term in self.composition.matches:
                # An equality, or a lower and an upper limit.
                y = [self.solution.point.y[row] for row in rows]
                values = y[0] if len(y) == 1 else y[1] - y[0]
                return np.where(matched, values.reshape(matched.shape), np.nan)
        return np.full(matched.shape, np.nan)

    @property
    def asks_for_measured_time(self) -> bool:
        """Whether a constraint or a term of weight above 0 ties alpha to the measured T."""
        terms = zip(self.composition.objective.terms, self.composition.weights, strict=True)
        return bool(self.composition.matches) or any(
            isinstance(t, SoftMatch) and w > 0 for t, w in terms
        )

    @cached_property
    def effects(self) -> dict[str, float]:
        """The sizes of the further unknowns, by name."""
        layout = self.composition.layout
        sizes = self.solution.unknowns[layout.n_alpha :]
        return dict(zip(layout.further, sizes.tolist(), strict=True))
