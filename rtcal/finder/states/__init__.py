"""Two states of one room: what changed between two measurements at the same positions."""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.finder.states.case import StatesCase as StatesCase
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
