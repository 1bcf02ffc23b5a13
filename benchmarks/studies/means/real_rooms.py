"""The finder's verdicts on measured rooms, of which something was left out of the model on purpose.

    python -m benchmarks.studies.means.real_rooms list --more folder
    python -m benchmarks.studies.means.real_rooms run --more folder --out rows [--part judging]
    python -m benchmarks.studies.means.real_rooms table --out rows

Without --out the stored rows are printed.

The cases, and which names are right, are in `benchmarks.studies.means.real_cases`.

``folder`` has what is not beside the repository, and a case without its data is skipped:
`bras-cr2/measured.json` and `bras-cr3/measured.json` (of emmettl/RoomCAD, `Validation/`, derived from
BRAS, doi 10.14279/depositonce-6726.3; CC BY-SA 4.0), and `meetingroom_to_hallway_290cm.wav` (McKenzie,
Schlecht, Pulkki 2021, doi 10.5281/zenodo.4636068, CC BY 4.0; in the wheel of pyFDN 0.5.0).

A wrong claim is a member or family claimed (verdict "named" or "family") that is not right.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.studies.means.judging import (
    FLAGS,
    NOTHING,
    Judged,
    families_of,
    kept_controls,
    rate,
    row_of,
)
from benchmarks.studies.means.real_cases import COEFFICIENTS, RealCase, every_case
from rtcal.finder.search import find

STORED = Path(__file__).parent / "real_rooms.json"
"""The rows of the run that the study shows: what the finder said, no measured value."""


def run(more: Path, out: Path, part: str | None) -> None:
    """Run the finder on every case whose data are there; control rooms are kept beside the rows."""
    warnings.simplefilter("ignore")
    for each in every_case():
        path = out / f"{each.file}.json"
        if path.exists() or part not in (None, each.part):
            continue
        try:
            made = each.make(more)
        except FileNotFoundError as error:
            print(f"skipped: {each.name}: no {Path(error.filename or str(error)).name}")
            continue
        controls = kept_controls(made, out / "controls" / f"{each.file}.npz")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(row_of(find(made, controls=controls))), encoding="utf-8")
        print(".", end="", flush=True)
    print()


def rows_of(out: Path | None) -> dict[str, dict[str, Any]]:
    """Rows by case: of a run, or those that are stored."""
    if out is None:
        stored: dict[str, dict[str, Any]] = json.loads(STORED.read_text(encoding="utf-8"))
        return stored
    paths = {c.name: out / f"{c.file}.json" for c in every_case()}
    return {k: json.loads(p.read_text(encoding="utf-8")) for k, p in paths.items() if p.exists()}


def outcome(each: RealCase, row: dict[str, Any]) -> str:
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
    if row["verdict"] not in FLAGS:
        return "right" if each.control else "missed"
    narrow = bool(accepted) and all(families_of([c]) <= accepted for c in row["candidates"])
    return "right" if judged.truth_in_set or narrow else "missed"


def named(row: dict[str, Any]) -> bool:
    """Whether anything is named: an effect, a family, several candidates."""
    return row["verdict"] in ("named", "family", "ambiguous")


def claim(row: dict[str, Any]) -> str:
    """The claim in a few words, with the probability of what is claimed."""
    names = {
        "named": row["effect"],
        "family": row["family"],
        "ambiguous": " or ".join(row["candidates"][:4]),
        "hint": row["effect"],
    }
    said = names.get(row["verdict"])
    table = {**row["families"], **row["probabilities"]}
    p = row["families"].get(said) if row["verdict"] == "family" else table.get(row["effect"])
    if row["verdict"] == "none":
        p = row["probabilities"].get(NOTHING)
    return row["verdict"] + (f": {said}" if said else "") + ("" if p is None else f" ({p:.2f})")


def table(rows: dict[str, dict[str, Any]], part: str) -> dict[str, int]:
    """Print the cases one by one and the rates; return the counts."""
    here = [(c, rows[c.name]) for c in every_case() if c.part == part and c.name in rows]
    print(f"\n== {part}: {len(here)} cases ==")
    for each, row in here:
        size = "" if row["size"] is None else "  {:.3g} ({:.3g} to {:.3g})".format(*row["size"])
        print(
            f"{outcome(each, row):7} {each.name:50} hidden: {each.hidden:42} "
            f"{claim(row)}{size if row['verdict'] == 'named' else ''}"
        )
    results = [(c, outcome(c, r)) for c, r in here]
    claims = [o for (_, o), (_, r) in zip(results, here, strict=True) if r["verdict"] in FLAGS[:2]]
    print("wrong claims                ", rate(o == "wrong" for _, o in results))
    print("  on controls               ", rate(o == "wrong" for c, o in results if c.control))
    print("  of the claims made        ", rate(o == "wrong" for o in claims))
    print("truth in what is named      ", rate(o == "right" for _, o in results))
    print(
        "  where something is named  ",
        rate(o == "right" for (_, o), (_, r) in zip(results, here, strict=True) if named(r)),
    )
    print("  where something is hidden ", rate(o == "right" for c, o in results if not c.control))
    itself = [
        outcome(replace(c, names=c.names - {COEFFICIENTS}), r) == "right"
        for c, r in here
        if not c.control
    ]
    print("    and not as coefficients ", rate(itself))
    print("controls flagged            ", rate(r["verdict"] in FLAGS for c, r in here if c.control))
    for source in ("PTB", "dEchorate", "CR2", "CR3", "pyFDN"):
        of = [o for c, o in results if c.name.startswith(source)]
        if of:
            print(
                f"  {source:10} wrong {of.count('wrong')}, right {of.count('right')}, "
                f"missed {of.count('missed')} of {len(of)}"
            )
    return {
        "cases": len(results),
        "wrong": sum(o == "wrong" for _, o in results),
        "wrong on controls": sum(o == "wrong" for c, o in results if c.control),
        "right": sum(o == "right" for _, o in results),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("list", "run", "table", "store"))
    parser.add_argument("--more", type=Path, default=Path("."), help="folder of further data")
    parser.add_argument("--out", type=Path, help="folder of the rows")
    parser.add_argument("--part", choices=("development", "judging"))
    given = parser.parse_args()
    if given.what == "list":
        for each in every_case():
            right = ", ".join(sorted(each.names))
            print(f"{each.part:12} {each.name:50} hidden: {each.hidden:42} right: {right}")
    elif given.what == "run":
        run(given.more, given.out, given.part)
    elif given.what == "store":
        STORED.write_text(json.dumps(rows_of(given.out), indent=0) + "\n", encoding="utf-8")
    else:
        for part in ("development", "judging") if given.part is None else (given.part,):
            table(rows_of(given.out), part)


if __name__ == "__main__":
    main()
