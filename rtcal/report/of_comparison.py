"""A run beside a measurement in words, as a table and as a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.comparison import NOTICED, Comparison
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.marks import LARGE_Z, of_unit, rms
from rtcal.acoustics.observables import OBSERVABLES, REVERBERATION, parameter_label
from rtcal.acoustics.room import is_calibrated
from rtcal.report import figures
from rtcal.report.document import Code, Items, Page, Picture, Section, summary, tables
from rtcal.support import __version__
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.text import as_sentence, listed, number, numbers
from rtcal.support.types import Array

_MOST = 3  # parameters of which the answer says where they disagree
_STRONG = 5.0  # JND
_MULTIPLE = 1.5  # ratio of T from which the same one in all bands is a mistake of what is stated
_BANDS = 3  # that must show it: two may be alike by chance
_LEAST = 1e-6  # JND; equal values at all positions do not show their uncertainty


def sentence(c: Comparison) -> str:
    """Return in words which parameters disagree, by how much and where, the largest first."""
    whose = f"{c.equation.name}'s" if c.of_equation else "The program's"
    wrong = [p for p in c.parameters if c.disagrees[p].any()]
    right = listed([parameter_label(p) for p in c.parameters if p not in wrong])
    if not wrong:
        agree = f"{whose} {right} agree{'s' * (len(c.parameters) == 1)} with the measurement"
        agree += " in the mean over the pairs" if c.pairs else ""
        return f"{agree}, within {NOTICED:g} JND or twice the uncertainty in all bands."
    said = []
    for p in wrong[:_MOST]:
        of_time = OBSERVABLES[p].unit == "s"
        words = ("too short", "too long") if of_time else ("too low", "too high")
        deviates = _groups(c, c.deviation[p], c.disagrees[p], p, words)
        said.append(f"{parameter_label(p)} is {deviates}")
    if more := [parameter_label(p) for p in wrong[_MOST:]]:
        deviates = f"deviate{'s' * (len(more) == 1)}"
        said.append(f"{listed(more)} also {deviates} by more than {NOTICED:g} JND")
    if right:
        said.append(f"{right} agree{'s' * (len(c.parameters) - len(wrong) == 1)}")
    return f"{whose} {'; '.join(said)}.{_positions(c, wrong[0])}"


def _groups(
    c: Comparison, deviation: Array, chosen: NDArray[np.bool_], parameter: str, words: Any
) -> str:
    """Return how much what is below and above deviates, and in which bands."""
    f = c.run.room.centre_frequencies
    known = np.isfinite(np.array([*c.deviation.values()])).any(axis=0)
    said = []
    for sign, word in zip((-1, 1), words, strict=True):
        some = chosen & (np.sign(deviation) == sign)
        if some.any():
            said.append(
                f"{_amount(deviation[some], parameter)} {word} {bands.where(f, some, known)}"
            )
    return " and ".join(said)


def _amount(deviation: Array, parameter: str) -> str:
    """Return the range of deviations in JND as percent, or in the parameter's unit."""
    kind = OBSERVABLES[parameter]
    if kind.relative_jnd:
        sizes, unit, decimals = 100 * kind.jnd * np.abs(deviation), "%", 0
    elif kind.unit == "s":
        sizes, unit, decimals = 1000 * kind.jnd * np.abs(deviation), "ms", 0
    else:
        sizes, unit, decimals = kind.jnd * np.abs(deviation), kind.unit, max(kind.decimals, 1)
    low, high = (f"{end:.{decimals}f}" for end in (sizes.min(), sizes.max()))
    return f"{low if low == high else f'{low} to {high}'} {unit}".rstrip()


def _positions(c: Comparison, parameter: str) -> str:
    """Return a sentence on whether a parameter deviates alike at all positions; "" of means."""
    if len(c.pairs) < 2:
        return ""
    each = _over_bands(c.at_pairs[parameter][:, c.disagrees[parameter]])
    each = each[np.isfinite(each)]
    same = "about" if np.ptp(each) <= abs(each.mean()) else "not"
    return f" The deviation of {parameter_label(parameter)} is {same} the same at all positions."


def _over_bands(off: Array) -> Array:
    """Return the mean over bands of what is there, (n_pairs,); NaN where nothing is."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nansum(off, axis=1) / np.isfinite(off).sum(axis=1))


def _largest_pair(c: Comparison) -> list[str]:
    """Return which pair deviates most, and in what, on the average over the bands."""
    if not c.pairs:
        return []
    each = {p: _over_bands(off) for p, off in c.at_pairs.items()}
    worst = {p: int(np.nanargmax(np.abs(off))) for p, off in each.items()}
    p = max(worst, key=lambda p: abs(each[p][worst[p]]))
    i = worst[p]
    z = float(_over_bands(c.at_pairs[p] / c.pair_uncertainty[p])[i])
    return [
        f"Of all pairs, {' to '.join(c.pairs[i])} deviates most: in the mean over the bands, its "
        f"{parameter_label(p)} deviates by {number(float(each[p][i]), '+.1f')} JND "
        f"({number(abs(z), '.1f')} standard uncertainties of the measurement)."
    ]


def _multiple(c: Comparison) -> list[str]:
    """Return that a run's T is a multiple of the measured one in all bands; [] else."""
    run, measured = c.sides
    for kind in REVERBERATION:
        if c.of_equation or kind.key not in c.deviation:
            continue
        ratio = run.mean(kind.key) / measured.mean(kind.key)
        ratio = ratio[np.isfinite(ratio)]
        factor = float(np.exp(np.log(ratio).mean()))
        alike = len(ratio) >= _BANDS and ratio.max() <= (1 + kind.jnd) * ratio.min()
        time = parameter_label(kind.key)
        if not alike and (
            slip := of_unit(ratio, np.ones_like(ratio), f"the program's {time}", "the measured one")
        ):
            return [as_sentence(slip[0].sentence)]
        if alike and max(factor, 1 / factor) >= _MULTIPLE:
            whose = ("The program's", "measured one")
            if factor < 1:
                factor, whose = 1 / factor, ("The measured", "program's")
            return [
                f"{whose[0]} {time} is {factor:.1f} times the {whose[1]} in all bands. Check the scale "
                f"of the room, and whether both tables hold {time}."
            ]
    return []


def _coefficients(c: Comparison) -> list[str]:
    """Return whether the coefficients explain what disagrees; [] where all agrees."""

    def named(chosen: Callable[[str], NDArray[np.bool_]]) -> list[str]:
        f = c.run.room.centre_frequencies
        found = [(p, chosen(p)) for p in c.parameters]
        known = {p: np.isfinite(c.deviation[p]) for p in c.parameters}
        return [
            f"{parameter_label(p)} {bands.where(f, at, known[p])}" for p, at in found if at.any()
        ]

    if not any(at.any() for at in c.disagrees.values()):
        return []
    if is_calibrated(c.run.room):
        return [
            "The coefficients were calibrated to T, so their uncertainty cannot explain a "
            "deviation of T."
        ]
    yes = named(lambda p: c.explained[p])
    no = named(lambda p: c.disagrees[p] & ~c.explained[p])
    if not yes:
        return [
            "No coefficients within the sigma of the input remove these deviations: something else is "
            "wrong, or a sigma is too small."
        ]
    part, others = ("a part of ", f", but not those of {listed(no)}") if no else ("", "")
    whose, which = "Wrong input coefficients", "other coefficients"
    if c.had_other_coefficients.any():
        whose, which = "The program's coefficients", "the input coefficients, or others"
    return [
        f"{whose} may be {part}the cause: {which} within their sigma "
        f"remove the deviations of {listed(yes)}{others}. Each band was tested by itself."
    ]


def _other_coefficients(c: Comparison) -> list[str]:
    """Return how the run's T differs because its coefficients are not the input's, where noticed."""
    if not (differs := c.had_other_coefficients).any():
        return []
    off = c.of_other_coefficients
    how = _groups(c, off, differs, REVERBERATION[0].key, ("shorter", "longer"))
    return [
        "The program had other coefficients than the input: with them T by "
        f"{c.equation.name}'s equation is {how}."
    ]


def _of_the_equation(c: Comparison) -> list[str]:
    """Return by how much the equation's T differs from the program's, where that is noticed."""
    differs = np.abs(c.of_the_equation) > NOTICED
    if c.of_equation or not differs.any():
        return []
    how = _groups(c, c.of_the_equation, differs, REVERBERATION[0].key, ("shorter", "longer"))
    said = f"T by {c.equation.name}'s equation, compared with the program's T, is {how}"
    compared = [p for p in c.parameters if p in {o.key for o in REVERBERATION}]
    if compared and not any((at & differs).any() for at in c.disagrees.values()):
        said += ". In these bands the program agrees with the measurement"
    return [said + "."]


def _table(c: Comparison) -> Table:
    """Return the deviations; of the parameters that disagree also whether alpha explains them."""
    rows = list[Row]()
    for p, off in c.deviation.items():
        rows.append(Row(f"{parameter_label(p)} / JND", off, "+.1f", off / _STRONG))
        if not c.disagrees[p].any():
            continue
        u, possible = c.uncertainty[p], c.explained[p]
        if (sure := u > _LEAST).any():
            with np.errstate(all="ignore"):
                own = np.where(sure, off / u, np.nan)
            rows.append(Row("  in standard uncertainties", own, "+.1f"))
        if c.coefficients[p][1].any():
            by_band = zip(c.disagrees[p], possible, strict=True)
            said = ["-" if not wrong else "yes" if can else "no" for wrong, can in by_band]
            rows.append(Row("  explained by coefficients", said))
    return Table(
        bands.labels(c.run.room.centre_frequencies),
        rows,
        f"Deviation ({'equation' if c.of_equation else 'program'} minus measurement); the parameter "
        'that deviates most is first. "-": the deviation is below 1 JND or 2 standard uncertainties',
    )


def _by_pair(c: Comparison) -> list[Table]:
    """Return the deviations by pair, the largest first."""
    if not c.pairs:
        return []
    every = np.concatenate([*c.at_pairs.values()], axis=1)
    order = np.argsort(-np.nan_to_num(rms(every, axis=1)), kind="stable")
    columns, shades = {}, {}
    for p, off in c.at_pairs.items():
        mean, z = _over_bands(off)[order], _over_bands(off / c.pair_uncertainty[p])[order]
        cells = zip(numbers(mean, "+.1f"), numbers(z, "+.1f"), strict=True)
        columns[parameter_label(p)] = [f"{jnd} ({own})" for jnd, own in cells]
        shades[parameter_label(p)] = np.nan_to_num(mean) / _STRONG
    table = Table.of_columns([" to ".join(c.pairs[i]) for i in order], columns, shades)
    title = "By pair: mean over the bands / JND (and in standard uncertainties), the largest first"
    return [replace(table, title=title, detail=True)]


def _values(c: Comparison) -> Table:
    """Return the means that are compared, in their units."""
    rows = [
        Row(
            f"{parameter_label(p)}, {who}{f' / {kind.unit}' if kind.unit else ''}",
            side.mean(p),
            f".{kind.decimals}f",
        )
        for p in c.parameters
        for kind in (OBSERVABLES[p],)
        for who, side in zip(
            ("equation" if c.of_equation else "run", "measured"), c.sides, strict=True
        )
    ]
    columns = bands.labels(c.run.room.centre_frequencies)
    return Table(columns, rows, "Values: means over the pairs that both have", detail=True)


def blocks(c: Comparison) -> list[Block]:
    """Return a comparison as blocks: the answer, possible causes, the table, and data left out."""
    said = (_multiple, _largest_pair, _other_coefficients, _coefficients, _of_the_equation)
    first = [sentence(c), *(line for of in said for line in of(c))]
    detailed = [*_by_pair(c), _values(c)]
    return [*map(Note, first), _table(c), *detailed, *map(Note, c.left_out)]


def picture(c: Comparison, of: str, alt: str = "") -> Picture:
    """Return the picture of the deviations ``of`` a model: mean, pairs, and what alpha can explain.

    ``alt`` is for readers who cannot see it, by default the caption.
    """
    dots = "Dots are pairs; bars" if c.pairs else "Bars"
    return Picture(
        lambda: figures.disagreement(c),
        f"How far the {of} is from the measurement. {dots} are two standard uncertainties of the "
        "measurement; orange is what errors of the coefficients can explain (two standard deviations, "
        "including parameters that follow T); grey is one JND.",
        alt,
    )


def section(c: Comparison) -> list[Any]:
    """Return the first part of a comparison's page: the answer, the picture, and possible causes."""
    of = "equation" if c.of_equation else "run"
    return summary(c.blocks(), picture(c, of, sentence(c)), wide=True)


def page(c: Comparison) -> Page:
    """Return the page of a comparison."""
    room, simulated = c.run.room, "" if c.of_equation else " --simulated run.csv"
    equation = "" if c.equation == Eyring() else f" --equation {c.equation.key}"
    assumed = [
        f"A parameter disagrees where it is off by more than {NOTICED:g} JND and by more than "
        f"{LARGE_Z:g} standard uncertainties of the measurement (as given, or else from ISO 3382-2 and "
        "the spread over pairs). One JND of a decay time is "
        f"{100 * REVERBERATION[0].jnd:g} % of it.",
        "At a single pair, a value without an uncertainty gets the reproducibility standard deviation "
        "between measuring teams.",
        "The deviation that the coefficients can explain follows from their sigma and from common "
        f"errors of handbook values, by {c.equation.name}'s equation. For other parameters, "
        "coefficients explain only what follows from T in an exponential decay.",
    ]
    blocks = [
        *section(c),
        Section("Tables", "tables"),
        *tables(c.blocks()),
        Section("Technical details", "details"),
        Items(assumed),
        Code(f"rtcal compare room.toml measured.csv{simulated}{equation}"),
        Note(f"rtcal {__version__}."),
    ]
    return Page(room.name, room.author, "where simulation and measurement disagree", blocks)
