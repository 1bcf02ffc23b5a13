"""Words that several sentences share: sizes, lists of names, odds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.support.types import Array

NATS = "2.3 nats are odds of ten to one"
_ALIKE = 1.25
"""Ratio of the upper and the lower bands, below which these are alike."""


def amount(value: float, unit: str, interval: tuple[float, float] | None = None) -> str:
    """Return a size with its unit and its 90 % interval; a ratio as so many times.

    >>> amount(2.0, "of the stated area"), amount(12.3, "m²", (8.0, 17.0))
    ('2 times the stated area', '12.3 m² (90 %: 8 to 17)')
    >>> amount(0.875, "of its area covered", (0.47, 1.0))
    '0.875 of its area covered (90 %: 0.47 to 1)'
    """
    times = unit.replace("of the stated ", "times the stated ")
    ends = "" if interval is None else f" (90 %: {interval[0]:.3g} to {interval[1]:.3g})"
    return f"{value:.3g} {times}{ends}"


def engine_title(name: str) -> str:
    """Return what an engine is called in a sentence.

    >>> engine_title("network"), engine_title("path tracing")
    ('scattering delay network', 'path tracing')
    """
    return "scattering delay network" if name == "network" else name


def over_frequency(values: Array) -> str:
    """Return how the size of values (n_bands,) goes with frequency.

    >>> over_frequency(np.array([1.0, 2.0])), over_frequency(np.array([-2.0, -2.2]))
    ('rising with frequency', 'alike at all frequencies')
    """
    half, size = max(1, len(values) // 2), np.abs(values)
    low, high = size[:half].mean(), size[-half:].mean()
    if max(low, high) < _ALIKE * min(low, high):
        return "alike at all frequencies"
    return f"{'rising' if high > low else 'falling'} with frequency"


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return names as a sentence lists them: a, b and c.

    >>> listed(["a", "b", "c"]), listed(["a", "b"], last="or")
    ('a, b and c', 'a or b')
    """
    return f" {last} ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def as_sentence(words: str) -> str:
    """Return words as a sentence of its own.

    >>> as_sentence("the coefficients are off together")
    'The coefficients are off together.'
    """
    return words[:1].upper() + words[1:].rstrip(".") + "."
