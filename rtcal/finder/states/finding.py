"""The finding of two states: what changed between two measurements of one room."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rtcal.acoustics import bands
from rtcal.files.disk import json_numbers
from rtcal.finder.claim import CLAIMED, Names, over_frequency
from rtcal.finder.finding import LEAST_PAIRS, NATS, Finding, Size, amount
from rtcal.finder.prior import NONE
from rtcal.finder.states.case import StatesCase
from rtcal.finder.states.evidence import ADDED
from rtcal.support.blocks import Block, Note, Table
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence, listed
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.finder.corrected import Corrected


def decimals(change: Array) -> int:
    """Return the decimals with which changes (3, n_bands) are printed: the interval shows its width.

    Examples
    --------
    >>> decimals(np.array([[10.0], [8.0], [13.0]])), decimals(np.array([[0.04], [-0.01], [0.09]]))
    (1, 2)
    """
    width = change[2] - change[1]
    known = width[np.isfinite(width) & (width > 0)]
    if not len(known):
        return 1
    return int(np.clip(np.ceil(-np.log10(known.min() / 2)), 1, 6))


def interval(change: Array, digits: int) -> str:
    """Return a change (3,) in m² with its 90 % interval; that nothing was tried, where it is NaN.

    Examples
    --------
    >>> interval(np.array([10.0, 8.0, 13.0]), 1)
    '+10.0 (+8.0 to +13.0)'
    """
    if not np.isfinite(change).all():
        return "not tried"
    mean, low, high = (f"{value:+.{digits}f}" for value in change)
    return f"{mean} ({low} to {high})"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StatesFinding(Finding):
    """The change between two states of a room; attributes beside those of `Finding`.

    The verdict is "family" where something changed and what, such as "added absorption, rising", has a
    probability of at least 0.9; "named" where that is the climate alone, which then explains T by
    chi-square; "ambiguous" where it is not told.

    Two states that are exchanged have the same finding, but for "added" and "removed", which are
    exchanged, and all changes, which have the other sign.

    The score is the log evidence that something changed over that nothing did. Where nothing changed,
    and the noise is as assumed, it exceeds the threshold ln 20 in at most one of twenty cases, whatever
    was measured: the mean of a likelihood ratio is then 1.

    Attributes
    ----------
    case : Case
    candidates : tuple of Candidate
        The kinds of change whose probability is at least 0.03, the most probable first: "added porous".
        Each size is the change of the absorption area in m², mean over the bands of ``middle``.
    area : array (n_bands,)
        The surfaces' absorption area before in m², by the equation; NaN where T is missing.
    change : array (3, n_bands)
        Its change in m², if absorption was added or removed: mean and both ends of the 90 % interval.
        NaN where that was not tried.
    shift : array (n_bands,)
        Mean of ln(T after / T before) if something changed, by absorption and by climate.
    size : Size
        The change as mean over the bands of ``middle``, in m².
    middle : tuple of float
        Bands in Hz: those of 500 Hz to 2 kHz, or all where none of them was measured.
    surfaces : mapping of str to float
        Probability of each surface that something changed on it; empty where none is told.
    sets : mapping of (names of surfaces) to float
        Sets of surfaces that changed together, the most probable first.
    climate : float
        Probability that the climate of the air is another as well, if absorption was added or removed.
    left_out : tuple of str
        What was not tried.
    """

    record_kind: ClassVar[str] = "finding of two states 2"

    case: StatesCase
    area: Array
    change: Array
    shift: Array
    size: Size
    middle: tuple[float, ...]
    surfaces: Mapping[str, float]
    sets: Mapping[Names, float]
    climate: float
    left_out: tuple[str, ...]

    @property
    def can_be_added(self) -> bool:
        """Whether `apply` has something to add: absorption that changed."""
        return self.reason_for_none is None

    @property
    def can_be_verified(self) -> bool:
        """Whether half of the pairs can predict the others."""
        return self.detected and len(self.case.differences.pairs) >= LEAST_PAIRS

    @property
    def reason_for_none(self) -> str | None:
        """Why there is no changed room, in a sentence; None where there is one."""
        if not self.detected:
            return f"{self.headline} There is nothing to add to the room."
        if self.family == "climate":
            return (
                "The climate of the air changed: state temperature and humidity in the room's file."
            )
        return None

    def apply(self) -> Corrected:
        """Return the room of the second state, to calibrate, export and predict with.

        Raises
        ------
        DataError
            Where nothing changed, or the climate alone.

        Examples
        --------
        >>> import rtcal as rt
        >>> room = rt.Room(name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1] * 2],
        ...                sigma=[[0.05] * 2], centre_frequencies=[500, 1000], air=rt.Air())
        >>> t = {"before": [[1.5, 1.4]], "after": [[0.9, 0.7]]}
        >>> before, after = (
        ...     rt.Measurement(centre_frequencies=[500, 1000], values={"t20": v}, n_sources=6,
        ...                    n_receivers=6) for v in t.values())
        >>> changed = rt.find(room, after, before=before).apply()
        >>> now = rt.Eyring().reverberation_time(changed.room)
        >>> print(abs(now / [0.9, 0.7] - 1) < 0.1)  # within 10 %
        [ True  True]
        """
        from rtcal.finder.corrected import changed_room

        if self.reason_for_none is not None:
            raise DataError(self.reason_for_none)
        kinds = [c.effect for c in self.candidates]
        return changed_room(self.case, self.area, self.change, self.claimed_surfaces, kinds)

    @property
    def claimed_surfaces(self) -> tuple[str, ...]:
        """The surfaces that are claimed: something changed on each, at a probability of 0.9."""
        return tuple(name for name, p in self.surfaces.items() if p >= CLAIMED)

    @property
    def what(self) -> str:
        """The change in words: more or less absorption, its spectrum and its amount."""
        if self.verdict == NONE:
            return "nothing"
        if self.family == "climate":
            return "another climate of the air, and nothing else"
        if not np.isfinite(self.size.mean):  # nothing but the climate was tried
            return "another climate of the air"
        added = self.families.get(f"{ADDED} absorption", 0.0)
        said = f"{'more' if added > (1 - self.probabilities[NONE]) / 2 else 'less'} absorption"
        said += f", {self.spectrum}" if self.spectrum else ""
        low, high = sorted((abs(self.size.low), abs(self.size.high)))
        size = amount(abs(self.size.mean), "m²", (low, high))
        at = bands.label(self.middle[0])
        if len(self.middle) > 1:
            at = f"{self.middle[0]:g} to {self.middle[-1]:g} Hz"
        return f"{said}; {size} at {at}"

    @property
    def spectrum(self) -> str:
        """The trend of the change over frequency: rising, falling or alike; "" of a single band."""
        change = self.change[0][np.isfinite(self.change[0])]
        return over_frequency(change) if len(change) > 1 else ""

    @property
    def headline(self) -> str:
        """The doubt that leads, the verdict, and how probable it is that nothing changed."""
        said = {
            NONE: "Nothing changed beyond the noise of both measurements.",
            "hint": f"A hint, not claimed{self.or_nothing}: {self.what}.",
        }.get(self.verdict, f"Changed{self.or_nothing}: {self.what}.")
        if self.claimed_surfaces:
            names = [f'"{name}"' for name in self.claimed_surfaces]
            said += f" It is on {listed(names)}."
        if not self.or_nothing:
            said += f" The probability that nothing changed is {self.percent(NONE)}."
        return " ".join([*self.reasons, said])

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is not told apart, a climate that changed as well, where else, the score, and notes."""
        said, changed = list[str](), self.verdict != NONE
        kinds = [f"{c.effect} ({100 * c.probability:.0f} %)" for c in self.candidates]
        if changed and len(kinds) > 1:
            said.append(f"Not told apart by T: {listed(kinds)}.")
        if changed and self.family != "climate" and self.climate >= 0.5:
            share = 100 * self.climate
            said.append(f"Another climate of the air explains a part of it ({share:.0f} %).")
        some = [
            f'"{name}" ({100 * p:.0f} %)'
            for name, p in self.surfaces.items()
            if 1 - CLAIMED <= p < CLAIMED
        ]
        if some:
            together = "Several may have changed together, so these need not add up to 100 %."
            said.append(f"It may be on {listed(some)} as well. {together}")
        score = (
            f"Evidence that something changed: {self.score:+z.1f} nats; threshold "
            f"{self.threshold:.1f} nats."
        )
        return (*said, score, *self.notes)

    def blocks(self) -> list[Block]:
        """Return what the result says."""
        found, digits = self.case.differences, decimals(self.change)
        measured = np.flatnonzero(found.measured).tolist()
        columns = {
            "T / s": [f"{found.before[k]:.2f}" for k in measured],
            "after / s": [f"{found.after[k]:.2f}" for k in measured],
            "area / m²": [f"{self.area[k]:.1f}" for k in measured],
            "change / m² (90 %)": [interval(self.change[:, k], digits) for k in measured],
        }
        names = bands.labels(found.centre_frequencies[measured])
        notes = (*self.sentences, as_sentence(NATS))
        return [Note(self.headline), Table.of_columns(names, columns), *map(Note, notes)]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        found = self.case.differences
        return {
            **super().to_dict(),
            "surfaces": dict(self.surfaces),
            "claimed_surfaces": list(self.claimed_surfaces),
            "sets": [
                {"surfaces": list(names), "probability": p}
                for names, p in islice(self.sets.items(), 20)
            ],
            "size": self.size.to_dict(),
            "bands_of_size": list(self.middle),
            "kinds": [
                {
                    "name": c.effect,
                    "family": c.family,
                    "probability": c.probability,
                    "size": Size(c.size, c.low, c.high, c.unit).to_dict(),
                }
                for c in self.candidates
            ],
            "centre_frequencies": json_numbers(found.centre_frequencies),
            "before": json_numbers(found.before),
            "after": json_numbers(found.after),
            "absorption_area_before": json_numbers(self.area),
            "change": json_numbers(self.change),
            "pairs": [list(pair) for pair in found.pairs],
        }
