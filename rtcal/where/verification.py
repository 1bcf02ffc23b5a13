"""Whether the gap shrinks at positions that were not fitted."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.quality import gap_jnd
from rtcal.errors import DataError
from rtcal.loop.measured_pairs import Pair
from rtcal.loop.positions import calibrate_positions
from rtcal.simulators.observations import Observations, observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks, text
from rtcal.support.arguments import checked
from rtcal.support.files import json_numbers
from rtcal.support.types import Array
from rtcal.where.candidate import Candidate
from rtcal.where.case import Case
from rtcal.where.corrected import corrected
from rtcal.where.find import find
from rtcal.where.finding import Finding

MODELS = ("before", "plain", "corrected")
LEAST_PAIRS = 4
"""Fewest pairs: half of them have to say where."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Verification:
    """Gaps at positions that were not fitted: as stated, calibrated, corrected and calibrated.

    The pairs are divided into two halves. Each half finds the effect again and calibrates both models;
    the other half is predicted. So no value was used for its own prediction.

    Attributes
    ----------
    finding : Finding
    before, plain, corrected : array (n_seeds, n_parameters, n_pairs, n_bands)
        Simulated less measured in JND at held-out pairs; NaN where nothing was measured.
    added : tuple of (Candidate or None)
        What each half added to its model, half by half; None where it found no surface.
    halves : tuple of tuples of pairs
    seeds : tuple of int
    """

    finding: Finding
    before: Array
    plain: Array
    corrected: Array
    added: tuple[Candidate | None, ...]
    halves: tuple[tuple[Pair, ...], ...]
    seeds: tuple[int, ...]

    @checked
    def gap(self, model: str) -> Array:
        """Return the mean absolute gap of a model in `MODELS`, (n_seeds,), in JND."""
        if model not in MODELS:
            raise DataError(f'model = "{model}" is not one of {", ".join(MODELS)}')
        return np.asarray(np.nanmean(np.abs(getattr(self, model)), axis=(1, 2, 3)))

    @property
    def ratio(self) -> float:
        """Mean absolute gap, corrected over plain."""
        return float(self.gap("corrected").mean() / self.gap("plain").mean())

    @property
    def shrinks(self) -> bool:
        """Whether the corrected model's gap is smaller than the plain one's, for every seed."""
        return bool((self.gap("corrected") < self.gap("plain")).all())

    @property
    def by_parameter(self) -> dict[str, dict[str, float]]:
        """Mean absolute gap by model and parameter in JND, over all seeds."""
        return {
            model: {
                name: float(np.nanmean(np.abs(getattr(self, model)[:, p])))
                for p, name in enumerate(self.finding.parameters)
            }
            for model in MODELS
        }

    @property
    def by_pair(self) -> dict[str, Array]:
        """Mean absolute gap by model, (n_pairs,), in JND, over all seeds."""
        return {m: np.nanmean(np.abs(getattr(self, m)), axis=(0, 1, 3)) for m in MODELS}

    @property
    def sentence(self) -> str:
        """What became of the gap, in words."""
        before, plain, after = (self.gap(m).mean() for m in MODELS)
        words = (
            f"At positions that were not fitted the gap is {before:.1f} JND as stated, {plain:.1f} "
            f"calibrated, {after:.1f} corrected and calibrated"
        )
        if len(self.seeds) > 1:
            spread = self.gap("corrected").std(ddof=1)
            words += f" (± {spread:.2f} over {len(self.seeds)} seeds of the simulator)"
        shrunk = "" if self.shrinks else " It does not shrink: the correction does not hold."
        return f"{words}.{shrunk}"

    def __repr__(self) -> str:
        before, plain, after = (self.gap(m).mean() for m in MODELS)
        return f"<Verification: {before:.2f}, {plain:.2f}, {after:.2f} JND at held-out pairs>"

    def __str__(self) -> str:
        names = [p.upper() for p in self.finding.parameters]
        rows = [
            (model, [f"{v:.2f}" for v in [*values.values(), self.gap(model).mean()]])
            for model, values in self.by_parameter.items()
        ]
        header = ("mean gap / JND", [*names, "all"])
        lines = [*text.wrapped(self.sentence), "", *text.table(rows, header=header)]
        for half, added in zip(self.halves, self.added, strict=True):
            names = [" to ".join(pair) for pair in half]
            what = "nothing" if added is None else f"{added.title}, {added.in_words}"
            lines += text.wrapped(f"Fitted on {', '.join(names)}: added {what}.", hanging="    ")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {
            "sentence": self.sentence,
            "shrinks": self.shrinks,
            "gaps_jnd": {m: json_numbers(self.gap(m)) for m in MODELS},
            "by_parameter_jnd": self.by_parameter,
            "by_pair_jnd": {m: json_numbers(v) for m, v in self.by_pair.items()},
            "pairs": [list(p) for p in self.finding.pairs],
            "seeds": list(self.seeds),
            "added": [None if c is None else c.to_dict() for c in self.added],
            "finding": self.finding.to_dict(),
        }

    def to_json(self) -> str:
        """Return the text of `to_dict` as JSON."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False)


@checked
def verify(
    finding: Finding,
    *,
    seeds: Sequence[int] = (0,),
    cache: str | os.PathLike[str] | None = None,
) -> Verification:
    """Return the gaps at positions that were not fitted, with and without what was found.

    Parameters
    ----------
    finding : Finding
    seeds : sequence of int
        Of the simulator. The spread over them is the noise of the tracing.
    cache : path, optional
        As for `find`.

    Raises
    ------
    DataError
        For fewer than `LEAST_PAIRS` pairs, or where the finding has nothing to add to a surface.
    """
    chosen = tuple(checks.whole("seeds", s, 0) for s in checks.listed("seeds", seeds))
    if not chosen:
        raise DataError("seeds is empty; it has at least one")
    if not finding.can_be_added:
        raise DataError(f'the verdict is "{finding.verdict}"; no surface lacks anything to add')
    case = finding.case
    if len(finding.pairs) < LEAST_PAIRS:
        raise DataError(
            f"there are {len(finding.pairs)} pairs; to predict half of them from the others, it needs "
            f"{LEAST_PAIRS}"
        )
    halves = _halves(finding.pairs)
    shape = (len(chosen), *finding.map.shape)
    gaps = {model: np.full(shape, np.nan) for model in MODELS}
    added: list[Candidate | None] = []
    for half in halves:
        fitted = case.only(half)
        again = find(fitted, controls=finding.controls, cache=cache, seed=chosen[0])
        best = next((c for c in again.candidates if c.surface is not None), None)
        added.append(best)
        left = [p for p in finding.pairs if p not in half]
        columns = [finding.pairs.index(p) for p in left]
        for n, seed in enumerate(chosen):
            for model, heard in _predicted(fitted, finding, best, seed).items():
                gaps[model][n][:, columns] = _gap(case, finding, heard, left)
    return Verification(
        finding=finding,
        before=gaps["before"],
        plain=gaps["plain"],
        corrected=gaps["corrected"],
        added=tuple(added),
        halves=halves,
        seeds=chosen,
    )


def _halves(pairs: Sequence[Pair]) -> tuple[tuple[Pair, ...], ...]:
    """Return two halves with every source in both: every second receiver of each source.

    Sources begin in turn with the first and the second receiver, so that a half has all receivers
    where there are two sources.
    """
    sources = list(dict.fromkeys(s for s, _ in pairs))
    receivers = list(dict.fromkeys(r for _, r in pairs))
    even = tuple((s, r) for s, r in pairs if (sources.index(s) + receivers.index(r)) % 2 == 0)
    return even, tuple(p for p in pairs if p not in even)


def _predicted(
    fitted: Case, finding: Finding, best: Candidate | None, seed: int
) -> dict[str, Observations]:
    """Return what all positions hear in each model, calibrated on the fitted pairs."""
    match = finding.parameters

    def calibrated(simulator: PathTracing) -> Observations:
        result = calibrate_positions(
            simulator,
            simulator.room,
            fitted.measured,
            match,
            exclude=fitted.exclude,
            controls=finding.controls,
            seed=seed,
        )
        return observe(simulator, result.alpha, match, seed=seed)

    out = {
        "before": observe(fitted.simulator, fitted.room.alpha, match, seed=seed),
        "plain": calibrated(fitted.simulator),
    }
    out["corrected"] = out["plain"]
    if best is not None:
        out["corrected"] = calibrated(corrected(fitted, best).simulator)
    return out


def _gap(case: Case, finding: Finding, heard: Observations, pairs: Sequence[Pair]) -> Array:
    """Return simulated less measured at pairs in JND, (n_parameters, n_pairs, n_bands).

    A relative level has its mean over each source's pairs taken off.
    """
    measured = Observations.of_measurement(case.measured, finding.parameters, pairs)
    rows = [heard.pairs.index(p) for p in pairs]
    gaps = []
    for name in finding.parameters:
        model, values = heard.natural(name)[rows], measured.natural(name)
        if name == "level" and "level" in case.measured.values:
            for source in {s for s, _ in pairs}:
                same = [i for i, (s, _) in enumerate(pairs) if s == source]
                model[same] -= np.nanmean(model[same] - values[same], axis=0)
        gaps.append(gap_jnd(model, values, name))
    return np.stack(gaps)
