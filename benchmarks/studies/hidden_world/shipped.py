"""The room that ships with rtcal, measured again with its opening closed.

    python -m benchmarks.studies.hidden_world.shipped    # writes rtcal/datasets/hidden_room/closed.json

case.json there is room 8 of kind 2, population 0. Its opening is closed here, and the world's tracer
measures it once more, with noise of its own. Nothing is chosen: it is the one draw of this seed.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.hidden_world.populations import make, measure, plain

SEED = (0, 2, 8)
FOLDER = Path(__file__).parents[3] / "rtcal" / "datasets" / "hidden_room"


def closed() -> dict[str, Any]:
    """Return the case with configuration A, and C: A with the opening closed."""
    case: dict[str, Any] = json.loads((FOLDER / "case.json").read_text(encoding="utf-8"))
    room = make(*SEED)
    rng = np.random.default_rng([*SEED, 2])
    wall = replace(room.world, patch_wall=-1, patch_alpha=None)
    again = measure(room, wall, int(rng.integers(2**31)), rng)
    case["configuration"] = [
        case["configuration"][0],
        plain({"name": "C", "suspect_removed": True, **again}),
    ]
    return case


if __name__ == "__main__":
    (FOLDER / "closed.json").write_text(json.dumps(closed()) + "\n", encoding="utf-8")
