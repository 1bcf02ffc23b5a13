"""Options and searches that ``rtcal find``, ``verify``, ``apply`` and ``plan`` share.

With ``--before`` a search is for what changed between two measurements of a room.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cached_property, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.command.console import (
    bar_wanted,
    errors_name_options,
    exclude_option,
    match_option,
    numbers,
    output_options,
    pairs,
    paths_option,
    read_measured,
    said,
    scattering_option,
    seed_option,
    tell,
)
from rtcal.support.errors import DataError
from rtcal.support.files import spare
from rtcal.support.speed import bar

if TYPE_CHECKING:
    from rtcal.finder.positions.corrected import Corrected
    from rtcal.finder.positions.finding import PositionsFinding
    from rtcal.finder.states import SecondState, StatesFinding
    from rtcal.report.document import Heading


SEEDS = (0, 1, 2)
"""Seeds of the simulator over which a gap at positions is printed."""


def read_case(inputs: Inputs, targets: Sequence[str | Path] = (), *, quietly: bool = True) -> Any:
    """Read the case; DataError if a file to be written is also one of those that are read."""
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
    measured = read_measured(inputs.measured, quietly=quietly)
    if not inputs.at_positions:
        refuse(inputs.stated, _NEEDS_POSITIONS)
        return case_of(room, measured)
    more: dict[str, Any] = {"exclude": pairs("--exclude", inputs.exclude)}
    if inputs.simulated is not None:
        more["simulated"] = read_measured(inputs.simulated, quietly=quietly)
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
    from rtcal.finder.case import files_of_case

    if inputs.measured is None:
        return [os.fspath(path) for path in files_of_case(inputs.case)]
    return [f for f in (inputs.case, inputs.measured, inputs.simulated) if f is not None]


def search_case(
    inputs: Inputs,
    search: Search,
    targets: Sequence[str | Path] = (),
    number: Mapping[str, Any] | None = None,
    case: Any = None,
) -> Any:
    """Find what a room's model misses; simulations are kept beside its file."""
    from rtcal.finder.search import find

    case = read_case(inputs, targets, quietly=False) if case is None else case
    options: dict[str, Any] = {"seed": search.seed, "without": search.without, "only": search.only}
    number = {} if number is None else number
    of_means = {"prior": search.prior, **number}
    if search.engines:
        of_means["engines"] = search.engines
    if inputs.at_positions:
        stated = {
            "--engine": search.engines or None,
            "--prior": search.prior or None,
            "--most": None if number.get("most") == 1 else number.get("most"),
            "--expected": number.get("expected"),
        }
        refuse(stated, ": with a geometry there is no such option")
    else:
        options |= of_means
    with _progress("step") as progress:
        options |= {"cache": inputs.kept, "progress": progress}
        return find(case, **options)


def verified(inputs: Inputs, finding: Any) -> Any:
    """Return the gaps before and after; at pairs that were not fitted over `SEEDS`."""
    from rtcal import finder

    if not inputs.at_positions:
        return finder.verify(finding)
    with _progress("model") as progress:
        return finder.verify(finding, seeds=SEEDS, cache=inputs.kept, progress=progress)


@contextmanager
def _progress(unit: str) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each step of a computation."""
    begun: list[str] = []
    with bar(0, unit, bar_wanted(), said()) as shown:

        def progress(step: str, done: int, total: int) -> None:
            if step not in begun:
                begun.append(step)
                if done == 1:
                    shown.reset(total=total)
                shown.set_description(step)
            shown.update(1)

        yield progress


def refuse(stated: Mapping[str, object], why: str) -> None:
    """Raise DataError for the first option that is stated."""
    for option, value in stated.items():
        if value is not None:
            raise DataError(f"{option}{why}")


before_option = click.option(
    "--before",
    type=click.Path(dir_okay=False),
    help="What was measured at the same positions before something was changed (CSV): it is about "
    "what changed.",
)


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """The input of a command: a case, or a room and what was measured in it."""

    case: str
    measured: str | None = None
    simulated: str | None = None
    match: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    scattering: float | None = None
    paths: int | None = None

    @cached_property
    def at_positions(self) -> bool:
        """Whether a room that states where its sources and receivers are was measured pair by pair."""
        if self.measured is None:
            return False
        from rtcal.acoustics.room import Room

        stated = Room.from_file(self.case).scene.sources
        return bool(stated) and not read_measured(self.measured, quietly=True).is_summary

    @property
    def kept(self) -> Path:
        """The folder in which simulations are kept, beside the case or room."""
        from rtcal.finder.means.evidence import FOLDER

        return Path(self.case).parent / FOLDER

    @property
    def stated(self) -> dict[str, list[str]]:
        """The stated options of a search with positions."""
        return {
            f"--{name}": [str(v) for v in (value if isinstance(value, tuple) else (value,))]
            for name in ("simulated", "match", "exclude", "scattering", "paths")
            if (value := getattr(self, name)) not in (None, ())
        }

    def arguments(self) -> list[str]:
        """Return arguments and options of a command that reads the same."""
        files = [self.case] if self.measured is None else [self.case, self.measured]
        return [
            *files,
            *(x for name, texts in self.stated.items() for t in texts for x in (name, t)),
        ]


def input_options(command: Any) -> Any:
    """Add the arguments and options of `Inputs`, which the command takes as ``inputs``."""
    names = [field.name for field in fields(Inputs)]

    @click.argument("case", metavar="CASE|ROOM", type=click.Path())
    @click.argument("measured", type=click.Path(), required=False)
    @click.option(
        "--simulated",
        type=click.Path(dir_okay=False),
        help="What another program gave for the model as stated (CSV), with positions.",
    )
    @match_option
    @exclude_option
    @scattering_option
    @paths_option
    @wraps(command)
    def with_inputs(**stated: Any) -> Any:
        of_inputs = {name: stated.pop(name) for name in names}
        return command(inputs=Inputs(**of_inputs), **stated)

    return with_inputs


@dataclass(frozen=True)
class Search:
    """Settings of the search beside the case, as `rtcal.find` does."""

    seed: int
    engines: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    prior: Mapping[str, float] = field(default_factory=dict)

    def arguments(self) -> list[str]:
        """Return the options of a command that repeats the search."""
        out = ["--seed", str(self.seed)]
        for option, values in (
            ("--engine", self.engines),
            ("--without", self.without),
            ("--only", self.only),
            ("--prior", [f"{k}={v:g}" for k, v in self.prior.items()]),
        ):
            out += [x for value in values for x in (option, value)]
        return out


def search_options(command: Any) -> Any:
    """Add `Inputs` and the options of the search, which the command takes as ``search``."""

    @click.option(
        "--engine",
        "engines",
        multiple=True,
        help="Simulator of the control rooms, at least two; by default path tracing and image sources.",
    )
    @click.option("--without", multiple=True, metavar="EFFECT", help="Do not try this effect.")
    @click.option("--only", multiple=True, metavar="EFFECT", help="Try this effect alone.")
    @click.option(
        "--prior",
        multiple=True,
        metavar="EFFECT=ODDS",
        help="Prior odds of an effect, of none or of coefficients: opening=2.",
    )
    @seed_option
    @output_options
    @wraps(command)
    def with_search(
        engines: tuple[str, ...],
        seed: int,
        without: tuple[str, ...],
        only: tuple[str, ...],
        prior: tuple[str, ...],
        **others: Any,
    ) -> Any:
        odds = numbers("--prior", prior, "EFFECT=ODDS, such as opening=2")
        return command(search=Search(seed, engines, without, only, odds), **others)

    return input_options(with_search)


def number_options(command: Any) -> Any:
    """Add how many effects may be missing at once; the command takes them as ``number``, for `find`."""

    @click.option(
        "--most",
        type=int,
        default=1,
        show_default=True,
        help="Largest number of effects that may be missing at once, up to 3.",
    )
    @click.option("--expected", type=float, help="Expected number of effects, with --most.")
    @wraps(command)
    def with_numbers(most: int, expected: float | None, **others: Any) -> Any:
        return command(number={"most": most, "expected": expected}, **others)

    return with_numbers


def add_to_folder(
    finding: PositionsFinding | StatesFinding,
    apply: Callable[[], Corrected | SecondState],
    folder: Path,
) -> bool:
    """Write the room with what was found into a folder; return whether something was found."""
    if (nothing := finding.reason_for_none) is not None:
        tell(f"{nothing}\nNothing is written.", finding.to_dict())
        return False
    made = apply()
    made.save(folder)
    tell("\n".join([finding.headline, *made.in_words]), {**finding.to_dict(), **made.to_dict()})
    return True


def find_change(
    inputs: Inputs,
    search: Search,
    before: str,
    folder: Path | None,
    heading: Heading,
) -> None:
    """Find what changed, print it, and write its folder if there is one; then it is verified, too.

    Raises
    ------
    DataError
        Without a room and what was measured in it, and as `rtcal.find` does.
    """
    from rtcal.finder.search import verify
    from rtcal.report import document, finding_pages
    from rtcal.support.saved import NUMBERS

    paths = [] if folder is None else [folder / NUMBERS, folder / finding_pages.PAGE]
    finding = _what_changed(inputs, search, before, paths)
    printed, record = str(finding), finding.to_dict()
    if folder is not None:
        if finding.can_be_verified:
            verification = verify(finding)
            printed = f"{verification}\n{printed}"
            record["verification"] = verification.to_dict()
        page = finding_pages.states_page(finding, heading, lambda: None)
        finding.save(folder)
        document.write(paths[1], page)
    tell(printed, record)


def verify_change(
    inputs: Inputs,
    search: Search,
    before: str,
    earlier: str | None,
) -> None:
    """Print how well a change predicts pairs that were not fitted: halves, or an earlier finding's."""
    from rtcal.finder.search import verify
    from rtcal.finder.states import StatesFinding
    from rtcal.support.saved import load

    if earlier is None:
        finding = _what_changed(inputs, search, before)
        if (nothing := finding.reason_for_none) is not None:
            record = {"verdict": None, "sentence": nothing, "finding": finding.to_dict()}
            tell(nothing, record)
            return
        result = verify(finding, seed=search.seed)
    else:
        loaded = load(earlier)
        if not isinstance(loaded, StatesFinding):
            raise DataError(f"--finding {earlier} holds no finding of two states")
        _refuse_options_of_one_state(inputs, search, traced=False)
        two = {"before": before, "after": str(inputs.measured)}
        measured = {name: read_measured(path) for name, path in two.items()}
        result = verify(loaded, **measured)
    tell(str(result), result.to_dict())


def apply_change(
    inputs: Inputs,
    search: Search,
    before: str,
    folder: Path,
) -> bool:
    """Write the room of the second state into a folder; return whether there was one."""
    from rtcal.finder.states.case import MESH, ROOM

    if folder.is_file():
        raise DataError(f"--out {folder} is a file; with --before it is a folder")
    finding = _what_changed(inputs, search, before, [folder / ROOM, folder / MESH])
    return add_to_folder(finding, finding.apply, folder)


def _refuse_options_of_one_state(inputs: Inputs, search: Search, *, traced: bool) -> None:
    """Raise DataError without a room and a measurement, and for options of a search in one state.

    The scattering is of both, where paths are ``traced``.
    """
    if inputs.measured is None:
        raise DataError(
            "--before needs a room and what was measured after: ROOM AFTER --before BEFORE"
        )
    refused = {**inputs.stated, "--prior": search.prior, "--engine": search.engines}
    if traced and inputs.at_positions:
        refused.pop("--scattering", None)
    for option, value in refused.items():
        if value:
            raise DataError(f"{option} is not of a search for what changed between two states")


def _what_changed(
    inputs: Inputs, search: Search, before: str, targets: Sequence[Path] = ()
) -> StatesFinding:
    """Find what changed; no file that is read may be among the targets."""
    from rtcal.acoustics.room import Room
    from rtcal.finder.search import case_of, find

    _refuse_options_of_one_state(inputs, search, traced=True)
    measured = str(inputs.measured)
    spare(targets, [inputs.case, measured, before])
    room = Room.from_file(inputs.case)
    if room.scene.mesh is not None:
        spare(targets, [room.scene.mesh])
    scattering = {} if inputs.scattering is None else {"scattering": inputs.scattering}
    after, earlier = (read_measured(path, quietly=True) for path in (measured, before))
    if after.is_summary or earlier.is_summary or not room.scene.sources:
        refuse({"--scattering": inputs.scattering}, f"{_NEEDS_POSITIONS} before and after")
    with errors_name_options("scattering"):
        case: Any = case_of(room, after, before=earlier, tracing=scattering)
    found: StatesFinding = find(case, only=search.only, without=search.without, seed=search.seed)
    return found
