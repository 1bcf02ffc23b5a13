"""Damaged copies of a file, the same at each run."""

from __future__ import annotations

import random
from collections.abc import Iterator


def damages(content: bytes, number: int) -> Iterator[bytes]:
    """Yield copies with a few bytes changed, left out or added, or cut off."""
    rng = random.Random(len(content))
    for _ in range(number):
        damaged = bytearray(content)
        for _ in range(rng.randint(1, 6)):
            at, kind = rng.randrange(len(damaged)), rng.random()
            if kind < 0.5:
                damaged[at] = rng.randrange(256)
            elif kind < 0.7:
                del damaged[at : at + rng.randint(1, 40)]
            elif kind < 0.9:
                damaged[at:at] = rng.randbytes(rng.randint(1, 8))
            else:
                del damaged[max(at, 4) :]
            damaged = damaged or bytearray(b"x")
        yield bytes(damaged)
