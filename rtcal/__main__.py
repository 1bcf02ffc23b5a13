"""The script ``rtcal`` and ``python -m rtcal``: the command, and what Ctrl-C does to it."""

from __future__ import annotations

import os
import signal

INTERRUPTED = 130


def main() -> None:
    """Load and run the command; exit with 130 where it is interrupted."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    try:
        from rtcal.command.main import main as command

        command()
    except KeyboardInterrupt:
        _end()
    except SystemExit as ended:
        if ended.code == INTERRUPTED:
            _end()
        raise


def _interrupt(*_: object) -> None:
    """End at once.

    An exception that may come anywhere does harm: libraries turn it into others while they load, and
    a lock that was just taken is never let go. Files are whole at any moment, also after a kill, and
    `rtcal.support.files` holds the signal back while it writes.
    """
    _end()


def _end() -> None:
    """End the process now. Python would wait for threads that nobody needs any more."""
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
