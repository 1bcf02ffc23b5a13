"""The result of the closed loop: the calibrated room, and the simulated measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics.bands import labels
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET, observable, parameter_label
from rtcal.acoustics.quality import gap_jnd
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import in_words
from rtcal.acoustics.trust import TrustMark, explained
from rtcal.calibration.result import CalibrationResult
from rtcal.loop.matched import SHOWN, Gaps, ParameterGap, left, sentences
from rtcal.loop.state import Loop
from rtcal.support import text
from rtcal.support.files import json_numbers
from rtcal.support.saved import Result
from rtcal.support.types import Array

_STRONGEST_SHADE = 5.0  # JND


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LoopResult(Result):
    """A calibrated simulator.

    Attributes
    ----------
    room : Room
        The room with the coefficients for the simulator, and a record of the calibration.
    simulator : str
        Name of the simulator. The coefficients belong to no other.
    loop : Loop
        All steps, and the `status` and `gap` of each band.
    simulations : int
        Number of all calls of the simulator.
    before : Measurement
        Simulated with the stated coefficients. If some band has no T20 with them, or fewer than three
        simulations were allowed, with those of the equation's calibration.
    after : Measurement
        Simulated with the coefficients returned. What is matched was fitted, by default T20.
    confirmation : Measurement or None
        Simulated with the coefficients returned and another seed. None for a deterministic
        simulator, and if no band converged.
    measured : Measurement or None
        What was measured, in the room's bands, also what was not fitted.
    notes : tuple of str
        What is to be known of the simulations, such as paths that left through gaps of the mesh.
    """

    record_kind: ClassVar[str] = "loop result 1"

    room: Room
    simulator: str
    loop: Loop
    simulations: int
    before: Measurement
    after: Measurement
    confirmation: Measurement | None
    measured: Measurement | None = None
    notes: tuple[str, ...] = ()

    @property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return self.room.alpha

    @property
    def final(self) -> Measurement:
        """The simulation that judges the result: `confirmation` if there is one, else `after`."""
        return self.confirmation or self.after

    @property
    def status(self) -> tuple[str, ...]:
        """Status of each band: one of `rtcal.loop.rules.STATUSES`."""
        return self.loop.confirmed(self.final)

    @property
    def gap(self) -> Array:
        """Gap of what is matched, of `final`, in JND, (n_bands,), NaN without a measured T."""
        return self.loop.matched.gap(self.final)

    @property
    def compromise(self) -> dict[str, ParameterGap]:
        """Each matched parameter's share, its gaps before and after, and what it lost, in JND."""
        return self.loop.matched.compromise(self.before.mean, self.final.mean)

    def gaps(self, parameter: str) -> tuple[Array, Array]:
        """Return simulated less measured before and after in JND, each (n_bands,).

        Of the means over pairs; NaN where the parameter was not measured or not simulated.
        """
        observable(parameter)
        if self.measured is None:
            return np.full(self.loop.wanted.shape, np.nan), np.full(self.loop.wanted.shape, np.nan)
        wanted = self.measured.mean(parameter)
        return (
            gap_jnd(self.before.mean(parameter), wanted, parameter),
            gap_jnd(self.final.mean(parameter), wanted, parameter),
        )

    @property
    def farther(self) -> tuple[str, ...]:
        """Parameters that are not fitted and whose gap grew by more than one JND, in some band.

        The mean T20 is fitted; what it costs in EDT, C50 and C80 is told here. `compromise` tells it
        of what is matched.
        """
        return left(self.gaps_beside)

    @property
    def of_uncertain_room(self) -> CalibrationResult | None:
        """The calibration to the same targets with volume, areas and climate uncertain.

        None for an exact room. See `Loop.of_uncertain_room`.
        """
        return self.loop.of_uncertain_room

    @property
    def gaps_beside(self) -> Gaps:
        """`gaps` of each parameter that is shown and was not matched."""
        return {p: self.gaps(p) for p in SHOWN if p not in self.loop.matched.shares}

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Reasons to doubt the coefficients of a band; see `Loop.trust_marks`."""
        return self.loop.trust_marks

    def __repr__(self) -> str:
        return f"<{self._description}>"

    @property
    def _description(self) -> str:
        measured = int(np.isfinite(self.loop.wanted).sum())
        converged = self.status.count("converged")
        return (
            f'LoopResult of "{text.shortened(self.simulator)}": {self.simulations} '
            f"simulation{'s' * (self.simulations != 1)}, {converged} of {measured} bands converged"
        )

    def ends(self) -> dict[str, Any]:
        """Return the parameters before and after, means by parameter and band, as plain values."""
        return {
            "simulator": self.simulator,
            "confirmed": self.confirmation is not None,
            "status": list(self.status),
            **{
                name: {} if of is None else {p: json_numbers(of.mean(p)) for p in of.values}
                for name, of in (
                    ("measured", self.measured),
                    ("before", self.before),
                    ("after", self.final),
                )
            },
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the loop and the parameters before and after as plain values."""
        return {**self.loop.to_dict(), "result": self.ends()}

    def __str__(self) -> str:
        lines = [f"Coefficients only for {self.simulator}; {self.simulations} simulations"]
        for header, rows in filter(all, (self._table(), self._compromise(), self._beside())):
            lines += text.table([(row[0], row[1:]) for row in rows], header=(header[0], header[1:]))
        for note in self._notes():
            lines += text.wrapped(note, hanging="       " if note.startswith(" ") else "    ")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Return the table with shaded gaps: orange for a T that is too long, blue for too short."""
        header, rows = self._table()
        for more, rows_beside in (self._compromise(), self._beside()):
            header += more[1:]
            for row, beside in zip(rows, rows_beside, strict=bool(more)):
                row.extend(beside[1:])
        column = header.index("gap / JND")
        shaded: list[list[str | text.Cell]] = [[*row] for row in rows]
        for cells, gap in zip(shaded, np.nan_to_num(self.gap), strict=True):
            shade = float(np.clip(gap / _STRONGEST_SHADE, -1, 1))
            cells[column] = text.Cell(str(cells[column]), shade)
        return text.html_table(self._description, header, shaded, self._notes())

    def _table(self) -> tuple[list[str], list[list[str]]]:
        """Return the header and one row per band."""
        columns: dict[str, Sequence[str]] = {
            "": labels(self.room.centre_frequencies),
            "T wanted / s": text.numbers(self.loop.wanted, ".3f"),
            "simulated / s": text.numbers(self.loop.matched.combined(self.final.mean), ".3f"),
            "gap / JND": text.numbers(self.gap, "+.2f"),
            "z": text.numbers(self.loop.outcome.plausibility.z, "+.1f"),
            "status": self.status,
        }
        return list(columns), [list(row) for row in zip(*columns.values(), strict=True)]

    def _compromise(self) -> tuple[list[str], list[list[str]]]:
        """Return header and rows of the gaps of what is matched together; nothing for T20 alone."""
        if len(self.compromise) == 1:
            return [], []
        columns: dict[str, Sequence[str]] = {"": labels(self.room.centre_frequencies)}
        for parameter, part in self.compromise.items():
            name = parameter_label(parameter)
            columns[f"{name} gap / JND before"] = text.numbers(part.before, "+.1f")
            columns[f"{name} gap / JND after"] = text.numbers(part.after, "+.1f")
            columns[f"{name} lost / JND"] = text.numbers(part.lost, ".1f")
        return list(columns), [list(row) for row in zip(*columns.values(), strict=True)]

    def _beside(self) -> tuple[list[str], list[list[str]]]:
        """Return header and rows of EDT, C50 and C80: measured, before and after the loop."""
        columns: dict[str, Sequence[str]] = {"": labels(self.room.centre_frequencies)}
        for parameter in (p for p in SHOWN if p != TARGET.key and p in self.before.values):
            name = f"{parameter_label(parameter)} / {observable(parameter).unit}"
            measured = self.measured and self.measured.values
            for when, of in (
                ("measured", self.measured if measured and parameter in measured else None),
                ("before", self.before),
                ("after", self.final),
            ):
                if of is not None:
                    columns[f"{name} {when}"] = text.numbers(of.mean(parameter), ".2f")
        if len(columns) == 1:
            return [], []
        return list(columns), [list(row) for row in zip(*columns.values(), strict=True)]

    def _notes(self) -> list[str]:
        notes = explained(self.trust_marks)
        if "not confirmed" in self.status:
            notes.insert(
                0,
                "Not confirmed: with another seed the gap exceeds tolerance plus noise, or the noise "
                "exceeds the tolerance. Simulate with less noise (more paths).",
            )
        notes[:0] = sentences(self.gaps_beside, self.room.centre_frequencies)
        if self.loop.room.is_uncertain:
            notes.append(
                f"The room is uncertain ({in_words(self.loop.room)}). These coefficients serve the "
                "simulator in the room as stated, and carry the room's error, too. Those of the "
                "materials are in result.of_uncertain_room."
            )
        if self.loop.low is not None:
            notes.append(self.loop.low.note)
        return [*notes, *self.notes]
