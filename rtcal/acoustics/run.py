"""A run: what a simulation program gave, and the room with the coefficients that it had.

With a run, calibrations, comparisons and searches begin from the user's own program in place of an
equation. "The program" is what made the run, "the run" its results.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.bands import hertz, label
from rtcal.acoustics.measurement import Measurement, Pair
from rtcal.acoustics.observables import LEVEL, OBSERVABLES, parameter_label
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError, OtherBandsWarning
from rtcal.support.text import first_of, listed
from rtcal.support.types import Array, put

Lacking = Literal["run", "measurement", "reference"]
Flags: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Run:
    """Results of a simulation program for a room, with the coefficients that the program had.

    Parameters
    ----------
    room : Room
        Room as it was simulated: its alpha are the coefficients that the program had.
    simulated : Measurement
        Results of the program: T20, T30, EDT, C80, ... by band, as means or by source-receiver pair.
        They are converted to the room's bands.

    Raises
    ------
    DataError
        For an argument of a wrong type, or if room and simulation have no band in common. Bands that
        are converted or left out only give a warning.

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
            put(self, simulated=self.simulated.in_bands(frequencies))
        except DataError as error:
            raise DataError(f"simulated: {error}") from error
        if notes := bands.notes(own, frequencies, "the run"):
            told = f"simulated: {'; '.join(notes)}"
            warnings.warn(told, OtherBandsWarning, stacklevel=checks.stack_level())

    def __repr__(self) -> str:
        names = ", ".join(parameter_label(p) for p in self.simulated.values)
        return f'<Run of "{self.room.name}": {names}>'

    def refuse_other(self, room: Room) -> None:
        """Raise DataError if the run is of another room than ``room``.

        Materials, bands, areas, volume and air must be the same; alpha and scattering may differ.
        """
        own, of = self.room, f'the simulation was run with room "{self.room.name}", which has'
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

    def nothing_common(self, measured: Measurement, what: str = "value") -> DataError:
        """Return a DataError which states that run and measurement have no value in common.

        ``what`` is the name of the missing quantity in the message, such as "T20 or T30".
        """
        return DataError(
            f"the simulation and the measurement have no {what} in common: the simulation "
            f"has {contents(self.simulated)}, the measurement has {contents(measured)}. "
            "Only the same parameter in the same band is compared: T20 with T20, and T30 "
            "with T30"
        )

    def beside(self, measured: Measurement, *, by_pair: bool = False) -> Beside:
        """Return the values that both run and measurement have, in the room's bands.

        T20 is compared only with T20, and T30 with T30. If some source-receiver pairs are in both, only
        these pairs are returned, and a value that is missing on one side is NaN on both, so that means
        are over the same values. Otherwise both keep their pairs or means, and only the means can be
        compared.

        Parameters
        ----------
        measured : Measurement
            Measurement that the run is compared with.
        by_pair : bool
            Whether only values of common pairs count. Relative levels, which have a reference for each
            source, can then be compared, and G of the run counts as a relative level.

        Raises
        ------
        DataError
            If run and measurement have no parameter and band in common or, with ``by_pair``, no pair.
        """
        run, measured = self.simulated, measured.in_bands(self.room.centre_frequencies)
        own = run.pairs, measured.pairs
        pairs = [pair for pair in measured.pairs if pair in run.pairs]
        if by_pair and not pairs:
            each = (first_of([*map(" to ".join, of)], 2) for of in own)
            raise DataError(
                "the simulation and the measurement have no source-receiver pair in "
                f"common: the simulation has {', the measurement '.join(each)}. Name "
                "sources and receivers alike in both"
            )
        if pairs:
            run, measured = run.select(pairs), measured.select(pairs)
        key_of_run = {p: p for p in (*measured.values, *run.values)}
        if by_pair and LEVEL.key in measured.values:
            key_of_run[LEVEL.key] = LEVEL.key_in(run.values)
        stood_in = {key for p, key in key_of_run.items() if p != key} - measured.values.keys()
        names = [p for p in OBSERVABLES if p in key_of_run and p not in stood_in]

        def there(of: Measurement, key: str) -> Flags:
            if key not in of.values:
                return np.zeros((1, 1), dtype=bool)
            return np.isfinite(of.values[key] if pairs else of.mean(key)[np.newaxis])

        known = {p: (there(run, key_of_run[p]), there(measured, p)) for p in names}
        shared, lacking = list[str](), dict[str, Lacking]()
        for p, (of_run, of_measured) in known.items():
            if not (of_run.any() and of_measured.any()):
                if of_run.any() or of_measured.any():
                    lacking[p] = "measurement" if of_run.any() else "run"
            elif p == LEVEL.key and not by_pair:
                lacking[p] = "reference"
            else:
                shared.append(p)
        both = {p: known[p][0] & known[p][1] for p in shared if (known[p][0] & known[p][1]).any()}
        if not both:
            raise self.nothing_common(measured)

        def common(of: Measurement, keys: Mapping[str, str]) -> Measurement:
            known_at = {keys[p]: at for p, at in both.items()}
            kept = of.only([*known_at])
            values = {p: np.where(at, kept.values[p], np.nan) for p, at in known_at.items()}
            return replace(kept, values=values)

        missing = [[p for p in of if p not in pairs] if pairs else [] for of in own[::-1]]
        return Beside(
            common(run, key_of_run),
            common(measured, {p: p for p in both}),
            lacking,
            dict(zip(_SIDES, missing, strict=True)),
            {p: known[p] for p in shared},
        )


_SIDES: tuple[Lacking, ...] = ("run", "measurement")
_WHY: Mapping[Lacking, str] = {
    "run": "which the run does not have",
    "measurement": "which the measurement does not have",
    "reference": "which has a different reference for each source",
}
_MOST_NAMED = 8
"""Names of what one side lacks that are listed; of others their number is said."""


@dataclass(frozen=True, eq=False)
class Beside:
    """Values that both a run and a measurement have, and what one of them lacks (see `Run.beside`).

    ``run`` and ``measured`` have the common values, ``lacking`` the parameters and ``missing`` the
    source-receiver pairs that one side lacks. ``known`` shows which values each side has.
    """

    run: Measurement
    measured: Measurement
    lacking: Mapping[str, Lacking]
    """Parameters that cannot be compared, each with the side that lacks it. A relative level cannot be
    compared without its ``"reference"``."""
    missing: Mapping[Lacking, Sequence[Pair]]
    """Source-receiver pairs by the side that lacks them; empty where only means are compared."""
    known: Mapping[str, tuple[Flags, Flags]]
    """Whether run and measurement each have a value, (n_pairs, n_bands), by compared parameter."""

    def left_out(self, parameters: Collection[str] = OBSERVABLES) -> list[str]:
        """Return sentences for the user on values that are not compared, because one side lacks them.

        Only ``parameters`` (keys, such as "t20") are named, by default all. The list is empty if
        nothing is left out.
        """
        each, pairs = [], [" to ".join(pair) for pair in self.measured.pairs]
        f, by_pair = self.run.centre_frequencies, self.run.pairs == self.measured.pairs
        for why, said in _WHY.items():
            names = [parameter_label(p) for p in parameters if self.lacking.get(p) == why]
            names += map(" to ".join, self.missing.get(why, ()))
            if why in _SIDES:
                i = _SIDES.index(why)
                of = {p: (k[i], k[1 - i]) for p, k in self.known.items() if p in parameters}
                names += _values_in_words(of, pairs, f)
            if names:
                short = listed(names) if len(names) <= _MOST_NAMED else first_of(names, _MOST_NAMED)
                each.append(f"{short}, {said}")
        found = [f"Not compared: {', and '.join(each)}."] if each else []
        if not (by_pair or self.run.is_summary or self.measured.is_summary):
            found.append(
                "Means over the pairs are compared, because run and measurement have no pair in common."
            )
        return found


def _values_in_words(
    known: Mapping[str, tuple[Flags, Flags]], pairs: Sequence[str], f: Array
) -> list[str]:
    """Return bands, parameters in bands, and single values that one side lacks, in words.

    ``known`` is where it has a value and where the other side has one, (n_pairs, n_bands) each.
    """
    lost = {p: had & ~has for p, (has, had) in known.items()}
    in_band = {p: had.any(axis=0) for p, (_, had) in known.items()}
    gone = {p: in_band[p] & ~(has & had).any(axis=0) for p, (has, had) in known.items()}
    whole = np.any([*gone.values()], axis=0) & np.all(
        [gone[p] | ~there for p, there in in_band.items()], axis=0
    )
    said = [hertz(f[whole])] if whole.any() else []
    for p, at in lost.items():
        name, bands_of = parameter_label(p), gone[p] & ~whole
        said += [f"{name} at {hertz(f[bands_of])}"] if bands_of.any() else []
        single = np.argwhere(at & ~gone[p])
        if len(single) == 1:
            ((i, k),) = single
            said.append(f"{name} from {pairs[i]} at {label(f[k])}")
        elif len(single):
            said.append(f"{len(single)} values of {name}")
    return said


def contents(of: Measurement) -> str:
    """Return in words the parameters and bands that have values: "T20 (6 bands, 125 to 4000 Hz)"."""
    known = {p: np.isfinite(values).any(axis=0) for p, values in of.values.items()}
    each = (
        f"{parameter_label(p)} ({bands.span(of.centre_frequencies[at])})"
        for p, at in known.items()
        if at.any()
    )
    return ", ".join(each) or "no value"
