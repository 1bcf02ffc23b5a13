"""The size of the package, and what its three main paths enter. It prints, and never fails.

    python -m benchmarks.house              # half a minute
    python -m benchmarks.house --modules    # imports and lines of each module too

Code is without docstrings, comments and blank lines. A path is traced on its second call, imports
excluded: a file is entered where a function of it runs, a form of the data is a class of which the call
makes an object. Exported names are those that a user reaches below `rtcal` by attribute.
"""

from __future__ import annotations

import argparse
import ast
import io
import sys
import tokenize
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any

import numpy as np

import rtcal as rt

ROOT = Path(rt.__file__).parent.parent
GROUPS = {"rtcal": ROOT / "rtcal", "tests": ROOT / "tests", "benchmarks": ROOT / "benchmarks"}
_NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)


def docstrings(tree: ast.Module) -> set[int]:
    """Lines of docstrings, of a module, its classes and functions."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and node.body:
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                lines.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return lines


class Module:
    """A file of Python: its lines, its code and what it defines and imports."""

    def __init__(self, path: Path) -> None:
        self.path, self.text = path, path.read_text(encoding="utf-8")
        self.tree = ast.parse(self.text)
        self.lines = len(self.text.splitlines())
        # Lines that hold a token, other than a comment, outside docstrings.
        held: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(self.text).readline):
            if token.type not in _NO_CODE:
                held.update(range(token.start[0], token.end[0] + 1))
        self.code = len(held - docstrings(self.tree))
        # Names that are imported from the package itself, anywhere in the file.
        self.imports = sum(
            len(node.names)
            for node in ast.walk(self.tree)
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rtcal")
        )

    def number(self, kind: type[ast.AST]) -> int:
        """Nodes of a kind."""
        return sum(isinstance(node, kind) for node in ast.walk(self.tree))


def exported() -> tuple[int, int]:
    """Return how many names a user reaches below `rtcal` by attribute, and how many are modules."""
    modules: list[ModuleType] = [rt]
    names = 0
    for module in modules:
        for name in module.__all__:
            value = getattr(module, name)
            if not isinstance(value, ModuleType):
                names += 1
            elif value not in modules:
                modules.append(value)
    return names, len(modules) - 1


@dataclass
class Trace:
    """What a call enters: files and functions of the package, calls of them, classes made."""

    files: set[str] = field(default_factory=set)
    functions: set[Any] = field(default_factory=set)
    made: set[type] = field(default_factory=set)
    crossings: set[tuple[str, str]] = field(default_factory=set)
    calls: int = 0

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        if event != "call":
            return
        code = frame.f_code
        if code.co_name == "__init__":
            kind = type(next(iter(frame.f_locals.values()), None))
            if kind.__module__.startswith("rtcal."):
                self.made.add(kind)
        if not code.co_filename.startswith(str(GROUPS["rtcal"])):
            return
        self.files.add(code.co_filename)
        self.functions.add(code)
        self.calls += 1
        before = frame.f_back.f_code.co_filename if frame.f_back else ""
        if before.startswith(str(GROUPS["rtcal"])) and before != code.co_filename:
            self.crossings.add((before, code.co_filename))

    @classmethod
    def of(cls, call: Callable[[], Any]) -> Trace:
        """Trace the second call."""
        call()
        trace = cls()
        sys.setprofile(trace)
        try:
            call()
        finally:
            sys.setprofile(None)
        return trace


def paths() -> dict[str, Callable[[], Any]]:
    """The three main paths, as a user calls them."""
    room, measured = rt.datasets.bras_cr2()
    case, _ = rt.datasets.hidden_room()
    sides = (7.0, 5.0, 3.0)
    walls = dict.fromkeys(("west", "east", "south", "north"), "plaster")
    box = rt.simulators.Polyhedron.shoebox(sides, {**walls, "floor": "carpet", "ceiling": "tiles"})
    hall = rt.Room.from_geometry(
        box,
        name="room",
        centre_frequencies=[250, 500, 1000],
        materials=[
            rt.Material(n, [a] * 3, [0.05] * 3, scattering=[0.2] * 3)
            for n, a in (("plaster", 0.08), ("carpet", 0.2), ("tiles", 0.5))
        ],
        air=rt.Air(20, 50),
    )
    tracer = rt.simulators.PathTracing(
        geometry=box,
        room=hall,
        sources={"S1": (1.5, 1.2, 1.5)},
        receivers={"R1": (5.5, 3.5, 1.2), "R2": (3.0, 4.0, 1.2), "R3": (5.0, 1.5, 1.2)},
        n_paths=1000,
    )
    heard = tracer.simulate(np.clip(1.3 * hall.alpha, 0, 1), seed=7)
    return {
        "rt.calibrate": lambda: rt.calibrate(room, measured),
        "rt.find, on means": lambda: rt.find(case),
        "rt.calibrate_positions": lambda: rt.calibrate_positions(tracer, hall, heard),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--modules", action="store_true", help="each module of the package too")
    given = parser.parse_args()
    warnings.simplefilter("ignore")

    groups = {
        name: [Module(path) for path in sorted(folder.rglob("*.py"))]
        for name, folder in GROUPS.items()
    }
    print(f"{'':<12} {'lines':>7} {'code':>7} {'modules':>7} {'classes':>7} {'functions':>9}")
    for name, modules in groups.items():
        lines, code = sum(m.lines for m in modules), sum(m.code for m in modules)
        kinds = [sum(m.number(k) for m in modules) for k in (ast.ClassDef, ast.FunctionDef)]
        print(f"{name:<12} {lines:7} {code:7} {len(modules):7} {kinds[0]:7} {kinds[1]:9}")
    own = groups["rtcal"]
    folders: dict[str, list[Module]] = {}
    for m in own:
        folders.setdefault(m.path.relative_to(GROUPS["rtcal"]).parts[0], []).append(m)
    for folder, inside in sorted(folders.items()):
        print(f"  {folder:<14} {sum(m.lines for m in inside):7} lines, {len(inside):3} modules")

    imports = sorted(m.imports for m in own)
    names, packages = exported()
    print(f"\nexported: {names} names in {packages} modules")
    print(
        f"imports of the package per module: median {imports[len(imports) // 2]}, "
        f"mean {np.mean(imports):.1f}, most {imports[-1]}"
    )

    print(f"\n{'second call of':<24} {'files':>5} {'functions':>9} {'calls':>8} pairs  forms")
    for name, call in paths().items():
        trace = Trace.of(call)
        print(
            f"{name:<24} {len(trace.files):5} {len(trace.functions):9} {trace.calls:8} "
            f"{len(trace.crossings):5}  {len(trace.made):5}"
        )
        if given.modules:
            for file in sorted(trace.files):
                print(f"    {Path(file).relative_to(ROOT)}")
            print("    forms:", ", ".join(sorted(kind.__name__ for kind in trace.made)))
    if given.modules:
        print("\nmodule: lines, code, imports")
        for m in sorted(own, key=lambda m: -m.lines):
            print(f"{m.lines:6} {m.code:6} {m.imports:4}  {m.path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
