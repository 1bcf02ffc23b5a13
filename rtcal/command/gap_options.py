"""Options that the commands of ``rtcal gap`` share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import wraps
from typing import Any

import click

from rtcal.command.assignments import numbers
from rtcal.command.console import json_option, quiet_option
from rtcal.errors import DataError

ENGINES = ("path tracing", "network")
_EXPECTED = 0.7  # set_posterior.EXPECTED, which takes seconds to import
seed_option = click.option(
    "--seed", default=0, show_default=True, help="Seed of the control rooms and the bootstrap."
)


@dataclass(frozen=True)
class Search:
    """What the search takes beside the case, as `rtcal.discrepancy.find` does."""

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
    """Add a case and the options of its search, which the command takes as ``search``."""

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
        click.argument("case", type=click.Path()),
    ):
        with_search = option(with_search)
    return with_search


def several_options(command: Any) -> Any:
    """Add the options of a search for several effects; the command takes their expected number."""

    @wraps(command)
    def with_number(several: bool, expected: float | None, **others: Any) -> Any:
        if expected is not None and not several:
            raise DataError("--expected is of a search for several effects: add --several")
        number = _EXPECTED if expected is None else expected
        return command(expected=number if several else None, **others)

    for option in (
        click.option(
            "--expected",
            type=float,
            help=f"Expected number of missing effects, with --several; {_EXPECTED:g} unless stated.",
        ),
        click.option("--several", is_flag=True, help="Several effects may be missing at once."),
    ):
        with_number = option(with_number)
    return with_number
