"""The options of one solve: the solver, its start, and the handling of an unreachable T."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypedDict

from rtcal.errors import DataError, ModelError

Unreachable = Literal["raise", "nearest"]
WarmStart = Literal["auto", "closed_form", "none"]

STARTED = ("osqp", "qpsolvers:osqp", "qpsolvers:daqp", "qpsolvers:proxqp", "qpsolvers:scs")
"""Solvers that take a start."""


class SolveKeywords(TypedDict, total=False):
    """The keyword arguments of `SolveOptions`, for the functions that pass them on."""

    solver: str
    unreachable: Unreachable
    warm_start: WarmStart
    settings: Mapping[str, Any] | None


@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """The options of one solve.

    Parameters
    ----------
    solver : str
        ``"clarabel"``, ``"osqp"``, another solver of cvxpy's, or ``"qpsolvers:NAME"``.
    unreachable : {"raise", "nearest"}
        What to do where no coefficients within the bounds give the measured T. ``"raise"`` raises
        InfeasibleError; ``"nearest"`` takes the nearest T within reach and lists the band in the
        result.
    warm_start : {"auto", "closed_form", "none"}
        ``"auto"`` starts a solver that takes a start from the paper's closed form, if the problem has
        one. ``"closed_form"`` raises ModelError where that cannot be. Clarabel takes no start.
    settings : mapping, optional
        The solver's own settings by name, beside rtcal's; ``{}`` for rtcal's alone. Without it,
        Clarabel may run with looser ones first; ``result.raw.settings`` says with which.

    Raises
    ------
    DataError, ModelError
        For a value that is not allowed.
    """

    solver: str = "clarabel"
    unreachable: Unreachable = "raise"
    warm_start: WarmStart = "auto"
    settings: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.solver, str):
            raise ModelError(f'solver = {self.solver!r} is not a name such as "clarabel"')
        if self.unreachable not in ("raise", "nearest"):
            raise DataError(f'unreachable = "{self.unreachable}" is not "raise" or "nearest"')
        if self.warm_start not in ("auto", "closed_form", "none"):
            raise ModelError(
                f'warm_start = {self.warm_start!r} is not "auto", "closed_form" or "none"'
            )
        if not isinstance(self.settings, Mapping | None):
            raise ModelError(f"settings = {self.settings!r} is not a mapping of name to value")
        for key in self.settings or {}:
            if not isinstance(key, str):
                raise ModelError(f"settings has {key!r}, which is no setting's name")
        if self.warm_start == "closed_form" and not self.takes_start:
            raise ModelError(f'solver "{self.solver}" takes no warm start; {", ".join(STARTED)} do')

    @property
    def takes_start(self) -> bool:
        """Whether the solver takes a start."""
        return self.solver.lower() in STARTED
