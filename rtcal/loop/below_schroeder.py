"""Room modes in a closed loop: they are the prior of all bands, and some bands they carry.

No simulator of rays hears room modes, and below the Schroeder frequency T is no equation's. So the loop
is not told what was measured there: coefficients stay as the modes' decays left them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.bands import label
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.repeats import of_room
from rtcal.acoustics.room import Room
from rtcal.acoustics.trust import TrustMark
from rtcal.calibration.problem_data import times_in_room
from rtcal.modes.calibrate import above_schroeder, below_schroeder
from rtcal.modes.result import ModesResult
from rtcal.support import checks
from rtcal.support.errors import DataError


@dataclass(frozen=True, eq=False)
class BelowSchroeder:
    """The bands below the Schroeder frequency, in a loop that was given room modes.

    ``modes`` were calibrated without T. ``below`` (n_bands,) says which bands lie below the Schroeder
    frequency of the measured T.
    """

    modes: ModesResult
    below: NDArray[np.bool_]

    @classmethod
    def of(cls, modes: ModesResult, room: Room, measured: Measurement) -> BelowSchroeder:
        """Return the bands of a room and its measurement.

        Raises DataError if the modes are another room's or were calibrated to T, too, or if every
        measured band lies below the Schroeder frequency.
        """
        checks.instance("modes", modes, ModesResult)
        if of_room(modes.prior) != of_room(room):
            raise DataError(
                f'modes is of room "{modes.prior.name}" as it was; it is calibrated for the room '
                f'"{room.name}" as given here'
            )
        if np.isfinite(modes.data.reverberation_time).any():
            raise DataError(
                "modes was calibrated to T as well, which would count twice: leave T out, "
                "calibrate_modes(room, modes)"
            )
        times = times_in_room(room, measured)
        below = below_schroeder(room, times)
        if not np.isfinite(times.reverberation_time[~below]).any():
            raise DataError(
                "every measured band lies below the Schroeder frequency, so that nothing is left to "
                "simulate: `rtcal calibrate ROOM MEASURED --modes MODES` (rt.calibrate_modes) has the "
                "coefficients"
            )
        return cls(modes, below)

    @property
    def room(self) -> Room:
        """The room as the modes left it: the loop's prior."""
        return self.modes.room

    @property
    def carried(self) -> NDArray[np.bool_]:
        """Bands that at least three modes carry, (n_bands,)."""
        return np.asarray(self.below & self.modes.carried)

    def above(self, measured: Measurement) -> Measurement:
        """Return a measurement without the bands below the Schroeder frequency."""
        return above_schroeder(measured, self.room, self.below)

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Marks of the modes themselves, and of the bands that no modes carry."""
        return (*self.modes.own_marks, *self.modes.uncarried(self.below & ~self.carried))

    def statuses(self, status: Sequence[str]) -> tuple[str, ...]:
        """Return the loop's statuses with those of the bands below the Schroeder frequency."""
        own = np.where(self.carried, "by modes", "too few modes")
        return tuple(np.where(self.below, own, status).tolist())

    def to_dict(self) -> dict[str, Any]:
        """Return the bands and the modes as plain values."""
        return {"below": self.below, "carried": self.carried, "modes": self.modes.to_dict()}

    @property
    def doubts(self) -> list[str]:
        """Reasons to doubt the modes' matches, as the modes' own result tells them."""
        return [note for note in self.modes.notes if note.startswith("Doubtful")]

    @property
    def note(self) -> str:
        """The room modes stand in place of what was measured, and their doubts: this as sentences."""
        told = "No band lies below the Schroeder frequency; the modes are part of the prior."
        return " ".join([self._of_bands if self.below.any() else told, *self.doubts])

    @property
    def _of_bands(self) -> str:
        bands = [label(f) for f in self.room.centre_frequencies[self.below]]
        without = [label(mark.frequency) for mark in self.trust_marks if mark.frequency]
        doubt = (
            f" Fewer than three carry {', '.join(without)}: do not use these." if without else ""
        )
        return (
            f"Below the Schroeder frequency ({', '.join(bands)}) {len(self.modes.used)} room modes "
            f"stand in place of what was measured there.{doubt}"
        )
