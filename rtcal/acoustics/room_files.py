"""A room in TOML, the native format. The codec of `rtcal.acoustics.room.Room`.

One ``[[material]]`` per material::

    name = "Seminar room"
    author = "A. Consultant"            # optional: stands on the pages of its results
    above_one = "clip"                  # optional: cut ISO 354 coefficients above 1, and say so
    volume = 146.1                      # m³
    centre_frequencies = [500, 1000]    # Hz
    scattering_model = "random"         # optional: what scattering means; or "vector"
    volume_sigma = 0.05                 # optional: relative standard deviation of the volume
    area_sigma = 0.03                   # optional: the same of each material's area
    common_area_sigma = 0.02            # optional: the same of all areas together
    common_alpha_sigma = 0.1            # optional: the same of all coefficients together
    climate_sigma = [2, 10]             # optional: of the air's temperature (K), humidity (%)

    [geometry]                          # optional, for simulators
    mesh = "room.obj"                   # Wavefront OBJ, relative to this file; without it the room
                                        # is the box of its dimensions
    unit = 0.001                        # optional: of the mesh, in m
    position_uncertainty = 0.1          # optional: of sources and receivers, in m
    [geometry.surfaces]                 # optional: names of the faces of each surface
    "south wall" = ["face 3", "face 7"]

    [sources]                           # optional, with [receivers]: x, y and z in m
    S1 = [1.2, 3.4, 1.5]

    [receivers]
    R1 = [4.0, 2.2, 1.2]

    [directivity]                       # optional: of sources that are not omnidirectional
    S1 = { index = [3, 7], aim = [1, 0, 0] }  # dB per band, and the axis; or "unknown"; or
    S2 = { file = "s.sofa", aim = [1, 0, 0], up = [0, 0, 1] }  # a balloon, as rtcal.io.balloon reads

    [air]                               # left out: the air absorbs nothing
    temperature = 19.5                  # °C
    humidity = 41.7                     # %
    pressure = 101.325                  # kPa

    [prior]                             # for materials that state no sigma:
    relative = 0.3                      # sigma = in_situ_factor * max(relative * alpha, minimum,
    minimum = 0.01                      #                              ISO 12999-2's if asked for)
    iso_12999_2 = true                  # optional: the spread between laboratories as the least
    in_situ_factor = 1.5                # optional, 1 or more: another specimen, mounted otherwise
    band_correlation = 0.7              # optional: of one material's errors an octave apart

    [[material]]
    name = "plaster"
    area = 34.93                        # m²; or leave it out and state [[surface]]s
    alpha = [0.052, 0.052]              # 0 to 1, one per band
    sigma = 0.05                        # optional: one number, one per band, or a degree of
                                        # uncertainty: "low" 0.01, "moderate" 0.05, "high" 0.1
    alpha_min = 0.01                    # optional: lower bound of the calibrated alpha
    scattering = [0.1, 0.1]             # optional, for simulators
    source = "where alpha comes from"   # optional
    area_sigma = "1.5 m²"               # optional: in place of the room's; relative, or in m²

    [[correlation]]                     # optional: of two materials' errors in the same band
    materials = ["plaster", "concrete"]
    value = 0.5

    [[surface]]                         # optional: areas of a material are summed
    name = "north wall"
    material = "plaster"
    area = 12.0                         # m²
    axis = "x"                          # optional: the direction of its normal
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.materials import CalibrationRecord, Material, Surface, stacked
from rtcal.acoustics.priors import TIERS, in_situ, sigma_iso_12999_2, sigma_relative
from rtcal.acoustics.scene import TABLES, Scene, listed, quoted, scene_lines
from rtcal.support import checks
from rtcal.support.checks import Entries, toml_table
from rtcal.support.errors import DataError
from rtcal.support.files import json_numbers
from rtcal.support.types import Array

MAX_BYTES = 2**18
"""Largest size of a room's file in bytes: thirty times a usual one."""
MAX_ENTRIES = {"material": 500, "surface": 5000, "correlation": 5000}

_AIR = tuple(f.name for f in fields(Air))
_RECORD = ("method", "equation", "measured")
_RECORD_OPTIONAL = ("solver", "version")
_MATERIAL = ("area", "sigma", "alpha_min", "scattering", "source", "area_sigma")
RELATIVE = ("volume_sigma", "common_area_sigma", "common_alpha_sigma")
_PRIOR = ("relative", "minimum", "iso_12999_2", "in_situ_factor", "band_correlation")
_FILE = (
    "name",
    "author",
    "scattering_model",
    "air",
    "dimensions",
    "calibration",
    "above_one",
    "clipped",
    *RELATIVE,
    "climate_sigma",
)
"""Optional keys that the file and the dict have in common."""
_TABLES = (*TABLES, "area_sigma", "prior", "material", "surface", "correlation")
_NEEDED = ("volume", "materials", "areas", "alpha", "sigma", "centre_frequencies")
_OPTIONAL = (
    *_FILE,
    "alpha_min",
    "scattering",
    "surfaces",
    "sources",
    "scene",
    "band_correlation",
    "material_correlation",
    "area_sigma",
)
_PRIOR_LIMITS = (0.0, np.finfo(float).max)


def attributes(data: Mapping[str, Any], place: str = "") -> dict[str, Any]:
    """Return the arguments of `Room` from the dict that `parse` and `Room.to_dict` return.

    Raises DataError, which begins with ``place``, for an unknown key or a value of the wrong kind.
    """
    place = f"{place}: " if checks.text("place", place) else ""
    room = Entries(place, data, _NEEDED, _OPTIONAL)
    materials = room.texts("materials")
    frequencies = room.array("centre_frequencies", (None,))
    shape = (len(materials), len(frequencies))
    arguments: dict[str, Any] = {
        "name": room.text("name", "room"),
        "author": room.text("author", ""),
        "scattering_model": room.text("scattering_model", "random"),
        "scene": Scene.from_dict(data.get("scene", {}), f"{place}: scene" if place else ""),
        "volume": room.number("volume"),
        "materials": materials,
        "areas": room.array("areas", shape[:1]),
        "centre_frequencies": frequencies,
        "band_correlation": room.number("band_correlation", 0.0),
        "clipped": tuple(room.texts("clipped", [])),
        "above_one": room.text("above_one", "refuse"),
        "sources": room.mapping("sources", {}),
        "material_correlation": dict(
            _correlation(f"{room.place}material_correlation[{i}]", each)
            for i, each in enumerate(room.listed("material_correlation", []))
        ),
        "surfaces": [
            _surface(f"{room.place}surfaces[{i}]", each)
            for i, each in enumerate(room.listed("surfaces", []))
        ],
    }
    for name in ("alpha", "sigma", "alpha_min", "scattering"):
        if name in room or name in _NEEDED:
            arguments[name] = room.array(name, shape)
    for name in RELATIVE:
        arguments[name] = room.number(name, 0.0)
    arguments["area_sigma"] = data.get("area_sigma", 0.0)
    arguments["climate_sigma"] = data.get("climate_sigma", (0.0, 0.0))
    if "dimensions" in room:
        arguments["dimensions"] = tuple(_dimensions(room).tolist())
    if "air" in room:
        arguments["air"] = air(f"{room.place}air", data["air"])
    if "calibration" in room:
        record = room.entries("calibration", _RECORD, _RECORD_OPTIONAL)
        texts = {key: record.text(key) for key in record.values}
        arguments["calibration"] = CalibrationRecord(**texts)
    return arguments


def air(place: str, data: Any) -> Air | None:
    """Return the air of temperature, humidity and pressure, or None for None."""
    if data is None:
        return None
    entries = Entries(f"{place}.", data, (), _AIR)
    return Air(**{key: entries.number(key) for key in data})


def parse(text: str) -> dict[str, Any]:
    """Return a TOML text as `Room.to_dict` would; DataError names place, value and rule."""
    content = toml_table(text)
    if content and set(content) <= set(TABLES):
        raise DataError(
            f"{' and '.join(content)} are tables of the room's file: copy them to the end of room.toml"
        )
    file = Entries("", content, ("volume", "centre_frequencies"), (*_FILE, *_TABLES))
    frequencies = bands.as_bands(file.array("centre_frequencies", (None,)))
    prior = file.entries("prior", (), _PRIOR) if "prior" in file else None
    surfaces = [_surface(place, entry) for place, entry in _tables(file, "surface")]
    covered = {surface.material for surface in surfaces}
    materials: list[Material] = []
    for place, entry in _tables(file, "material"):
        stated = material(place, entry, frequencies, prior)
        if stated.name in {m.name for m in materials}:
            raise DataError(f'material "{stated.name}" is given twice')
        materials.append(stated)
        if "area" in entry and stated.name in covered:
            raise DataError(f'area["{stated.name}"] is given, and its surfaces too; give one')
        if "area" in entry:
            area = Entries(f'material "{stated.name}": ', entry, (), entry).number("area")
            surfaces.append(Surface(name=stated.name, material=stated.name, area=area))
        elif stated.name not in covered:
            raise DataError(f'area["{stated.name}"] is missing, and no [[surface]] has it')
    if not materials:
        raise DataError("no [[material]]; a room has at least one")
    rows = stacked(surfaces, materials, frequencies)
    own = {e["name"]: e["area_sigma"] for _, e in _tables(file, "material") if "area_sigma" in e}
    return {
        **{key: content[key] for key in ("volume", *_FILE) if key in content},
        "centre_frequencies": json_numbers(frequencies),
        "materials": rows["materials"],
        **{
            key: json_numbers(rows[key])
            for key in ("areas", "alpha", "sigma", "alpha_min", "scattering")
            if rows[key] is not None
        },
        "surfaces": [vars(surface) for surface in surfaces],
        "sources": rows["sources"],
        "scene": {key: content[key] for key in TABLES if key in content},
        "band_correlation": 0.0 if prior is None else prior.number("band_correlation", 0.0),
        "material_correlation": [entry for _, entry in _tables(file, "correlation")],
        "area_sigma": {
            name: own.get(name, content.get("area_sigma", 0.0)) for name in rows["materials"]
        },
    }


def _tables(file: Entries, key: str) -> Iterable[tuple[str, Mapping[str, Any]]]:
    """Return each ``[[key]]`` of a file with its place."""
    tables = file.listed(key, [])
    if len(tables) > MAX_ENTRIES[key]:
        raise DataError(f"{len(tables)} [[{key}]]; a room has at most {MAX_ENTRIES[key]}")
    return [(f"[[{key}]] {i + 1}", table) for i, table in enumerate(tables)]


def _surface(place: str, data: Any) -> Surface:
    surface = Entries(f"{place}: ", data, ("material", "area"), ("name", "axis"))
    return Surface(
        name=surface.text("name", place.removeprefix("[[").replace("]]", "")),
        material=surface.text("material"),
        area=surface.number("area"),
        axis=surface.text("axis") if "axis" in surface else None,
    )


def _correlation(place: str, data: Any) -> tuple[tuple[str, str], float]:
    entry = Entries(f"{place}: ", data, ("materials", "value"))
    pair = entry.texts("materials")
    if len(pair) != 2:
        raise DataError(f"{place}: materials = {pair!r} is not two names")
    return (pair[0], pair[1]), entry.number("value")


def _dimensions(room: Entries) -> Array:
    stated = room.values["dimensions"]
    if not isinstance(stated, list | tuple) or len(stated) != 3:
        raise DataError(
            f"{room.place}dimensions = {str(stated)[:40]} is not the three lengths of a shoebox in m"
        )
    return room.array("dimensions", (3,))


def material(
    place: str, data: Mapping[str, Any], frequencies: Array, prior: Entries | None
) -> Material:
    """Return the material of a ``[[material]]``; ``prior`` derives a sigma that is not stated."""
    name = Entries(f"{place}: ", data, ("name",), ("alpha", *_MATERIAL)).text("name")
    entry = Entries(f'material "{name}": ', data, ("name", "alpha"), _MATERIAL)
    shape = (len(frequencies),)

    def per_band(key: str) -> list[float]:
        """Return one number per band, of a list or of one number for all."""
        stated = data[key]
        if not isinstance(stated, list):
            return [entry.number(key)] * shape[0]
        values: list[float] = entry.array(key, shape).tolist()
        return values

    alpha = entry.array("alpha", shape)
    if isinstance(data.get("sigma"), str):
        sigma = [TIERS[entry.choice("sigma", TIERS)]] * shape[0]
    elif "sigma" in entry:
        sigma = per_band("sigma")
    elif prior is not None:
        sigma = _prior_sigma(prior, alpha, frequencies).tolist()
    else:
        raise DataError(
            f'material "{name}" states no sigma, and the file has no [prior] to derive it from; if in '
            "doubt, write [prior] with relative = 0.3 and minimum = 0.01"
        )
    return Material(
        name=name,
        alpha=alpha.tolist(),
        sigma=sigma,
        alpha_min=per_band("alpha_min") if "alpha_min" in entry else 0.0,
        scattering=per_band("scattering") if "scattering" in entry else None,
        source=entry.text("source", ""),
    )


def _prior_sigma(prior: Entries, alpha: Array, frequencies: Array) -> Array:
    """Return sigma by the file's [prior], for materials that state none."""
    alpha = np.clip(alpha, 0, 2)  # the rules' limits; the room refuses or cuts what lies above 1
    sigma = sigma_relative(
        alpha,
        prior.number("relative", 0.0, (0.0, 1.0)),
        prior.number("minimum", 0.0, (0.0, 1.0)),
    )
    if prior.flag("iso_12999_2", False):
        sigma = np.maximum(sigma, sigma_iso_12999_2(alpha, frequencies))
    return in_situ(sigma, prior.number("in_situ_factor", 1.0, _PRIOR_LIMITS))


def author(text: str) -> str:
    """Return who made the room of a TOML text; "" if the text does not say or is no room."""
    try:
        stated = toml_table(text).get("author", "")
    except DataError:
        return ""
    return stated if isinstance(stated, str) else ""


def plain(room: Any) -> dict[str, Any]:
    """Return a `Room` as plain values for JSON, without fields that are not stated."""
    stated: dict[str, Any] = {
        name: json_numbers(values)
        for name in ("alpha_min", "scattering", "dimensions")
        if (values := getattr(room, name)) is not None
    }
    if room.surfaces:
        stated["surfaces"] = [vars(surface).copy() for surface in room.surfaces]
    if room.sources:
        stated["sources"] = dict(room.sources)
    if room.material_correlation:
        stated["material_correlation"] = [
            {"materials": list(pair), "value": float(value)}
            for pair, value in room.material_correlation.items()
        ]
    if room.calibration is not None:
        stated["calibration"] = vars(room.calibration).copy()
    if room.scattering_model != "random":
        stated["scattering_model"] = room.scattering_model
    if room.scene:
        stated["scene"] = room.scene.to_dict()
    if room.author:
        stated["author"] = room.author
    if room.clipped:
        stated["clipped"] = list(room.clipped)
    stated |= {name: value for name in RELATIVE if (value := getattr(room, name))}
    if room.area_sigma.any():
        stated["area_sigma"] = json_numbers(room.area_sigma)
    if any(room.climate_sigma):
        stated["climate_sigma"] = list(room.climate_sigma)
    return {
        "name": room.name,
        "volume": room.volume,
        "materials": list(room.materials),
        **{name: json_numbers(getattr(room, name)) for name in ("areas", "alpha", "sigma")},
        "band_correlation": float(room.band_correlation),
        "centre_frequencies": json_numbers(room.centre_frequencies),
        "air": None if room.air is None else vars(room.air).copy(),
        **stated,
    }


def toml_text(data: Mapping[str, Any]) -> str:
    """Return `Room.to_dict`'s dict as the text of its TOML file."""
    lines = [f"name = {quoted(data['name'])}"]
    if "author" in data:
        lines.append(f"author = {quoted(data['author'])}")
    lines.append(f"volume = {data['volume']!r}")
    lines.append(f"centre_frequencies = {listed(data['centre_frequencies'])}")
    if "dimensions" in data:
        lines.append(f"dimensions = {listed(data['dimensions'])}")
    if "clipped" in data:
        lines.append("clipped = [" + ", ".join(map(quoted, data["clipped"])) + "]")
    if "scattering_model" in data:
        lines.append(f"scattering_model = {quoted(data['scattering_model'])}")
    lines += [f"{name} = {data[name]!r}" for name in RELATIVE if name in data]
    if "climate_sigma" in data:
        lines.append(f"climate_sigma = {listed(data['climate_sigma'])}")
    lines += scene_lines(data.get("scene", {}))
    if data["band_correlation"]:
        lines += ["", "[prior]", f"band_correlation = {data['band_correlation']!r}"]
    if data["air"] is not None:
        lines += ["", "[air]"]
        lines += [f"{key} = {float(data['air'][key])!r}" for key in sorted(data["air"])]
    if "calibration" in data:
        lines += ["", "[calibration]"]
        lines += [f"{key} = {quoted(value)}" for key, value in data["calibration"].items()]
    surfaces = data.get("surfaces", [])
    covered = {surface["material"] for surface in surfaces}
    for i, material in enumerate(data["materials"]):
        lines += ["", "[[material]]", f"name = {quoted(material)}"]
        if material not in covered:
            lines.append(f"area = {data['areas'][i]!r}")
        for key in ("alpha", "sigma", "alpha_min", "scattering"):
            if key in data:
                lines.append(f"{key} = {listed(data[key][i])}")
        if data.get("area_sigma", [0.0] * (i + 1))[i]:
            lines.append(f"area_sigma = {data['area_sigma'][i]!r}")
        if material in data.get("sources", {}):
            lines.append(f"source = {quoted(data['sources'][material])}")
    for entry in data.get("material_correlation", []):
        pair = ", ".join(map(quoted, entry["materials"]))
        lines += ["", "[[correlation]]", f"materials = [{pair}]", f"value = {entry['value']!r}"]
    for surface in surfaces:
        lines += ["", "[[surface]]", f"name = {quoted(surface['name'])}"]
        lines += [f"material = {quoted(surface['material'])}", f"area = {surface['area']!r}"]
        if surface["axis"] is not None:
            lines.append(f"axis = {quoted(surface['axis'])}")
    return "\n".join(lines) + "\n"
