"""Calibrate a simulator: calibrate an equation, and move its target until the simulator agrees.

`calibrate_simulator` runs the loop of `rtcal.loop.state` with a simulator that can be called; one that
is run by hand takes part through `start`, `Loop.next_alpha` and `Loop.record`, or ``rtcal loop``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.errors import DataError, RtcalError, SimulatorError
from rtcal.loop.result import LoopResult as LoopResult
from rtcal.loop.rules import Rule
from rtcal.loop.state import Loop as Loop
from rtcal.loop.state import start as start
from rtcal.simulators.base import Simulator, run
from rtcal.support import checks
from rtcal.support.types import Array


def calibrate_simulator(
    simulator: Simulator,
    room: Room,
    measured: Measurement,
    rule: Rule | None = None,
    *,
    method: str = "mle",
    equation: LinearEquation | None = None,
    decimals: int | None = None,
    tolerance: float = 1.0,
    max_simulations: int = 12,
    seed: int = 0,
    after_step: Callable[[Loop], None] | None = None,
) -> LoopResult:
    """Calibrate a room's coefficients so that a simulator has the measured T20.

    Parameters
    ----------
    simulator : Simulator
    room : Room
        Its alpha and sigma are the prior. In large hard rooms let sigma be proportional to alpha:
        equal sigmas drive large hard walls to alpha = 0.
    measured : Measurement
    rule : {"secant", "safeguarded", "regression"}, optional
        `rtcal.loop.rules`; "safeguarded" for a smooth simulator, "regression" for one whose T
        jumps with alpha, if not given.
    method, equation
        Of the equation's calibration; see `rtcal.calibrate`.
    decimals : int, optional
        Decimals of alpha that the program reads.
    tolerance : float
        JND; a band is done when its gap is within it less the simulator's noise, and confirmed
        when fresh random numbers keep within it and their noise.
    max_simulations : int
        One more may be spent where a band has no T20.
    seed : int
        All steps share it, so that they differ by alpha alone; the confirmation uses the next.
    after_step : callable, optional
        Called with the loop after every simulation, for example to `Loop.save` it: what was
        simulated is then kept if the simulator fails later.

    Returns
    -------
    LoopResult
        Its ``status`` says of every band whether it converged and was confirmed.

    Raises
    ------
    SimulatorError, TooShortError
        From the simulator. A band that has no T20 at some coefficients, since too little is
        reflected or the equation does not hold, ends as unreachable instead.
    DataError
        If simulator and room differ in materials or bands.

    References
    ----------
    Bellows & Katz 2025, Sects. 4.2 and 4.3, Eqs. 38 to 40.

    Examples
    --------
    >>> import rtcal as rt
    >>> from rtcal.simulators.equation import EquationSimulator
    >>> room, measured = rt.datasets.bras_cr2()
    >>> result = calibrate_simulator(EquationSimulator(rt.Kuttruff(), room), room, measured)
    >>> set(result.status), result.simulations <= 3
    ({'converged'}, True)
    """
    if not isinstance(simulator, Simulator):
        raise DataError(
            f"simulator = {simulator!r} is no Simulator: it lacks simulate() or its rows"
        )
    checks.instance("room", room, Room)
    if after_step is not None and not callable(after_step):
        raise DataError(f"after_step = {after_step!r} cannot be called")
    checks.whole("seed", seed, 0)
    checks.whole("max_simulations", max_simulations, 1)
    if tuple(simulator.materials) != tuple(room.materials) or not np.array_equal(
        simulator.centre_frequencies, room.centre_frequencies
    ):
        raise DataError(f'{simulator.name} has other materials or bands than room "{room.name}"')
    if rule is None:
        rule = "safeguarded" if simulator.smooth else "regression"
    loop = start(
        room,
        measured,
        rule=rule,
        method=method,
        equation=equation,
        decimals=decimals,
        tolerance=tolerance,
    )
    found: list[Measurement] = []
    calls = 0
    while not loop.finished and calls < max_simulations:
        alpha = loop.next_alpha
        answer, without = _answer(simulator, loop, alpha, seed)
        calls += 1 + bool(without)
        found.append(answer)
        loop = loop.record(alpha, answer, without)
        if after_step is not None:
            after_step(loop)
    alpha = np.stack([loop.steps[b].alpha[:, k] for k, b in enumerate(loop.best)], axis=1)
    # Bands that did not converge may have been nearest at different steps: never simulated together.
    together = np.array_equal(alpha, loop.steps[-1].alpha)
    after = found[-1] if together else run(simulator, alpha, seed=seed)
    calibrated = loop.outcome.room
    record = calibrated.calibration and replace(
        calibrated.calibration,
        measured=loop.measured,
        equation=f"{calibrated.calibration.equation}, in the loop with {simulator.name}",
    )
    return LoopResult(
        room=calibrated.replace(alpha=alpha, calibration=record),
        simulator=simulator.name,
        loop=loop,
        simulations=calls,
        before=found[0],
        after=after,
        confirmation=None if simulator.deterministic else run(simulator, alpha, seed=seed + 1),
    )


def _answer(
    simulator: Simulator, loop: Loop, alpha: Array, seed: int
) -> tuple[Measurement, tuple[int, ...]]:
    """Simulate; where bands have no T20 at ``alpha``, simulate them as before, and name them.

    Before the first step that is the prior. NaN there is an error, and so is no T20 in any band.
    """
    try:
        return run(simulator, alpha, seed=seed), ()
    except RtcalError as error:
        nan_at_first = isinstance(error, SimulatorError) and not loop.steps
        if not error.bands or nan_at_first or 1 < len(alpha[0]) == len(error.bands):
            raise
        without = error.bands
    again = alpha.copy()
    for k in without:
        known = [s for s in loop.steps if np.isfinite(s.simulated[k])]
        again[:, k] = known[-1].alpha[:, k] if known else loop.rounded(loop.room.alpha[:, k])
    return run(simulator, again, seed=seed), without
