"""``rtcal gap`` for a case with a geometry: what is other than stated, and on which surface."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtcal.command.console import bar_wanted, tell, written
from rtcal.errors import DataError
from rtcal.support.files import spare
from rtcal.support.progress import bar

if TYPE_CHECKING:
    from rtcal.report.document import Heading
    from rtcal.where import Finding, Place, Verification

SEEDS = (0, 1, 2)
"""Seeds of the simulator over which a gap is said."""

PROPOSED = 3
"""Places for a further receiver that are printed."""


@dataclass(frozen=True)
class Patch:
    """How what was found is added: see `rtcal.where.Finding.apply`."""

    form: str
    at: tuple[float, ...] | None


def find(path: str, search: Any, quiet: bool, outputs: Sequence[Path] = ()) -> Finding:
    """Return the finding of a case's file; DataError if an output is also one of its files.

    Control runs and weighings are kept beside the file.
    """
    from rtcal import where
    from rtcal.discrepancy.cache import FOLDER
    from rtcal.where import case_files

    if search.engines_stated:
        raise DataError("--engine: a case with a geometry has control runs in that geometry")
    if search.prior:
        raise DataError("--prior: a case with a geometry takes --only and --without")
    spare(outputs, [path])
    case = where.Case.from_file(path)
    spare(outputs, case_files.files(path))
    begun: list[str] = []
    with bar(0, "control run", bar_wanted(quiet)) as shown:

        def progress(what: str, done: int, total: int) -> None:
            step = "weighing" if what != "control runs" else what
            if step not in begun and hasattr(shown, "reset"):
                begun.append(step)
                shown.reset(total=total)
                shown.set_description(step)
            shown.update(1)

        return where.find(
            case,
            cache=Path(path).parent / FOLDER,
            seed=search.seed,
            only=search.only,
            without=search.without,
            progress=progress,
        )


def tell_finding(path: str, search: Any, *, quiet: bool, as_json: bool) -> None:
    """Print the finding."""
    finding = find(path, search, quiet)
    tell(str(finding), finding.to_dict(), quiet=quiet, as_json=as_json)


def apply(path: str, search: Any, out: str, patch: Patch, *, quiet: bool, as_json: bool) -> bool:
    """Write the corrected room into a folder; return whether there was something to add."""
    from rtcal.where.corrected import FILES

    folder = Path(out)
    finding = find(path, search, quiet, [folder / name for name in FILES])
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


def verify(path: str, search: Any, *, quiet: bool, as_json: bool) -> None:
    """Print the gaps at pairs that were not fitted."""
    finding = find(path, search, quiet)
    if not finding.can_be_added:
        text = f"{finding.headline}\nThere is nothing to add to a surface."
        record = {"verdict": None, "sentence": text, "finding": finding.to_dict()}
        tell(text, record, quiet=quiet, as_json=as_json)
        return
    result = _verified(path, finding, search, quiet)
    tell(str(result), result.to_dict(), quiet=quiet, as_json=as_json)


def _verified(path: str, finding: Finding, search: Any, quiet: bool) -> Verification:
    """Return the gaps at pairs that were not fitted, over `SEEDS`; a bar says how long it will take."""
    from rtcal import where
    from rtcal.discrepancy.cache import FOLDER

    with bar(0, "model", bar_wanted(quiet)) as shown:

        def progress(what: str, done: int, total: int) -> None:
            if done == 1 and hasattr(shown, "reset"):
                shown.reset(total=total)
            shown.update(1)

        return where.verify(
            finding,
            seeds=SEEDS,
            cache=Path(path).parent / FOLDER,
            only=search.only,
            without=search.without,
            progress=progress,
        )


def plan(path: str, search: Any, *, quiet: bool, as_json: bool) -> None:
    """Print where a further receiver would tell the surfaces apart that are in question."""
    from rtcal.support import text

    finding = find(path, search, quiet)
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
            "measurement would tell most is planned with means over positions: leave geometry and "
            "positions out of the case."
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
    from rtcal import where

    if not finding.can_be_added or finding.surface is not None:
        return ()
    try:
        return where.next_position(finding)
    except DataError:  # at most one surface is in question, or the room is too small for a grid
        return ()


def report(
    path: str, search: Any, out: str, heading: Heading, *, quiet: bool, as_json: bool
) -> None:
    """Write page, finding and figures into a folder."""
    from rtcal import where
    from rtcal.report import where_folder

    folder = Path(out)
    finding = find(path, search, quiet, [folder / name for name in where_folder.FILES])
    verification = None
    if finding.can_be_added and len(finding.pairs) >= where.LEAST_PAIRS:
        verification = _verified(path, finding, search, quiet)
    command = shlex.join(
        ["rtcal", "gap", "report", path, *replace(search, engines=()).arguments(), "--out", out]
    )
    place = next(iter(_places(finding)), None)
    paths = where_folder.write(finding, verification, folder, heading, command, place)
    first = [] if verification is None else [verification.sentence]
    text = "\n".join([*first, str(finding), written(paths)])
    record = {**finding.to_dict(), "written": [str(p) for p in paths]}
    tell(text, record, quiet=quiet, as_json=as_json)
