"""Models that others have published, each by one command: V and S beside what their authors state.

    python -m benchmarks.public_models FOLDER [--only PART]

FOLDER holds clones of the repositories named below, each under its own name. The models are not part of
rtcal. It prints the table of benchmarks/studies/formats, and the processor time of the slowest.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

LICENCES = {
    "reuk/wayverb": "GPL 2",
    "LCAV/pyroomacoustics": "MIT",
    "jdginn/go-recording-studio": "MIT",
    "youshengCode/IfcSampleFiles": "none stated",
}


@dataclass(frozen=True)
class Model:
    """A file of a repository, the options that it needs, and what its authors state."""

    repository: str
    path: str
    options: str = ""
    stated: str = ""


def _of(repository: str, folder: str, *rows: str) -> list[Model]:
    """Return models of rows "file; options; what is stated"."""
    cells = [[cell.strip() for cell in row.split(";")] for row in rows]
    return [Model(repository, os.path.join(folder, name), *rest) for name, *rest in cells]


EVERY = [
    *_of(
        "reuk/wayverb",
        "demo/evaluation/models/object",
        "small_cuboid.obj; ; 15 m³, 37 m² (2 × 2.5 × 3 m)",
        "medium_cuboid.obj; ; 39.375 m³, 71.5 m² (4.5 × 2.5 × 3.5 m)",
        "large_cuboid.obj; ; 384 m³, 352 m² (12 × 4 × 8 m)",
        "echo_tunnel.obj; ; 2800 m³, 2256 m² (4 × 7 × 100 m)",
        "concert.obj; ; about 33 × 15 × 50 m around it",
    ),
    *_of(
        "reuk/wayverb",
        "demo/assets/test_models",
        *(f"{name}.obj" for name in ("vault", "bedroom", "basic", "random_pillars")),
        "murphy2008.dae",
        "southern2013_2.dae",
        *(f"room{k}.dxf; --unit 0.1" for k in (1, 2, 3)),
    ),
    *_of(
        "LCAV/pyroomacoustics",
        "examples/data",
        'INRIA_MUSIS.stl; --unit 0.001; a unit of 1/500 m, for "a realistic size"',
    ),
    *_of(
        "jdginn/go-recording-studio",
        "testdata",
        "Cutout.3mf",
        *(f"{name}.3mf; --open" for name in ("Modified", "without_walls", "angled_difuser")),
    ),
    *_of(
        "youshengCode/IfcSampleFiles",
        "",
        *(
            f"Ifc4_SampleHouse.ifc; --space {space}; {volume} m³"
            for space, volume in (
                ('"1 - Living room"', 129.987),
                ('"2 - Bedroom"', 38.542),
                ('"3 - Entrance hall"', 21.734),
                ('"4 - Roof"', 76.466),
            )
        ),
        *(
            f"Ifc2x3_Duplex_Architecture.ifc; --space {space}; {volume} m³"
            for space, volume in (
                ("A101", 40.241),
                ("A102", 71.391),
                ("A103", 33.512),
                ("A104", 8.177),
                ("A105", 20.796),
                ("A201", 18.115),
                ("A202", 56.894),
                ("A203", 56.894),
                ("A204", 12.240),
            )
        ),
    ),
]


def checked(model: Model, folder: Path) -> tuple[str, str, float]:
    """Return V and S as ``rtcal import check`` has them, in words, and its processor time in s."""
    file = folder / model.repository.split("/")[1] / model.path
    options = model.options.split(" ", 1) if model.options else []
    options = [o.strip('"') for o in options]
    before = os.times().children_user
    done = subprocess.run(
        [sys.executable, "-m", "rtcal", "import", "check", str(file), *options, "--json", "-q"],
        capture_output=True,
        text=True,
        check=False,
    )
    taken = os.times().children_user - before
    if done.returncode:
        return "refused", done.stderr.strip().replace(str(folder), ""), taken
    made = json.loads(done.stdout)
    volume, u = made["volume"], made["volume_uncertainty"]
    digits = f"{volume:.3f}" if u < 1e-3 * volume else f"{volume:.1f} ± {u:.1f}"
    return digits, f"{sum(made['areas'].values()):.1f}", taken


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", metavar="PART", help="of the file's name")
    given = parser.parse_args()
    print("| model | options | V / m³ | S / m² | its authors state |\n|---|---|---|---|---|")
    slowest, last = (0.0, ""), ""
    for model in EVERY:
        if given.only not in model.path:
            continue
        volume, area, taken = checked(model, given.folder)
        slowest = max(slowest, (taken, model.path))
        source = f"{model.repository} ({LICENCES[model.repository]}), "
        name = f"{source if source != last else ''}{Path(model.path).name}"
        last = source
        options = f"`{model.options}`" if model.options else ""
        print(f"| {name} | {options} | {volume} | {area} | {model.stated} |", flush=True)
    print(f"\nThe slowest took {slowest[0]:.1f} s of processor: {slowest[1]}")


if __name__ == "__main__":
    main()
