"""Rooms with the defects of real models: V and S within 1 %.

    python -m benchmarks.defective_meshes [number]    # of 200

`defective_meshes.jsonl.gz` has 320, of the seeds 0 to 199 and 3000 to 3119; the same module in commit
995d6858 drew them. Each is a prism over a random footprint with a flat or a pitched roof, drawn as a
person would, and then damaged: joints rounded to a centimetre, slivers, windows on walls, doors to the
floor, flipped faces, faces drawn twice, free panels, tables without a bottom, small holes, fins, closed
objects on the floor and on a wall, stages that are open to the floor and to a wall; and what cannot be
mended: a missing wall, a wall 15 cm beside its place, a sheet instead of a room. V and S of the room as
meant are known. A free panel counts on both sides, a window takes the area of its wall, and where an
object stands neither it nor the wall counts.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.stored import numbered
from rtcal.io.mend import Faces, MeshError, mended

REFUSED = {
    "missing wall": "hole",
    "wall beside": "hole",
    "sheet": "the faces do not enclose a volume",
}
"""Defects that cannot be mended, and what the refusal names."""


@dataclass(frozen=True)
class Drawn:
    """A room as it is drawn, and as it is meant."""

    polygons: list[np.ndarray]
    names: list[str]
    volume: float
    areas: dict[str, float]
    defects: list[str]

    def faces(self) -> Faces:
        names = [f"{n} {i}" for i, n in enumerate(self.names)]
        return Faces("mesh", self.polygons, self.names, names)


@cache
def stored() -> dict[int, dict[str, Any]]:
    """Return every stored room by its seed."""
    return numbered(Path(__file__).with_suffix(".jsonl.gz"), "seed")


def example(seed: int) -> Drawn:
    """Return a damaged room: every fifth cannot be mended, the others have one to four defects."""
    row = stored()[seed]
    return Drawn(**{**row, "polygons": [np.array(p) for p in row["polygons"]]})


def judged(seed: int) -> tuple[str, str]:
    """Return what came of a mesh, "right", "refused right", "refused wrong" or "silent", and why."""
    drawn = example(seed)
    unmendable = [REFUSED[d] for d in drawn.defects if d in REFUSED]
    try:
        done = mended(drawn.faces())
    except MeshError as error:
        right = any(name in str(error) for name in unmendable)
        return ("refused right" if right else "refused wrong"), f"{drawn.defects}: {error}"
    volume = done.geometry.volume / drawn.volume - 1
    area = float(np.sum(done.geometry.face_areas)) / sum(drawn.areas.values()) - 1
    within = max(abs(volume), abs(area)) <= 0.01 and not unmendable
    why = f"{drawn.defects}: V {100 * volume:+.2f} %, S {100 * area:+.2f} %, {done}"
    return ("right" if within else "silent"), why


def areas_held(seed: int) -> list[bool]:
    """Whether each material's area is right within twice its standard uncertainty, or 0.1 %."""
    drawn = example(seed)
    try:
        done = mended(drawn.faces())
    except MeshError:
        return []
    u = done.area_uncertainty
    return [
        abs(area - drawn.areas[m]) <= max(2 * u.get(m, 0.0), 1e-3 * drawn.areas[m])
        for m, area in done.areas.items()
    ]


def main() -> None:
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    results = [judged(seed) for seed in range(number)]
    for seed, (what, why) in enumerate(results):
        if what in ("silent", "refused wrong"):
            print(f"{seed}: {what}: {why}\n")
    print(dict(Counter(what for what, _ in results)))
    held = [h for seed in range(number) for h in areas_held(seed)]
    print(f"{sum(held)} of {len(held)} areas within twice their uncertainty, or 0.1 %")


if __name__ == "__main__":
    main()
