"""The `rtcal` command: parse, call, print, exit code."""
