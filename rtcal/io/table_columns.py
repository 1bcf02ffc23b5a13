"""The columns of a table of measured values: what each header means.

A header names a parameter, a band, a position or a value, with or without its unit, in the usual
English and German spellings. "RT60" does not say which decay time it is; that must be stated.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.parameters import UNITS
from rtcal.errors import DataError
from rtcal.io.text import shown

_LEAST_BAND = 10.0
"""Hz. A smaller number in a header is a value: the header line is missing."""

_PARAMETER_SPELLINGS = {
    "t20": "t20",
    "rt20": "t20",
    "t60(20)": "t20",
    "t_20": "t20",
    "t30": "t30",
    "rt30": "t30",
    "t_30": "t30",
    "t60(30)": "t30",
    "edt": "edt",
    "t10": "edt",
    "earlydecaytime": "edt",
    "c50": "c50",
    "clarityc50": "c50",
    "c80": "c80",
    "clarityc80": "c80",
    "d50": "d50",
    "definition": "d50",
    "deutlichkeit": "d50",
    "ts": "ts",
    "centretime": "ts",
    "centertime": "ts",
    "schwerpunktzeit": "ts",
    "g": "g",
    "strength": "g",
    "soundstrength": "g",
}
_AMBIGUOUS = {"rt", "rt60", "t60", "t", "reverberationtime", "nachhallzeit", "tr"}
_COLUMN_SPELLINGS = {
    "source": "source",
    "src": "source",
    "quelle": "source",
    "sourceposition": "source",
    "receiver": "receiver",
    "rec": "receiver",
    "mic": "receiver",
    "microphone": "receiver",
    "position": "receiver",
    "pos": "receiver",
    "empfänger": "receiver",
    "mikrofon": "receiver",
    "receiverposition": "receiver",
    "measurement": "receiver",
    "parameter": "parameter",
    "quantity": "parameter",
    "metric": "parameter",
    "band": "band",
    "frequency": "band",
    "freq": "band",
    "f": "band",
    "frequenz": "band",
    "octaveband": "band",
    "centrefrequency": "band",
    "centerfrequency": "band",
    "value": "value",
    "wert": "value",
    "mean": "value",
    "unit": "unit",
    "einheit": "unit",
}
_SCALES: dict[str, dict[str, float]] = {
    "s": {"s": 1, "sec": 1, "ms": 1e-3},
    "dB": {"db": 1},
    "": {"%": 0.01, "percent": 0.01, "-": 1},
}


@dataclass(frozen=True)
class Column:
    """What a column of the table holds.

    Parameters
    ----------
    kind : str
        "source", "receiver", "parameter", "band", "value" or "unit"; "of" for values of the
        ``parameter``, the ``band`` or both.
    parameter : str
        Empty where each row names it.
    band : float
        Hz; NaN where each row names it.
    scale : float
        Value in the parameter's unit = cell * scale.
    """

    kind: str
    parameter: str = ""
    band: float = np.nan
    scale: float = 1.0

    def description(self, header: str, stated: str | None) -> str:
        """Return how the column is read; ``stated`` is the parameter that the user states."""
        if self.kind != "of":
            content = self.kind
        else:
            name = self.parameter or stated
            content = name.upper() if name else "the row's parameter"
            if np.isfinite(self.band):
                content += f" at {bands.label(self.band)}"
            if self.scale != 1:
                content += f", times {self.scale:g}"
        return f'"{header}": {content}'


def parameter_of(text: str, place: str, decay_time: str | None) -> str | None:
    """Return the parameter that a spelling means, None if none; DataError for "RT60"."""
    key = re.sub(r"[\s_]+", "", text.lower())
    if key in _PARAMETER_SPELLINGS:
        return _PARAMETER_SPELLINGS[key]
    if key in _AMBIGUOUS:
        if decay_time is None:
            raise DataError(
                f'{place}: "{shown(text)}" does not say which decay time it is; state '
                'decay_time="t20" or "t30"'
            )
        return decay_time
    return None


def frequency_of(text: str) -> float | None:
    """Return a frequency in Hz, with or without its unit, as the nominal band; None if it is none."""
    match = re.fullmatch(r"(\d{1,6}(?:[.,]\d{1,3})?)\s*(k?)(?:Hz)?", text.strip(), re.I | re.ASCII)
    if not match:
        return None
    value = float(match.group(1).replace(",", ".")) * (1000 if match.group(2) else 1)
    return bands.nominal(value) if value > 0 else None


def nominal_band(frequency: float, place: str) -> float:
    """Return a nominal band as it is; DataError for any other frequency, which may be a slip."""
    if frequency not in (12.5, 16.0, *bands.THIRD_OCTAVES):
        raise DataError(f"{place}: {frequency:g} Hz is no octave or third-octave (IEC 61260-1)")
    return frequency


def column_of(cell: str, place: str, decay_time: str | None) -> Column:
    """Return what the column of a header holds; DataError if the header does not say it."""
    match = re.fullmatch(r"([^\[\](]*(?:\(\d+\))?)\s*[\[(]?\s*([^\])]*?)\s*[\])]?", cell)
    name, unit = (match.group(1).strip(), match.group(2)) if match else (cell, "")
    frequency = frequency_of(name if not unit or unit.lower() in ("hz", "khz") else cell)
    if frequency is not None:
        frequency *= 1000 if unit.lower() == "khz" else 1
        if frequency < _LEAST_BAND:
            raise DataError(
                f'{place}: column "{shown(cell)}" is no band; is the line with the names of the '
                "columns missing?"
            )
        return Column("of", band=nominal_band(frequency, place))
    key = re.sub(r"[\s_]+", "", name.lower())
    if key in _COLUMN_SPELLINGS:
        if unit and not (_COLUMN_SPELLINGS[key] == "band" and unit.lower() == "hz"):
            raise DataError(f'{place}: column "{shown(cell)}": the unit is not known')
        return Column(_COLUMN_SPELLINGS[key])
    parameter = parameter_of(name, place, decay_time)
    if parameter is None:
        raise DataError(
            f'{place}: column "{shown(cell)}" is no parameter, band, source or receiver'
        )
    return Column("of", parameter, scale=scale_of(parameter, unit, place))


def scale_of(parameter: str, unit: str, place: str) -> float:
    """Return the factor from a unit to the parameter's own; DataError for another unit."""
    scales = _SCALES[UNITS[parameter]]
    if unit and unit.lower() not in scales:
        raise DataError(
            f'{place}: {parameter.upper()} in "{shown(unit)}"; known are {", ".join(scales)}'
        )
    return scales[unit.lower()] if unit else 1.0
