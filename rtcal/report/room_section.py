"""Rooms that pages show: of a calibration, of a calibration to every position, of a finding."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.io import geometry_files
from rtcal.report import room_view
from rtcal.report.room_view import Quantity, RoomView
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.errors import DataError

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult
    from rtcal.finder.positions.finding import Place, PositionsFinding
    from rtcal.finder.positions.verification import PositionsVerification
    from rtcal.loop.positions_result import PositionsResult

_NONE: dict[str, Any] = {"room": None, "no_room": ""}
"""Section of a room that states no geometry."""


def of_calibration(result: CalibrationResult) -> dict[str, Any]:
    """Return the section of a calibration whose room states its geometry.

    A mesh that cannot be read is no error: the page says so, and goes without it.
    """
    room = result.prior
    if not room.scene:
        return _NONE
    try:
        geometry = geometry_files.read(room)
    except DataError as error:
        return {"room": None, "no_room": f"The room is not drawn: {error}."}
    shift = np.divide(
        result.alpha - room.alpha, room.sigma, out=np.zeros_like(room.alpha), where=room.sigma > 0
    )
    view = RoomView(
        geometry=geometry,
        parts=room_view.of_materials(geometry, room.materials),
        part="Material",
        areas=room.areas,
        quantities=room_view.absorption(room.centre_frequencies, room.alpha, result.alpha, shift),
        stands=room_view.stands(room.scene.sources, room.scene.receivers, (), ()),
    )
    return _section(view)


def of_positions(result: PositionsResult) -> dict[str, Any]:
    """Return the section of a calibration to every position, if its simulator has a geometry."""
    tracer: Any = result.tracer
    geometry = getattr(tracer, "geometry", None)
    if not isinstance(geometry, Polyhedron):
        return _NONE
    room = result.prior
    view = RoomView(
        geometry=geometry,
        parts=room_view.of_materials(geometry, room.materials),
        part="Material",
        areas=room.areas,
        quantities=room_view.absorption(
            room.centre_frequencies, room.alpha, result.alpha, result.shift
        ),
        stands=room_view.stands(
            tracer.sources,
            tracer.receivers,
            result.pairs,
            (result.gap_before, result.gap_after),
        ),
        whens=("before", "after"),
    )
    return _section(view)


def of_finding(
    finding: PositionsFinding,
    verification: PositionsVerification | None,
    place: Place | None = None,
) -> dict[str, Any]:
    """Return the section of a finding in a geometry.

    Its gaps are those of a verification at pairs that were not fitted. ``place`` is a further receiver.
    """
    case, room = finding.case, finding.case.room
    none = finding.verdict == "none"
    chance = [0.0 if none else finding.surfaces.get(name, 0.0) for name in case.faces]
    rows = [_material(room, case.geometry, int(faces[0])) for faces in case.faces.values()]
    likely = Quantity(
        name="Probability that something is missing on this surface",
        head="Probability",
        columns=("",),
        values=np.array(chance)[:, np.newaxis],
        low=0.0,
        high=1.0,
        colours=room_view.LIKELY,
        digits=0,
        factor=100.0,
        unit=" %",
    )
    alpha = room_view.absorption(
        room.centre_frequencies, room.alpha[rows], room.alpha[rows], np.zeros((len(rows), 1))
    )[-1]
    sources, receivers = case.simulator.sources, dict(case.simulator.receivers)
    if place is not None:
        receivers["to measure here"] = place.point
    gaps, whens = [], []
    if verification is not None:
        gaps = [np.concatenate(gap) for gap in verification.gaps[[0, -1]]]
        whens = ["as stated", "corrected"]
    view = RoomView(
        geometry=case.geometry,
        parts=case.faces,
        part="Surface",
        areas=np.array([case.geometry.face_areas[f].sum() for f in case.faces.values()]),
        quantities=[likely, alpha],
        stands=room_view.stands(sources, receivers, finding.pairs, gaps),
        whens=whens,
    )
    return _section(view)


def _section(view: RoomView) -> dict[str, Any]:
    made = room_view.section(view)
    if made is None:
        limits = f"{room_view.MOST_FACES} faces or {room_view.MOST_TRIANGLES} triangles"
        return {"room": None, "no_room": f"The room is not drawn: it has more than {limits}."}
    return {"room": made, "no_room": ""}


def _material(room: Room, geometry: Polyhedron, face: int) -> int:
    return room.material_index(geometry.materials[face])
