"""The calibrated coefficients of a case, with or without the effects that were added to its model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.calibration.problem_data import data_history, times_in_room
from rtcal.calibration.result import JointResult
from rtcal.finder.case import Case
from rtcal.finder.effects.checks import AppliedEffect
from rtcal.finder.finding import amount
from rtcal.finder.means.corrected import corrected_room
from rtcal.support import text
from rtcal.support.lazy import __version__
from rtcal.support.results import Result
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False, repr=False)
class Recalibrated(Result):
    """The calibrated coefficients of a case, and the model's prediction with them.

    Attributes
    ----------
    case : Case
        With the effects' sizes as calibrated.
    alpha : array (n_materials, n_bands)
        The room's coefficients; those that a configuration changes are in ``changed``.
    changed : mapping of (configuration, material) to array (n_bands,)
    sizes : mapping of str to float
        Sizes of the effects that have one, in the effect's unit.
    features : array (n_configurations, n_features, n_bands)
        Predicted: ln T20, ln EDT/T20, ln T30/T20, C80 and G in dB, the model's bias left out.
    off : float
        Root mean square of the fitted ln T less the measured one, over its standard deviation.
    joint : JointResult
        The QP's answer, in which a configuration's changed materials have names of their own.
    """

    record_kind: ClassVar[str] = "recalibration 1"

    case: Case
    alpha: Array
    changed: Mapping[tuple[str, str], Array]
    sizes: Mapping[str, float]
    features: Array
    off: float
    joint: JointResult

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of alpha, (n_materials, n_bands): the QP's `posterior_sigma`.

        It holds if the effects in the model are right, with their parameters. Only the sizes that are
        unknowns of the QP contribute their uncertainty.
        """
        by_name = dict(zip(self.joint.materials, self.joint.posterior_sigma, strict=True))
        room = self.case.room
        return np.array([by_name.get(m, room.sigma[i]) for i, m in enumerate(room.materials)])

    @property
    def interval(self) -> tuple[Array, Array]:
        """Ends of alpha's 90 % interval, each (n_materials, n_bands): alpha ± 1.645 sigma in 0 to 1."""
        spread = NORMAL_90 * self.sigma
        return np.clip(self.alpha - spread, 0, 1), np.clip(self.alpha + spread, 0, 1)

    @cached_property
    def room(self) -> Room:
        """`corrected_room` with the calibrated coefficients, their sigma, and the record of it."""
        stated = self.case.room
        data = [times_in_room(stated, c.measured) for c in self.case.configurations]
        calibrated = stated.replace(
            alpha=self.alpha,
            sigma=self.sigma,
            calibration=CalibrationRecord(
                method="gap",
                equation=self.joint.equation.name,
                solver=self.joint.solver,
                measured=" ".join(
                    [data_history(stated, data[0]), *(d.fingerprint for d in data[1:])]
                ),
                version=__version__,
            ),
        )
        return corrected_room(replace(self.case, room=calibrated))

    @property
    def effects(self) -> list[dict[str, Any]]:
        """The effects with their sizes, and the 90 % interval from all data.

        The size of a ``calibrated`` effect was an unknown of the QP, which uses T20 only. Other effects
        have the size with which they were added.
        """
        return [
            p.to_dict()
            | {
                "size": self.sizes.get(p.name),
                "unit": p.effect.unit,
                "material": p.effect.material(p.parameters, self.case.room),
                "calibrated": p.name in self.joint.effects,
            }
            for p in self.case.applied
        ]

    @property
    def effects_in_words(self) -> list[str]:
        """A line per effect: its size, and the data from which the size follows."""
        return [self._in_words(p) for p in self.case.applied]

    def _in_words(self, p: AppliedEffect) -> str:
        name = p.effect.title(p.parameters, self.case.room)
        size, ends = self.sizes.get(p.name), p.size_interval
        if size is None:
            return f"{name}: {p.effect.describe(p.parameters)}"
        source = ", calibrated to T20 alone" if p.name in self.joint.effects else ""
        return f"{name}{source}: {amount(size, p.effect.unit, ends)}"

    def __repr__(self) -> str:
        """Return one line: the room, and the effects with their sizes."""
        sizes = (
            p.name if p.name not in self.sizes else f"{p.name} {self.sizes[p.name]:.3g}"
            for p in self.case.applied
        )
        effects = text.shortened(", ".join(sizes)) or "no effect"
        name = text.shortened(self.case.room.name)
        return f'<Recalibrated "{name}": {len(self.alpha)} materials, with {effects}>'

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        low, high = self.interval
        return {
            "effects": self.effects,
            "materials": [
                {
                    "name": m,
                    "alpha": self.alpha[i].tolist(),
                    "sigma": self.sigma[i].tolist(),
                    "low": low[i].tolist(),
                    "high": high[i].tolist(),
                }
                for i, m in enumerate(self.case.room.materials)
            ],
            "changed": [
                {"configuration": c, "material": m, "alpha": v.tolist()}
                for (c, m), v in self.changed.items()
            ],
        }


def table(room: Room, columns: Mapping[str, Recalibrated]) -> list[str]:
    """Return lines with each material's alpha, as stated and as calibrated, and the effects."""
    named = {"prior": (room.alpha, NORMAL_90 * room.sigma)}
    named |= {k: (c.alpha, np.subtract(*c.interval[::-1]) / 2) for k, c in columns.items()}
    rows = []
    for i, material in enumerate(room.materials):
        cells = [f"{a[i].mean():.3f} ± {half[i].mean():.3f}" for a, half in named.values()]
        rows.append((f"  {material}", cells))
    lines = ["alpha ± half its 90 % interval, means over bands"]
    lines += text.table(rows, header=("", list(named)))
    for c in columns.values():
        for line in c.effects_in_words:
            lines += text.wrapped(line, indent="  ")
    return lines
