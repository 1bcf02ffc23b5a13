"""The room: its stated materials, surfaces, volume and air."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands, room_files
from rtcal.acoustics.air import Air
from rtcal.acoustics.materials import (
    ARCHIVE,
    AXES,
    LARGEST,
    LARGEST_LABORATORY_ALPHA,
    LEAST,
    CalibrationRecord,
    Geometry,
    Material,
    Surface,
    above_one_hint,
    array_of,
    in_order,
    short_name,
    stacked,
    text_name,
)
from rtcal.acoustics.scene import Scene
from rtcal.support import checks, text
from rtcal.support.errors import DataError
from rtcal.support.files import read_text, write_text
from rtcal.support.schema import read
from rtcal.support.text import LOOKS, look_alike, shortened
from rtcal.support.types import Array, read_only

__all__ = ["AXES", "CalibrationRecord", "Material", "Room", "Surface", "text_name"]
__dir__ = __all__.copy


def _relative(place: str, value: object) -> float:
    """Return a relative standard deviation; DataError unless it is 0 or more and below 1."""
    stated = checks.number(place, value)
    if not 0 <= stated < 1:
        percent = ": is it in percent?" if 1 <= stated <= 100 else ""
        raise DataError(f"{place} = {stated:g} is not a relative value from 0 to below 1{percent}")
    return stated


@dataclass(frozen=True, kw_only=True, eq=False)
class Room:
    """A room: volume, materials with their areas, absorption coefficients and their uncertainty.

    One row is one unknown of the calibration. A material that covers several surfaces is one row
    with the sum of their areas: `Room.from_surfaces` sums them and keeps them. A mapping by material,
    such as ``areas={"floor": 20, "rest": 74}``, and a pandas DataFrame are ordered by their labels.

    Parameters
    ----------
    name : str
    volume : float
        m³, from 1e-9 to 1e9.
    materials : sequence of str (n_materials,)
        Names, each once.
    areas : array (n_materials,)
        m², above 0.
    alpha : array (n_materials, n_bands)
        Absorption coefficients, 0 to 1: the prior means before a calibration, the calibrated
        coefficients after it.
    sigma : array (n_materials, n_bands)
        Their standard deviations, 0 to 1; a coefficient with 0 is not calibrated.
    centre_frequencies : array (n_bands,)
        Hz, increasing; within 1.5 % of a nominal third-octave centre they are made nominal.
    air : Air, optional
        Without it the air absorbs nothing, which is wrong above about 1 kHz.
    alpha_min : array (n_materials, n_bands), optional
        Lower bounds of the calibrated coefficients; 0 if not stated.
    scattering : array (n_materials, n_bands), optional
        Scattering coefficients, 0 to 1, for simulators.
    scattering_model : {"random", "vector"}
        What they mean; see `rtcal.simulators.tracer.ScatteringModel`.
    surfaces : sequence of Surface
        The single surfaces, if stated: the areas are their sums.
    dimensions : (x, y, z), optional
        Of a shoebox, in m, for simulators.
    scene : Scene
        Mesh, sources and receivers, for simulators; empty unless stated.
    sources : mapping of str to str
        By material, where its coefficients come from.
    band_correlation : float
        Prior correlation of one material's errors in bands an octave apart, 0 to below 1; it falls as
        band_correlation ** octaves.
    material_correlation : mapping of (material, material) to float
        Prior correlation of two materials' errors in the same band, for materials that share a source
        or a mounting.
    above_one : {"refuse", "clip"}
        What to do with coefficients above 1, which laboratories report (ISO 354: the edges of the
        specimen absorb too). Clipped ones are listed in ``clipped``.
    calibration : CalibrationRecord, optional
        Set in the room that a calibration returns, or `rtcal.calibration.archive.Archive.apply`.
    author : str
        Who made the model, for the pages of its results.
    volume_sigma : float
        Relative standard deviation of the volume, 0 to below 1; 0 takes it as exact.
    area_sigma : float, or array or mapping (n_materials,)
        Relative standard deviation of each material's area, of its own. A mapping may state some in
        m²: ``{"curtain": "1.5 m²"}``; materials that it lacks are exact.
    common_area_sigma : float
        Relative standard deviation that all areas have in common: the drawing's scale.
    common_alpha_sigma : float
        Relative standard deviation that all coefficients have in common: tables off together.
    climate_sigma : (temperature, humidity)
        Standard deviations of the air's temperature in K and relative humidity in %.

    Raises
    ------
    DataError
        If a shape or a value breaks a rule; the message names place, value and rule.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["floor", "rest"], areas=[20, 74],
    ...             alpha=[[0.4], [0.6]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])
    >>> print(room.absorption_area)
    [52.4]
    """

    name: str
    volume: float
    materials: Sequence[str]
    areas: Array
    alpha: Array
    sigma: Array
    centre_frequencies: Array
    air: Air | None = None
    alpha_min: Array | None = None
    scattering: Array | None = None
    scattering_model: Literal["random", "vector"] = "random"
    surfaces: Sequence[Surface] = ()
    dimensions: tuple[float, float, float] | None = None
    scene: Scene = field(default_factory=Scene)
    sources: Mapping[str, str] = field(default_factory=dict)
    band_correlation: float = 0.0
    material_correlation: Mapping[tuple[str, str], float] = field(default_factory=dict)
    calibration: CalibrationRecord | None = None
    author: str = ""
    volume_sigma: float = 0.0
    area_sigma: Array = 0.0  # type: ignore[assignment]
    common_area_sigma: float = 0.0
    common_alpha_sigma: float = 0.0
    climate_sigma: tuple[float, float] = (0.0, 0.0)
    above_one: InitVar[str] = "refuse"
    clipped: tuple[str, ...] = ()

    def __post_init__(self, above_one: str) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        checks.choice("above_one", above_one, ("refuse", "clip"))
        if isinstance(self.materials, str):
            raise DataError(f'materials = "{self.materials}" is one text, not a sequence of names')
        for name in ("alpha", "sigma", "areas", "materials"):
            if getattr(self, name) is None:
                raise DataError(f"{name} is missing; a room states it")
        materials = checks.listed("materials", self.materials)
        put("materials", tuple(text_name("materials", m) for m in materials))
        if blank := [m for m in self.materials if not m.strip()]:
            raise DataError(f"materials has {blank[0]!r}; a name is not blank")
        put("name", text_name("name", self.name))
        put("author", short_name("author", self.author))
        put("surfaces", checks.listed("surfaces", self.surfaces))
        put("sources", checks.mapped("sources", self.sources))
        pairs = checks.mapped("material_correlation", self.material_correlation)
        put("material_correlation", pairs)
        for name, kind in (("air", Air), ("calibration", CalibrationRecord)):
            if not isinstance(getattr(self, name), (kind, type(None))):
                raise DataError(f"{name} = {getattr(self, name)!r} is not a rtcal {kind.__name__}")
        if not all(isinstance(surface, Surface) for surface in self.surfaces):
            raise DataError("surfaces has something that is no rtcal.Surface")
        put("centre_frequencies", read_only(bands.as_bands(self.centre_frequencies)))
        put("volume", checks.positive("volume", self.volume, "m³"))
        if not LEAST <= self.volume <= LARGEST:
            raise DataError(f"volume = {self.volume:g} m³ is not from {LEAST:g} to {LARGEST:g} m³")
        n = self.n_materials
        if n == 0:
            raise DataError("materials is empty; a room has at least one material")
        if len({*self.materials}) < n:
            twice = min(m for m in self.materials if self.materials.count(m) > 1)
            raise DataError(
                f'materials has "{twice}" twice; a material is one row (Room.from_surfaces sums its '
                "surfaces)"
            )
        if alike := look_alike(self.materials):
            raise DataError(f'materials has "{alike[0]}" and "{alike[1]}", {LOOKS}')
        for name in ("areas", "alpha", "sigma", "scattering", "alpha_min"):
            stated = getattr(self, name)
            put(name, in_order(name, stated, self.materials, self.centre_frequencies))
        put("areas", read_only(array_of("areas", self.areas)))
        if self.areas.shape != (n,):
            raise DataError(
                f"areas has shape {self.areas.shape}; with {n} materials it must be ({n},)"
            )
        for material, area in zip(self.materials, self.areas, strict=True):
            if not 0 < area <= LARGEST:
                raise DataError(
                    f'areas["{material}"] = {area:g} m² is not an area above 0 and at most {LARGEST:g}'
                )
        if above_one == "clip":
            put("alpha", alpha := array_of("alpha", self.alpha))
            for i, k in np.argwhere(alpha > 1).tolist() if alpha.shape == self._shape else ():
                if alpha[i, k] > LARGEST_LABORATORY_ALPHA:
                    raise DataError(
                        f"{self.place('alpha', i, k)} = {alpha[i, k]:g} looks like percent; "
                        f'above_one = "clip" takes values up to {LARGEST_LABORATORY_ALPHA:g}, as '
                        "laboratories report them"
                    )
                put("clipped", (*self.clipped, f"{self.place('alpha', i, k)} = {alpha[i, k]:g}"))
                self.alpha[i, k] = 1.0
        for name in ("alpha", "sigma", "scattering", "alpha_min"):
            if getattr(self, name) is not None:
                put(name, self._coefficients(name))
        if self.alpha_min is not None and (low := self.alpha_min > self.alpha).any():
            i, k = np.argwhere(low)[0].tolist()
            raise DataError(
                f"{self.place('alpha', i, k)} = {self.alpha[i, k]:g} is below its own "
                f"alpha_min = {self.alpha_min[i, k]:g}"
            )
        if self.dimensions is not None:
            stated = checks.listed("dimensions", self.dimensions)
            sides = tuple(checks.positive("dimensions", side, "m") for side in stated)
            if len(sides) != 3:
                raise DataError(f"dimensions has {len(sides)} values; a shoebox has 3")
            put("dimensions", sides)
        checks.choice("scattering_model", self.scattering_model, ("random", "vector"))
        checks.instance("scene", self.scene, Scene)
        self._check_surfaces()
        self._check_correlation()
        for name in ("volume_sigma", "common_area_sigma", "common_alpha_sigma"):
            put(name, _relative(name, getattr(self, name)))
        put("area_sigma", self._area_errors())
        pair = checks.listed("climate_sigma", self.climate_sigma)
        if len(pair) != 2:
            raise DataError(f"climate_sigma has {len(pair)} values; it has K and % of humidity")
        kelvin, percent = (checks.number("climate_sigma", value) for value in pair)
        for value, unit, most in ((kelvin, "K", 20), (percent, "%", 50)):
            if not 0 <= value <= most:
                raise DataError(f"climate_sigma = {value:g} {unit} is not from 0 to {most} {unit}")
        if self.air is None and (kelvin or percent):
            raise DataError("climate_sigma is stated, but no air that it belongs to")
        put("climate_sigma", (kelvin, percent))

    @property
    def _shape(self) -> tuple[int, int]:
        return self.n_materials, self.n_bands

    def _coefficients(self, name: str) -> Array:
        """Return values from 0 to 1, (n_materials, n_bands), or raise DataError naming one."""
        array, shape = array_of(name, getattr(self, name)), self._shape
        if array.shape != shape:
            raise DataError(
                f"{name} has shape {array.shape}; it must be (n_materials, n_bands) = {shape}"
            )
        bad = ~np.isfinite(array) | (array < 0) | (array > 1)
        if bad.any():
            i, k = np.argwhere(bad)[0].tolist()
            rule = "in [0, 1]"
            if name == "sigma" and not array[i, k] > 0:
                rule = "a finite value of 0 or more"
            elif LARGEST_LABORATORY_ALPHA < array[i, k] <= 100 or (
                name != "alpha" and array[i, k] > 1.5
            ):
                rule += ": is it in percent?"
            elif name == "alpha":
                rule += above_one_hint(array[i, k])
            raise DataError(f"{self.place(name, i, k)} = {array[i, k]:g} is not {rule}")
        return read_only(array)

    def _check_surfaces(self) -> None:
        """Raise DataError unless the surfaces, if there are any, add up to the stated areas."""
        drawn = dict.fromkeys(self.materials, 0.0)
        for surface in self.surfaces:
            if surface.material not in drawn:
                raise DataError(
                    f'surface["{surface.name}"].material = "{surface.material}" is no material of '
                    f"the room; it has {', '.join(self.materials)}"
                )
            drawn[surface.material] += surface.area
        for material, area in zip(self.materials, self.areas, strict=True):
            if self.surfaces and not np.isclose(drawn[material], area, rtol=1e-9, atol=0):
                raise DataError(
                    f'areas["{material}"] = {area:g} m², but its surfaces sum to '
                    f"{drawn[material]:g} m²; change both, or leave the surfaces out (surfaces=())"
                )

    def _check_correlation(self) -> None:
        """Raise DataError unless the prior correlations of bands and materials are possible ones."""
        if not 0 <= checks.number("band_correlation", self.band_correlation) < 1:
            raise DataError(
                f"band_correlation = {self.band_correlation:g} is not from 0 to below 1"
            )
        between: dict[tuple[int, int], float] = {}
        for pair, value in self.material_correlation.items():
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise DataError(f"material_correlation: {pair!r} is not a pair of materials")
            place = f'material_correlation["{pair[0]}", "{pair[1]}"]'
            checks.number(place, value)
            if unknown := [name for name in pair if name not in self.materials]:
                raise DataError(
                    f'{place}: "{unknown[0]}" is no material of the room; it has '
                    f"{', '.join(self.materials)}"
                )
            i, j = (self.materials.index(name) for name in pair)
            if i == j or not -1 < value < 1:
                raise DataError(
                    f"{place} = {value:g} is not a value between -1 and 1 for two materials"
                )
            between[i, j] = between[j, i] = value
        named = sorted({i for i, _ in between})
        matrix = np.array([[between.get((i, j), float(i == j)) for j in named] for i in named])
        if named and np.linalg.eigvalsh(matrix)[0] <= 0:
            raise DataError("material_correlation is not positive definite: the values contradict")

    def _area_errors(self) -> Array:
        """Return the relative standard deviation of each area, (n_materials,), however it is stated.

        Raises DataError for a value that is no relative one nor a text in m², or an unknown material.
        """
        stated: Any = self.area_sigma
        if isinstance(stated, Mapping):
            if unknown := [name for name in stated if name not in self.materials]:
                raise DataError(
                    f'area_sigma["{unknown[0]}"]: no material of the room has that name; it has '
                    f"{', '.join(self.materials)}"
                )
            listed = [stated.get(name, 0.0) for name in self.materials]
        elif isinstance(stated, str) or np.ndim(stated) == 0:
            listed = [stated] * self.n_materials
        elif not np.any(listed := list(stated)):
            for value in listed:
                _relative("area_sigma", value)
            listed = [0.0] * self.n_materials  # also of a room that had other materials
        if len(listed) != self.n_materials:
            raise DataError(
                f"area_sigma has {len(listed)} values; there are {self.n_materials} materials"
            )
        values = []
        for name, value, area in zip(self.materials, listed, self.areas.tolist(), strict=True):
            place = f'area_sigma["{name}"]'
            if not isinstance(value, str):
                values.append(_relative(place, value))
                continue
            try:
                square_metres = float(value.strip().removesuffix("m²"))
            except ValueError:
                square_metres = np.nan
            if not value.strip().endswith("m²") or np.isnan(square_metres):
                raise DataError(
                    f'{place} = "{value[:40]}" is no number with the unit m² (written with ²), such as '
                    '"1.5 m²"; a share of the area is a number without quotes, such as 0.1'
                )
            if not 0 <= square_metres < area:
                raise DataError(
                    f'{place} = "{value[:40]}" is not from 0 to below the area, which is {area:g} m²'
                )
            values.append(square_metres / area)
        return read_only(np.array(values))

    def __repr__(self) -> str:
        return f"<{self._description}>"

    def _repr_html_(self) -> str:
        """Return a table of alpha ± sigma per material and band, darker where more is absorbed."""
        rows: list[list[str | text.Cell]] = [
            [
                name,
                f"{area:.4g}",
                *(
                    text.Cell(f"{alpha:.3f} ± {sigma:.3f}", float(alpha))
                    for alpha, sigma in zip(self.alpha[i], self.sigma[i], strict=True)
                ),
            ]
            for i, (name, area) in enumerate(zip(self.materials, self.areas, strict=True))
        ]
        labels = bands.labels(self.centre_frequencies)
        return text.html_table(self._description, ["α ± σ", "S / m²", *labels], rows)

    @property
    def _description(self) -> str:
        calibrated = ""
        if self.calibration is not None:
            from_archive = self.calibration.method == ARCHIVE
            calibrated = ", coefficients of an archive" if from_archive else ", calibrated"
        return (
            f'Room "{shortened(self.name)}": {self.volume:.4g} m³, {self.total_area:.4g} m², '
            f"{self.n_materials} material{'s' * (self.n_materials > 1)}, "
            f"{bands.span(self.centre_frequencies)}{calibrated}"
        )

    @property
    def n_materials(self) -> int:
        """Number of materials, the rows of ``alpha``."""
        return len(self.materials)

    @property
    def n_bands(self) -> int:
        """Number of bands, the columns of ``alpha``."""
        return len(self.centre_frequencies)

    @cached_property
    def total_area(self) -> float:
        """S, the sum of the areas in m²."""
        return float(np.sum(self.areas))

    @property
    def absorption_area(self) -> Array:
        """S'alpha, the surfaces' equivalent absorption area in m², (n_bands,)."""
        return np.asarray(self.areas @ self.alpha)

    @cached_property
    def air_attenuation(self) -> Array:
        """m in 1/m at the nominal centre frequencies, (n_bands,); 0 where no air is stated."""
        if self.air is None:
            return read_only(np.zeros(self.n_bands))
        return read_only(self.air.attenuation(self.centre_frequencies))

    @cached_property
    def is_uncertain(self) -> bool:
        """Whether the room states an uncertainty of its volume, areas or climate."""
        stated = (self.volume_sigma, self.common_area_sigma, *self.climate_sigma)
        return any(stated) or bool(self.area_sigma.any())

    @property
    def as_exact(self) -> Room:
        """The room with its volume, areas and climate as stated and taken as exact."""
        if not self.is_uncertain:
            return self
        return self.replace(
            volume_sigma=0.0, area_sigma=0.0, common_area_sigma=0.0, climate_sigma=(0.0, 0.0)
        )

    @cached_property
    def speed_of_sound(self) -> float:
        """c in m/s of the stated air; of air at 20 °C if none is stated."""
        return (self.air or Air()).speed_of_sound

    def with_air(self, air: Air | None) -> Room:
        """Return the room in another climate, to predict T there with the same coefficients.

        Only the air's attenuation and the speed of sound change; without air the climate's
        uncertainty goes.
        """
        sigma = (0.0, 0.0) if air is None else self.climate_sigma
        return self.replace(air=air, climate_sigma=sigma)

    def place(self, name: str, material: int, band: int) -> str:
        """Return the name of one value in messages: ``alpha["carpet", 500 Hz]``."""
        checks.text("name", name)
        axes = (("material", material, self.n_materials), ("band", band, self.n_bands))
        for axis, place, count in axes:
            if checks.whole(axis, place, 0) >= count:
                raise DataError(f"{axis} = {checks.shown(place)} is not from 0 to {count - 1}")
        frequency = bands.label(self.centre_frequencies[band])
        return f'{name}["{self.materials[material]}", {frequency}]'

    def material_index(self, name: str) -> int:
        """Return the row of the material ``name``; DataError if the room has none of that name."""
        return int(self.material_rows([checks.text("name", name)])[0])

    def material_rows(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Return the rows of materials, (n,); DataError as `material_index`."""
        names = checks.texts("names", names)
        rows = {name: i for i, name in enumerate(self.materials)}
        if lacking := [name for name in names if name not in rows]:
            known = ", ".join(self.materials)
            raise DataError(f'"{lacking[0]}" is no material of room "{self.name}"; it has {known}')
        return np.array([rows[name] for name in names], dtype=np.int64)

    def replace(self, **changes: Any) -> Room:
        """Return the room with some fields changed, checked like a new one.

        Raises DataError as `Room` does, and for a field that it lacks.
        """
        try:
            return replace(self, **changes)
        except TypeError as error:
            raise DataError(f"a room cannot be changed so: {error}") from error

    @classmethod
    def from_surfaces(
        cls,
        *,
        name: str,
        volume: float,
        surfaces: Iterable[Surface],
        materials: Iterable[Material],
        centre_frequencies: Sequence[float] | Array,
        air: Air | None = None,
        dimensions: tuple[float, float, float] | None = None,
        band_correlation: float = 0.0,
        material_correlation: Mapping[tuple[str, str], float] | None = None,
        calibration: CalibrationRecord | None = None,
        above_one: str = "refuse",
    ) -> Room:
        """Return the room whose area per material is the sum over its surfaces.

        A wall may be drawn as two polygons, since only the area per material counts. Materials
        without a surface are left out. Raises DataError as `Room` does, and for a surface whose
        material is not among ``materials``.
        """
        frequencies = bands.as_bands(centre_frequencies)
        return cls(
            name=name,
            volume=volume,
            centre_frequencies=frequencies,
            air=air,
            dimensions=dimensions,
            band_correlation=band_correlation,
            material_correlation={} if material_correlation is None else material_correlation,
            calibration=calibration,
            above_one=above_one,
            **stacked(
                checks.listed("surfaces", surfaces),
                checks.listed("materials", materials),
                frequencies,
            ),
        )

    @classmethod
    def from_geometry(
        cls,
        geometry: Geometry,
        *,
        name: str,
        materials: Iterable[Material],
        centre_frequencies: Sequence[float] | Array,
        **stated: Any,
    ) -> Room:
        """Return the room with the volume and surfaces of a `rtcal.simulators.Polyhedron`.

        ``stated`` goes to `from_surfaces`. Raises DataError as that does.
        """
        for needed in ("volume", "surfaces"):
            if not hasattr(geometry, needed):
                raise DataError(
                    f"geometry = {checks.shown(geometry)} has no {needed}, as a "
                    "rtcal.simulators.Polyhedron has"
                )
        return cls.from_surfaces(
            name=name,
            volume=geometry.volume,
            surfaces=geometry.surfaces,
            materials=materials,
            centre_frequencies=centre_frequencies,
            **stated,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the room as plain values for JSON, without fields that are not stated."""
        return room_files.plain(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], place: str = "room") -> Room:
        """Return the room of plain values, as `to_dict` gives them.

        Raises DataError, which begins with ``place``, for an unknown key, for a value of the wrong
        kind, and as `Room` does.
        """
        return cls(**room_files.of_plain(read(room_files.PlainRoom, data, place)))

    @classmethod
    def from_file(cls, path: str) -> Room:
        """Read a room from TOML; see `rtcal.acoustics.room_files` for the format."""
        room = cls.from_text(read_text(path, room_files.MAX_BYTES), os.fspath(path))
        return room.replace(scene=room.scene.within(Path(path).parent)) if room.scene else room

    @classmethod
    def from_text(cls, text: str, place: str) -> Room:
        """Return the room of a TOML text; messages begin with ``place``."""
        try:
            return cls(**room_files.of_text(text))
        except DataError as error:
            raise DataError(f"{place}: {error}") from error

    def to_text(self, folder: str | os.PathLike[str] | None = None) -> str:
        """Return the text of its TOML file; reading it gives the same numbers.

        The scene's mesh is named as seen from ``folder``, if that is given.
        """
        room = self if folder is None else self.replace(scene=self.scene.seen_from(folder))
        return room_files.text_of(room)

    def save(self, path: str) -> None:
        """Write the room to TOML, whole or not at all."""
        write_text(path, self.to_text(checks.path("path", path).parent))
