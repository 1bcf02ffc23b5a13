"""The page of a finding, by means, at positions or between two states; its files, its correction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.comparison import compare
from rtcal.acoustics.marks import rms
from rtcal.acoustics.observables import parameter_label
from rtcal.acoustics.room import MAX_BYTES, Room
from rtcal.acoustics.run import Run
from rtcal.files.saved import NUMBERS
from rtcal.finder.apply import CASE, DRAWN_LARGER, ROOM, Corrected
from rtcal.finder.evidence import NONE
from rtcal.finder.finding import Finding
from rtcal.finder.means.recalibration import recalibrate
from rtcal.finder.positions.places import Place
from rtcal.finder.verification import Verification, residual_map
from rtcal.report import figures, of_comparison, room_view, verification_words
from rtcal.report import finding_words as words
from rtcal.report.document import (
    PAGE,
    Box,
    Code,
    Files,
    Items,
    Page,
    Picture,
    Section,
    SideBySide,
    coefficients,
)
from rtcal.report.finding_words import odds, percent
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.blocks import lines as lines_of
from rtcal.support.text import as_sentence, listed
from rtcal.support.types import Array

_FIGURES = {
    "means": ("gap", "reverberation_time", "shifts"),
    "positions": ("plan", "gap"),
    "states": ("change",),
}
WRITTEN = (NUMBERS, PAGE, *{f"{n}.png": 0 for names in _FIGURES.values() for n in names})
"""The files of a finding, each kind some of them."""
_SUBJECTS = {
    "means": "what the room-acoustic model may lack",
    "positions": "what differs from the model, and on which surface",
    "states": "what changed between two measurements",
}


def page(
    result: Finding | Verification,
    verification: Verification | None = None,
    command: str = "",
    place: Place | None = None,
) -> Page:
    """Return the page of a finding: the answer, its reasons, what to do, and the numbers.

    ``verification`` is that of the finding; None if there is none. ``command`` is the command, printed
    on the page, that reproduces it. ``place`` is a position for a further receiver that would
    distinguish the surfaces; None if there is none.
    """
    if isinstance(result, Verification):
        return page(result.finding, result, command, place)
    finding = result
    room, drawn = finding.case.room, pictures(finding, verification, place)
    level = {"none": "agrees", "hint": "open"}.get(finding.verdict, "contradicts")
    level = "open" if level == "agrees" and finding.differs else level
    answer, *more = words.headline(finding)
    of_kind: list[Any]
    if finding.kind == "means":
        of_kind = _of_means(finding, verification, drawn[1:])
    elif finding.kind == "positions":
        of_kind = _at_positions(finding, verification, drawn[1:], place)
    else:
        of_kind = _of_states(finding, drawn[1:])
    blocks = [
        *_of_run(finding),
        Section("The finding", "finding"),
        Box(level, answer, more),
        Section("What it rests on", "basis", 3),
        Items(rests_on(finding, verification)),
        SideBySide(
            [
                [Section("What to do", "to-do", 3), Items(to_do(finding, verification, place))],
                drawn[:1],
            ]
        ),
        *of_kind,
        *([Section("Notes", "notes", 3)] if words.noted(finding) else []),
        Items(words.noted(finding)),
        *_reproduced(finding, command),
    ]
    return Page(room.name, room.author, _SUBJECTS[finding.kind], blocks)


def _of_run(finding: Finding) -> list[Any]:
    """Return where a program's run and the measurement disagree; nothing without a run."""
    case = finding.case
    if finding.kind == "states" or not case.has_run:
        return []
    if finding.kind == "positions":
        run, measured = Run(case.room, case.simulated), case.in_room
    else:
        first = next(c for c in case.configurations if c.simulated is not None)
        run, measured = first.simulated, first.measured
    title = Section("Where run and measurement disagree", "disagreement")
    return [title, *of_comparison.section(compare(case.room, measured, run))]


def rests_on(finding: Finding, verification: Verification | None) -> list[str]:
    """Return the reasons for the answer, a sentence each, cautions first."""
    return [
        *(f"Caution: {said}" for said in words.cautions(finding)),
        *([] if verification is None else [verification.sentence]),
        *map(as_sentence, words.details(finding)),
        words.evidence(finding),
        *filter(None, [words.track_record(finding)]),
    ]


def to_do(
    finding: Finding, verification: Verification | None, place: Place | None = None
) -> list[str]:
    """Return the next steps, a sentence each: the next measurement, and which coefficients to use."""
    steps = [] if finding.advice is None or finding.verdict == NONE else [str(finding.advice)]
    steps += filter(None, [words.without_measuring(finding)])
    if place is not None:
        at = ", ".join(f"{x:.1f}" for x in place.point)
        steps.append(
            f"To distinguish the surfaces, measure at ({at}) m with source {place.source}, the "
            "star in the plan. Of the positions that were tried, this one is expected to distinguish "
            f"them best: as well as {place.pairs:.1f} of the {len(finding.pairs)} measured pairs."
        )
    if finding.undecided is not None:
        confirm = "Do not add an effect to the model before it is confirmed."
        return [*steps, confirm, chosen(finding)]
    if verification is not None:
        steps += filter(
            None, [words.USE[verification.verdict], verification_words.misses(verification)]
        )
    elif finding.can_be_added and finding.kind == "means":
        steps.append(
            "Do not use the corrected calibration yet, because this set has not been verified. "
            "`rtcal plan` shows what to measure next."
        )
    if finding.can_be_added and finding.kind != "means":
        made = "the room after the change" if finding.kind == "states" else "the corrected model"
        steps.append(f"rtcal apply FOUND --out FOLDER writes {made}.")
    if (
        finding.kind == "means"
        and not finding.can_be_added
        and not words.without_measuring(finding)
    ):
        steps.append(
            "Do not use a calibration of this model, because its coefficients would "
            "compensate for the missing effect."
            if finding.verdict == "unknown"
            else "Calibrate as usual (rtcal calibrate). Nothing was found to be missing, but T "
            "may still be out of reach or mistyped: the cautions of the calibration show "
            "whether the result can be used."
        )
    return steps


def chosen(finding: Finding, found: str = "FOUND") -> str:
    """Return what you must choose before `apply`, with the command for it; "" if nothing."""
    if finding.undecided is None:
        return ""
    what, _, _ = str(finding.undecided).partition(" Choose one: ")
    place = " or --place X,Y,Z" if finding.kind == "positions" else ""
    add = f" To add one: rtcal apply {found} --effect NAME{place} --out corrected."
    return what + add


def _of_means(
    finding: Finding, verification: Verification | None, drawn: list[Picture]
) -> list[Any]:
    """Return the corrected calibration, probabilities and odds."""
    sets = [
        Row(words.set_of(names), [100 * p], ".0f", [p]) for names, p in finding.likely_sets.items()
    ]
    rows = [
        Row(
            words.called(name),
            [f"{100 * p:.0f}", odds(finding.evidence.get(name, 0.0))],
            shade=[p, 0.0],
        )
        for name, p in finding.probabilities.items()
    ]
    after = None if verification is None else residual_map(verification)
    return [
        *_corrected(finding, verification),
        SideBySide([[picture] for picture in drawn]),
        Section("The evidence in numbers", "evidence"),
        Table(["Probability / %"], sets, "Sets of effects, the most probable first", "Set"),
        Note(
            "The odds compare the model with the effect to the model without it, by the "
            "measurement only. The probability also includes how likely each effect was before "
            "the measurement.",
            kind="keep",
        ),
        Table(["Probability / %", "Odds"], rows, "Every effect that was tried", "Effect"),
        *words.deviations(finding, finding.residuals),
        *(
            []
            if after is None
            else words.deviations(finding, after, f" with {words.title(finding)}")
        ),
    ]


def _at_positions(
    finding: Finding,
    verification: Verification | None,
    drawn: list[Picture],
    place: Place | None,
) -> list[Any]:
    """Return the room, the candidates, where the model disagrees, and the gaps."""
    probable = words.candidates(finding)
    by_model: list[Any] = []
    if verification is not None:
        heading = "Mean deviation in JND, ± its standard deviation over the simulator's seeds"
        by_model = [
            Section("The deviations by parameter and by pair", "gaps"),
            replace(verification_words.gaps(verification), title=heading, corner=""),
            Items(verification_words.notes(verification)),
        ]
    return [
        *room_view.of_finding(finding, verification, place),
        *([] if probable is None else [replace(probable, title="Candidates")]),
        Section("Where the model disagrees", "map"),
        *drawn,
        *_disagreement(finding),
        *by_model,
    ]


def _disagreement(finding: Finding) -> list[Table]:
    """Return the deviations as tables: pairs by parameters, and parameters by bands."""
    names = [parameter_label(p) for p in finding.parameters]
    of_pairs, of_bands = rms(finding.map, (2,)).T, rms(finding.map, (1,))
    most = max(2.0, float(np.nanmax(of_pairs)), float(np.nanmax(of_bands)))

    def table(columns: Sequence[str], rows: Sequence[str], values: Array, what: str) -> Table:
        title = f"Root mean square deviation by {what}, in standard deviations: about 1 is expected"
        made = [Row(n, row, ".1f", row / most) for n, row in zip(rows, values, strict=True)]
        return Table(columns, made, title, what.partition(" ")[0].capitalize())

    labels = bands.labels(finding.case.room.centre_frequencies)
    return [
        table(names, [" to ".join(pair) for pair in finding.pairs], of_pairs, "pair and parameter"),
        table(labels, names, of_bands, "parameter and band"),
    ]


def _of_states(finding: Finding, drawn: list[Picture]) -> list[Any]:
    """Return what it may be, on which surface, and both states by band."""
    kinds, n = words.candidates(finding), len(finding.case.pairs)
    rows = [
        Row(name, [f"{100 * p:.0f}", "identified" if name in finding.identified_surfaces else ""])
        for name, p in finding.surfaces.items()
    ]
    return [
        *([] if kinds is None else [replace(kinds, title="What it may be")]),
        Table(["Probability that it changed / %", ""], rows, "On which surface", "Surface"),
        Section("By band", "bands"),
        *drawn,
        *(replace(t, title="Both states") for t in words.numbers(finding) if isinstance(t, Table)),
        Note(
            f"{finding.case.equation.name}'s equation; {n} pair{'s' * (n != 1)}. Both "
            "configurations are assumed to be measured at the same positions with the same "
            "equipment. The first one calibrates the model, so the input coefficients have no "
            "influence."
        ),
    ]


def _time(finding: Finding) -> str:
    return str(finding.case.configurations[0].measured.time_label)


def _corrected(finding: Finding, verification: Verification | None) -> list[Any]:
    """Return the coefficients with the effect or the set in the model; nothing where none is added."""
    if not finding.can_be_added or finding.undecided is not None:
        return []
    corrected = None if verification is None else verification.corrected
    if corrected is None:
        corrected = recalibrate(finding.with_effects(), finding.discrepancy)
    of = listed([f'"{c.name}"' for c in finding.case.configurations])
    with_it = f"with {words.title(finding)} in the model, calibrated to {_time(finding)} of {of}"
    return [
        Section("The corrected calibration", "corrected", new_sheet=True),
        Note(f"In the model: {'; '.join(words.effects_of(corrected))}.", kind="keep"),
        coefficients(
            f"Corrected coefficients, {with_it}: input → calibrated, below it the 90 % interval",
            finding.case.room,
            corrected.alpha,
            corrected.interval,
        ),
    ]


def pictures(
    finding: Finding, verification: Verification | None = None, place: Place | None = None
) -> list[Picture]:
    """Return the figures of a finding; the first one is shown beside the answer."""
    if finding.kind == "means":
        if verification is None:
            return []
        tested = [] if np.isnan(verification.before) else [_bars(verification, "data")]
        return [
            *tested,
            Picture(
                lambda: figures.corrected_times(verification),
                "T by band. A calibration without the effect also has the measured T, which "
                "proves nothing.",
                name="reverberation_time",
            ),
            Picture(
                lambda: figures.corrected_shifts(verification),
                "How far the coefficients had to move, with and without the effect in the model, "
                "and their 90 % intervals. The intervals without the effect are valid only if "
                "nothing is missing from the model.",
                tall=True,
                name="shifts",
            ),
        ]
    if finding.kind == "positions":
        likely = "; ".join(f"{n} {percent(finding.surfaces[n])}" for n in finding.likely_surfaces)
        coloured = (
            f"coloured are {likely}"
            if finding.verdict != "none" and likely
            else "no surface is coloured"
        )
        drawn = [
            Picture(
                lambda: figures.plan(finding, place),
                "The plan. A line joins source (triangle) and receiver (circle); the darker it "
                "is, the larger the deviation of the pair. The more orange a wall is, the more "
                "probable it is.",
                f"The plan of the room with sources and receivers; {coloured}.",
                name="plan",
            ),
        ]
        if verification is None:
            return drawn
        return [_bars(verification, "pairs"), *drawn]
    return [
        Picture(
            lambda: figures.change(finding),
            "Change of the absorption area with its 90 % interval, if it changed.",
            name="change",
        ),
    ]


def _bars(verified: Verification, what: str) -> Picture:
    """Return the picture of the gap at ``what`` was not fitted, of each of the three models."""
    each = zip(verified.by_seed.mean(axis=1), verified.models, strict=True)
    of_seeds = "; whiskers are the range over the simulator's seeds" * (verified.gaps.shape[1] > 1)
    return Picture(
        lambda: figures.bars(verified),
        f"Mean deviation at {what} that were not fitted{of_seeds}. The dotted line is 1 JND.",
        f"Three bars of the mean deviation at {what} that were not fitted: "
        f"{listed([f'{gap:.2f} JND {model}' for gap, model in each])}.",
        name="gap",
    )


def _reproduced(finding: Finding, command: str) -> list[Any]:
    """Return the command that searched; of a saved finding its case, and the command for it.

    Nothing if the case is too large for a page.
    """
    title = Section("How to reproduce the finding", "reproduce-finding")
    if finding.kind == "states":
        return []
    if command:
        engines = () if finding.discrepancy is None else finding.discrepancy.engines
        rooms = [Note(f"Reference simulations: {listed(engines)}.", kind="keep")] if engines else []
        return [title, *rooms, Code(command)]
    if finding.kind == "positions":
        return []
    case = finding.case.to_json().encode()
    if len(case) > MAX_BYTES:
        return []
    said = (
        ", which holds the room and every measurement, and run this command (with the same "
        "options, if you used any):"
    )
    return [title, Files({"case.json": case}, said), Code("rtcal find case.json")]


INSTRUCTIONS = "instructions.txt"
"""File of what to change in the program, where a run of the program was given."""
_SAME = 5e-4
"""Change of a coefficient that a list of materials, which has 0.1 %, does not hold."""


def instructions(
    finding: Finding,
    made: Corrected,
    room: Room,
    effect: str | None = None,
    place: Sequence[float] | None = None,
) -> list[Block]:
    """Return what to change in a program's list of materials, what to draw, and what neither can hold.

    ``made`` is the corrected model, and ``room`` its room with the coefficients to simulate with.
    ``effect`` is the name of the effect that was chosen, and ``place`` where it was put; None if it is
    the effect that was found, where it was found.
    """
    run = finding.case.room
    if finding.kind == "means" and finding.case.configurations[0].simulated is not None:
        run = finding.case.configurations[0].simulated.room
    labels, old = (
        bands.labels(room.centre_frequencies),
        dict(zip(run.materials, run.alpha, strict=True)),
    )
    rows, new = list[Row](), list[Row]()
    for name, area, alpha in zip(room.materials, room.areas, room.alpha, strict=True):
        if name not in old:
            new.append(Row(f"{name}, {area:.2f} m²", alpha, ".3f"))
        elif np.abs(alpha - old[name]).max() > _SAME:
            of = f"{name} (m² per piece)" if name in room.pieces else name
            rows += [Row(f"{of}, old", old[name], ".3f"), Row(f"{of}, new", alpha, ".3f")]
    where = (
        "anywhere, because means over positions do not show the place; distribute it, or put "
        "it where it is likely"
    )
    if made.added is not None:
        where = (
            f'on "{made.surfaces[0]}", {_ends(made)}'
            if made.form == "patch"
            else "the whole surface"
        )
        where += "" if made.form == "patch" else f' "{made.surfaces[0]}"'
    what = words.title(finding) if effect is None else words.name_of(finding, effect)
    what = what if made.added is None else made.added.title
    out: list[Block] = [Note(f"What to change in the program for {what}.")]
    if rows:
        out += [Note("1. In the list of materials, change alpha:"), Table(labels, rows)]
    else:
        out.append(Note("1. In the list of materials, nothing changes."))
    if new:
        out += [Note(f"2. Draw a surface with a new material, {where}:"), Table(labels, new)]
        out += [Note(as_sentence(str(note))) for note in made.notes if note.code == DRAWN_LARGER]
        if made.form == "patch":
            out.append(Note("There it replaces the material of the surface."))
        elif made.added is None:
            out.append(
                Note(
                    "It is drawn larger than the effect that was found, with lower coefficients, "
                    "so that a calibration can make it absorb more or less. Its coefficients are "
                    "those of a free-standing surface: where it replaces a wall's material, add "
                    "that wall's alpha."
                )
            )
    else:
        out.append(Note("2. The geometry stays as it is."))
    lost = [
        Note(f"- {as_sentence(str(note))}", "  ")
        for note in made.notes
        if note.code != DRAWN_LARGER
    ]
    out += [Note("3. A list of materials cannot hold:"), *lost] if lost else []
    option = "" if effect is None else f' --effect "{effect}"'
    option += "" if place is None else f" --place {','.join(f'{x:g}' for x in place)}"
    then = f"Simulate again, and then: rtcal verify FOUND{option} --simulated corrected_run.csv"
    return [*out, Note(then)]


def _ends(made: Corrected) -> str:
    """Return where a patch is, by the two corners of the box about it."""
    solid = made.geometry
    if solid is None:
        return "in the middle of the surface"
    faces = [
        f for f, name in zip(solid.faces, solid.materials, strict=True) if name == made.material
    ]
    points = solid.vertices[np.concatenate([list(face) for face in faces])]
    low, high = (", ".join(f"{x:.2f}" for x in of) for of in (points.min(0), points.max(0)))
    return f"from ({low}) to ({high}) m"


def _to_calibrate(command: str, made: Corrected) -> str:
    """Return how the corrected room is calibrated; of one with a caution, after which step."""
    if not made.caution:
        return f"To calibrate {ROOM}: {command}."
    return (
        f"Do not calibrate {ROOM} before the effect is confirmed, because a calibration adapts to a "
        f"wrong effect, too. Once it is confirmed: {command}."
    )


def correct(
    finding: Finding,
    out: Path,
    verification: Verification | None = None,
    *,
    effect: str | None = None,
    form: str | None = None,
    at: Sequence[float] | None = None,
) -> tuple[str, dict[str, Any], dict[Path, bytes]]:
    """Return the text, the record and the files of a finding's corrected model, without writing them.

    ``out`` is the folder for the files, which are returned by path; there are none if there is nothing
    to add. ``verification`` has the caution for the model. For ``effect``, ``form``, ``at`` and errors
    see `Finding.apply`.
    """
    record = finding.to_dict()
    if finding.refusal is not None:
        nothing = str(finding.refusal)
        return f"{nothing}\nNothing is written.", {**record, "sentence": nothing}, {}
    made = finding.apply(effect=effect, form=form, at=at)
    if verification is not None:
        made = replace(made, caution=verification_words.misses(verification))
    step = words.first_step(finding, verification)
    warned = [*([made.caution] if made.caution else []), *([f"Next: {step}"] if step else [])]
    lines = [" ".join(words.headline(finding)), *warned]
    if made.added is not None:
        what = f"{made.added.title}, {made.added.in_words}"
        lines[0] = (
            f"The corrected model contains {what}, as a {made.form} of the new material "
            f'"{made.material}". {lines[0]}'
        )
    lines += map(str, made.notes)
    lines += [f"{n}: {'; '.join(r.notes)}." for n, r in made.reports.items() if r.notes]
    if lists := made.reports:
        in_none = [
            lost
            for lost in next(iter(lists.values())).lost
            if all(lost in r.lost for r in lists.values())
        ]
        said = [f"The lists {listed([*lists])} do not contain: {'; '.join(in_none)}"]
        for name, report in lists.items():
            own = [lost for lost in report.lost if lost not in in_none]
            said += [f"{name} does not contain {listed(own)} either"] if own else []
        lines.append(f"{'; '.join(said)}.")
    if finding.kind == "positions":
        lines.append(
            f"{ROOM} is not calibrated: it holds the input coefficients and the new material. "
            + _to_calibrate(f"rtcal fit {out / ROOM} MEASURED --out FOLDER", made)
        )
    record["corrected"] = made.to_dict()
    room = made.room
    if made.model is not None:
        members = finding.chosen(effect)
        calibrated = None if verification is None else verification.corrected
        if calibrated is None or members != finding.members:
            calibrated = recalibrate(made.model.case, finding.discrepancy)
        lines = [
            words.added(finding, members),
            *warned,
            "",
            *lines_of(calibrated.blocks()),
            f"{ROOM} and {CASE} hold the input coefficients; only the table has the calibrated ones. "
            + _to_calibrate(f"rtcal calibrate {out / ROOM} MEASURED --out FOLDER", made),
            *(f"Note: {note}" for note in words.noted(finding)),
            *(["The room's file cannot hold:"] if made.notes else []),
            *(f"  - {note}" for note in made.notes),
        ]
        record |= {"sentence": lines[0], "calibrated": calibrated.to_dict()}
        room = calibrated.room
    files = made.contents(out)
    if finding.kind != "states" and finding.case.has_run:
        said = lines_of(instructions(finding, made, room, effect, at))
        files[out / INSTRUCTIONS] = ("\n".join(said) + "\n").encode()
        lines += ["", *said]
    return "\n".join(lines), record, files
