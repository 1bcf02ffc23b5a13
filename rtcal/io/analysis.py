"""The parameters of analysed impulse responses, with what is missing and doubtful, by band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.marks import in_measurement
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import (
    REVERBERATION,
    observable,
    parameter_label,
)
from rtcal.support import text
from rtcal.support.types import Array

MOST_NAMED = 4
"""Largest number of pairs or files that a sentence names."""
_FAR = 3.0
"""Ratio of a time to the median over the pairs above which it is told as a likely typing error."""


def with_uncertainty(measurement: Measurement) -> Measurement:
    """Return the measurement with the uncertainty of each value, from theory and round robins.

    Per value: that of one response, whose field is noise (`Observable.scatter`). In common to the pairs
    of a band: what teams differ by (Bork 2005).
    """
    frequencies, values = measurement.centre_frequencies, measurement.values
    times = measurement.reverberation_time
    own: dict[str, Array] = {}
    common: dict[str, Array] = {}
    for p, table in values.items():
        kind = observable(p)
        told = kind.decay_time(table)
        decay = np.where(np.isfinite(table), np.where(np.isfinite(told), told, times), np.nan)
        own[p] = kind.of_value(kind.scatter(frequencies, decay), table)
        common[p] = kind.of_value(kind.between_teams(frequencies), measurement.mean(p))
    return replace(measurement, uncertainty=own, common_uncertainty=common)


class Floor(Enum):
    """What ends the range of levels of a decay, as a sentence with a place for the range in dB."""

    NOISE = "It is {} dB."
    CUT = "It is {} dB at the end of the response, which is cut off before the noise."
    END = "It is {} dB at the end of the response, be it noise or a cut decay."
    FLAT = "No decay of 10 dB stands out of the end of the response, be it noise or a cut decay."
    SHORT = "The response is silent or shorter than 50 ms."
    LATE = (
        "The energy arrives late, as in a recording of a sweep, of interrupted noise or of two sounds: "
        "it is no decay."
    )


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """The parameters of impulse responses, the reasons for missing values, and notes.

    Attributes
    ----------
    measurement : Measurement
    impulse_to_noise_ratio : array (n_pairs, n_bands)
        dB; of repeats, the least.
    floors : tuple of tuples of Floor, (n_pairs, n_bands)
        What ends each decay's range.
    minimum_range : mapping of str to float
        Impulse-to-noise ratio in dB that each parameter needed.
    notes : tuple of str
        Doubts about the other values.
    """

    measurement: Measurement
    impulse_to_noise_ratio: Array
    floors: tuple[tuple[Floor, ...], ...]
    minimum_range: Mapping[str, float]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the means by band, what is missing by band, and the notes."""
        lines = means(self.measurement)
        if missing := self.missing:
            needed: dict[float, list[str]] = {}
            for name in self.measurement.values:
                needed.setdefault(self.minimum_range[name], []).append(parameter_label(name))
            parts = [f"{ratio:g} dB for {', '.join(names)}" for ratio, names in needed.items()]
            rule = "Missing values. Impulse-to-noise ratio needed (ISO 3382)"
            lines += ["", *text.wrapped(f"{rule}: {'; '.join(parts)}.")]
            for sentence in missing:
                lines += text.wrapped(sentence, indent="  ")
        for note in self.notes:
            lines += text.wrapped(f"note: {note}")
        return "\n".join(lines)

    @property
    def missing(self) -> tuple[str, ...]:
        """A sentence per band: how many pairs lack which parameter, their range in dB, what ends it."""
        sentences, n = [], len(self.measurement.pairs)
        for k, frequency in enumerate(self.measurement.centre_frequencies):
            lacking: dict[tuple[int, ...], list[str]] = {}
            for parameter, values in self.measurement.values.items():
                rows = tuple(np.flatnonzero(np.isnan(values[:, k])).tolist())
                lacking.setdefault(rows, []).append(parameter_label(parameter))
            lacking.pop((), None)
            if not lacking:
                continue
            where = "; ".join(
                ", ".join(names) + (f" in {self._pairs(rows)}" if n > 1 else "")
                for rows, names in sorted(lacking.items(), key=lambda item: -len(item[0]))
            )
            of_floor: dict[Floor, list[int]] = {}
            for i in sorted({i for rows in lacking for i in rows}):
                of_floor.setdefault(self.floors[i][k], []).append(i)
            why = []
            for floor, some in of_floor.items():
                sentence = floor.value.format(spread(self.impulse_to_noise_ratio[some, k], ".1f"))
                why.append(
                    sentence if len(of_floor) == 1 else f"In {self._pairs(some)}: {sentence}"
                )
            sentences.append(f"{bands.label(frequency)}: no {where}. {' '.join(why)}")
        return tuple(sentences)

    def _pairs(self, rows: Sequence[int]) -> str:
        """Return how many pairs these are, and which, up to `MOST_NAMED`."""
        n = len(self.measurement.pairs)
        named = [" to ".join(self.measurement.pairs[i]) for i in rows]
        which = f" ({text.first_of(named, MOST_NAMED)})" if len(rows) < n else ""
        return f"{len(rows)} of {n} pairs{which}"


def means(measurement: Measurement) -> list[str]:
    """Return the means over the pairs as the lines of a table, one row per parameter."""
    n, rows, of_all = len(measurement.pairs), [], []
    for parameter in measurement.values:
        kind, mean = observable(parameter), measurement.mean(parameter)
        cells = [format(v, f".{kind.decimals}f") if np.isfinite(v) else "-" for v in mean]
        rows.append((f"{kind.label} / {kind.unit}".removesuffix(" / "), cells))
        overall = kind.overall(mean, measurement.centre_frequencies)
        if np.isfinite(overall):
            of_all.append(f"{kind.label} of all bands: {overall:.{kind.decimals}f}")
    title = f"Means over {n} pairs of source and receiver:" if n > 1 else "Values:"
    header = ("", bands.labels(measurement.centre_frequencies))
    return [title, *text.table(rows, header=header), *of_all]


def spread(values: Sequence[float] | Array, form: str) -> str:
    """Return the ends of some values; one number if they are printed alike.

    Examples
    --------
    >>> spread([0.5, 0.25], ".2f"), spread([0.5, 0.501], ".2f")
    ('0.25 to 0.50', '0.50')
    """
    ends = dict.fromkeys(format(v, form) for v in (np.min(values), np.max(values)))
    return " to ".join(ends)


def unusual(measurement: Measurement) -> tuple[str, ...]:
    """Return notes on likely typing errors, and on values that hardly any room or no other pair has."""
    notes = [error.sentence for error in in_measurement(measurement)]
    pairs, frequencies = measurement.pairs, measurement.centre_frequencies
    for parameter, table in measurement.values.items():
        kind = observable(parameter)
        odd = np.argwhere((table < kind.usual[0]) | (table > kind.usual[1]))
        if not odd.size:
            notes += _far_from_others(measurement, parameter) if kind.unit == "s" else []
            continue
        i, k = odd[0]
        place = "" if measurement.is_summary else f"{' to '.join(pairs[i])} "
        more = f", and {len(odd) - 1} more" if len(odd) > 1 else ""
        notes.append(
            f"hardly any room has {kind.label} of {table[i, k]:g} {kind.unit} ({place}at "
            f"{bands.label(frequencies[k])}{more}): look whether the column, the unit or the decimal "
            "is another"
        )
    return tuple(notes)


def _far_from_others(measurement: Measurement, parameter: str) -> list[str]:
    """Return a note on times far from the median over the pairs of their band (`_FAR`)."""
    table, pairs, label = measurement.values[parameter], measurement.pairs, bands.label
    counts = np.isfinite(table).sum(axis=0)
    median = np.full(len(counts), np.inf)
    median[counts > 2] = np.nanmedian(table[:, counts > 2], axis=0)
    # Early parameters are short near a source.
    late = np.isfinite(median) & (observable(parameter) in REVERBERATION)
    least = np.where(late, median, 0.0) / _FAR
    found = [
        f"{table[i, k]:g} s ({' to '.join(pairs[i])} at {label(measurement.centre_frequencies[k])}; "
        f"median over the pairs {median[k]:.3g} s)"
        for i, k in np.argwhere((table > _FAR * median) | (table < least))
    ]
    if not found:
        return []
    return [
        f"{parameter_label(parameter)} is {_FAR:g} times as long as at the other pairs, or as short: "
        f"{text.first_of(found, MOST_NAMED)}. Look whether the decimal is another, and whether the "
        "row is a position"
    ]
