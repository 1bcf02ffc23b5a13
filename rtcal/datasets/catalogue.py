"""A catalogue of materials: pyroomacoustics' table, read from the installed package, and others.

The values of the table (after M. Vorländer, Auralization, 2008, Appendix) are under the MIT licence of
pyroomacoustics; ``materials.toml`` has what it lacks. They are handbook values, which need a realistic
sigma. ``material_names.toml`` has what people call them, and how their specimens are mounted.

Persons, seats and furniture are in ``pieces.toml``, with the source of each value (`piece`).
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import metadata, resources
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.priors import SigmaRule, sigma_iso_12999_2
from rtcal.acoustics.room import Material, Piece
from rtcal.datasets import lookup
from rtcal.io import pyroomacoustics
from rtcal.io.material_list import ListedMaterial, MaterialList
from rtcal.io.text import Text
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.text import shortened
from rtcal.support.types import Array

__all__ = ["material", "names", "pages", "piece", "pieces", "similar"]
__dir__ = __all__.copy

_TABLE = "pyroomacoustics"
_RENAMED = {"gypsum_board": "gypsum_board_perforated"}
"""Entries whose name hides what they are. 19.6 % of this board are holes, and alpha is 1.00 at 500 Hz;
a plain board is ``plasterboard``."""
_OTHERS = 3  # Largest number of other entries that are named beside the one that was taken
_OF_THE_THING = 2.0  # Weight of the word that names the thing, over that of others
_LEAST_LIKENESS = 0.76
"""Share of the letters that two words have in common: 0.93 for "curtains" and "curtain", 0.75 for
"sofa" and "soft"."""


def names() -> dict[str, str]:
    """Return the description of each material in the catalogue, by the material's name.

    Raises MissingDependencyError if pyroomacoustics, which has the catalogue, is not installed.
    """
    return {name: said for name, (said, _) in _entries().items()}


OPENING = "open_window"
"""Entry that is not of the table."""
_OF_OPENING = (
    "Open window, door or hole: sound that leaves does not return",
    "alpha = 1 by definition, the unit of W. C. Sabine (1900)",
)


def material(
    name: str, centre_frequencies: Sequence[float] | Array, in_situ_factor: float = 1.5
) -> Material:
    """Return a material of the catalogue: alpha, its uncertainty sigma, and its source.

    Raises DataError for an unknown name, or a band that the catalogue lacks for this material. Raises
    MissingDependencyError without pyroomacoustics.

    Parameters
    ----------
    name : str
        Name of the material: a key of `names`.
    centre_frequencies : sequence (n_bands,)
        Centre frequencies in Hz of octaves that the catalogue has, within 125 to 8000 Hz.
    in_situ_factor : float
        Factor by which sigma is larger than ISO 12999-2's standard deviation between laboratories,
        because a material in a room differs more from a table than two laboratories differ. Above
        4 kHz, where the standard has no value, sigma is that at 4 kHz. An open window's sigma is 0.
    """
    f = bands.as_bands(centre_frequencies)
    entries = _entries()
    if name not in entries:
        near = ", ".join(sorted(n for n in entries if n.split("_")[0] == name.split("_")[0]))
        raise DataError(
            f'"{name}" is not in the catalogue of {len(entries)} materials'
            + (f"; similar: {near}" if near else "")
        )
    entry = entries[name][1]
    by_band = dict(zip(entry.centre_frequencies, entry.alpha, strict=True))
    if lacking := [frequency for frequency in f if frequency not in by_band]:
        has = ", ".join(bands.labels(by_band))
        raise DataError(f'"{name}" has no value at {bands.label(lacking[0])}; it has {has}')
    alpha = np.array([by_band[frequency] for frequency in f])
    between = [
        sigma_iso_12999_2(np.array([a]), np.array([min(frequency, 4000.0)]))[0]
        for a, frequency in zip(alpha, f, strict=True)
    ]
    sigma = SigmaRule(in_situ_factor=in_situ_factor).in_situ_factor * np.array(between)
    if entry.sigma is not None:
        sigma = np.full(len(f), entry.sigma)
    return Material(name=name, alpha=alpha.tolist(), sigma=sigma.tolist(), source=entry.source)


_OCTAVES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)


def pieces() -> dict[str, str]:
    """Return, by the name of each kind of piece, the published values that its absorption area is from.

    Pieces are things that are counted, such as persons and chairs.
    """
    works = {key: each["work"] for key, each in _tabulated()["source"].items()}
    return {
        each["name"]: _FROM[len(each["row"]) > 1, "extremes" in each]
        + "; ".join(f"{row['of']} [{works[row['source']]}]" for row in each["row"])
        for each in _tabulated()["piece"]
    }


def holds(name: str) -> set[str]:
    """Return what the absorption area of a piece is of: "person", "chair", both, or neither."""
    return {*next(each.get("holds", ()) for each in _tabulated()["piece"] if each["name"] == name)}


_FROM = {
    (False, False): "",
    (True, False): "mean of ",
    (True, True): "midway between the extremes ",
}


def pages(names: Collection[str]) -> list[str]:
    """Return a line for each source of these entries: the work, and a page with a copy of its table.

    ``names`` are those of materials and pieces of the catalogue. Materials that are in pyroomacoustics'
    table have no line.
    """
    rows = (row for each in _tabulated()["piece"] if each["name"] in names for row in each["row"])
    used = {row["source"] for row in rows}
    used |= {source for source, rows in _published().items() if {*rows} & {*names}}
    return [
        f"{each['work']}: {each['page']}, read on {each['read']}"
        for key, each in _tabulated()["source"].items()
        if key in used
    ]


def piece(name: str, number: float, centre_frequencies: Sequence[float] | Array) -> Piece:
    """Return several pieces of one kind, such as chairs, with the absorption area of each piece.

    The absorption area in m² is the mean of published values (`pieces` names them). The uncertainty
    sigma of the area is the standard deviation of these values; where they are a typical lowest and
    highest one, it is that of a uniform distribution between them.

    sigma has two lower limits: 0.01 m², and a share of the area, which is the root mean square of sigma
    over area in the catalogue. A piece with one published value has this share. At 8000 Hz the ratio is
    that of 4000 Hz.

    Raises DataError for an unknown name or a band that the catalogue lacks for this piece.

    Parameters
    ----------
    name : str
        Name of the piece: a key of `pieces`.
    number : float
        Number of pieces in the room.
    centre_frequencies : sequence (n_bands,)
        Centre frequencies in Hz of octaves from 125 to 8000 Hz.

    Examples
    --------
    >>> piece("wooden chair", 40, [500, 1000]).area_per_piece
    [0.05, 0.06]
    """
    areas = _areas()
    if name not in areas:
        raise DataError(f'"{name}" is not among the pieces: {", ".join(areas)}')
    mean, relative = areas[name]
    has = [f for f, value in zip(_OCTAVES, mean, strict=True) if not np.isnan(value)]
    f = bands.as_bands(centre_frequencies).tolist()
    if other := next((each for each in f if each not in has), None):
        raise DataError(
            f'"{name}" has no value at {bands.label(other)}; it has {has[0]:g} to {has[-1]:g} Hz'
        )
    rows = [_OCTAVES.index(each) for each in f]
    area = mean[rows].round(4)
    return Piece(
        name=name,
        number=number,
        area_per_piece=area.tolist(),
        sigma=np.maximum(relative[rows] * area, _LEAST_SIGMA).round(4).tolist(),
        source=pieces()[name],
    )


_LEAST_SIGMA = 0.01  # m²: the decimals of the published values


@cache
def _areas() -> dict[str, tuple[Array, Array]]:
    """Return m² per piece in `_OCTAVES`, NaN without a value, and its relative standard deviation."""
    means, spreads = {}, {}
    for each in _tabulated()["piece"]:
        rows = np.full((len(each["row"]), len(_OCTAVES)), np.nan)
        for at, row in enumerate(each["row"]):
            rows[at, : len(row["values"])] = np.multiply(row["values"], row.get("times", 1.0))
        having = ~np.isnan(rows)
        counted = having.sum(axis=0)
        mean = np.where(having, rows, 0).sum(axis=0) / np.where(counted, counted, np.nan)
        squares = np.where(having, (rows - mean) ** 2, 0).sum(axis=0)
        # Two extremes are 2 s sqrt(3) apart, so that their squared deviations add up to 6 s².
        squares /= 6 if "extremes" in each else np.where(counted > 1, counted - 1, np.nan)
        means[each["name"]], spreads[each["name"]] = mean, np.sqrt(squares) / mean
    several = np.array([*spreads.values()])[:, : len(_OCTAVES) - 1]
    pooled = np.sqrt(np.nanmean(several**2, axis=0))
    relative = {name: np.fmax(spread[:-1], pooled) for name, spread in spreads.items()}
    return {name: (means[name], np.append(each, each[-1])) for name, each in relative.items()}


def _published() -> dict[str, dict[str, list[Any]]]:
    """Return the materials of ``materials.toml`` by the source that ``pieces.toml`` has."""
    return lookup.table("materials.toml")


def _tabulated() -> dict[str, Any]:
    """Return the sources and the pieces of ``pieces.toml``."""
    return lookup.table("pieces.toml")


def origin() -> str:
    """Return the name of the catalogue, with which the source of each of its materials begins."""
    return f"{_TABLE} {metadata.version(_TABLE)} materials.json (after Vorländer 2008)"


@cache
def _entries() -> dict[str, tuple[str, ListedMaterial]]:
    """Return the description of each material, and the material in the bands that it has."""
    try:
        # Only the data file is read; the package itself is not imported.
        with resources.as_file(resources.files(_TABLE) / "data" / "materials.json") as path:
            groups = json.loads(path.read_text(encoding="utf-8"))["absorption"].values()
            listed = pyroomacoustics.read(path).materials
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            "the catalogue needs pyroomacoustics: pip install 'rtcal[geometry]'"
        ) from error
    of_table = {name: str(entry["description"]) for of in groups for name, entry in of.items()}
    entries = [
        (replace(m, name=_RENAMED.get(m.name, m.name)), of_table[m.name], f"{origin()}: {{}}")
        for m in listed
    ]
    opened, by_definition = _OF_OPENING
    rows = [
        *(
            (name, alpha, None, said, f"{_tabulated()['source'][source]['work']}: {{}}")
            for source, of in _published().items()
            for name, (said, *alpha) in of.items()
        ),
        (OPENING, [1.0] * len(_OCTAVES), 0.0, opened, f"{{}} ({by_definition})"),
    ]
    for name, alpha, sigma, said, source in rows:
        frequencies = _OCTAVES[: len(alpha)]
        made = ListedMaterial(
            name=name,
            line=0,
            alpha=tuple(alpha),
            centre_frequencies=frequencies,
            spans=(),
            sigma=sigma,
        )
        entries.append((made, said, source))
    mounted = {n: how for how, of in lookup.table()["mounting"].items() for n in of.split()}
    return {
        m.name: (
            said,
            replace(
                m,
                source=f"{source.format(said)}; mounting: {mounted.get(m.name, 'not stated')}",
            ),
        )
        for m, said, source in entries
    }


@cache
def material_list() -> MaterialList:
    """Return the whole catalogue as a material list, each material in the bands that it has."""
    materials = tuple(m for _, m in _entries().values())
    return MaterialList(path="the catalogue", text=Text(""), materials=materials)


def found(name: str, among: Mapping[str, str] | None = None) -> list[str]:
    """Return the entry that a name means, followed by other entries that resemble the name.

    Raises DataError, with the nearest names, for a name that means no entry, such as "steel".

    >>> found("Wooden Chair", pieces()), found("Holzboden")[0]
    (['wooden chair'], 'wood_floor')
    """
    described = names() if among is None else among
    own = next((n for n in described if _plainly(n) == _plainly(name)), None)
    if own is not None:
        return [own]
    meant = _meaning(name, described)
    if meant.entry is not None:
        return [*dict.fromkeys((meant.entry, *meant.nearest, *similar(name, 1 + _OTHERS, among)))][
            : 1 + _OTHERS
        ]
    kind, option, other = "material", "its other names are pieces (`rtcal room --object`)", pieces()
    if among is not None:
        kind, option, other = "piece", "its other names are materials of surfaces", names()
    said = f'the catalogue has no {kind} like "{shortened(name, 60)}"'
    if not lookup.words(name):
        raise DataError(
            f"{said}: no name of a {kind} is in it, at most a finish, a form or what it is without"
        )
    near = [n for n in meant.nearest if n in described][:_OTHERS]
    near = near or similar(name, _OTHERS, among)
    if near:
        said += f". The nearest {'names are' if near[1:] else 'name is'} {', '.join(near)}"
    elsewhere = _meaning(name, other)
    beyond = [n for n in (elsewhere.entry, *meant.nearest) if n in other]
    if beyond:
        said += f"; {option}: {', '.join(dict.fromkeys(beyond))}"
    raise DataError(said)


def _meaning(name: str, described: Mapping[str, str]) -> lookup.Meaning:
    """Return what a name means of the materials, or of the pieces."""
    part = "pieces" if described.keys() == pieces().keys() else "names"
    return lookup.meaning(name, part, described)


def _plainly(name: str) -> str:
    return re.sub(r"[\W_]+", " ", name.lower()).strip()


def similar(name: str, most: int = 5, among: Mapping[str, str] | None = None) -> list[str]:
    """Return the catalogue's names of materials that resemble a name in your own words.

    ``name`` is your name of the material, and ``most`` the largest number of names to return. ``among``
    has the entries to choose from, descriptions by name; by default all materials of the catalogue.
    First comes the entry that the name means, if it means one (`rtcal.datasets.lookup`). The others are
    ordered by the words that they share with the name: rare words count more than frequent ones, and
    words of an entry's name more than those of its description.

    Examples
    --------
    >>> similar("vinyl floor", 1), similar("perforated metal panel", 1)
    (['linoleum_on_concrete'], ['ceiling_perforated_metal'])
    """
    described = names() if among is None else among
    meant = None if among is not None and among != pieces() else _meaning(name, described).entry
    asked, noun = lookup.words(name), lookup.name_of(name).noun
    of_entry = {n: (lookup.words(n), lookup.words(text)) for n, text in described.items()}
    scores = dict.fromkeys(described, 0.0)
    for word in asked:
        close = {
            entry: max(_closest(word, own), 0.75 * _closest(word, text))
            for entry, (own, text) in of_entry.items()
        }
        having = sum(share > 0 for share in close.values())
        weight = np.log((len(described) + 1) / (having + 1)) if having else 0.0
        weight *= _OF_THE_THING if word == noun else 1.0
        for entry, share in close.items():
            scores[entry] += weight * share
    for entry, (own, _) in of_entry.items():
        scores[entry] /= 1 + 0.02 * len(own)
    if meant is not None:
        scores[meant] = np.inf
    best = sorted((n for n, score in scores.items() if score), key=lambda n: (-scores[n], n))
    return best[:most]


def nearest(name: str, most: int = 3) -> list[str]:
    """Return catalogue entries that resemble a material's name, each as a line of text."""
    described = names()
    lines = []
    for entry in similar(name, most):
        at = material(entry, [500.0])
        lines.append(
            f"{entry}: {shortened(described[entry], 70)}, alpha {float(np.ravel(at.alpha)[0]):.2f} ± "
            f"{float(np.ravel(np.array(at.sigma, float))[0]):.2f} at 500 Hz"
        )
    return lines


def _closest(word: str, others: Collection[str]) -> float:
    """Return the largest likeness of a word to one of others; 0 below the least."""
    begun = (other for other in others if other[:2] == word[:2])
    likeness = (difflib.SequenceMatcher(None, word, other).ratio() for other in begun)
    best = max(likeness, default=0.0)
    return best if best >= _LEAST_LIKENESS else 0.0
