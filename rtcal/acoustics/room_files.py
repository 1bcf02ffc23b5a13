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

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.directivity import Lobe
from rtcal.acoustics.materials import CalibrationRecord, Material, Surface, stacked
from rtcal.acoustics.priors import TIERS, in_situ, sigma_iso_12999_2, sigma_relative
from rtcal.acoustics.scene import GeometryTable, Places, Scene, SceneTables
from rtcal.support.errors import DataError
from rtcal.support.files import json_numbers
from rtcal.support.schema import FileTable, Number, Share, read, toml_table, toml_text
from rtcal.support.types import Array

MAX_BYTES = 2**18
"""Largest size of a room's file in bytes: thirty times a usual one."""

PerBand = Number | list[Number]
StatedSigma = PerBand | Literal["low", "moderate", "high"]
"""A sigma, or a degree of uncertainty of `TIERS`."""
RELATIVE = ("volume_sigma", "common_area_sigma", "common_alpha_sigma")


class AirTable(FileTable):
    """Temperature in °C, relative humidity in % and pressure in kPa, as of `Air`."""

    temperature: Number = 20.0
    humidity: Number = 50.0
    pressure: Number = 101.325


class PriorTable(FileTable):
    """The rule for the sigma of materials that state none."""

    relative: Share = 0.0
    minimum: Share = 0.0
    iso_12999_2: bool = False
    in_situ_factor: Number = 1.0
    band_correlation: Number = 0.0


class MaterialTable(FileTable):
    """A ``[[material]]``."""

    name: str
    alpha: list[Number]
    area: Number | None = None
    sigma: StatedSigma | None = None
    alpha_min: PerBand = 0.0
    scattering: PerBand | None = None
    source: str = ""
    area_sigma: Number | str | None = None


class SurfaceTable(FileTable):
    """A surface; its name in a file without one is its number."""

    material: str
    area: Number
    name: str = ""
    axis: str | None = None


class Correlation(FileTable):
    """The correlation of two materials' errors in the same band."""

    materials: tuple[str, str]
    value: Number


class Record(FileTable):
    """The calibration of a calibrated room; see `CalibrationRecord`."""

    method: str
    equation: str
    measured: str
    solver: str = ""
    version: str = ""


class _Common(FileTable, kw_only=True):
    """Keys that a room's file and its plain values have in common."""

    volume: Number
    centre_frequencies: list[Number]
    name: str = "room"
    author: str = ""
    scattering_model: str = "random"
    air: AirTable | None = None
    dimensions: list[Number] | None = None
    calibration: Record | None = None
    above_one: str = "refuse"
    clipped: tuple[str, ...] = ()
    volume_sigma: Number = 0.0
    common_area_sigma: Number = 0.0
    common_alpha_sigma: Number = 0.0
    climate_sigma: tuple[Number, Number] = (0.0, 0.0)


class RoomFile(_Common):
    """A room's file; its scene's tables are those of `SceneTables`."""

    geometry: GeometryTable = msgspec.field(default_factory=GeometryTable)
    sources: Places | None = None
    receivers: Places | None = None
    directivity: dict[str, Lobe | Literal["unknown"]] = {}
    material: Annotated[list[MaterialTable], msgspec.Meta(max_length=500)] = []
    surface: Annotated[list[SurfaceTable], msgspec.Meta(max_length=5000)] = []
    correlation: Annotated[list[Correlation], msgspec.Meta(max_length=5000)] = []
    prior: PriorTable | None = None
    area_sigma: Number | str | dict[str, Number | str] = 0.0


class PlainRoom(_Common, kw_only=True):
    """A room as plain values, as `rtcal.Room.to_dict` returns them."""

    materials: list[str]
    areas: list[Number]
    alpha: list[list[Number]]
    sigma: list[list[Number]]
    alpha_min: list[list[Number]] | None = None
    scattering: list[list[Number]] | None = None
    surfaces: list[SurfaceTable] = []
    sources: dict[str, str] = {}
    scene: SceneTables = msgspec.field(default_factory=SceneTables)
    band_correlation: Number = 0.0
    material_correlation: list[Correlation] = []
    area_sigma: Number | str | list[Number | str] | dict[str, Number | str] = 0.0


def air(table: AirTable | None) -> Air | None:
    """Return the air of a table; None for None."""
    return None if table is None else Air(**msgspec.structs.asdict(table))


def _common(file: _Common) -> dict[str, Any]:
    """Return the arguments of `Room` that a file and plain values state alike."""
    record = file.calibration
    return {
        **{field: getattr(file, field) for field in _Common.__struct_fields__},
        "air": air(file.air),
        "calibration": record and CalibrationRecord(**msgspec.structs.asdict(record)),
    }


def _surfaces(tables: list[SurfaceTable]) -> list[Surface]:
    return [
        Surface(s.name or f"surface {i}", s.material, s.area, s.axis)
        for i, s in enumerate(tables, start=1)
    ]


def _correlations(tables: list[Correlation]) -> dict[tuple[str, str], float]:
    return {c.materials: c.value for c in tables}


def of_plain(data: PlainRoom) -> dict[str, Any]:
    """Return the arguments of `Room` of its plain values."""
    return {
        **{field: getattr(data, field) for field in PlainRoom.__struct_fields__},
        **_common(data),
        "scene": Scene.of(data.scene),
        "surfaces": _surfaces(data.surfaces),
        "material_correlation": _correlations(data.material_correlation),
    }


def of_text(text: str) -> dict[str, Any]:
    """Return the arguments of `Room` of a TOML text; DataError names place, value and rule."""
    content = toml_table(text)
    if content and set(content) <= set(SceneTables.__struct_fields__):
        raise DataError(
            f"{' and '.join(content)} are tables of the room's file: copy them to the end of room.toml"
        )
    file = read(RoomFile, content)
    frequencies = bands.as_bands(file.centre_frequencies)
    surfaces = _surfaces(file.surface)
    covered = {surface.material for surface in surfaces}
    refuse_repeats(file.material)
    for m in file.material:
        if m.area is not None and m.name in covered:
            raise DataError(f'area["{m.name}"] is given, and its surfaces too; give one')
        if m.area is not None:
            surfaces.append(Surface(name=m.name, material=m.name, area=m.area))
        elif m.name not in covered:
            raise DataError(f'area["{m.name}"] is missing, and no [[surface]] has it')
    materials = [material(m, frequencies, file.prior) for m in file.material]
    area_sigma = {
        name: file.area_sigma.get(name, 0.0)
        if isinstance(file.area_sigma, dict)
        else file.area_sigma
        for name in (m.name for m in file.material)
    }
    return {
        **_common(file),
        **stacked(surfaces, materials, frequencies),
        "scene": Scene.of(file),
        "band_correlation": 0.0 if file.prior is None else file.prior.band_correlation,
        "material_correlation": _correlations(file.correlation),
        "area_sigma": area_sigma | {m.name: m.area_sigma for m in file.material if m.area_sigma},
    }


def refuse_repeats(materials: Sequence[Any]) -> None:
    """Raise DataError for two materials of a file with one name."""
    names = [m.name for m in materials]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise DataError(f'material "{twice}" is given twice')


def material(table: MaterialTable, frequencies: Array, prior: PriorTable | None) -> Material:
    """Return the material of a ``[[material]]``; ``prior`` derives a sigma that is not stated.

    Raises DataError, which names the material, for another number of values than bands.
    """

    def per_band(key: str, stated: PerBand) -> list[float]:
        if not isinstance(stated, list):
            return [stated] * len(frequencies)
        if len(stated) != len(frequencies):
            raise DataError(
                f'material "{table.name}": {key} has {len(stated)} values; the room has '
                f"{len(frequencies)} bands"
            )
        return stated

    alpha, sigma = per_band("alpha", table.alpha), table.sigma
    if sigma is None:
        if prior is None:
            raise DataError(
                f'material "{table.name}" states no sigma, and the file has no [prior] to derive it '
                "from; if in doubt, write [prior] with relative = 0.3 and minimum = 0.01"
            )
        sigma = _prior_sigma(prior, alpha, frequencies)
    return Material(
        name=table.name,
        alpha=alpha,
        sigma=per_band("sigma", TIERS[sigma] if isinstance(sigma, str) else sigma),
        alpha_min=per_band("alpha_min", table.alpha_min) if table.alpha_min else 0.0,
        scattering=None if table.scattering is None else per_band("scattering", table.scattering),
        source=table.source,
    )


def _prior_sigma(prior: PriorTable, alpha: list[float], frequencies: Array) -> list[float]:
    """Return sigma by the file's [prior], for materials that state none."""
    limited = np.clip(alpha, 0, 2)  # the rules' limits; the room refuses or cuts what lies above 1
    sigma = sigma_relative(limited, prior.relative, prior.minimum)
    if prior.iso_12999_2:
        sigma = np.maximum(sigma, sigma_iso_12999_2(limited, frequencies))
    return list(map(float, in_situ(sigma, prior.in_situ_factor)))


def plain(room: Any) -> dict[str, Any]:
    """Return a `Room` as plain values for JSON, without fields that are not stated."""
    stated: dict[str, Any] = {
        name: json_numbers(values)
        for name in ("alpha_min", "scattering", "dimensions")
        if (values := getattr(room, name)) is not None
    }
    more: dict[str, Any] = {
        "surfaces": [vars(surface).copy() for surface in room.surfaces],
        "sources": dict(room.sources),
        "material_correlation": [
            {"materials": list(pair), "value": float(value)}
            for pair, value in room.material_correlation.items()
        ],
        "calibration": room.calibration and vars(room.calibration).copy(),
        "scattering_model": room.scattering_model if room.scattering_model != "random" else None,
        "scene": room.scene.to_dict(),
        "author": room.author,
        "clipped": list(room.clipped),
        **{name: getattr(room, name) for name in RELATIVE},
        "area_sigma": json_numbers(room.area_sigma) if room.area_sigma.any() else None,
        "climate_sigma": list(room.climate_sigma) if any(room.climate_sigma) else None,
    }
    return {
        "name": room.name,
        "volume": room.volume,
        "materials": list(room.materials),
        **{name: json_numbers(getattr(room, name)) for name in ("areas", "alpha", "sigma")},
        "band_correlation": float(room.band_correlation),
        "centre_frequencies": json_numbers(room.centre_frequencies),
        "air": None if room.air is None else vars(room.air).copy(),
        **stated,
        **{name: value for name, value in more.items() if value},
    }


def text_of(room: Any) -> str:
    """Return a `Room` as the text of its TOML file."""
    data = plain(room)
    surfaces = data.get("surfaces", [])
    covered = {surface["material"] for surface in surfaces}
    materials = []
    for i, name in enumerate(room.materials):
        stated: dict[str, Any] = {
            "name": name,
            "area": None if name in covered else data["areas"][i],
            **{k: data[k][i] for k in ("alpha", "sigma", "alpha_min", "scattering") if k in data},
            "area_sigma": float(room.area_sigma[i]),
            "source": room.sources.get(name),
        }
        materials.append({k: v for k, v in stated.items() if v})
    top = (
        "name",
        "author",
        "volume",
        "centre_frequencies",
        "dimensions",
        "clipped",
        "scattering_model",
        *RELATIVE,
        "climate_sigma",
    )
    tables = {
        **data.get("scene", {}),
        "prior": {k: data[k] for k in ("band_correlation",) if data[k]},
        "air": {k: float(v) for k, v in sorted((data["air"] or {}).items())},
        "calibration": data.get("calibration"),
        "material": materials,
        "correlation": data.get("material_correlation"),
        "surface": [{k: v for k, v in s.items() if v is not None} for s in surfaces],
    }
    return toml_text(
        {k: data[k] for k in top if k in data} | {k: v for k, v in tables.items() if v}
    )
