"""``rtcal gap`` with positions: what is other than stated, and on which surface."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtcal.command.assignments import errors_name_options, pairs
from rtcal.command.console import bar_wanted, said, tell, written
from rtcal.command.gap_options import Inputs
from rtcal.errors import DataError
from rtcal.support.files import spare
from rtcal.support.progress import bar

if TYPE_CHECKING:
    from rtcal.finder.positions import Case, Finding, Place, Verification
    from rtcal.report.document import Heading

SEEDS = (0, 1, 2)
"""Seeds of the simulator over which a gap is said."""

PROPOSED = 3
"""Places for a further receiver that are printed."""


@dataclass(frozen=True)
class Patch:
    """The size and the place of what is added: see `rtcal.finder.positions.Finding.apply`."""

    form: str
    at: tuple[float, ...] | None


def find(inputs: Inputs, search: Any, quiet: bool, outputs: Sequence[Path] = ()) -> Finding:
    """Return the finding in a room; DataError if an output is also one of the files that are read.

    Control runs and weighings are kept beside the room.
    """
    from rtcal.finder import positions

    if search.engines_stated:
        raise DataError("--engine: a search with positions has control runs in the room's geometry")
    if search.prior:
        raise DataError("--prior: a search with positions takes --only and --without")
    case = _case(inputs, outputs)
    begun: list[str] = []
    with bar(0, "control run", bar_wanted(quiet), said(quiet)) as shown:

        def progress(what: str, done: int, total: int) -> None:
            step = "weighing" if what != "control runs" else what
            if step not in begun and hasattr(shown, "reset"):
                begun.append(step)
                shown.reset(total=total)
                shown.set_description(step)
            shown.update(1)

        return positions.find(
            case,
            cache=inputs.kept,
            seed=search.seed,
            only=search.only,
            without=search.without,
            progress=progress,
        )


def _case(inputs: Inputs, outputs: Sequence[Path]) -> Case:
    """Return the case of a room and its measurement."""
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room
    from rtcal.finder.positions import Case

    room = Room.from_file(inputs.case)
    files = [inputs.case, inputs.measured, inputs.simulated, room.scene.mesh]
    spare(outputs, [path for path in files if path is not None])
    simulated = inputs.simulated and Measurement.from_file(inputs.simulated)
    tracing = {"n_paths": inputs.paths, "scattering": inputs.scattering}
    with errors_name_options("scattering", "match", "exclude"):
        return Case.from_room(
            room,
            Measurement.from_file(str(inputs.measured)),
            tracing={name: value for name, value in tracing.items() if value is not None},
            simulated=simulated,
            exclude=pairs("--exclude", inputs.exclude),
            **({"match": inputs.match} if inputs.match else {}),
        )


def tell_finding(inputs: Inputs, search: Any, *, quiet: bool, as_json: bool) -> None:
    """Print the finding."""
    finding = find(inputs, search, quiet)
    tell(str(finding), finding.to_dict(), quiet=quiet, as_json=as_json)


def apply(
    inputs: Inputs, search: Any, out: str, patch: Patch, *, quiet: bool, as_json: bool
) -> bool:
    """Write the corrected room into a folder; return whether there was something to add."""
    from rtcal.finder.positions.corrected import FILES

    folder = Path(out)
    finding = find(inputs, search, quiet, [folder / name for name in FILES])
    if not finding.can_be_added:
        text = f"{finding.headline}\nNothing is written."
        tell(text, {**finding.to_dict(), "written": []}, quiet=quiet, as_json=as_json)
        return False
    corrected = finding.apply(patch.form, at=patch.at)
    paths = corrected.save(folder)
    added = corrected.added
    text = "\n".join(
        [
            finding.headline,
            f"Added {added.title}, {added.in_words}, as {corrected.form}: "
            f'material "{corrected.material}".',
            *([corrected.note] if corrected.note else []),
            written(paths),
        ]
    )
    record = {
        **finding.to_dict(),
        "added": added.to_dict(),
        "form": corrected.form,
        "note": corrected.note,
        "written": [str(p) for p in paths],
    }
    tell(text, record, quiet=quiet, as_json=as_json)
    return True


def verify(inputs: Inputs, search: Any, *, quiet: bool, as_json: bool) -> None:
    """Print the gaps at pairs that were not fitted."""
    finding = find(inputs, search, quiet)
    if not finding.can_be_added:
        text = f"{finding.headline}\nThere is nothing to add to a surface."
        record = {"verdict": None, "sentence": text, "finding": finding.to_dict()}
        tell(text, record, quiet=quiet, as_json=as_json)
        return
    result = _verified(inputs, finding, search, quiet)
    tell(str(result), result.to_dict(), quiet=quiet, as_json=as_json)


def _verified(inputs: Inputs, finding: Finding, search: Any, quiet: bool) -> Verification:
    """Return the gaps at pairs that were not fitted, over `SEEDS`; a bar says how long it will take."""
    from rtcal.finder import positions

    with bar(0, "model", bar_wanted(quiet), said(quiet)) as shown:

        def progress(what: str, done: int, total: int) -> None:
            if done == 1 and hasattr(shown, "reset"):
                shown.reset(total=total)
            shown.update(1)

        return positions.verify(
            finding,
            seeds=SEEDS,
            cache=inputs.kept,
            only=search.only,
            without=search.without,
            progress=progress,
        )


def plan(inputs: Inputs, search: Any, *, quiet: bool, as_json: bool) -> None:
    """Print where a further receiver would tell the surfaces apart that are in question."""
    from rtcal.support import text

    finding = find(inputs, search, quiet)
    places = _places(finding)[:PROPOSED]
    lines = [*text.wrapped(finding.headline), ""]
    if places:
        names = [f'"{name}"' for name in finding.likely_surfaces]
        lines += text.wrapped(
            "A further receiver is expected to tell these surfaces apart with so many nats of "
            f"evidence (2.3 are odds of ten to one): {', '.join(names)}."
        )
        rows = [
            (f"{', '.join(f'{x:.2f}' for x in place.point)} m", [place.source, f"{place.nats:.1f}"])
            for place in places
        ]
        lines += text.table(rows, header=("receiver", ["source", "nats"]))
    else:
        lines += text.wrapped(
            "No surfaces are in question that a further receiver would tell apart. Which other "
            "measurement would tell most is planned with means over positions: name a case that states "
            "the room, or a measurement of means."
        )
    record = {
        "places": [
            {"point": list(place.point), "source": place.source, "nats": place.nats}
            for place in places
        ],
        "finding": finding.to_dict(),
    }
    tell("\n".join(lines), record, quiet=quiet, as_json=as_json)


def _places(finding: Finding) -> tuple[Place, ...]:
    """Return places for a further receiver, the one that tells most first; none without a question."""
    from rtcal.finder import positions

    if not finding.can_be_added or finding.surface is not None:
        return ()
    try:
        return positions.next_position(finding)
    except DataError:  # at most one surface is in question, or the room is too small for a grid
        return ()


def report(
    inputs: Inputs, search: Any, out: str, heading: Heading, *, quiet: bool, as_json: bool
) -> None:
    """Write page, finding and figures into a folder."""
    from rtcal.finder import positions
    from rtcal.report import where_folder

    folder = Path(out)
    finding = find(inputs, search, quiet, [folder / name for name in where_folder.FILES])
    verification = None
    if finding.can_be_added and len(finding.pairs) >= positions.LEAST_PAIRS:
        verification = _verified(inputs, finding, search, quiet)
    command = shlex.join(
        [
            "rtcal",
            "gap",
            "report",
            *inputs.arguments(),
            *replace(search, engines=()).arguments(),
            "--out",
            out,
        ]
    )
    place = next(iter(_places(finding)), None)
    paths = where_folder.write(finding, verification, folder, heading, command, place)
    first = [] if verification is None else [verification.sentence]
    text = "\n".join([*first, str(finding), written(paths)])
    record = {**finding.to_dict(), "written": [str(p) for p in paths]}
    tell(text, record, quiet=quiet, as_json=as_json)
