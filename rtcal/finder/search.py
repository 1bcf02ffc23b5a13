"""Find what is missing from a model: by means over positions, at every position, or in two states."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.acoustics.run import Run
from rtcal.finder.case import AnyCase, case_of
from rtcal.finder.finding import Finding
from rtcal.finder.means.search import find as find_by_means
from rtcal.finder.positions.search import find as find_at_positions
from rtcal.finder.states import find as find_between
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError

_SEARCHES: Mapping[str, tuple[Callable[..., Finding], str]] = {
    "means": (find_by_means, "by means over positions"),
    "positions": (find_at_positions, "at positions"),
    "states": (find_between, "for what changed between two states"),
}
"""By kind of case its search, and what a message calls it."""


def find(
    room: Room | AnyCase,
    measured: Measurement | None = None,
    simulator: PathTracing | None = None,
    *,
    before: Measurement | None = None,
    simulated: Run | None = None,
    program: str = "",
    tracing: Mapping[str, Any] | None = None,
    seed: int = 0,
    **options: Any,
) -> Finding:
    """Find what is missing from a room's model and, if positions were measured, on which surface.

    Each effect of a library (an opening, a curtain, a wrong volume, ...) is added to the model, and its
    probability is calculated from the measurement. If the measurement has a value for each
    source-receiver pair, and the room has a mesh with sources and receivers or a ``simulator`` is
    given, every pair is compared with a path tracing. Otherwise means over positions are compared with
    a reverberation equation.

    Parameters
    ----------
    room : Room, or a case
        Room with its input coefficients, or a case that contains the room and its measurement: a
        `rtcal.finder.Case` with several configurations or another equation, or a
        `rtcal.finder.PositionsCase` with a simulator.
    measured : Measurement, optional
        Measurement of the room; not given with a case.
    simulator : PathTracing, optional
        Simulator of the room; by default rtcal makes one if the room has a mesh with sources and
        receivers.
    before : Measurement, optional
        Measurement at the same positions before the room was changed. rtcal then finds what changed
        from ``before`` to ``measured``, and the room's coefficients have no effect
        (docs/two_states.md). ``controls``, ``cache``, ``progress`` and ``scheduler`` cannot be given
        with it.
    simulated : Run, optional
        Result of a simulation program such as ODEON, with the coefficients that it used. It is compared
        with the measurement in place of the equation's result, so that errors of the equation are not
        taken for errors of the room. rtcal's equation is then only used for the differences that other
        coefficients and effects would make to this result.
    program : {"", "geometrical"}
        Kind of the simulation program, for means over positions. "geometrical" says that the program
        traces rays or image sources: rtcal then does not report an uneven sound field or a second room
        as missing, because the program simulates both itself. "" says nothing.
    tracing : mapping, optional
        Arguments of `PathTracing`, such as ``n_paths`` and ``scattering``, if rtcal makes the
        simulator.
    seed : int
        Seed of the random numbers; without effect for means over positions.
    **options
        - ``effects``: sequence of `Effect`; the effects to try, by default the whole library. With
          ``before``, only effects that add absorption are used, once as added and once as removed.
        - ``only``, ``without``: names of the effects to try alone, or to leave out. With ``before``
          also "air" for the climate, and "unknown" for a change that has the spectrum of no effect.
        - ``controls``: errors of the model, so that they are not simulated again: at positions the
          `ControlRuns` of an earlier finding (``finding.controls``), for means the `ControlRooms`
          that `rtcal.finder.control_rooms` returns.
        - ``cache``: folder in which simulations are kept for the next search.
        - ``progress``: function that is called with the name of the step, and with the numbers of
          finished and of all steps.
        - ``scheduler``: address of a Dask scheduler whose workers simulate; by default this machine.
        - ``most``, for means over positions: largest number of effects that may be missing at once,
          from 1 to 3.
        - ``prior``, for means over positions: how probable an effect is before the measurement,
          relative to a usual effect. With ``{"opening": 2.0}`` an opening is twice as probable.

    Returns
    -------
    Finding
        Verdict, the probability of each effect and surface, the size of what was found, and cautions.
        ``print`` shows them, and `Finding.apply` adds the effect to the model.

    Raises
    ------
    DataError
        If ``measured`` is missing, or given with a case; for an unknown effect, an option that does not
        apply to the data, or too few pairs; if the room has already been calibrated to this
        measurement; and for other input that the case does not accept.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> finding = rt.find(room, measured, only=["opening", "volume"])  # doctest: +SKIP
    >>> print(finding.verdict)  # doctest: +SKIP
    none
    """
    checks.whole("seed", seed, 0)
    if not isinstance(room, AnyCase):
        checks.instance("room", room, Room)
    if isinstance(room, Room):
        if measured is None:
            raise DataError(
                "measured is missing: give the measurement with which the room is compared"
            )
        more: dict[str, Any] = {"simulated": simulated, "program": program}
        case = case_of(room, measured, simulator, before, tracing=tracing, **more)
    elif any(of is not None for of in (measured, simulator, before, tracing, simulated)) or program:
        raise DataError(
            "measured, before, simulated, program, simulator and tracing cannot be given "
            "with a case, which contains its measurements: leave them out"
        )
    else:
        case = room
    search, kind = _SEARCHES[case.kind]
    possible = inspect.signature(search).parameters
    for name, value in options.items():
        if name not in possible and value is not None:
            raise DataError(f"{name} cannot be used in a search {kind}: leave it out")
    every = {"seed": seed, **options}
    some = {name: value for name, value in every.items() if name in possible}
    return search(case, **some)
