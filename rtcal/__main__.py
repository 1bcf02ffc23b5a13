"""The script ``rtcal`` and ``python -m rtcal``: the command, and what Ctrl-C does to it."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress

INTERRUPTED = 130
_ERRORS = 2  # POSIX's number of the stream
_LAST = 3  # files that are named


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
    `rtcal.files.disk` holds the signal back while it writes.
    """
    _end()


def _end() -> None:
    """Say so, and end the process now. Python would wait for threads that nobody needs any more."""
    # Nothing is imported here: the interrupt may have come while a library loads.
    begun = getattr(sys.modules.get("rtcal.files.disk"), "begun", ())
    last = ", ".join(path.name for path in begun[-_LAST:])
    what = f"written last, or begun: {last}" if begun else "nothing was written"
    said = "".join(c if c.isprintable() else "?" for c in f"rtcal: interrupted; {what}")
    with suppress(OSError):
        os.write(_ERRORS, f"{said}\n".encode(errors="backslashreplace"))
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
