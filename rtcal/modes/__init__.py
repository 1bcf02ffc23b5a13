"""Room modes below the Schroeder frequency: what their decays say of each wall."""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.modes.measured import MeasuredModes as MeasuredModes
    from rtcal.modes.measured import find_modes as find_modes
    from rtcal.modes.measured import read as read
    from rtcal.modes.room_modes import RoomModes as RoomModes
    from rtcal.modes.room_modes import absorption as absorption
    from rtcal.modes.room_modes import admittance as admittance
    from rtcal.modes.room_modes import modes_of as modes_of
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
