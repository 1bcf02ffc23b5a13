"""Options that the commands ``find``, ``verify``, ``apply`` and ``plan`` share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, wraps
from pathlib import Path
from typing import Any

import click

from rtcal.command.assignments import numbers
from rtcal.command.console import json_option, quiet_option

ENGINES = ("path tracing", "network")
seed_option = click.option(
    "--seed", default=0, show_default=True, help="Seed of the control rooms and the bootstrap."
)

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
        from rtcal.acoustics.measurement import Measurement
        from rtcal.acoustics.room import Room

        stated = Room.from_file(self.case).scene.sources
        return bool(stated) and not Measurement.from_file(self.measured).is_summary

    @property
    def kept(self) -> Path:
        """The folder in which simulations are kept, beside the case or room."""
        from rtcal.finder.means.bootstrap import FOLDER

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

    @wraps(command)
    def with_inputs(**stated: Any) -> Any:
        of_inputs = {name: stated.pop(name) for name in names}
        return command(inputs=Inputs(**of_inputs), **stated)

    for option in (
        click.option(
            "--paths",
            type=click.IntRange(100, 10_000_000),
            help="Paths from each source, with positions; 8000 unless stated.",
        ),
        click.option(
            "--scattering",
            type=float,
            help="Scattering coefficient of all materials, with positions, if the room states none.",
        ),
        click.option(
            "--exclude",
            multiple=True,
            metavar="SOURCE:RECEIVER",
            help="Leave a pair out, with positions.",
        ),
        click.option(
            "--match",
            multiple=True,
            help="Compare this parameter alone, with positions; may repeat.",
        ),
        click.option(
            "--simulated",
            type=click.Path(dir_okay=False),
            help="What another program gave for the model as stated (CSV), with positions.",
        ),
        click.argument("measured", type=click.Path(), required=False),
        click.argument("case", metavar="CASE|ROOM", type=click.Path()),
    ):
        with_inputs = option(with_inputs)
    return with_inputs


@dataclass(frozen=True)
class Search:
    """Settings of the search beside the case, as `rtcal.finder.find` does."""

    engines: tuple[str, ...]
    seed: int
    without: tuple[str, ...]
    only: tuple[str, ...]
    prior: Mapping[str, float]
    engines_stated: bool = False

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
        search = Search(engines or ENGINES, seed, without, only, odds, bool(engines))
        return command(search=search, **others)

    for option in (
        quiet_option,
        json_option,
        seed_option,
        click.option(
            "--prior",
            multiple=True,
            metavar="EFFECT=ODDS",
            help="Prior odds of an effect, of none or of coefficients: opening=2.",
        ),
        click.option("--only", multiple=True, metavar="EFFECT", help="Try this effect alone."),
        click.option("--without", multiple=True, metavar="EFFECT", help="Do not try this effect."),
        click.option(
            "--engine",
            "engines",
            multiple=True,
            help="Simulator of the control rooms, at least two; by default path tracing and network.",
        ),
    ):
        with_search = option(with_search)
    return input_options(with_search)


def number_options(command: Any) -> Any:
    """Add how many effects may be missing at once; the command takes them as ``number``, for `find`."""

    @wraps(command)
    def with_numbers(most: int, expected: float | None, **others: Any) -> Any:
        return command(number={"most": most, "expected": expected}, **others)

    for option in (
        click.option("--expected", type=float, help="Expected number of effects, with --most."),
        click.option(
            "--most",
            type=int,
            default=1,
            show_default=True,
            help="Largest number of effects that may be missing at once, up to 3.",
        ),
    ):
        with_numbers = option(with_numbers)
    return with_numbers
