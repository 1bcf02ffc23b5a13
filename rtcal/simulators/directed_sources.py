"""Sources of a simulation that are not omnidirectional, or of which nobody knows whether they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rtcal.acoustics.directivity import Directivity, DirectivityFile
from rtcal.acoustics.observables import OBSERVABLES
from rtcal.acoustics.room import Room
from rtcal.acoustics.scene import directivities
from rtcal.simulators.observations import checked_parameters
from rtcal.support.errors import DataError


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DirectedSources:
    """The directivity of each source, for a simulator that takes it; see `PathTracing`.

    The simulator states ``room`` and ``sources``. Its constructor calls `_check_directivity`.
    """

    room: Room
    sources: Mapping[str, Any]
    directivity: Mapping[str, Any] = field(default_factory=dict)

    def _check_directivity(self) -> None:
        """Give each directivity a value per band; DataError if one fits no source or the bands."""
        stated = directivities(self.directivity, self.sources)
        for name, of in stated.items():
            if isinstance(of, DirectivityFile):
                raise DataError(f'directivity["{name}"] is a file; rtcal.io.balloon.read reads it')
            if isinstance(of, Directivity):
                stated[name] = of.for_bands(self.room.n_bands, f'directivity["{name}"]')
        object.__setattr__(self, "directivity", stated)

    @property
    def unknown_sources(self) -> tuple[str, ...]:
        """The sources whose directivity is stated to be unknown."""
        return tuple(name for name, of in self.directivity.items() if isinstance(of, str))

    @property
    def aimed_sources(self) -> dict[int, Directivity]:
        """The directivities that are known, by the number of the source."""
        stated = {s: self.directivity.get(name) for s, name in enumerate(self.sources)}
        return {s: of for s, of in stated.items() if isinstance(of, Directivity)}

    def trusted(self, match: Sequence[str]) -> tuple[str, ...]:
        """Return those parameters that say as much where a source's directivity is unknown.

        Early sound depends on where a loudspeaker aims, and so does the level near it. T20 and T30
        depend on it little. DataError where none is left.
        """
        names = checked_parameters(match)
        if not self.unknown_sources:
            return names
        kept = tuple(name for name in names if OBSERVABLES[name].part == "late")
        if not kept:
            raise DataError(
                f"match = {', '.join(names)} depends on the directivity of a source, which is unknown"
            )
        return kept

    @property
    def source_notes(self) -> tuple[str, ...]:
        """The assumption on the sources' directivities."""
        notes = []
        if unknown := ", ".join(self.unknown_sources):
            notes.append(
                f"The directivity of {unknown} is unknown. So reverberation times alone are used: the "
                "level and early parameters depend on where a loudspeaker aims."
            )
        if taken := ", ".join(name for name in self.sources if name not in self.directivity):
            notes.append(f"Taken as omnidirectional: {taken}.")
        return tuple(notes)
