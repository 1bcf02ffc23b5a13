"""The progress bar and the types of what tells progress; only this module imports tqdm."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from rtcal.support.errors import MissingDependencyError
from rtcal.support.text import width

Progress = Callable[[int, int], None]
"""Called with the number of finished steps and their total."""
TaskProgress = Callable[[str, int, int], None]
"""Called with what is computed, the number of finished steps and their total."""

DELAY = 2.0
"""Delay in seconds; shorter tasks show no bar."""


PATIENCE = 10.0
"""Time in seconds after which a step without a bar says once what it does, and how long it may take."""


def bar(count: int, unit: str, wanted: bool, say: Callable[[str], None] | None = None) -> Any:
    """Return a bar of ``count`` steps on standard error, to be entered and ``update(1)``-d.

    It appears after two seconds and says how long the rest will take. Without ``wanted`` there is no
    bar: after ten seconds ``say`` is called once with the same in words, for a log. Raises
    MissingDependencyError if tqdm is not installed.
    """
    if not wanted:
        return _NoBar() if say is None else _Said(count, unit, say)
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


def following(shown: Any) -> Progress:
    """Return what moves a bar to the number of finished steps."""
    last = 0

    def progress(done: int, _: int) -> None:
        nonlocal last
        shown.update(done - last)
        last = done

    return progress


class _Said:
    """Says once, after `PATIENCE`, how many steps are done and how long the others may take.

    If not one is done by then, it says so, and the time when the first is. What follows the last step
    is a step of its own.
    """

    def __init__(self, count: int, unit: str, say: Callable[[str], None]) -> None:
        self.unit, self.say, self.what = unit, say, ""
        self.reset(count)

    def reset(self, total: int) -> None:
        self._stop()
        self.total, self.done, self.asked, self.told = total, 0, False, False
        self.begun = time.monotonic()
        self._wait(self._ask)

    _entered = False
    _timer: threading.Timer | None = None

    def set_description(self, text: str) -> None:
        self.what = f"{text}: "

    def __enter__(self) -> _Said:
        self._entered = True
        self.reset(self.total)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()

    def update(self, steps: int) -> None:
        self.done += steps
        if self.asked and not self.told:
            self._tell()
        if 0 < self.total <= self.done:
            self._stop()
            self._wait(self._rest)

    def _wait(self, then: Callable[[], None]) -> None:
        self._timer = threading.Timer(PATIENCE, then)
        self._timer.daemon = True
        if self._entered:
            self._timer.start()

    def _rest(self) -> None:
        self.say(f"{self.what}what follows the {self.unit}s takes more than {PATIENCE:g} s")

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _ask(self) -> None:
        self.asked = True
        if self.done:
            self._tell()
            return
        of_all = f" of {self.total}" if self.total > 1 else ""
        first = "" if self.total == 1 else "first "
        self.say(f"{self.what}the {first}{self.unit}{of_all} takes more than {PATIENCE:g} s")

    def _tell(self) -> None:
        self.told = True
        passed = time.monotonic() - self.begun
        if not self.done < self.total:
            return
        left = passed / self.done * (self.total - self.done)
        self.say(
            f"{self.what}{self.done} of {self.total} {self.unit}s in {_duration(passed)}, about "
            f"{_duration(left)} left"
        )


def _duration(seconds: float) -> str:
    """Return a duration in s, min or h.

    Examples
    --------
    >>> _duration(12.3), _duration(150), _duration(9000)
    ('12 s', '2.5 min', '2.5 h')
    """
    for unit, length in (("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.0f} s"


class _NoBar:
    def __enter__(self) -> _NoBar:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def update(self, _: int) -> None:
        pass
