"""A room as the text of its TOML file, which `rtcal.acoustics.room_files` reads."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from rtcal.acoustics.room_files import RELATIVE


def toml_text(data: Mapping[str, Any]) -> str:
    """Return `Room.to_dict`'s dict as the text of its TOML file."""
    lines = [f"name = {_quoted(data['name'])}"]
    if "author" in data:
        lines.append(f"author = {_quoted(data['author'])}")
    lines.append(f"volume = {data['volume']!r}")
    lines.append(f"centre_frequencies = {_listed(data['centre_frequencies'])}")
    if "dimensions" in data:
        lines.append(f"dimensions = {_listed(data['dimensions'])}")
    if "clipped" in data:
        lines.append("clipped = [" + ", ".join(map(_quoted, data["clipped"])) + "]")
    if "scattering_model" in data:
        lines.append(f"scattering_model = {_quoted(data['scattering_model'])}")
    lines += [f"{name} = {data[name]!r}" for name in RELATIVE if name in data]
    if "climate_sigma" in data:
        lines.append(f"climate_sigma = {_listed(data['climate_sigma'])}")
    lines += _scene(data.get("scene", {}))
    if data["band_correlation"]:
        lines += ["", "[prior]", f"band_correlation = {data['band_correlation']!r}"]
    if data["air"] is not None:
        lines += ["", "[air]"]
        lines += [f"{key} = {float(data['air'][key])!r}" for key in sorted(data["air"])]
    if "calibration" in data:
        lines += ["", "[calibration]"]
        lines += [f"{key} = {_quoted(value)}" for key, value in data["calibration"].items()]
    surfaces = data.get("surfaces", [])
    covered = {surface["material"] for surface in surfaces}
    for i, material in enumerate(data["materials"]):
        lines += ["", "[[material]]", f"name = {_quoted(material)}"]
        if material not in covered:
            lines.append(f"area = {data['areas'][i]!r}")
        for key in ("alpha", "sigma", "alpha_min", "scattering"):
            if key in data:
                lines.append(f"{key} = {_listed(data[key][i])}")
        if data.get("area_sigma", [0.0] * (i + 1))[i]:
            lines.append(f"area_sigma = {data['area_sigma'][i]!r}")
        if material in data.get("sources", {}):
            lines.append(f"source = {_quoted(data['sources'][material])}")
    for entry in data.get("material_correlation", []):
        pair = ", ".join(map(_quoted, entry["materials"]))
        lines += ["", "[[correlation]]", f"materials = [{pair}]", f"value = {entry['value']!r}"]
    for surface in surfaces:
        lines += ["", "[[surface]]", f"name = {_quoted(surface['name'])}"]
        lines += [f"material = {_quoted(surface['material'])}", f"area = {surface['area']!r}"]
        if surface["axis"] is not None:
            lines.append(f"axis = {_quoted(surface['axis'])}")
    return "\n".join(lines) + "\n"


def _scene(tables: Mapping[str, Any]) -> list[str]:
    """Return the lines of `Scene.to_dict`'s tables."""
    lines: list[str] = []
    geometry = tables.get("geometry", {})
    if geometry:
        lines += ["", "[geometry]"]
        lines += [f"mesh = {_quoted(geometry[key])}" for key in ("mesh",) if key in geometry]
        numbers = ("unit", "position_uncertainty")
        lines += [f"{key} = {geometry[key]!r}" for key in numbers if key in geometry]
        if "surfaces" in geometry:
            lines += ["", "[geometry.surfaces]"]
            for name, faces in geometry["surfaces"].items():
                lines.append(f"{_quoted(name)} = [{', '.join(map(_quoted, faces))}]")
    for kind in ("sources", "receivers"):
        if kind in tables:
            lines += ["", f"[{kind}]"]
            lines += [f"{_quoted(n)} = {_listed(point)}" for n, point in tables[kind].items()]
    if "directivity" in tables:
        lines += ["", "[directivity]"]
    for name, of in tables.get("directivity", {}).items():
        if isinstance(of, str):
            lines.append(f"{_quoted(name)} = {_quoted(of)}")
        else:
            # JSON's texts and lists of numbers are TOML's.
            entries = ", ".join(f"{key} = {json.dumps(value)}" for key, value in of.items())
            lines.append(f"{_quoted(name)} = {{ {entries} }}")
    return lines


def _quoted(text: str) -> str:
    # A JSON string is a TOML basic string, but for DEL, which TOML wants escaped.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _listed(values: Iterable[float]) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"
