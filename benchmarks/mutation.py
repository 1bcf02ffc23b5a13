"""The share of faults that the tests see: `make mutate`, or `benchmarks/mutation.py [N] [SEED]`.

mutmut makes some 9,600 mutants of the modules that decide an answer (see ``[tool.mutmut]`` in
pyproject.toml). A fixed sample of them is run: the N names (300 if not given) with the smallest
SHA-256. A seed, any word, is put before each name and draws another sample. A name is a function and
a number within it. A change of one function therefore leaves the sample of all others as it is. A
mutant that only rewords a message is not drawn: it changes nothing but the letters of a string
literal that has a space in it and is not compared with anything.

A mutant is killed if a test fails, the tests crash or take 5 times as long. It is tried by the tests
that reach it, the quickest first, and only by those of at most `LONGEST` seconds. Every other mutant
of the sample is listed. `SURVIVORS` has the reason for those that may survive: an equivalent mutant,
or one that changes only how quickly an answer is found.

Making the mutants takes 105 s of one core. Then all selected tests run once, and after them every
mutant of the sample. The run may be stopped and started again: what was killed stays killed until its
function changes. `make clean` forgets it.
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
ANY = "rtcal.loop.closed.x_secant__mutmut_1"  # any one mutant: mutmut makes all before it runs it
LONGEST = 3.0  # s; a survivor costs the time of all tests that reach it
STATS = Path("mutants/mutmut-stats.json")
SURVIVED = {
    0: "survived", 2: "interrupted", 33: "no test reaches it", None: "not run", 34: "skipped",
}  # fmt: skip
SURVIVORS: dict[tuple[str, str], str] = {
    (
        "rtcal.calibration.archive.x__named",
        "+ for room, of_room in zip((each.room for each in rooms), columns, strict=False):",
    ): "equivalent: each room has one row of names, and one of columns",
    (
        "rtcal.calibration.qp.x_closed_form",
        "+ own[program.compiled.places] = True",
    ): "the polish leads from any active set to the same optimum: more rounds, same answer",
    (
        "rtcal.calibration.problem.x_fit",
        "+ for share in (*0.5 ** np.arange(_HALVINGS + 2.0), 0.0):",
    ): "a seventh halving is tried before the start is returned",
    (
        "rtcal.calibration.qp.xǁCompiledProblemǁ__init__",
        "+ numbered = np.arange(n, )",
    ): "equivalent: cvxpy makes floats of them",
    (
        "rtcal.finder.means.problem.x_evaluate",
        "+ for stated, off, unknown in zip(*parts, strict=False)",
    ): "equivalent: the parts have one length",
    (
        "rtcal.loop.closed.xǁLoopǁblocks",
        '+ Row("simulated / s", last, ".3F"),',
    ): "equivalent for numbers that are finite",
}
"""Mutants that survive, by function and last changed line, and why that is right."""


class WithoutWording(ast.NodeTransformer):
    """Replaces every string literal that has a space in it by an empty one, unless it is compared."""

    def visit_Compare(self, node: ast.Compare) -> ast.Compare:
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        message = isinstance(node.value, str) and " " in node.value
        return ast.Constant("") if message else node


def run(*names: str) -> None:
    subprocess.run([MUTMUT, "run", *names], check=True, stdout=subprocess.DEVNULL)


def leave_out_long_tests() -> None:
    """Take the tests that are longer than `LONGEST` from every function that has a shorter one."""
    stats = json.loads(STATS.read_text(encoding="utf-8"))
    seconds = stats["duration_by_test"]
    for tests in stats["tests_by_mangled_function_name"].values():
        limit = max(LONGEST, min((seconds[test] for test in tests), default=0.0))
        # pytest does not find a test by a name that has a backslash in it.
        tests[:] = [test for test in tests if seconds[test] <= limit and "\\" not in test]
    STATS.write_text(json.dumps(stats), encoding="utf-8")


def changes(name: str) -> list[str]:
    """Return the lines that a mutant removes and adds, each after its sign."""
    shown = subprocess.run([MUTMUT, "show", name], capture_output=True, text=True, check=True)
    lines = [x for x in shown.stdout.splitlines() if x.startswith(("-", "+"))]
    return [x[0] + " " + x[1:].strip() for x in lines if not x.startswith(("---", "+++"))]


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
    seed = sys.argv[2] if len(sys.argv) > 2 else ""
    run(ANY)
    leave_out_long_tests()
    drawn = outcomes().keys() - rewordings()
    by_digest = sorted(drawn, key=lambda name: hashlib.sha256((seed + name).encode()).digest())
    sample = by_digest[:wanted]
    codes = outcomes()
    left = [name for name in sample if codes[name] in SURVIVED]
    if left:
        run(*left)
    codes = outcomes()
    survived = sorted(name for name in sample if codes[name] in SURVIVED)
    for name in survived:
        lines = changes(name)
        reason = SURVIVORS.get((name.partition("__mutmut_")[0], lines[-1]), "no reason stated")
        print(f"\n{name}, {SURVIVED[codes[name]]}: {reason}", *lines, sep="\n")
    killed = len(sample) - len(survived)
    print("\nexit codes:", dict(Counter(codes[name] for name in sample)))
    print(f"{killed} of {len(sample)} mutants killed ({100 * killed / len(sample):.0f} %)")


if __name__ == "__main__":
    main()
