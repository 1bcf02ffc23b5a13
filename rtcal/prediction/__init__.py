"""Prediction of T after a change of the room, and design of the change that meets a target."""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.acoustics.changes import Change as Change
    from rtcal.acoustics.changes import Target as Target
    from rtcal.acoustics.changes import Treatment as Treatment
    from rtcal.acoustics.changes import Variant as Variant
    from rtcal.acoustics.changes import ansi_s12_60 as ansi_s12_60
    from rtcal.acoustics.changes import changed as changed
    from rtcal.acoustics.changes import din_18041 as din_18041
    from rtcal.acoustics.room_errors import Assumptions as Assumptions
    from rtcal.prediction.predicted import predict as predict
    from rtcal.prediction.predicted import predict_variants as predict_variants
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
