"""The room of a page in three dimensions: its parts coloured by numbers, its sources and receivers.

It is the room of a calibration, of a calibration to every position, or of a finding. The page holds it
three times: as data that its script (``room.js``) draws with WebGL and turns, as still pictures for
print and for browsers without WebGL, and as tables. Nothing is fetched. A picture is an axonometric
projection: faces towards the reader are left out, so that the room can be looked into.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.marks import rms
from rtcal.acoustics.room import Room
from rtcal.report import figures
from rtcal.report.document import Picture
from rtcal.report.figures import likely_shares
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.blocks import Note
from rtcal.support.errors import DataError
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult
    from rtcal.finder.finding import Finding
    from rtcal.finder.positions.places import Place
    from rtcal.finder.verification import Verification
    from rtcal.loop.positions import PositionsResult

GREY = "#c8c8c8"
"""Colour of what has no value."""
ABOVE, BELOW = np.radians([30, -30])
"""Directions from which the view looks, above the horizontal: floor or ceiling is seen."""
TURNS = np.radians([35, 125, 215, 305])
"""Directions round z, of which the one is taken that shows most of what is to be seen."""
_FLAT = 0.01  # largest sine between the normals of two faces without an edge between them
MOST_FACES = 5000
"""Largest number of faces that are drawn: the page stays below 2 MB."""
MOST_TRIANGLES = 20_000
ABSORBS = ("#ffffd9", "#c7e9b4", "#41b6c4", "#225ea8", "#081d58")
MOVES = ("#2166ac", "#92c5de", "#f7f7f7", "#f4a582", "#b2182b")
LIKELY = ("#f7f7f7", "#e8a268", "#d55e00")
GAPS = ("#fee838", "#bcae6c", "#7c7b78", "#434e6c", "#00224e")
"""Colours from the lowest value to the highest; each scale can be read in grey, or has a middle."""


def between(colours: Sequence[str], share: float) -> str:
    """Return the colour at a share from 0 to 1 of a colour scale.

    A share beyond an end of the scale has the colour of the end, and NaN is grey.

    >>> between(("#000000", "#ff0000"), 0.5), between(("#000000", "#ff0000"), float("nan"))
    ('#800000', '#c8c8c8')
    """
    if not np.isfinite(share):
        return GREY
    stops = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in colours], dtype=float)
    at = np.clip(share, 0, 1) * (len(stops) - 1)
    mixed = [np.interp(at, np.arange(len(stops)), channel) for channel in stops.T]
    return "#" + "".join(f"{int(np.floor(c + 0.5)):02x}" for c in mixed)


def into_picture(turn: float, tilt: float) -> Array:
    """Return the unit vector into the picture, (3,), of a view: turned round z, tilted above."""
    return np.array([-np.cos(tilt) * np.sin(turn), np.cos(tilt) * np.cos(turn), -np.sin(tilt)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Quantity:
    """Hold a quantity whose numbers colour the parts of a room, NaN where nothing is known.

    ``values`` are (n_parts, n_columns), and ``columns`` the names of the columns: a band, or the mean
    over bands. ``head`` is the quantity's name in the head of a table. ``colours`` is the scale of
    colours from ``low`` to ``high``. In text, a number is multiplied by ``factor``, has ``digits``
    decimals, and is followed by ``unit``. ``still`` is whether the page has a picture of it for print.
    """

    name: str
    head: str
    columns: Sequence[str]
    values: Array
    low: float
    high: float
    colours: Sequence[str]
    digits: int = 2
    factor: float = 1.0
    unit: str = ""
    still: bool = True

    @property
    def title(self) -> str:
        """Name of the quantity, with the name of its first column."""
        return ", ".join(filter(None, (self.name, self.columns[0])))

    def text(self, value: float) -> str:
        """Return a value as the page prints it."""
        if not np.isfinite(value):
            return "–"
        return f"{self.factor * value:z.{self.digits}f}{self.unit}".replace("-", "−")

    def colour(self, value: float) -> str:
        """Return the colour of a value, grey for NaN."""
        return between(self.colours, (value - self.low) / (self.high - self.low))

    @property
    def plain(self) -> dict[str, Any]:
        """The quantity as the page's script reads it."""
        values = [[round(float(v), 6) if np.isfinite(v) else None for v in r] for r in self.values]
        return {**vars(self), "values": values}


@dataclass(frozen=True, kw_only=True)
class Stand:
    """Hold a source or receiver: its position in m, and its deviations in JND, NaN if unknown."""

    kind: str
    name: str
    place: tuple[float, float, float]
    gaps: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class RoomSection:
    """Hold the view of a room on a page.

    ``parts`` has the numbers of the faces of each material or surface, and ``areas`` (n_parts,) are in
    m². ``part`` is the word for a part in the head of a table. The first of ``quantities`` is shown at
    first. ``stands`` are sources and receivers with their deviations, and ``whens`` the names of the
    models to which these belong, such as "input". ``level`` is that of the heading; None for none.
    """

    geometry: Polyhedron
    parts: Mapping[str, NDArray[np.int64]]
    part: str
    areas: Array
    quantities: Sequence[Quantity]
    stands: Sequence[Stand] = ()
    whens: Sequence[str] = ()
    level: int | None = 2

    @cached_property
    def gap(self) -> Quantity:
        """Deviations at the sources and receivers, and their colours."""
        gaps = np.array([s.gaps for s in self.stands], dtype=float)
        gaps = gaps.reshape(len(self.stands), len(self.whens))
        return Quantity(
            name="Deviation / JND",
            head="Deviation / JND",
            columns=tuple(self.whens),
            values=gaps,
            low=0.0,
            high=float(np.ceil(np.nanmax(gaps, initial=2.0))),
            colours=GAPS,
            digits=1,
        )

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """Number of the part to which each face belongs, (n_faces,); -1 for none."""
        owners = np.full(len(self.geometry.faces), -1)
        for i, faces in enumerate(self.parts.values()):
            owners[faces] = i
        return owners

    def turn(self, tilt: float) -> float:
        """Return the turn in radians that shows most of the parts with high first values, by area."""
        first, geometry = self.quantities[0], self.geometry
        shares = np.nan_to_num(first.values[:, 0] - first.low) / (first.high - first.low)
        weights = geometry.face_areas * (0.05 + np.append(shares, 0.0)[self.owners])
        facing = [geometry.normals @ into_picture(turn, tilt) for turn in TURNS]
        return float(TURNS[int(np.argmax(np.clip(facing, 0, None) @ weights))])

    @property
    def edges(self) -> NDArray[np.int64]:
        """Vertices of the edges that are drawn, (n_edges, 2): between parts, and where a part bends."""
        of_edge: dict[tuple[int, int], list[int]] = {}
        for i, face in enumerate(self.geometry.faces):
            for a, b in zip(face, [*face[1:], face[0]], strict=True):
                of_edge.setdefault((min(a, b), max(a, b)), []).append(i)

        def drawn(faces: list[int]) -> bool:
            if len(faces) < 2 or len({int(self.owners[i]) for i in faces}) > 1:
                return True
            bends = np.cross(self.geometry.normals[faces[0]], self.geometry.normals[faces[1:]])
            return bool((np.linalg.norm(bends, axis=1) > _FLAT).any())

        kept = [edge for edge, faces in of_edge.items() if drawn(faces)]
        return np.array(kept, dtype=np.int64).reshape(-1, 2)

    @property
    def stills(self) -> list[Picture]:
        """The pictures for print, and for browsers that cannot turn the room."""
        shown = [q for q in self.quantities if q.still]
        return [Picture(partial(self.still, q), f"{q.title}, from above and below") for q in shown]

    def still(self, quantity: Quantity) -> Any:
        """Return the figure of a room with its parts coloured by a quantity, from above and below."""
        colours = np.array([*map(quantity.colour, quantity.values[:, 0]), GREY])[self.owners]
        views = []
        for tilt in (ABOVE, BELOW):
            turn = self.turn(tilt)
            facing = self.geometry.normals @ into_picture(turn, tilt) > 0
            views.append((turn, float(tilt), np.flatnonzero(facing).tolist()))
        marks = [
            (s.kind, s.name, s.place, self.gap.colour(s.gaps[-1]) if s.gaps else GREY)
            for s in self.stands
        ]
        unit = f" /{quantity.unit}" if quantity.unit else ""
        ends = quantity.factor * quantity.low, quantity.factor * quantity.high
        scale = quantity.title + unit, quantity.colours, ends
        return figures.room(self.geometry, colours.tolist(), views, marks, scale)

    @property
    def data(self) -> str:
        """The data of the script as JSON that holds no character of markup."""
        geometry = self.geometry
        corners = np.round(1000 * geometry.triangles).astype(int).reshape(-1, 3)
        points, triangles = np.unique(corners, axis=0, return_inverse=True)
        content = {
            "points": points.ravel().tolist(),
            "triangles": triangles.ravel().tolist(),
            "owners": self.owners[geometry.triangle_faces].tolist(),
            "edges": np.round(1000 * geometry.vertices[self.edges]).astype(int).ravel().tolist(),
            "parts": list(self.parts),
            "quantities": [q.plain for q in self.quantities],
            "gap": self.gap.plain,
            "stands": [{"kind": s.kind, "name": s.name, "place": s.place} for s in self.stands],
            "turn": self.turn(ABOVE),
            "tilt": float(ABOVE),
        }
        text = json.dumps(content, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
        for character in "<>&":
            text = text.replace(character, f"\\u{ord(character):04x}")
        return text

    @cached_property
    def script(self) -> str:
        """The page's script, ``room.js``."""
        return resources.files("rtcal.report").joinpath("templates/room.js").read_text("utf-8")

    @property
    def fingerprint(self) -> str:
        """What the page's policy allows to run: this script, and nothing else."""
        digest = hashlib.sha256(self.script.encode()).digest()
        return f"'sha256-{base64.b64encode(digest).decode()}'"


def _section(geometry: Polyhedron, **of: Any) -> list[Any]:
    """Return the room as a block of a page; of too many faces a note that it is not drawn."""
    if len(geometry.faces) > MOST_FACES or len(geometry.triangles) > MOST_TRIANGLES:
        why = f"it has more than {MOST_FACES} faces or {MOST_TRIANGLES} triangles"
        return [Note(f"The room is not drawn: {why}.", kind="note")]
    return [RoomSection(geometry=geometry, **of)]


def _of_materials(geometry: Polyhedron, room: Room, alpha: Array, shift: Array) -> dict[str, Any]:
    """Return the parts of a room by material, with what colours them."""
    of_face = np.array(geometry.materials, dtype=object)
    return {
        "geometry": geometry,
        "parts": {m: np.flatnonzero(of_face == m) for m in room.materials},
        "part": "Material",
        "areas": room.areas,
        "quantities": absorption(room.centre_frequencies, room.alpha, alpha, shift),
    }


def absorption(
    frequencies: Array, stated: Array, calibrated: Array, shift: Array
) -> list[Quantity]:
    """Return alpha as calibrated, its shift in standard deviations, and alpha as input.

    All are (n_materials, n_bands).
    """
    columns = ("mean over the bands", *bands.labels(frequencies))
    highest = float(np.ceil(10 * max(stated.max(), calibrated.max(), 0.1))) / 10
    reach = float(np.ceil(max(2.0, np.abs(shift).max())))
    alpha: dict[str, Any] = {"columns": columns, "low": 0.0, "high": highest, "colours": ABSORBS}
    moved: dict[str, Any] = alpha | {"low": -reach, "high": reach, "colours": MOVES, "digits": 1}

    def with_mean(values: Array) -> Array:
        return np.column_stack([values.mean(axis=1), values])

    after, before, by = map(with_mean, (calibrated, stated, shift))
    name, shifted = "Absorption coefficient", "Shift of the coefficient in standard deviations"
    return [
        Quantity(name=f"{name}, calibrated", head="α calibrated", values=after, **alpha),
        Quantity(name=shifted, head="shift / σ", values=by, **moved),
        Quantity(name=f"{name}, input", head="α input", values=before, **alpha, still=False),
    ]


def stands(
    sources: Mapping[str, Any],
    receivers: Mapping[str, Any],
    pairs: Sequence[tuple[str, str]] = (),
    gaps: Sequence[Array] = (),
) -> list[Stand]:
    """Return sources and receivers with the root mean square deviation of their pairs in JND.

    ``sources`` and ``receivers`` are positions in m, by name. ``pairs`` are the (source, receiver) of
    each pair. ``gaps`` are the deviations of each model in JND, (n_parameters, n_pairs, n_bands).
    """
    made = []
    for kind, points, end in (("source", sources, 0), ("receiver", receivers, 1)):
        for name, place in points.items():
            own = [i for i, pair in enumerate(pairs) if pair[end] == name]
            x, y, z = (float(c) for c in place)
            values = tuple(float(rms(gap[:, own])) for gap in gaps)
            made.append(Stand(kind=kind, name=name, place=(x, y, z), gaps=values))
    return made


def of_calibration(result: CalibrationResult) -> list[Any]:
    """Return the view of the room for the page of a calibration; empty if the room has no geometry."""
    room = result.prior
    if not room.scene:
        return []
    from rtcal.io import geometry_files

    try:
        geometry = geometry_files.read(room)
    except DataError as error:
        return [Note(f"The room is not drawn: {error}.", kind="note")]
    shift = np.divide(
        result.alpha - room.alpha, room.sigma, out=np.zeros_like(room.alpha), where=room.sigma > 0
    )
    return _section(
        **_of_materials(geometry, room, result.alpha, shift),
        stands=stands(room.scene.sources, room.scene.receivers),
    )


def of_positions(result: PositionsResult) -> list[Any]:
    """Return the section of a calibration to every position, if its simulator has a geometry."""
    tracer: Any = result.tracer
    geometry = getattr(tracer, "geometry", None)
    if not isinstance(geometry, Polyhedron):
        return []
    gaps = result.gap_before, result.gap_after
    return _section(
        **_of_materials(geometry, result.prior, result.alpha, result.shift),
        stands=stands(tracer.sources, tracer.receivers, result.pairs, gaps),
        whens=("before", "after"),
    )


def of_finding(
    finding: Finding,
    verification: Verification | None,
    place: Place | None = None,
) -> list[Any]:
    """Return the view of the room for the page of a finding at positions."""
    case, room = finding.case, finding.case.room
    rows = [
        room.material_index(case.geometry.materials[int(faces[0])]) for faces in case.faces.values()
    ]
    alpha, none = room.alpha[rows], np.zeros((len(rows), 1))
    likely = Quantity(
        name="Probability that something is missing on this surface",
        head="Probability",
        columns=("",),
        values=np.array([*likely_shares(finding).values()])[:, np.newaxis],
        low=0.0,
        high=1.0,
        colours=LIKELY,
        digits=0,
        factor=100.0,
        unit=" %",
    )
    sources, receivers = case.simulator.sources, dict(case.simulator.receivers)
    if place is not None:
        receivers["to measure here"] = place.point
    ends: Sequence[Array] = [] if verification is None else [*verification.gaps[[0, -1]]]
    gaps = [np.concatenate(gap) for gap in ends]
    return _section(
        geometry=case.geometry,
        parts=case.faces,
        part="Surface",
        areas=np.array([case.geometry.face_areas[f].sum() for f in case.faces.values()]),
        quantities=[likely, absorption(room.centre_frequencies, alpha, alpha, none)[-1]],
        stands=stands(sources, receivers, finding.pairs, gaps),
        whens=["input", "corrected"] if gaps else [],
        level=None,
    )
