"""The room with what was found on a surface, or of the second of two states, and its geometry.

`rtcal.finder.means.corrected` spreads what was found over all walls, since means know no place. A
candidate at positions has a surface, and so a geometry. Of two states the room is made of the measured
difference, band by band, and not of an effect with its parameters.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.changes import new_name
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import CHANGED, POSITION, Directivity, Material, Room, Scene
from rtcal.calibration.methods import calibrate
from rtcal.files import disk
from rtcal.files.disk import make_folder, write_all
from rtcal.finder.claim import Candidate
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.surfaces import NEAR, face_at, of_geometry, patched
from rtcal.finder.states.case import StatesCase
from rtcal.io import catt, odeon
from rtcal.io.material_list import ExportReport
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import listed
from rtcal.support.types import Array

SPECTRUM_ERROR = 0.15
"""Relative standard deviation of the alpha of what was found: by so much catalogues differ."""
HEADROOM = 0.9
"""Size over area of a patch of alpha = 1. It is drawn larger, so that a calibration can make it absorb
more as well as less."""
ROOM, MESH, CATT, ODEON = "room.toml", "room.obj", "catt.txt", "odeon.txt"
_LEAST_SIGMA = 0.01
_NOTED = 0.05
"""Share of a change that does not fit, from which on a note says so."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Corrected:
    """A room with what was found, and its geometry where that stands on a surface.

    Attributes
    ----------
    case : PositionsCase or StatesCase
    room : Room
        Without a mesh, which is ``geometry``. A material that was added has a sigma of what the size's
        interval and the spectrum leave open. With a patch a box states no dimensions, since simulators
        of boxes know one material per wall. Of two states its coefficients are those of a calibration
        to the first state, with the change's mean; their sigma is the calibration's and the change's.
    geometry : Polyhedron or None
        None where no surface is claimed.
    surfaces : tuple of str
        Those that have changed, each with a material of its own; empty where all materials share it.
    notes : tuple of str
        Why the form is another than the one that was asked for, what the room does not hold, and what
        was assumed.
    added : Candidate or None
        None of two states.
    material, form : str
        Name of the candidate's material, and "patch" where it has faces of its own, or "material" where
        the whole surface absorbs as much.
    support : str
        Verdict, probability and rivals of what was added, in words.
    """

    case: PositionsCase | StatesCase
    room: Room
    geometry: Polyhedron | None = None
    surfaces: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    added: Candidate | None = None
    material: str = ""
    form: str = ""
    support: str = ""

    @property
    def simulator(self) -> PathTracing:
        """The case's simulator in the corrected room. The new material scatters as its surface does."""
        if self.case.simulator is None or self.geometry is None:
            raise DataError("no surface is claimed: the room has no geometry of its own")
        return replace(
            self.case.simulator,
            room=self.room,
            geometry=self.geometry,
            scattering=self.room.scattering,
        )

    @property
    def in_words(self) -> list[str]:
        """The effect that was added, its form, and what room and lists do not hold."""
        rows = list(self.notes)
        if self.added is not None:
            sure = f" ({self.support})" if self.support else ""
            said = f"Added: {self.added.title}, {self.added.in_words}, as {self.form}"
            rows = [f'{said}, material "{self.material}"{sure}.', *rows]
        rows += [f"{name}: {'. '.join(notes)}." for name, notes in self.filled.items()]
        return rows + [f"{name} lacks: {', '.join(lost)}." for name, lost in self.lost.items()]

    def to_dict(self) -> dict[str, Any]:
        """Return what was added or changed as plain values."""
        if self.added is None:
            notes = list(self.notes)
            return {
                "surfaces": list(self.surfaces),
                "room": self.room.to_dict(),
                "notes": notes,
            }
        return {
            "added": self.added.to_dict(),
            "form": self.form,
            "note": " ".join(self.notes),
            "filled": {name: list(notes) for name, notes in self.filled.items()},
            "lost": {name: list(lost) for name, lost in self.lost.items()},
        }

    def contents(self, folder: Path) -> dict[Path, bytes]:
        """Return the content of each file of the room in a folder, as `save` writes them."""
        made = {ROOM: self._with_scene(folder / MESH).to_text(folder).encode()}
        if self.geometry is not None:
            made[MESH] = self.geometry.to_text().encode()
        made |= {name: content for name, (content, _) in self._lists.items()}
        return {folder / name: content for name, content in made.items()}

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write the room's files into a folder, all or none, and return their paths.

        ``room.toml`` and, where a surface is claimed, its mesh ``room.obj`` are for rtcal and any
        program that reads a mesh; of an effect ``catt.txt`` and ``odeon.txt`` are lists of materials.
        Octaves that the room lacks have the coefficients of the nearest one there. In CATT's list a
        name has an underscore in place of a character that CATT does not read.
        """
        where = checks.path("folder", folder)
        contents = self.contents(where)
        make_folder(where)
        write_all(contents)
        return [*contents]

    def _with_scene(self, mesh: Path) -> Room:
        """Return the room with its mesh, sources and receivers, as its file states it."""
        simulator = self.case.simulator
        if self.geometry is None or simulator is None:
            return self.room
        of_files = {
            name: of
            for name, of in self.case.room.scene.directivity.items()
            if isinstance(of, Directivity) and of.file is not None
        }
        scene = Scene(
            mesh=mesh,
            sources=simulator.sources,
            receivers=simulator.receivers,
            directivity={**simulator.directivity, **of_files},  # a balloon is too much for a file
            position_uncertainty=getattr(self.case, "position_uncertainty", POSITION),
            surfaces=self._faces(self.geometry),
        )
        return self.room.replace(scene=scene)

    def _faces(self, solid: Polyhedron) -> dict[str, list[str]]:
        """The faces that each surface of the case has now, and the patch; none if it states none."""
        case = self.case
        if not isinstance(case, PositionsCase) or case.surfaces is None:
            return {}
        before = case.geometry.names
        owners = {before[i]: name for name, faces in case.faces.items() for i in faces}
        made: dict[str, list[str]] = {}
        for name, material, face in zip(solid.names, solid.materials, solid.faces, strict=True):
            owner = owners.get(name, "")
            if name not in before:
                middle = solid.vertices[list(face)].mean(axis=0)  # of a convex piece
                owner = material if material == self.material else surface_at(case, middle)
            if owner:
                made.setdefault(owner, []).append(name)
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
        if self.added is None:
            return {}
        stated = self._with_scene(Path(MESH))
        # Their writers fill in a list that exists; these are new ones.
        with disk.at_once(), tempfile.TemporaryDirectory(prefix="rtcal-") as empty:
            reports = {
                CATT: catt.write(stated, Path(empty, CATT), missing_bands="nearest"),
                ODEON: odeon.write(stated, Path(empty, ODEON), missing_bands="nearest"),
            }
            return {n: (Path(empty, n).read_bytes(), r) for n, r in reports.items()}

    def __repr__(self) -> str:
        on = listed([f'"{name}"' for name in self.surfaces]) if self.surfaces else "all materials"
        what = "second state" if self.added is None else self.added.title
        return f"<Corrected room: {what} on {on}>"


def corrected_geometry(
    case: PositionsCase, added: Candidate, form: str = "patch", at: Sequence[float] | None = None
) -> Corrected:
    """Return room and geometry with a candidate on its surface; see `rtcal.finder.Finding.apply`."""
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
        note = (
            f'A patch of {area:.3g} m² does not fit on "{added.surface}" of '
            f"{case.areas[added.surface]:.3g} m²: the whole surface is the new material."
        )
        return replace(_as_material(case, added, material), notes=(note,))
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
    weights = case.geometry.face_areas[faces]
    share = min(added.size / float(weights.sum()), 1.0)
    rows = case.room.material_rows([case.geometry.materials[i] for i in faces])
    stated = np.average(case.room.alpha[rows], axis=0, weights=weights)
    geometry = _with_material(case.geometry, {material: faces})
    alpha = (1 - share) * stated + share * added.spectrum
    return _made(case, added, geometry, material, alpha, "material")


def _with_material(geometry: Polyhedron, faces: dict[str, NDArray[np.intp]]) -> Polyhedron:
    """Return the geometry with these materials on these faces."""
    materials = list(geometry.materials)
    for material, numbers in faces.items():
        for i in numbers.tolist():
            materials[i] = material
    return replace(geometry, materials=materials)


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
    faces = case.faces[str(added.surface)]
    largest = int(faces[np.argmax(case.geometry.face_areas[faces])])
    below = room.material_index(case.geometry.materials[largest])
    deviation = np.log(max(added.high, added.size) / max(added.low, 1e-9)) / (2 * NORMAL_90)
    sigma = alpha * np.hypot(SPECTRUM_ERROR, deviation)
    if form == "material":
        sigma = np.hypot(np.abs(alpha - room.alpha[below]) * deviation, room.sigma[below])
    drawn = []
    if form == "patch" and not np.isclose(areas[material], added.size, rtol=1e-3):
        drawn = [
            f"The patch is drawn with {areas[material]:.3g} m² for {added.size:.3g} m², and its "
            "coefficients are lower for it: so a calibration can make it absorb more as well as less."
        ]
    simulator = case.simulator
    new = Material(
        material,
        np.clip(alpha, 0.0, 1.0).tolist(),
        np.clip(sigma, _LEAST_SIGMA, 1.0).tolist(),
        scattering=simulator.scattering[below].tolist(),
        source=" ".join([f"rtcal find: {added.title}, {added.in_words}.", *drawn]),
        area=areas[material],
    )
    stated = _stated(room, simulator)
    # A material keeps its stated area but for what the new one takes of it in the geometry.
    left = (room.areas - _replaced(case, geometry)).tolist()
    corrected = stated.with_rows(
        [*(replace(stated.material(room.materials[i]), area=left[i]) for i in kept), new],
        # Simulators of boxes know one material per wall.
        dimensions=None if form == "patch" else room.dimensions,
        surfaces=geometry.surfaces if room.surfaces else (),
    )
    return Corrected(
        case=case,
        room=corrected,
        geometry=geometry,
        surfaces=(str(added.surface),),
        notes=tuple(drawn),
        added=added,
        material=material,
        form=form,
    )


def _stated(room: Room, simulator: PathTracing) -> Room:
    """Return the room with the simulator's scattering, and no scene: its mesh is another one's."""
    return room.replace(
        scattering=simulator.scattering,
        scattering_model=simulator.scattering_model,
        surfaces=(),
        scene=Scene(),
    )


def changed_room(
    case: StatesCase, area: Array, change: Array, surfaces: Sequence[str], kinds: Sequence[str]
) -> Corrected:
    """Return the room of the second state; see `rtcal.finder.Finding.apply`.

    Parameters
    ----------
    case : Case
    area, change : array (n_bands,), (3, n_bands)
        Absorption area before and its change in m², as of `Finding`.
    surfaces : sequence of str
        Those that are claimed.
    kinds : sequence of str
        What may have changed.
    """
    room_bands = case.room.centre_frequencies
    before = calibrate(
        case.room.replace(calibration=None),
        case.differences.before,
        equation=case.equation,
        unreachable="nearest",
    ).room
    # T before, not that of the changed room, stays on record: it is not to count twice.
    before = before.replace(calibration=replace(cast("Any", before.calibration), method=CHANGED))
    change = np.where(np.isfinite(change), change, 0.0)
    spread = (change[2] - change[1]) / (2 * NORMAL_90)
    notes = []
    unknown = room_bands[~case.differences.measured].tolist()
    if unknown:
        at = listed(bands.labels(unknown))
        notes.append(f"Nothing is known of {at}: there the room is that of the first state.")
    geometry: Polyhedron | None = None
    if surfaces and case.simulator is not None:
        room, geometry, lacking = _on_surfaces(case.simulator, surfaces, before, change[0], spread)
    else:
        alpha, sigma, lacking = _absorbing(
            before.alpha, before.sigma, before.areas, change[0], spread
        )
        changed = (alpha != before.alpha).any(axis=1)
        each = zip(before.materials, changed.tolist(), strict=True)
        sources = {name: _source([before.sources.get(name, "")]) for name, so in each if so}
        room = before.replace(alpha=alpha, sigma=sigma, sources={**before.sources, **sources})
        notes.append("Where it changed is not told: every material has its share.")
    for k in np.flatnonzero(np.abs(lacking) > _NOTED * np.abs(change[0])).tolist():
        notes.append(
            f"At {bands.label(room_bands[k])} {abs(lacking[k]):.1f} m² of the change of "
            f"{change[0, k]:+.1f} m² do not fit on what has changed."
        )
    off = before.areas @ before.alpha - area
    for k in np.flatnonzero(np.abs(off) > _NOTED * area).tolist():
        notes.append(
            f"At {bands.label(room_bands[k])} no coefficients of the room give T before: its "
            f"absorption area is off by {off[k]:+.1f} m²."
        )
    if len(kinds) > 1:
        notes.append(
            f"What it is made of is not told ({listed(kinds)}): its amount is in the room."
        )
    return Corrected(
        case=case,
        room=room,
        geometry=geometry,
        surfaces=() if geometry is None else tuple(surfaces),
        notes=tuple(notes),
    )


def _source(stated: Sequence[str]) -> str:
    """Return the source of a material that changed, of the sources of what was there."""
    return "; ".join([*filter(None, dict.fromkeys(stated)), "changed by rtcal find: two states"])


def _absorbing(
    alpha: Array, sigma: Array, areas: Array, change: Array, spread: Array
) -> tuple[Array, Array, Array]:
    """Return alpha and sigma with a change of the absorption area, and what of it did not fit.

    ``alpha`` and ``sigma`` are (n, n_bands), ``areas`` (n,), and the others in m² (n_bands,).
    """
    more = change > 0
    by_share = np.where(more, 1 - alpha, alpha)
    room = np.maximum(areas @ by_share, 1e-9)
    share = np.clip(change / room, -1.0, 1.0)
    new = np.clip(alpha + share * by_share, 0.0, 1.0)
    wide = np.hypot(sigma, by_share * spread / room)
    return new, np.clip(wide, _LEAST_SIGMA, 1.0), change - areas @ (new - alpha)


def _on_surfaces(
    simulator: PathTracing, surfaces: Sequence[str], before: Room, change: Array, spread: Array
) -> tuple[Room, Polyhedron, Array]:
    """Return room and geometry in which each claimed surface has a material of its own."""
    geometry, faces = simulator.geometry, of_geometry(simulator.geometry)
    scattering, left = simulator.scattering, before.areas.copy()
    rows, names, areas, sources = [], [], [], []
    taken = list(before.materials)
    for surface in surfaces:
        of_face = before.material_rows([geometry.materials[i] for i in faces[surface]])
        sizes = geometry.face_areas[faces[surface]]
        weights = np.bincount(of_face, sizes, before.n_materials)
        rows.append(weights / weights.sum())
        areas.append(float(weights.sum()))
        left = np.maximum(left - weights, 0.0)
        below = [before.materials[i] for i in np.flatnonzero(weights).tolist()]
        sources.append(_source([before.sources.get(name, "") for name in below]))
        names.append(new_name(taken, f"{surface}, changed"))
        taken.append(names[-1])
    mix = np.array(rows)
    alpha, sigma, lacking = _absorbing(
        mix @ before.alpha, mix @ before.sigma, np.array(areas), change, spread
    )
    kept = [i for i in range(before.n_materials) if left[i] > 1e-6 * before.total_area]
    further = [
        Material(name, a.tolist(), s.tolist(), 0.0, scatter.tolist(), source, area)
        for name, a, s, scatter, source, area in zip(
            names, alpha, sigma, mix @ scattering, sources, areas, strict=True
        )
    ]
    changed = dict(zip(names, (faces[s] for s in surfaces), strict=True))
    geometry = _with_material(geometry, changed)
    stated = _stated(before, simulator)
    room = stated.with_rows(
        [*(replace(stated.material(before.materials[i]), area=left[i]) for i in kept), *further],
        surfaces=geometry.surfaces if before.surfaces else (),
        scene=Scene(
            sources=simulator.sources,
            receivers=simulator.receivers,
            directivity=simulator.directivity,
        ),
    )
    return room, geometry, lacking
