"""A prediction in words: the table, what its interval is made of, and what to measure next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.changes import Target
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.types import Array

ALPHA = 'alpha of "{}"'
STAYS = "alpha of what stays"
EQUATION = "the equation"
SIZES = "volume, areas and climate"
PROGRAM = "the program"
MEASUREMENT = "the measured T"
BEFORE = "T before, which was not measured"
MEASURED, MODEL, STATED = "measured", "calibrated model", "input coefficients"
CALIBRATED = "calibrated room"
"""What T before is."""
ALIKE, CHANGED_ALONE = (
    "error of the simulator in both rooms",
    "error of the simulator in the changed room",
)
COVERS, PLACES = "the covered areas", "where the cover lies"

_ADVICE = {
    STAYS: "measure T in a second state of the room, such as with part of the change, to separate "
    "the absorption that stays from that of the change",
    EQUATION: "measure T in a second state of the room, such as with part of the change, to determine "
    "the error of the equation, or use a simulator",
    BEFORE: "measure T in the room as it is",
    SIZES: "survey the volume and the areas, and measure the climate if it is uncertain",
    MEASUREMENT: "measure T at more positions",
    ALIKE: "measure at more positions",
    CHANGED_ALONE: "measure after the first part of the change, which is the only way to determine it",
    PROGRAM: "measure after the first part of the change, which shows the error of the program",
    COVERS: "measure the areas that are covered",
    PLACES: "specify the place of the cover: give it a material of its own in the mesh and in the room",
}


def advice(part: str, n_states: int) -> str:
    """Return the measurement that would narrow one part of an interval, after this number of states."""
    if n_states == 0 and part in (STAYS, EQUATION):
        return "measure T in the room as it is"
    if part == EQUATION and n_states > 1:
        return (
            "use a simulator: several states were measured, and the error of the equation remains"
        )
    return _ADVICE.get(part, f"measure {part}, or T with the first square metres of the change")


ASSUMED = {
    "volume": "relative error of the volume",
    "areas": "relative error of each area",
    "common": "error of ln T before, where it was not measured",
    "factor": "standard deviation of the logarithm of the equation's error, for each material's "
    "absorption",
    "least": "the same, as an absorption coefficient",
    "evenness": "mean of u, which goes from the equation (0) to Arau-Puchades' (1) and Fitzroy's (2)",
    "evenness_sigma": "standard deviation of u",
    "one_surface": "probability that all exchanged surfaces face one axis, if their axes are not given",
    "own": "relative error of a change between two measured states that no factor explains",
    "changed": "least sigma of a new material, at positions",
    "time": "relative uncertainty of a measured T that has none",
    "band_correlation": "correlation of the errors an octave apart",
}
"""What the numbers of `rtcal.prediction.Assumptions` are."""
REMARK = (
    "The interval is for a measurement without error{}, and is only as accurate as these numbers "
    "and the input sigma. One JND is 5 % of T."
)
NOTHING_CHANGES = "Nothing changes, so T stays as it was before."
NOTHING_MEASURED = "Nothing was measured: the interval is that of the input coefficients."
CALIBRATED_BEFORE = (
    "T before was calculated from the calibrated room, and the interval follows from the sigma "
    "of its coefficients. For the measured T before, give the room as it was before its "
    "calibration, and the measurement."
)
GIVEN = (
    "An error of the measured T before shifts T after by at most the same percentage. The intervals do "
    "not count it; the table has its standard uncertainty."
)
EXACT_BEFORE = (
    "The measured T counts as exact: the probability does not include its uncertainty, which is in the "
    "table."
)
UNPLACED = (
    "The room does not give the axes of the surfaces that change. The interval therefore allows "
    "for all of them on one pair of walls, where T falls less. To narrow it, give the axis of "
    "each surface, or the dimensions, or name the surfaces floor, ceiling and wall."
)


def of_target(target: Target) -> list[str]:
    """Return where a target is from in a sentence; none if the user gave its limits."""
    return [] if target.source == Target.source else [f"The target is {target.source}."]


def headline(
    labels: Sequence[str],
    before: Array,
    after: Array,
    interval: tuple[Array, Array],
    parameter: str = "T",
) -> str:
    """Return the change of a decay time in a sentence; before and after in s, (n_bands,) each."""
    change = np.round(100 * (after / before - 1))
    k = int(np.argmax(np.abs(change)))
    verb = "falls" if change.max() <= 0 else "rises" if change.min() >= 0 else "changes"
    ends = sorted(change.tolist() if verb == "changes" else np.abs(change).tolist())
    form = "+.0f" if verb == "changes" else ".0f"
    by = format(ends[-1], form)
    if by != format(ends[0], form):
        by = f"{format(ends[0], form)} to {by}"
    low, high = interval
    how = f"{verb} by {by} %" if change.any() else "changes by less than 1 %"
    return (
        f"{parameter} {how}. The largest change is at {labels[k]}: from {before[k]:.2f} to "
        f"{after[k]:.2f} s (90 % interval {low[k]:.2f} to {high[k]:.2f} s)."
    )


def not_measured(labels: Sequence[str]) -> str:
    """Return that T before was not measured in some bands."""
    return (
        f"At {', '.join(labels)} T before was not measured. There the T of the model is used, and the "
        "interval includes the error of the model."
    )


def uneven(
    label: str, mean: float, times: Mapping[str, float], interval: tuple[float, float]
) -> str:
    """Return the caution that T after the change depends on the equation, as absorption is uneven."""
    (own, even), (_, of_axes) = times.items()
    low, high = interval
    outside = [f"{t:.2f} s" for t in times.values() if not low <= t <= high]
    allowed = f"does not contain {' and '.join(outside)}" if outside else "contains both values"
    why = "The less the surfaces scatter, the longer is T"
    if of_axes < even:
        why = "Arau-Puchades' T is the shorter where one pair of walls absorbs nearly everything"
    return (
        f"{_UNEVEN}, so T after depends on the equation. {why}. The interval {allowed}: at {label} "
        f"{even:.2f} s by {own}'s equation and {of_axes:.2f} s by Arau-Puchades'. T after, "
        f"{mean:.2f} s, is a mean over both and Fitzroy's."
    )


def of_calibrated(
    label: str, old: tuple[str, float, float], new: Sequence[str], share: float
) -> str:
    """Return that a calibration changed the coefficients of what leaves, and not those of what comes.

    ``label`` is the band. ``old`` are the name of the covered material, its input and its calibrated
    alpha, ``new`` the names of the new materials. ``share`` is the change of T by the difference, as a
    share of T.
    """
    name, stated, calibrated = old
    come = " and ".join(f'"{each}"' for each in new)
    if stated:
        alike = (
            f" If both deviate alike from their input, multiply it by {calibrated / stated:.2g}."
        )
    else:
        alike = ""
    return (
        f'Calibration changed alpha of "{name}" at {label} from {stated:.2g} to {calibrated:.2g}, but '
        f"{come} {'have' if new[1:] else 'has'} the input alpha. The difference changes T by "
        f"{100 * share:+.0f} %.{alike}"
    )


def of_hard(label: str, below: float, equation: str) -> str:
    """Return why T after is below the equation's by a share of it, in a band."""
    return (
        f"At {label} T after is {100 * below:.0f} % below that by {equation}'s equation alone, because "
        "hard surfaces may absorb much more than their alpha, but only a little less."
    )


_UNEVEN = "Caution: the absorption is uneven after the change"
_NEXT = "Next: to narrow the interval, "
_CALIBRATION = "Calibration "
_JOINED = (_UNEVEN, _CALIBRATION, _NEXT)
"""Beginnings of the sentences that end with values after a colon, which `joined` joins."""


def joined(own: Sequence[tuple[str, str]]) -> list[str]:
    """Return the sentences of several variants, each with its variant's name.

    ``own`` are pairs of name and sentence. A sentence that several variants share, or share up to its
    values, is printed once, with the names or the values of all.

    >>> joined([("panels", "Measure T."), ("curtain", "Measure T.")])
    ['panels, curtain: Measure T.']
    """
    alike: dict[str, list[tuple[str, str]]] = {}
    for name, said in own:
        start, _, values = said.rpartition(": ") if said.startswith(_JOINED) else (said, "", "")
        alike.setdefault(start, []).append((name, values.removesuffix(".")))
    found = []
    for start, each in alike.items():
        if start.startswith(_JOINED) and len(each) > 1:
            found.append(f"{start}: {'; '.join(f'{name} {values}' for name, values in each)}.")
            continue
        names, values = ", ".join(name for name, _ in each), each[0][1]
        said = f"{start}: {values}." if start.startswith(_JOINED) else start
        kind, _, rest = said.partition(": ")
        of_kind = kind in ("Caution", "Next")
        found.append(f"{kind}, {names}: {rest}" if of_kind else f"{names}: {said}")
    return found


def in_order(sentences: Sequence[str]) -> list[str]:
    """Return sentences with the cautions after what supports the answer, and the next steps last.

    >>> in_order(["Next: measure.", "Caution: uneven.", "T falls."])
    ['T falls.', 'Caution: uneven.', 'Next: measure.']
    """
    return sorted(sentences, key=lambda s: s.startswith("Caution") + 2 * s.startswith("Next"))


def to_narrow(parts: Mapping[str, Array], n_states: int) -> str:
    """Return the largest of an interval's parts, (n_bands,) each, and how to narrow the interval."""
    largest, share = next((name, float(part.mean())) for name, part in parts.items())
    return (
        f"{_NEXT}{advice(largest, n_states)}. The largest part of the interval's variance comes from "
        f"{'the ' * largest.startswith('error')}{largest} (mean of the bands): {100 * share:.0f} %."
    )


def by_program(
    label: str,
    times: tuple[float, float],
    by_equation: float,
    half_widths: tuple[float, float],
    left: Sequence[str],
) -> str:
    """Return sentences on the change of T by a program and by the equation, in one band."""
    said = (
        f"The change is the program's: at {label} from {times[0]:.2f} to {times[1]:.2f} s. By the "
        f"equation alone T after is {by_equation:.2f} s, ± {100 * half_widths[0]:.0f} % in "
        f"place of ± {100 * half_widths[1]:.0f} %."
    )
    if not left:
        return said
    return f"{said} At {', '.join(left)} the equation predicts, because a run has no T there."


def gained(without: Array, half_width: Array, of: str = "T", unit: str = "") -> str:
    """Return in words by how much calibration narrowed the interval of a parameter."""
    before, after = (float(np.median(each)) for each in (without, half_width))
    how = "narrowed" if after < before else "did not narrow"
    ends = (f"{x:.2g} {unit}".rstrip() if unit else f"{100 * x:.0f} %" for x in (before, after))
    return (
        f"{_CALIBRATION}{how} the interval of {of} (median of the bands): ± {next(ends)} without "
        f"calibration and ± {next(ends)} with it."
    )


def blocks_of(
    heads: Sequence[str],
    labels: Sequence[str],
    rows: Sequence[Row],
    parts: tuple[str, Mapping[str, Array]],
    sentences: Sequence[str],
) -> list[Block]:
    """Return the blocks of a prediction: values by band, the parts of the interval, and sentences."""
    interval, shares = parts
    made_of = [Row(name, [100 * s for s in share], ".0f") for name, share in shares.items()]
    return [
        *map(Note, heads),
        *map(Note, sentences),
        Table(labels, rows),
        Table(labels, made_of, f"Parts of {interval} / % of the variance"),
    ]


@dataclass(frozen=True, eq=False)
class Shown:
    """Hold what a table of variants and a page show of a prediction: T, or the mean of a parameter.

    ``name`` is the parameter's name with its unit. ``before``, ``after`` and both ends of the 90 %
    ``interval`` are (n_bands,). ``parts`` are the shares of the variance of the quantity ``of``, by
    cause.
    """

    name: str
    of: str
    before: Array
    after: Array
    interval: tuple[Array, Array]
    parts: Mapping[str, Array]
