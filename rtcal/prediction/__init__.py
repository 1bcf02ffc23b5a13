"""What a change of the room does to T, how sure that is, and which change meets a target."""

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
    from rtcal.prediction.estimate import State as State
    from rtcal.prediction.predicted import Prediction as Prediction
    from rtcal.prediction.predicted import predict as predict
    from rtcal.prediction.variants import Variant as Variant
    from rtcal.prediction.variants import read_variants as read_variants
else:
    __getattr__, __dir__, __all__ = lazy.exports(__name__, __file__)
