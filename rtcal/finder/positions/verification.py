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

import numpy as np

from rtcal.acoustics.observables import LEVEL, parameter_label
from rtcal.files import disk
from rtcal.finder.corrected import corrected_geometry
from rtcal.finder.finding import Candidate
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.finding import PositionsFinding, kind
from rtcal.finder.positions.search import find_by_positions
from rtcal.finder.positions.weighing import key_of
from rtcal.finder.verification import (
    Gap,
    Verification,
    check_pairs,
    gain_over_pairs,
    misses_over_pairs,
)
from rtcal.loop.control_runs import trace_ahead
from rtcal.loop.measured_pairs import Pair, gap_at_pairs
from rtcal.loop.positions import calibrate_positions
from rtcal.simulators.base import Observations, observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import TaskProgress
from rtcal.support.text import listed
from rtcal.support.types import Array

MODELS = {
    "before": "as stated",
    "plain": "calibrated",
    "corrected": "corrected and calibrated",
}
"""The models whose gaps are compared, and how each is called."""


def concluded(
    finding: PositionsFinding,
    gaps: Array,
    added: Sequence[Candidate | None],
    halves: Sequence[Sequence[Pair]],
    seeds: Sequence[int],
) -> Verification:
    """Return what the gaps at pairs that were not fitted say of a finding.

    Parameters
    ----------
    finding : PositionsFinding
    gaps : array (n_models, n_seeds, n_parameters, n_pairs, n_bands)
        Simulated less measured in JND at held-out pairs, of each of `MODELS`.
    added : sequence of (Candidate or None)
        What each half added to its model, half by half; None where it found no surface.
    halves : sequence of sequences of pairs
    seeds : sequence of int
        Of the simulator.
    """
    size, pairs, parameters = np.abs(gaps), finding.pairs, finding.parameters
    before, plain, after = np.nanmean(size, axis=(2, 3, 4)).mean(axis=1).tolist()
    without, with_it = (np.nanmean(each, axis=(1, 3)) for each in size[1:])
    by_seed = np.nanmean(size, axis=(3, 4))
    spread = by_seed.std(axis=1, ddof=1) if len(seeds) > 1 else np.full(by_seed[:, 0].shape, np.nan)
    by_parameter = np.nanmean(size, axis=(1, 3, 4))
    by_pair = np.nanmean(size, axis=(1, 2, 4))
    measured = Observations.of_measurement(finding.case.in_room, parameters, pairs)
    relative = LEVEL.key if LEVEL.key in finding.case.measured.values else ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a band without a value
        left = np.nanmean(gaps[-1], axis=0)
        matched = {
            name: (np.nanmean(measured.natural(name), axis=0), left[p])
            for p, name in enumerate(parameters)
            if name != relative  # its mean over the pairs is taken off
        }
    doubts, but, again = _found_again(finding, added)
    n_seeds = "1 seed" if len(seeds) == 1 else f"{len(seeds)} seeds"
    notes = [
        f"± is the standard error over {len(pairs)} pairs and {n_seeds} of the simulator. As stated, "
        f"the gap is {before:.2f} JND."
    ]
    if before < plain:
        notes.append(
            "Calibrated, the model is no better there than as stated: do not simulate with it."
        )
    for half, what in zip(halves, added, strict=True):
        names = ", ".join(" to ".join(pair) for pair in half)
        said = "nothing" if what is None else f"{what.title}, {what.in_words}"
        notes.append(f"Fitted on {names}: added {said}.")
    return Verification(
        finding=finding,
        models=tuple(MODELS.values()),
        held_out=("pairs that were not fitted",),
        before=plain,
        after=after,
        **gain_over_pairs(without - with_it),
        quantities=(
            *(
                Gap(parameter_label(name), "", tuple(values), "", tuple(off))
                for name, values, off in zip(
                    parameters, by_parameter.T.tolist(), spread.T.tolist(), strict=True
                )
            ),
            Gap("all", "", (before, plain, after)),
            *(
                Gap(" to ".join(pair), "", tuple(values))
                for pair, values in zip(pairs, by_pair.T.tolist(), strict=True)
            ),
        ),
        misses=misses_over_pairs(matched, pairs, finding.case.room.centre_frequencies),
        doubts=doubts,
        but=but,
        found_again=again,
        notes=tuple(notes),
        gaps=gaps,
        details={
            "pairs": [list(p) for p in pairs],
            "seeds": list(seeds),
            "halves": [[list(p) for p in half] for half in halves],
            "gaps_jnd": dict(zip(MODELS, np.nanmean(size, axis=(2, 3, 4)).tolist(), strict=True)),
            "by_parameter_jnd": {
                model: dict(zip(parameters, values, strict=True))
                for model, values in zip(MODELS, by_parameter.tolist(), strict=True)
            },
            "by_pair_jnd": dict(zip(MODELS, by_pair.tolist(), strict=True)),
            "added": [None if c is None else c.to_dict() for c in added],
        },
    )


def _found_again(
    finding: PositionsFinding, added: Sequence[Candidate | None]
) -> tuple[tuple[str, ...], str, str]:
    """Return doubts, what a support leaves open, and what halves found that is other, in words.

    The same thing is of the same family, all of added absorption as one; where a surface is claimed,
    also on that surface, or on one that these positions do not tell from it.
    """
    found, claimed = finding.likeliest, finding.surface
    if found is None:
        return (), "", ""
    alike = {claimed}.union(*(g for g in finding.groups if claimed in g))
    others = differing = [
        c
        for c in added
        if c is None or kind(c) != kind(found) or not (claimed is None or c.surface in alike)
    ]
    if not differing:
        others = [c for c in added if c is not None and c.surface != found.surface]
    if not others:
        return (), "", ""
    each = listed([*dict.fromkeys("nothing" if c is None else c.title for c in others)])
    which = "the halves of the pairs" if len(others) > 1 else "half of the pairs"
    again = f"{which} found {each}, not {found.title} as all pairs did; "
    if differing:
        return ("the halves of the pairs found another thing than all pairs",), "", again
    return (), f" for {kind(found)}, not for its surface", again


def verify(
    finding: PositionsFinding,
    *,
    seeds: Sequence[int] = (0,),
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
) -> Verification:
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
    return concluded(finding, gaps, searched, halves, chosen)


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
            progress([*MODELS.values()][model], done, len(halves) + len(seeds) * _MODELS)

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
    return gap_at_pairs(
        heard.at(measured).values, measured, relative=LEVEL.key in case.measured.values
    )
