"""A loudspeaker's balloon from a file: SOFA (AES69), or the text of the Common Loudspeaker Format.

Of SOFA, the conventions `rtcal.io.sofa.DIRECTIVITY_CONVENTIONS` are read. Of CLF, the text that an
author writes (``<CLF1>`` and ``<CLF2>``, and ``<CIF1>`` and ``<CIF2>`` of instruments), not the binary
file that is made of it. Its balloon has a row per arc about the axis and a column per angle from it,
every 10 degrees in octaves (1) or every 5 degrees in thirds (2). The first arc goes upwards.

References: AES69-2022; the CLF group's pages (clfgroup.org). The group's specification was not at hand:
what its text looks like was taken from public descriptions and readers of it. None says to which
side the arcs turn. It is taken as the right-hand side, seen from behind the loudspeaker. It only
matters to one that radiates otherwise to its left than to its right.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.room import UPWARDS, Directivity
from rtcal.files.disk import read_bytes
from rtcal.io import sofa, text
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["read"]
__dir__ = __all__.copy

MAX_TEXT = 2**22
"""Largest size of a CLF text file in bytes: 30 third-octaves with 72 arcs of 37 levels are 0.6 MB."""
_STEP = 5  # Of the balloon that is made of SOFA's directions, in degrees
_DIRECTIONS = 12
_LARGEST_GAP = 40.0  # Largest distance of a direction from the nearest ones of the file, in degrees
_LEAST_INDEX = 1.0  # By how many dB the axis may be below the mean
_SAME_POLE = 1.0  # By how many dB the arcs may differ on the axis, where they meet
_MOST_DB, _MOST_HZ = 300.0, 40_000.0
_STEPS = {"1": 10, "2": 5}
_ARCS = {"none": 1.0, "horizontal": 0.5, "full": 0.25}
"""Share of the circle that each symmetry states; all but the first with both ends."""


def read(
    path: str | os.PathLike[str],
    frequencies: Sequence[float] | Array,
    aim: Sequence[float],
    up: Sequence[float] = UPWARDS,
) -> Directivity:
    """Return the directivity of a loudspeaker from a file of measured levels, per octave.

    The energy in an octave is the mean over the file's frequencies or third-octaves in this octave. A
    SOFA file is interpolated at every 5 degrees.

    Raises DataError for a file of another kind, a band without a frequency in the file, missing
    directions, levels that are not numbers, and an axis in which the loudspeaker does not radiate most.
    Raises MissingDependencyError for a SOFA file, if netCDF4 is not installed.

    Parameters
    ----------
    path : path
        Path of a SOFA file (``rtcal[sofa]``), or of a text in the Common Loudspeaker Format (CLF).
    frequencies : sequence of float (n_bands,)
        Octave bands in Hz.
    aim, up : (x, y, z)
        Directions in which the loudspeaker's axis and its top point, in the room's coordinates.
    """
    place = os.fspath(checks.path("path", path))
    wanted = np.atleast_1d(checks.array("frequencies", frequencies)).ravel().tolist()
    of_sofa = sofa.recognises(path)
    gains = np.array(_from_sofa(place, wanted) if of_sofa else _from_text(place, wanted))
    try:
        made = Directivity(gains=gains, aim=aim, up=up)
    except DataError as error:
        raise DataError(f"{place}: {error}") from error
    least = float(made.gains[:, 0].mean(axis=1).min())
    if least < 10 ** (-_LEAST_INDEX / 10):
        raise DataError(
            f"{place}: the source does not radiate along the file's axis, where its energy is only "
            f"{least:.2g} times the mean. Check the orientation of the balloon in the file"
        )
    return made


def _from_sofa(place: str, wanted: Sequence[float]) -> list[Array]:
    """Return a SOFA file's energy at equal angles, (n_theta, n_phi) for each band."""
    directions, energy, lines = sofa.balloon(place)
    of_bands = []
    for f in wanted:
        inside = (lines >= f / np.sqrt(2)) & (lines < f * np.sqrt(2))
        if not inside.any():
            raise DataError(f"{place}: the file has no frequency in the octave of {bands.label(f)}")
        of_bands.append(energy[:, inside].mean(axis=1))
    return list(_at_equal_angles(directions, np.array(of_bands), place))


def _at_equal_angles(directions: Array, energy: Array, place: str) -> Array:
    """Return energy (n_bands, n_directions) at equal angles, (n_bands, n_theta, n_phi).

    ``directions`` (n_directions, 3) are along the axis, above it and to its left. Each direction weighs
    the corners of the triangle of their hull in which it lies.
    """
    from scipy.spatial import ConvexHull, QhullError

    _, first = np.unique(np.round(directions, 5), axis=0, return_index=True)
    if len(first) < _DIRECTIONS:
        raise DataError(
            f"{place}: the file has {len(first)} directions, but a directivity needs at "
            f"least {_DIRECTIONS}"
        )
    points, energy = directions[first], energy[:, first]
    try:
        hull = ConvexHull(points)
    except QhullError as error:
        raise DataError(
            f"{place}: the directions do not surround the source; export the whole sphere"
        ) from error
    gap = float(np.degrees(np.arccos(np.clip(-hull.equations[:, 3], -1, 1))).max())
    if gap > _LARGEST_GAP:
        raise DataError(
            f"{place}: the directions leave gaps, in which the nearest direction is up to {gap:.0f} "
            f"degrees away, but may be {_LARGEST_GAP:.0f}. Export more directions"
        )
    corners = np.linalg.inv(points[hull.simplices])
    phi = np.radians(np.arange(0, 360, _STEP))
    rows = []
    for theta in np.radians(np.arange(0, 181, _STEP)):
        flat = np.sin(theta) * np.array([np.cos(phi), np.sin(phi)])
        wanted = np.stack([np.full(len(phi), np.cos(theta)), *flat], axis=1)
        shares = np.einsum("pi,tij->ptj", wanted, corners)
        within = shares.min(axis=2).argmax(axis=1)
        share = np.maximum(shares[np.arange(len(phi)), within], 0.0)
        share = share / share.sum(axis=1, keepdims=True)
        rows.append(np.einsum("pj,bpj->bp", share, energy[:, hull.simplices[within]]))
    return np.stack(rows, axis=1)


def _from_text(place: str, wanted: Sequence[float]) -> list[Array]:
    """Return the energy of CLF's text, (n_theta, n_phi) for each band, each of the mean 1."""
    content = read_bytes(place, MAX_TEXT)
    if b"\0" in content[:64]:
        raise DataError(
            f"{place}: this file is neither SOFA nor CLF text. The formats CF1, CF2 and "
            "GLL cannot be read; ask the manufacturer for CLF text or SOFA"
        )
    rows = [
        [cell.strip() for cell in line.split("\t")]
        for _, _, line in text.lines(text.decode(content, place).characters)
    ]
    head = next((row[0].upper() for row in rows if row[0]), "")
    if head not in {f"<C{kind}F{n}>" for kind in "LI" for n in _STEPS}:
        raise DataError(
            f"{place}: begins with {text.shown(head)!r}; CLF text must begin with <CLF1> or <CLF2>"
        )
    step = _STEPS[head[-2]]
    # What would be read otherwise than it is meant is refused.
    for tag, known in {
        "<RADIATION>": ("fullsphere",),
        "<SIGN>": ("actual",),
        "<BALLOON-ARC-ORDER>": ("default", "normal", "reversed"),
        "<BALLOON-SYMMETRY>": (*_ARCS, "rotational"),
    }.items():
        if (stated := _stated(rows, tag)) not in (*known, ""):
            raise DataError(
                f"{place}: {tag} is {text.shown(stated)!r}; it must be {' or '.join(known)}"
            )
    at = {}
    for n, row in enumerate(rows):
        if row[0].upper() == "<BAND>":
            f = _number(row[1] if len(row) > 1 else "", f"{place}, line {n + 1}", _MOST_HZ)
            at[bands.nominal(f)] = _energy(rows, n + 1, step, place)
    out = []
    for f in wanted:
        inside = [at[b] for b in at if f / np.sqrt(2) <= b < f * np.sqrt(2)]
        if not inside:
            have = ", ".join(bands.labels(at)) or "none"
            raise DataError(
                f"{place}: the file has no band in the octave of {bands.label(f)}; its bands are "
                f"{have}"
            )
        out.append(
            np.mean([Directivity(gains=[e], aim=(1, 0, 0)).gains[0] for e in inside], axis=0)
        )
    return out


def _stated(rows: Sequence[Sequence[str]], tag: str) -> str:
    """Return the word after a tag, in small letters and without brackets; "" where there is none."""
    for row in rows:
        names = [cell.upper() for cell in row]
        if tag in names:
            after = [cell for cell in row[names.index(tag) + 1 :] if cell]
            return after[0].strip("<>").lower() if after else ""
    return ""


def _energy(rows: Sequence[Sequence[str]], begin: int, step: int, place: str) -> Array:
    """Return the energy of the rows that follow a band's line, (n_theta, n_phi)."""
    arcs = []
    for n in range(begin, len(rows)):
        if rows[n][0].startswith("<"):
            break
        if any(rows[n]):
            cells = [cell for cell in rows[n] if cell]
            arcs.append([_number(cell, f"{place}, line {n + 1}") for cell in cells])
            if len(cells) != 180 // step + 1:
                raise DataError(
                    f"{place}, line {n + 1}: this arc has {len(cells)} levels, but must "
                    f"have {180 // step + 1}, one every {step} degrees"
                )
    symmetry = _stated(rows, "<BALLOON-SYMMETRY>") or "none"
    number, circle = len(arcs), 360 // step
    both_ends = symmetry in ("horizontal", "full")
    wanted = round(_ARCS[symmetry] * circle) + both_ends if symmetry in _ARCS else 1
    if number != wanted:
        raise DataError(
            f"{place}, line {begin}: the balloon has {number} arcs, but with the symmetry "
            f"{symmetry} it must have {wanted}"
        )
    level = np.array(arcs)
    if symmetry == "full":
        level = np.concatenate([level, level[-2::-1]])
    if symmetry in ("full", "horizontal"):
        level = np.concatenate([level, level[-2:0:-1]])
    if symmetry == "rotational":
        level = np.repeat(level, circle, axis=0)
    if (apart := float(np.ptp(level[:, [0, -1]], axis=0).max())) > _SAME_POLE:
        raise DataError(
            f"{place}, line {begin}: the arcs differ by {apart:.1f} dB on the axis, where "
            "they must be equal"
        )
    # phi goes to the left, CLF's arcs to the right unless they are reversed.
    if _stated(rows, "<BALLOON-ARC-ORDER>") != "reversed":
        level = np.concatenate([level[:1], level[:0:-1]])
    return np.asarray(10 ** (level.T / 10))


def _number(token: str, place: str, most: float = _MOST_DB) -> float:
    value = text.number(token.replace(",", "."), place)
    if not abs(value) <= most:
        raise DataError(f"{place}: {text.shown(token)} must be from -{most:g} to {most:g}")
    return value
