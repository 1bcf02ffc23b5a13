"""The script ``rtcal`` and ``python -m rtcal``. Ctrl-C prints no traceback, also while they load."""

from __future__ import annotations

import sys


def main() -> None:
    """Load and run the command; exit with 130 where it is interrupted."""
    try:
        from rtcal.command.main import main as command

        command()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
