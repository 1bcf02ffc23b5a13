"""The result of the closed loop: the calibrated room, and the simulated measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.acoustics.bands import label
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.parameters import UNITS, parameter_label
from rtcal.acoustics.quality import TrustMark, explained, gap_jnd
from rtcal.acoustics.room import Room
from rtcal.loop import files
from rtcal.loop.state import Loop
from rtcal.support import html, text
from rtcal.support.arguments import checked
from rtcal.support.files import json_numbers, write_text
from rtcal.support.types import Array

_STRONGEST_SHADE = 5.0  # JND


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LoopResult:
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
        Simulated with the coefficients of the equation's calibration, without the loop.
    after : Measurement
        Simulated with the coefficients returned. T20 was fitted, other parameters were not.
    confirmation : Measurement or None
        Simulated with the coefficients returned and another seed. None for a deterministic
        simulator, and if no band converged.
    notes : tuple of str
        What is to be known of the simulations, such as paths that left through gaps of the mesh.
    """

    room: Room
    simulator: str
    loop: Loop
    simulations: int
    before: Measurement
    after: Measurement
    confirmation: Measurement | None
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
        """Status of each band: one of `rtcal.loop.status.STATUSES`."""
        return self.loop.confirmed(self.final)

    @property
    def gap(self) -> Array:
        """Gap of T20 of `final` in JND, (n_bands,), NaN without a measured T."""
        return gap_jnd(self.final.mean("t20"), self.loop.wanted)

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
                name: {p: json_numbers(measurement.mean(p)) for p in measurement.values}
                for name, measurement in (("before", self.before), ("after", self.final))
            },
        }

    def to_json(self) -> str:
        """Return the loop and the parameters before and after as JSON text.

        `Loop.load` reads the loop, ``rtcal report`` the whole text.
        """
        return files.text({**self.loop.to_dict(), "result": self.ends()})

    @checked
    def save(self, path: str) -> None:
        """Write the text of `to_json` to a file; a failure leaves no part of it."""
        write_text(path, self.to_json())

    def __str__(self) -> str:
        header, rows = self._table()
        lines = [f"Coefficients only for {self.simulator}; {self.simulations} simulations"]
        lines += text.table([(row[0], row[1:]) for row in rows], header=(header[0], header[1:]))
        for note in self._notes():
            lines += text.wrapped(note, hanging="       " if note.startswith(" ") else "    ")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Return the table with shaded gaps: orange for a T that is too long, blue for too short."""
        header, rows = self._table()
        column = header.index("gap / JND")
        shaded: list[list[str | html.Cell]] = [[*row] for row in rows]
        for row, gap in zip(shaded, np.nan_to_num(self.gap), strict=True):
            row[column] = html.Cell(str(row[column]), float(np.clip(gap / _STRONGEST_SHADE, -1, 1)))
        return html.table(self._description, header, shaded, self._notes())

    def _table(self) -> tuple[list[str], list[list[str]]]:
        """Return the header and one row per band."""
        columns: dict[str, Sequence[str]] = {
            "": [label(f) for f in self.room.centre_frequencies],
            "T20 wanted / s": _numbers(self.loop.wanted, ".3f"),
            "simulated / s": _numbers(self.final.mean("t20"), ".3f"),
            "gap / JND": _numbers(self.gap, "+.2f"),
            "z": _numbers(self.loop.outcome.plausibility.z, "+.1f"),
            "status": self.status,
        }
        for parameter in ("edt", "c50", "c80"):
            if parameter in self.before.values:
                first, last = (
                    _numbers(measurement.mean(parameter), ".2f")
                    for measurement in (self.before, self.final)
                )
                columns[f"{parameter_label(parameter)} / {UNITS[parameter]}"] = [
                    f"{a} to {b}" for a, b in zip(first, last, strict=True)
                ]
        return list(columns), [list(row) for row in zip(*columns.values(), strict=True)]

    def _notes(self) -> list[str]:
        notes = explained(self.trust_marks)
        if "not confirmed" in self.status:
            notes.insert(
                0,
                "Not confirmed: with another seed the gap exceeds tolerance plus noise, or the noise "
                "exceeds the tolerance. Simulate with less noise (more paths).",
            )
        return [*notes, *self.notes]


def _numbers(values: Array, form: str) -> list[str]:
    return [format(v, form) if np.isfinite(v) else "-" for v in values]
