"""The page of a finding, by means, at positions or between two states; its files, its correction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.comparison import Comparison, compare
from rtcal.acoustics.marks import rms
from rtcal.acoustics.observables import parameter_label
from rtcal.acoustics.room import MAX_BYTES, Room
from rtcal.acoustics.run import Run
from rtcal.files.saved import NUMBERS
from rtcal.finder.apply import CASE, DRAWN_LARGER, ROOM, Corrected, material_lists
from rtcal.finder.finding import Finding
from rtcal.finder.means.recalibration import recalibrate
from rtcal.finder.positions.places import Place
from rtcal.finder.verification import Verification, residual_map
from rtcal.io.material_list import ExportReport
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
    tables,
)
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.blocks import lines as lines_of
from rtcal.support.text import as_sentence, listed, sentences
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
    more: Sequence[Any] = (),
) -> Page:
    """Return the page of a finding: answer, three sentences, a figure, cautions, tables and details.

    ``more`` are blocks before the technical details.
    """
    if isinstance(result, Verification):
        return page(result.finding, result, command, place, more)
    finding = result
    room, drawn = finding.case.room, pictures(finding, verification, place)
    level = {"none": "agrees", "hint": "open"}.get(finding.verdict, "contradicts")
    level = "open" if level == "agrees" and finding.differs else level
    answer, said, further = _summary(finding, verification)
    if place is not None:
        at = ", ".join(f"{x:.1f}" for x in place.point)
        further.append(
            f"To distinguish the surfaces, measure at ({at}) m with source {place.source}, the star in "
            f"the plan: it is worth {place.pairs:.1f} of the {len(finding.pairs)} measured pairs."
        )
    if finding.kind == "means":
        numbers = _of_means(finding, verification, drawn[1:])
    elif finding.kind == "positions":
        numbers = _at_positions(finding, verification, drawn[1:], place)
    else:
        numbers = _of_states(finding, drawn[1:])
    blocks = [
        Box(level, answer),
        SideBySide([[Items(said)], drawn[:1]], "summary"),
        *([Section("Cautions and next steps", "cautions"), Items(further)] if further else []),
        *_of_run(finding, drawn=finding.kind == "means" and verification is None),
        *numbers,
        *more,
        *_reproduced(finding, command),
    ]
    return Page(room.name, room.author, _SUBJECTS[finding.kind], blocks)


def _summary(
    finding: Finding, verification: Verification | None
) -> tuple[str, list[str], list[str]]:
    """Return the answer, at most three sentences after it, and what stands below the figure.

    The three are what follows the answer, what the verification gave, and what to do next.
    """
    answer, *rest = sentences(" ".join(words.headline(finding)))
    checked, use = list[str](), ""
    if verification is not None:
        checked = sentences(verification.sentence)
        use = words.USE[verification.verdict] if finding.undecided is None else ""
    step = words.first_step(finding, verification) or use
    first, *then = sentences(step) or [""]
    said = [*rest[:1], *checked[:1], *([f"Next: {first}"] if step else [])]
    further = [*rest[1:], *words.cautions(finding), " ".join(checked[1:]), *words.noted(finding)]
    further += [chosen(finding), use if use != step else "", step if then else ""]
    return answer, said, [*filter(None, further)]


def _of_run(finding: Finding, drawn: bool) -> list[Any]:
    """Return where a program's run and the measurement disagree, if not ``drawn`` with its picture.

    Returns nothing without a run.
    """
    if (compared := _compared(finding)) is None:
        return []
    section = of_comparison.section(compared)
    said = [block for block in section if not (drawn and isinstance(block, Picture))]
    return [Section("Where run and measurement disagree", "disagreement"), *said]


def _compared(finding: Finding) -> Comparison | None:
    """Return a program's run compared with the measurement, of the first configuration with a run."""
    case = finding.case
    if finding.kind == "states" or not case.has_run:
        return None
    if finding.kind == "positions":
        return compare(case.room, case.in_room, Run(case.room, case.simulated))
    first = next(c for c in case.configurations if c.simulated is not None)
    return compare(case.room, first.measured, first.simulated)


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
    """Return the corrected calibration, every effect that was tried, and the deviations."""
    after = None if verification is None else residual_map(verification)
    with_it = f" with {words.title(finding)}"
    return [
        *_corrected(finding, verification),
        SideBySide([[picture] for picture in drawn]),
        Section("The evidence in numbers", "evidence"),
        *tables([words.candidates(finding, least=0.0)]),
        Items(words.details(finding)),
        *words.deviations(finding, finding.residuals),
        *([] if after is None else words.deviations(finding, after, with_it)),
    ]


def _at_positions(
    finding: Finding,
    verification: Verification | None,
    drawn: list[Picture],
    place: Place | None,
) -> list[Any]:
    """Return the room, the candidates, where the model disagrees, and the gaps."""
    by_model: list[Any] = []
    if verification is not None:
        by_model = [
            Section("The deviations by parameter and by pair", "gaps"),
            verification_words.gaps(verification),
            Items(verification_words.notes(verification)),
        ]
    return [
        *room_view.of_finding(finding, verification, place),
        *tables([words.candidates(finding)]),
        Items(words.details(finding)),
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
    rows = [
        Row(name, [f"{100 * p:.0f}", "identified" if name in finding.identified_surfaces else ""])
        for name, p in finding.surfaces.items()
    ]
    return [
        *tables([words.candidates(finding)]),
        Items(words.details(finding)),
        Table(["Probability that it changed / %", ""], rows, "On which surface", "Surface"),
        Section("By band", "bands"),
        *drawn,
        *tables(words.numbers(finding)),
    ]


def _corrected(finding: Finding, verification: Verification | None) -> list[Any]:
    """Return the coefficients with the effect or the set in the model; nothing where none is added."""
    if not finding.can_be_added or finding.undecided is not None:
        return []
    corrected = None if verification is None else verification.corrected
    if corrected is None:
        corrected = recalibrate(finding.with_effects(), finding.discrepancy)
    time = finding.case.configurations[0].measured.time_label
    of = listed([f'"{c.name}"' for c in finding.case.configurations])
    return [
        Section("The corrected calibration", "corrected", new_sheet=True),
        Note(f"In the model: {'; '.join(words.effects_of(corrected))}.", kind="keep"),
        coefficients(
            f"Corrected coefficients, calibrated to {time} of {of}: input → calibrated, below it the "
            "90 % interval",
            finding.case.room,
            corrected.alpha,
            corrected.interval,
        ),
    ]


def pictures(
    finding: Finding, verification: Verification | None = None, place: Place | None = None
) -> list[Picture]:
    """Return the figures of a finding; the first one is shown beside the answer."""
    if finding.kind == "states":
        caption = "Change of the absorption area with its 90 % interval, if it changed."
        return [Picture(lambda: figures.change(finding), caption, name="change")]
    drawn = list[Picture]()
    if verification is not None and np.isfinite(verification.before):
        drawn = [_bars(verification)]
    if finding.kind == "positions":
        likely = finding.likely_surfaces if finding.verdict != "none" else ()
        orange = listed([f"{name} {words.percent(finding.surfaces[name])}" for name in likely])
        plan = Picture(
            lambda: figures.plan(finding, place),
            "The plan. A line joins source (triangle) and receiver (circle); the darker it is, the "
            "larger the deviation of the pair. The more orange a wall is, the more probable it is.",
            f"Plan of the room with sources and receivers. Probable surfaces: {orange or 'none'}.",
            name="plan",
        )
        return [*drawn, plan]
    if verification is None:
        if (compared := _compared(finding)) is not None:
            return [of_comparison.picture(compared, "run")]
        most = sorted(finding.comparisons, key=words.largest, reverse=True)
        return [of_comparison.picture(c, "model") for c in most[:1]]
    return [
        *drawn,
        Picture(
            lambda: figures.corrected_times(verification),
            "T by band. A calibration without the effect has the measured T, too: it proves nothing.",
            name="reverberation_time",
        ),
        Picture(
            lambda: figures.corrected_shifts(verification),
            "How far the coefficients had to move, with and without the effect in the model, and their "
            "90 % intervals. Those without the effect hold only if nothing is missing from the model.",
            tall=True,
            name="shifts",
        ),
    ]


def _bars(verification: Verification) -> Picture:
    """Return the picture of the mean deviation at data that were not fitted, of each model."""
    what = "data" if verification.finding.kind == "means" else "pairs"
    ranges = ", with its range over the simulator's seeds" * (verification.gaps.shape[1] > 1)
    mean = verification.by_seed.mean(axis=1)
    each = [f"{gap:.2f} JND {of}" for gap, of in zip(mean, verification.models, strict=True)]
    title = f"Mean deviation at {what} that were not fitted"
    return Picture(
        lambda: figures.bars(verification),
        f"{title}{ranges}. The dotted line is 1 JND.",
        f"{title}: {listed(each)}.",
        name="gap",
    )


def _reproduced(finding: Finding, command: str) -> list[Any]:
    """Return the odds, how often such findings were right, what was assumed, and how to repeat it.

    A search is repeated by its command; one by means without a command, by its case.
    """
    said: list[Any] = [Code(command)] if command else []
    if finding.kind == "states":
        n = len(finding.case.pairs)
        assumed = (
            f"{finding.case.equation.name}'s equation; {n} pair{'s' * (n != 1)}. Both configurations "
            "are assumed to be measured at the same positions with the same equipment. The first one "
            "calibrates the model, so the input coefficients have no influence."
        )
        said = [Note(assumed), *said]
    elif (
        finding.kind == "means"
        and not command
        and len(case := finding.case.to_json().encode()) <= MAX_BYTES
    ):
        files = (
            ", which holds the room and every measurement, and run with the options of the search:"
        )
        said = [Files({"case.json": case}, files), Code("rtcal find case.json")]
    engines = () if finding.discrepancy is None else finding.discrepancy.engines
    rooms = [Note(f"Reference simulations: {listed(engines)}.", kind="keep")] if engines else []
    grounds = [*filter(None, (words.evidence(finding), words.track_record(finding)))]
    return [Section("Technical details", "details"), Items(grounds), *rooms, *said]


INSTRUCTIONS = "instructions.txt"
"""File of what to change in the program, where a run of the program was given."""
_SAME = 5e-4  # change of a coefficient that a list of materials, which has 0.1 %, does not hold


def instructions(
    finding: Finding,
    made: Corrected,
    room: Room,
    effect: str | None = None,
    place: Sequence[float] | None = None,
) -> list[Block]:
    """Return what to change in a program's list of materials, what to draw, and what is lost."""
    run = finding.case.room
    if finding.kind == "means" and finding.case.configurations[0].simulated is not None:
        run = finding.case.configurations[0].simulated.room
    labels = bands.labels(room.centre_frequencies)
    old = dict(zip(run.materials, run.alpha, strict=True))
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
                    "Its area times alpha is the absorption area that was found. The area is so large "
                    "that a calibration can make it absorb more or less. Its coefficients are those of "
                    "a free-standing surface: where it replaces a wall's material, add that wall's "
                    "alpha."
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


def _of_lists(reports: Mapping[str, ExportReport]) -> list[str]:
    """Return how lists of materials differ from the room, and what they do not contain."""
    said = [f"{n}: {'; '.join(r.notes)}." for n, r in reports.items() if r.notes]
    lost: dict[str, list[str]] = {}
    for name, report in reports.items():
        for what in report.lost:
            lost.setdefault(what, []).append(name)
    each = "; ".join(f"{what} ({', '.join(names)})" for what, names in lost.items())
    return [*said, *([f"The lists do not contain: {each}."] if each else [])]


def correct(
    finding: Finding,
    out: Path,
    verification: Verification | None = None,
    *,
    effect: str | None = None,
    form: str | None = None,
    at: Sequence[float] | None = None,
) -> tuple[str, dict[str, Any], dict[Path, bytes]]:
    """Return the text, the record and the files (not written) of a finding's corrected model."""
    record = finding.to_dict()
    if finding.refusal is not None and effect is None and at is None:
        nothing = str(finding.refusal)
        return f"{nothing}\nNothing is written.", {**record, "sentence": nothing}, {}
    made = finding.apply(effect=effect, form=form, at=at)
    if verification is not None:
        made = replace(made, caution=verification_words.misses(verification))
    confirmed = "To calibrate it: "
    if made.caution:
        confirmed = (
            "Do not calibrate it before the effect is confirmed, because a calibration adapts to a "
            "wrong effect, too. Once it is confirmed: "
        )
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
    lines += _of_lists(made.reports)
    if finding.kind == "positions":
        lines.append(
            f"{ROOM} is not calibrated: it holds the input coefficients and the new material. "
            f"{confirmed}rtcal fit {out / ROOM} MEASURED --out FOLDER."
        )
    record["corrected"] = made.to_dict()
    room = made.room
    if made.model is not None:
        members = finding.chosen(effect)
        calibrated = None if verification is None else verification.corrected
        if calibrated is None or members != finding.members:
            calibrated = recalibrate(made.model.case, finding.discrepancy)
        undetected = [] if finding.detected else words.headline(finding)[:1]
        added = [m for m in made.room.materials if m not in finding.case.room.materials]
        areas = dict(zip(made.room.materials, made.room.areas, strict=True))
        lines = [
            " ".join([words.added(finding, members), *undetected]),
            *warned,
            "",
            *lines_of(calibrated.blocks()),
            f"{ROOM} and {CASE} hold the input coefficients; only the table has the calibrated ones. "
            f"{confirmed}rtcal calibrate {out / ROOM} MEASURED --out FOLDER.",
            *(
                f'In {ROOM} "{m}" stands free with {areas[m]:.3g} m² and coefficients with which this '
                "area absorbs what was found: a calibration can then make it absorb more or less."
                for m in added
            ),
            *(f"Note: {note}" for note in words.noted(finding)),
            *(["The room's file cannot hold:"] if made.notes else []),
            *(f"  - {note}" for note in made.notes),
        ]
        record |= {"sentence": lines[0], "calibrated": calibrated.to_dict()}
        room = calibrated.room
    files = made.contents(out)
    if finding.kind == "means" and finding.case.has_run:
        lists = material_lists(made.room.replace(alpha=room.alpha))
        files |= {out / name: content for name, (content, _) in lists.items()}
        lines += _of_lists({name: report for name, (_, report) in lists.items()})
    if finding.kind != "states" and finding.case.has_run:
        said = lines_of(instructions(finding, made, room, effect, at))
        files[out / INSTRUCTIONS] = ("\n".join(said) + "\n").encode()
        lines += ["", *said]
    return "\n".join(lines), record, files
