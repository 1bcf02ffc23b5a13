"""Two states of one room: ln T after less before, by pair.

Two measurements are compared with each other, so that neither the coefficients' prior nor a
configuration counts: it is no `rtcal.finder.Case`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MATCH, REVERBERATION, SUMMARY, parameter_label
from rtcal.acoustics.room import Directivity, Room
from rtcal.calibration.measured import notes_of_bands
from rtcal.finder.case import CLIMATE_UNCERTAINTY, checked_climate_uncertainty
from rtcal.simulators import base
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence, first_of
from rtcal.support.types import Array

_LEAST = 1e-6
"""Least standard uncertainty that is taken of a stated mean, of its share: none is exact."""


@dataclass(frozen=True, eq=False)
class Differences:
    """The differences of two states, in the room's bands.

    Attributes
    ----------
    centre_frequencies : array (n_bands,)
        Hz.
    before, after : array (n_bands,)
        Mean T20, or else T30, in s over the pairs that both states have.
    pairs : tuple of (source, receiver)
        ``(("*", "*"),)`` of means over positions.
    change : array (n_pairs, n_bands)
        ln(T after / T before); NaN where one is missing.
    variance : array (n_pairs, n_bands)
        Of the noise of ``change``: of both states.
    notes : tuple of str
        Bands and pairs that one state lacks, what is converted, and where the uncertainties
        come from.
    states : two Measurement
        What is compared: the pairs that both have, in the room's bands.
    """

    centre_frequencies: Array
    before: Array
    after: Array
    pairs: tuple[tuple[str, str], ...]
    change: Array
    variance: Array
    notes: tuple[str, ...]
    states: tuple[Measurement, Measurement]

    @classmethod
    def of(cls, room: Room, before: Measurement, after: Measurement) -> Differences:
        """Return the differences of two measurements in a room.

        A pair's noise is the larger of what is stated and of what theory expects of one decay,
        0.88 / sqrt(B T) for T20. The noise of a decay does not cancel: another absorption is another
        field. Measured in a laboratory whose panels were turned, the differences scatter by 0.9 to 1.3
        times the theory of both states.

        Raises
        ------
        DataError
            If the states have no pair in common, or no T20 or T30 in any band.
        """
        checks.instance("room", room, Room)
        checks.instance("before", before, Measurement)
        checks.instance("after", after, Measurement)
        wanted = room.centre_frequencies
        states = [m.in_bands(wanted) for m in (before, after)]
        pairs = [p for p in states[0].pairs if p in states[1].pairs]
        if not pairs:
            raise DataError(
                "before and after have no source and receiver in common; two states are measured at "
                f"the same positions, and these are {_pairs_of(before)} and {_pairs_of(after)}"
            )
        notes = _by_state(*("; ".join(notes_of_bands(room, m)) for m in (before, after)))
        for state, name in zip(states, ("before", "after"), strict=True):
            if others := [" to ".join(p) for p in state.pairs if p not in pairs]:
                notes.append(f"Only {name} has {first_of(others, 1)}: left out.")
        chosen = [m.select(pairs) for m in states]
        shape = (len(pairs), room.n_bands)
        change, variance = np.full(shape, np.nan), np.full(shape, np.nan)
        times, unstated = np.full((2, room.n_bands), np.nan), False
        for o in reversed(REVERBERATION):  # the first replaces the others
            if not all(o.key in m.values for m in chosen):
                continue
            values = [m.values[o.key] for m in chosen]
            both = np.isfinite(values[0]) & np.isfinite(values[1])
            some = both.any(axis=0)
            count = np.maximum(both.sum(axis=0), 1)
            means = [np.where(both, v, 0.0).sum(axis=0) / count for v in values]
            relative = np.zeros(shape)
            for m, v, mean in zip(chosen, values, means, strict=True):
                if m.is_summary:
                    u = np.fmax(m.mean_uncertainty(o.key)[np.newaxis] / v, _LEAST)
                    unstated |= o.key not in m.uncertainty and m.n_sources is None
                else:
                    theory = o.scatter(room.centre_frequencies, np.where(some, mean, np.nan))
                    stated = m.uncertainty.get(o.key, np.zeros(shape)) / v
                    u = np.fmax(theory, stated)
                relative = relative + u**2
            # Of states that are exchanged it is the same to the last digit, of the other sign.
            of_log = np.log(values[1]) - np.log(values[0])
            times[:, some] = np.array(means)[:, some]
            change[:, some] = np.where(both, of_log, np.nan)[:, some]
            variance[:, some] = np.where(both, relative, np.nan)[:, some]
        if not np.isfinite(change).any():
            labels = " or ".join(parameter_label(o.key) for o in REVERBERATION)
            raise DataError(
                f"no {labels} in any band of the room that before and after have in common"
            )
        if empty := np.flatnonzero(np.isnan(change).all(axis=1)).tolist():
            without = first_of([" to ".join(pairs[i]) for i in empty], 3)
            notes.append(f"No T of both states at {without}: left out.")
        if unstated:
            notes.append(
                "A mean T states neither its uncertainty nor of how many positions it is: it is taken "
                "as that of one position (ISO 3382-2). State either, or give the pairs."
            )
        named = (wanted, times[0], times[1], tuple(pairs))
        return cls(*named, change, variance, tuple(notes), (chosen[0], chosen[1]))

    @property
    def of_means(self) -> bool:
        """Whether they are of means over positions."""
        return self.pairs == ((SUMMARY, SUMMARY),)

    @property
    def same(self) -> bool:
        """Whether T of every pair is the same in both states, as of one file given twice."""
        return not np.nan_to_num(self.change).any()

    @property
    def falls(self) -> bool:
        """Whether T is shorter after than before, in the mean of ln T as far as each is known.

        Where the mean is 0, the first T that changed decides, so that states that are exchanged differ.
        """
        mean = np.nansum(self.change / self.variance)
        if mean == 0 and not self.same:
            mean = self.change[np.nan_to_num(self.change) != 0][0]
        return bool(mean <= 0)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """In which bands there is a difference, (n_bands,)."""
        return np.asarray(np.isfinite(self.change).any(axis=0))


def _by_state(before: str, after: str) -> list[str]:
    """Return the notes of each state as sentences; one, if it is the same of both.

    >>> _by_state("no T", "no T"), _by_state("", "no T")
    (['Before and after: no T.'], ['After: no T.'])
    """
    each = {"before and after": before} if before == after else {"before": before, "after": after}
    return [as_sentence(f"{state}: {note}") for state, note in each.items() if note]


def _pairs_of(measured: Measurement) -> str:
    """Return in words whether there are means, or the first pair and how many more."""
    if measured.is_summary:
        return "means over positions"
    return first_of([*map(" to ".join, measured.pairs)], 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class StatesCase:
    """A room that was measured twice, at the same positions with the same equipment.

    Parameters
    ----------
    room : Room
        Its volume, areas and air. Its coefficients do not count: the first state calibrates.
    before, after : Measurement
        Means over positions, or pairs. The pairs that both have are compared, source by source.
    equation : LinearEquation
        Turns T into an absorption area; Eyring's unless given. Sabine's overstates the change of a
        room that absorbs much.
    simulator : PathTracing, optional
        Of the same room, with every source's directivity: then surfaces are told apart.
    match : sequence of str
        Parameters that tell surfaces apart, where both states have them. Of the level, both states have
        one reference. Without a simulator T alone is compared.
    climate_uncertainty : (float, float)
        Standard uncertainties of a stated climate in K and in percent of relative humidity, in each of
        the two states. A room whose air is not stated may have any indoor climate in either.

    Attributes
    ----------
    differences : Differences
        What the two states differ by, in the room's bands.

    Raises
    ------
    DataError
        If no pair, or no T20 or T30 in a band of the room, is in both; if the simulator is of another
        room, or lacks a measured pair; for a ``match`` without a simulator, and an uncertainty of a
        climate that is not stated, which would have no effect.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1] * 2],
    ...                sigma=[[0.05] * 2], centre_frequencies=[500, 1000])
    >>> before = rt.Measurement.from_values([500, 1000], t20=[1.5, 1.4])
    >>> after = rt.Measurement.from_values([500, 1000], t20=[1.1, 0.9])
    >>> case = rt.finder.states.StatesCase(room=room, before=before, after=after)
    >>> print(case.differences.change.round(2))
    [[-0.31 -0.44]]
    """

    room: Room
    before: Measurement
    after: Measurement
    equation: LinearEquation = field(default_factory=Eyring)
    simulator: PathTracing | None = None
    match: Sequence[str] = MATCH
    climate_uncertainty: tuple[float, float] = CLIMATE_UNCERTAINTY
    differences: Differences = field(init=False)

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        checks.instance("before", self.before, Measurement).refuse_large_uncertainty()
        checks.instance("after", self.after, Measurement).refuse_large_uncertainty()
        checks.instance("equation", self.equation, LinearEquation)
        object.__setattr__(self, "match", base.checked_parameters(self.match))
        if self.simulator is None and self.match != base.checked_parameters(MATCH):
            raise DataError("match needs a simulator: without one T alone is compared")
        uncertain = checked_climate_uncertainty(self.climate_uncertainty)
        object.__setattr__(self, "climate_uncertainty", uncertain)
        if self.room.air is None and uncertain != CLIMATE_UNCERTAINTY:
            raise DataError(
                "climate_uncertainty is that of a stated climate, and the room states no air"
            )
        object.__setattr__(self, "differences", Differences.of(self.room, self.before, self.after))
        if self.simulator is not None:
            checks.instance("simulator", self.simulator, PathTracing)
            if self.simulator.room is not self.room:
                raise DataError("simulator is of another room; make it with this one")
            lacking = [p for p in self.differences.pairs if p not in self.simulator.pairs]
            if lacking:
                raise DataError(f"simulator lacks {' to '.join(lacking[0])}, which was measured")

    @property
    def sources_unstated(self) -> tuple[str, ...]:
        """The measured sources whose directivity is not stated, or unknown."""
        if self.simulator is None:
            return ()
        stated = self.simulator.directivity
        sources = dict.fromkeys(source for source, _ in self.differences.pairs)
        return tuple(s for s in sources if not isinstance(stated.get(s), Directivity))
