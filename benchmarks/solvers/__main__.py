"""`python -m benchmarks.solvers run --short|--full`, then `python -m benchmarks.solvers render`."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.solvers import render, run

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(__file__).parent / "results"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command", choices=["run", "render"])
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--short", dest="size", action="store_const", const="short")
    size.add_argument("--full", dest="size", action="store_const", const="full")
    parser.set_defaults(size="full")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    given = parser.parse_args()
    if given.command == "run":
        rows = run.run(given.folder, given.size)
        run.finish(given.folder, given.size)
        print(f"{len(rows)} solves in {given.folder / given.size}.csv.gz")
    else:
        render.page(given.folder, given.size, ROOT / "benchmarks" / "solvers")


if __name__ == "__main__":
    main()
