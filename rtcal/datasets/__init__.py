"""Rooms that ship with rtcal, invented halls, and a catalogue of absorption coefficients."""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.datasets import catalogue as catalogue
    from rtcal.datasets import examples as examples
    from rtcal.datasets import halls as halls
    from rtcal.datasets.examples import bras_cr2 as bras_cr2
    from rtcal.datasets.examples import hidden_room as hidden_room
    from rtcal.datasets.examples import path as path
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
