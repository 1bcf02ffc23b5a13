"""The pages of a finding: by means, at positions, between two states; its files, its correction."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.observables import parameter_label
from rtcal.acoustics.room import MAX_BYTES
from rtcal.calibration.methods import calibrate
from rtcal.files.disk import make_folder, write_all
from rtcal.files.saved import NUMBERS
from rtcal.finder.claim import CLAIMED, percent
from rtcal.finder.finding import (
    Finding,
    added,
    best_title,
    or_nothing,
    rivals,
    runner_up,
    sentence_of,
    sentences,
)
from rtcal.finder.means.recalibration import recalibrate
from rtcal.finder.means.verdict import TWO
from rtcal.finder.positions.places import Place
from rtcal.finder.verification import Verification
from rtcal.report import figures, of_calibration, room_view
from rtcal.report.document import (
    Box,
    Code,
    Files,
    Heading,
    Items,
    Page,
    Picture,
    Section,
    SideBySide,
    coefficients,
    notes,
    render,
    tables,
)
from rtcal.report.odds import odds
from rtcal.support import __version__
from rtcal.support.blocks import Note, Row, Table
from rtcal.support.blocks import lines as lines_of
from rtcal.support.errors import MissingAirWarning
from rtcal.support.text import as_sentence, listed

PAGE = "report.html"
_FIGURES = {
    "means": ("evidence", "probabilities", "residuals", "reverberation_time", "shifts"),
    "positions": ("map", "plan", "gap"),
}
WRITTEN = (NUMBERS, PAGE, *(f"{name}.png" for names in _FIGURES.values() for name in names))
"""The files of a finding, each kind some of them."""
_SUBJECTS = {
    "means": "what the room-acoustic model may lack",
    "positions": "what is other than stated, and on which surface",
    "states": "what changed between two measurements",
}
_LEVELS = {"supported": "agrees", "withdrawn": "contradicts", "unproven": "open"}
"""Kind of the box that a verification stands in."""


def page(
    finding: Finding,
    verification: Verification | None = None,
    command: str = "",
    place: Place | None = None,
) -> Page:
    """Return the page of a finding of any kind.

    ``verification`` is the finding's, or None. ``command`` reproduces it, and is printed. ``place`` is
    a further receiver that would tell the surfaces apart.
    """
    room = finding.case.room
    if finding.kind == "means":
        blocks = _of_means(finding, verification, command)
    elif finding.kind == "states":
        blocks = _of_states(finding, verification)
    else:
        blocks = _where(finding, verification, command, place)
    return Page(room.name, room.author, _SUBJECTS[finding.kind], blocks)


def pictures(
    finding: Finding, verification: Verification | None = None, place: Place | None = None
) -> dict[str, Picture]:
    """Return the figures of a finding by the names of their files; none of two states."""
    if finding.kind == "means":
        return _pictures_of_means(finding, verification)
    at_positions = finding.kind == "positions"
    return _pictures_of_where(finding, verification, place) if at_positions else {}


def write(
    finding: Finding,
    verification: Verification | None,
    folder: Path,
    heading: Heading | None = None,
    command: str = "",
    place: Place | None = None,
) -> None:
    """Write `page`, numbers and figures, all or none; the arguments are those of `page`.

    Raises
    ------
    MissingDependencyError
        Without matplotlib or jinja2.
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    text = render(page(finding, verification, command, place), heading)
    saved = finding if verification is None else verification
    contents = {folder / PAGE: text.encode(), folder / NUMBERS: saved.to_json(folder).encode()}
    for name, picture in pictures(finding, verification, place).items():
        contents[folder / f"{name}.png"] = figures.rendered(picture.draw(), "png")
    make_folder(folder)
    write_all(contents)


def _chances(table: Mapping[str, float], further: Sequence[str]) -> list[Row]:
    """Return a row for each name with its probability in percent, and a further column."""
    rows = zip(table.items(), further, strict=True)
    return [Row(name, [f"{100 * p:.0f}", also]) for (name, p), also in rows]


def _of_means(finding: Finding, verification: Verification | None, command: str) -> list[Any]:
    """Return the blocks of a finding by means; those of the calibration without the effect are last."""
    drawn = _pictures_of_means(finding, verification)
    level = {"none": "agrees", "hint": "open"}.get(finding.verdict, "contradicts")
    corrected = _corrected(finding, verification, drawn)
    residuals = [[drawn["residuals"]]] if corrected or finding.likely_sets else []
    usable = finding.verdict in ("none", "hint")
    plain = f'plain calibration to {_time(finding)} of "{finding.case.configurations[0].name}"'
    if verification is not None and verification.verdict == "supported":
        lacking = listed([best_title(finding), *(c.effect for c in rivals(finding))], last="or")
        plain += f": not to be used, the model lacks something ({lacking})"
    first = next(
        drawn[n] for n in ("reverberation_time", "probabilities", "residuals") if n in drawn
    )
    there = ": probability that it is there at all, and its odds alone"
    alone = [odds(finding.evidence.get(name, 0.0)) for name in finding.probabilities]
    return [
        Section("The finding", "finding"),
        Box(level, as_sentence(f"{sentence_of(finding)}{or_nothing(finding)}")),
        Section("What it rests on", "basis", 3),
        Items(rests_on(finding, verification)),
        SideBySide(
            [
                [
                    Section("What to do", "to-do", 3),
                    Items(to_do(finding, verification)),
                    *([Note(_unknowable(finding, verification))] if corrected else []),
                ],
                [first],
            ]
        ),
        *corrected,
        Section("The evidence in numbers", "evidence"),
        Table(
            ["Probability / %"],
            [Row(names, [100 * p], ".0f") for names, p in finding.likely_sets.items()],
            "Sets of effects, the most probable first",
            "Set",
        ),
        Note(
            "The odds of an effect are those that the measurement alone gives it against a model that "
            "lacks nothing. The probability counts in as well how likely each effect was before the "
            "measurement.",
            kind="keep",
        ),
        Table(
            ["Probability / %", "Odds"],
            _chances(finding.probabilities, alone),
            f"Every effect that was tried{there if finding.likely_sets else ''}",
            "Effect",
        ),
        SideBySide([[drawn["evidence"]], *residuals]),
        *([Section("Notes", "notes", 3), Items(finding.notes)] if finding.notes else []),
        *_reproduced(finding, command),
        Section(
            "The calibration" if usable else "The plain calibration: the model lacks something",
            "plain",
        ),
        Note(f"From here on, text, tables and pictures are of the {plain}."),
        *of_calibration.beside_a_finding(_plain(finding), level, plain),
    ]


def _plain(finding: Finding) -> Any:
    """Return the calibration of the first configuration without the effect."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MissingAirWarning)  # among the finding's notes
        return calibrate(
            finding.case.room,
            finding.case.configurations[0].measured,
            unreachable="nearest",
            equation=mean_equation(finding.case.equation).linear(),
        )


def _time(finding: Finding) -> str:
    return str(finding.case.configurations[0].measured.time_label)


def rests_on(finding: Finding, verification: Verification | None) -> list[str]:
    """Return what the verdict rests on, a sentence each."""
    rule = (
        "An effect or a family is claimed if the probability that it is there is at least "
        f"{percent(CLAIMED)}, and if it passes the checks. More than one is claimed from "
        f"{percent(TWO)} for more than one effect."
    )
    return [
        *map(as_sentence, sentences(finding)),
        *([] if verification is None else [verification.sentence]),
        *([rule] if finding.more_than_one else []),
    ]


_USE = {
    "supported": "Use the corrected calibration below for T and level, not the plain one. "
    "Do not quote its coefficients before the effect is confirmed.",
    "not tested": "Measure C80 or G, or a second configuration, before the corrected "
    "calibration is used: nothing was measured that the finding was not fitted to.",
    "unproven": "Do this before the corrected calibration is used: the measurements do "
    "not tell the effect from coefficients other than the stated ones.",
    "withdrawn": "Use neither calibration: with the effect in the model the measurements fit worse.",
}
_QUOTE = {
    "supported": "To be quoted once the effect is confirmed.",
    "not tested": "Nothing but the evidence supports them.",
    "unproven": "Nothing but the evidence supports them.",
    "withdrawn": "Not to be used: the finding is withdrawn.",
}
"""What may be done with the corrected calibration, and with its coefficients, by verification."""


def to_do(finding: Finding, verification: Verification | None) -> list[str]:
    """Return what to do, a sentence each: the next measurement, and which coefficients to use."""
    steps = [] if finding.verdict == "none" else [as_sentence(finding.advice)]
    if finding.undecided:
        confirm = "Put none of the effects into the model before one is confirmed."
        return [*steps, f"{confirm} {finding.undecided}"]
    if verification is not None:
        misses = verification.misses_in_words
        return [*steps, _USE[verification.verdict], *([misses] if misses else [])]
    if finding.can_be_added:
        return [
            *steps,
            "Ask what to measure next with rtcal plan: of this finding it goes on from these sets.",
            "Do this before the corrected calibration is used. Nothing has verified the set.",
        ]
    return [
        *steps,
        "Do not use the calibration below: its coefficients make up for what is missing."
        if finding.verdict == "unknown"
        else "The calibration below can be used, with the reservations that it states.",
    ]


def _corrected(
    finding: Finding, verification: Verification | None, drawn: dict[str, Picture]
) -> list[Any]:
    """Return the coefficients with the effect or the set in the model; nothing where none is added."""
    if not finding.can_be_added or finding.undecided:
        return []
    use = "They are right if these are the right names."
    if verification is None:
        corrected = recalibrate(finding.with_effects(), finding.discrepancy)
    else:
        (_, corrected), use = verification.calibrations, _QUOTE[verification.verdict]
        if verification.misses:
            use = "Not to be used: with them the model misses T."
    of = listed([f'"{c.name}"' for c in finding.case.configurations])
    with_it = f"with {best_title(finding)} in the model, calibrated to {_time(finding)} of {of}"
    return [
        Section("The corrected calibration", "corrected", new_sheet=True),
        Note(f"In the model: {'; '.join(corrected.effects_in_words)}. {use}", kind="keep"),
        coefficients(
            f"Corrected coefficients, {with_it}: stated → calibrated, below it the 90 % interval",
            finding.case.room,
            corrected.alpha,
            corrected.interval,
        ),
        *[drawn[name] for name in ("shifts",) if name in drawn],
    ]


def _unknowable(finding: Finding, verification: Verification | None) -> str:
    """Return the sentence on what no calibration can show: whether the name is right."""
    if len(finding.members) > 1:
        return (
            "What cannot be known: whether these are the right names. Other effects of the same family "
            "explain the measurement about as well."
        )
    second = runner_up(finding)
    next_to = f"the next best is {second} {finding.percent(second)}"
    if others := [c.effect for c in rivals(finding)]:
        next_to = f"{listed(others)} would explain the data about as well"
    said = f"What cannot be known: whether it is {best_title(finding)}."
    said += f" The name may be wrong; {next_to}."
    if verification is not None and verification.verdict == "supported":
        said += (
            " That the gap shrinks says that the model is better, not which effect is in the room."
        )
    return said


def _pictures_of_means(finding: Finding, verified: Verification | None) -> dict[str, Picture]:
    """Return the figures by name; those of shifts and T need a verification."""
    shown = {
        "evidence": Picture(
            lambda: figures.evidence(finding),
            "Evidence of every effect over the model; a finding must exceed the threshold. "
            "An arrow marks a bar that is cut: its number is printed.",
            tall=True,
        ),
        "residuals": Picture(
            lambda: figures.residuals(finding, verified),
            "Model less measured, in standard deviations"
            + ("." if verified is None else ": before and after."),
            tall=True,
        ),
    }
    if finding.more_than_one:
        shown["probabilities"] = Picture(
            lambda: figures.probabilities(finding),
            "Probability of each effect that it is there at all, alone or with others. "
            "They do not sum to 100 %.",
        )
    if verified is None:
        return shown
    shown["reverberation_time"] = Picture(
        lambda: figures.corrected_times(verified),
        "T(f). Plain calibration meets T whatever is missing: that proves nothing.",
    )
    shown["shifts"] = Picture(
        lambda: figures.corrected_shifts(verified),
        "How far the coefficients had to move, with and without the effect in the model, and "
        "their 90 % intervals: a plain calibration's count on a model that lacks nothing.",
        tall=True,
    )
    return shown


def _reproduced(finding: Finding, command: str) -> list[Any]:
    """Return the command that searched; of a saved finding its case, and the command for it.

    Nothing if the case is too large for a page.
    """
    title = Section("How to reproduce the finding", "reproduce-finding")
    if command:
        rooms = f"The control rooms are those of {' and '.join(finding.engines)}:"
        return [title, Note(rooms, kind="keep"), Code(command)]
    case = finding.case.to_json().encode()
    if len(case) > MAX_BYTES:
        return []
    said = (
        ", which holds the room and every measurement, and run this, with the options of the search if "
        "it had any:"
    )
    return [title, Files({"case.json": case}, said), Code("rtcal find case.json")]


def _where(
    finding: Finding,
    verification: Verification | None,
    command: str,
    place: Place | None,
) -> list[Any]:
    """Return the blocks of a finding at positions; the three gaps stand in front."""
    drawn = _pictures_of_where(finding, verification, place)
    headline, *others = notes(finding.blocks())
    said = as_sentence(headline)
    gap: list[Any] = [
        Note(said, kind="lead"),
        Note("There is nothing to add to a surface, so there is no second model to compare."),
    ]
    by_model: list[Any] = []
    if verification is not None:
        verdict, _, why = verification.sentence.partition(": ")
        box = Box(_LEVELS[verification.verdict], verdict, [as_sentence(why), verification.notes[0]])
        better = "A gap that shrinks shows that the model is better, not that the name is right."
        gap = [SideBySide([[drawn["gap"]], [box, Note(better)]])]
        title = "Mean gap in JND, ± its standard deviation over the simulator's seeds"
        by_model = [
            Section("The gaps by parameter and by pair", "gaps"),
            replace(verification.table, title=title, corner=""),
            Items(list(verification.notes[1:])),
        ]
    further = []
    if place is not None:
        x, y, z = place.point
        further = [
            Note(
                f"To tell the surfaces apart, measure at ({x:.1f}, {y:.1f}, {z:.1f}) m with source "
                f"{place.source}: of the places that were tried it is expected to tell most, with odds "
                f"of {odds(place.nats)}. It is the star in the plan."
            )
        ]
    return [
        Section("The gap at positions that were not fitted", "gap"),
        *gap,
        Section("What was found", "finding"),
        Note(said),
        *room_view.of_finding(finding, verification, place),
        *(replace(probable, title="Candidates") for probable in tables(finding.blocks())),
        *map(Note, others),
        *further,
        Section("Where the model disagrees", "map"),
        SideBySide([[drawn["plan"]], [drawn["map"]]]),
        *by_model,
        *([Section("How to reproduce", "reproduce"), Code(command)] if command else []),
    ]


def _pictures_of_where(
    finding: Finding, verification: Verification | None, place: Place | None
) -> dict[str, Picture]:
    """Return the figures with what they show in words and numbers."""
    strongest = int(np.nanargmax(np.abs(finding.map)))
    p, i, k = np.unravel_index(strongest, finding.map.shape)
    likely = "; ".join(f"{n} {percent(finding.surfaces[n])}" for n in finding.likely_surfaces)
    coloured = (
        f"coloured are {likely}"
        if finding.verdict != "none" and likely
        else "no surface is coloured"
    )
    drawn = {
        "plan": Picture(
            lambda: figures.plan(finding, place),
            "The plan. A line joins source (triangle) and receiver (circle); it is as dark as the pair "
            "disagrees. Walls are as orange as they are probable.",
            f"The plan of the room with sources and receivers; {coloured}.",
        ),
        "map": Picture(
            lambda: figures.disagreement(finding),
            "Residuals in standard deviations of what prior, simulator and measurement leave open: "
            "root mean squares by pair and parameter, and by parameter and band. About 1 is what is "
            "expected.",
            "Two tables of the disagreement in standard deviations. The largest single one is "
            f"{abs(finding.map[p, i, k]):.1f}: {parameter_label(finding.parameters[p])} from "
            f"{' to '.join(finding.pairs[i])} at {finding.case.room.centre_frequencies[k]:g} Hz.",
            tall=len(finding.pairs) > 8,
        ),
    }
    if verification is not None:
        before, plain, after = (f"{gap:.2f}" for gap in verification.by_seed.mean(axis=1))
        drawn["gap"] = Picture(
            lambda: figures.bars(verification),
            "Mean gap at pairs that were not fitted; whiskers are the range over the simulator's "
            "seeds. The dotted line is 1 JND.",
            f"Three bars of the mean gap at pairs that were not fitted: {before} JND as stated, "
            f"{plain} calibrated, {after} corrected and calibrated.",
        )
    return drawn


def _of_states(finding: Finding, verification: Verification | None) -> list[Any]:
    """Return the blocks of a finding between two states."""
    headline, *others = notes(finding.blocks())
    kinds = finding.candidates if finding.best is not None else ()
    n = len(finding.case.pairs)
    verified = [] if verification is None else [Note(f"Verification: {verification.sentence}")]
    claims = ["claimed" if s in finding.claimed_surfaces else "" for s in finding.surfaces]
    apply = (
        "The room of the second state, to calibrate, export and predict with: "
        "rtcal apply FOUND --out FOLDER."
    )
    return [
        Section("Summary", "summary"),
        Note(headline, kind="lead"),
        *verified,
        Picture(
            lambda: figures.change(finding),
            "Change of the absorption area with its 90 % interval, if it changed.",
        ),
        Items(others),
        Table(
            ["Probability / %", "Absorption area, 500 Hz to 2 kHz"],
            _chances({c.effect: c.probability for c in kinds}, [c.in_words for c in kinds]),
            "What it may be",
            "Change",
        ),
        Table(
            ["Probability that it changed / %", ""],
            _chances(finding.surfaces, claims),
            "On which surface",
            "Surface",
        ),
        Section("By band", "bands"),
        Picture(
            lambda: figures.states(finding),
            "T by band, mean over the pairs that both states have.",
        ),
        *(replace(table, title="Both states") for table in tables(finding.blocks())),
        Section("What was assumed", "assumed"),
        Note(
            f"{finding.case.equation.name}'s equation; {n} pair{'s' * (n != 1)}. Both states have "
            "the same positions and equipment. The first calibrates, so the stated coefficients do not "
            "count."
        ),
        *([Note(apply)] if finding.can_be_added else []),
        Note(f"rtcal {__version__}."),
    ]


def correct(
    finding: Finding,
    out: Path,
    verification: Verification | None = None,
    *,
    effect: str | None = None,
    form: str | None = None,
    at: Sequence[float] | None = None,
) -> tuple[str, dict[str, Any], dict[Path, bytes]]:
    """Add what was found to the model, with the caution of its verification.

    Parameters
    ----------
    finding : Finding
    out : Path
        A folder.
    verification : Verification, optional
        The finding's. Of means it holds the calibration with the effect, which is else made.
    effect, form, at
        As `Finding.apply` takes them.

    Returns
    -------
    (str, dict, dict)
        The text, its record, and the files to write by path; none if there is nothing to add.

    Raises
    ------
    DataError
        As `Finding.apply`.
    """
    record = finding.to_dict()
    if (nothing := finding.reason_for_none) is not None:
        return f"{nothing}\nNothing is written.", {**record, "sentence": nothing}, {}
    made = finding.apply(effect=effect, form=form, at=at)
    if verification is not None:
        made = replace(made, caution=verification.misses_in_words)
    lines = [finding.headline, *made.in_words]
    record["corrected"] = made.to_dict()
    if made.model is not None:
        members = finding.chosen(effect)
        calibrated = None if verification is None else verification.corrected
        if calibrated is None or members != finding.members:
            calibrated = recalibrate(made.model.case, finding.discrepancy)
        lines = [
            added(finding, members),
            *([made.caution] if made.caution else []),
            *lines_of(calibrated.blocks()),
            *(f"  note: {note}" for note in finding.notes),
            *(f"  not in the room: {note}" for note in made.notes),
        ]
        record |= {"sentence": lines[0], "calibrated": calibrated.to_dict()}
    return "\n".join(lines), record, made.contents(out)
