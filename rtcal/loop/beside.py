"""Parameters that were measured but not fitted: their gaps before and after, and which grew."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.bands import label
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import LEVEL, OBSERVABLES
from rtcal.acoustics.parameters import parameter_label
from rtcal.acoustics.quality import gap_jnd
from rtcal.simulators.observations import Observations
from rtcal.support.types import Array, read_only

SHOWN = tuple(key for key, kind in OBSERVABLES.items() if kind.shown)
"""Parameters that are shown before and after, fitted or not."""
_LEFT = 1.0
"""JND by which a gap grows in some band where a parameter left what was measured."""

Pair = tuple[str, str]

Gaps = Mapping[str, tuple[Array, Array]]
"""Gaps before and after in JND by parameter, each (n_bands,)."""


def means(measurement: Measurement) -> dict[str, Array]:
    """Return the means over pairs of the parameters that are shown and there, each (n_bands,)."""
    found = {p: read_only(measurement.mean(p)) for p in SHOWN}
    return {p: mean for p, mean in found.items() if np.isfinite(mean).any()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Beside:
    """Parameters at positions that are not matched: measured, before and after.

    Attributes
    ----------
    measured, before, after : Observations
        Of the same parameters and pairs.
    """

    measured: Observations
    before: Observations
    after: Observations

    @classmethod
    def of(
        cls,
        measured: Measurement,
        matched: Observations,
        before: Observations,
        after: Observations,
    ) -> Beside:
        """Return what is in ``before`` and not in ``matched``, at the pairs that are matched."""
        names = [p for p in before.parameters if p not in matched.parameters]
        wanted = Observations.of_measurement(measured, names, matched.pairs)
        return cls(measured=wanted, before=before.at(wanted), after=after.at(wanted))

    @classmethod
    def at_pairs(
        cls,
        measured: Measurement,
        matched: Observations,
        pairs: Sequence[Pair],
        before: Observations,
        after: Observations,
    ) -> Beside | None:
        """Return the parameters of ``matched`` at pairs that were left out; None without any.

        A relative level is none of them: what is left out has no reference.
        """
        names = [p for p in matched.parameters if p != LEVEL.key]
        kept = [p for p in pairs if p in before.pairs]
        if not names or not kept:
            return None
        wanted = Observations.of_measurement(measured, names, kept)
        return cls(measured=wanted, before=before.at(wanted), after=after.at(wanted))

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters that were measured and not matched."""
        return self.measured.parameters

    @property
    def gap_before(self) -> Array:
        """Simulated less measured, with the prior, in JND, (n_parameters, n_pairs, n_bands)."""
        return self._gap(self.before)

    @property
    def gap_after(self) -> Array:
        """Simulated less measured, in JND, (n_parameters, n_pairs, n_bands)."""
        return self._gap(self.after)

    @property
    def gaps(self) -> Gaps:
        """Root mean squares over the pairs."""
        ends = zip(self.parameters, self.gap_before, self.gap_after, strict=True)
        return {p: (_over_pairs(before), _over_pairs(after)) for p, before, after in ends}

    def _gap(self, simulated: Observations) -> Array:
        gaps = [gap_jnd(simulated.natural(p), self.measured.natural(p), p) for p in self.parameters]
        return np.reshape(gaps, self.measured.values.shape)


def _over_pairs(gap: Array) -> Array:
    known = np.isfinite(gap)
    number = np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    return np.asarray(np.sqrt((np.where(known, gap, 0.0) ** 2).sum(axis=0) / number))


def left(gaps: Gaps) -> tuple[str, ...]:
    """Return the parameters that left what was measured, in some band by more than one JND."""
    return tuple(
        parameter
        for parameter, (before, after) in gaps.items()
        if (np.abs(after) > np.abs(before) + _LEFT).any()
    )


def sentences(gaps: Gaps, frequencies: Array) -> Iterator[str]:
    """Yield by how much each parameter of `left` left what was measured, in its worst band."""
    for parameter in left(gaps):
        before, after = (np.abs(gap) for gap in gaps[parameter])
        k = int(np.nanargmax(after - before))
        yield (
            f"{parameter_label(parameter)}, which was not fitted, left what was measured: by "
            f"{before[k]:.1f} JND before and {after[k]:.1f} JND after, at {label(frequencies[k])}. "
            "Match it at every position, or look for what the model misses (rtcal find)."
        )
