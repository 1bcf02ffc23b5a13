"""The names of room-acoustic parameters as they are printed, and of means over positions."""

from __future__ import annotations

from rtcal.acoustics.observables import OBSERVABLES

SUMMARY = "*"
"""Name of the source and of the receiver in a row that holds means over several pairs."""


def parameter_label(parameter: str) -> str:
    """Return a parameter as it is printed; a name that is none in capitals.

    Examples
    --------
    >>> [parameter_label(parameter) for parameter in ("t20", "ts", "level")]
    ['T20', 'Ts', 'level']
    """
    known = OBSERVABLES.get(parameter)
    return parameter.upper() if known is None else known.label
