"""Whether the gap shrinks at positions that were not fitted.

Every model is traced anew, so that it has the prediction of a tracer; `rtcal.finder.states` predicts by
an equation, and means over positions have no pairs to hold out.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics.observables import LEVEL, parameter_label
from rtcal.files import disk
from rtcal.files.disk import json_numbers
from rtcal.finder.finding import Candidate, HeldOutVerification, check_pairs
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.corrected import corrected_geometry
from rtcal.finder.positions.finding import PositionsFinding, kind
from rtcal.finder.positions.search import find_by_positions
from rtcal.finder.positions.weighing import key_of
from rtcal.loop.control_runs import trace_ahead
from rtcal.loop.measured_pairs import Pair, gap_at_pairs
from rtcal.loop.positions import calibrate_positions
from rtcal.simulators.base import Observations, observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks, text
from rtcal.support.errors import DataError
from rtcal.support.speed import TaskProgress
from rtcal.support.text import listed
from rtcal.support.types import Array

MODELS = ("before", "plain", "corrected")
TITLES = {
    "before": "as stated",
    "plain": "calibrated",
    "corrected": "corrected and calibrated",
}
"""How each model is called."""
_SHORT = ("stated", "calibrated", "corrected")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsVerification(HeldOutVerification):
    """Gaps at positions that were not fitted: as stated, calibrated, corrected and calibrated.

    The pairs are divided into two halves. Each half finds the effect again and calibrates both models;
    the other half is predicted. So no value was used for its own prediction.

    Attributes
    ----------
    finding : PositionsFinding
    gaps : array (n_models, n_seeds, n_parameters, n_pairs, n_bands)
        Simulated less measured in JND at held-out pairs, of each of `MODELS`.
    added : tuple of (Candidate or None)
        What each half added to its model, half by half; None where it found no surface.
    halves : tuple of tuples of pairs
    seeds : tuple of int
    """

    record_kind: ClassVar[str] = "verification at positions 1"

    finding: PositionsFinding
    added: tuple[Candidate | None, ...]
    halves: tuple[tuple[Pair, ...], ...]
    seeds: tuple[int, ...]

    @property
    def before(self) -> float:
        """Mean absolute gap of the calibrated model without what was found, in JND."""
        return float(self.gap("plain").mean())

    @property
    def after(self) -> float:
        """The same with what was found."""
        return float(self.gap("corrected").mean())

    def gap(self, model: str) -> Array:
        """Return the mean absolute gap of a model in `MODELS`, (n_seeds,), in JND."""
        if model not in MODELS:
            raise DataError(f'model = "{model}" is not one of {", ".join(MODELS)}')
        return np.asarray(np.nanmean(np.abs(self.gaps[MODELS.index(model)]), axis=(1, 2, 3)))

    @property
    def ratio(self) -> float:
        """Mean absolute gap, corrected over plain."""
        return self.after / self.before

    @property
    def gains(self) -> Array:
        """Plain less corrected, the mean absolute gap of each seed and pair, in JND."""
        plain, corrected = (np.nanmean(np.abs(gaps), axis=(1, 3)) for gaps in self.gaps[1:])
        return np.asarray(plain - corrected)

    @property
    def matched(self) -> dict[str, tuple[Array, Array]]:
        """For each parameter the measured mean over the pairs, and the corrected model's gaps."""
        case, parameters = self.finding.case, self.finding.parameters
        measured = Observations.of_measurement(case.in_room, parameters, self.finding.pairs)
        relative = LEVEL.key if LEVEL.key in case.measured.values else ""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a band without a value
            gaps = np.nanmean(self.gaps[-1], axis=0)
            return {
                name: (np.nanmean(measured.natural(name), axis=0), gaps[p])
                for p, name in enumerate(parameters)
                if name != relative  # its mean over the pairs is taken off
            }

    @property
    def matched_pairs(self) -> Sequence[tuple[str, str]]:
        """The pairs, each of which was predicted from the half that it is not in."""
        return self.finding.pairs

    @property
    def frequencies(self) -> Array:
        """Centre frequencies in Hz, (n_bands,)."""
        return self.finding.case.room.centre_frequencies

    @property
    def by_parameter(self) -> dict[str, dict[str, float]]:
        """Mean absolute gap by model and parameter in JND, over all seeds."""
        return {
            model: {
                name: float(np.nanmean(np.abs(gaps[:, p])))
                for p, name in enumerate(self.finding.parameters)
            }
            for model, gaps in zip(MODELS, self.gaps, strict=True)
        }

    @property
    def spread(self) -> dict[str, dict[str, float]]:
        """Standard deviation over the seeds of `by_parameter`; NaN for a single seed."""
        out: dict[str, dict[str, float]] = {}
        for model, gaps in zip(MODELS, self.gaps, strict=True):
            mean = np.nanmean(np.abs(gaps), axis=(2, 3))
            off = mean.std(axis=0, ddof=1) if len(mean) > 1 else np.full(mean.shape[1], np.nan)
            out[model] = dict(zip(self.finding.parameters, off.tolist(), strict=True))
        return out

    @property
    def by_pair(self) -> dict[str, Array]:
        """Mean absolute gap by model, (n_pairs,), in JND, over all seeds."""
        by_pair = (np.nanmean(np.abs(gaps), axis=(0, 1, 3)) for gaps in self.gaps)
        return dict(zip(MODELS, by_pair, strict=True))

    @property
    def differing(self) -> tuple[Candidate | None, ...]:
        """The candidates of halves that are another thing than all pairs found; () where they agree.

        The same thing is of the same family, all of added absorption as one; where a surface is
        claimed, also on that surface, or on one that these positions do not tell from it.
        """
        found, claimed = self.finding.likeliest, self.finding.surface
        if found is None:
            return ()
        alike = {claimed}.union(*(g for g in self.finding.groups if claimed in g))
        return tuple(
            c
            for c in self.added
            if c is None or kind(c) != kind(found) or not (claimed is None or c.surface in alike)
        )

    @property
    def verdict(self) -> str:
        """As of the gap; but not ``supported`` where the halves found another thing than all pairs."""
        of_gap = super().verdict
        return "unproven" if of_gap == "supported" and self.differing else of_gap

    @property
    def verdict_in_words(self) -> str:
        """The grounds of the verdict, in a sentence or two; what the halves found stands in it."""
        size, verdict = (
            f"{abs(self.gain):.2f} ± {self.uncertainty:.2f} JND",
            self.verdict.capitalize(),
        )
        found, elsewhere = self.finding.likeliest, self.differing
        if found is not None and not elsewhere:
            elsewhere = tuple(c for c in self.added if c is not None and c.surface != found.surface)
            if elsewhere and self.verdict == "supported":
                verdict += f" for {kind(found)}, not for its surface"
        halves = ""
        if elsewhere and found is not None:
            each = listed([*dict.fromkeys("nothing" if c is None else c.title for c in elsewhere)])
            which = "the halves of the pairs" if len(elsewhere) > 1 else "half of the pairs"
            halves = f"{which} found {each}, not {found.title} as all pairs did; "
        less = "smaller" if self.gain > 0 else "larger"
        said = f"{halves}with what was found the gap is {size} {less} than calibrated alone"
        counts = f"only a change by more than {self.needed:.2f} JND counts"
        sentences = [f"{verdict}: {said}; {counts}.", self.misses_in_words]
        return " ".join(filter(None, sentences))

    @property
    def sentence(self) -> str:
        """The change of the gap, in words; the verdict first."""
        before, plain, after = (self.gap(m).mean() for m in MODELS)
        return (
            f"{self.verdict_in_words} At positions that were not fitted it is {before:.2f} JND as "
            f"stated, {plain:.2f} calibrated, {after:.2f} corrected and calibrated.{self.warning}"
        )

    @property
    def warning(self) -> str:
        """A sentence, after a blank, if the calibrated model is no better than the stated; else ""."""
        if self.before < self.gap("before").mean():
            return ""
        return " Calibrated, the model is no better there than as stated: do not simulate with it."

    @property
    def support(self) -> str:
        """The sources of the uncertainty, in words."""
        seeds = "1 seed" if len(self.seeds) == 1 else f"{len(self.seeds)} seeds"
        return (
            f"± is the standard error over {len(self.finding.pairs)} pairs and {seeds} of the "
            "simulator."
        )

    def __repr__(self) -> str:
        before, plain, after = (self.gap(m).mean() for m in MODELS)
        return f"<Verification: {before:.2f}, {plain:.2f}, {after:.2f} JND at held-out pairs>"

    def __str__(self) -> str:
        names = [parameter_label(p) for p in self.finding.parameters]
        rows = [
            (TITLES[model], [f"{v:.2f}" for v in [*values.values(), self.gap(model).mean()]])
            for model, values in self.by_parameter.items()
        ]
        header = ("mean gap / JND", [*names, "all"])
        lines = [*text.wrapped(self.sentence), *text.wrapped(self.support), ""]
        lines += text.table(rows, header=header)
        lines += ["", *text.table(self._pair_rows(), header=("mean gap / JND", [*_SHORT])), ""]
        for sentence in self.halves_in_words:
            lines += text.wrapped(sentence, hanging="    ")
        return "\n".join(lines)

    def _pair_rows(self) -> list[tuple[str, list[str]]]:
        by_model = [self.by_pair[m] for m in MODELS]
        return [
            (" to ".join(pair), [f"{gaps[i]:.2f}" for gaps in by_model])
            for i, pair in enumerate(self.finding.pairs)
        ]

    @property
    def halves_in_words(self) -> tuple[str, ...]:
        """The effects that each half of the pairs added, a sentence each."""
        out = []
        for half, added in zip(self.halves, self.added, strict=True):
            names = ", ".join(" to ".join(pair) for pair in half)
            what = "nothing" if added is None else f"{added.title}, {added.in_words}"
            out.append(f"Fitted on {names}: added {what}.")
        return tuple(out)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            **super().to_dict(),
            "gain_jnd": self.gain,
            "uncertainty_jnd": self.uncertainty,
            "gaps_jnd": {m: json_numbers(self.gap(m)) for m in MODELS},
            "by_parameter_jnd": self.by_parameter,
            "by_pair_jnd": {m: json_numbers(v) for m, v in self.by_pair.items()},
            "pairs": [list(p) for p in self.finding.pairs],
            "seeds": list(self.seeds),
            "added": [None if c is None else c.to_dict() for c in self.added],
        }


def verify(
    finding: PositionsFinding,
    *,
    seeds: Sequence[int] = (0,),
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
) -> PositionsVerification:
    """Return the gaps at positions that were not fitted, with and without what was found.

    Parameters
    ----------
    finding : PositionsFinding
    seeds : sequence of int
        Of the simulator. The spread over them is the noise of the tracing.
    cache : path, optional
        As for `find`.
    progress : callable, optional
        Called with what is computed, the number of finished steps and their total.

    Raises
    ------
    DataError
        For fewer than four pairs, or where the finding has nothing to add to a surface.
    """
    chosen = tuple(checks.whole("seeds", s, 0) for s in checks.listed("seeds", seeds))
    if not chosen:
        raise DataError("seeds is empty; it has at least one")
    if len(set(chosen)) < len(chosen):
        raise DataError(f"seeds has one twice: {', '.join(map(str, chosen))}")
    if (nothing := finding.reason_for_none) is not None:
        raise DataError(nothing)
    case = finding.case
    check_pairs(finding.pairs)
    halves, tried = halves_of(finding.pairs), tuple(finding.effects.values())
    searched = []
    for n, half in enumerate(halves):
        again = find_by_positions(
            case.only(half), tried, finding.controls, cache, chosen[0], finding.left_out
        )
        searched.append(next((c for c in again.candidates if c.can_be_added), None))
        if progress is not None:
            progress("search in half of the pairs", n + 1, len(halves) + len(chosen) * _MODELS)
    path, shape = None, (len(MODELS), len(chosen), *finding.map.shape)
    if cache is not None:
        path = checks.path("cache", cache) / f"{_key(finding, chosen, searched)}.array"
    gaps = None if path is None else disk.read(path)
    if gaps is None or gaps.shape != shape:
        gaps = _gaps(finding, halves, searched, chosen, progress)
        if path is not None:
            disk.write(path, gaps)
    return PositionsVerification(
        finding=finding,
        gaps=gaps,
        added=tuple(searched),
        halves=halves,
        seeds=chosen,
    )


_MODELS = 5
"""Models by seed: as stated, and with each half of the pairs the calibrated and the corrected one."""


def _gaps(
    finding: PositionsFinding,
    halves: Sequence[Sequence[Pair]],
    added: Sequence[Candidate | None],
    seeds: Sequence[int],
    progress: TaskProgress | None,
) -> Array:
    """Return the gaps at held-out pairs, (n_models, n_seeds, n_parameters, n_pairs, n_bands)."""
    case = finding.case
    gaps = np.full((len(MODELS), len(seeds), *finding.map.shape), np.nan)
    done = len(halves)

    def tell(model: int) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(TITLES[MODELS[model]], done, len(halves) + len(seeds) * _MODELS)

    # A gap is not to be that of the tracing's noise. The paths of a seed are traced once for all models
    # in the stated geometry.
    stated = case.simulator.denser()
    with_added = [
        stated if best is None else corrected_geometry(case.only(half), best).simulator.denser()
        for half, best in zip(halves, added, strict=True)
    ]
    for n, seed in enumerate(seeds):
        trace_ahead(stated, stated.room.alpha, seed)
        as_stated = observe(stated, stated.room.alpha, finding.parameters, seed=seed)
        tell(0)
        for half, simulator in zip(halves, with_added, strict=True):
            left = [p for p in finding.pairs if p not in half]
            columns = [finding.pairs.index(p) for p in left]
            fitted = case.only(half)
            gaps[0, n][:, columns] = _gap_in_jnd(case, finding, as_stated, left)
            for model, tracer in enumerate((stated, simulator), 1):
                heard = heard_calibrated(fitted, tracer, finding, seed)
                gaps[model, n][:, columns] = _gap_in_jnd(case, finding, heard, left)
                tell(model)
    return gaps


def _key(finding: PositionsFinding, seeds: Sequence[int], added: Sequence[Candidate | None]) -> str:
    """Return a hash of all that the gaps depend on."""
    case = finding.case
    content = [
        "verify",
        key_of(case, seeds[0]),
        case.room.to_dict(),
        case.measured.to_dict(),
        [case.exclude, finding.pairs, finding.parameters, seeds, case.position_uncertainty],
        [None if best is None else best.to_dict() for best in added],
        hashlib.sha256(finding.controls.errors.tobytes()).hexdigest(),
    ]
    text = json.dumps(content, sort_keys=True, default=list)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def halves_of(pairs: Sequence[Pair]) -> tuple[tuple[Pair, ...], ...]:
    """Return two halves with every source in both: every second receiver of each source.

    Sources begin in turn with the first and the second receiver, so that a half has all receivers
    where there are two sources.
    """
    sources = list(dict.fromkeys(s for s, _ in pairs))
    receivers = list(dict.fromkeys(r for _, r in pairs))
    even = tuple((s, r) for s, r in pairs if (sources.index(s) + receivers.index(r)) % 2 == 0)
    return even, tuple(p for p in pairs if p not in even)


def heard_calibrated(
    fitted: PositionsCase, simulator: PathTracing, finding: PositionsFinding, seed: int
) -> Observations:
    """Return what all positions hear in a model that is calibrated on the fitted pairs."""
    result = calibrate_positions(
        simulator,
        simulator.room,
        fitted.measured,
        finding.parameters,
        exclude=fitted.exclude,
        controls=finding.controls,
        more_paths=1,  # it is denser already
        seed=seed,
    )
    # Its tracer scatters as fitted, with which alpha was calibrated.
    return observe(result.tracer, result.alpha, finding.parameters, seed=seed)


def _gap_in_jnd(
    case: PositionsCase, finding: PositionsFinding, heard: Observations, pairs: Sequence[Pair]
) -> Array:
    """Return simulated less measured at pairs in JND, (n_parameters, n_pairs, n_bands).

    A relative level has its mean over each source's pairs taken off.
    """
    measured = Observations.of_measurement(case.in_room, finding.parameters, pairs)
    return gap_at_pairs(heard.at(measured), measured, relative=LEVEL.key in case.measured.values)
