"""Whether the model predicts better with what was found, at data that it was not fitted to.

Calibration changes alpha until T fits, whatever effect is missing. So a smaller gap in what was fitted
proves nothing, and the gap is that of data that were held out: of means over positions the level and
further configurations, of positions and of two states other pairs. A gap that shrinks there shows that
the model is better, not that the name is right: a rival that does the same would shrink it too.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from scipy import stats

from rtcal.acoustics import bands
from rtcal.acoustics.observables import DecaySlope, observable
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.finder.finding import LEAST_PAIRS
from rtcal.support import blocks
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence, first_of, listed
from rtcal.support.types import Array

LEAST_SHRINKAGE = 0.2
"""Decrease of the mean gap in JND that supports a finding at least, however well it is known: a gap
that goes from 1.75 to 1.74 JND supports nothing."""
_CONFIDENCE = 0.95
"""Of a gap over pairs that is said to shrink or to grow: one-sided, by Student's t."""
_WORDS_OF_MISSES = 3
"""Bands that miss what was measured and are named in a sentence."""


@dataclass(frozen=True)
class Gap:
    """The mean absolute gap in JND of one quantity, at one place or all, by model.

    ``used`` is "matched" of what plain calibration matches, "held out" of what a model predicts that
    was not fitted to it, else "". ``spread`` is the standard deviation over the simulator's seeds.
    """

    quantity: str
    place: str
    values: tuple[float, ...]
    used: str = ""
    spread: tuple[float, ...] = ()

    @property
    def row(self) -> Row:
        """Quantity and place with the gap of each model."""
        name = " of ".join(filter(None, (self.quantity, self.place)))
        values = self.spread or (np.nan,) * len(self.values)
        cells = [
            f"{value:.2f}" + (f" ± {spread:.2f}" if np.isfinite(spread) else "")
            for value, spread in zip(self.values, values, strict=True)
        ]
        return Row(f"{name} ({self.used})" if self.used else name, cells)


@dataclass(frozen=True)
class Miss:
    """A band in which the model with what was found misses what it was matched to.

    Attributes
    ----------
    quantity, place : str
        "T20", and where: the name of a configuration; "" where there is one.
    frequency : float
        Centre frequency in Hz.
    model, measured, uncertainty : float
        In the quantity's ``unit``; the standard uncertainty of what was measured.
    jnd : float
        The gap in JND, signed.
    unit : str
    """

    quantity: str
    place: str
    frequency: float
    model: float
    measured: float
    uncertainty: float
    jnd: float
    unit: str

    @property
    def in_words(self) -> str:
        """The band with both values: "T20 at 500 Hz is 0.53 s, measured 0.645 ± 0.013 s"."""
        at = f"{self.quantity} at {bands.label(self.frequency)}"
        at += f' of "{self.place}"' if self.place else ""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{at} is {self.model:.3g}{unit}, measured {self.measured:.3g} ± "
            f"{self.uncertainty:.2g}{unit}"
        )


def is_miss(jnd: Array, uncertainty: Array) -> Array:
    """Return where a gap in JND exceeds 1 JND and its standard uncertainty, which is in JND, too."""
    return np.asarray(np.abs(jnd) > np.maximum(1.0, np.nan_to_num(uncertainty)))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Verification(Result):
    """The gap with and without what was found, at data that it was not fitted to.

    Attributes
    ----------
    finding : Finding
    models : tuple of str
        How each model is called; the last has what was found, the one before it has not.
    held_out : tuple of str
        What was held out, in words; () where nothing could be.
    before, after : float
        Mean absolute gap in JND at what was held out, without and with what was found; NaN where
        nothing was.
    gain, uncertainty : float
        The decrease of the gap and its standard error, in JND.
    needed, endured : float
        The decrease of the gap in JND that supports the finding, and the increase that withdraws it.
    quantities : tuple of Gap
    misses : tuple of Miss
        What the model with what was found was matched to, and misses.
    doubts : tuple of str
        Why the finding is not supported, beside gap and misses, a clause each.
    found_again : str
        The things that parts of the data found, where these are others, in words.
    but : str
        What a support leaves open, in words.
    notes : tuple of str
    gaps : array (n_models, n_seeds, n_parameters, n_pairs, n_bands)
        Model less measured in JND at pairs, NaN where nothing was measured; empty of means over
        positions.
    plain, corrected : Recalibrated or None
        Of means over positions: the calibrations to all data without and with what was found.
    details : mapping of str to plain values
        What its kind has beside these, as `to_dict` returns it.
    """

    record_kind: ClassVar[str] = "verification 4"

    finding: Any
    models: tuple[str, ...]
    held_out: tuple[str, ...]
    before: float
    after: float
    gain: float
    uncertainty: float
    needed: float
    endured: float
    quantities: tuple[Gap, ...] = ()
    misses: tuple[Miss, ...] = ()
    doubts: tuple[str, ...] = ()
    found_again: str = ""
    but: str = ""
    notes: tuple[str, ...] = ()
    gaps: Array = field(default_factory=lambda: np.zeros((0, 0, 0, 0, 0)))
    plain: Any = None
    corrected: Any = None
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """``supported``: the gap shrinks by more than is `needed`, and there is no objection.

        ``withdrawn``: it grows. ``unproven``: it changes by less, or there are `objections`.
        ``not tested``: nothing was measured that the finding was not fitted to.
        """
        if np.isnan(self.before):
            return "not tested"
        if -self.gain > self.endured:
            return "withdrawn"
        return "unproven" if self.objections else "supported"

    @property
    def objections(self) -> tuple[str, ...]:
        """Why the finding is not supported, a clause each; () where it is."""
        little = self.gain <= self.needed
        return (
            *([f"only a decrease by more than {self.needed:.2f} JND counts"] if little else ()),
            *self.doubts,
            *(["the corrected model misses what it was matched to"] if self.misses else ()),
        )

    @property
    def misses_in_words(self) -> str:
        """A sentence on what the model misses, with the consequence; "" where it meets all."""
        if not self.misses:
            return ""
        worst = sorted(self.misses, key=lambda miss: -abs(miss.jnd))
        said = first_of([miss.in_words for miss in worst], _WORDS_OF_MISSES)
        return f"Do not simulate with it: with what was found {said}."

    @property
    def sentence(self) -> str:
        """The verdict, the change of the gap with its standard error, and what speaks against it."""
        if np.isnan(self.before):
            said = [
                "Not tested: what was found was fitted to all that was measured. Measure C80 or G, or "
                "a second configuration. The finding rests on T and on the stated coefficients."
            ]
        else:
            supported = self.verdict == "supported"
            verb = "shrinks" if self.gain > 0 else "grows"
            grounds = self.objections[: -1 if self.misses else None]
            said = [
                f"{self.verdict.capitalize()}{self.but if supported else ''}: {self.found_again}at "
                f"data that it was not fitted to ({listed(self.held_out)}) the mean gap {verb} with "
                f"what was found from {self.before:.2f} to {self.after:.2f} JND, by "
                f"{abs(self.gain):.2f} ± {self.uncertainty:.2f} JND (standard error)"
                f"{f'; more than {self.needed:.2f} JND counts' if supported else ''}.",
                as_sentence(listed(grounds)) if grounds else "",
                "The model is better; the name may still be wrong." if supported else "",
            ]
        return " ".join(filter(None, [*said, self.misses_in_words]))

    @property
    def by_seed(self) -> Array:
        """Mean absolute gap at pairs in JND by model and seed of the simulator, (n_models, n_seeds)."""
        return np.asarray(np.nanmean(np.abs(self.gaps), axis=(2, 3, 4)))

    @property
    def table(self) -> Table:
        """The mean gaps by quantity and place, and all that was held out, by model."""
        rows = [gap.row for gap in self.quantities]
        if np.isfinite(self.before) and not len(self.gaps):
            rows.append(Row("all that was held out", [self.before, self.after], ".2f"))
        return Table(self.models, rows, corner="mean gap / JND")

    def __str__(self) -> str:
        return "\n".join(blocks.lines(self.blocks()))

    def _repr_html_(self) -> str:
        return blocks.notebook(f"Verification: {self.verdict}", self.blocks())

    def blocks(self) -> list[Block]:
        """Return what the result says."""
        table = [self.table] if self.quantities else []
        out: list[Block] = [Note(self.sentence), *map(Note, self.notes), *table]
        return out if self.corrected is None else [*out, *self.corrected.blocks(self.plain)]

    def __repr__(self) -> str:
        return (
            f"<Verification {self.verdict}: {self.finding.what}; gap {self.before:.2f} to "
            f"{self.after:.2f} JND>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        calibrated = {"plain": self.plain, "corrected": self.corrected}
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "misses": [dict(vars(miss)) for miss in self.misses],
            "least_shrinkage_jnd": LEAST_SHRINKAGE,
            "finding": self.finding.to_dict(),
            "held_out": list(self.held_out),
            "before_jnd": json_numbers(self.before),
            "after_jnd": json_numbers(self.after),
            "gain_jnd": json_numbers(self.gain),
            "uncertainty_jnd": json_numbers(self.uncertainty),
            "objections": [] if np.isnan(self.before) else list(self.objections),
            **self.details,
            **{name: of.to_dict() for name, of in calibrated.items() if of is not None},
        }


def check_pairs(pairs: Sequence[object]) -> None:
    """Raise DataError for fewer than `LEAST_PAIRS` pairs."""
    if len(pairs) < LEAST_PAIRS:
        raise DataError(
            f"there are {len(pairs)} pairs; {LEAST_PAIRS} are needed, half of which predict the others"
        )


def gain_over_pairs(gains: Array) -> dict[str, Any]:
    """Return `Verification.gain`, ``uncertainty``, ``needed`` and ``endured``, of gains at pairs.

    ``gains`` (n_seeds, n_pairs) are decreases of the mean absolute gap in JND. The standard error is
    over pairs and, of two seeds and more, over seeds. More than it is needed, one-sided, by Student's t
    over the pairs, and `LEAST_SHRINKAGE`.
    """
    n_seeds, n_pairs = gains.shape
    of_pairs = gains.mean(axis=0).std(ddof=1) / np.sqrt(n_pairs)
    of_seeds = gains.mean(axis=1).std(ddof=1) / np.sqrt(n_seeds) if n_seeds > 1 else 0.0
    error = float(np.hypot(of_pairs, of_seeds))
    needed = max(LEAST_SHRINKAGE, error * float(stats.t.ppf(_CONFIDENCE, n_pairs - 1)))
    return {
        "gain": float(gains.mean()),
        "uncertainty": error,
        "needed": needed,
        "endured": needed,
    }


def misses_over_pairs(
    matched: Mapping[str, tuple[Array, Array]],
    pairs: Sequence[tuple[str, str]],
    frequencies: Array,
    times: Array | None = None,
    prediction: Array | float = 0.0,
) -> tuple[Miss, ...]:
    """Return the means over pairs that a model misses.

    Their variance is the larger of that over the pairs, of which as many are independent as there are
    sources or receivers, and of that of noise in as many responses (ISO 3382-2).

    Parameters
    ----------
    matched : mapping of str to two arrays
        For each parameter the mean measured over the pairs, (n_bands,), and what is left of the gap,
        (n_pairs, n_bands), signed and in JND.
    pairs : sequence of (source, receiver)
    frequencies : array (n_bands,)
        Hz.
    times : array (n_bands,), optional
        T in s by which a response is noisy; by default that among ``matched``.
    prediction : array (n_bands,) or float
        Standard deviation in JND that the model states for itself; 0 of a calibrated one.
    """
    out = list[Miss]()
    independent = max(len({s for s, _ in pairs}), len({r for _, r in pairs}))
    if times is None:
        slopes = (m for p, (m, _) in matched.items() if isinstance(observable(p), DecaySlope))
        times = next(slopes, None)
    for name, (measured, gaps) in matched.items():
        of = observable(name)
        step = of.jnd * measured if of.relative_jnd else np.full(len(measured), of.jnd)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a band without a value
            mean = np.nanmean(gaps, axis=0)
            error = np.nanstd(gaps, axis=0, ddof=1) / np.sqrt(independent)
        if times is not None:
            one = of.scatter(frequencies, times) * (measured if of.logarithmic else 1.0)
            error = np.fmax(error, one / step / np.sqrt(len(pairs)))
        error = np.hypot(error, prediction)
        for k in np.flatnonzero(is_miss(mean, error) & np.isfinite(mean)).tolist():
            out.append(
                Miss(
                    quantity=of.label,
                    place="",
                    frequency=float(frequencies[k]),
                    model=float(measured[k] + step[k] * mean[k]),
                    measured=float(measured[k]),
                    uncertainty=float(step[k] * np.nan_to_num(error[k])),
                    jnd=float(mean[k]),
                    unit=of.unit,
                )
            )
    return tuple(out)
