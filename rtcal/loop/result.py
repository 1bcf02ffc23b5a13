"""What the closed loop returns: the calibrated room, and what the simulator makes of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.parameters import UNITS
from rtcal.acoustics.quality import TrustMark, explained, gap_jnd
from rtcal.acoustics.room import Room
from rtcal.loop import files
from rtcal.loop.state import Loop
from rtcal.support.files import json_numbers, write_text
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopResult:
    """A calibrated simulator.

    Attributes
    ----------
    room : Room
        With the coefficients to give to the simulator, and the record of which simulator.
    simulator : str
        The coefficients belong to it and to no other.
    loop : Loop
        Every step, and the `status` and `gap` of every band.
    simulations : int
        Calls of the simulator until the loop ended, those that gave no T20 included.
    before, after : Measurement
        Simulated with the equation's calibration alone, and with the coefficients returned; of
        these, T20 was fitted, EDT, C50, C80 and the rest were not.
    confirmation : Measurement or None
        The same coefficients with a fresh seed; None for a deterministic simulator.
    """

    room: Room
    simulator: str
    loop: Loop
    simulations: int
    before: Measurement
    after: Measurement
    confirmation: Measurement | None

    @property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return self.room.alpha

    @property
    def final(self) -> Measurement:
        """What the coefficients give, with fresh random numbers where there are any."""
        return self.confirmation or self.after

    @property
    def status(self) -> tuple[str, ...]:
        """What is said of each band, one of `STATUSES`; see `Loop.confirmed`."""
        return self.loop.confirmed(self.final)

    @property
    def gap(self) -> Array:
        """Gap of T20 in JND of `final`, (n_bands,)."""
        return gap_jnd(self.final.mean("t20"), self.loop.wanted)

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Why not to believe the coefficients of a band; see `Loop.trust_marks`."""
        return self.loop.trust_marks

    def ends(self) -> dict[str, Any]:
        """Return what the simulator had before and after: means by parameter and band, JSON-able."""
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
        """Return the loop and what the simulator had before and after, as JSON text.

        `Loop.load` reads the loop in it, ``rtcal report`` all of it.
        """
        return files.text({**self.loop.to_dict(), "result": self.ends()})

    def save(self, path: str) -> None:
        """Write `to_json` to a file, whole or not at all."""
        write_text(path, self.to_json())

    def __str__(self) -> str:
        def shown(values: Array, form: str) -> list[str]:
            return [format(v, form) if np.isfinite(v) else "-" for v in values]

        others = [p for p in ("edt", "c50", "c80") if p in self.before.values]
        heads = [f"{p.upper()} / {UNITS[p]}" for p in others]
        z, status = self.loop.outcome.plausibility.z, self.status
        columns = [
            ("Hz", 7, shown(self.room.centre_frequencies, "g")),
            ("T20 wanted / s", 16, shown(self.loop.wanted, ".3f")),
            ("found / s", 11, shown(self.final.mean("t20"), ".3f")),
            ("gap / JND", 11, shown(self.gap, "+.2f")),
            ("z", 6, shown(z, "+.1f")),
            *(
                (
                    head,
                    14,
                    [
                        f"{a} to {b}"
                        for a, b in zip(
                            shown(self.before.mean(p), ".2f"),
                            shown(self.final.mean(p), ".2f"),
                            strict=True,
                        )
                    ],
                )
                for head, p in zip(heads, others, strict=True)
            ),
        ]
        lines = [
            f"Coefficients for {self.simulator} only; {self.simulations} simulations",
            "".join(head.rjust(width) for head, width, _ in columns),
        ]
        for k, said in enumerate(status):
            lines.append("".join(c[k].rjust(width) for _, width, c in columns) + f"  {said}")
        if "not confirmed" in status:
            lines.append(
                "Not confirmed: fresh random numbers are further off than tolerance and noise, or "
                "the noise alone is more than the tolerance. Simulate with less noise (more paths)."
            )
        return "\n".join([*lines, *explained(self.trust_marks)])
