"""Shares, and statistics over rooms, with their 95 % intervals; tables in Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from rtcal.finder.records import Share

SEED, DRAWS = 20261122, 4000
Line = tuple[float, float, float, int]
"""A figure, its 95 % interval, and the number of rooms that it is over; NaN of no rooms."""


def share(hits: Iterable[Any]) -> Line:
    """Return a share with its interval (Clopper and Pearson 1934)."""
    table = [bool(h) for h in hits]
    k, n = sum(table), len(table)
    return (k / n, *Share(k, n).interval, n) if n else (np.nan, np.nan, np.nan, 0)


def rate(hits: Iterable[Any]) -> str:
    """Return a share with its interval in words."""
    value, low, high, n = share(hits)
    return f"{value:.3f} [{low:.3f}, {high:.3f}] of {n}" if n else "none"


def over(statistic: Callable[..., Any], *columns: Iterable[Any]) -> Line:
    """Return a statistic of the rooms' values, a column or more, with its bootstrap interval."""
    values = [np.array([v for v in column if v is not None], dtype=float) for column in columns]
    n, rng = len(values[0]), np.random.default_rng(SEED)
    if not n:
        return np.nan, np.nan, np.nan, 0
    drawn = []
    for _ in range(DRAWS):
        i = rng.integers(n, size=n)
        drawn.append(statistic(*(v[i] for v in values)))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(statistic(*values)), float(low), float(high), n


def markdown(head: Iterable[object], *lines: Iterable[object]) -> str:
    """Return a table in Markdown."""
    names = [*head]
    rule = ["---"] * len(names)
    cells = ([f" {cell} " if cell != "" else " " for cell in line] for line in (names, *lines))
    first, *rest = (f"|{'|'.join(row)}|" for row in cells)
    return "\n".join([first, f"|{'|'.join(rule)}|", *rest])
