"""Tables whose content is known: each is read with the true values, or refused by its place.

    python -m benchmarks.drawn_tables [number]    # of 500

`drawn_tables.jsonl.gz` has 560, of the seeds 0 to 499 and 7000 to 7059; the same module in commit
995d6858 drew them. They are material lists, tables of measured values and tables of modes: in six
languages, as text with four separators and in a workbook; with bands across, bands down, positions
across, one value per row, one sheet per position, and as ISO 354's protocols. Units stand in a title,
in headers, in a row of units above or below them, in a column, in a cell or nowhere; numbers are
fractions, percent or m² per object, s or ms, Hz or kHz. Beside the values stand rows, columns and
sheets of statistics, times and uncertainties.
"""

from __future__ import annotations

import base64
import re
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.stored import numbered
from rtcal.acoustics.observables import SUMMARY
from rtcal.io import library, tables
from rtcal.modes import measured
from rtcal.support.errors import DataError


@dataclass
class Drawn:
    """A table as it is written, and what it means.

    ``truth`` is, of materials, the coefficients by product and band; of measured values the value by
    source, receiver, parameter and band; of modes the frequency in Hz, the decay and its uncertainty in
    1/s by number. ``objects`` are the products in m² per object, which no room may use.
    """

    kind: str
    name: str
    content: bytes
    truth: dict[tuple[Any, ...], Any]
    what: str
    objects: list[str]
    options: dict[str, Any] = field(default_factory=dict)


@cache
def stored() -> dict[int, dict[str, Any]]:
    """Return every stored table by its seed."""
    return numbered(Path(__file__).with_suffix(".jsonl.gz"), "seed")


def example(seed: int) -> Drawn:
    """Return the table of a seed."""
    row = stored()[seed]
    truth = {tuple(key): value for key, value in row["truth"]}
    return Drawn(**{**row, "content": base64.b64decode(row["content"]), "truth": truth})


def filled_in(refusal: str) -> str:
    """Return the ``columns`` that a refusal proposes, with - for a column that is to be filled in."""
    proposed = re.search(r'columns="([^"]*)"', refusal)
    text = proposed[1].replace("[?]", "[-]") if proposed else ""
    return re.sub(r"(?<=[:;] )\?(?=;|$)", "-", text)


def judged(seed: int, folder: Path) -> tuple[str, str]:
    """Return what came of a table, and why.

    It is "right", "refused", "refused without a place", or "silent" for values that are not true. One
    that is refused with a proposal of its columns is read again with it: "right as proposed".
    """
    drawn = example(seed)
    path = folder / drawn.name
    path.write_bytes(drawn.content)
    right = "right"
    try:
        wrong = OF_KIND[drawn.kind](path, drawn)
    except DataError as error:
        named = str(path) in str(error) or "line " in str(error)
        refused = ("refused" if named else "refused without a place"), f"{drawn.what}: {error}"
        filled = filled_in(str(error))
        if not filled:
            return refused
        drawn.options["columns"], right = filled, "right as proposed"
        try:
            wrong = OF_KIND[drawn.kind](path, drawn)
        except DataError:
            return refused
    finally:
        path.unlink()
    return ("silent" if wrong else right), f"{drawn.what}: {wrong}"


def differ(found: dict[Any, float], true: dict[Any, float]) -> str:
    """Return the first difference of values by key; empty without one."""
    for key in [*true, *found]:
        a, b = found.get(key), true.get(key)
        if a is None or b is None or abs(a - b) > 1e-9 * abs(b):
            return f"{key}: {a} read, {b} true"
    return ""


def of_materials(path: Path, drawn: Drawn) -> str:
    found = {
        (m.name, f): a
        for m in library.read(path, **drawn.options).materials
        if not m.doubt
        for f, a in zip(m.centre_frequencies, m.alpha, strict=True)
    }
    usable = {key: min(a, 1.0) for key, a in drawn.truth.items() if key[0] not in drawn.objects}
    return differ(found, usable)


def of_values(path: Path, drawn: Drawn) -> str:
    m = tables.read(path, **drawn.options).measurement
    found = {
        (*pair, parameter, float(f)): float(values[i, k])
        for parameter, values in m.values.items()
        for i, pair in enumerate(m.pairs)
        for k, f in enumerate(m.centre_frequencies)
        if np.isfinite(values[i, k])
    }
    return differ(found, drawn.truth) if (SUMMARY, SUMMARY) not in m.pairs else "means alone"


def of_modes(path: Path, drawn: Drawn) -> str:
    modes = measured.read(path)
    found = np.stack([modes.frequencies, modes.decays, modes.decay_uncertainty], axis=1)
    true = np.array([*drawn.truth.values()])
    same = found.shape == true.shape and np.allclose(found, true, rtol=1e-6, atol=0)
    return "" if same else f"{found.tolist()} read, {true.tolist()} true"


OF_KIND = {"materials": of_materials, "values": of_values, "modes": of_modes}
"""Of each kind what says how the values that are read differ from the true ones."""


def main() -> None:
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    with tempfile.TemporaryDirectory() as folder:
        results = [judged(seed, Path(folder)) for seed in range(number)]
    for seed, (what, why) in enumerate(results):
        if not what.startswith("right") and what != "refused":
            print(f"{seed}: {what}: {why}\n")
    for first, kind in enumerate(("material lists", "measured values", "modes")):
        print(f"{kind}: {dict(Counter(what for what, _ in results[first::3]))}")
    print(dict(Counter(what for what, _ in results)))


if __name__ == "__main__":
    main()
