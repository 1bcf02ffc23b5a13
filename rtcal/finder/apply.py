"""The model with what was found in it: of means, on a surface, and of the second of two states.

Means over positions know no place. Volume and areas stay as stated, unless an effect is about that very
number, and absorption that belongs to no stated material becomes a further one, which stands free. Its
area is such that alpha = 1 in its most absorbing band is the upper end of the size's 90 % interval, so
that a calibration can increase the absorber as well as decrease it. A room cannot represent a decay's
shape or noise, which `Corrected.notes` say; the simulator of the corrected model does.

A candidate at positions has a surface, and so a geometry. Of two states the room is made of the
measured difference, band by band, and not of an effect with its parameters.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.changes import new_name
from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import (
    CHANGED,
    LARGEST_PIECE,
    POSITION,
    Directivity,
    Material,
    Room,
    Scene,
    Surface,
)
from rtcal.calibration.methods import calibrate
from rtcal.files import disk
from rtcal.files.disk import make_folder, write_all
from rtcal.finder.case import Case, Configuration, PositionsCase, StatesCase
from rtcal.finder.claim import Candidate, Reason, amount
from rtcal.finder.effects import AppliedEffect
from rtcal.finder.means.problem import predict_in, state, values_of_features, with_applied
from rtcal.finder.model import FEATURES, RoomState, highest, mean_contributions
from rtcal.finder.positions.surfaces import NEAR, face_at, of_geometry, patched
from rtcal.io import catt, odeon, pyroomacoustics
from rtcal.io.material_list import ExportReport
from rtcal.simulators.base import RoomSimulator, Simulator, check_alpha, run
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import listed
from rtcal.support.types import Array

CASE, ROOM, MESH, CATT = "case.json", "room.toml", "room.obj", "catt.txt"
LISTS = {CATT: catt, "odeon.txt": odeon, "pyroomacoustics.json": pyroomacoustics}
"""Lists of materials that are written, each with its format."""
CAUTION = "caution.txt"


@dataclass(frozen=True, kw_only=True, eq=False)
class Corrected:
    """Hold the model of a room with the effect that was found, as `Finding.apply` returns it."""

    case: Case | PositionsCase | StatesCase
    """Case with the effects in its model, for means, to be searched and recalibrated like any other."""
    room: Room
    """Room with the effect, not yet calibrated (for two states calibrated to the first state). For
    means it has the absorption area and T of the case's model, without what the ``notes`` list. A
    material that was added or changed has a sigma from the size and the spectrum. With a patch a box
    has no dimensions, because simulators of boxes have one material per wall."""
    geometry: Polyhedron | None = None
    """Geometry with the effect; None where no surface is identified."""
    surfaces: tuple[str, ...] = ()
    """Names of the surfaces that changed, each with a new material; none if all materials share it."""
    notes: tuple[Reason, ...] = ()
    """Notes on what the room cannot represent, on assumptions, and on why the form is another one."""
    added: Candidate | None = None
    """Candidate that was added, at positions."""
    material: str = ""
    form: str = ""
    """Name of the effect's material; "patch" for faces of its own, "material" for the whole surface."""
    support: str = ""
    """Verdict, probability and alternatives of the effect that was added, in words."""
    caution: str = ""
    """Reason not to use the model in simulations, at the head of its files; "" without one."""
    model: CaseModel | None = None
    """Model of the case with its effects, as a simulator, for means."""

    def simulator(self, make: Callable[[Room], Simulator] | None = None) -> Any:
        """Return a simulator of the corrected model, which takes alpha of each material of ``room``.

        If means over positions were compared, the result is the case's reverberation equation with the
        effects that were found. Otherwise it is the case's simulator with the corrected geometry, in
        which a new material has the scattering coefficient of the surface that it is on.

        Parameters
        ----------
        make : function, optional
            Function that returns your own simulator for a room: ``lambda room: PathTracing(room=room,
            geometry=..., ...)``. It can be given only if means over positions were compared. rtcal
            calls it with a room that has the input materials, and the air, volume and areas of the
            finding. The absorption that was found is then spread over all walls: each wall absorbs the
            same share of the energy that it would reflect.

        Raises
        ------
        DataError
            If no surface is identified and means were not compared, or if ``make`` is given for such a
            case; if your simulator cannot represent an effect: a coupled room, a noise floor, a custom
            effect on the decay, or an area or volume that its geometry does not have.
        """
        if self.model is not None:
            return self.model if make is None else self.model.spread_over(make)
        if make is not None:
            raise DataError(
                "make can be used only with means over positions, but this case has a "
                "simulator: leave make out"
            )
        tracer = None if isinstance(self.case, Case) else self.case.simulator
        if self.geometry is None or tracer is None:
            raise DataError(
                "no surface can be identified, because the room has no geometry; give the "
                "room's file a [geometry]"
            )
        scattering = self.room.scattering
        return replace(tracer, room=self.room, geometry=self.geometry, scattering=scattering)

    def to_dict(self) -> dict[str, Any]:
        """Return the materials and effects that were added or changed as plain values for JSON."""
        case = self.case
        return {
            "added": disk.json_numbers(self.added),
            "effects": [p.to_dict() for p in case.applied] if isinstance(case, Case) else [],
            "form": self.form,
            "surfaces": list(self.surfaces),
            "notes": [note.to_dict() for note in self.notes],
            "caution": self.caution,
            "lists": {
                name: {"notes": list(report.notes), "lost": list(report.lost)}
                for name, report in self.reports.items()
            },
            "room": self.room.to_dict(),
        }

    def contents(self, folder: Path) -> dict[Path, bytes]:
        """Return the content of each file that `save` would write into a folder, by path."""
        head = f"# {self.caution}\n" if self.caution else ""
        made = {ROOM: (head + self._with_mesh(folder / MESH).to_text(folder)).encode()}
        if isinstance(self.case, Case):
            made[CASE] = self.case.to_json(self.caution).encode()
        if self.geometry is not None:
            made[MESH] = self.geometry.to_text().encode()
        made |= {name: content for name, (content, _) in self._lists.items()}
        if self.caution and CATT in made:
            words = self.caution.replace("±", "+-").encode("ascii", "replace")
            made[CATT] = b"; " + words + b"\r\n" + made[CATT]
            made[CAUTION] = f"{self.caution}\n".encode()  # the other lists have no comments
        return {folder / name: content for name, content in made.items()}

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write the corrected room's files into a folder, all or none, and return their paths.

        ``room.toml`` is the room and, if a surface is identified, ``room.obj`` is its mesh. If means
        over positions were compared, ``case.json`` is the case with the effects. If every position was
        compared, ``catt.txt``, ``odeon.txt`` and ``pyroomacoustics.json`` are lists of materials for
        these programs. Octaves that the room does not have, but a list must have, get the coefficients
        of its nearest band.
        """
        where = checks.path("folder", folder)
        contents = self.contents(where)
        make_folder(where)
        write_all(contents)
        return [*contents]

    def _with_mesh(self, mesh: Path) -> Room:
        """Return the room with its mesh, and the faces of each surface, as its file states it."""
        case, solid, made = self.case, self.geometry, dict[str, list[str]]()
        if solid is None:
            return self.room
        if isinstance(case, PositionsCase) and case.surfaces is not None:
            before = case.geometry.names
            owners = {before[i]: name for name, faces in case.faces.items() for i in faces}
            for name, material in zip(solid.names, solid.materials, strict=True):
                # A face that is new is of the patch, or a piece of the wall that it is cut from.
                cut = material if material == self.material else self.surfaces[0]
                if owner := owners.get(name, "" if name in before else cut):
                    made.setdefault(owner, []).append(name)
        return self.room.replace(scene=replace(self.room.scene, mesh=mesh, surfaces=made))

    @property
    def reports(self) -> dict[str, ExportReport]:
        """Reports on what each list of materials cannot represent, and on its bands, by file name."""
        return {name: report for name, (_, report) in self._lists.items()}

    @cached_property
    def _lists(self) -> dict[str, tuple[bytes, ExportReport]]:
        """The lists of materials for each program, and their reports, by file name."""
        return {} if self.added is None else material_lists(self._with_mesh(Path(MESH)))

    def __repr__(self) -> str:
        if isinstance(self.case, Case):
            return f'<Corrected room "{self.room.name}"{_with_effects(self.case)}>'
        on = listed([f'"{name}"' for name in self.surfaces]) if self.surfaces else "all materials"
        what = "second state" if self.added is None else self.added.title
        return f"<Corrected room: {what} on {on}>"


def material_lists(room: Room) -> dict[str, tuple[bytes, ExportReport]]:
    """Return a room's list of materials for each program, and its report, by file name."""
    # Their writers fill in a list that exists; these are new ones.
    with disk.at_once(), tempfile.TemporaryDirectory(prefix="rtcal-") as empty:
        reports = {
            name: of.write(room, Path(empty, name), missing_bands="nearest")
            for name, of in LISTS.items()
        }
        return {n: (Path(empty, n).read_bytes(), r) for n, r in reports.items()}


# Means over positions.


_LARGEST_SHARE = 0.5
"""Share of the wall area up to which an absorber is enlarged for its size's interval. The limit only
bounds how far a calibration can enlarge the absorber."""
_MOST = 10.0  # area of an absorber over that of the walls beyond which no such absorber is made
_NO_ABSORPTION = 1e-12
"""Change of the absorption over the wall area under which an effect absorbs nothing."""
_OFF_GEOMETRY = 0.01
"""Share by which a geometry may differ from an area or a volume that the finding has changed."""
_STEP = 1e-4  # step of alpha for a derivative
_HELD = (
    *("volume", "areas", "alpha", "air", "speed_of_sound", "covering", "objects", "equation"),
    "walls",
)
"""Parts of a state that a room, or the equation that is named beside it, represents."""
_DECAY, _NO_AIR, _TOO_MUCH = "decay not in a room", "air of no climate", "absorbs too much"
"""Codes of the reasons for which a simulator of the room cannot represent an effect either."""


@dataclass(frozen=True, eq=False, repr=False)
class CaseModel(RoomSimulator):
    """Simulate a case's model with its effects, for given coefficients of the materials of ``room``."""

    case: Case
    room: Room  # the input materials, followed by one for each effect that absorbs
    stated: Room  # the input materials alone
    whole: RoomState  # state of the model with the coefficients of ``room``
    # Why a room cannot represent an effect, by the effect's name.
    absent: Mapping[str, Sequence[Reason]] = field(default_factory=dict)
    inner: Simulator | None = None
    """Simulator of ``stated``, over whose walls the effects' absorption is spread; by default the
    equation gives the values of the first configuration."""

    @property
    def name(self) -> str:
        """Name of the model to which calibrated coefficients belong."""
        own = f"the model of {self.case.room.name}" if self.inner is None else self.inner.name
        return f"{own}{_with_effects(self.case)}"

    @property
    def deterministic(self) -> bool:
        """Whether its results do not depend on the seed."""
        return self.inner is None or self.inner.deterministic

    def state(self, alpha: Array) -> RoomState:
        """Return the state with alpha (n_materials, n_bands) of the materials of ``room``."""
        equation = mean_equation(self.whole.equation)

        def absorbed(of: Array) -> Array:
            h = equation.contribution(np.minimum(of, equation.largest_alpha))
            h = np.where(self.room.is_surface[:, np.newaxis], h, of)
            mean = np.minimum(self.room.areas @ h / self.room.total_area, highest(equation))
            return np.asarray(self.room.total_area * equation.exponent(mean))

        new = replace(self.whole, alpha=alpha[: self.stated.n_materials])
        more = absorbed(alpha) - absorbed(self.room.alpha)
        walls = new.surface_absorption - self.whole.surface_absorption
        return new.with_objects(more - walls)

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Simulate alpha (n_materials, n_bands)."""
        s = self.state(check_alpha(self, alpha))
        if self.inner is None:
            features = predict_in(self.case, self.case.configurations[0], [s]).features[0]
            return values_of_features(features, self.centre_frequencies, FEATURES)
        # The stated materials, with which the walls absorb all.
        linear = mean_equation(s.equation).linear()
        bare = replace(s, covering=0.0, objects=0.0)
        whole, walls = (linear.inverse(_absorbing(at) / at.total_area) for at in (s, bare))
        whole = np.where(np.isfinite(whole), np.minimum(whole, 1.0), 1.0)
        more = (whole - walls) / (1 - walls)
        spread = np.where(more > 0, s.alpha + more * (1 - s.alpha), s.alpha * whole / walls)
        return run(self.inner, np.clip(spread, 0.0, 1.0), seed=seed)

    def spread_over(self, make: Callable[[Room], Simulator]) -> CaseModel:
        """Return the model in a simulator that ``make`` returns for a room with the input materials."""
        if not callable(make):
            raise DataError(
                f"make = {make!r} must be a function that takes a room and returns a simulator"
            )
        for p in self.case.applied:
            absent = {why.code: why for why in self.absent.get(p.name, ())}
            why = next(
                (absent[code] for code in (_DECAY, _NO_AIR, _TOO_MUCH) if code in absent), None
            )
            if why is not None and (words := p.effect.not_in_simulator) is not None:
                raise DataError(f"{p.name}: {words}" if why.code == _DECAY else str(why))
        self.stated.refuse_pieces("make, a simulator of your own")
        inner, room = make(self.stated), self.case.room
        if not isinstance(inner, Simulator):
            raise DataError(
                f"make returned {checks.shown(inner)}; it must return an rtcal.simulators.Simulator"
            )
        if tuple(inner.materials) != tuple(room.materials):
            raise DataError(
                f"{inner.name}, which make returned, has the materials "
                f"{', '.join(inner.materials)}; it must have those of the case, "
                f"{', '.join(room.materials)}"
            )
        if not np.array_equal(inner.centre_frequencies, room.centre_frequencies):
            raise DataError(
                f"{inner.name}, which make returned, has "
                f"{bands.span(inner.centre_frequencies)}; it must have those of the case, "
                f"{bands.span(room.centre_frequencies)}"
            )
        if (geometry := getattr(inner, "geometry", None)) is not None:
            # An area, or the volume, that the finding has changed.
            areas = zip(room.materials, room.areas, self.stated.areas, strict=True)
            sizes = [("volume", room.volume, self.stated.volume, geometry.volume, "m³")]
            sizes += [
                (f'area of "{n}"', float(one), float(other), geometry.areas.get(n, 0.0), "m²")
                for n, one, other in areas
            ]
            for what, one, other, drawn, unit in sizes:
                if one != other and abs(drawn - other) > _OFF_GEOMETRY * other:
                    raise DataError(
                        f"{what}: the finding needs {other:.4g} {unit}, but the "
                        f"simulator's geometry has {drawn:.4g} {unit}. Draw the geometry "
                        "with the finding's value"
                    )
        return replace(self, inner=inner)


def _with_effects(case: Case) -> str:
    return "".join(f" with {p.name}" for p in case.applied)


def _absorbing(s: RoomState) -> Array:
    """Return the absorption area of walls and objects in m², (n_bands,)."""
    return np.asarray(s.surface_absorption + s.objects)


def corrected_case(case: Case) -> Corrected:
    """Return the corrected room of a case, to which each of the case's effects is added in turn.

    An effect that changes an input material changes its coefficients, and the material's ``source``
    names it. One that adds absorption becomes a material after the input materials.
    """
    base = replace(case.configurations[0], changes={}, suspect_removed=False, air=None)
    room, air, last_air = case.room, case.room.air, "air"
    first = after = state(replace(case, applied=()), base)
    absent: dict[str, list[Reason]] = {}
    gains: list[tuple[AppliedEffect, Array]] = []
    sources = dict(room.sources)
    for p in case.applied:
        before, after = after, with_applied(after, [p], base)
        for row in np.flatnonzero((after.alpha != before.alpha).any(axis=1)).tolist():
            name = room.materials[row]
            changed = f"changed by rtcal find: {p.name}, {_size(p, room)}"
            sources[name] = "; ".join(filter(None, [sources.get(name, ""), changed]))
        pairs = [(getattr(after, k), getattr(before, k)) for k in ("covering", "objects")]
        gain = np.array([one - other + np.zeros(room.n_bands) for one, other in pairs])
        if gain.any():
            gains.append((p, gain))
        if any(
            not np.array_equal(getattr(after, f.name), getattr(before, f.name))
            for f in fields(RoomState)
            if f.name not in _HELD
        ):
            absent[p.name] = [Reason(_DECAY, {"effect": p.name})]
        if not np.array_equal(after.air, before.air):
            air, last_air = p.effect.air(air, p.parameters), p.name
    attenuation = 0.0 if air is None else air.attenuation(room.centre_frequencies)
    if not np.allclose(attenuation, after.air, rtol=1e-12, atol=0):
        absent[last_air] = [Reason(_NO_AIR, {"effect": last_air})]
    stated = room.replace(
        air=air,
        alpha=after.alpha,
        sigma=_sigma(case, base, first, after),
        alpha_min=None if room.alpha_min is None else np.minimum(room.alpha_min, after.alpha),
        sources=sources,
    )
    other = after.areas != room.areas
    if after.volume != room.volume or other.any():
        resized: dict[str, Any] = {"volume": after.volume, "areas": after.areas}
        if after.volume != room.volume or other[room.is_surface].any():
            resized |= {"dimensions": None, "surfaces": ()}
        stated = stated.replace(**resized)
    made, further = stated, _absorbers(stated, after, gains, absent)
    if further:
        new = [Surface(name=m.name, material=m.name, area=float(m.area or 0)) for m in further]
        surfaces = (*stated.surfaces, *new) if stated.surfaces else ()
        rows = [*map(stated.material, stated.materials), *further]
        made = stated.with_rows(rows, surfaces=surfaces)
    # What a room cannot represent: decay shape, noise, equation, surfaces.
    notes = [why for each in absent.values() for why in each]
    if after.equation != case.equation:
        notes.append(Reason("equation", {"equation": str(after.equation)}))
    speed, own = after.speed_of_sound, made.speed_of_sound
    if speed != own:
        off = {"model": speed, "room": own, "by": 100 * (speed / own - 1)}
        notes.append(Reason("speed of sound", off))
    lost = [n for n in ("surfaces", "dimensions") if getattr(room, n) and not getattr(made, n)]
    if lost:
        notes.append(Reason("no place", {"lost": lost}))
    inputs = [("volume", " m³", room.volume, made.volume)]
    for name, was, area in zip(room.materials, room.areas, made.areas, strict=False):
        what, unit = ("number", "") if name in room.pieces else ("area", " m²")
        inputs.append((f'{what} of "{name}"', unit, float(was), float(area)))
    for what, unit, was, now in inputs:
        if now != was:
            values = {"what": what, "unit": unit, "before": was, "now": now}
            notes.append(Reason("input changed", values))
    model = CaseModel(case, made, stated, after, absent)
    return Corrected(case=case, room=made, notes=tuple(notes), model=model)


def _absorbers(
    stated: Room,
    whole: RoomState,
    gains: Sequence[tuple[AppliedEffect, Array]],
    absent: dict[str, list[Reason]],
) -> list[Material]:
    """Return materials of effects that add absorption; ``absent`` gets what none represents."""
    equation, walls = mean_equation(whole.equation), whole.total_area
    at = replace(whole, covering=0.0, objects=0.0)
    scattering = None
    if stated.scattering is not None:
        scattering = (stated.areas @ stated.scattering / stated.total_area).tolist()
    names, further = list(stated.materials), list[Material]()
    area, contribution = walls, walls * mean_contributions(equation, [at])[0]
    absorbed = at.surface_absorption
    top = float(equation.contribution(np.array(min(1.0, equation.largest_alpha))))
    for p, (covering, objects) in gains:
        before, at = at, replace(at, covering=at.covering + covering, objects=at.objects + objects)
        gain = (_absorbing(at) - _absorbing(before)) / walls

        def lacks(code: str, effect: str = p.name, **values: Any) -> None:
            absent.setdefault(effect, []).insert(0, Reason(code, {"effect": effect, **values}))

        if (gain <= _NO_ABSORPTION).all():
            if (gain < -_NO_ABSORPTION).any():
                lacks("takes absorption")
            continue

        def standing(
            size: float,
            wanted: Array = absorbed + walls * gain,
            area: float = area,
            other: Array = contribution,
        ) -> Array:
            """Return h of an absorber of this area with which the room absorbs what is wanted."""
            mean = equation.inverse(wanted / (area + size))
            return np.asarray(((area + size) * mean - other) / size)

        least = _smallest(standing, top, walls)
        if least is None:
            lacks(_TOO_MUCH)
            continue
        spread = p.size_sigma / max(abs(p.size), 1e-9)
        larger = _smallest(standing, top / (1 + NORMAL_90 * spread), walls) or least
        size = max(least, min(larger, _LARGEST_SHARE * walls))
        h = standing(size)
        if (h < 0).any():
            lacks("hides wall", bands=bands.labels(stated.centre_frequencies[h < 0]))
        h = np.clip(h, 0, top)
        alpha = equation.coefficient(h)
        names.append(new_name(names, p.name))
        further.append(
            Material(
                names[-1],
                alpha.tolist(),
                np.minimum(alpha * spread, 1.0).tolist(),
                0.0,
                scattering,
                f"rtcal find: {_size(p, stated)}. It stands free with {size:.3g} m², so that a "
                "calibration can make it absorb more",
                size,
            )
        )
        area, contribution = area + size, contribution + size * h
        absorbed = area * equation.exponent(np.minimum(contribution / area, highest(equation)))
    return further


def _smallest(standing: Callable[[float], Array], top: float, walls: float) -> float | None:
    """Return the smallest area in m² at which no band of an absorber exceeds ``top``; None if none."""

    def fits(size: float) -> bool:
        return bool((standing(size) <= top).all())  # NaN, where no mean absorbs as much, does not

    high = _MOST * walls
    if not fits(high):
        return None
    low = 1e-9 * walls
    while high / low > 1 + 1e-13:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if fits(middle) else (middle, high)
    return high


def _size(p: AppliedEffect, room: Room) -> str:
    return amount(p.size, p.effect.unit_in(p.parameters, room), p.size_interval).rstrip()


def _sigma(case: Case, base: Configuration, before: RoomState, after: RoomState) -> Array:
    """Return sigma of the stated materials: that of what is seen of them, and of the effects' sizes."""
    if np.array_equal(after.alpha, before.alpha):
        return case.room.sigma
    at = np.array(case.room.alpha)
    step = np.where(at < 0.5, _STEP, -_STEP)
    seen = (state(case, base, at + step).alpha - after.alpha) / step  # of what is not covered
    variance = (case.room.sigma * seen) ** 2
    for i, p in enumerate(case.applied):
        if p.size_interval is not None:
            sized = (
                [*case.applied[:i], p.resized(end), *case.applied[i + 1 :]]
                for end in p.size_interval
            )
            low, high = (state(replace(case, applied=each), base).alpha for each in sized)
            variance = variance + ((high - low) / (2 * NORMAL_90)) ** 2
    return np.minimum(np.sqrt(variance), case.room.most_alpha)


# Surfaces.


SPECTRUM_ERROR = 0.15
"""Relative standard deviation of the alpha of a material that was found: catalogues differ by so
much."""
HEADROOM = 0.9
"""Factor by which a patch of alpha = 1 is drawn larger than found, so that a calibration can raise its
absorption as well as lower it."""
DRAWN_LARGER = "patch drawn larger"
"""Code of the note that a patch was drawn larger."""
_LEAST_SIGMA = 0.01
_NOTED = 0.05  # share of a change that does not fit, from which on a note says so
_GONE = 1e-6  # share of all surfaces under which a material is no longer there


def corrected_geometry(
    case: PositionsCase, added: Candidate, form: str = "patch", at: Sequence[float] | None = None
) -> Corrected:
    """Return room and geometry with a candidate on its surface; see `rtcal.finder.Finding.apply`."""
    if form not in ("patch", "material"):
        raise DataError(f'form = "{form}" must be "patch" or "material"')
    if added.surface is None:
        raise DataError(f"{added.title} is not on a surface: leave form and at out")
    if form == "material" and at is not None:
        raise DataError(
            'at and form = "material" are both given: at is the centre of a patch, and '
            'form = "material" changes the whole surface. Leave one of them out'
        )
    room, faces = case.room, case.faces[added.surface]
    name = new_name(room.materials, f"{added.effect} on {added.surface}")
    geometry, notes = None, list[Reason]()
    if form == "patch":
        wanted = added.size * max(1.0, float(added.spectrum.max()) / HEADROOM)
        middle = added.middle if at is None else at
        place = None if middle is None else point(middle)
        geometry = patched(case.geometry, faces, wanted, name, name, place)
        if geometry is None:
            form = "material"
            ends = {"patch": wanted, "surface": added.surface, "area": case.areas[added.surface]}
            notes.append(Reason("patch too large", ends))
    if geometry is None:
        geometry = _with_material(case.geometry, name, faces)
    area = geometry.areas[name]
    if form == "patch" and not np.isclose(area, added.size, rtol=1e-3):
        notes.append(Reason(DRAWN_LARGER, {"drawn": area, "size": added.size}))
    # The rest of what is larger than the size absorbs as the wall does.
    behind = _behind(room, case.geometry, geometry) / area
    below, share = behind @ room.alpha, min(added.size / area, 1.0)
    alpha = below + share * (added.spectrum - below)
    deviation = np.log(max(added.high, added.size) / max(added.low, 1e-9)) / (2 * NORMAL_90)
    variance = (share * added.spectrum * SPECTRUM_ERROR) ** 2
    variance += (share * (added.spectrum - below) * deviation) ** 2
    variance += ((1 - share) * (behind @ room.sigma)) ** 2
    drawn = notes if form == "patch" else []
    new = Material(
        name,
        np.clip(alpha, 0.0, 1.0).tolist(),
        np.clip(np.sqrt(variance), _LEAST_SIGMA, 1.0).tolist(),
        scattering=(behind @ case.simulator.scattering).tolist(),
        source=" ".join([f"rtcal find: {added.title}, {added.in_words}.", *map(str, drawn)]),
    )
    # Simulators of boxes know one material per wall.
    stated = room.replace(dimensions=None) if form == "patch" else room
    return Corrected(
        case=case,
        room=_in_geometry(stated, case.simulator, geometry, [new], case.position_uncertainty),
        geometry=geometry,
        surfaces=(added.surface,),
        notes=tuple(notes),
        added=added,
        material=name,
        form=form,
    )


def _behind(room: Room, before: Polyhedron, after: Polyhedron) -> Array:
    """Return the area of each material that is no longer in a geometry, (n_materials,) in m²."""
    stated, left = before.areas, after.areas
    return np.array([stated.get(m, 0.0) - left.get(m, 0.0) for m in room.materials])


def _with_material(geometry: Polyhedron, material: str, faces: NDArray[np.intp]) -> Polyhedron:
    """Return the geometry with a material on these faces."""
    made_of = enumerate(geometry.materials)
    return replace(geometry, materials=[material if i in faces else of for i, of in made_of])


def _in_geometry(
    room: Room,
    tracer: PathTracing,
    geometry: Polyhedron,
    new: Sequence[Material],
    uncertainty: float = POSITION,
) -> Room:
    """Return the room with a geometry's areas and new materials; its scene names no mesh."""
    left = room.areas - _behind(room, tracer.geometry, geometry)
    drawn = geometry.areas
    kept = [
        i
        for i, name in enumerate(room.materials)
        if (name in drawn or name not in tracer.geometry.areas)
        and left[i] > _GONE * room.total_area
    ]
    of_files = {
        name: of
        for name, of in room.scene.directivity.items()
        if isinstance(of, Directivity) and of.file is not None
    }
    scene = Scene(
        sources=tracer.sources,
        receivers=tracer.receivers,
        directivity={**tracer.directivity, **of_files},  # a balloon is too much for a file
        position_uncertainty=uncertainty,
    )
    stated = room.replace(
        scattering=tracer.scattering, scattering_model=tracer.scattering_model, surfaces=()
    )
    rows = [replace(stated.material(room.materials[i]), area=float(left[i])) for i in kept]
    rows += [replace(material, area=drawn[material.name]) for material in new]
    surfaces = geometry.surfaces if room.surfaces else ()
    return stated.with_rows(rows, surfaces=surfaces, scene=scene)


def surface_at(case: PositionsCase, at: Sequence[float]) -> str:
    """Return the name of the surface at a point (x, y, z) in m; DataError far from every surface."""
    place = point(at)
    face, distance = face_at(case.geometry, place)
    name = next((n for n, faces in case.faces.items() if face in faces), None)
    if name is None or distance > NEAR:
        where = ", ".join(f"{x:g}" for x in place)
        nearest = "" if name is None else f'; the nearest is "{name}", {distance:.2g} m away'
        raise DataError(f"at = ({where}) m is on no surface{nearest}")
    return name


def point(at: Sequence[float]) -> Array:
    """Return a point (x, y, z) in m as an array (3,); raises DataError for anything else."""
    place = checks.array("at", at)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise DataError(f"at = {at!r} must be three finite numbers in m")
    return place


# Two states.


def changed_room(
    case: StatesCase, area: Array, change: Array, surfaces: Sequence[str], kinds: Sequence[str]
) -> Corrected:
    """Return the room after a change, by its area before (n_bands,) and the change (3, n_bands) in m².

    The coefficients are those of a calibration to T before, plus the mean change; their sigma
    contains the uncertainty of the change. ``surfaces`` are those that changed, if any is
    identified, and ``kinds`` the effects that may be the change.
    """
    labels = bands.labels(case.room.centre_frequencies)
    stated = case.room.replace(calibration=None)
    fitted = calibrate(stated, case.times[0], equation=case.equation, unreachable="nearest")
    # T before, not that of the changed room, stays on record: it is not to count twice.
    record = replace(cast("Any", fitted.room.calibration), method=CHANGED)
    before = fitted.room.replace(calibration=record)
    change = np.where(np.isfinite(change), change, 0.0)
    mean, spread = change[0], (change[2] - change[1]) / (2 * NORMAL_90)
    notes = []
    if not case.known.all():
        at = [label for label, known in zip(labels, case.known, strict=True) if not known]
        notes.append(Reason("bands unknown", {"bands": at}))
    geometry, tracer = None, case.simulator
    names, rows = list(before.materials), [*np.diag(before.areas)]
    if surfaces and tracer is not None:
        geometry, faces, rows = tracer.geometry, of_geometry(tracer.geometry), []
        for surface in surfaces:
            names.append(new_name(names, f"{surface}, changed"))
            after = _with_material(geometry, names[-1], faces[surface])
            rows.append(_behind(before, geometry, after))
            geometry = after
    # What changes is of the materials in proportion to the areas in its row.
    areas = np.array(rows).sum(axis=1)
    mix = np.array(rows) / areas[:, np.newaxis]
    was = mix @ before.alpha
    # What is added has a surface; what is removed may be pieces such as persons.
    pieces = np.array([name in before.pieces for name in names[len(names) - len(mix) :]])
    most = np.where(pieces, LARGEST_PIECE, 1.0)[:, np.newaxis]
    by_share = np.where(mean > 0, np.where(pieces[:, np.newaxis], 0.0, 1 - was), was)
    left = np.maximum(areas @ by_share, 1e-9)
    alpha = np.clip(was + np.clip(mean / left, -1.0, 1.0) * by_share, 0.0, most)
    sigma = np.hypot(mix @ before.sigma, by_share * spread / left)
    sigma = np.clip(sigma, _LEAST_SIGMA, most)
    lacking = mean - areas @ (alpha - was)
    sources = []
    for row in mix:
        of = dict.fromkeys(before.sources.get(names[i]) for i in np.flatnonzero(row > _GONE))
        sources.append("; ".join([*filter(None, of), "changed by rtcal find: two states"]))
    if geometry is not None and tracer is not None:
        columns = (alpha.tolist(), sigma.tolist(), (mix @ tracer.scattering).tolist(), sources)
        of_names = zip(names[before.n_materials :], *columns, strict=True)
        new = [Material(name, a, s, 0.0, scatters, of) for name, a, s, scatters, of in of_names]
        room = _in_geometry(before, tracer, geometry, new)
    else:
        changed = dict(before.sources)
        for i in np.flatnonzero((alpha != before.alpha).any(axis=1)).tolist():
            changed[names[i]] = sources[i]
        room = before.replace(alpha=alpha, sigma=sigma, sources=changed)
        notes.append(Reason("surface unknown"))
    off = before.areas @ before.alpha - area
    for k, label in enumerate(labels):
        if abs(lacking[k]) > _NOTED * abs(mean[k]):
            part = {"band": label, "rest": float(abs(lacking[k])), "change": float(mean[k])}
            notes.append(Reason("change does not fit", part))
        if abs(off[k]) > _NOTED * area[k]:
            notes.append(Reason("T before out of reach", {"band": label, "off": float(off[k])}))
    if len(kinds) > 1:
        notes.append(Reason("kind unknown", {"kinds": tuple(kinds)}))
    on = () if geometry is None else tuple(surfaces)
    return Corrected(case=case, room=room, geometry=geometry, surfaces=on, notes=tuple(notes))
