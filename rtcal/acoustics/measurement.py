"""Measured or simulated room-acoustic parameters by source, receiver and band, and their file.

The native format is CSV, one row per value. An empty value is missing. Lines that begin with # are
notes::

    source,receiver,parameter,band,value
    S1,R1,T20,500,1.92

Parameters: T20, T30, EDT, Ts in s; C50, C80, G in dB; D50 and STI as fractions; the band in Hz.
Optional columns: ``uncertainty`` (standard uncertainty of the value) and ``common_uncertainty``
(beside it, the part that all pairs of a band have in common, the same in each of their rows). A row
over several pairs has source and receiver ``*``, and may have ``standard_deviation`` over the pairs,
``sources`` and ``receivers``. A receiver ``R1#2`` is a repeat of
``R1``: one position, with the repeats' mean.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import msgspec
import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables import (
    MARGIN_DB,
    OBSERVABLES,
    REVERBERATION,
    SUMMARY,
    TARGET,
    cut_off_db,
    observable,
    parameter_label,
    parameters,
)
from rtcal.files.disk import json_numbers, read_text, write_text
from rtcal.files.schema import TABLE, FileTable, Number, expecting, read
from rtcal.support import blocks, checks
from rtcal.support.blocks import Row, Table
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError, TooShortError, of_bands
from rtcal.support.text import decimal_comma, first_of
from rtcal.support.types import Array, put, read_only

MAX_POSITIONS = 12
"""Largest number of source-receiver pairs that lowers the uncertainty of a mean: the number that the
precision method of ISO 3382-2:2008, Table 1, requires."""


Pair = tuple[str, str]

SAME_PLACE = 0.01
"""Distance in m within which two positions count as one: no microphone is put back more exactly."""
MOST_REPEATS = 1000
"""Largest number of repeated measurements at one position."""
_NUMBERED = re.compile(r"(.*\S)\s*#\d+", re.ASCII | re.DOTALL)


def of_names(names: Iterable[str]) -> dict[str, str]:
    """Return the original name of each name that marks a repeat, such as ``R1`` for ``R1#2``.

    A number after # marks a repeat if the character before # is a digit, or if the name without the
    number is also among ``names``. "Seat #1", "Seat #2" and "Seat #3" alone are therefore three
    positions, and are not in the result.

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


def names_of_repeats(receiver: str) -> Iterator[str]:
    """Yield the names for repeated measurements at a receiver: ``R1``, ``R1#2``, ``R1#3`` and so on.

    Raises DataError after 1000 names (`MOST_REPEATS`).
    """
    yield receiver
    for n in range(2, MOST_REPEATS + 1):
        yield f"{receiver}#{n}"
    raise DataError(
        f'receiver "{receiver}" has more than {MOST_REPEATS} repeats, the largest number that is '
        "read"
    )


def places_of(pairs: Sequence[Pair]) -> list[Pair]:
    """Return the pairs (source, receiver) with the names of repeats replaced by the original names.

    For example, R1#2 becomes R1 (`of_names`). Raises DataError for names that differ only in upper
    case, blanks or the width of characters.
    """
    of_sources, of_receivers = (of_names(p[i] for p in pairs) for i in range(2))
    placed = [(of_sources.get(s, s), of_receivers.get(r, r)) for s, r in pairs]
    for kind, names in (("source", (s for s, _ in placed)), ("receiver", (r for _, r in placed))):
        if alike := checks.look_alike(names):
            other, name = alike
            raise DataError(
                f'pairs has the {kind} "{other}" and the {kind} "{name}", {checks.LOOKS}; if '
                f'they are repeats at one position, name them "{other}" and "{other}#2"'
            )
    return placed


def _mean_by_place(table: Array, placed: Sequence[Pair], power: int) -> Array:
    """Return a table (n_pairs, n_bands) with one row per place: the power mean of what is there."""
    row_of = {pair: i for i, pair in enumerate(dict.fromkeys(placed))}
    total, count = np.zeros((2, len(row_of), table.shape[1]))
    for pair, values in zip(placed, table, strict=True):
        there = np.isfinite(values)
        total[row_of[pair], there] += values[there] ** power
        count[row_of[pair]] += there
    with np.errstate(invalid="ignore"):
        return read_only((total / count) ** (1 / power))


def note_of_repeats(placed: Iterable[Pair]) -> list[str]:
    """Return a list with a note on pairs that occur several times, as repeats; empty without any.

    Examples
    --------
    >>> note_of_repeats([("S1", "R1"), ("S1", "R1"), ("S1", "R2")])
    ['repeats of one place are averaged and count as one position: 2 of S1 to R1']
    """
    repeated = [(pair, n) for pair, n in Counter(placed).items() if n > 1]
    if not repeated:
        return []
    each = first_of([f"{n} of {' to '.join(pair)}" for pair, n in repeated], 4)
    return [f"repeats of one place are averaged and count as one position: {each}"]


def require_repeats(placed: Sequence[Pair], place: str) -> None:
    """Raise DataError if each source-receiver pair of ``placed`` occurs only once.

    Call this if the user says that there are repeats. The message begins with ``place``.
    """
    if len({*placed}) == len(placed):
        raise DataError(
            f"{place}: repeats=True has no effect, because every source and receiver occurs "
            "once; leave it out, or name a repeat by its position: S1-R1#2 repeats S1-R1"
        )


class MeasurementTable(FileTable):
    """Measurement as plain values, as `Measurement.to_dict` returns them; None where missing."""

    values: dict[str, list[list[Number | None]]]
    centre_frequencies: list[Number] = []
    pairs: tuple[tuple[str, str], ...] = ((SUMMARY, SUMMARY),)
    uncertainty: dict[str, list[list[Number | None]]] = {}
    common_uncertainty: dict[str, list[Number | None]] = {}
    standard_deviation: dict[str, list[Number | None]] = {}
    n_sources: int | None = None
    n_receivers: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement:
    """Measured or simulated room-acoustic parameters, by source-receiver pair and band.

    Parameters
    ----------
    centre_frequencies : array (n_bands,)
        Centre frequencies in Hz, increasing.
    values : mapping of str to array (n_pairs, n_bands)
        Values of each parameter, such as ``"t20"`` (a key of
        `rtcal.acoustics.observables.OBSERVABLES`), in its unit. NaN stands for a missing value.
    pairs : sequence of (source, receiver)
        Names of source and receiver, (n_pairs,). The single pair ``("*", "*")`` marks a summary, whose
        values are means over several pairs. ``("S1", "R1#2")`` is a repeat of ``("S1", "R1")``; repeats
        are averaged to one pair.
    standard_deviation : mapping of str to array (n_bands,)
        Standard deviation over the pairs that a summary averages (not the uncertainty of the mean).
    uncertainty : mapping of str to array (n_pairs, n_bands)
        Stated standard uncertainty of each value, where the measurer knows it.
    common_uncertainty : mapping of str to array (n_bands,)
        Standard uncertainty that all pairs of a band have in common, in addition to ``uncertainty``:
        equipment, evaluation, climate. It does not average out.
    n_sources, n_receivers : int, optional
        Numbers of sources and receivers that a summary averages.

    Raises
    ------
    DataError
        For a wrong shape, an unknown parameter, an infinite value or a decay time not above 0.

    Examples
    --------
    >>> m = Measurement.from_values([500, 1000], t20=[1.9, 2.0])
    >>> m.reverberation_time.tolist()
    [1.9, 2.0]
    """

    centre_frequencies: Array
    values: Mapping[str, Array]
    pairs: Sequence[tuple[str, str]] = ((SUMMARY, SUMMARY),)
    standard_deviation: Mapping[str, Array] = field(default_factory=dict)
    uncertainty: Mapping[str, Array] = field(default_factory=dict)
    common_uncertainty: Mapping[str, Array] = field(default_factory=dict)
    n_sources: int | None = None
    n_receivers: int | None = None

    def __post_init__(self) -> None:
        put(
            self,
            centre_frequencies=read_only(bands.as_bands(self.centre_frequencies)),
            pairs=self._checked_pairs(),
        )
        for name in TABLES:
            tables = checks.mapped(f"measurement {name}", getattr(self, name))
            put(self, **{name: {p: self._checked(name, p, table) for p, table in tables.items()}})
        if not self.values:
            raise DataError("measurement: values is empty; give at least one parameter")
        put(self, **self._averaged(places_of(self.pairs)))
        self._check_summary()

    def _averaged(self, placed: Sequence[Pair]) -> dict[str, Any]:
        """Return the fields that differ if each row has the place ``placed``: a mean per place."""
        if tuple(placed) == self.pairs:
            return {}
        # The repeats share the errors of their place: those have their root mean square.
        means = {
            name: {p: _mean_by_place(t, placed, power) for p, t in getattr(self, name).items()}
            for name, power in (("values", 1), ("uncertainty", 2))
        }
        return {"pairs": tuple(dict.fromkeys(placed)), **means}

    def with_repeats(
        self,
        *,
        sources: Mapping[str, str] | None = None,
        receivers: Mapping[str, str] | None = None,
    ) -> Measurement:
        """Return the measurement with repeated measurements of one position averaged.

        Parameters
        ----------
        sources, receivers : mapping of str to str, optional
            Name of the position that each name repeats: ``receivers={"R2": "R1", "R3": "R1"}``.

        Raises
        ------
        DataError
            For a name that the measurement lacks.

        Examples
        --------
        >>> sweeps = Measurement(centre_frequencies=[500], values={"t20": [[1.0], [1.2]]},
        ...                      pairs=[("S1", "R1"), ("S1", "R2")])
        >>> print(sweeps.with_repeats(receivers={"R2": "R1"}).values["t20"])
        [[1.1]]
        """
        stated = {
            "sources": checks.text_by_name("sources", sources),
            "receivers": checks.text_by_name("receivers", receivers),
        }
        for i, (kind, of_kind) in enumerate(stated.items()):
            for name in of_kind:
                if name not in {pair[i] for pair in self.pairs}:
                    raise DataError(f'{kind} has "{name}", which is not in the measurement')
        of_source, of_receiver = stated.values()
        placed = [(of_source.get(s, s), of_receiver.get(r, r)) for s, r in self.pairs]
        return replace(self, **self._averaged(placed))

    def _checked_pairs(self) -> tuple[Pair, ...]:
        pairs = checks.pairs("pairs", self.pairs)
        for name in (name for pair in pairs for name in pair):
            text_name("pairs", name)
        if wrong := [source for source, _ in pairs if source.startswith("#")]:
            raise DataError(
                f'pairs has "{wrong[0]}"; a source must not begin with #, which begins a comment in a '
                "file"
            )
        if twice := [pair for pair, n in Counter(pairs).items() if n > 1]:
            raise DataError(
                f'pairs has {twice[0]} twice; name a repeat at the same position "{twice[0][1]}#2"'
            )
        return pairs

    def _check_summary(self) -> None:
        """Raise DataError for what only a summary may state, and for errors of what has no values."""
        counts = {"n_sources": self.n_sources, "n_receivers": self.n_receivers}
        stated = {name: n for name, n in counts.items() if n is not None}
        for name, n in stated.items():
            checks.whole(f"measurement: {name}", n, 1)
        if (self.standard_deviation or stated) and not self.is_summary:
            raise DataError(
                "measurement: a standard deviation over pairs, and numbers of sources and "
                f'receivers, are allowed only in a summary (source and receiver "{SUMMARY}"), '
                "not with single pairs"
            )
        if self.standard_deviation and len(stated) < len(counts):
            raise DataError(
                "measurement: a standard deviation over pairs needs the numbers of sources and "
                "receivers (n_sources, n_receivers), from which the uncertainty of the mean "
                "follows"
            )
        for name, p in [(table, p) for table in TABLES for p in getattr(self, table)]:
            if p not in self.values:
                raise DataError(
                    f"measurement {name}[{p}] is given without values[{p}]; add the values"
                )

    def _checked(self, name: str, parameter: str, value: Any) -> Array:
        kind, n_bands = observable(parameter), len(self.centre_frequencies)
        shape = (len(self.pairs), n_bands) if name in _OF_PAIRS else (n_bands,)
        array = checks.shaped(f"measurement {name}[{parameter}]", value, *shape)
        wrong, rule = array < 0, "finite and 0 or more"
        if name == "values":
            wrong = kind.broken(array)
            rule = f"finite and above 0 {kind.unit}" if kind.simulated else kind.rule
        checks.entries(
            partial(self._place, name, parameter), array, ~(np.isinf(array) | wrong), rule
        )
        return array

    def _place(self, name: str, parameter: str, *at: int) -> str:
        """Return the name of a value in messages; the last of its indices is that of its band."""
        return f"measurement {name}[{parameter}, {bands.label(self.centre_frequencies[at[-1]])}]"

    def __repr__(self) -> str:
        return f"<{self._description}>"

    def _repr_html_(self) -> str:
        """Return a table of each parameter's mean over the pairs ± its standard uncertainty."""
        rows = []
        for parameter in self.values:
            unit = f" / {OBSERVABLES[parameter].unit}".removesuffix(" / ")
            cells = []
            for m, u in zip(self.mean(parameter), self.mean_uncertainty(parameter), strict=True):
                plus = f" ± {u:.2g}" if np.isfinite(u) else ""
                cells.append(f"{m:.3g}{plus}" if np.isfinite(m) else "–")
            rows.append(Row(parameter_label(parameter) + unit, cells))
        labels = bands.labels(self.centre_frequencies)
        return blocks.notebook(self._description, [Table(labels, rows, corner="mean ± u")])

    def refuse_other_units(self) -> None:
        """Raise DataError for decay times in ms, and for uncertainties in percent.

        A decay time is taken to be in ms if it is longer than that of any room in s
        (`Observable.refuse`); short decay times are accepted. An uncertainty is taken to be in percent
        if it is larger than the value or than the parameter's whole range. Call this for measured data
        only: in a simulation with few paths the uncertainty can be as large, and a decay can have any
        length.
        """
        for parameter, table in self.values.items():
            kind, longest = observable(parameter), np.where(np.isfinite(table), table, -np.inf)
            k = int(longest.max(axis=0).argmax())
            place = f"{kind.label}[{bands.label(self.centre_frequencies[k])}]"
            kind.refuse(place, max(float(longest[:, k].max()), kind.limits[0]))
        for name in ("uncertainty", "common_uncertainty"):
            for parameter, stated in getattr(self, name).items():
                kind = observable(parameter)
                most = kind.largest_uncertainty(self.values[parameter])

                def rule(*at: int, most: Array = most, unit: str = kind.unit) -> str:
                    limit = f"{most[at]:g} {unit}".rstrip()
                    return f"at most {limit} there. Check that it is not in percent"

                checks.entries(
                    partial(self._place, name, parameter),
                    np.broadcast_to(stated, most.shape),
                    ~(stated > most),
                    rule,
                    kind.unit,
                )

    @property
    def _description(self) -> str:
        parameters = ", ".join(parameter_label(parameter) for parameter in self.values)
        n = len(self.pairs)
        pairs = "a summary" if self.is_summary else f"{n} pair{'s' * (n > 1)}"
        return f"Measurement of {parameters}: {pairs}, {bands.span(self.centre_frequencies)}"

    @property
    def is_summary(self) -> bool:
        """Whether the values are means over several source-receiver pairs."""
        return self.pairs == ((SUMMARY, SUMMARY),)

    @classmethod
    def from_values(
        cls, centre_frequencies: Sequence[float] | Array, **parameters: Sequence[float] | Array
    ) -> Measurement:
        """Return a measurement of one value per band: ``from_values([500, 1000], t20=[1.9, 2.0])``.

        The values count as means over several source-receiver pairs. Parameters are given by their
        keys, (n_bands,) each, NaN where missing. ``centre_frequencies`` (n_bands,) are in Hz.
        """
        return cls(
            centre_frequencies=checks.array("centre_frequencies", centre_frequencies),
            values={
                p: checks.array(f"measurement values[{p}]", v)[np.newaxis]
                for p, v in parameters.items()
            },
        )

    @classmethod
    def from_decays(
        cls,
        energy: Array,
        bin_width: float,
        centre_frequencies: Array,
        pairs: Sequence[tuple[str, str]],
        uncertainty: Mapping[str, Array] | None = None,
    ) -> Measurement:
        """Return the measurement with the room-acoustic parameters of energy decays.

        ``energy`` (n_pairs, n_bands, n_bins) is the energy in time bins of the width ``bin_width`` in
        s. ``centre_frequencies`` (n_bands,) are in Hz, and ``pairs`` are (source, receiver).
        ``uncertainty`` is the standard uncertainty of each parameter by its key, (n_pairs, n_bands);
        None if it is not known.

        Raises
        ------
        TooShortError
            If a decay is too short for T20. Without this error the pair would be missing in the mean.
        DataError
            If a decay has no T20 at all, because nothing is reflected.
        """
        f, pairs = bands.as_bands(centre_frequencies), checks.pairs("pairs", pairs)
        energy = checks.shaped("energy", energy, len(pairs), len(f), "n_bins")
        values = parameters(energy, bin_width)
        lost = np.isnan(values[TARGET.key])
        short = lost & TARGET.too_short(energy)
        if lost.any():
            pair, band = np.argwhere(short if short.any() else lost)[0].tolist()
            where = f"the decay from {' to '.join(pairs[pair])}, {bands.label(f[band])}"
            if not short.any():
                error = DataError(f"{where} has no {TARGET.label}: too little sound is reflected")
                raise of_bands(error, np.flatnonzero(lost.any(axis=0)))
            down = max(0.0, -float(cut_off_db(energy)[pair, band]))
            raise TooShortError(
                f"{where} is too short for {TARGET.label}: in {energy.shape[-1] * bin_width:.3g} s it "
                f"falls by {down:.0f} dB, but {TARGET.label} needs "
                f"{MARGIN_DB - TARGET.lower:.0f} dB. Simulate a longer decay"
            )
        return cls(centre_frequencies=f, values=values, pairs=pairs, uncertainty=uncertainty or {})

    def mean(self, parameter: str) -> Array:
        """Return a parameter's arithmetic mean over the pairs that have it, (n_bands,), else NaN.

        ``parameter`` is a key, such as ``"t20"``. Raises DataError for a name that is no parameter.
        """
        observable(parameter)
        if parameter not in self.values:
            return np.full(len(self.centre_frequencies), np.nan)
        values = self.values[parameter]
        count = np.sum(np.isfinite(values), axis=0)
        total = np.nansum(values, axis=0)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    @property
    def time_label(self) -> str:
        """Name of the reverberation time that a calibration matches: T20, T30, or both."""
        used = {parameter_label(p) for p in self.reverberation_parameter if p}
        return " and ".join(sorted(used)) or TARGET.label

    def mean_uncertainty(self, parameter: str) -> Array:
        """Return the standard uncertainty u of a parameter's `mean`, (n_bands,), NaN where unknown.

        ``parameter`` is a key, such as ``"t20"``. u is calculated for each band as follows.

        - If every value states a standard uncertainty u_i, u² = sum u_i² / N² for N pairs, because the
          errors count as independent.
        - Otherwise u² = s² / n_eff, with the standard deviation s over the pairs. n_eff is the larger
          of the numbers of sources and of receivers, because pairs that share a source are not
          independent. For T20 and T30, u² is at least the variance of ISO 3382-2:2008, Eqs. 4 and 5,
          for N pairs and 10 decays. n_eff and N count as at most 12 (`MAX_POSITIONS`), because all
          pairs share errors of equipment, evaluation and climate, which do not average out.
        - A common uncertainty adds its square to u². If the values state u_i as well, u² without the
          common uncertainty is at least s² / n_eff.

        For T = 1 s, N = 12 and octaves, ISO 3382-2's variance gives u of 2.9 % (125 Hz) to 0.5 % (4
        kHz). Between teams, T30 at one pair in the music studio of the PTB had standard deviations of
        4.6 % (125 Hz) to 1.3 % (4 kHz) (Bork 2005). State the uncertainty where teams or days are to be
        compared.

        References
        ----------
        I. Bork, Report on the 3rd round robin on room acoustical computer simulation, Part I:
        Measurements, Acta Acustica united with Acustica 91, 740-752 (2005).
        """
        mean = self.mean(parameter)
        if parameter not in self.values:
            return mean
        measured = np.isfinite(self.values[parameter])
        count = np.sum(measured, axis=0)
        spread, n_effective, positions = self._spread(parameter)
        n_effective, positions = (np.minimum(n, MAX_POSITIONS) for n in (n_effective, positions))
        several, n_effective = n_effective > 1, np.maximum(n_effective, 1)
        iso = observable(parameter).variance_of_mean(self.centre_frequencies, mean, positions)
        variance = np.fmax(np.where(several, spread**2 / n_effective, np.nan), iso)
        uncertainty = np.where(count > 0, np.sqrt(variance), np.nan)
        common = self.common_uncertainty.get(parameter)
        if parameter in self.uncertainty:
            stated = np.where(measured, self.uncertainty[parameter], 0.0)
            of_mean = np.sqrt(np.sum(stated**2, axis=0)) / np.maximum(count, 1)
            if common is not None:
                scattered = np.where(several, spread / np.sqrt(n_effective), 0)
                of_mean = np.maximum(of_mean, scattered)  # NaN where a pair states none
            uncertainty = np.where((count > 0) & np.isfinite(of_mean), of_mean, uncertainty)
        return uncertainty if common is None else np.hypot(uncertainty, np.nan_to_num(common))

    def _spread(self, parameter: str) -> tuple[Array, Array, Array]:
        """Standard deviation over pairs, effective number and number of pairs, each (n_bands,)."""
        values = self.values[parameter]
        none = np.full(values.shape[1], np.nan)
        if self.is_summary:
            n = self.n_sources or 1, self.n_receivers or 1
            spread = self.standard_deviation.get(parameter, none)
            return (
                np.asarray(spread),
                np.full(none.shape, float(max(n))),
                np.full(none.shape, float(n[0] * n[1])),
            )
        measured = np.isfinite(values)
        names = [np.array(each) for each in zip(*self.pairs, strict=True)]
        effective = [max(len({*each[used]}) for each in names) for used in measured.T]
        count = np.sum(measured, axis=0).astype(float)
        squares = np.sum(np.where(measured, values - self.mean(parameter), 0.0) ** 2, axis=0)
        several = count > 1
        spread = np.where(several, np.sqrt(squares / np.where(several, count - 1, 1)), np.nan)
        return spread, np.array(effective, dtype=float), count

    def only(self, parameters: Collection[str]) -> Measurement:
        """Return the measurement with some of its parameters, by their keys."""
        tables: dict[str, Any] = {
            name: {p: v for p, v in getattr(self, name).items() if p in parameters}
            for name in TABLES
        }
        return replace(self, **tables)

    def select(self, pairs: Iterable[tuple[str, str]]) -> Measurement:
        """Return the measurement at some source-receiver pairs, in the given order.

        ``pairs`` are (source, receiver). Raises DataError for a pair that the measurement lacks, and if
        no pair is given.

        Examples
        --------
        >>> both = Measurement(centre_frequencies=[500], values={"t20": [[1.0], [1.2]]},
        ...                    pairs=[("S1", "R1"), ("S1", "R2")])
        >>> both.select([("S1", "R2")]).mean("t20").tolist()
        [1.2]
        """
        wanted = checks.pairs("pairs", pairs)
        if not wanted:
            raise DataError("pairs is empty; a measurement must have at least one pair")
        if lacking := [pair for pair in wanted if pair not in self.pairs]:
            raise DataError(f"pairs has {' to '.join(lacking[0])}, which is not in the measurement")
        rows = [self.pairs.index(pair) for pair in wanted]
        values, uncertainty = (
            {p: table[rows] for p, table in tables.items()}
            for tables in (self.values, self.uncertainty)
        )
        return replace(self, pairs=wanted, values=values, uncertainty=uncertainty)

    def in_bands(self, wanted: Iterable[float]) -> Measurement:
        """Return the measurement in the wanted bands, given in Hz, with NaN in bands without a value.

        Third-octaves and octaves are converted into each other by `rtcal.acoustics.bands.Conversion`;
        the standard deviation over pairs is converted like an uncertainty. Raises DataError if no band
        can be selected or converted.

        Examples
        --------
        >>> thirds = Measurement.from_values([400, 500, 630], t20=[1.0, 2.0, 2.0])
        >>> thirds.in_bands([500, 1000]).values["t20"].tolist()
        [[1.5, nan]]
        """
        if np.array_equal(self.centre_frequencies, wanted):  # type: ignore[arg-type]
            return self
        conversion = bands.Conversion(self.centre_frequencies, wanted, missing=True)
        if not bands.obtainable(conversion.old, conversion.new).size:
            raise DataError(
                f"the measurement ({bands.hertz(conversion.old)}) and the room "
                f"({bands.hertz(conversion.new)}) have no band in common"
            )
        tables: dict[str, Any] = {name: {} for name in TABLES}
        for name, p in [(table, p) for table in TABLES for p in getattr(self, table)]:
            table, scale = getattr(self, name)[p], observable(p).averaging
            if name == "values":
                tables[name][p] = conversion.mean(table, scale)
            else:  # beside the values or, if all pairs of a band have it, beside their mean
                beside = self.values[p] if name in _OF_PAIRS else self.mean(p)
                tables[name][p] = conversion.uncertainty(table, beside, scale)
        return replace(self, centre_frequencies=conversion.new, **tables)

    @cached_property
    def reverberation_parameter(self) -> tuple[str, ...]:
        """Key of the T that a calibration matches, by band: ``"t20"``, else ``"t30"``, else ``""``.

        EDT is never matched, because it depends on the early sound and the source's directivity, for
        which absorption coefficients must not compensate.
        """
        known = {o.key: np.isfinite(self.mean(o.key)) for o in REVERBERATION}
        each = range(len(self.centre_frequencies))
        return tuple(next((name for name, at in known.items() if at[k]), "") for k in each)

    @property
    def reverberation_time(self) -> Array:
        """T that a calibration matches in s, (n_bands,): T20, or T30 without it; NaN where missing."""
        return self._matched(self.mean)

    @property
    def reverberation_time_uncertainty(self) -> Array:
        """Standard uncertainty of `reverberation_time` in s, (n_bands,); NaN where it is unknown."""
        return self._matched(self.mean_uncertainty)

    def _matched(self, of: Callable[[str], Array]) -> Array:
        names = self.reverberation_parameter
        each = {name: of(name) for name in {*names} - {""}}
        return np.array([each[name][k] if name else np.nan for k, name in enumerate(names)])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, which `from_dict` reads; None where a value is missing."""
        tables = {
            name: {p: json_numbers(values) for p, values in getattr(self, name).items()}
            for name in TABLES
            if name != "common_uncertainty" or self.common_uncertainty
        }
        return {
            "centre_frequencies": json_numbers(self.centre_frequencies),
            "pairs": [list(pair) for pair in self.pairs],
            **tables,
            "n_sources": self.n_sources,
            "n_receivers": self.n_receivers,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Measurement:
        """Return the measurement from plain values, as `to_dict` returns them.

        Raises DataError for an unknown key, a value that is no number, and for the reasons of
        `Measurement`.
        """
        return cls(**msgspec.structs.asdict(read(MeasurementTable, data, "measurement")))

    @classmethod
    def from_file(cls, path: str) -> Measurement:
        """Read a measurement from a CSV file; `rtcal.acoustics.measurement` describes its format."""
        with expecting(TABLE, checks.path("path", path)):
            text = read_text(path, MAX_BYTES)
            try:
                rows = _rows_of(text)
            except _HeaderError as error:
                raise DataError(
                    f"{error}. If the table has another layout, read it with `rtcal table {path}`"
                ) from error
        try:
            return cls(**of_single_values(rows))
        except DataError as error:
            raise DataError(f"{path}: {error}") from error

    def to_text(self) -> str:
        """Return the measurement as the text of a CSV file, from which the same numbers are read."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        for row in self.rows():
            cells = []
            for value in row:
                if isinstance(value, str) and value.startswith(("=", "+", "-", "@")):
                    value = f" {value}"  # Excel would take it for a formula; readers drop the blank
                cells.append(repr(value) if isinstance(value, float) else value)
            writer.writerow(cells)
        return stream.getvalue()

    def rows(self) -> list[list[Any]]:
        """Return the rows of the measurement's CSV file: the header, and a row per value."""
        counts = {"sources": self.n_sources, "receivers": self.n_receivers}
        used = [c for c in _OPTIONAL_COLUMNS if getattr(self, c, None) or counts.get(c) is not None]
        table: list[list[Any]] = [[*_COLUMNS, *used]]
        bands_of = json_numbers(self.centre_frequencies)
        for parameter, values in self.values.items():
            beside: list[Any] = []
            for column in used:
                of = getattr(self, column, {}).get(parameter, np.nan)
                cells = json_numbers(np.broadcast_to(of, values.shape))
                beside.append([[counts.get(column, c) for c in row] for row in cells])
            for i, (pair, row) in enumerate(zip(self.pairs, json_numbers(values), strict=True)):
                for k, (band, value) in enumerate(zip(bands_of, row, strict=True)):
                    table.append(
                        [*pair, parameter.upper(), band, value, *(b[i][k] for b in beside)]
                    )
        return table

    def save(self, path: str) -> None:
        """Write the measurement to a CSV file; an error leaves no incomplete file."""
        write_text(path, self.to_text())


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_COLUMNS = ("source", "receiver", "parameter", "band", "value")
_OPTIONAL_COLUMNS = (
    "uncertainty",
    "common_uncertainty",
    "standard_deviation",
    "sources",
    "receivers",
)

_OF_PAIRS = ("values", "uncertainty")
TABLES = (*_OF_PAIRS, "common_uncertainty", "standard_deviation")
MAX_BYTES = 2**21
MAX_CELLS = 2**20
"""Largest number of values in a file: pairs times bands times parameters. Most may be empty."""


Place = tuple[str, str, str, float]
"""Source, receiver, parameter and band in Hz of a value."""


class _HeaderError(DataError):
    """Report a header of other columns: the table may have another layout."""


def _rows_of(text: str) -> dict[Place, dict[str, float]]:
    """Return the rows of a CSV file's text."""
    header: list[str] = []
    rows: dict[Place, dict[str, float]] = {}
    # Not splitlines: it would also split at separators that may stand in a name.
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            cells = [cell.strip() for cell in next(csv.reader([line], strict=True))]
            if not header:
                header = _header([cell.lower() for cell in cells], line)
                continue
            if len(cells) != len(header):
                raise DataError(
                    f"this row has {len(cells)} cells, but the header has {len(header)}"
                )
            key, numbers = _row(dict(zip(header, cells, strict=True)))
            if key in rows:
                cure = f"If it is a repeat, name its receiver {key[1]}#2"
                raise DataError(
                    f"{parameter_label(key[2])} of {key[0]}, {key[1]} at "
                    f"{bands.label(key[3])} is given twice. "
                    f"{'Delete one of the means' if SUMMARY in key else cure}"
                )
        except csv.Error as error:
            raise DataError(
                f"line {number}: not a line of comma-separated values: {error}"
            ) from error
        except DataError as error:
            raise type(error)(f"line {number}: {error}") from error
        rows[key] = numbers
    if not header:
        raise _HeaderError(f"no rows; the first row must name the columns {', '.join(_COLUMNS)}")
    if not rows:
        raise DataError("no row with a value below the header")
    return rows


def _header(header: list[str], line: str) -> list[str]:
    """Return the columns of a header; DataError for one that is missing, unknown or given twice."""
    if repeated := next((c for c, n in Counter(header).items() if n > 1), None):
        raise _HeaderError(f'column "{repeated}" is given twice')
    allowed = _COLUMNS + _OPTIONAL_COLUMNS
    if missing := [column for column in _COLUMNS if column not in header]:
        other = {s: n for s, n in ((";", '";"'), ("\t", "tabs")) if line.count(s) > line.count(",")}
        why = [f', since columns are separated by {n} and not by ","' for n in other.values()]
        raise _HeaderError(f'column "{missing[0]}" is missing{"".join(why[:1])}')
    if unknown := [column for column in header if column not in allowed]:
        raise _HeaderError(
            f'column "{unknown[0]}" is not known; columns may be {", ".join(allowed)}'
        )
    return header


def _row(cell: Mapping[str, str]) -> tuple[Place, dict[str, float]]:
    parameter = cell["parameter"].lower()
    if parameter not in OBSERVABLES:
        allowed = ", ".join(OBSERVABLES)
        raise DataError(f'parameter "{cell["parameter"]}" is unknown; known: {allowed}')
    band = _number(cell, "band")
    if not band > 0:
        raise DataError(f'band = "{cell["band"]}" must be a frequency above 0 Hz')
    numbers = {c: _number(cell, c) for c in ("value", *_OPTIONAL_COLUMNS) if c in cell}
    OBSERVABLES[parameter].refuse(cell["parameter"], numbers["value"])
    for column in _OPTIONAL_COLUMNS:
        if numbers.get(column, 0.0) < 0:
            raise DataError(f"{column} = {numbers[column]:g} must be 0 or more")
    return (cell["source"], cell["receiver"], parameter, bands.nominal(band)), numbers


def _number(cell: Mapping[str, str], column: str) -> float:
    text = cell[column]
    if not text:
        return float("nan")
    if text.lower().lstrip("+-") in ("inf", "infinity", "nan"):
        raise DataError(f'{column} = "{text}" is not finite; leave a missing value empty')
    if not _NUMBER.fullmatch(text) or not np.isfinite(float(text)):
        raise DataError(f'{column} = "{text[:40]}" must be a number{decimal_comma(text)}')
    return float(text)


def of_single_values(
    rows: Mapping[Place, Mapping[str, float]],
) -> dict[str, Any]:
    """Return the arguments of `Measurement` from single values by source, receiver, parameter and band.

    ``rows`` has for each (source, receiver, parameter, frequency in Hz) the entry ``value`` and those
    of the file's optional columns, such as the uncertainty. A value that no row has is NaN.
    """
    frequencies = {f: k for k, f in enumerate(sorted({key[3] for key in rows}))}
    pairs = {pair: i for i, pair in enumerate(dict.fromkeys(key[:2] for key in rows))}
    parameters = list(dict.fromkeys(key[2] for key in rows))
    if (SUMMARY, SUMMARY) in pairs and len(pairs) > 1:
        raise DataError(
            f'the file has summary rows (source and receiver "{SUMMARY}") and single pairs; keep '
            "only one kind"
        )
    shape = (len(pairs), len(frequencies))
    if shape[0] * shape[1] * len(parameters) > MAX_CELLS:
        raise DataError(
            f"{shape[0]} pairs, {shape[1]} bands and {len(parameters)} parameters make more than "
            f"{MAX_CELLS} values, the largest number that is read"
        )
    tables: dict[str, dict[str, Array]] = {c: {} for c in ("value", *_OPTIONAL_COLUMNS)}
    for (source, receiver, parameter, band), numbers in rows.items():
        for column, number in numbers.items():
            if column == "value" or np.isfinite(number):
                table = tables[column].setdefault(parameter, np.full(shape, np.nan))
                table[pairs[source, receiver], frequencies[band]] = number
    counts = {}
    for name in ("sources", "receivers"):
        every = np.concatenate([[np.nan], *(table.ravel() for table in tables[name].values())])
        least, most = np.fmin.reduce(every), np.fmax.reduce(every)
        if least < most:
            raise DataError(
                f"column {name} has different values; it must have the same value in all rows"
            )
        if most < 1 or most % 1 > 0:
            raise DataError(f"column {name} = {most:g} must be a whole number above 0")
        counts[f"n_{name}"] = int(most) if np.isfinite(most) else None
    of_bands: dict[str, dict[str, Array]] = {}
    for name in ("common_uncertainty", "standard_deviation"):
        of_bands[name] = {p: np.fmax.reduce(table) for p, table in tables[name].items()}
        for p, most in of_bands[name].items():
            if (differing := np.fmin.reduce(tables[name][p]) < most).any():
                label = bands.label(list(frequencies)[int(np.argmax(differing))])
                raise DataError(
                    f"{name} of {parameter_label(p)} at {label} has different values; in a "
                    "band it must have the same value for all pairs"
                )
    return {
        "centre_frequencies": np.array(list(frequencies)),
        "pairs": list(pairs),
        "values": tables["value"],
        "uncertainty": tables["uncertainty"],
        **of_bands,
        **counts,
    }
