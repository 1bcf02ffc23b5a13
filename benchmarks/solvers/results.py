"""The table of results: appended while it runs, so that a run that was stopped goes on."""

from __future__ import annotations

import csv
import datetime
import gzip
import importlib.metadata
import io
import json
import os
import platform
from collections.abc import Iterable
from dataclasses import asdict, fields
from pathlib import Path

from benchmarks.solvers.cases import RANDOM, Rooms
from benchmarks.solvers.measure import Row, iterations, judge, throughput, timed
from benchmarks.solvers.routes import Route, available, fits, settings_of
from rtcal.files.disk import write_bytes, write_text

COLUMNS = [f.name for f in fields(Row)]
PACKAGES = (
    "rtcal",
    "numpy",
    "scipy",
    "cvxpy",
    "clarabel",
    "osqp",
    "qpsolvers",
    "qpbenchmark",
    "highspy",
    "daqp",
    "piqp",
    "proxsuite",
    "scs",
    "quadprog",
    "numba",
)
TOO_SLOW = 1.0  # s: a route that took longer is not given larger problems of that family


def machine() -> dict[str, object]:
    """Return what a time depends on: processor, cores, versions, date; no names."""
    model = platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            x.split(":", 1)[1].strip()
            for x in info.read_text().splitlines()
            if x.startswith("model name")
        ]
        model = names[0] if names else model
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "processor": model,
        "cores": os.cpu_count(),
        "system": platform.system(),
        "versions": versions,
    }


def read(path: Path) -> list[Row]:
    """Read the rows of a table, plain or compressed; a last line that was cut off is left out."""
    if not path.exists():
        return []
    raw = path.read_bytes()
    text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode()
    whole = text[: text.rfind("\n") + 1]
    return [_row(given) for given in csv.DictReader(io.StringIO(whole))]


def _row(given: dict[str, str]) -> Row:
    kinds = {"int": int, "float": float, "str": str, "bool": lambda v: v == "True"}
    return Row(**{f.name: kinds[str(f.type)](given[f.name]) for f in fields(Row)})  # type: ignore[arg-type]


def _line(row: Row) -> list[object]:
    return [f"{v:.3g}" if isinstance(v, float) else v for v in asdict(row).values()]


def run(folder: Path, size: str, routes: dict[str, Route] | None = None) -> list[Row]:
    """Run what is not yet in ``folder``'s table, and return all rows."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{size}.csv"
    rows = read(path)
    done = {(r.problem, r.route, r.settings) for r in rows}
    slow = {_kind(r) for r in rows if r.microseconds > 1e6 * TOO_SLOW}
    # Rewritten whole first: a line that was cut off goes.
    write_text(path, _text(rows))
    test_set = Rooms(size)
    chosen = available() if routes is None else routes
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        for case in test_set:
            for name, route in chosen.items():
                if not fits(name, case):
                    continue
                for setting in settings_of(name):
                    key = (case.family, case.name.split()[0], name, setting)
                    if (case.name, name, setting) in done or key in slow:
                        continue
                    found = timed(route, case, test_set.solver_settings[setting], setting)
                    row = judge(case, name, setting, found, test_set.tolerances[setting])
                    if found.seconds > TOO_SLOW:
                        slow.add(key)
                    writer.writerow(_line(row))
                    rows.append(row)
            file.flush()
    return rows


def _kind(row: Row) -> tuple[str, str, str, str]:
    return row.family, row.problem.split()[0], row.route, row.settings


def _text(rows: Iterable[Row]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(_line(row) for row in rows)
    return out.getvalue()


def finish(folder: Path, size: str) -> None:
    """Measure iterations and throughput, and write the table compressed with the machine beside it."""
    rows = read(folder / f"{size}.csv")
    count = 3 if size == "short" else RANDOM
    also = {
        "run": size,
        **machine(),
        "left_out": Rooms(size).left_out,
        "iterations": [asdict(c) for c in iterations(count)],
        "throughput": throughput(),
    }
    write_text(folder / f"{size}.json", json.dumps(also) + "\n")
    write_bytes(folder / f"{size}.csv.gz", gzip.compress(_text(rows).encode(), mtime=0))
