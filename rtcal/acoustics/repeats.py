"""Repeats are one position, which has their mean; data that were used before have one name.

Five sweeps at one microphone tell what one tells of the room: its positions are what differs. So the
repeats' mean counts as one value, and its stated uncertainty is the repeats' root mean square.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.observables import OBSERVABLES, parameter_label
from rtcal.acoustics.room import ARCHIVE, CHANGED, Room
from rtcal.support.errors import DataError
from rtcal.support.text import LOOKS, first_of, look_alike
from rtcal.support.types import Array

Pair = tuple[str, str]

_SAME = 1e-4
"""Largest difference of equal values, relative above 1: a program that converts changes less."""
_LEAST_COPIED = 3
"""Least number of values of a pair that is noted as a copy of another."""


def require_repeats(placed: Sequence[Pair], place: str) -> None:
    """Raise DataError for stated repeats where every place, (n_pairs,), is there once."""
    if len({*placed}) == len(placed):
        raise DataError(
            f"{place}: repeats=True changes nothing, since every source and receiver is there once; "
            "leave it out, or name a repeat after its place: S1-R1#2 repeats S1-R1"
        )


def fingerprint(kind: str, values: Mapping[str, float]) -> str:
    """Return the name of data as a room's record keeps it: the values themselves, NaN left out.

    Examples
    --------
    >>> fingerprint("T", {"500": 1.92, "1000": 1.8801})
    'T:500=1.92000,1000=1.88010'
    """
    return f"{kind}:" + ",".join(f"{k}={v:.5f}" for k, v in values.items() if math.isfinite(v))


def of_times(centre_frequencies: Array, times: Array) -> str:
    """Return the name of T in s, (n_bands,), in these bands in Hz."""
    labels = (f"{f:g}" for f in centre_frequencies.tolist())
    return fingerprint("T", dict(zip(labels, times.tolist(), strict=True)))


def of_pairs(
    parameter: str, pairs: Sequence[Pair], values: Array, centre_frequencies: Array
) -> str:
    """Return the name of a parameter's values at pairs, (n_pairs, n_bands)."""
    cells = {
        f"{'>'.join(quote(name, safe='') for name in pair)}@{f:g}": value
        for pair, row in zip(pairs, values.tolist(), strict=True)
        for f, value in zip(centre_frequencies.tolist(), row, strict=True)
    }
    return fingerprint(parameter, cells)


def times_of(room: Room) -> Array:
    """Return the T in s that a calibrated room's record names, (n_bands,); NaN where it names none.

    A record with several T, as of several configurations, names none of the room alone; nor does that
    of a room that was changed since.
    """
    times, record = np.full(room.n_bands, np.nan), room.calibration
    every = [] if record is None or record.method == CHANGED else record.measured.split()
    names = [name for name in every if name.partition(":")[0] not in OBSERVABLES]
    if len(names) != 1 or not names[0].startswith("T:"):
        return times
    cells = _cells(names[0])
    for k, frequency in enumerate(room.centre_frequencies.tolist()):
        try:
            times[k] = float(cells.get(f"{frequency:g}", "nan"))
        except ValueError:  # a record that was written by hand
            continue
    return times


def _cells(name: str) -> dict[str, str]:
    """Return the values of a name of data, as text by their labels."""
    return dict(c.partition("=")[::2] for c in name.partition(":")[2].split(",") if "=" in c)


def same_data(one: str, other: str) -> bool:
    """Whether two names are of the same data, or one of a part of the other's.

    Names are of the same data if all values that both have are equal to 1e-4, relative above 1, and
    these are at least two, or all that either has. Data that were rounded anew in between, or of which
    a value was replaced, are other data.

    Examples
    --------
    >>> same_data("T:500=1.92000", "T:500=1.92001"), same_data("T:500=1.92000", "T:500=1.93000")
    (True, False)
    >>> same_data("T:250=2.1,500=1.92,1000=1.7", "T:500=1.92,1000=1.7")
    True
    >>> same_data("T:250=2.1,500=1.92", "T:500=1.92,1000=1.7")
    False
    """
    return bool(_shared(one, other))


def _shared(one: str, other: str) -> list[str]:
    """Return the labels of the values that two names of the same data share; [] for other data."""
    if one.partition(":")[0] != other.partition(":")[0]:
        return []
    of_one, of_other = _cells(one), _cells(other)
    if one == other:
        return list(of_one) or [one]
    both = [label for label in of_one if label in of_other]
    least = 1 if of_one.keys() == of_other.keys() else 2
    equal = all(_equal(of_one[label], of_other[label]) for label in both)
    return both if equal and len(both) >= least else []


def _equal(one: str, other: str) -> bool:
    try:
        value, second = float(one), float(other)
    except ValueError:  # a record that was written by hand
        return one == other
    return bool(np.isclose(value, second, rtol=_SAME, atol=_SAME))


def refuse_repeated_data(room: Room, *names: str) -> None:
    """Raise DataError if the room was calibrated already on data of one of these names.

    A name may hold several names of data, with blanks between. The message names the shared values.
    """
    before = [] if room.calibration is None else room.calibration.measured.split()
    anew = [one for name in names for one in name.split()]
    found = ((new, _shared(new, old)) for old in before for new in anew)
    name, shared = next((each for each in found if each[1]), ("", []))
    if not shared:
        return
    what = first_of([_value_in_words(name.partition(":")[0], label) for label in shared], 3)
    if room.calibration is not None and room.calibration.method == ARCHIVE:
        raise DataError(
            f'room "{room.name}" has the coefficients of an archive that has learned from these '
            f"data ({what}); calibrating to them would count them twice. Leave their room out of the "
            "archive"
        )
    raise DataError(
        f'room "{room.name}" was already calibrated on these data ({what}); doing so again would '
        "count them twice. Take the room as it was before, or other data"
    )


def _value_in_words(kind: str, label: str) -> str:
    """Return a value's label in a name of data as a message names it.

    >>> _value_in_words("t20", "S1>R1@500"), _value_in_words("T", "500")
    ('T20 of S1 to R1 at 500 Hz', 'T at 500 Hz')
    """
    pair, _, band = label.rpartition("@")
    if pair:
        places = " to ".join(unquote(name) for name in pair.split(">"))
        return f"{parameter_label(kind)} of {places} at {band} Hz"
    if kind == "pairs":
        parameter, _, band = label.rpartition("-")
        return f"mean {parameter_label(parameter)} at {band} Hz"
    return f"{'mode' if kind == 'modes' else kind} at {band} Hz"


SAME_PLACE = 0.01
"""Distance in m within which two positions are one place: no microphone is put back more exactly."""
MOST_REPEATS = 1000
"""Largest number of repeats at one place that are numbered."""
_NUMBERED = re.compile(r"(.*\S)\s*#\d+", re.ASCII | re.DOTALL)


def of_names(names: Iterable[str]) -> dict[str, str]:
    """Return the place of each name that repeats another: ``R1#2`` repeats ``R1``.

    A number after # is a repeat's if a digit stands before it, or if the name without it is there,
    too. Three seats "Seat #1", "Seat #2" and "Seat #3" stay three.

    Examples
    --------
    >>> of_names(["R1", "R1#2", "Seat #1", "Seat #2"])
    {'R1#2': 'R1'}
    """
    every = dict.fromkeys(names)
    matches = {name: _NUMBERED.fullmatch(name) for name in every}
    return {
        name: match[1]
        for name, match in matches.items()
        if match and (match[1] in every or match[1][-1].isdigit())
    }


def of_points(points: Mapping[str, Sequence[float]]) -> dict[str, str]:
    """Return the place of each name whose point in m is that of an earlier name.

    Examples
    --------
    >>> of_points({"R1": (1, 2, 1.2), "R2": (1, 2, 1.2), "R3": (4, 2, 1.2)})
    {'R2': 'R1'}
    """
    first: dict[str, Array] = {}
    places = {}
    for name, point in points.items():
        here = np.asarray(point, dtype=float)
        near = (n for n, p in first.items() if np.linalg.norm(p - here) <= SAME_PLACE)
        if (place := next(near, None)) is None:
            first[name] = here
        else:
            places[name] = place
    return places


def names_of_repeats(receiver: str) -> Iterator[str]:
    """Yield the names of a receiver's repeats: ``R1``, ``R1#2``, ``R1#3`` and so on.

    Raises DataError after `MOST_REPEATS`.
    """
    yield receiver
    for n in range(2, MOST_REPEATS + 1):
        yield f"{receiver}#{n}"
    raise DataError(f'receiver "{receiver}" has more than {MOST_REPEATS} repeats')


def places_of(pairs: Sequence[Pair]) -> list[Pair]:
    """Return the place of each pair, (n_pairs,), by the names of sources and receivers.

    Raises DataError for names that look alike (`rtcal.support.text.look_alike`).
    """
    of_sources, of_receivers = (of_names(p[i] for p in pairs) for i in range(2))
    placed = [(of_sources.get(s, s), of_receivers.get(r, r)) for s, r in pairs]
    for kind, names in (("source", (s for s, _ in placed)), ("receiver", (r for _, r in placed))):
        if alike := look_alike(names):
            other, name = alike
            raise DataError(
                f'pairs has the {kind} "{other}" and the {kind} "{name}", {LOOKS}; repeats at one '
                f'place are "{other}" and "{other}#2"'
            )
    return placed


def groups(placed: Iterable[Pair]) -> dict[Pair, list[int]]:
    """Return the rows of each place, in the order of the places' first rows."""
    rows: dict[Pair, list[int]] = {}
    for i, pair in enumerate(placed):
        rows.setdefault(pair, []).append(i)
    return rows


def averaged(
    tables: Mapping[str, Array], rows: Mapping[Pair, Sequence[int]], name: str
) -> dict[str, Array]:
    """Return tables (n_pairs, n_bands) with one row per place: the mean of the values that are there.

    Of ``name`` "uncertainty" it is the root mean square: the repeats share the errors of their place.
    """
    power = 2 if name == "uncertainty" else 1
    out = {}
    for parameter, table in tables.items():
        of_place = np.full((len(rows), table.shape[1]), np.nan)
        for i, group in enumerate(rows.values()):
            values = table[list(group)] ** power
            there = np.isfinite(values).any(axis=0)
            of_place[i, there] = np.nanmean(values[:, there], axis=0) ** (1 / power)
        of_place.setflags(write=False)
        out[parameter] = of_place
    return out


def in_words(placed: Iterable[Pair]) -> list[str]:
    """Return a note on places that were measured several times; [] without any.

    Examples
    --------
    >>> in_words([("S1", "R1"), ("S1", "R1"), ("S1", "R2")])
    ['repeats of one place are averaged and count as one position: 2 of S1 to R1']
    """
    repeated = [(pair, len(rows)) for pair, rows in groups(placed).items() if len(rows) > 1]
    if not repeated:
        return []
    each = first_of([f"{n} of {' to '.join(pair)}" for pair, n in repeated], 4)
    return [f"repeats of one place are averaged and count as one position: {each}"]


def same_values(one: Array, other: Array) -> NDArray[np.bool_]:
    """Return which rows (n_rows, n_values) have equal values wherever both have one, three at least.

    Examples
    --------
    >>> t = np.array([[1.514, 1.411, 1.313], [1.514, 1.411, np.nan]])
    >>> same_values(t, t * 1.00001).tolist(), same_values(t, t * 1.001).tolist()
    ([True, False], [False, False])
    """
    known = np.isfinite(one) & np.isfinite(other)
    equal = np.isclose(one, other, rtol=_SAME, atol=_SAME)
    return np.asarray((equal | ~known).all(axis=1) & (known.sum(axis=1) >= _LEAST_COPIED))


def copies(pairs: Sequence[Pair], tables: Iterable[Array]) -> list[str]:
    """Return a note on pairs that have all values of another, three at least; [] without any.

    ``tables`` are (n_pairs, n_bands) by parameter.

    Examples
    --------
    >>> t = np.array([[1.514, 1.411, 1.313]] * 2)
    >>> copies([("S1", "R1"), ("S1", "R2")], [t])[0][:52]
    'the same values in every band: S1 to R2 and S1 to R1'
    """
    rows = np.hstack([*tables])
    first: dict[bytes, int] = {}
    copied = []
    for i, row in enumerate(np.nan_to_num(rows, nan=-np.inf)):
        j = first.setdefault(row.tobytes(), i)
        if j != i and np.isfinite(rows[i]).sum() >= _LEAST_COPIED:
            copied.append(" and ".join(" to ".join(pairs[k]) for k in (i, j)))
    if not copied:
        return []
    return [
        f"the same values in every band: {first_of(copied, 3)}. If one is a copy, leave it out, or "
        "name it as a repeat (R1#2 of R1): else it counts as a position of its own"
    ]
