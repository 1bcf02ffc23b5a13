"""The text in which NTi Audio's XL2 reports a reverberation time (``..._RT60_..._Report.txt``).

A report is of one position: its averages over some decays by band, then every decay. Read are the
averages. "MeasUnct" is the standard uncertainty of ISO 3382-2:2008, Eq. 3 with N = 1 position and n
decays, 0.88 sqrt((1 + 1.90 / n) / (B T)) for T20: so it is in the reports that were at hand.

Read from four reports of firmware 4.94 that their owner has published; no manual was at hand.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import PureWindowsPath

from rtcal.io.table_columns import position_in
from rtcal.io.table_layout import Row, Sheet
from rtcal.io.text import decode, lines, number
from rtcal.support.errors import DataError

_START = b"XL2 RT60 Reporting"
_AVERAGES = "# rt60 average results"
_HEADER = re.compile(r"Band\s+RT60\((T[23]0)\)\s+MeasUnct", re.I)
_BANDS = re.compile(r"Band \[Hz\]:\s+(.*)")
_DECAY = re.compile(r"\d+((?:\s+(?:-\.--|\d[\d.]*))+)")
_ROUNDING = 0.0105
"""Largest difference of an average and its decays' mean in s: both are rounded to a hundredth."""
_ROW = re.compile(r"(\d[\d.]*)\s+(-\.--|\d[\d.]*)\s+(-\.--|\d[\d.]*)")


def claims(content: bytes) -> bool:
    """Return whether a file is the XL2's report of a reverberation time."""
    return _START in content[:200]


def sheets(content: bytes, path: str, where: Mapping[str, str]) -> list[Sheet]:
    """Return the averages of a report as one sheet; DataError names file and line.

    ``where`` selects rows later, and is not used here.
    """
    text = decode(content, path)
    numbered = [(n, raw.strip()) for n, _, raw in lines(text.characters)]
    at = next((i for i, (_, line) in enumerate(numbered) if line.lower() == _AVERAGES), None)
    header = next(
        ((n, m[1]) for n, line in numbered[at or 0 :] if (m := _HEADER.fullmatch(line))), None
    )
    if at is None or header is None:
        raise DataError(
            f'{path}, line 1: the XL2\'s "RT60 Average Results" with Band, RT60(T20) and MeasUnct are '
            "missing"
        )
    rows: list[Row] = [(header[0], ["Frequency [Hz]", header[1].upper(), "uncertainty"])]
    for n, line in numbered[at + 1 :]:
        if line.startswith("#"):
            break
        if m := _ROW.fullmatch(line):
            rows.append((n, [m[1], *_with_uncertainty(m[2], m[3], f"{path}, line {n}")]))
    if len(rows) < 2:
        raise DataError(f"{path}, line {header[0]}: no row of a band below the header")
    lines_after = [line for _, line in numbered[at + 1 :]]
    name = PureWindowsPath(numbered[0][1].partition(":")[2].strip()).stem
    return [
        Sheet(
            place=path,
            rows=tuple(rows),
            note=f"the XL2's report {name}, text in {text.encoding}",
            position=position_in(name) or ("", name),
            notes=(
                f"{header[1].upper()} is the average over the report's decays; its uncertainty is "
                "MeasUnct (ISO 3382-2)",
                *_contradictions(rows[1:], _decays(lines_after)),
            ),
        )
    ]


def _with_uncertainty(value: str, percent: str, place: str) -> tuple[str, str]:
    """Return a value and its uncertainty in its own unit; empty if they are missing."""
    if value.startswith("-") or not number(value, place):
        return "", ""
    if percent.startswith("-"):
        return value, ""
    return value, repr(number(value, place) * number(percent, place) / 100)


def _decays(after: list[str]) -> dict[str, list[float]]:
    """Return the times in s of every decay by band; empty without the list of decays."""
    bands = next((m[1].split() for line in after if (m := _BANDS.fullmatch(line))), [])
    times: dict[str, list[float]] = {band: [] for band in bands}
    for line in after:
        m = _DECAY.fullmatch(line)
        cells = m[1].split() if m else []
        if len(cells) == 2 * len(bands):  # a time and its correlation for every band
            for band, cell in zip(bands, cells[::2], strict=True):
                if not cell.startswith("-"):
                    times[band].append(number(cell, band))
    return times


def _contradictions(rows: list[Row], decays: dict[str, list[float]]) -> list[str]:
    """Return a note on averages that are not the mean of their decays."""
    off = []
    for _, (band, value, _u) in rows:
        times = decays.get(band, [])
        if value and decays and not times:
            off.append(f"{band} Hz (no decay)")
        elif value and times and abs(sum(times) / len(times) - float(value)) > _ROUNDING:
            off.append(
                f"{band} Hz ({value} s, of decays with a mean of {sum(times) / len(times):.2f} s)"
            )
    if not off:
        return []
    return [f"averages that are not the mean of the report's decays: {', '.join(off)}"]
