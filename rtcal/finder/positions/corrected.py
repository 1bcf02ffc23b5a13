"""Room and geometry with what was found on a surface.

`rtcal.finder.means.corrected` spreads what was found over all walls, since means know no place; here it
has a surface, and so a geometry.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics.changes import Further, new_name, with_materials
from rtcal.acoustics.directivity import DirectivityFile
from rtcal.acoustics.room import Material, Room
from rtcal.acoustics.scene import Scene
from rtcal.files import disk
from rtcal.files.disk import make_folder, write_all
from rtcal.finder.finding import Candidate
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.surfaces import NEAR, face_at, patched
from rtcal.io import catt, odeon
from rtcal.io.material_list import ExportReport
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

SPECTRUM_ERROR = 0.15
"""Relative standard deviation of the alpha of what was found: by so much catalogues differ."""
HEADROOM = 0.9
"""Size over area of a patch of alpha = 1. It is drawn larger, so that a calibration can make it absorb
more as well as less."""
ROOM, MESH, CATT, ODEON = "room.toml", "room.obj", "catt.txt", "odeon.txt"
FILES = (ROOM, MESH, CATT, ODEON)


@dataclass(frozen=True, kw_only=True, eq=False)
class Corrected:
    """A room and its geometry with what was found on a surface.

    Attributes
    ----------
    case : Case
        As it was stated.
    added : Candidate
    room : Room
        With a further material. Its sigma is what the size's interval and the spectrum leave open. It
        states the simulator's scattering, and no scene: its mesh is ``geometry``. With a patch a box
        states no dimensions, since simulators of boxes know one material per wall.
    geometry : Polyhedron
    material : str
        Name of the further material.
    form : {"patch", "material"}
        Whether it has faces of its own, or the whole surface absorbs as much.
    note : str
        Why the form is another than the one that was asked for; "" if it is not.
    support : str
        Verdict, probability and rivals of what was added, in words.
    """

    case: PositionsCase
    added: Candidate
    room: Room
    geometry: Polyhedron
    material: str
    form: str
    note: str = ""
    support: str = ""

    @property
    def simulator(self) -> PathTracing:
        """The case's simulator in the corrected room. The new material scatters as its surface does."""
        return replace(
            self.case.simulator,
            room=self.room,
            geometry=self.geometry,
            scattering=self.room.scattering,
        )

    @property
    def drawn(self) -> str:
        """Why a patch has another area than was found; "" where it has that one."""
        if self.form != "patch":
            return ""
        return _drawn(self.added, self.geometry.areas[self.material])

    @property
    def in_words(self) -> list[str]:
        """The effect that was added, its form, and what the lists fill in and lack."""
        said = f"Added: {self.added.title}, {self.added.in_words}, as {self.form}"
        sure = f" ({self.support})" if self.support else ""
        rows = [f'{said}, material "{self.material}"{sure}.']
        rows += [note for note in (self.drawn, self.note) if note]
        rows += [f"{name}: {'. '.join(notes)}." for name, notes in self.filled.items()]
        return rows + [f"{name} lacks: {', '.join(lost)}." for name, lost in self.lost.items()]

    def to_dict(self) -> dict[str, Any]:
        """Return what was added as plain values."""
        return {
            "added": self.added.to_dict(),
            "form": self.form,
            "note": self.note,
            "filled": {name: list(notes) for name, notes in self.filled.items()},
            "lost": {name: list(lost) for name, lost in self.lost.items()},
        }

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write `FILES` into a folder, all or none, and return their paths.

        ``room.toml`` and its mesh, ``room.obj``, are for rtcal and any program that reads a mesh,
        ``catt.txt`` and ``odeon.txt`` lists of materials. Octaves that the room lacks have the
        coefficients of the nearest one there. In CATT's list a name has an underscore in place of a
        character that CATT does not read.
        """
        where = checks.path("folder", folder)
        contents = {
            ROOM: self._with_scene(where / MESH).to_text(where).encode(),
            MESH: self.geometry.to_text().encode(),
            **{name: content for name, (content, _) in self._lists.items()},
        }
        make_folder(where)
        write_all({where / name: content for name, content in contents.items()})
        return [where / name for name in contents]

    def _with_scene(self, mesh: Path) -> Room:
        """Return the room with its mesh, sources and receivers, as its file states it."""
        simulator = self.case.simulator
        of_files = {
            name: of
            for name, of in self.case.room.scene.directivity.items()
            if isinstance(of, DirectivityFile)
        }
        scene = Scene(
            mesh=mesh,
            sources=simulator.sources,
            receivers=simulator.receivers,
            directivity={**simulator.directivity, **of_files},  # a balloon is too much for a file
            position_uncertainty=self.case.position_uncertainty,
            surfaces=self._surfaces,
        )
        return self.room.replace(scene=scene)

    @property
    def _surfaces(self) -> dict[str, list[str]]:
        """The faces that each surface of the case has now, and the patch; none if it states none."""
        if self.case.surfaces is None:
            return {}
        before = self.case.geometry.names
        owners = {before[i]: name for name, faces in self.case.faces.items() for i in faces}
        made: dict[str, list[str]] = {}
        solid = self.geometry
        for name, material, face in zip(solid.names, solid.materials, solid.faces, strict=True):
            if name not in before:
                middle = solid.vertices[list(face)].mean(axis=0)  # of a convex piece
                patch = material == self.material
                made.setdefault(material if patch else surface_at(self.case, middle), []).append(
                    name
                )
            elif name in owners:
                made.setdefault(owners[name], []).append(name)
        return made

    @property
    def lost(self) -> dict[str, tuple[str, ...]]:
        """The entries that a list of materials does not hold, by the list's file name."""
        return {name: report.lost for name, (_, report) in self._lists.items() if report.lost}

    @property
    def filled(self) -> dict[str, tuple[str, ...]]:
        """Notes on the bands of a list that the room lacks or has in other widths, by its file name."""
        return {name: report.notes for name, (_, report) in self._lists.items() if report.notes}

    @cached_property
    def _lists(self) -> dict[str, tuple[bytes, ExportReport]]:
        """The lists of materials for CATT and ODEON, and their reports, by file name."""
        stated = self._with_scene(Path(MESH))
        # Their writers fill in a list that exists; these are new ones.
        with disk.at_once(), tempfile.TemporaryDirectory(prefix="rtcal-") as empty:
            reports = {
                CATT: catt.write(stated, Path(empty, CATT), missing_bands="nearest"),
                ODEON: odeon.write(stated, Path(empty, ODEON), missing_bands="nearest"),
            }
            return {n: (Path(empty, n).read_bytes(), r) for n, r in reports.items()}

    def __repr__(self) -> str:
        return f'<Corrected room: {self.added.title} as {self.form} "{self.material}">'


def corrected_geometry(
    case: PositionsCase, added: Candidate, form: str = "patch", at: Sequence[float] | None = None
) -> Corrected:
    """Return room and geometry with a candidate on its surface; see `PositionsFinding.apply`."""
    if form not in ("patch", "material"):
        raise DataError(f'form = "{form}" is not "patch" or "material"')
    if added.surface is None:
        raise DataError(f"{added.title} stands on no surface: there is nothing to add to one")
    material = new_name(case.room.materials, f"{added.effect} on {added.surface}")
    if form == "material":
        if at is not None:
            raise DataError('at is the middle of a patch; form = "material" is the whole surface')
        return _as_material(case, added, material)
    faces = case.faces[added.surface]
    area = added.size * max(1.0, float(added.spectrum.max()) / HEADROOM)
    middle = added.middle if at is None else at
    place = None if middle is None else point(middle)
    geometry = patched(case.geometry, faces, area, material, material, place)
    if geometry is None:
        return replace(
            _as_material(case, added, material),
            note=f'A patch of {area:.3g} m² does not fit on "{added.surface}" of '
            f"{case.areas[added.surface]:.3g} m²: the whole surface is the new material.",
        )
    # A patch that is drawn larger replaces more of its wall: the rest of it absorbs as the wall does.
    below = _replaced(case, geometry) @ case.room.alpha / area
    alpha = below + (added.spectrum - below) * added.size / area
    return _made(case, added, geometry, material, alpha, "patch")


def _replaced(case: PositionsCase, geometry: Polyhedron) -> Array:
    """Return the area of each material that is no longer in the geometry, (n_materials,) in m²."""
    stated, left = case.geometry.areas, geometry.areas
    return np.array([stated.get(m, 0.0) - left.get(m, 0.0) for m in case.room.materials])


def surface_at(case: PositionsCase, at: Sequence[float]) -> str:
    """Return the name of the surface at a place; DataError if it is far from every surface."""
    place = point(at)
    face, distance = face_at(case.geometry, place)
    name = next((n for n, faces in case.faces.items() if face in faces), None)
    if name is None or distance > NEAR:
        where = ", ".join(f"{x:g}" for x in place)
        nearest = "" if name is None else f'; the nearest is "{name}", {distance:.2g} m away'
        raise DataError(f"at = ({where}) m is on no surface{nearest}")
    return name


def point(at: Sequence[float]) -> Array:
    """Return a place as an array (3,) in m; DataError for anything else."""
    place = checks.array("at", at)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise DataError(f"at = {at!r} is not three finite numbers in m")
    return place


def _as_material(case: PositionsCase, added: Candidate, material: str) -> Corrected:
    """Return the room in which the whole surface absorbs what the candidate does."""
    faces = case.faces[str(added.surface)]
    area = float(case.geometry.face_areas[faces].sum())
    share = min(added.size / area, 1.0)
    rows = case.room.material_rows([case.geometry.materials[i] for i in faces])
    stated = np.average(case.room.alpha[rows], axis=0, weights=case.geometry.face_areas[faces])
    materials = list(case.geometry.materials)
    for i in faces:
        materials[i] = material
    geometry = replace(case.geometry, materials=materials)
    alpha = (1 - share) * stated + share * added.spectrum
    return _made(case, added, geometry, material, alpha, "material")


def _made(
    case: PositionsCase,
    added: Candidate,
    geometry: Polyhedron,
    material: str,
    alpha: Array,
    form: str,
) -> Corrected:
    room, areas = case.room, geometry.areas
    kept = [i for i, m in enumerate(room.materials) if m in areas or m not in case.geometry.areas]
    below = room.material_index(_material_below(case, added))
    deviation = np.log(max(added.high, added.size) / max(added.low, 1e-9)) / (2 * 1.645)
    sigma = alpha * np.hypot(SPECTRUM_ERROR, deviation)
    if form == "material":
        sigma = np.hypot(np.abs(alpha - room.alpha[below]) * deviation, room.sigma[below])
    # A material keeps its stated area but for what the new one takes of it in the geometry.
    sizes = (room.areas - _replaced(case, geometry))[kept]
    scattering = case.simulator.scattering
    source = [f"rtcal find: {added.title}, {added.in_words}."]
    source += [_drawn(added, areas[material])] if form == "patch" else []
    new = Material(
        material,
        np.clip(alpha, 0.0, 1.0).tolist(),
        np.minimum(np.maximum(sigma, 0.01), 1.0).tolist(),
        scattering=scattering[below].tolist(),
        source=" ".join(source).strip(),
    )
    # No scene, whose mesh is not that of the corrected geometry; and simulators of boxes know one
    # material per wall.
    stated = room.replace(
        scattering=scattering,
        scattering_model=case.simulator.scattering_model,
        surfaces=(),
        scene=Scene(),
        dimensions=None if form == "patch" else room.dimensions,
    )
    return Corrected(
        case=case,
        added=added,
        room=with_materials(
            stated,
            [Further(new, areas[material])],
            kept,
            sizes,
            surfaces=geometry.surfaces if room.surfaces else (),
        ),
        geometry=geometry,
        material=material,
        form=form,
    )


def _drawn(added: Candidate, area: float) -> str:
    """Return why a patch has another area in m² than was found; "" where it has that one."""
    if np.isclose(area, added.size, rtol=1e-3):
        return ""
    return (
        f"The patch is drawn with {area:.3g} m² for {added.size:.3g} m², and its coefficients are "
        "lower for it: so a calibration can make it absorb more as well as less."
    )


def _material_below(case: PositionsCase, added: Candidate) -> str:
    """Return the material of the largest face of the candidate's surface."""
    faces = case.faces[str(added.surface)]
    return case.geometry.materials[int(faces[np.argmax(case.geometry.face_areas[faces])])]
