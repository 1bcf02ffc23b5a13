"""Models that others have published, each read by one call: V and S beside what their authors state.

    python -m benchmarks.public_models FOLDER

FOLDER holds clones of the repositories named below, each under its own name. The models are not part of
rtcal. The rows are those of the table in docs/io.md; the seconds are of this process.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.io import mesh
from rtcal.io.mend import MeshError
from rtcal.support.errors import DataError

WAYVERB = "reuk/wayverb (GPL 2)"
ASSETS, MODELS = "demo/assets/test_models", "demo/evaluation/models/object"
STUDIO = "jdginn/go-recording-studio (MIT)"
BUILDINGS = "youshengCode/IfcSampleFiles (none stated)"


@dataclass(frozen=True)
class Model:
    """A file, where it is from, the options that it needs, and what its authors state."""

    source: str
    path: str
    stated: str = "nothing"
    options: Mapping[str, Any] = field(default_factory=dict)

    def file(self, folder: Path) -> Path:
        return folder / self.source.split(" ")[0].split("/")[1] / self.path


def _spaces(path: str, **stated: str) -> list[Model]:
    return [
        Model(BUILDINGS, path, said, {"space": space.replace("_", " ")})
        for space, said in stated.items()
    ]


EVERY = (
    Model(WAYVERB, f"{MODELS}/small_cuboid.obj", "2 x 2.5 x 3 m: 15 m³, 37 m²"),
    Model(WAYVERB, f"{MODELS}/medium_cuboid.obj", "4.5 x 2.5 x 3.5 m: 39.375 m³, 71.5 m²"),
    Model(WAYVERB, f"{MODELS}/large_cuboid.obj", "12 x 4 x 8 m: 384 m³, 352 m²"),
    Model(WAYVERB, f"{MODELS}/echo_tunnel.obj", "4 x 7 x 100 m: 2800 m³, 2256 m²"),
    Model(WAYVERB, f"{MODELS}/concert.obj", "about 33 x 15 x 50 m around it"),
    *(Model(WAYVERB, f"{ASSETS}/{name}.obj") for name in ("vault", "bedroom", "basic",
                                                          "random_pillars")),
    Model(WAYVERB, f"{ASSETS}/murphy2008.dae"),
    Model(WAYVERB, f"{ASSETS}/southern2013_2.dae"),
    *(Model(WAYVERB, f"{ASSETS}/room{k}.dxf", options={"unit": 0.1}) for k in (1, 2, 3)),
    Model(
        "LCAV/pyroomacoustics (MIT)",
        "examples/data/INRIA_MUSIS.stl",
        'a unit of 1/500 m, for "a realistic size"',
        {"unit": 0.001},
    ),
    *(Model(STUDIO, f"testdata/{name}.3mf") for name in ("Cutout", "Modified", "without_walls",
                                                          "angled_difuser")),
)  # fmt: skip


def room(model: Model, folder: Path) -> tuple[str, str, int, str]:
    """Return V, S, the number of faces and what was found, in words."""
    try:
        done = mesh.room(model.file(folder), **model.options)
    except MeshError as error:
        if error.unclosed is None:
            return "refused", "", 0, str(error)
        left = error.unclosed
        volume = f"{left.volume:.6g} ± {left.volume_uncertainty:.2g} (--open)"
        return volume, f"{sum(left.areas.values()):.4g}, as drawn", 0, ""
    except DataError as error:
        return "refused", "", 0, str(error)
    found = ", ".join(f"{d.number} {d.kind}" for d in done.defects)
    u = f" ± {done.volume_uncertainty:.2g}" if done.volume_uncertainty > 1e-4 * done.volume else ""
    area = float(np.sum(done.geometry.face_areas))
    return f"{done.volume:.6g}{u}", f"{area:.4g}", len(done.geometry.faces), found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="part of the path")
    given = parser.parse_args()
    for model in EVERY:
        if given.only not in model.path:
            continue
        begin = time.process_time()
        v, s, n, found = room(model, given.folder)
        taken = time.process_time() - begin
        print(
            f"| {model.path} | {v} | {s} | {model.stated} | {n} | {taken:.1f} s | {found} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
