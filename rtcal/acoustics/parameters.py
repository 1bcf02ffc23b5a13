"""The room-acoustic parameters of ISO 3382-1: names, units and plausible ranges."""

from __future__ import annotations

from rtcal.errors import DataError

UNITS: dict[str, str] = {
    "t20": "s",
    "t30": "s",
    "edt": "s",
    "c50": "dB",
    "c80": "dB",
    "d50": "",
    "ts": "s",
    "g": "dB",
    "level": "dB",
}
"""Unit of each parameter (ISO 3382-1); D50 is a fraction. The level has any reference that all
receivers of a source share: it is what G is without a calibrated source."""

DECAY_TIMES = ("t20", "t30", "edt")
T_LIMITS = (0.01, 120.0)
"""Shortest and longest T20 and T30 in s that are accepted. A lined box of a litre has 0.01 s or more.
The longest published T is 112 s, at 125 Hz in the oil tanks of Inchindown (T. Cox, Sonic
Wonderland, 2014)."""
LIMITS: dict[str, tuple[float, float, str]] = {
    "c50": (-200.0, 200.0, "is it in dB?"),
    "c80": (-200.0, 200.0, "is it in dB?"),
    "d50": (0.0, 1.0, "is it in percent? D50 is a fraction"),
    "ts": (0.0, 10.0, "is it in ms?"),
    "g": (-200.0, 200.0, "is it in dB?"),
    "level": (-200.0, 200.0, "is it in dB?"),
}
"""Limits of each other parameter in its unit, and the likely mistake of a value beyond them.

Ts of an exponential decay is T / 13.8: 8.7 s for T = 120 s. C80 of T = 0.03 s is 160 dB."""
SUMMARY = "*"
"""Name of the source and of the receiver in a row that holds means over several pairs."""


def parameter_label(parameter: str) -> str:
    """Return a parameter as it is printed.

    Examples
    --------
    >>> [parameter_label(parameter) for parameter in ("t20", "ts", "level")]
    ['T20', 'Ts', 'level']
    """
    return {"ts": "Ts", "level": "level"}.get(parameter, parameter.upper())


def check_parameter(name: str) -> None:
    """Raise DataError for a name that is no parameter."""
    if name not in UNITS:
        raise DataError(f'parameter "{name}" is unknown; known are {", ".join(UNITS)}')


def limits_in_words(parameter: str) -> tuple[float, float, str]:
    """Return the least and the largest value that is accepted, rounding included, and the rule.

    The parameter is one of `LIMITS`.

    Examples
    --------
    >>> limits_in_words("d50")[2]
    'from 0 to 1: is it in percent? D50 is a fraction'
    """
    least, most, question = LIMITS[parameter]
    unit = f" {UNITS[parameter]}".rstrip()
    return least, most * (1 + 1e-9), f"from {least:g} to {most:g}{unit}: {question}"


def plausible_time(place: str, seconds: float, parameter: str = "t20") -> None:
    """Raise DataError for a T that no room has: it is most likely in another unit.

    EDT has no lower limit, since strong direct sound makes it arbitrarily short.
    """
    low, high = T_LIMITS
    if seconds > high or (seconds < low and parameter != "edt"):
        raise DataError(
            f"{place} = {seconds:g} s is not from {low:g} to {high:g} s, as in any room: "
            "is it in seconds?"
        )
