"""Feed broken files to every reader: `python benchmarks/fuzz_files.py [EXAMPLES]` (10,000 if not said).

Prints how many files each reader took and refused; any other exception, a hang or a refusal that
does not name the file ends the run with that file.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hypothesis import HealthCheck, Phase, given, settings

from tests import fuzz


def main(examples: int) -> None:
    counts: Counter[tuple[str, bool]] = Counter()
    with tempfile.TemporaryDirectory() as folder:

        @settings(
            max_examples=examples,
            deadline=None,
            database=None,
            derandomize=True,
            phases=(Phase.generate, Phase.shrink),
            suppress_health_check=list(HealthCheck),
        )
        @given(fuzz.broken())
        def run(case: tuple[str, bytes]) -> None:
            counts[case[0], fuzz.check(*case, Path(folder))] += 1

        run()
    print(f"{'reader':16} {'read':>6} {'refused':>8}")
    for name in sorted(fuzz.READERS):
        print(f"{name:16} {counts[name, True]:6} {counts[name, False]:8}")
    print(f"{'all':16} {sum(counts.values()):15}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
