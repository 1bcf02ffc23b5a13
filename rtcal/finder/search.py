"""Find what a model misses: by means over positions, at every position, or between two states."""

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
    """Find what the model of a room lacks and, where the positions show it, on which surface.

    Two models of what is observed, one library of effects. With a simulator, or a room that states its
    mesh, sources and receivers, and a measurement of each pair, every pair is compared with traced
    paths. Otherwise means over positions are compared with closed forms.

    Parameters
    ----------
    room : Room, or a case
        A `rtcal.finder.Case` has several configurations or another equation, a
        `rtcal.finder.PositionsCase` a simulator; both hold what was measured.
    measured : Measurement
        In a `Room`.
    simulator : PathTracing, optional
        Simulator of the room; by default a path tracing of the room's scene, if it has one.
    before : Measurement, optional
        Measurement at the same positions before a change: the change is then found, instead of what
        the model lacks (`rtcal.finder.states`). The room's coefficients do not count. Neither
        ``controls``, ``cache``, ``progress`` nor ``scheduler`` belongs to such a search.
    simulated : Run, optional
        What a program gave at its coefficients. The run is then the model: the equation says how
        coefficients and effects change it, and what the equation errs by is not blamed on the room.
    program : {"", "geometrical"}
        By means: a geometrical program computes no equation, and an uneven field, or a second room, is
        in it if it was told so. Neither is taken for an error of the room.
    tracing : mapping, optional
        Arguments of `PathTracing`, such as ``n_paths`` and ``scattering``, where the room's scene is
        traced: in place of a ``simulator``.
    seed : int
        Seed of the random numbers at positions and of two states. A search by means over positions
        draws nothing: reference rooms and null rooms are fixed sequences.
    **options
        - ``effects``: sequence of `Effect`; the effects to try, by default the whole library. At
          positions those that stand on surfaces are sought on each of them (`Effect.stands_on`). Of two
          states those that add absorption give the spectra that are tried, added and removed, besides
          one that no effect has.
        - ``only``, ``without``: names of the effects to try alone, or to leave out; of two states "air"
          for the climate and "unknown" for a spectrum that no effect has.
        - ``controls``: `ControlRuns`, or a sequence of `ControlRooms`; the model's own error, of an
          earlier search.
        - ``cache``: folder in which simulations are kept, by a hash of all that they depend on.
        - ``progress``: called with what is computed, the number of finished steps and their total.
        - ``scheduler``: address of a Dask scheduler whose workers simulate, by default this machine.
        - By means over positions ``prior`` and ``most``, as `rtcal.finder.means.search.find` takes
          them.

    Returns
    -------
    Finding

    Raises
    ------
    DataError
        If a room is given without ``measured``, or a case with it; for an unknown effect, an option
        that such a search does not have, and too few pairs; and as the cases do.

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
            "measured, before, simulated, program, simulator and tracing are arguments for a "
            "room; a case contains them already: leave them out"
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
