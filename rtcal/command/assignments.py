"""Options of the form NAME=VALUE, given several times."""

from __future__ import annotations

from collections.abc import Sequence

from rtcal.errors import DataError


def texts(option: str, stated: Sequence[str], value_name: str) -> dict[str, str]:
    """Return the texts by name; DataError for another form and for a name given twice."""
    by_name: dict[str, str] = {}
    for text in stated:
        name, _, value = text.rpartition("=")
        if not name or not value:
            raise DataError(f'{option}: "{text}" is not NAME={value_name}')
        if name in by_name:
            raise DataError(f'{option}: "{name}" is given twice')
        by_name[name] = value
    return by_name


def numbers(option: str, stated: Sequence[str], value_name: str) -> dict[str, float]:
    """Return the numbers by name; DataError as `texts`, and for a value that is no number."""
    by_name = {}
    for name, value in texts(option, stated, value_name).items():
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        if number != number:
            raise DataError(f'{option}: "{name}={value}" is not NAME={value_name}')
        by_name[name] = number
    return by_name
