"""The words of a verification: the verdict with its reasons, notes, and the table of the gaps."""

from __future__ import annotations

import numpy as np

from rtcal.acoustics import bands
from rtcal.finder.claim import Candidate
from rtcal.finder.finding import rivals, support
from rtcal.finder.verification import MISSES, Miss, Verification, mean_of_known
from rtcal.report.finding_words import name_of, next_step
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.text import as_sentence, first_of, listed, with_uncertainty
from rtcal.support.types import Array

_SHOWN_MISSES = 3  # bands that miss what was measured and are named in a sentence
_EXACT = 0.005  # gap in JND that is printed as 0.00
_USED = (
    "Matched: alpha is calibrated to it. Held out: neither alpha nor the effect is fitted to it. "
    "Without a mark: the effect is fitted to it, alpha is not."
)
"""What the rows of a table of means are marked by."""
_ONLY_SCALED = (
    "As simulated, the second run deviates less than the first, so that rtcal's calibration of both "
    "runs may be wrong. Calibrate your program without and with the effect, and give both results: "
    "--calibrated and --simulated."
)
_MET = 2.0  # standard deviations of T within which a calibration has met it


def of_miss(miss: Miss) -> str:
    """Return both values and the band: "T20 at 500 Hz is 0.53 s (measured: 0.645 ± 0.013 s)"."""
    unit = f" {miss.unit}" if miss.unit else ""
    at = bands.label(miss.frequency) + (f' in "{miss.place}"' if miss.place else "")
    measured = f"{miss.measured:.3g} ± {miss.uncertainty:.2g}{unit}"
    return f"{miss.quantity} at {at} is {miss.model:.3g}{unit} (measured: {measured})"


def misses(v: Verification) -> str:
    """Return which values the corrected model does not reproduce, and what follows; "" without any."""
    return f"Do not simulate with the {_corrected(v)}: {_missed(v, 'its')}." if v.misses else ""


def _corrected(v: Verification) -> str:
    """Return what the model with what was found is called."""
    return "room after the change" if v.finding.kind == "states" else "corrected model"


def _missed(v: Verification, whose: str) -> str:
    """Return which values of the corrected model, ``whose`` values they are, miss the measured ones."""
    worst = sorted(v.misses, key=lambda miss: -abs(miss.jnd))
    said = first_of([*map(str, worst)], _SHOWN_MISSES)
    before, after = _as_compared(v)
    return f"{before}{whose} {said}{after}"


def _as_compared(v: Verification) -> tuple[str, str]:
    """Return where the corrected model misses a value, as words before it, and why, as words after."""
    if v.finding.kind == "states":
        return "with the change that was found, ", ""
    if v.finding.kind == "positions":
        run = "in the second run and " * bool(v.again.size)
        return f"{run}averaged over pairs to which it was not fitted, ", ""
    if not v.runs:
        why = "Coefficients that give the measured T would be further from the input than sigma allows"
        return "even after calibration, ", f". {why}"
    scaled = v.models[1] not in v.runs
    return f"in the second run{', scaled to the measured T by the equation' * scaled}, ", ""


def _unproven(v: Verification, found: str, again: str, gain: str, measured: list[str]) -> list[str]:
    """Return that a finding is unproven, what is for it and what against it.

    ``again`` is what the halves of the pairs found that is other; "" for nothing.
    """
    said = (
        f"The correction is unproven: the verification neither confirms {found} nor rules it out."
    )
    if v.gain > 0 and v.misses:
        against = _missed(v, f"the {_corrected(v)}'s")
        against = f"Against it: {again}{against}. Do not simulate with this model."
        return [said, f"For it: {gain}", *measured, against]
    gain = again + gain
    return [said, misses(v), f"{gain[:1].upper()}{gain[1:]}", *measured]


def sentence(v: Verification) -> str:
    """Return the verdict, the change of the deviation with its standard error, and the objections."""
    little = [str(reason) for reason in v.objections if reason.code == "little left"]
    if np.isnan(v.before) or (v.verdict == "not tested" and little):
        why = (
            "the finding was fitted to all that was measured. Measure C80 or G, or a second "
            "configuration."
        )
        if little:
            why = f"at {listed(v.held_out)}, {little[0]}."
        elif v.runs and v.held_out:
            why = (
                "the second run does not have the data that the finding was not fitted to "
                f"({listed(v.held_out)}). Simulate them, too."
            )
        said = [f"The correction is not tested: {why}", _as_simulated(v)]
    else:
        supported = v.verdict == "supported"
        verb = "reduces" if v.gain > 0 else "increases"
        grounds = [str(reason) for reason in v.objections if reason.code != MISSES]
        again, but = _found_again(v)
        found = "what was found" if v.contained is None else v.contained.title
        found = found if v.corrected is None else name_of(v.finding, _verified(v).effect)
        by = with_uncertainty(abs(v.gain), v.uncertainty, 2)
        required = f"; required: more than {v.needed:.2f} JND" if supported else ""
        of = "" if v.finding.kind == "states" else "calibrated "
        gain = (
            f"adding {found} to the model {verb} the mean deviation at data that were not "
            f"fitted ({', and '.join(v.held_out)}) by {by} JND (standard error{required}): from "
            f"{v.before:.2f} JND ({of}without it) to {v.after:.2f} JND ({of}with it)."
        )
        measured = [
            _as_simulated(v),
            as_sentence(listed(grounds)) if grounds else "",
            _ONLY_SCALED if v.only_scaled else "",
        ]
        if v.verdict == "unproven":
            effect = "the effect" if v.corrected is None else found
            return " ".join(filter(None, _unproven(v, effect, again, gain, measured)))
        said = [
            f"The correction is {v.verdict}{but if supported else ''}: {again}{gain}",
            *measured,
            "The model is better, but the name of the effect may still be wrong."
            if supported
            else "",
        ]
    return " ".join(filter(None, [*said, misses(v)]))


def _as_simulated(v: Verification) -> str:
    """Return the gaps of both runs as they are, what was not fitted first; "" without a second run."""
    if not v.again.size:
        return ""
    known = np.where(np.isfinite(v.again), v.gaps[0].mean(axis=0), np.nan)
    first, second = (mean_of_known(np.abs(of), (1, 2)) for of in (known, v.again))
    held_out_first = np.argsort(~v.counted[:, 0], kind="stable")
    said = [
        f"{v.quantities[i]} {first[i]:.2f} to {second[i]:.2f} JND"
        for i in held_out_first.tolist()
        if np.isfinite(second[i])
    ]
    return f"From the first run to the second, as simulated: {listed(said)}."


def _found_again(v: Verification) -> tuple[str, str]:
    """Return what halves of the pairs found that is other, and what a support leaves open."""
    if v.uncorrected is not None:
        alike = [c.effect for c in rivals(v.finding, _verified(v))]
        return "", f", but not distinguished from {listed(alike)}" if alike else ""
    found, (others, in_kind) = v.contained or v.finding.likeliest, v.found_elsewhere
    if not others or found is None:
        return "", ""
    each = listed([*dict.fromkeys("nothing" if c is None else c.title for c in others)])
    which = "the halves of the pairs" if len(others) > 1 else "half of the pairs"
    not_so = "as all pairs did" if v.contained is None else "which the second run contains"
    comma = "," * (v.contained is not None)
    again = f"{which} found {each}, not {found.title}{comma} {not_so}; "
    return again, "" if in_kind else f" for {found.kind}, not for its surface"


def notes(v: Verification) -> list[str]:
    """Return the notes on the comparison."""
    if v.uncorrected is not None and v.corrected is not None:
        how = "found" if v.effect == v.finding.best_effect else "verified"
        found = f"The effect that was {how} is {support(v.finding, _verified(v))}."
        return [found, *(_of_runs(v) if v.runs else [_of_time(v)]), *v.notes]
    return [*(_of_runs(v) if v.runs else ()), *v.notes, *(_of_pairs(v) if v.halves else ())]


def _verified(v: Verification) -> Candidate:
    """Return the candidate of means that is verified."""
    return v.finding.candidate(v.effect) or v.finding.candidates[0]


def _of_runs(v: Verification) -> list[str]:
    """Return which models are runs of the program, and what the effect was sized with."""
    at_pairs, again = v.finding.kind == "positions", v.again.size > 0
    which = f"{listed([*v.models]).capitalize()} are unchanged runs of the program."
    if v.models[1] not in v.runs and not again:
        which = (
            f"{v.models[1].capitalize()} and {v.models[2]} are the run plus the changes that rtcal's "
            "tracer predicts. To compare a second run: rtcal verify FOUND --simulated RUN."
        )
    elif v.models[1] not in v.runs:
        how = "calibrated to half of the pairs by rtcal's tracer"
        which = (
            f"{v.models[1].capitalize()} and {v.models[2]} are the first and the second run, each "
            f"{how if at_pairs else 'scaled to the measured T by the equation'}."
        )
    if not again:
        return [which]
    if v.contained is None:
        return [which, "The size of the simulated effect comes from all data."]
    return [which, f"The second run contains {v.contained.title}, which was chosen with all pairs."]


def _of_time(v: Verification) -> str:
    """Return whether the calibrations meet the fitted T."""
    time, gap = v.quantities[0], v.sizes[1, 0, 0, 0]
    if v.corrected is not None and v.corrected.off > _MET:
        return (
            f"Over all bands, {time} of the calibrated corrected model deviates from the measured "
            f"{time} by {v.corrected.off:.1f} times the measurement's uncertainty (root mean square)."
        )
    how = "exactly" if gap < _EXACT else f"to {gap:.2f} JND"
    return (
        f"Calibrated without the effect, the model reproduces the fitted {time} {how}; with the "
        "effect, as closely as the uncertainty of T allows."
    )


def _of_pairs(v: Verification) -> list[str]:
    """Return the gap as stated, and what each half of the pairs added."""
    seeds = v.gaps.shape[1]
    in_table = "; in the table, ± is the standard deviation over the seeds" * (seeds > 1)
    stated, plainly = mean_of_known(np.abs(v.gaps[:2]), (1, 2, 3, 4)).tolist()
    first = "run" if v.runs else "model with its input coefficients"
    out = [
        f"This standard error is that over {len(v.places)} pairs and {seeds} "
        f"seed{'s' * (seeds != 1)} of the simulator{in_table}. The {first} "
        f"deviates by {stated:.2f} JND."
    ]
    if stated < plainly:
        out.append(
            f"The calibrated model deviates no less than the {'run' if v.runs else 'input model'}: do "
            "not simulate with it."
        )
    for half, what in zip(v.halves, v.added, strict=True):
        names = ", ".join(" to ".join(pair) for pair in half)
        added = "nothing" if what is None else f"{what.title}, {what.in_words}"
        out.append(f"Searching with the pairs {names} alone, rtcal added {added}.")
    return out


def gaps(v: Verification) -> Table:
    """Return the table of mean deviations of each model at held-out data."""
    sizes, rows = v.sizes, list[Row]()

    def row(name: str, by_seed: Array) -> None:
        """Add a row: means over the seeds, and their standard deviation, which a run does not have."""
        means, several = by_seed.mean(axis=1), by_seed.shape[1] > 1
        spread = by_seed.std(axis=1, ddof=1) if several else np.zeros(len(means))
        if np.isfinite(means).all():
            cells = [
                f"{m:.2f}" if s < _EXACT else with_uncertainty(m, s, 2)
                for m, s in zip(means, spread, strict=True)
            ]
            rows.append(Row(name, cells))

    by_pair = v.counted.all() or bool(v.halves)
    if by_pair:
        for q, quantity in enumerate(v.quantities):
            matched = "" if v.counted[q].any() else " (matched)"
            row(f"{quantity}{matched}", mean_of_known(sizes[:, :, q], 2))
    for p, place in enumerate(v.places):
        if by_pair:
            row(place, mean_of_known(np.where(v.counted, sizes, np.nan)[:, :, :, p], 2))
            continue
        for q, quantity in enumerate(v.quantities):
            used = "matched" if p == q == 0 else ""
            used = "held out" if v.counted[q, p] else used
            row(f"{quantity} of {place}{f' ({used})' if used else ''}", sizes[:, :, q, p])
    row("all that was held out", v.by_seed)
    note = "" if v.counted.all() else _USED
    return Table(v.models, rows, corner="mean deviation / JND", note=note)


def blocks(v: Verification) -> list[Block]:
    """Return a verification as blocks, with the next measurement unless the finding is supported."""
    step = "" if v.verdict == "supported" else next_step(v.finding, v)
    following = [f"Next: {step}"] if step else []
    out: list[Block] = [*map(Note, [sentence(v), *notes(v), *following]), gaps(v)]
    return out if v.corrected is None else [*out, *v.corrected.blocks(v.uncorrected)]
