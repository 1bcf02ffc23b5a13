"""The progress bar and the types of what tells progress; only this module imports tqdm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rtcal.errors import MissingDependencyError
from rtcal.support.text import width

Progress = Callable[[int, int], None]
"""Called with the number of finished steps and their total."""
TaskProgress = Callable[[str, int, int], None]
"""Called with what is computed, the number of finished steps and their total."""

DELAY = 2.0
"""Delay in seconds; shorter tasks show no bar."""


def bar(count: int, unit: str, wanted: bool) -> Any:
    """Return a bar of ``count`` steps on standard error, to be entered and ``update(1)``-d.

    It appears after two seconds and says how long the rest will take. Without ``wanted`` it does
    nothing. Raises MissingDependencyError if tqdm is not installed.
    """
    if not wanted:
        return _NoBar()
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise MissingDependencyError(
            "the progress bar needs tqdm: pip install 'rtcal[studies]'"
        ) from error
    return tqdm(
        total=count,
        unit=unit,
        smoothing=0.05,
        delay=DELAY,
        ncols=width(),
        bar_format="{desc}{n_fmt}/{total_fmt} {unit}s |{bar}| {elapsed} passed, about {remaining} left",
    )


class _NoBar:
    def __enter__(self) -> _NoBar:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def update(self, _: int) -> None:
        pass
