"""The `rtcal` command: each module parses the arguments, calls the package and prints."""
