"""Calibrate a simulator to what every position heard, by Gauss-Newton steps that are each a QP.

    minimise ½ (y - f(a) - J (alpha - a))' C⁻¹ (y - f(a) - J (alpha - a)) + the other terms,

with y what was measured, f what the simulator hears, J its derivatives at a, and C the covariance of
the errors of measurement and simulator. alpha becomes the next a, or a point on the way to it where
the objective with the simulator itself would rise. No fit ends farther from what was measured than it
began: then the start is returned, and ``refused`` says so.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import overload

import numpy as np

from rtcal.acoustics.band_conversion import measurement_in_room_bands
from rtcal.acoustics.materials import CalibrationRecord
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MATCH, observable, parameter_label
from rtcal.acoustics.quality import gap_jnd, rms
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import in_words, prior_covariance
from rtcal.acoustics.scene import POSITION, checked_uncertainty
from rtcal.calibration.problem import Calibration
from rtcal.loop import control_runs
from rtcal.loop.control_runs import (
    ControlRuns,
    simulated_controls,
    trace_ahead,
)
from rtcal.loop.matched import BelowSchroeder, Beside
from rtcal.loop.matched import means as measured_beside
from rtcal.loop.measured_pairs import (
    T30_ALONE,
    MeasuredPairs,
    Pair,
    history,
    pairs_to_match,
    refuse_known,
    with_t30,
    without_place,
)
from rtcal.loop.positions_result import GaussNewtonStep, PositionsResult
from rtcal.loop.positions_steps import (
    GROUPS,
    Fitted,
    Listener,
    PositionsFit,
    simulator_error,
)
from rtcal.loop.prior_reach import BeyondPrior, beyond_prior
from rtcal.loop.scattering import Scattering, fitted
from rtcal.modes.result import ModesResult
from rtcal.simulators import base, observations
from rtcal.simulators.base import Simulator
from rtcal.simulators.observations import DifferentiableSimulator, Observations, observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import __version__, checks
from rtcal.support.errors import DataError, FewPathsWarning, SimulatorError
from rtcal.support.speed import Progress
from rtcal.support.types import Array

MORE_PATHS = 4
"""Factor of the number of paths that are weighed: EDT of a pair has a noise of 2 to 9 % with 6000. In a
development room with 26 surfaces the error of alpha was 1.00 times that of T20 alone with 8000 paths,
and 0.95 times with 32,000."""
_BATCHES = 16
"""Batches of the paths that are weighed; a multiple of `simulator_error.GROUPS`."""


def calibrate_positions(
    simulator: Simulator,
    room: Room | ModesResult,
    measured: Measurement,
    match: Sequence[str] = MATCH,
    *,
    exclude: Sequence[Pair] = (),
    calibration: Calibration | None = None,
    controls: ControlRuns | None = None,
    cache: str | os.PathLike[str] | None = None,
    position_uncertainty: float = POSITION,
    fit_scattering: bool = True,
    more_paths: int = MORE_PATHS,
    seed: int = 0,
    progress: Progress | None = None,
) -> PositionsResult:
    """Calibrate a room's coefficients so that a simulator has what every position heard.

    The gap over all that is matched, and the objective, are at most those of the room as given: else
    that room is returned, and the result's ``refused`` says so. Where a gap above 0.5 JND is left, of
    the coefficients whose objective is within half a nat of its minimum those with a smaller gap are
    returned.

    Parameters
    ----------
    simulator : Simulator
        A `PathTracing` is followed with more paths.
    room : Room or ModesResult
        Its alpha and sigma are the prior. A result of ``calibrate_modes(room, ...)`` without T stands
        in place of what was heard below the Schroeder frequency: coefficients stay there as it left
        them.
    measured : Measurement
        Of pairs that the simulator has, too.
    match : sequence of str
        Keys of `rtcal.acoustics.observables`, each matched at every pair. "g" is the measured G, and
        "level" one whose reference all positions of a source share.
    exclude : sequence of (source, receiver)
        Measured pairs that are left out.
    calibration : Calibration, optional
        Prior, further terms and constraints. By default the room's prior alone.
    controls : ControlRuns, optional
        The simulator's error, as ``result.controls`` has it. By default it is simulated for a
        simulator with a geometry (`rtcal.loop.control_runs`). For others it is not known, and no
        interval is stated.
    cache : path, optional
        Folder in which the control runs are kept.
    position_uncertainty : float
        Root mean square distance of sources and receivers from where they are stated, in m; at
        most 1.
    fit_scattering : bool
        Whether the scattering coefficients of a `PathTracing` are fitted, too. Its model is
        "random". If not, those stated are kept, and are uncertain.
    more_paths : int
        Factor of the number of paths of a `PathTracing`, besides that of `PathTracing.denser`.
    seed : int
        Seed of all simulations.
    progress : callable, optional
        Called with the number of finished control runs and their total.

    Raises
    ------
    SimulatorError, TooShortError
        From the simulator.
    DataError
        If simulator and room differ in materials or bands, or an argument breaks its rule. Also if
        the measurement has no pair in common with the simulator, or none of the parameters.

    Examples
    --------
    >>> import rtcal as rt
    >>> hall = rt.datasets.halls.corridor()
    >>> tracer = rt.simulators.PathTracing(
    ...     room=hall.room, geometry=hall.geometry, sources=hall.sources,
    ...     receivers=hall.receivers, n_paths=800)
    >>> measured = tracer.simulate(0.8 * hall.room.alpha, seed=1)
    >>> controls = rt.loop.ControlRuns(
    ...     parameters=("t20",), pairs=tracer.pairs,
    ...     errors=0.1 * np.ones((4, 1, len(tracer.pairs), hall.room.n_bands)))
    >>> result = rt.calibrate_positions(
    ...     tracer, hall.room, measured, ("t20",), controls=controls)
    >>> len(result.before.pairs)
    4
    """
    modes = room if isinstance(room, ModesResult) else None
    room = room.prior if isinstance(room, ModesResult) else room
    base.check_fits(simulator, room)
    match = observations.checked_parameters(match)
    exclude = checks.pairs("exclude", exclude)
    checks.whole("seed", seed, 0)
    checks.flag("fit_scattering", fit_scattering)
    checked_uncertainty(position_uncertainty)
    if calibration is not None:
        checks.instance("calibration", calibration, Calibration)
    measured, repeated = base.at_places(simulator, measured)
    if modes is not None:
        low = BelowSchroeder.of(modes, room, measured)
        room, measured = low.room, low.above(measured)
        repeated = (*repeated, low.note)
    tracer = simulator
    wanted = with_t30(match, measured)
    if isinstance(simulator, PathTracing):  # data that were used before are told before the paths
        kept = [p for p in measured.pairs if p in simulator.pairs and p not in exclude]
        refuse_known(room, measured, wanted, kept)
    simulator = precise(simulator, more_paths)
    trace_ahead(simulator, room.alpha, seed)
    replaced = wanted != tuple(match)
    if isinstance(simulator, PathTracing):
        wanted = simulator.trusted(wanted)
    match, notes = _given(simulator, room.alpha, wanted, seed)
    if isinstance(simulator, PathTracing):
        notes = (*notes, *simulator.notes, *simulator.source_notes)
    if replaced:
        notes = (T30_ALONE, *notes)
    first, not_heard = _first(simulator, room.alpha, match, measured, seed)
    data = pairs_to_match(room, measured, match, first, exclude)
    notes = (*without_place(measured, first.pairs), *notes, *not_heard, *repeated)
    if stated := in_words(room):
        notes = (*notes, f"The room is uncertain, and that counts: {stated}.")
    _refuse_one_place(simulator, data.observations.pairs, position_uncertainty)
    if isinstance(tracer, PathTracing) and isinstance(simulator, PathTracing):
        # Too few paths are told before the control runs.
        heard = simulator.observe_in_groups(room.alpha, GROUPS, match, seed=seed)
        _tell_noise(heard, match, tracer)
    if controls is None:
        told: list[int] = []

        def tell(done: int, total: int) -> None:
            told.append(done)
            if progress is not None:
                progress(done, total)

        controls = simulated_controls(
            simulator,
            room,
            match,
            seed=seed,
            position_uncertainty=position_uncertainty,
            cache=cache,
            progress=tell,
        )
        if controls is not None and not told:  # they were kept
            tell(control_runs.RUNS, control_runs.RUNS)
    in_room = measurement_in_room_bands(measured, room.centre_frequencies)
    listener = Listener(simulator, data, first, room.alpha, seed)
    before = listener.values()
    prior = prior_covariance(room)
    error, by_scattering = simulator_error(listener, controls, fit_scattering)
    beyond = _beyond(listener, room, prior, error)
    fit = PositionsFit(
        listener,
        room,
        calibration,
        measured,
        prior,
        error,
        None if beyond else by_scattering,
    ).run()
    listener, path = fit.listener, fit.path
    last = path.steps[-1].model.matrix
    scattering, start = None, tracer.scattering if isinstance(tracer, PathTracing) else None
    if fit.scattering is not None and isinstance(tracer, PathTracing):
        weighed, materials = fit.scattering.tracer, fit.scattering.materials
        tracer = replace(
            tracer, scattering=weighed.scattering, scattering_model=weighed.scattering_model
        )
        unknown = fit.errors.covariance + last @ prior @ last.T
        posterior = materials.posterior(listener.used, unknown)
        scattering = fitted(tracer, materials.traced, posterior)
    elif fit_scattering and isinstance(tracer, PathTracing):
        notes = (*notes, _kept(tracer, beyond))
    return PositionsResult(
        prior=room,
        room=room if fit.refused else _calibrated(room, tracer, scattering, fit, data, controls),
        simulator=_named(tracer, scattering),
        tracer=tracer,
        weighed=precise(tracer, more_paths),
        seed=seed,
        scattering=scattering,
        start=start,
        simulations=listener.calls,
        measured=data,
        beside=Beside.of(in_room, data.observations, first, listener.heard),
        held_out=Beside.at_pairs(in_room, data.observations, exclude, first, listener.heard),
        before=_with(data.observations, before),
        after=_with(data.observations, listener.values()),
        predicted=_predicted(fit, with_error=controls is not None),
        controls=controls,
        unexplained=fit.errors.unexplained,
        innovation=fit.residual + last @ (listener.alpha - room.alpha).ravel(),
        covariance=fit.errors.covariance,
        prior_covariance=prior,
        steps=tuple(
            GaussNewtonStep(s.model.start.alpha, s.model.matrix, float(s.share[0]), s.model.answer)
            for s in path.steps
        ),
        settled=path.settled,
        refused=fit.refused,
        beyond=beyond,
        notes=(*notes, *data.notes, *base.lost_paths(simulator)),
    )


def _beyond(listener: Listener, room: Room, prior: Array, error: Array) -> BeyondPrior | None:
    """Return how far T is from what the stated coefficients let expect; see `beyond_prior`."""
    data = listener.data
    shape = data.observations.values.shape
    matrix = np.zeros((*shape, prior.shape[0]))
    matrix[data.used] = listener.linearised()
    used = np.flatnonzero(data.used)
    errors = np.zeros((data.used.size, data.used.size))
    of_simulator = error[np.ix_(listener.used, listener.used)]
    errors[np.ix_(used, used)] = data.covariance + of_simulator
    return beyond_prior(
        room,
        data.observations.parameters,
        data.observations.values,
        listener.values(),
        matrix,
        prior,
        errors,
    )


def _predicted(fit: Fitted, *, with_error: bool) -> Observations:
    """Return what every position hears, with the simulator's error as the measured pairs tell it.

    The error's mean given the residual r at the measured pairs: D_all (R + D)⁻¹ r, D_all its
    covariance between all values and those used.
    """
    heard, values = fit.listener.heard, fit.listener.everywhere()
    if with_error:
        told = fit.errors.simulator @ fit.pull
        if fit.scattering is not None:
            told = told + fit.scattering.materials.back
        values = values + told.reshape(values.shape)
    return Observations(
        parameters=fit.listener.data.observations.parameters,
        pairs=heard.pairs,
        centre_frequencies=heard.centre_frequencies,
        values=values,
    )


def _calibrated(
    room: Room,
    simulator: Simulator,
    scattering: Scattering | None,
    fit: Fitted,
    data: MeasuredPairs,
    controls: ControlRuns | None,
) -> Room:
    """Return the room with its coefficients, their sigma where it is known, and a record.

    It has the scattering coefficients of a `PathTracing` and their meaning, too.
    """
    answer = fit.path.steps[-1].model.answer
    record = CalibrationRecord(
        method="positions",
        equation=f"every position heard by {_named(simulator, scattering)}",
        measured=" ".join([*history(room), *data.fingerprints]),
        solver=answer.solver,
        version=__version__,
    )
    sigma = room.sigma if controls is None else np.minimum(answer.posterior_sigma, 1.0)
    if isinstance(simulator, PathTracing):
        room = room.replace(
            scattering=simulator.scattering, scattering_model=simulator.scattering_model
        )
    alpha = np.clip(fit.listener.alpha, 0.0, 1.0)
    return room.replace(alpha=alpha, sigma=sigma, calibration=record)


def _given(
    simulator: Simulator, alpha: Array, match: Sequence[str], seed: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the parameters that the simulator gives, and a note of those that it does not."""
    match = observations.checked_parameters(match)
    if isinstance(simulator, DifferentiableSimulator):
        return match, ()
    simulated = base.run(simulator, alpha, seed=seed)
    given = tuple(p for p in match if p in observations.given(simulated))
    if not given:
        raise SimulatorError(
            f"{simulator.name} gives none of {', '.join(map(parameter_label, match))}"
        )
    absent = [parameter_label(p) for p in match if p not in given]
    note = f"Left out, since the simulator does not give it: {', '.join(absent)}."
    return given, (note,) if absent else ()


def _first(
    simulator: Simulator, alpha: Array, match: tuple[str, ...], measured: Measurement, seed: int
) -> tuple[Observations, tuple[str, ...]]:
    """Return what is heard with the prior, also of what was measured and is not matched.

    A note names what the simulator does not give of that.
    """
    more = [p for p in measured_beside(measured) if p not in match]
    if not isinstance(simulator, DifferentiableSimulator):
        simulated = base.run(simulator, alpha, seed=seed)
        heard = [p for p in more if p in observations.given(simulated)]
        return Observations.of_measurement(simulated, (*match, *heard), simulated.pairs), ()
    try:
        return observe(simulator, alpha, (*match, *more), seed=seed), ()
    except DataError:
        if not more:
            raise
        without = observe(simulator, alpha, match, seed=seed)
    names = ", ".join(map(parameter_label, more))
    return without, (f"Not shown, since the simulated decays do not hold it: {names}.",)


def _refuse_one_place(simulator: Simulator, pairs: Sequence[Pair], uncertainty: float) -> None:
    """Raise DataError if several pairs stand where one does: they tell no more than one."""
    sources, receivers = (getattr(simulator, kind, None) for kind in ("sources", "receivers"))
    if len(pairs) < 2 or not isinstance(sources, Mapping) or not isinstance(receivers, Mapping):
        return
    places = np.array([[*sources[s], *receivers[r]] for s, r in pairs], dtype=float)
    if np.max(np.linalg.norm(places - places[0], axis=1)) <= uncertainty:
        raise DataError(
            f"all {len(pairs)} pairs stand at one place, within the {uncertainty:g} m that positions "
            "are uncertain by; every position needs several"
        )


@overload
def precise(simulator: PathTracing, more_paths: int = MORE_PATHS) -> PathTracing: ...
@overload
def precise(simulator: Simulator, more_paths: int = MORE_PATHS) -> Simulator: ...
def precise(simulator: Simulator, more_paths: int = MORE_PATHS) -> Simulator:
    """Return a denser path tracing in `_BATCHES`, any other simulator as it is."""
    if not isinstance(simulator, PathTracing):
        return simulator
    denser = simulator.denser(more_paths)
    return denser if denser.n_batches == _BATCHES else replace(denser, n_batches=_BATCHES)


NOISE = 0.5
"""Largest noise in JND of the paths of a fit, root mean square over pairs and bands. In a shipped room
some 180 paths from each source have it. With 6000 it is 0.1."""


def _tell_noise(groups: Array, match: Sequence[str], tracer: PathTracing) -> None:
    """Warn where the paths are so few that the noise of a parameter is above `NOISE`.

    ``groups`` (n_groups, n_parameters, n_pairs, n_bands) are those of all paths.
    """
    spread = groups.std(axis=0, ddof=1) / len(groups) ** 0.5
    noise = {}
    for name, middle, error in zip(match, groups.mean(axis=0), spread, strict=True):
        kind = observable(name)
        ends = gap_jnd(kind.natural(middle + error), kind.natural(middle), name)
        noise[name] = float(rms(ends))
    worst = max(noise, key=lambda name: noise[name])
    if noise[worst] <= NOISE:
        return
    enough = math.ceil(tracer.n_paths * (noise[worst] / NOISE) ** 2 / 100) * 100
    warnings.warn(
        f"{tracer.n_paths} paths from each source are few: {parameter_label(worst)} of a pair has a "
        f"noise of {noise[worst]:.2g} JND, and more than {NOISE:g} hides what is to be matched. Take "
        f"{enough} paths or more",
        FewPathsWarning,
        stacklevel=checks.stack_level(),
    )


def _kept(tracer: PathTracing, beyond: BeyondPrior | None) -> str:
    """Return why the scattering was not fitted."""
    if beyond is not None:
        return (
            "The scattering stated was kept: no scattering makes up for absorption that is lacking."
        )
    if tracer.scattering_model != "random":
        return 'The scattering stated was kept: only "random" paths tell what another would change.'
    if np.isin(tracer.scattering, (0.0, 1.0)).all():
        return "The scattering stated was kept: coefficients of 0 and 1 are not changed."
    return "The scattering stated was kept: too few control runs tell what it changes."


def _named(simulator: Simulator, scattering: Scattering | None) -> str:
    """Return what the coefficients belong to."""
    if scattering is None:
        return simulator.name
    return f"{simulator.name}, scattering {scattering.mean:.2f}"


def _with(like: Observations, values: Array) -> Observations:
    return Observations(
        parameters=like.parameters,
        pairs=like.pairs,
        centre_frequencies=like.centre_frequencies,
        values=values,
    )
