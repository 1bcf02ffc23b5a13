"""The calibration of a room: from its prior and its measured T to its absorption coefficients alpha.

In short: every calibration is a QP (weighted quadratic objective, area equality, 0-1 box) built once in
cvxpy and solved with Clarabel or OSQP; the closed-form solutions are a warm start, and the oracle in
the tests.

The path of `rtcal.calibrate(room, measured)`, module by module:

- `methods`: `preset` gives the terms of the method, a `Calibration` without a room.
- `problem`: `Calibration.build` takes the Room, `CalibrationProblem.solve` the Measurement.
- `unknowns`: `Layout` is the order of the unknowns, `Numbers` has the prior, the box, areas and b.
- `terms`: each term is a cvxpy expression of the deviations x = (alpha - mu) / sigma; soft matches take
  the place of the area equality, other terms add inequalities or tighten the box.
- `composition`: `Composition` has all three for one layout: unknowns, numbers and terms.
- `qp`: `compile_once` makes a `CompiledProblem`, which the numbers turn into a `QP`. `solve` asks the
  solver (`closed_form` is OSQP's start), `polish` solves the optimality conditions on the active set,
  and `certify` checks the answer anew. If the polish fails, the closed form's answer, then the
  solver's own is certified (`problem.certified_answer`).
- `feasibility`: whether T is within reach, before solving; why nothing is feasible, after it.
- `solution`, `result`: the answer with its certificate, and the `CalibrationResult` for the room.

`exact` has closed forms and the exact solution of one band, which share no code with this path.
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
