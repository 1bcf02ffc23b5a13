"""Repeatable NAME=VALUE options, and option names in error messages."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rtcal.errors import DataError


def as_options(text: str, arguments: Sequence[str]) -> str:
    """Return a text with the command's options in place of Python's arguments.

    Examples
    --------
    >>> as_options('state decay_time="t20" or n_sources', ["decay_time", "n_sources"])
    'state --decay-time t20 or --sources'
    >>> as_options('read where={"room": "CR2"}', [])
    'read --where "room=CR2"'
    >>> as_options("state repeats=True", ["repeats"])
    'state --repeats'
    """
    text = re.sub(r'\bwhere=\{"([^"]+)": "([^"]+)"\}', r'--where "\1=\2"', text)
    for argument in arguments:
        option = "--" + argument.removeprefix("n_").replace("_", "-")
        text = text.replace(f"{argument}=True", option)
        text = re.sub(rf'\b{argument} ?= ?(?:"(\w+)"|("[^"]*"|[\w.]+))', rf"{option} \1\2", text)
        if "_" in argument:
            text = re.sub(rf"(?<!-)\b{argument}\b", option, text)
    return text


@contextmanager
def errors_name_options(*arguments: str) -> Iterator[None]:
    """Replace Python's arguments by the command's options in the message of a DataError."""
    try:
        yield
    except DataError as error:
        raise DataError(as_options(str(error), arguments)) from error


def pairs(option: str, stated: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs of a source and a receiver; DataError for another form than SOURCE:RECEIVER."""
    found = []
    for text in stated:
        source, colon, receiver = text.partition(":")
        if not (source and colon and receiver):
            raise DataError(f'{option}: "{text}" is not SOURCE:RECEIVER')
        found.append((source, receiver))
    return found


def texts(option: str, stated: Sequence[str], form: str) -> dict[str, str]:
    """Return the texts by name; DataError for another form than NAME=VALUE and for a repeated name.

    ``form`` says in the error's message what is expected.
    """
    by_name: dict[str, str] = {}
    for text in stated:
        name, _, value = text.rpartition("=")
        if not name or not value:
            raise DataError(f'{option}: "{text}" is not {form}')
        if name in by_name:
            raise DataError(f'{option}: "{name}" is given twice')
        by_name[name] = value
    return by_name


def numbers(option: str, stated: Sequence[str], form: str) -> dict[str, float]:
    """Return the numbers by name; DataError as `texts`, and for a value that is no number."""
    by_name = {}
    for name, value in texts(option, stated, form).items():
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        if number != number:
            decimal = ""
            if re.fullmatch(r"\d+,\d+", value):
                decimal = f", which has a decimal point: {name}={value.replace(',', '.')}"
            raise DataError(f'{option}: "{name}={value}" is not {form}{decimal}')
        by_name[name] = number
    return by_name
