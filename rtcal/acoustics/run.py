"""A run: what a simulation program gave, and the room with the coefficients that it had.

With a run, calibrations, comparisons and searches begin from the user's own program in place of an
equation. "The program" is what made the run, "the run" its results.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.bands import hertz
from rtcal.acoustics.measurement import TABLES, Measurement
from rtcal.acoustics.observables import LEVEL, OBSERVABLES, parameter_label
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError, OtherBandsWarning

Lacking = Literal["run", "measurement", "reference"]


@dataclass(frozen=True, eq=False)
class Run:
    """Values that a simulation program gave for a room with certain coefficients.

    Parameters
    ----------
    room : Room
        The room as it was simulated: its alpha are the coefficients that the program had.
    simulated : Measurement
        What the program gave: T20, T30, EDT, C80, ... by band, as means or by pair. It is kept in the
        room's bands.

    Raises
    ------
    DataError
        For another kind of argument, or if room and simulation have no band in common. Bands that are
        converted or left out are a warning.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> times = rt.Eyring().reverberation_time(room)
    >>> rt.Run(room, rt.Measurement.from_values(room.centre_frequencies, t20=times))
    <Run of "BRAS CR2, seminar room": T20>
    """

    room: Room
    simulated: Measurement

    def __post_init__(self) -> None:
        frequencies = checks.instance("room", self.room, Room).centre_frequencies
        checks.instance("simulated", self.simulated, Measurement)
        own = self.simulated.centre_frequencies
        try:
            object.__setattr__(self, "simulated", self.simulated.in_bands(frequencies))
        except DataError as error:
            raise DataError(f"simulated: {error}") from error
        if notes := bands.notes(own, frequencies, "the run"):
            told = f"simulated: {'; '.join(notes)}"
            warnings.warn(told, OtherBandsWarning, stacklevel=checks.stack_level())

    def __repr__(self) -> str:
        names = ", ".join(parameter_label(p) for p in self.simulated.values)
        return f'<Run of "{self.room.name}": {names}>'

    def refuse_other(self, room: Room) -> None:
        """Raise DataError unless the run is of ``room``, with perhaps other coefficients.

        Materials, bands, areas, volume and air must be the same; alpha and scattering may differ.
        """
        own, of = self.room, f'the run is of room "{self.room.name}", which has'
        if own.materials != room.materials:
            raise DataError(
                f"{of} the materials {', '.join(own.materials)}; it must have "
                f"{', '.join(room.materials)}, in this order"
            )
        each = own.centre_frequencies, room.centre_frequencies
        if not np.array_equal(*each):
            raise DataError(f"{of} the bands {hertz(each[0])}; it must have {hertz(each[1])}")
        numbers = [
            (f'area["{m}"]', *areas, "m²")
            for m, *areas in zip(own.materials, own.areas, room.areas, strict=True)
        ]
        for name, mine, asked, unit in [*numbers, ("volume", own.volume, room.volume, "m³")]:
            if not np.isclose(mine, asked, rtol=1e-6, atol=0):
                raise DataError(f"{of} {name} = {mine:.6g} {unit}; it must have {asked:.6g} {unit}")
        if own.air != room.air:
            raise DataError(f"{of} {own.air or 'no air'}; it must have {room.air or 'no air'}")

    def lacking(self, measured: Measurement) -> dict[str, Lacking]:
        """Return the parameters that cannot be compared, each with the side that does not have it.

        T20 is compared only with T20, and T30 with T30. A relative level cannot be compared without its
        ``"reference"``.
        """
        there = (m.in_bands(self.room.centre_frequencies) for m in (self.simulated, measured))
        run, stated = (
            {p for p, values in m.values.items() if np.isfinite(values).any()} for m in there
        )
        found: dict[str, Lacking] = {p: "measurement" if p in run else "run" for p in run ^ stated}
        if LEVEL.key in run & stated:
            found[LEVEL.key] = "reference"
        return {p: found[p] for p in OBSERVABLES if p in found}

    def nothing_common(self, measured: Measurement, what: str = "value") -> DataError:
        """Return the error that there is none of ``what`` in both, with what each side has."""
        return DataError(
            f"run and measurement have no {what} in common: the run has {contents(self.simulated)}, "
            f"the measurement has {contents(measured)}. T20 is compared with T20 alone, and T30 with "
            "T30, in the same band"
        )

    def beside(self, measured: Measurement) -> tuple[Measurement, Measurement]:
        """Return run and measurement with their common parameters and pairs, in the room's bands.

        Both have the same parameters. Where pairs of a source and a receiver are common, both have
        these pairs alone, and a value is NaN where the other lacks it, so that means are over the same
        values. Else each has its own pairs, or means, and only their means can be compared.

        Raises
        ------
        DataError
            If no parameter has a value of both in any band.
        """
        run, measured = self.simulated, measured.in_bands(self.room.centre_frequencies)
        both = measured.values.keys() & run.values.keys() - {LEVEL.key}
        common = [p for p in OBSERVABLES if p in both]
        if pairs := [pair for pair in measured.pairs if pair in run.pairs]:
            run, measured = run.select(pairs), measured.select(pairs)
            known = {
                p: np.isfinite(run.values[p]) & np.isfinite(measured.values[p]) for p in common
            }
        else:
            known = {p: np.isfinite(run.mean(p)) & np.isfinite(measured.mean(p)) for p in common}
        common = [p for p in common if known[p].any()]
        if not common:
            raise self.nothing_common(measured)

        def only(of: Measurement) -> Measurement:
            tables = {name: getattr(of, name) for name in TABLES}
            kept: dict[str, Any] = {
                n: {p: t[p] for p in common if p in t} for n, t in tables.items()
            }
            kept["values"] = {p: np.where(known[p], t, np.nan) for p, t in kept["values"].items()}
            return replace(of, **kept)

        return only(run), only(measured)


def contents(of: Measurement) -> str:
    """Return what has values, in words: "T20 (6 bands, 125 to 4000 Hz)"."""
    known = {p: np.isfinite(values).any(axis=0) for p, values in of.values.items()}
    each = (
        f"{parameter_label(p)} ({bands.span(of.centre_frequencies[at])})"
        for p, at in known.items()
        if at.any()
    )
    return ", ".join(each) or "no value"
