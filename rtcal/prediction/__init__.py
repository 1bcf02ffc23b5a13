"""Prediction of T after a change of the room, and design of the change that meets a target."""

from typing import TYPE_CHECKING

from rtcal.support import lazy

if TYPE_CHECKING:
    from rtcal.prediction.assumptions import Assumptions as Assumptions
    from rtcal.prediction.changes import Add as Add
    from rtcal.prediction.changes import Climate as Climate
    from rtcal.prediction.changes import Cover as Cover
    from rtcal.prediction.changes import NewVolume as NewVolume
    from rtcal.prediction.changes import Open as Open
    from rtcal.prediction.changes import Remove as Remove
    from rtcal.prediction.changes import changed as changed
    from rtcal.prediction.compared import Predictions as Predictions
    from rtcal.prediction.compared import compare as compare
    from rtcal.prediction.designed import Design as Design
    from rtcal.prediction.designed import Known as Known
    from rtcal.prediction.designed import design as design
    from rtcal.prediction.estimate import State as State
    from rtcal.prediction.predicted import Prediction as Prediction
    from rtcal.prediction.predicted import predict as predict
    from rtcal.prediction.targets import Target as Target
    from rtcal.prediction.targets import ansi_s12_60 as ansi_s12_60
    from rtcal.prediction.targets import din_18041 as din_18041
    from rtcal.prediction.treatments import Treatment as Treatment
    from rtcal.prediction.treatments import read_treatments as read_treatments
    from rtcal.prediction.variants import Variant as Variant
    from rtcal.prediction.variants import read_variants as read_variants
else:
    __getattr__, __dir__, __all__ = lazy.exports(__name__, __file__)
