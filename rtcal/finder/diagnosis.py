"""Find what is missing from a model, check it, add it and calibrate the model, in one call."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.files.saved import Result
from rtcal.finder.apply import Corrected
from rtcal.finder.case import AnyCase, PositionsCase
from rtcal.finder.finding import Finding
from rtcal.finder.means.recalibration import Recalibrated, plain, recalibrate
from rtcal.finder.search import find
from rtcal.finder.verification import Verification, verify
from rtcal.loop.positions import PositionsResult, calibrate_positions
from rtcal.support.errors import DataError
from rtcal.support.speed import TaskProgress

if TYPE_CHECKING:
    from rtcal.simulators.path_tracing import PathTracing


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Diagnosis(Result):
    """Hold what is missing from a room's model, its check, and the corrected, calibrated model."""

    record_kind: ClassVar[str] = "diagnosis 1"
    words_in: ClassVar[str] = "rtcal.report.of_diagnosis"
    in_file: ClassVar[str] = "finding verification corrected calibrated"

    finding: Finding
    verification: Verification | None
    """Deviations with and without the effect, at data that were held out; None if no check was
    possible."""
    calibrated: PositionsResult | Recalibrated
    """Model with the added effect, calibrated to all data; the model as given if nothing was added."""
    given: tuple[str, ...] = ("room.toml", "measured.csv")
    """Names of the files that were read, first that of the case or room."""
    options: tuple[str, ...] = ()
    """Options of the command that made the diagnosis, as words of a command line."""

    @cached_property
    def corrected(self) -> Corrected | None:
        """Model with the effect that was found, before it is calibrated; None if nothing was added."""
        return _corrected(self.finding, self.verification)

    @property
    def room(self) -> Room:
        """Calibrated room with the effect that was added."""
        return self.calibrated.room

    def __repr__(self) -> str:
        return f"<Diagnosis of {self.finding!r}>"


def _corrected(finding: Finding, verification: Verification | None) -> Corrected | None:
    """Return the model with what was found; None where `apply` needs a choice, or it was withdrawn."""
    withdrawn = verification is not None and verification.verdict == "withdrawn"
    if not finding.can_be_added or finding.undecided is not None or withdrawn:
        return None
    return finding.apply()


def diagnose(
    room: Room | AnyCase,
    measured: Measurement | None = None,
    simulator: PathTracing | None = None,
    *,
    seeds: Sequence[int] = (0,),
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
    scheduler: str | None = None,
    **options: Any,
) -> Diagnosis:
    """Find the effect that is missing from a model, check it on held-out data, add it, and calibrate.

    The steps are those of `rtcal.find`, `rtcal.finder.verify`, `Finding.apply` and a calibration. If no
    effect is probable enough to be added, or the check fails, the model is calibrated without it.

    Parameters
    ----------
    room : Room, or a case
        Room with its input coefficients, or a case that contains the room and its measurement.
    measured : Measurement, optional
        Measurement of the room; not given with a case.
    simulator, cache, progress, scheduler
        Simulator of the room, and options of the computation: see `rtcal.find`.
    seeds : sequence of int
        Seeds of the simulator's random numbers. At positions, the check is repeated with each seed.
    **options
        Further options of `rtcal.find`.

    Returns
    -------
    Diagnosis
        Finding, its check, and the corrected and calibrated room.

    Raises
    ------
    DataError
        As `rtcal.find` does, and for two states (`StatesCase`), which have no model to correct.

    Examples
    --------
    >>> import rtcal as rt
    >>> case, truth = rt.datasets.hidden_room("identified")
    >>> print(rt.diagnose(case))  # doctest: +SKIP
    """
    of_both: dict[str, Any] = {"cache": cache, "progress": progress, "scheduler": scheduler}
    finding = find(room, measured, simulator, **of_both, **options)
    verification = None
    if finding.can_be_verified:
        at_positions = {"seeds": seeds, **of_both} if finding.kind == "positions" else {}
        verification = verify(finding, **at_positions)
    return diagnosis(finding, verification, seed=options.get("seed", 0), cache=cache)


def diagnosis(
    finding: Finding,
    verification: Verification | None,
    *,
    seed: int = 0,
    cache: str | os.PathLike[str] | None = None,
) -> Diagnosis:
    """Return the diagnosis of a checked finding; the effect is added unless the check withdraws it.

    ``seed`` is that of the random numbers of the calibration at positions.
    """
    if finding.kind == "states":
        raise DataError(
            "a diagnosis compares a model with one measurement, not with two configurations"
        )
    corrected = _corrected(finding, verification)
    if isinstance(finding.case, PositionsCase):
        case = finding.case
        simulator = case.simulator if corrected is None else corrected.simulator()
        calibrated: PositionsResult | Recalibrated = calibrate_positions(
            simulator,
            simulator.room,
            case.measured,
            finding.parameters,
            exclude=case.exclude,
            controls=finding.controls,
            cache=cache,
            position_uncertainty=case.position_uncertainty,
            seed=seed,
        )
    elif corrected is None:
        calibrated = plain(finding.case)
    elif verification is not None and verification.corrected is not None:
        calibrated = verification.corrected
    else:
        calibrated = recalibrate(finding.with_effects(), finding.discrepancy)
    return Diagnosis(finding=finding, verification=verification, calibrated=calibrated)
