"""The two cases of `rtcal example identified`: by what rule they were picked, and what the finder said.

    python -m benchmarks.studies.means.shipped_cases   # writes rtcal/datasets/hidden_room; some minutes
    python -m benchmarks.studies.means.shipped_cases --dry  # prints the table alone

The rooms are of `studies/hidden_world`: a tracer of its own, coefficients drawn about the stated ones
with the stated sigma and correlation. Nothing of rtcal is in them. The rule, written down before any
was run: one room of each kind of hidden effect, index 0 of population 4, which nothing else uses; the
kinds in an order shuffled with `ORDER`. The first room in which `find` names one effect is shipped,
whether the name is right or not, and so is the first in which it claims nothing. All rooms up to the
later of the two are printed, with what was hidden in them and what was said.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.hidden_world.populations import KINDS, build
from benchmarks.studies.means.judged import NAMES
from rtcal.finder import Case
from rtcal.finder.search import find

POPULATION = 4
ORDER = 37
FOLDER = Path(__file__).parents[3] / "rtcal" / "datasets" / "hidden_room"
CLAIMS_NOTHING = ("none", "hint")


def kinds() -> list[int]:
    """The kinds that an effect of the library is, in the order in which they are tried."""
    of_library = [k for k, name in KINDS.items() if name not in ("nothing", "unknown")]
    return [int(k) for k in np.random.default_rng(ORDER).permutation(of_library)]


def main(*, dry: bool) -> None:
    wanted: dict[str, Any] = {"identified": None, "not_identified": None}
    print(f"{'hidden':20s} {'verdict':10s} {'effect':18s} score / nats")
    for kind in kinds():
        made = build(POPULATION, kind, 0)
        finding = find(Case.from_dict(made["case"]))
        print(
            f"{NAMES[kind]:20s} {finding.verdict:10s} {finding.effect or '-':18s} "
            f"{finding.score:.1f}",
            flush=True,
        )
        if finding.verdict == "named" and wanted["identified"] is None:
            wanted["identified"] = made
        if finding.verdict in CLAIMS_NOTHING and wanted["not_identified"] is None:
            wanted["not_identified"] = made
        if all(wanted.values()):
            break
    if dry:
        return
    for name, made in wanted.items():
        truth = {"hidden": NAMES[made["truth"]["seed"][1]], **made["truth"]}
        for file, content in ((f"{name}.json", made["case"]), (f"{name}_truth.json", truth)):
            (FOLDER / file).write_text(json.dumps(content) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dry", action="store_true")
    main(dry=parser.parse_args().dry)
