"""The parts of a calibration: objective terms and constraints.

Objective terms add with ``+`` and scale with ``*``. Constraints stand in a list. Each term describes
itself twice, independently: by an expression for cvxpy, and in plain NumPy. An objective term has
its value, gradient and curvature, a constraint its rows. The certificate is computed from the NumPy
description, so a wrong expression cannot certify itself. Tests compare the two descriptions.

In both the unknowns u are one flat vector: alpha row by row with the bands last, then further
unknowns (`rtcal.calibration.problem_data.Layout`).
"""

from rtcal.calibration.layout import Observed as Observed
from rtcal.calibration.terms.base import (
    BaseTerm,
    BoundConstraint,
    FurtherUnknown,
    LinearObservations,
    MatchConstraint,
    Objective,
    ObjectiveTerm,
    RowConstraint,
    Rows,
    SharedMaterials,
    as_objective,
    half_squares,
    lacking,
)
from rtcal.calibration.terms.limits import (
    AtMost,
    BandSmoothness,
    Bounds,
    Fixed,
    GroupAbsorption,
    Shared,
)
from rtcal.calibration.terms.match import (
    AddedAbsorption,
    ExactMatch,
    MatchWithin,
    RoomMatch,
    SoftMatch,
    match_matrix,
)
from rtcal.calibration.terms.prior import HuberDeviation, PriorDeviation

__all__ = [
    "AddedAbsorption",
    "AtMost",
    "BandSmoothness",
    "BaseTerm",
    "BoundConstraint",
    "Bounds",
    "ExactMatch",
    "Fixed",
    "FurtherUnknown",
    "GroupAbsorption",
    "HuberDeviation",
    "LinearObservations",
    "MatchConstraint",
    "MatchWithin",
    "Objective",
    "ObjectiveTerm",
    "Observed",
    "PriorDeviation",
    "RoomMatch",
    "RowConstraint",
    "Rows",
    "Shared",
    "SharedMaterials",
    "SoftMatch",
    "as_objective",
    "half_squares",
    "lacking",
    "match_matrix",
]
__dir__ = __all__.copy
