"""The room of a page in three dimensions: its parts coloured by numbers, its sources and receivers.

It is the room of a calibration, of a calibration to every position, or of a finding. The page holds it
three times: as data that its script draws with WebGL and turns, as still pictures for print and for
browsers without WebGL, and as tables. Nothing is fetched. A still picture is an axonometric projection
as the shapes of an SVG: faces towards the reader are left out, so that the room can be looked into.
``room.js`` projects in the same way.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.marks import rms
from rtcal.acoustics.room import Room
from rtcal.io import geometry_files
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
_WIDTH, _HEIGHT = 460, 330
_MARGIN = 20
_SIZE = 7
_FLAT = 0.01
"""Largest sine between the normals of two faces without an edge between them."""
_MOST_NAMES = 40
MOST_FACES = 5000
"""Largest number of faces that are drawn: the page stays below 2 MB."""
MOST_TRIANGLES = 20_000
ABSORBS = ("#ffffd9", "#c7e9b4", "#41b6c4", "#225ea8", "#081d58")
MOVES = ("#2166ac", "#92c5de", "#f7f7f7", "#f4a582", "#b2182b")
LIKELY = ("#f7f7f7", "#e8a268", "#d55e00")
GAPS = ("#fee838", "#bcae6c", "#7c7b78", "#434e6c", "#00224e")
"""Colours from the lowest value to the highest; each scale can be read in grey, or has a middle."""


def between(colours: Sequence[str], share: float) -> str:
    """Return the colour at a share from 0 to 1 of a scale; beyond its ends the end; grey for NaN.

    >>> between(("#000000", "#ff0000"), 0.5), between(("#000000", "#ff0000"), float("nan"))
    ('#800000', '#c8c8c8')
    """
    if not np.isfinite(share):
        return GREY
    stops = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in colours], dtype=float)
    at = np.clip(share, 0, 1) * (len(stops) - 1)
    mixed = [np.interp(at, np.arange(len(stops)), channel) for channel in stops.T]
    return "#" + "".join(f"{int(np.floor(c + 0.5)):02x}" for c in mixed)


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """A direction of view of a geometry: ``turn`` round z, ``tilt`` above the horizontal, in radians.

    ``owners`` (n_faces,) is the part of each face, -1 without one.
    """

    geometry: Polyhedron
    owners: NDArray[np.int64]
    turn: float
    tilt: float

    @cached_property
    def frame(self) -> tuple[float, Array, Array]:
        """Units of the picture per m, its origin in m, and its size."""
        right, up, _ = axes_of(self.turn, self.tilt)
        corners = self.geometry.vertices
        flat = np.stack([corners @ right, corners @ up], axis=1)
        low, high = flat.min(axis=0), flat.max(axis=0)
        space = np.array([_WIDTH, _HEIGHT]) - 2 * _MARGIN
        scale = float((space / np.maximum(high - low, 1e-9)).min())
        origin = np.array([low[0] - _MARGIN / scale, high[1] + _MARGIN / scale])
        return scale, origin, scale * (high - low) + 2 * _MARGIN

    @property
    def box(self) -> str:
        """The picture's extent as an SVG's viewBox."""
        width, height = self.frame[2]
        return f"0 0 {width:.0f} {height:.0f}"

    @cached_property
    def edges(self) -> NDArray[np.int64]:
        """Vertices of the edges that are drawn, (n_edges, 2): between parts, and where a part bends."""
        of_edge: dict[tuple[int, int], list[int]] = {}
        for i, face in enumerate(self.geometry.faces):
            for edge in _around(face):
                of_edge.setdefault(edge, []).append(i)

        def drawn(faces: list[int]) -> bool:
            if len(faces) < 2 or len({int(self.owners[i]) for i in faces}) > 1:
                return True
            bends = np.cross(self.geometry.normals[faces[0]], self.geometry.normals[faces[1:]])
            return bool((np.linalg.norm(bends, axis=1) > _FLAT).any())

        kept = [edge for edge, faces in of_edge.items() if drawn(faces)]
        return np.array(kept, dtype=np.int64).reshape(-1, 2)

    def shapes(self) -> dict[str, Any]:
        """Return polygons (points, part, edges), the farthest first, and the edges before them."""
        flat = self._flat(self.geometry.vertices)
        into = axes_of(self.turn, self.tilt)[2]
        drawn = {(int(a), int(b)) for a, b in self.edges}
        depth = self.geometry.vertices @ into
        faces = [list(face) for face in self.geometry.faces]
        order = sorted(
            np.flatnonzero(self.geometry.normals @ into > 0),
            key=lambda i: (-float(depth[faces[i]].max()), -float(depth[faces[i]].mean())),
        )
        of_face = {i: drawn.intersection(_around(faces[i])) for i in order}
        return {
            "polygons": [
                (_points(flat[faces[i]]), int(self.owners[i]), _path(flat, of_face[i]))
                for i in order
            ],
            "near": _path(flat, drawn.difference(*of_face.values())),
        }

    def marks(self, stands: Sequence[tuple[str, str, Any, str]]) -> list[dict[str, Any]]:
        """Return sources and receivers: (kind, name, place, colour), with names unless many."""
        low, s = self.geometry.vertices[:, 2].min(), _SIZE
        made = []
        for kind, name, place, colour in stands:
            (x, y), (_, foot) = self._flat(np.array([place, (place[0], place[1], low)]))
            triangle = np.array([(x, y - s), (x - s, y + 0.7 * s), (x + s, y + 0.7 * s)])
            made.append(
                {
                    "kind": kind,
                    "name": name if len(stands) <= _MOST_NAMES else "",
                    "x": f"{x:.1f}",
                    "y": f"{y:.1f}",
                    "foot": f"{foot:.1f}",
                    "corners": _points(triangle),
                    "colour": colour,
                }
            )
        return made

    def _flat(self, points: Array) -> Array:
        """Return points (n, 3) in m in the picture, (n, 2), whose y is downward."""
        scale, origin, _ = self.frame
        right, up, _ = axes_of(self.turn, self.tilt)
        flat = np.stack([points @ right, points @ up], axis=1) - origin
        return np.asarray(flat * scale * (1, -1))


def axes_of(turn: float, tilt: float) -> Array:
    """Return the unit vectors to the right, upward and into the picture, (3, 3)."""
    across, along = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    right = np.array([*across, 0.0])
    up = np.array([*(np.sin(tilt) * along), np.cos(tilt)])
    into = np.array([*(np.cos(tilt) * along), -np.sin(tilt)])
    return np.stack([right, up, into])


def look(
    geometry: Polyhedron, owners: NDArray[np.int64], weights: Array, tilt: float = ABOVE
) -> Look:
    """Return the look from which most of the faces' weights (n_faces,) is seen from inside."""

    def seen(turn: float) -> float:
        return float(weights @ np.clip(geometry.normals @ axes_of(turn, tilt)[2], 0, None))

    turn = float(max(TURNS, key=seen))
    return Look(geometry=geometry, owners=owners, turn=turn, tilt=float(tilt))


def _points(flat: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in flat)


def _around(face: Sequence[int]) -> list[tuple[int, int]]:
    """Return the edges of a face, each with its lower vertex first."""
    return [(min(a, b), max(a, b)) for a, b in zip(face, [*face[1:], face[0]], strict=True)]


def _path(flat: Array, edges: Iterable[tuple[int, int]]) -> str:
    """Return edges as the path of an SVG."""
    return "".join(
        "M{:.1f} {:.1f}L{:.1f} {:.1f}".format(*flat[a], *flat[b]) for a, b in sorted(edges)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Quantity:
    """Numbers (n_parts, n_columns) that colour the parts, NaN where nothing is known.

    ``head`` is the name in a table's head. ``columns`` says what each column is: the mean over the
    bands, or a band. ``colours`` go from ``low`` to ``high``. A value in text has so many ``digits``,
    is multiplied by ``factor`` and followed by ``unit``. ``still``: whether it has a still picture.
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
        values = [[round(float(v), 4) if np.isfinite(v) else None for v in r] for r in self.values]
        return {**vars(self), "values": values}


@dataclass(frozen=True, kw_only=True)
class Stand:
    """A source or receiver: where it stands in m, and its gaps in JND, NaN where there are none."""

    kind: str
    name: str
    place: tuple[float, float, float]
    gaps: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class RoomSection:
    """The room on a page, for the template ``room.html``, below a heading of a ``level`` or none.

    Attributes
    ----------
    geometry : Polyhedron
    parts : mapping of str to int array
        Faces of each part by its name: of a material, or of a surface.
    part : str
        What a part is called in a table's head.
    areas : array (n_parts,)
        m².
    quantities : sequence of Quantity
        The first is shown at first.
    stands : sequence of Stand
    whens : sequence of str
        What each gap of a stand is: as stated, calibrated.
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
        """The gaps of the stands, and their colours."""
        gaps = np.array([s.gaps for s in self.stands], dtype=float)
        gaps = gaps.reshape(len(self.stands), len(self.whens))
        most = float(np.ceil(np.nanmax(gaps, initial=2.0)))
        name, whens = "Gap / JND", tuple(self.whens)
        ends: dict[str, Any] = {"low": 0.0, "high": most, "colours": GAPS}
        return Quantity(name=name, head=name, columns=whens, values=gaps, digits=1, **ends)

    @cached_property
    def _looks(self) -> list[Look]:
        """From above and from below; by area and the first quantity faces are to be seen."""
        owners = np.full(len(self.geometry.faces), -1)
        for i, faces in enumerate(self.parts.values()):
            owners[faces] = i
        first = self.quantities[0]
        shares = np.nan_to_num(first.values[:, 0] - first.low) / (first.high - first.low)
        weights = self.geometry.face_areas * (0.05 + np.append(shares, 0.0)[owners])
        return [look(self.geometry, owners, weights, tilt) for tilt in (ABOVE, BELOW)]

    @property
    def looks(self) -> list[dict[str, Any]]:
        """Each look's shapes, with sources and receivers in the colour of their last gap."""
        last = self.gap.values[:, -1] if self.whens else np.full(len(self.stands), np.nan)
        marks = [
            (s.kind, s.name, s.place, self.gap.colour(gap))
            for s, gap in zip(self.stands, last, strict=True)
        ]
        return [
            {"name": name, "box": of.box, **of.shapes(), "marks": of.marks(marks)}
            for name, of in zip(("above", "below"), self._looks, strict=True)
        ]

    @property
    def data(self) -> str:
        """The data of the script as JSON that holds no character of markup."""
        geometry, above = self.geometry, self._looks[0]
        corners = np.round(1000 * geometry.triangles).astype(int).reshape(-1, 3)
        points, triangles = np.unique(corners, axis=0, return_inverse=True)
        content = {
            "points": points.ravel().tolist(),
            "triangles": triangles.ravel().tolist(),
            "owners": above.owners[geometry.triangle_faces].tolist(),
            "edges": np.round(1000 * geometry.vertices[above.edges]).astype(int).ravel().tolist(),
            "parts": list(self.parts),
            "quantities": [q.plain for q in self.quantities],
            "gap": self.gap.plain,
            "stands": [{"kind": s.kind, "name": s.name, "place": s.place} for s in self.stands],
            "turn": above.turn,
            "tilt": above.tilt,
        }
        text = json.dumps(content, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
        for character in "<>&":
            text = text.replace(character, f"\\u{ord(character):04x}")
        return text

    @property
    def script(self) -> str:
        """The page's script, ``room.js``."""
        return _script()

    @property
    def fingerprint(self) -> str:
        """What the page's policy allows to run: this script, and nothing else."""
        digest = hashlib.sha256(_script().encode()).digest()
        return f"'sha256-{base64.b64encode(digest).decode()}'"


@cache
def _script() -> str:
    return resources.files("rtcal.report").joinpath("templates/room.js").read_text("utf-8")


def _section(**of: Any) -> list[Any]:
    """Return the room as a block of a page; of too many faces a note that it is not drawn."""
    geometry = of["geometry"]
    if len(geometry.faces) > MOST_FACES or len(geometry.triangles) > MOST_TRIANGLES:
        return [_missing(f"it has more than {MOST_FACES} faces or {MOST_TRIANGLES} triangles")]
    return [RoomSection(**of)]


def _missing(why: str) -> Note:
    return Note(f"The room is not drawn: {why}.", kind="note")


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
    """Return alpha as calibrated, its shift in standard deviations, and alpha as stated.

    All are (n_materials, n_bands).
    """
    columns = ("mean over the bands", *bands.labels(frequencies))
    highest = float(np.ceil(10 * max(stated.max(), calibrated.max(), 0.1))) / 10
    reach = float(np.ceil(max(2.0, np.abs(shift).max())))

    def quantity(name: str, head: str, values: Array, **more: Any) -> Quantity:
        table = np.column_stack([values.mean(axis=1), values])
        return Quantity(name=name, head=head, columns=columns, values=table, **more)

    alpha = {"low": 0.0, "high": highest, "colours": ABSORBS}
    moved = {"low": -reach, "high": reach, "colours": MOVES, "digits": 1}
    name = "Absorption coefficient"
    return [
        quantity(f"{name}, calibrated", "α calibrated", calibrated, **alpha),
        quantity(
            "Shift of the coefficient in standard deviations of what was stated",
            "shift / σ",
            shift,
            **moved,
        ),
        quantity(f"{name}, stated", "α stated", stated, **alpha, still=False),
    ]


def stands(
    sources: Mapping[str, Any],
    receivers: Mapping[str, Any],
    pairs: Sequence[tuple[str, str]] = (),
    gaps: Sequence[Array] = (),
) -> list[Stand]:
    """Return sources and receivers with the root mean square gap of their pairs in JND.

    ``gaps`` are before, after: each (n_parameters, n_pairs, n_bands), NaN where nothing is known.
    """
    made = []
    for kind, points, end in (("source", sources, 0), ("receiver", receivers, 1)):
        for name, place in points.items():
            own = [i for i, pair in enumerate(pairs) if pair[end] == name]
            x, y, z = (float(c) for c in place)
            values = tuple(float(rms(gap[:, own])) for gap in gaps)
            made.append(Stand(kind=kind, name=name, place=(x, y, z), gaps=values))
    return made


def of_calibration(result: CalibrationResult, level: int = 2) -> list[Any]:
    """Return the section of a calibration whose room states its geometry; else nothing.

    A mesh that cannot be read is no error: the page says so, and goes without it.
    """
    room = result.prior
    if not room.scene:
        return []
    try:
        geometry = geometry_files.read(room)
    except DataError as error:
        return [_missing(str(error))]
    shift = np.divide(
        result.alpha - room.alpha, room.sigma, out=np.zeros_like(room.alpha), where=room.sigma > 0
    )
    return _section(
        **_of_materials(geometry, room, result.alpha, shift),
        stands=stands(room.scene.sources, room.scene.receivers),
        level=level,
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
    """Return the section of a finding in a geometry.

    Its gaps are those of a verification at pairs that were not fitted. ``place`` is a further receiver.
    """
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
        whens=["as stated", "corrected"] if gaps else [],
        level=None,
    )
