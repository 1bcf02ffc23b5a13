"""The script ``rtcal`` and ``python -m rtcal``. Ctrl-C prints no traceback, also while they load."""

from __future__ import annotations

import os

INTERRUPTED = 130


def main() -> None:
    """Load and run the command; exit with 130 where it is interrupted."""
    try:
        from rtcal.command.main import main as command

        command()
    except KeyboardInterrupt:
        _end()
    except SystemExit as ended:
        if ended.code == INTERRUPTED:
            _end()
        raise


def _end() -> None:
    """End the process now. Python would wait for threads that nobody needs any more.

    All files are whole at any moment (`rtcal.support.transaction`), and errors print unbuffered.
    """
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
