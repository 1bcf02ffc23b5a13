"""A calibrated simulator predicts what every position hears after changes, which share control runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rtcal.acoustics.change_files import Variant, refuse_repeated_names
from rtcal.acoustics.observables import MATCH, OBSERVABLES, TARGET
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.scene import POSITION, checked_uncertainty
from rtcal.loop.change_at_positions import Before, CalibratedAtPositions, Changed
from rtcal.loop.changed_room import ChangedRoom
from rtcal.loop.control_runs import Heard, simulated_controls
from rtcal.loop.positions_prediction import PositionsPredictions
from rtcal.simulators.base import Simulator
from rtcal.simulators.observations import checked_parameters, observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.errors import DataError
from rtcal.support.progress import Progress
from rtcal.support.types import Array

WANTED = (*MATCH, *(key for key, each in OBSERVABLES.items() if each.predicted))
"""What is predicted where nothing else is asked for."""
_BEFORE = "before the change"


def predict_positions(
    result: CalibratedAtPositions,
    variants: Sequence[Variant],
    *,
    wanted: Sequence[str] = WANTED,
    assumptions: Assumptions | None = None,
    position_uncertainty: float = POSITION,
    progress: Progress | None = None,
) -> PositionsPredictions:
    """Predict what every position hears after changes, which share the control runs.

    Parameters
    ----------
    result : CalibratedAtPositions
    variants : sequence of Variant
        Covers, openings and another climate.
    wanted : sequence of str
        Keys of `rtcal.acoustics.observables`.
    assumptions : Assumptions, optional
        Its ``changed`` is the least sigma of a new material, ``areas`` the relative error of the area
        of a partial cover. The others are the equation's.
    position_uncertainty : float
        As of `rtcal.calibrate_positions`.
    progress : callable, optional
        Called with the number of finished control runs and their total.

    Raises
    ------
    DataError
        For a change that the simulator does not know the place of, two variants of one name, or a
        simulator whose error no control run tells.

    Examples
    --------
    >>> import rtcal as rt
    >>> from rtcal.prediction import Cover, Open
    >>> room = rt.Room(name="box", volume=60, materials=["plaster"], areas=[94], alpha=[[0.2]],
    ...                sigma=[[0.04]], centre_frequencies=[1000], air=rt.Air(20, 50),
    ...                scattering=[[0.5]])
    >>> tracer = rt.simulators.PathTracing(
    ...     room=room, geometry=rt.simulators.Polyhedron.shoebox((4, 5, 3), "plaster"),
    ...     sources={"S1": (1, 1, 1.5)}, receivers={"R1": (3, 4, 1.2), "R2": (2.8, 1.3, 1.3)},
    ...     n_paths=400)
    >>> measured = tracer.simulate([[0.18]], seed=1)
    >>> result = rt.calibrate_positions(tracer, room, measured, ("t20", "c80"), more_paths=1)
    >>> panel = rt.Material("panel", [0.8], [0.1])
    >>> after = predict_positions(
    ...     result, [Variant("panels", (Cover("plaster", panel, 15),)),
    ...              Variant("window", (Open("plaster", 2),))], wanted=("t20", "c80"))
    >>> for prediction in after.predictions:
    ...     low, high = prediction.interval("t20")
    ...     print(prediction.name, bool((low < high).all()), bool((prediction.change("c80") > 0).all()))
    panels True True
    window True True
    """
    refuse_repeated_names(variants)
    assumed = Assumptions() if assumptions is None else assumptions
    every = (Variant(_BEFORE, ()), *variants)
    rooms = [ChangedRoom(result.prior, tuple(v.changes), assumed) for v in every]
    simulator, seed = result.weighed, result.seed
    for room in rooms:
        room.simulator(simulator)  # raises where it cannot take the change, before anything is run
    match = tuple(dict.fromkeys([TARGET.key, *checked_parameters(wanted)]))
    checked_uncertainty(position_uncertainty)
    if isinstance(simulator, PathTracing):
        match = simulator.trusted(match)

    def after(room: ChangedRoom) -> Heard:
        at_alpha: dict[bytes, Array] = {}

        def hear(of: Simulator, alpha: Array, seed: int) -> Array:
            walls = room.mixture @ room.all_alpha(alpha)
            if of is not simulator:
                return observe(room.simulator(of), walls, match, seed=seed).values
            if walls.tobytes() not in at_alpha:
                heard = observe(room.simulator(of), walls, match, seed=seed).values
                at_alpha[walls.tobytes()] = heard
            return at_alpha[walls.tobytes()]

        return hear

    controls = None
    if result.controls is not None:
        # The runs stand at the calibrated coefficients: those are known far better than the prior.
        controls = simulated_controls(
            simulator,
            result.room.replace(sigma=np.zeros_like(result.alpha), calibration=None),
            result.parameters,
            seed=seed,
            position_uncertainty=position_uncertainty,
            progress=progress,
            after=[(_names(match, i), after(room)) for i, room in enumerate(rooms)],
        )
    if controls is None:
        raise DataError(
            f"no control run tells the error of {result.simulator}: predict with a simulator that "
            "has a geometry, or T by an equation"
        )
    known = Before(result, simulator, controls.pairs)
    before, *after_each = (
        Changed(known, room, match, _names(match, i), controls).predicted(variant)
        for i, (room, variant) in enumerate(zip(rooms, every, strict=True))
    )
    return PositionsPredictions(
        predictions=tuple(replace(each, heard_before=before.middle) for each in after_each)
    )


def _names(match: Sequence[str], variant: int) -> tuple[str, ...]:
    return tuple(f"{parameter}, variant {variant + 1}" for parameter in match)
