"""How many deliberate faults do the tests see? `make mutate`, or `python benchmarks/mutation.py [N]`.

mutmut makes some 8,000 mutants of the modules that decide an answer (see ``[tool.mutmut]`` in
pyproject.toml). A fixed sample of them is run: the N names (300 if not given) with the smallest
SHA-256. A mutant that only rewords a message is not drawn: it changes nothing but the letters of a
string literal that has a space in it and is not compared with anything.

A mutant is killed if a test fails, the tests crash or take 15 times as long. Every other mutant of
the sample is listed. `SURVIVORS` has the reason for those that may survive: an equivalent mutant,
or one that changes only how quickly an answer is found.
"""

from __future__ import annotations

import ast
import hashlib
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

MUTMUT = Path(sys.executable).with_name("mutmut")
ANY = "rtcal.loop.rules.x_secant__mutmut_1"  # any one mutant: mutmut makes all before it runs it
SURVIVED = {0: "survived", 33: "no test reaches it", None: "not run", 34: "skipped"}
SURVIVORS: dict[str, str] = {}
"""Mutants that survive, and why that is right."""


class WithoutWording(ast.NodeTransformer):
    """Replaces every string literal that has a space in it by an empty one, unless it is compared."""

    def visit_Compare(self, node: ast.Compare) -> ast.Compare:
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        message = isinstance(node.value, str) and " " in node.value
        return ast.Constant("") if message else node


def run(*names: str) -> None:
    subprocess.run([MUTMUT, "run", *names], check=True, stdout=subprocess.DEVNULL)


def outcomes() -> dict[str, int | None]:
    """Return the exit code of each mutant's tests, by name; None where they were not run."""
    merged: dict[str, int | None] = {}
    for path in sorted(Path("mutants").rglob("*.meta")):
        merged |= json.loads(path.read_text(encoding="utf-8"))["exit_code_by_key"]
    return merged


def rewordings() -> set[str]:
    """Return the mutants that differ from the original only in a message."""
    names = set()
    for meta in sorted(Path("mutants").rglob("*.meta")):
        path = meta.with_suffix("")
        module = ".".join(path.relative_to("mutants").with_suffix("").parts)
        tree = WithoutWording().visit(ast.parse(path.read_text(encoding="utf-8")))
        bodies = {
            node.name: ast.dump(node.args) + ast.dump(ast.Module(node.body, []))
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef) and "__mutmut_" in node.name
        }
        for name, body in bodies.items():
            original = name.rpartition("__mutmut_")[0] + "__mutmut_orig"
            if name != original and body == bodies[original]:
                names.add(f"{module}.{name}")
    return names


def main() -> None:
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    run(ANY)
    drawn = outcomes().keys() - rewordings()
    sample = sorted(drawn, key=lambda name: hashlib.sha256(name.encode()).digest())[:wanted]
    run(*sample)
    codes = outcomes()
    survived = sorted(name for name in sample if codes[name] in SURVIVED)
    for name in survived:
        reason = SURVIVORS.get(name, "no reason stated")
        print(f"\n{name}, {SURVIVED[codes[name]]}: {reason}")
        shown = subprocess.run([MUTMUT, "show", name], capture_output=True, text=True, check=True)
        print("\n".join(x for x in shown.stdout.splitlines() if x.startswith(("-", "+"))))
    killed = len(sample) - len(survived)
    print("\nexit codes:", dict(Counter(codes[name] for name in sample)))
    print(f"{killed} of {len(sample)} mutants killed ({100 * killed / len(sample):.0f} %)")


if __name__ == "__main__":
    main()
