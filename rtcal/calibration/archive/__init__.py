"""An archive of calibrated rooms, and the materials that they share."""

from typing import TYPE_CHECKING

from rtcal.support import lazy

if TYPE_CHECKING:
    from rtcal.calibration.archive.library import Archive as Archive
    from rtcal.calibration.archive.library import Lesson as Lesson
    from rtcal.calibration.archive.library import Suspect as Suspect
    from rtcal.calibration.archive.likelihood import Spread as Spread
    from rtcal.calibration.archive.rooms import read_folder as read_folder
else:
    __getattr__, __dir__, __all__ = lazy.exports(__name__, __file__)
