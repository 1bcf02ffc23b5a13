"""Runs notebooks in full and stores their outputs: `python -m benchmarks.notebooks [NOTEBOOK ...]`.

Ends with 1 where a notebook printed something else than was stored, and says in which cell. Figures are
stored anew without a comparison. RTCAL_FAST=1 shortens the studies: then nothing is stored.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_ROUNDING = 1.01
"""Units of the last decimal that is printed: another machine may round otherwise. A whole number is a
count and has none."""


def differences(stored: list[str], now: list[str]) -> list[str]:
    """Return what two runs of a notebook print differently, by code cell."""
    found = [
        f"code cell {i}: stored {old[:200]!r}, now {new[:200]!r}"
        for i, (old, new) in enumerate(zip(stored, now, strict=False), 1)
        if not same(old, new)
    ]
    if len(stored) != len(now):
        found.append(f"{len(stored)} code cells are stored, there are {len(now)}")
    return found


def same(old: str, new: str) -> bool:
    """Return whether two texts differ in nothing but blanks and the rounding of the last decimal."""
    if _NUMBER.sub("0", old).split() != _NUMBER.sub("0", new).split():
        return False
    pairs = zip(_NUMBER.findall(old), _NUMBER.findall(new), strict=True)
    return all(abs(float(a) - float(b)) <= _ROUNDING * max(_unit(a), _unit(b)) for a, b in pairs)


def _unit(number: str) -> float:
    """Return the value of a number's last printed decimal; 0 of a whole number."""
    mantissa, _, power = number.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 10.0 ** (int(power or 0) - decimals) if decimals or power else 0.0


def printed(notebook: nbformat.NotebookNode) -> list[str]:
    """Return what each code cell printed."""
    return [
        "".join(out.text for out in cell.outputs if out.output_type == "stream")
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


def run(path: Path) -> list[str]:
    """Run a notebook beside its file, store it, and return what it prints differently."""
    notebook = nbformat.read(path, as_version=4)
    stored = printed(notebook)
    client = NotebookClient(
        notebook,
        timeout=3600,
        coalesce_streams=True,
        record_timing=False,
        resources={"metadata": {"path": str(path.parent)}},
    )
    client.execute()
    if "RTCAL_FAST" in os.environ:
        return []
    nbformat.write(notebook, path)
    return differences(stored, printed(notebook))


def main(names: list[str]) -> int:
    changed = False
    for path in [Path(name) for name in names] or sorted(FOLDER.glob("*/*.ipynb")):
        print(f"{path.parent.name}/{path.name}", flush=True)
        for line in run(path):
            print(f"  {line}")
            changed = True
    return int(changed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
