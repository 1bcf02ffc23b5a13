"""What takes time, beside an earlier revision, in turns: python benchmarks/speed.py --old TREE

TREE is a worktree of that revision (``git worktree add ../old 850fa03a``); without one the present code
runs alone. Each row is run ``--times`` times in a process of its own; medians are printed, and all
threads count. On a busy machine only the ratios, of times in one turn, mean something.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parents[1]
Measured = dict[str, float]


def data(name: str) -> Path:
    """Return the path of a shipped file or folder of the revision that runs."""
    import rtcal

    return Path(rtcal.__file__).parent / "datasets" / name


def command(folder: Path, *arguments: str, module: str = "rtcal") -> Measured:
    """Return the time in s by the clock and of the processor of a command, and its memory in GB."""
    began = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-m", module, *arguments], cwd=folder, stdout=subprocess.DEVNULL
    )
    _, status, used = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"{module} {' '.join(arguments)} failed")
    cpu, clock = used.ru_utime + used.ru_stime, time.perf_counter() - began
    return {"clock": clock, "cpu": cpu, "GB": used.ru_maxrss / 2**20}


def spent(call: Callable[[], Any]) -> float:
    """Return the processor time of a call in s."""
    began = time.process_time()
    call()
    return time.process_time() - began


def find_at_positions(folder: Path) -> Measured:
    """Search, page, verification and corrected room of the example, from empty caches."""
    shutil.copytree(data("where_room"), folder / "where")
    files = "room.toml", "pairs.csv"
    # 850fa03a searched anew in each command, as it could not read what was found.
    saves = (data("").parent / "files").is_dir()
    found, effect = (("page",), ("--effect", "curtain")) if saves else (files, ())
    runs = [
        command(folder / "where", *arguments)
        for arguments in (
            ("find", *files),
            ("find", *files, "--out", "page"),
            ("verify", *found),
            ("apply", *found, *effect, "--out", "corrected"),
        )
    ]
    return {
        "find / s": runs[0]["clock"],
        "find / cpu s": runs[0]["cpu"],
        "all four / cpu s": sum(run["cpu"] for run in runs),
        "GB": max(run["GB"] for run in runs),
    }


def find_of_means(folder: Path) -> Measured:
    """Search by means with no compiled function kept."""
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    shutil.copy(data("hidden_room/case.json"), folder)
    return {"cpu s": command(folder, "find", "case.json")["cpu"]}


def find_again(folder: Path) -> Measured:
    """Search a second time in the example with 4 x 4 and 8 x 8 pairs, whose rays are kept."""
    os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
    lines = (data("where_room") / "pairs.csv").read_text().splitlines()
    values = [line.split(",")[2:] for line in lines if line.startswith("S1,R1,")]
    head, _, rest = (data("where_room") / "room.toml").read_text().partition("[sources]")
    out = {}
    for n in (4, 8):
        at = folder / f"pairs{n}"
        at.mkdir()
        shutil.copy(data("where_room") / "room.obj", at)
        placed = f"[sources]\n{_places('S', n, 1.5)}\n[receivers]\n{_places('R', n, 1.2)}\n"
        (at / "room.toml").write_text(head + placed + rest[rest.index("[air]") :])
        # T of the shipped pair, with a ripple of 3 % that differs by pair.
        rows = [
            f"S{i},R{k},{name},{band},{float(t) * (1 + 0.03 * math.sin(7 * i + 3 * k + j)):.4f}"
            for i, k in itertools.product(range(n), repeat=2)
            for j, (name, band, t) in enumerate(values)
        ]
        (at / "pairs.csv").write_text("\n".join([lines[0], *rows]) + "\n")
        command(at, "find", "room.toml", "pairs.csv")
        run = command(at, "find", "room.toml", "pairs.csv")
        out |= {f"{n * n} pairs / s": run["clock"], f"{n * n} pairs / GB": run["GB"]}
    out["exponent"] = math.log(out["64 pairs / s"] / out["16 pairs / s"], 4)
    return out


def _places(letter: str, n: int, height: float) -> str:
    """Return n places in both arms of the L-shaped room, as lines of a room's file."""
    rows = []
    for i in range(n):
        x, y = (1 + 6 * (i + 0.5) / n, 1.0 if letter == "S" else 2.2)[:: 1 if i % 2 else -1]
        rows.append(f"{letter}{i} = [{x:.3f}, {y:.3f}, {height}]")
    return "\n".join(rows)


def large_mesh(folder: Path) -> Measured:
    """Check a box of 99,372 triangles."""
    n, lines, faces = 91, [], []
    for axis, end in itertools.product(range(3), (0, 1)):
        first = len(lines) + 1
        for corner in itertools.product(range(n + 1), repeat=2):
            at = [c / n for c in corner]
            at.insert(axis, end)
            lines.append("v {:.6f} {:.6f} {:.6f}".format(*np.multiply(at, (9, 7, 3))))
        faces.append(f"usemtl wall{axis}{end}")
        for i, k in itertools.product(range(n), repeat=2):
            a = first + i * (n + 1) + k
            b, c, d = a + 1, a + n + 1, a + n + 2
            turned = 1 if (end == 1) == (axis != 1) else -1
            faces += ["f {} {} {}".format(*face[::turned]) for face in ((a, c, d), (a, d, b))]
    (folder / "box.obj").write_text("\n".join([*lines, *faces]) + "\n")
    return {"cpu s": command(folder, "import", "check", "box.obj")["cpu"]}


def calibrate(folder: Path) -> Measured:
    """Calibrate, beside the import of cvxpy alone."""
    files = [str(data("bras_cr2") / name) for name in ("room.toml", "measured.csv")]
    command(folder, "calibrate", *files)  # writes bytecode
    run, plain = command(folder, "calibrate", *files), command(folder, module="cvxpy.settings")
    return {"cpu s": run["cpu"], "over import cvxpy": run["cpu"] / plain["cpu"]}


def printed(_: Path) -> Measured:
    """Print a result of 40 materials in 27 bands, beside its own calibration."""
    from resolve import case

    import rtcal as rt

    rt.calibrate(*case(39, 27, 0, "mle"))
    of = case(40, 27, 0, "mle")
    own, result = spent(lambda: rt.calibrate(*of)), rt.calibrate(*of)
    return {"ms": 1e3 * (said := spent(lambda: str(result))), "over calibrate": said / own}


def smooth(_: Path) -> Measured:
    """Solve smooth problems a second time, beside plain cvxpy."""
    from resolve import Plain, case

    import rtcal as rt

    out = {}
    for n, bands in ((23, 8), (500, 27)):
        of = case(n, bands, 0, "smooth")
        result, plain = rt.calibrate(*of, method="smooth"), Plain("smooth", n, bands)
        at = of[0], result.target, result.target_uncertainty
        plain.solve(*at, "smooth")
        own = spent(lambda: rt.calibrate(*of, method="smooth"))  # noqa: B023
        out[f"{n} x {bands}"] = own / spent(lambda: plain.solve(*at, "smooth"))  # noqa: B023
    return out


def fit(_: Path) -> Measured:
    """Fit a path tracing to every position of three boxes."""
    import rtcal as rt

    out = {}
    for size in ((7, 5, 3), (10, 7, 3.5), (6, 9, 4)):
        rng = np.random.default_rng(round(size[0]))
        walls = ["west", "east", "south", "north", "floor", "ceiling"]
        geometry = rt.simulators.Polyhedron.shoebox(size, {wall: wall for wall in walls})
        alpha = rng.uniform(0.05, 0.35, (6, 1)) * rng.uniform(0.8, 1.2, (6, 6))
        room = rt.Room(
            name="box",
            volume=float(np.prod(size)),
            materials=walls,
            areas=[geometry.areas[wall] for wall in walls],
            alpha=alpha,
            sigma=0.3 * alpha,
            centre_frequencies=[125 * 2**k for k in range(6)],
            air=rt.Air(),
        )
        at = [rng.uniform(0.2, 0.8, 3) * size for _ in range(5)]
        tracer = rt.simulators.PathTracing(
            room=room,
            geometry=geometry,
            sources={f"S{i}": at[i] for i in range(2)},
            receivers={f"R{i}": at[i] for i in range(2, 5)},
            n_paths=1500,
            scattering=0.3,
        )
        measured = tracer.simulate(alpha * rng.uniform(0.7, 1.4, (6, 1)), seed=5)
        out[f"{size} / cpu s"] = spent(lambda: rt.calibrate_positions(tracer, room, measured))  # noqa: B023
    return out


ROWS: dict[str, Callable[[Path], Measured]] = {
    of.__name__: of
    for of in (
        *(find_at_positions, find_again, find_of_means, calibrate),
        *(printed, smooth, large_mesh, fit),
    )
}


def main() -> None:
    """Print a table; with ``--here`` one row as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", default=[*ROWS], help=", ".join(ROWS))
    parser.add_argument("--old", type=Path, help="worktree of an earlier revision")
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.here:
        warnings.simplefilter("ignore")
        with tempfile.TemporaryDirectory() as folder:
            print(json.dumps(ROWS[options.rows[0]](Path(folder))))
        return
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": ""}
    trees = {"old": options.old, "new": HERE} if options.old else {"new": HERE}
    for row in options.rows:
        found: dict[str, list[Measured]] = {name: [] for name in trees}
        for _ in range(options.times):
            for name, tree in trees.items():
                env = {**os.environ, "PYTHONPATH": str(tree.resolve())}
                said = subprocess.check_output(
                    [sys.executable, __file__, "--here", row], env=env, text=True
                )
                found[name].append(json.loads(said))
        for key in found["new"][0]:
            medians = [
                f"{n} {statistics.median(r[key] for r in runs):.3g}" for n, runs in found.items()
            ]
            pairs = zip(found.get("old", ()), found["new"], strict=False)
            if ratios := [new[key] / old[key] for old, new in pairs]:
                medians.append(f"new / old {statistics.median(ratios):.2f}")
            print(f"{row}, {key}: {', '.join(medians)}", flush=True)


if __name__ == "__main__":
    main()
