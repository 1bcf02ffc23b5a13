"""The rooms with two effects and with one that judge the search for several effects."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.hidden_world.generate import read
from benchmarks.studies.hidden_world.populations import COUNTS, DOUBLE, TOGGLED, build
from benchmarks.studies.means.hidden_effects import name_of
from benchmarks.studies.means.judging import first_of, kept_controls, one
from benchmarks.studies.means.second_world import place
from rtcal.finder import AppliedEffect, Case
from rtcal.finder.effects import AT_1_KHZ
from rtcal.finder.means.engines import ControlRooms

DATA = {"one": "T20, EDT, T30; one configuration", "all": "two configurations, C80, G as well"}
ORDER = (9, 7, 8, 1, 2, 3, 4, 5, 6, 10, 11, 12)
"""Kinds in the order in which they act on a model: formula, area and volume first."""
BUILT_SINGLE = 100_000  # the number of the first built room with one effect, above all others
Room = tuple[int, Case, dict[str, Any], list[ControlRooms]]


def rooms(folder: str, population: int, more: int, *, double: bool) -> Iterator[Room]:
    """The rooms with two effects, or the others, whose control rooms stand."""
    cases, truths = read(population, "case"), read(population, "truth")
    order = np.random.default_rng(0).permutation(len(cases))
    for index in order:
        kept = place(folder, 1, population, "controls", int(index), "npz")
        if kept.exists() and (truths[index]["seed"][1] == DOUBLE) == double:
            case = Case.from_dict(cases[index])
            yield int(index), case, truths[index], kept_controls(case, kept)
    for index in range(more if double else 0):
        number = COUNTS[population][DOUBLE] + index
        path = place(folder, 1, population, "more", number, "json")
        yield len(cases) + index, *built(path, population, DOUBLE, number)


def pairs_from(folder: str, population: int, more: int, first: int) -> Iterator[Room]:
    """The rooms with two effects; with ``first``, the built ones from that one on."""
    begin = len(read(population, "case")) + first if first else 0
    for room in rooms(folder, population, more, double=True):
        if room[0] >= begin:
            yield room


def built_singles(folder: str, population: int, count: int) -> Iterator[Room]:
    """Rooms with one effect that are not stored with the tests, of every kind in turn."""
    for index in range(count):
        kind, number = 1 + index % len(ORDER), index // len(ORDER)
        path = place(folder, 1, population, "more_single", index, "json")
        yield (
            BUILT_SINGLE + index,
            *built(path, population, kind, COUNTS[population][kind] + number),
        )


def built(
    path: Path, population: int, kind: int, index: int
) -> tuple[Case, dict[str, Any], list[ControlRooms]]:
    """A room that is not stored with the tests, built once and kept, with its control rooms."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(build(population, kind, index)), encoding="utf-8")
    made: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    case = Case.from_dict(made["case"])
    return case, made["truth"], kept_controls(case, path.with_suffix(".npz"))


def true_effects(case: Case, truth: dict[str, Any]) -> list[AppliedEffect]:
    """The hidden effects with their true sizes, as the library states them."""
    hidden = sorted(truth["effects"], key=lambda e: ORDER.index(e["kind"]))
    return [AppliedEffect(name_of(e), true_parameters(e)) for e in hidden]


def true_parameters(hidden: dict[str, Any]) -> dict[str, float]:
    """The library's parameters of one hidden effect."""
    kind = hidden["kind"]
    if kind == 1:
        return {k: hidden[k] for k in ("temperature", "humidity")}
    if kind == 2:
        return {"area": hidden["size"]}
    if kind == 3 and "persons" in hidden:
        return {"persons": 0.51 / AT_1_KHZ * hidden["persons"]}
    if kind == 3:
        return {"absorption_area": 0.83 * hidden["size"]}
    if kind == 4:
        return {"absorption_area": hidden["size"]}
    if kind == 5:
        flow = 1000 * hidden["flow"]
        return {"thickness": hidden["depth"], "flow_resistivity": flow, "area": hidden["size"]}
    if kind == 6:
        return {"resonance": hidden["f0"], "quality": hidden["q"], "area": hidden["size"]}
    if kind == 7:
        return {"material": float(hidden["material"]), "ratio": hidden["ratio"]}
    if kind == 8:
        return {"ratio": hidden["ratio"]}
    if kind == 9:
        return {"equation": 1.0}
    if kind == 10:
        return {"aperture": hidden["size"], "volume": hidden["volume"], "alpha": hidden["alpha"]}
    if kind == 11:
        return {"scattering": hidden["scattering"]}
    return {"level": hidden["level"], "record": 2.0}


def cut(case: Case, controls: list[ControlRooms]) -> dict[str, tuple[Case, list[ControlRooms]]]:
    """The case as `DATA` says, with its control rooms."""
    return {"one": (one(case), first_of(controls)), "all": (case, controls)}


def judged_alone(truth: dict[str, Any]) -> bool:
    """Whether the room has one effect of the library, or none, and is made to look like no other."""
    kind = TOGGLED.get(truth["seed"][1], truth["seed"][1])
    return kind == 0 or kind in range(1, 13)
