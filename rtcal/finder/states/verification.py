"""Whether what was found of some pairs predicts how T changes at the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET
from rtcal.finder.finding import HeldOutVerification, check_pairs
from rtcal.finder.states.case import StatesCase
from rtcal.finder.states.evidence import Baseline
from rtcal.finder.states.finding import StatesFinding
from rtcal.finder.states.search import find
from rtcal.support import text
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.files import json_numbers
from rtcal.support.types import Array

_LEAST_NEW = 2
"""Fewest pairs that a finding had not: their scatter tells how sure the gain is."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StatesVerification(HeldOutVerification):
    """The change of T at pairs that were not fitted: measured, and as the fitted pairs say.

    Attributes
    ----------
    finding : StatesFinding
    case : Case or None
        What was measured at pairs that the finding had not; None where the halves of its own pairs
        predict each other.
    gaps : array (2, n_pairs, n_bands)
        ln T before less measured after, in JND of 5 %: as if nothing had changed. ln T predicted less
        measured after.
    """

    record_kind: ClassVar[str] = "two states verification 1"

    finding: StatesFinding
    case: StatesCase | None = None

    @property
    def before(self) -> float:
        """Mean absolute gap at held-out pairs without the change, in JND."""
        return float(np.nanmean(np.abs(self.gaps[0])))

    @property
    def after(self) -> float:
        """The same with the change."""
        return float(np.nanmean(np.abs(self.gaps[1])))

    @property
    def gains(self) -> Array:
        """Mean absolute gap of each pair without less with the change, (1, n_pairs), in JND."""
        without, with_change = np.abs(self.gaps)
        by_pair = np.nanmean(without - with_change, axis=1)
        return np.asarray(by_pair[np.newaxis])

    @property
    def sentence(self) -> str:
        """The verdict in a sentence."""
        others = "the other half of the pairs" if self.case is None else "the other pairs"
        return (
            f"{self.verdict}: at pairs that were not fitted the mean gap of T is {self.before:.1f} JND "
            f"if nothing changed, and {self.after:.1f} JND with what {others} found."
        )

    def __repr__(self) -> str:
        return f"<StatesVerification {self.verdict}>"

    def __str__(self) -> str:
        return "\n".join(text.wrapped(self.sentence))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        found = (self.finding.case if self.case is None else self.case).differences
        return {
            **super().to_dict(),
            "gaps": [self.before, self.after],
            "pairs": [list(pair) for pair in found.pairs],
            "centre_frequencies": json_numbers(found.centre_frequencies),
            "before": json_numbers(self.gaps[0]),
            "after": json_numbers(self.gaps[1]),
        }


@checked
def verify(
    finding: StatesFinding,
    *,
    before: Measurement | None = None,
    after: Measurement | None = None,
    seed: int = 0,
) -> StatesVerification:
    """Verify a finding at pairs that were not fitted.

    Parameters
    ----------
    finding : StatesFinding
    before, after : Measurement, optional
        Of both states. The finding predicts the pairs that it had not. Without them each half of the
        finding's pairs predicts the other.
    seed : int
        Of the samples from which the intervals come.

    Raises
    ------
    DataError
        If nothing was detected; for fewer than four pairs, or fewer than two that are new; if one of
        the states is missing.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1] * 2],
    ...                sigma=[[0.05] * 2], centre_frequencies=[500, 1000])
    >>> pairs = [("S1", "R1"), ("S1", "R2"), ("S2", "R1"), ("S2", "R2")]
    >>> before, after = (
    ...     rt.Measurement(centre_frequencies=[500, 1000], values={"t20": t}, pairs=pairs)
    ...     for t in ([[1.5, 1.4], [1.4, 1.4], [1.5, 1.3], [1.6, 1.5]],
    ...               [[0.8, 0.7], [0.8, 0.7], [0.7, 0.7], [0.8, 0.7]])
    ... )
    >>> print(verify(rt.find(room, after, before=before)).verdict)
    supported
    """
    case, found = finding.case, finding.case.differences
    if not finding.detected:
        raise DataError(f'the verdict is "{finding.verdict}"; there is no change to verify')
    if (before is None) != (after is None):
        lacking = "before" if before is None else "after"
        raise DataError(f"{lacking} is missing: the change is verified in both states")
    if before is not None and after is not None:
        case = _at_new_pairs(finding, before, after)
        found = case.differences
        gaps = _gaps(found.change, _shift(finding))
        return StatesVerification(finding=finding, gaps=gaps, case=case)
    check_pairs(found.pairs)
    predicted = np.full(found.change.shape, np.nan)
    for half in range(2):
        fitted = [i for i in range(len(found.pairs)) if i % 2 == half]
        held_out = [i for i in range(len(found.pairs)) if i % 2 != half]
        predicted[held_out] = _predicted(case, [found.pairs[i] for i in fitted], seed)
    gaps = _gaps(found.change, predicted)
    return StatesVerification(finding=finding, gaps=gaps)


def _gaps(change: Array, predicted: Array) -> Array:
    """Return the gaps in JND, (2, n_pairs, n_bands): as if nothing had changed, and as predicted."""
    jnd = np.log1p(TARGET.jnd)
    return np.stack([-change / jnd, (predicted - change) / jnd])


def _at_new_pairs(finding: StatesFinding, before: Measurement, after: Measurement) -> StatesCase:
    """Return the case of the pairs that a finding had not; DataError for fewer than two."""
    fitted = finding.case.differences.pairs
    if finding.case.differences.of_means or before.is_summary or after.is_summary:
        raise DataError("means over positions have no pairs that were not fitted")
    new = [p for p in before.pairs if p in after.pairs and p not in fitted]
    if len(new) < _LEAST_NEW:
        raise DataError(
            f"{len(new)} pairs of before and after are not among the {len(fitted)} that were fitted; "
            f"{_LEAST_NEW} are needed"
        )
    case = finding.case
    return StatesCase(
        room=case.room, before=before.select(new), after=after.select(new), equation=case.equation
    )


def _predicted(case: StatesCase, pairs: list[tuple[str, str]], seed: int) -> Array:
    """Return the shift of ln T that these pairs alone tell, (n_bands,); NaN where they have no T."""
    of_half = StatesCase(
        room=case.room,
        before=case.before.select(pairs),
        after=case.after.select(pairs),
        equation=case.equation,
    )
    return _shift(find(of_half, seed=seed))


def _shift(finding: StatesFinding) -> Array:
    """Return the shift of ln T that a finding states, (n_bands,); NaN where it has no T."""
    case = finding.case
    found, measured = case.differences, case.differences.measured
    baseline = Baseline.of(case.room, case.equation, found.before, measured)
    shift = np.full(len(measured), np.nan)
    shift[measured] = np.log(
        baseline.whole(baseline.area) / baseline.whole(baseline.area + finding.change[0, measured])
    )
    return shift
