"""The finder's verdicts on measured rooms, of which something was left out of the model on purpose.

    python -m benchmarks.studies.means.real_rooms list
    python -m benchmarks.studies.means.real_rooms run --folder out
    python -m benchmarks.studies.means.real_rooms table [--folder out]

Without --folder the stored rows are printed.

The cases, and which names are right, are in `benchmarks.studies.means.real_cases`. Their data are in
the folder that RTCAL_SHARED_DATA names, and a case without its data is skipped. Its folder `more` has
`bras-cr2/measured.json` and `bras-cr3/measured.json` (of emmettl/RoomCAD, `Validation/`, derived from
BRAS, doi 10.14279/depositonce-6726.3; CC BY-SA 4.0), and `meetingroom_to_hallway_290cm.wav` (McKenzie,
Schlecht, Pulkki 2021, doi 10.5281/zenodo.4636068, CC BY 4.0; in the wheel of pyFDN 0.5.0).

A wrong claim is a member or family claimed (verdict "named" or "family") that is not right.
"""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

from benchmarks.studies import stored
from benchmarks.studies.means.judging import (
    FLAGS,
    NOTHING,
    Judged,
    families_of,
    kept_controls,
    row_of,
)
from benchmarks.studies.means.real_cases import COEFFICIENTS, RealCase, every_case
from benchmarks.studies.rates import rate
from benchmarks.studies.stored import Row
from rtcal.finder import Case
from rtcal.finder.search import find

STORED = Path(__file__).parent / "real_rooms.json"
"""The rows of the run that the study shows: what the finder said, no measured value."""
PARTS = ("development", "judging")


def judge(made: Case, controls: Path) -> Row:
    """Search a case; its control rooms are kept in a file."""
    return row_of(find(made, controls=kept_controls(made, controls)))


def run(folder: Path) -> None:
    """Run the finder on every case whose data are there."""
    warnings.simplefilter("ignore")
    jobs = {}
    for each in every_case():
        controls = folder / "controls" / (re.sub(r"\W+", "_", each.name) + ".npz")
        try:
            jobs[each.name] = partial(judge, each.make(), controls)
        except FileNotFoundError as error:
            print(f"skipped: {each.name}: no {Path(error.filename or str(error)).name}")
    stored.resume(folder / "rows.jsonl", jobs)


def rows_of(folder: Path | None) -> dict[str, Row]:
    """Rows by case: of a run, or those that are stored."""
    if folder is not None:
        return {row["job"]: row for row in stored.rows(folder / "rows.jsonl")}
    return dict(json.loads(STORED.read_text(encoding="utf-8")))


def store(folder: Path) -> None:
    """Store the rows of a run."""
    STORED.write_text(json.dumps(rows_of(folder), indent=0) + "\n", encoding="utf-8")


def outcome(each: RealCase, row: Row) -> str:
    """Return "right", "wrong" (a claim), or "missed" (nothing claimed, and the truth not in it).

    Several candidates are right where the truth is among them, or where all are of families that would
    have been right: a set is then at least as narrow as the family.
    """
    judged = Judged(each.names, row)
    accepted = families_of(each.names | each.also)
    if row["verdict"] == "named":
        return "right" if judged.right_name else "wrong"
    if row["verdict"] == "family":
        return "right" if row["family"] in accepted else "wrong"
    if not judged.flagged:
        return "right" if each.control else "missed"
    narrow = bool(accepted) and all(families_of([c]) <= accepted for c in row["candidates"])
    return "right" if judged.truth_in_set or narrow else "missed"


def claim(row: Row) -> str:
    """The claim in a few words, with the probability of what is claimed."""
    verdict, effects = row["verdict"], row["probabilities"]
    said, p = {
        "named": (row["effect"], effects.get(row["effect"])),
        "family": (row["family"], row["families"].get(row["family"])),
        "ambiguous": (" or ".join(row["candidates"][:4]), effects.get(row["effect"])),
        "hint": (row["effect"], effects.get(row["effect"])),
        "none": ("", effects.get(NOTHING)),
    }.get(verdict, ("", effects.get(row["effect"])))
    return verdict + (f": {said}" if said else "") + ("" if p is None else f" ({p:.2f})")


def table(rows: dict[str, Row], part: str) -> dict[str, int]:
    """Print the cases one by one and the rates; return the counts."""
    here = [
        (c, rows[c.name], outcome(c, rows[c.name]))
        for c in every_case()
        if c.part == part and c.name in rows
    ]
    print(f"\n== {part}: {len(here)} cases ==")
    for each, row, came in here:
        size = "" if row["size"] is None else "  {:.3g} ({:.3g} to {:.3g})".format(*row["size"])
        print(
            f"{came:7} {each.name:50} hidden: {each.hidden:42} "
            f"{claim(row)}{size if row['verdict'] == 'named' else ''}"
        )
    print("wrong claims                ", rate(o == "wrong" for *_, o in here))
    print("  on controls               ", rate(o == "wrong" for c, _, o in here if c.control))
    claims = [o == "wrong" for _, r, o in here if r["verdict"] in FLAGS[:2]]
    print("  of the claims made        ", rate(claims))
    print("truth in what is named      ", rate(o == "right" for *_, o in here))
    named = [o == "right" for _, r, o in here if r["verdict"] in FLAGS[:3]]
    print("  where something is named  ", rate(named))
    print("  where something is hidden ", rate(o == "right" for c, _, o in here if not c.control))
    itself = [
        outcome(replace(c, names=c.names - {COEFFICIENTS}), r) == "right"
        for c, r, _ in here
        if not c.control
    ]
    print("    and not as coefficients ", rate(itself))
    flagged = [r["verdict"] in FLAGS for c, r, _ in here if c.control]
    print("controls flagged            ", rate(flagged))
    for source in ("PTB", "dEchorate", "CR2", "CR3", "pyFDN"):
        of = [o for c, _, o in here if c.name.startswith(source)]
        if of:
            print(
                f"  {source:10} wrong {of.count('wrong')}, right {of.count('right')}, "
                f"missed {of.count('missed')} of {len(of)}"
            )
    return {
        "cases": len(here),
        "wrong": sum(o == "wrong" for *_, o in here),
        "wrong on controls": sum(o == "wrong" for c, _, o in here if c.control),
        "right": sum(o == "right" for *_, o in here),
    }


def print_cases() -> None:
    """Print every case and the names that are right."""
    for each in every_case():
        right = ", ".join(sorted(each.names))
        print(f"{each.part:12} {each.name:50} hidden: {each.hidden:42} right: {right}")


if __name__ == "__main__":
    stored.commands(
        __doc__,
        list=lambda _: print_cases(),
        run=run,
        store=store,
        table=lambda folder: [table(rows_of(folder), part) for part in PARTS],
    )
