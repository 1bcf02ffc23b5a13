"""The calibration of a room: from its prior and its measured T to its absorption coefficients alpha.

In short: every calibration is a QP (weighted quadratic objective, area equality, 0-1 box) built once in
cvxpy and solved with Clarabel or OSQP. The paper's closed form is OSQP's warm start and the fallback
of both solvers (the first round of `qp.closed_form`) and, in the tests, the oracle (`exact`, which
shares no code with the QP).

The path of `rtcal.calibrate(room, measured)`, in the order in which it is taken:

1. `methods`: `preset` gives the terms of the method (`terms`, each a cvxpy expression of the deviations
   x = (alpha - mu) / sigma) as a `Calibration` without a room.
2. `problem`: `Calibration.build` takes the room and returns a `CalibrationProblem`. It is a
   `Composition` (`composition`): terms, rooms and equation, and the `qp.CompiledProblem` that cvxpy
   compiles of them, with the order of the unknowns; rooms of one layout share it (`qp.compile_once`).
3. `CalibrationProblem.solve` takes the measurement and has the rest of the path in one function: T in
   the room's bands (`measured`), and of it and the room the `Numbers` (`unknowns`): prior, box, areas,
   b. `feasibility` says whether T is within reach. The numbers fill a `QP`. `qp.solve` asks the solver
   which constraints are active (if it returns nothing, those held at an end and those
   that the prior violates), `qp.polish` solves the optimality
   conditions on that active set and corrects it, `qp.certify` checks the answer anew. If this fails,
   `qp.closed_form` polishes from the paper's closed form; then the solver's own answer is certified.
   If none passes, `feasibility` explains why nothing is feasible.
4. `result`: a `JointResult` (alpha, multipliers, densities, derivatives, uncertainties) over the
   unknowns of all rooms, and of it a `CalibrationResult` per room.

Beside the path: `posterior` (marginals and draws of a density), `fit` (steps around the QP for models
that are not linear), `archive` (what calibrated rooms say of their materials), `table` (a
calibration in words). `exact` has the paper's closed forms and the exact solution of one band, which
share no code with all this.
"""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.calibration.problem import CalibrationProblem as CalibrationProblem
    from rtcal.calibration.qp import forget as forget
    from rtcal.calibration.result import CalibrationResult as CalibrationResult
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
