"""The case of the finder's commands: read, searched and verified."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtcal.command.assignments import errors_name_options, pairs
from rtcal.command.console import bar_wanted, said
from rtcal.command.finder_options import Inputs, Search
from rtcal.errors import DataError
from rtcal.support.files import spare
from rtcal.support.progress import bar

if TYPE_CHECKING:
    from rtcal.finder import positions

SEEDS = (0, 1, 2)
"""Seeds of the simulator over which a gap at positions is printed."""


def read_case(inputs: Inputs, targets: Sequence[str | Path] = ()) -> Any:
    """Read the case; DataError if a file to be written is also one of those that are read."""
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room
    from rtcal.finder import Case
    from rtcal.finder.search import case_of

    spare(targets, [inputs.case])
    if inputs.measured is None:
        refuse(inputs.stated, _NEEDS_POSITIONS)
        case = Case.from_file(inputs.case)
        spare(targets, files_read(inputs))
        return case
    room = Room.from_file(inputs.case)
    spare(targets, [path for path in (*files_read(inputs), room.scene.mesh) if path is not None])
    measured = Measurement.from_file(inputs.measured)
    if not inputs.at_positions:
        refuse(inputs.stated, _NEEDS_POSITIONS)
        return case_of(room, measured)
    more: dict[str, Any] = {"exclude": pairs("--exclude", inputs.exclude)}
    if inputs.simulated is not None:
        more["simulated"] = Measurement.from_file(inputs.simulated)
    if inputs.match:
        more["match"] = inputs.match
    tracing = {"n_paths": inputs.paths, "scattering": inputs.scattering}
    with errors_name_options("scattering", "match", "exclude"):
        return case_of(
            room, measured, tracing={k: v for k, v in tracing.items() if v is not None}, **more
        )


_NEEDS_POSITIONS = " needs a room that states its sources and receivers, measured pair by pair"


def files_read(inputs: Inputs) -> list[str]:
    """Return the paths of the files that are read."""
    from rtcal.finder.case_files import files

    if inputs.measured is None:
        return [os.fspath(path) for path in files(inputs.case)]
    return [f for f in (inputs.case, inputs.measured, inputs.simulated) if f is not None]


def search_case(
    inputs: Inputs,
    search: Search,
    quiet: bool,
    targets: Sequence[str | Path] = (),
    number: Mapping[str, Any] | None = None,
    case: Any = None,
) -> Any:
    """Find what a room's model misses; simulations are kept beside its file."""
    from rtcal import finder

    case = read_case(inputs, targets) if case is None else case
    options: dict[str, Any] = {"seed": search.seed, "without": search.without, "only": search.only}
    number = {} if number is None else number
    of_means = {"prior": search.prior, "engines": search.engines, **number}
    if inputs.at_positions:
        stated = {
            "--engine": search.engines if search.engines_stated else None,
            "--prior": search.prior or None,
            "--most": None if number.get("most") == 1 else number.get("most"),
            "--expected": number.get("expected"),
        }
        refuse(stated, ": with a geometry there is no such option")
    else:
        options |= of_means
    with _progress("control room", quiet) as progress:
        options |= {"cache": inputs.kept, "progress": progress}
        return finder.find(case, **options)


def verified(inputs: Inputs, finding: Any, quiet: bool) -> Any:
    """Return the gaps before and after; at pairs that were not fitted over `SEEDS`."""
    from rtcal import finder

    if not inputs.at_positions:
        return finder.verify(finding)
    with _progress("model", quiet) as progress:
        return finder.verify(finding, seeds=SEEDS, cache=inputs.kept, progress=progress)


@contextmanager
def _progress(unit: str, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each step of a computation."""
    begun: list[str] = []
    with bar(0, unit, bar_wanted(quiet), said(quiet)) as shown:

        def progress(step: str, done: int, total: int) -> None:
            if step not in begun and hasattr(shown, "reset"):
                begun.append(step)
                if done == 1:
                    shown.reset(total=total)
                shown.set_description(step)
            shown.update(1)

        yield progress


def further_places(finding: positions.PositionsFinding) -> tuple[positions.Place, ...]:
    """Return places for a further receiver, the one that tells most first; none without a question."""
    from rtcal.finder import positions

    if not finding.can_be_added or finding.surface is not None:
        return ()
    try:
        return positions.next_position(finding)
    except DataError:  # at most one surface is in question, or the room is too small for a grid
        return ()


def refuse(stated: Mapping[str, object], why: str) -> None:
    """Raise DataError for the first option that is stated."""
    for option, value in stated.items():
        if value is not None:
            raise DataError(f"{option}{why}")
