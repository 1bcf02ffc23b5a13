"""Error of the exact posterior against quadrature on random bands, and its worst case.

`python benchmarks/studies/calibrations/posterior_accuracy.py [--bands 1000] [--first 0]`. It takes
0.1 s per band. It fails where a standard deviation or a 90 % width is wrong by more than 0.5 %, or
a correlation by more than 0.005.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

from tests.quadrature import errors, random_band

LIMITS = {"standard deviation": 0.005, "width of 90 %": 0.005, "correlation": 0.005}


def main() -> int:
    """Print the distribution of the errors and the band that has the worst one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bands", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    seeds = np.arange(options.first, options.first + options.bands)
    rows, sizes, exact = [], [], 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        band = random_band(rng)
        rows.append(errors(band, rng))
        sizes.append(len(band.mu))
        exact += band.noise == 0
    table = np.array(rows)
    print(f"{len(seeds)} bands of {min(sizes)} to {max(sizes)} materials, {exact} with u_b = 0")
    print(f"posterior / prior from {table[:, 0].min():.1e} to {table[:, 0].max():.2f}")
    failed = False
    for (name, limit), error in zip(LIMITS.items(), table[:, 1:].T, strict=True):
        worst = int(np.argmax(error))
        print(
            f"{name:20s} median {np.median(error):.1e}, 99 % {np.quantile(error, 0.99):.1e}, "
            f"worst {error[worst]:.1e} (seed {seeds[worst]}, {sizes[worst]} materials, posterior / "
            f"prior {table[worst, 0]:.1e})"
        )
        failed |= not error[worst] <= limit
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
