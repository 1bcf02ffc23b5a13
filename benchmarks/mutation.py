"""How many deliberate faults do the tests see? `make mutate`, or `python benchmarks/mutation.py [N]`.

mutmut makes some 8,000 mutants of the modules that decide an answer (see ``[tool.mutmut]`` in
pyproject.toml). A fixed sample of them is run: the N names (300 if not given) with the smallest
SHA-256. Every mutant that no test kills is listed. `SURVIVORS` has the reason for those that may
survive: an equivalent mutant, or one that changes only how quickly an answer is found.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

MUTMUT = Path(sys.executable).with_name("mutmut")
ANY = "rtcal.loop.rules.x_secant__mutmut_1"  # any one mutant: mutmut makes all before it runs it
SURVIVORS: dict[str, str] = {}
"""Mutants that survive, and why that is right."""


def run(*names: str) -> None:
    subprocess.run([MUTMUT, "run", *names], check=True, stdout=subprocess.DEVNULL)


def outcomes() -> dict[str, int | None]:
    """Return the exit code of each mutant's tests, by name; None where they were not run."""
    merged: dict[str, int | None] = {}
    for path in sorted(Path("mutants").rglob("*.meta")):
        merged |= json.loads(path.read_text(encoding="utf-8"))["exit_code_by_key"]
    return merged


def main() -> None:
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    run(ANY)
    every = sorted(outcomes(), key=lambda name: hashlib.sha256(name.encode()).digest())
    sample = every[:wanted]
    run(*sample)
    codes = outcomes()
    survived = sorted(name for name in sample if codes[name] in (0, 33))  # 33: no test reaches it
    for name in survived:
        print(f"\n{name}: {SURVIVORS.get(name, 'no reason stated')}")
        shown = subprocess.run([MUTMUT, "show", name], capture_output=True, text=True, check=True)
        print("\n".join(x for x in shown.stdout.splitlines() if x.startswith(("-", "+"))))
    killed = len(sample) - len(survived)
    print(f"\n{killed} of {len(sample)} mutants killed ({100 * killed / len(sample):.0f} %)")


if __name__ == "__main__":
    main()
