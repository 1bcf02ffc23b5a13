"""``python -m rtcal``: the command `rtcal`."""

from rtcal.command.main import main

main()
