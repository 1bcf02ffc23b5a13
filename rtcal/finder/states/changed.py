"""The room of the second state: the first state's, with what changed in it.

It is made of a measured difference, band by band, and not of an effect with its parameters as in
`rtcal.finder.means.corrected` and `rtcal.finder.positions.corrected`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.changes import Further, new_name, with_materials
from rtcal.acoustics.materials import Material
from rtcal.acoustics.room import Room
from rtcal.acoustics.scene import Scene
from rtcal.calibration.presets import calibrate
from rtcal.finder.case import NORMAL_90
from rtcal.finder.finding import listed
from rtcal.finder.positions import surfaces as of_room
from rtcal.finder.states.case import StatesCase
from rtcal.io import obj
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.files import make_folder, write_all
from rtcal.support.types import Array

ROOM, MESH = "room.toml", "room.obj"
_LEAST_SIGMA = 0.01
_TOLD = 0.05
"""Share of a change that does not fit, from which on it is said."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondState:
    """A second state: its room, to calibrate, export and predict with.

    Its coefficients are those of a calibration to the first state, with the change's mean. Their sigma
    is the calibration's and the change's, together. What is added takes the same share of the way to
    alpha = 1 on every surface that it is on; what is removed leaves the same share.

    Attributes
    ----------
    room : Room
        Where surfaces are claimed, each has a material of its own.
    surfaces : tuple of str
        The surfaces that are claimed to have changed; empty where all materials share the change.
    geometry : Polyhedron or None
        With the materials of the claimed surfaces; None where none is claimed.
    notes : tuple of str
        What of the change the room does not hold, and what was assumed.
    """

    room: Room
    surfaces: tuple[str, ...]
    geometry: Polyhedron | None
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        on = listed([f'"{name}"' for name in self.surfaces]) if self.surfaces else "all materials"
        return f"<SecondState: on {on}>"

    @property
    def in_words(self) -> list[str]:
        """The notes: what of the change the room does not hold, and what was assumed."""
        return list(self.notes)

    def to_dict(self) -> dict[str, Any]:
        """Return what changed, and the notes, as plain values."""
        return {
            "surfaces": list(self.surfaces),
            "room": self.room.to_dict(),
            "notes": list(self.notes),
        }

    @checked
    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write the room, and its mesh where surfaces are claimed; all or none. Return the paths."""
        where = checks.path("folder", folder)
        room = self.room
        contents = {}
        if self.geometry is not None:
            room = room.replace(scene=replace(room.scene, mesh=where / MESH))
            contents[MESH] = obj.text(self.geometry).encode()
        contents = {ROOM: room.to_text(where).encode(), **contents}
        make_folder(where)
        write_all({where / name: content for name, content in contents.items()})
        return [where / name for name in contents]


def changed_room(
    case: StatesCase, area: Array, change: Array, surfaces: Sequence[str], kinds: Sequence[str]
) -> SecondState:
    """Return the room of the second state; see `StatesFinding.apply`.

    Parameters
    ----------
    case : Case
    area, change : array (n_bands,), (3, n_bands)
        Absorption area before and its change in m², as of `StatesFinding`.
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
    change = np.where(np.isfinite(change), change, 0.0)
    spread = (change[2] - change[1]) / (2 * NORMAL_90)
    notes = []
    unknown = room_bands[~case.differences.measured].tolist()
    if unknown:
        at = listed([bands.label(f) for f in unknown])
        notes.append(f"Nothing is known of {at}: there the room is that of the first state.")
    geometry: Polyhedron | None = None
    if surfaces and case.simulator is not None:
        room, geometry, lacking = _on_surfaces(case.simulator, surfaces, before, change[0], spread)
    else:
        alpha, sigma, lacking = _absorbing(
            before.alpha, before.sigma, before.areas, change[0], spread
        )
        room = before.replace(alpha=alpha, sigma=sigma)
        notes.append("Where it changed is not told: every material has its share.")
    for k in np.flatnonzero(np.abs(lacking) > _TOLD * np.abs(change[0])).tolist():
        notes.append(
            f"At {bands.label(room_bands[k])} {abs(lacking[k]):.1f} m² of the change of "
            f"{change[0, k]:+.1f} m² do not fit on what has changed."
        )
    off = before.areas @ before.alpha - area
    for k in np.flatnonzero(np.abs(off) > _TOLD * area).tolist():
        notes.append(
            f"At {bands.label(room_bands[k])} no coefficients of the room give T before: its "
            f"absorption area is off by {off[k]:+.1f} m²."
        )
    if len(kinds) > 1:
        notes.append(
            f"What it is made of is not told ({listed(kinds)}): its amount is in the room."
        )
    return SecondState(
        room=room,
        surfaces=() if geometry is None else tuple(surfaces),
        geometry=geometry,
        notes=tuple(notes),
    )


def _absorbing(
    alpha: Array, sigma: Array, areas: Array, change: Array, spread: Array
) -> tuple[Array, Array, Array]:
    """Return alpha and sigma with a change of the absorption area, and what of it did not fit.

    ``alpha`` and ``sigma`` are (n, n_bands), ``areas`` (n,), ``change`` and ``spread`` (n_bands,) in
    m².
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
    geometry, faces = simulator.geometry, of_room.of_geometry(simulator.geometry)
    scattering, left = simulator.scattering, before.areas.copy()
    rows, names, areas = [], [], []
    taken, materials = list(before.materials), list(geometry.materials)
    for surface in surfaces:
        of_face = before.material_rows([geometry.materials[i] for i in faces[surface]])
        sizes = geometry.face_areas[faces[surface]]
        weights = np.bincount(of_face, sizes, before.n_materials)
        rows.append(weights / weights.sum())
        areas.append(float(weights.sum()))
        left = np.maximum(left - weights, 0.0)
        names.append(new_name(taken, f"{surface}, changed"))
        taken.append(names[-1])
        for i in faces[surface]:
            materials[i] = names[-1]
    mix = np.array(rows)
    alpha, sigma, lacking = _absorbing(
        mix @ before.alpha, mix @ before.sigma, np.array(areas), change, spread
    )
    kept = [i for i in range(before.n_materials) if left[i] > 1e-6 * before.total_area]
    further = [
        Further(Material(name, a.tolist(), s.tolist(), scattering=scatter.tolist()), area)
        for name, a, s, scatter, area in zip(
            names, alpha, sigma, mix @ scattering, areas, strict=True
        )
    ]
    geometry = replace(geometry, materials=materials)
    room = with_materials(
        before.replace(scattering=scattering, scattering_model=simulator.scattering_model),
        further,
        kept,
        left[kept],
        surfaces=geometry.surfaces if before.surfaces else (),
        scene=Scene(
            sources=simulator.sources,
            receivers=simulator.receivers,
            directivity=simulator.directivity,
        ),
    )
    return room, geometry, lacking
