"""A catalogue of materials: pyroomacoustics' table, read from the installed package.

Its values (after M. Vorländer, Auralization, 2008, Appendix) are under the MIT licence of
pyroomacoustics. They are handbook values, which need a realistic sigma. ``material_names.toml`` has
what people call them, and how their specimens are mounted.

Pieces, such as persons and chairs, are a table here (`piece`).
"""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import metadata, resources

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.priors import SigmaRule, sigma_iso_12999_2
from rtcal.acoustics.room import Material, Piece
from rtcal.io import pyroomacoustics
from rtcal.io.material_list import MaterialList
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.text import shortened
from rtcal.support.types import Array

__all__ = ["material", "names", "piece", "similar"]
__dir__ = __all__.copy

_TABLE = "pyroomacoustics"
_RENAMED = {"gypsum_board": "gypsum_board_perforated"}
"""Entries whose name hides what they are. 19.6 % of this board are holes, and alpha is 1.00 at 500 Hz;
a plain board is ``plasterboard``."""
_PLACES = {"floor", "wall", "walls", "ceiling", "roof", "panel", "board"}
"""Words that say where a material is, and of which form, rather than which it is."""
_PEOPLE = {"audience", "chairs", "orchestra"}
_OF_A_PLACE = 0.4
_LEAST_LIKENESS = 0.76
"""Share of the letters that two words have in common: 0.93 for "curtains" and "curtain", 0.75 for
"sofa" and "soft"."""


def names() -> dict[str, str]:
    """Return the name and the description of each material in the catalogue.

    Raises MissingDependencyError without pyroomacoustics, which has the catalogue.
    """
    try:
        # Only the data file is read; the package itself is not imported.
        text = (resources.files(_TABLE) / "data" / "materials.json").read_text(encoding="utf-8")
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            "the catalogue needs pyroomacoustics: pip install 'rtcal[geometry]'"
        ) from error
    groups = json.loads(text)["absorption"].values()
    return {
        _RENAMED.get(name, name): str(entry["description"])
        for group in groups
        for name, entry in group.items()
    }


def material(
    name: str, centre_frequencies: Sequence[float] | Array, in_situ_factor: float = 1.5
) -> Material:
    """Return a material of the catalogue: alpha, its uncertainty sigma, and its source.

    Parameters
    ----------
    name : str
        Name of the material: a key of `names`.
    centre_frequencies : sequence (n_bands,)
        Centre frequencies in Hz of octaves that the catalogue has, within 125 to 8000 Hz.
    in_situ_factor : float
        Factor between sigma and ISO 12999-2's standard deviation between laboratories. Above 4 kHz,
        where the standard has no value, sigma is that at 4 kHz.

    Raises
    ------
    DataError
        For an unknown name, or a band that the catalogue lacks for this material.
    MissingDependencyError
        Without pyroomacoustics.
    """
    f = bands.as_bands(centre_frequencies)
    entries = {m.name: m for m in material_list().materials}
    if name not in entries:
        near = ", ".join(sorted(n for n in entries if n.split("_")[0] == name.split("_")[0]))
        raise DataError(
            f'"{name}" is not in the catalogue of {len(entries)} materials'
            + (f"; similar: {near}" if near else "")
        )
    by_band = dict(zip(entries[name].centre_frequencies, entries[name].alpha, strict=True))
    for frequency in f:
        if frequency not in by_band:
            has = ", ".join(bands.labels(by_band))
            raise DataError(f'"{name}" has no value at {bands.label(frequency)}; it has {has}')
    alpha = np.array([by_band[frequency] for frequency in f])
    tabulated = np.minimum(f, 4000.0)
    sigma = np.array(
        [sigma_iso_12999_2(alpha[k : k + 1], tabulated[k : k + 1])[0] for k in range(len(f))]
    )
    return Material(
        name=name,
        alpha=alpha.tolist(),
        sigma=(SigmaRule(in_situ_factor=in_situ_factor).in_situ_factor * sigma).tolist(),
        source=entries[name].source,
    )


_EN = "EN 12354-6:2003, Annex C"
_KUTTRUFF = "Kuttruff, Room Acoustics (2009), equivalent absorption area of persons"
PIECES: dict[str, tuple[str, list[float], list[float]]] = {
    "wooden chair": (_EN, [0.02, 0.02, 0.03, 0.04, 0.04, 0.04], []),
    "upholstered chair": (_EN, [0.10, 0.20, 0.25, 0.30, 0.35, 0.35], []),
    "person in a group": (
        f"{_EN}, one per 6 m², middle of typical minimum and maximum",
        [0.05, 0.10, 0.20, 0.35, 0.50, 0.65],
        [0.12, 0.45, 0.80, 0.90, 0.95, 1.00],
    ),
    "person standing": (_KUTTRUFF, [0.12, 0.24, 0.59, 0.98, 1.13, 1.12], []),
    "person standing in a heavy coat": (_KUTTRUFF, [0.17, 0.41, 0.91, 1.30, 1.43, 1.47], []),
    "musician with instrument": (_KUTTRUFF, [0.60, 0.95, 1.06, 1.08, 1.08, 1.08], []),
}
"""Source of each piece, and its absorption area in m² at 125 to 4000 Hz, for some with smallest and
largest value. The values were noted without the sources at hand and are approximate, as each piece's
``source`` says."""
_APPROXIMATE = "approximate: from memory of {}"
_OF_A_PIECE = 0.3
"""Relative standard deviation of an area per piece of which no range is known, a judgement."""


def piece(name: str, number: float, centre_frequencies: Sequence[float] | Array) -> Piece:
    """Return several pieces of one kind, such as chairs, with the absorption area of each piece.

    Its uncertainty sigma is 30 % of the value, and at least 0.01 m². For a piece with a range of
    typical values, sigma is the standard deviation of a uniform distribution over this range.

    Parameters
    ----------
    name : str
        Name of the piece: a key of `PIECES`.
    number : float
        Number of pieces in the room.
    centre_frequencies : sequence (n_bands,)
        Centre frequencies in Hz of octaves from 125 to 4000 Hz.

    Raises
    ------
    DataError
        For an unknown name or a band that the catalogue lacks.

    Examples
    --------
    >>> piece("upholstered chair", 40, [500, 1000]).area_per_piece
    [0.25, 0.3]
    """
    if name not in PIECES:
        raise DataError(f'"{name}" is not among the pieces: {", ".join(PIECES)}')
    source, low, high = PIECES[name]
    f, octaves = bands.as_bands(centre_frequencies), [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]
    if other := next((each for each in f.tolist() if each not in octaves), None):
        raise DataError(f'"{name}" has no value at {bands.label(other)}; it has 125 to 4000 Hz')
    rows = [octaves.index(each) for each in f.tolist()]
    ends = np.array([low, high or low])[:, rows]
    mean = ends.mean(axis=0)
    sigma = np.ptp(ends, axis=0) / np.sqrt(12) if high else np.maximum(_OF_A_PIECE * mean, 0.01)
    return Piece(
        name=name,
        number=number,
        area_per_piece=mean.round(4).tolist(),
        sigma=sigma.round(4).tolist(),
        source=_APPROXIMATE.format(source),
    )


def origin() -> str:
    """Return the name of the catalogue, with which the source of each of its materials begins."""
    return f"{_TABLE} {metadata.version(_TABLE)} materials.json (after Vorländer 2008)"


@cache
def material_list() -> MaterialList:
    """Return the whole catalogue as a material list, each material in the bands that it has."""
    descriptions, mounted = names(), _mounting()
    with resources.as_file(resources.files(_TABLE) / "data" / "materials.json") as path:
        listed = pyroomacoustics.read(path)
    return replace(
        listed,
        path="the catalogue",
        materials=tuple(
            replace(
                m,
                name=(name := _RENAMED.get(m.name, m.name)),
                source=f"{origin()}: {descriptions[name]}; mounting: {mounted.get(name, 'not stated')}",
            )
            for m in listed.materials
        ),
    )


def similar(name: str, most: int = 5, among: Mapping[str, str] | None = None) -> list[str]:
    """Return the names of entries whose name or description resembles a material's name.

    An entry that ``material_names.toml`` lists for this name is first. For the others, rare words count
    more than frequent ones, and words of an entry's name more than those of its description. Endings
    may differ, and words of other languages and of the trade are translated. ``most`` is the largest
    number of names. ``among`` replaces the catalogue by other entries, name to description.

    Examples
    --------
    >>> similar("vinyl floor", 1), similar("perforated metal panel", 1)
    (['linoleum_on_concrete'], ['ceiling_fibre_absorber'])
    """
    described, called = (names(), _called()) if among is None else (among, {})
    asked = _words(name)
    of_entry = {n: (_words(n), _words(text)) for n, text in described.items()}
    scores = dict.fromkeys(described, 0.0)
    for word in asked:
        close = {
            entry: max(_closest(word, own), 0.75 * _closest(word, text))
            for entry, (own, text) in of_entry.items()
        }
        having = sum(share > 0 for share in close.values())
        weight = np.log((len(described) + 1) / (having + 1)) if having else 0.0
        weight *= _OF_A_PLACE if word in _PLACES else 1.0
        for entry, share in close.items():
            scores[entry] += weight * share
    for entry, (own, _) in of_entry.items():
        people = own & _PEOPLE and not any(_closest(word, _PEOPLE) for word in asked)
        scores[entry] *= (_OF_A_PLACE if people else 1.0) / (1 + 0.02 * len(own))
    if asked in called:
        scores[called[asked]] = np.inf
    best = sorted((n for n, score in scores.items() if score), key=lambda n: (-scores[n], n))
    return best[:most]


def nearest(name: str, most: int = 3) -> list[str]:
    """Return catalogue entries that resemble a material's name, each as a line of text.

    A line has the entry's name, its construction and mounting as the source describes them, and alpha
    at 500 Hz with its sigma.
    """
    described = names()
    lines = []
    for entry in similar(name, most):
        at = material(entry, [500.0])
        lines.append(
            f"{entry}: {shortened(described[entry], 70)}, alpha {float(np.ravel(at.alpha)[0]):.2f} ± "
            f"{float(np.ravel(np.array(at.sigma, float))[0]):.2f} at 500 Hz"
        )
    return lines


@cache
def _stated() -> dict[str, dict[str, str]]:
    text = resources.files("rtcal.datasets").joinpath("material_names.toml").read_text("utf-8")
    return tomllib.loads(text)


@cache
def _called() -> dict[frozenset[str], str]:
    """Return the entry that people mean by the words of a name."""
    stated = _stated()["names"].items()
    return {_words(name): entry for entry, each in stated for name in each.split(",")}


@cache
def _mounting() -> dict[str, str]:
    """Return how the specimen of each entry is mounted."""
    stated = _stated()["mounting"].items()
    return {entry: mounting for mounting, entries in stated for entry in entries.split()}


@cache
def _catalogue_words() -> dict[str, str]:
    """Return the catalogue's word for each other one."""
    stated = _stated()["words"].items()
    return {other: word for word, others in stated for other in others.split()}


def _words(text: str) -> frozenset[str]:
    """Return the words of a name, each as the catalogue has it."""
    words = re.findall(r"[^\W\d_]{3,}", text.lower())
    return frozenset(_catalogue_words().get(word, word) for word in words)


def _closest(word: str, others: Collection[str]) -> float:
    """Return the largest likeness of a word to one of others; 0 below the least.

    The first two letters are the same: words differ in their ending, and grass is no glass.
    """
    begun = (other for other in others if other[:2] == word[:2])
    likeness = (difflib.SequenceMatcher(None, word, other).ratio() for other in begun)
    best = max(likeness, default=0.0)
    return best if best >= _LEAST_LIKENESS else 0.0
