"""The calibration of a room: from its prior and its measured T to its absorption coefficients alpha.

In short: every calibration is a QP (weighted quadratic objective, area equality, 0-1 box) built once in
cvxpy and solved with Clarabel or OSQP; the closed-form solutions are a warm start, and the oracle in
the tests.

The path of `rtcal.calibrate(room, measured)`, in the order in which it is taken:

1. `methods`: `preset` gives the terms of the method (`terms`, each a cvxpy expression of the deviations
   x = (alpha - mu) / sigma) as a `Calibration` without a room.
2. `problem`: `Calibration.build` takes the room. Its `Composition` (`composition`) is the terms with
   the order of the unknowns, a `Layout` (`unknowns`), and with cvxpy's `CompiledProblem` of them,
   which rooms of one layout share (`qp.compile_once`).
3. `CalibrationProblem.solve` takes the measurement: T in the room's bands (`measured`), then the
   `Numbers` (`unknowns`): prior, box, areas, b. `feasibility` says whether T is within reach.
4. `problem.certified_answer`: the numbers fill a `QP`. `qp.solve` asks the solver, `qp.polish` solves
   the optimality conditions on the active set, `qp.certify` checks the answer anew. If the polish
   fails, the closed form's answer, then the solver's own is certified; if none passes, `feasibility`
   explains why nothing is feasible.
5. `result`: the `CalibrationResult` of the room, with what `solution` derives of the answer
   (multipliers, densities, derivatives, uncertainties).

Beside the path: `posterior` (marginals and draws of a density), `fit` (steps around the QP for models
that are not linear), `archive` (what calibrated rooms say of their materials), `table` and `verdict` (a
calibration in words). `exact` has closed forms and the exact solution of one band, which share no code
with all this.
"""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.calibration.problem import CalibrationProblem as CalibrationProblem
    from rtcal.calibration.qp import forget as forget
    from rtcal.calibration.result import CalibrationResult as CalibrationResult
    from rtcal.calibration.result import JointResult as JointResult
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
