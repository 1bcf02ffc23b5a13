"""The corrected room as a `Room` and as a `Simulator`, for use in other packages.

Volume, areas, coefficients and air are those of the case's state with its effects. Absorption that
belongs to no stated material becomes a further material, which replaces every wall in proportion to
its area. Its area equals its largest absorption area over the bands, with its size at the upper end of
the 90 % interval. So a calibration can increase the absorber as well as decrease it. A `Room` cannot
represent the decay's shape or noise (`not_in_room`); the `Simulator` does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.changes import Further, new_name, with_materials
from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.materials import Material
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import Room
from rtcal.finder.case import Case
from rtcal.finder.configuration import Configuration
from rtcal.finder.effects.checks import AppliedEffect
from rtcal.finder.finding import amount
from rtcal.finder.means.features import distances, state, with_applied
from rtcal.finder.model import FEATURES, RoomState, highest, mean_contributions, predict
from rtcal.simulators.base import RoomSimulator, Simulator, check_alpha, run
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.text import listed
from rtcal.support.types import Array

_LARGEST_SHARE = 0.5
"""Share of the wall area up to which an absorber is enlarged for its size's interval.

Half of every wall remains. T of the corrected room does not depend on the share w, since the
absorber's coefficient is wall + (both - wall) / w. The limit only bounds how far a calibration can
enlarge the absorber."""
_LARGER = ", larger than found, so that a calibration can make it absorb more"
_NO_ABSORPTION = 1e-12
"""Change of the mean over the walls under which an effect absorbs nothing."""
_OFF_GEOMETRY = 0.01
"""Share by which a geometry may differ from an area or a volume that the finding has changed."""
_HELD = ("volume", "areas", "alpha", "air", "speed_of_sound", "covering", "objects", "equation")
"""Parts of a state that a room, or the equation that is named beside it, represents."""


@checked
def corrected_room(case: Case) -> Room:
    """Return the case's room with its effects, not calibrated.

    By the model's equation it has the absorption area and T of the case's model, without what
    `not_in_room` lists. (A calibration of Millington's model uses Eyring's equation.) A change of a
    stated material, such as a cover, is in its row, and its source says so. Absorbers are materials
    after the stated ones, with the walls' mean scattering. Their sigma, and that of a changed material,
    contains the interval of the effect's size. An absorber's area is larger than the effect's, so that
    alpha = 1 is the upper end of the interval.

    Raises DataError for coefficients below 0 or above 1.
    """
    return _corrected(case).room


def not_in_room(case: Case) -> list[str]:
    """Return, in words, what a room cannot represent: decay shape, noise, equation, surfaces."""
    c = _corrected(case)
    out = [f"{name}: {why}" for name, why in c.absent.items()]
    if c.whole.equation != case.equation:
        out.append(f"formula: a room names no equation; calibrate it with {c.whole.equation}")
    model, own = c.whole.speed_of_sound, c.room.speed_of_sound
    if model != own:
        out.append(
            f"speed of sound: the model has {model:.1f} m/s, the room {own:.1f} m/s, that of its air; "
            f"so its T is {abs(100 * (model / own - 1)):.1f} % {'shorter' if own > model else 'longer'}"
        )
    names = ("surfaces", "dimensions")
    lost = [n for n in names if getattr(case.room, n) and not getattr(c.room, n)]
    if changed := _resized(case.room, c):
        out.append(f"{listed([*lost, 'areas as stated'])}: {listed(changed)}")
    return out


def _resized(stated: Room, c: _Corrected) -> list[str]:
    """Return in words which areas, and whether the volume, are other than stated, and why."""
    room, n = c.room, stated.n_materials
    out = []
    if room.volume != stated.volume:
        out = [f"the volume is {room.volume:.4g} m³ and was {stated.volume:.4g}"]
    for name, was, area in zip(stated.materials, stated.areas, c.stated.areas, strict=True):
        if area != was:
            out.append(f'the area of "{name}" is {area:.4g} m² and was {was:.4g}')
    if c.shares:
        further = zip(room.materials[n:], room.areas[n:], strict=True)
        each = listed([f"{name} ({area:.1f} m²)" for name, area in further])
        factor = room.areas[0] / c.stated.areas[0]
        out.append(f"each area is {factor:.3g} times as large, and the rest became {each}{_LARGER}")
    return out


@checked
def simulator(case: Case, make: Callable[[Room], Simulator] | None = None) -> Simulator:
    """Return a simulator of the corrected room; the rows of alpha are `corrected_room`'s.

    Parameters
    ----------
    case : Case
        With the effects that `MeansFinding.apply` has added.
    make : function, optional
        Builds a simulator for a room of the stated materials, with the air, volume and areas of the
        finding: ``lambda room: PathTracing(room=room, geometry=..., ...)``. Absorbers are spread over
        all its walls: alpha = (1 - w) alpha_wall + w alpha_absorber, w their share of the area. By
        default the simulator is the case's model: equation, decay and noise.

    Raises
    ------
    DataError
        If ``make``'s simulator cannot represent an effect: a coupled room, a noise floor, a custom
        effect on the decay, or an area or volume other than its geometry's.
    """
    if make is None:
        return CaseModel(case)
    if not callable(make):
        raise DataError(f"make = {make!r} is not a function of a room")
    c = _corrected(case)
    for p in case.applied:
        if p.name in c.absent and p.effect.not_in_simulator is not None:
            why = c.absent[p.name]
            raise DataError(f"{p.name}: {p.effect.not_in_simulator if why == _DECAY else why}")
    return SpreadAbsorbers(case, make(c.stated))


@dataclass(frozen=True, eq=False, repr=False)
class CaseModel(RoomSimulator):
    """A case's model as a `Simulator`: T20, EDT, T30, C80 and G of its first configuration."""

    case: Case
    room: Room = field(init=False)
    deterministic: bool = field(default=True, init=False)
    smooth: bool = field(default=True, init=False)
    _corrected: _Corrected = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_corrected", _corrected(self.case))
        object.__setattr__(self, "room", self._corrected.room)

    @property
    def name(self) -> str:
        """Name of the model to which calibrated coefficients belong."""
        return f"the model of {self.case.room.name}{_added(self.case)}"

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return what the model predicts for alpha (n_materials, n_bands)."""
        alpha = check_alpha(self, alpha)
        at = distances(self.case, _base(self.case))
        predicted = predict([self._corrected.state(alpha)], at)
        rows = dict(zip(FEATURES, predicted.features[0], strict=True))
        t20 = np.exp(rows["t20"])
        return Measurement.from_values(
            self.centre_frequencies,
            t20=t20,
            edt=t20 * np.exp(rows["edt"]),
            t30=t20 * np.exp(rows["t30"]),
            c80=rows["c80"],
            g=rows["g"],
        )


@dataclass(frozen=True, eq=False, repr=False)
class SpreadAbsorbers(RoomSimulator):
    """A simulator of the stated materials, with a corrected room's absorbers spread over its walls."""

    case: Case
    inner: Simulator
    room: Room = field(init=False)

    def __post_init__(self) -> None:
        c = _corrected(self.case)
        object.__setattr__(self, "room", c.room)
        if tuple(self.inner.materials) != tuple(self.case.room.materials):
            raise DataError(
                f"{self.inner.name} has the materials {', '.join(self.inner.materials)}; the case "
                f"has {', '.join(self.case.room.materials)}"
            )
        if not np.array_equal(self.inner.centre_frequencies, self.case.room.centre_frequencies):
            raise DataError(
                f"{self.inner.name} has {bands.span(self.inner.centre_frequencies)}; the case has "
                f"{bands.span(self.case.room.centre_frequencies)}"
            )
        if (geometry := getattr(self.inner, "geometry", None)) is not None:
            _check_geometry(self.case.room, c.stated, geometry)

    @property
    def name(self) -> str:
        """Name of the model to which calibrated coefficients belong."""
        return f"{self.inner.name}{_added(self.case)}"

    @property
    def deterministic(self) -> bool:
        """Whether the simulator of the stated materials is deterministic."""
        return self.inner.deterministic

    @property
    def smooth(self) -> bool:
        """Whether T of the simulator of the stated materials is smooth."""
        return self.inner.smooth

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Simulate alpha (n_materials, n_bands)."""
        alpha = check_alpha(self, alpha)
        n = len(self.inner.materials)
        share = self.room.areas[n:] / self.room.total_area
        return run(self.inner, (1 - share.sum()) * alpha[:n] + share @ alpha[n:], seed=seed)


def _check_geometry(before: Room, after: Room, geometry: Polyhedron) -> None:
    """Refuse a geometry without an area, or the volume, that the finding has changed."""
    pairs = [("volume", before.volume, after.volume, geometry.volume, "m³")]
    for name, one, other in zip(before.materials, before.areas, after.areas, strict=True):
        drawn = geometry.areas.get(name, 0.0)
        pairs.append((f'area of "{name}"', float(one), float(other), drawn, "m²"))
    for what, one, other, drawn, unit in pairs:
        if one != other and abs(drawn - other) > _OFF_GEOMETRY * other:
            raise DataError(
                f"{what}: the finding has {other:.4g} {unit}, the simulator's geometry {drawn:.4g} "
                f"{unit}; draw it anew"
            )


def _added(case: Case) -> str:
    return "".join(f" with {p.name}" for p in case.applied)


def _base(case: Case) -> Configuration:
    """The first configuration, with nothing changed or removed in it."""
    return replace(case.configurations[0], changes={}, suspect_removed=False, air=None)


_DECAY = "a room has surfaces and air only"
_NO_AIR = "its air is not that of a climate (ISO 9613-1)"
_TOO_MUCH = "no coefficients from 0 to 1 absorb so much, or so little, on these surfaces"


@dataclass(frozen=True, eq=False)
class _Corrected:
    """A corrected room, and what links it to the case's state.

    ``stated`` has the stated materials alone. ``whole`` is the state with all effects, ``kept`` the
    same without the absorption that has become the room's absorbers. ``shares`` are the absorbers'
    shares of the area, each of what stood before it. The first ``n_coverings`` replace wall, the others
    are objects. ``absent`` says why a room cannot represent an effect.
    """

    room: Room
    stated: Room
    whole: RoomState
    kept: RoomState
    shares: tuple[float, ...]
    n_coverings: int
    absent: dict[str, str]

    def state(self, alpha: Array) -> RoomState:
        """Return the state with the room's coefficients (n_materials, n_bands).

        Coverings and objects stay what they are, so that a decay's shape is the same, too.
        """
        n = self.stated.n_materials
        equation, area = mean_equation(self.whole.equation), self.whole.total_area
        s = replace(self.kept, alpha=alpha[:n], covering=0.0, objects=0.0)
        mean = mean_contributions(equation, [s])[0]
        covering, objects = self.kept.covering, self.kept.objects
        for i, (w, row) in enumerate(zip(self.shares, alpha[n:], strict=True)):
            patch = equation.contribution(np.minimum(row, equation.largest_alpha))
            after = np.minimum((1 - w) * mean + w * patch, highest(equation))
            if i < self.n_coverings:
                covering = covering + area * (after - mean)
            else:
                objects = objects + area * (equation.exponent(after) - equation.exponent(mean))
            mean = after
        return replace(s, covering=covering, objects=objects)


def _corrected(case: Case) -> _Corrected:
    """Return the corrected room: a step per effect, then an absorber for each change of absorption."""
    base, room, air = _base(case), case.room, case.room.air
    first = before = state(replace(case, applied=()), base)
    absent, last_air = dict[str, str](), "air"
    gains: dict[str, list[tuple[AppliedEffect, Array]]] = {"covering": [], "objects": []}
    sources = dict(room.sources)
    for p in case.applied:
        after = with_applied(before, [p], base)
        for row in np.flatnonzero((after.alpha != before.alpha).any(axis=1)).tolist():
            name = room.materials[row]
            sources[name] = "; ".join(filter(None, [sources.get(name, ""), _changed_by(p)]))
        for name, each in gains.items():
            gain = getattr(after, name) - getattr(before, name) + np.zeros(room.n_bands)
            if gain.any():
                each.append((p, gain))
        if any(
            not np.array_equal(getattr(after, f.name), getattr(before, f.name))
            for f in fields(RoomState)
            if f.name not in _HELD
        ):
            absent[p.name] = _DECAY
        climate = p.effect.air(air, p.parameters)
        air = climate if _is_air(climate, after) else air
        if after.air is not before.air:
            last_air = p.name
        before = after
    whole = before
    if not _is_air(air, whole):
        absent[last_air] = _NO_AIR
    stated = room.replace(
        air=air,
        alpha=whole.alpha,
        sigma=_sigma(case, first, whole),
        alpha_min=None if room.alpha_min is None else np.minimum(room.alpha_min, whole.alpha),
        sources=sources,
    )
    if whole.volume != room.volume or not np.array_equal(whole.areas, room.areas):
        stated = stated.replace(
            volume=whole.volume, areas=whole.areas, dimensions=None, surfaces=()
        )
    return _with_absorbers(stated, whole, gains, absent)


def _with_absorbers(
    stated: Room,
    whole: RoomState,
    gains: dict[str, list[tuple[AppliedEffect, Array]]],
    absent: dict[str, str],
) -> _Corrected:
    """Return the room with a material for each effect's coverings, then for each one's objects."""
    equation = mean_equation(whole.equation)
    at = kept = replace(whole, covering=0.0, objects=0.0)
    wall = _absorption(at)
    top = float(equation.contribution(np.array(min(1.0, equation.largest_alpha))))
    areas, names, shares = stated.areas, list(stated.materials), list[float]()
    materials: list[Material] = []
    scattering = None
    if stated.scattering is not None:
        scattering = (stated.areas @ stated.scattering / stated.total_area).tolist()
    n_coverings = 0
    for kind, every in gains.items():
        for p, gain in every:
            after = replace(at, **{kind: getattr(at, kind) + gain})
            both = _absorption(after)
            if np.allclose(wall, both, rtol=0, atol=_NO_ABSORPTION):
                kept = replace(kept, **{kind: getattr(kept, kind) + gain})
                continue
            with np.errstate(divide="ignore", invalid="ignore"):
                least = [(both - wall) / (top - wall), (wall - both) / wall]
                w = float(np.max(np.where(both == wall, 0.0, least)))
            if not w < 1:  # also where the equation has no mean of such an exponent
                absent[p.name] = _TOO_MUCH
                kept = replace(kept, **{kind: getattr(kept, kind) + gain})
                continue
            w = max(w, min(w * (1 + NORMAL_90 * _spread(p)), _LARGEST_SHARE))
            absorber = np.clip(wall + (both - wall) / w, 0, top)
            areas = np.append((1 - w) * areas, w * stated.total_area)
            shares.append(w)
            names.append(new_name(names, p.name))
            source = ""
            if p.size_interval is not None:
                source = f"rtcal find: {_size(p)}{_LARGER}"
            alpha = equation.coefficient(absorber)
            mean_wall = stated.absorption_area / stated.total_area
            sigma = np.minimum(np.abs(alpha - mean_wall) * _spread(p), 1.0)
            materials.append(
                Material(names[-1], alpha.tolist(), sigma.tolist(), 0.0, scattering, source)
            )
            at, wall = after, both
        if kind == "covering":
            n_coverings = len(shares)
    room = stated
    if shares:
        n = stated.n_materials
        further = [Further(m, area) for m, area in zip(materials, areas[n:], strict=True)]
        room = with_materials(stated, further, areas=areas[:n], surfaces=(), dimensions=None)
    return _Corrected(room, stated, whole, kept, tuple(shares), n_coverings, absent)


def _changed_by(p: AppliedEffect) -> str:
    """Return what a changed material's source says of an effect: its name and its size."""
    return f"changed by rtcal find: {p.name}, {_size(p)}"


def _size(p: AppliedEffect) -> str:
    return amount(p.size, p.effect.unit, p.size_interval).rstrip()


def _is_air(air: Air | None, s: RoomState) -> bool:
    """Return whether a state has this air's attenuation."""
    attenuation = 0.0 if air is None else air.attenuation(s.frequencies)
    return bool(np.allclose(attenuation, s.air, rtol=1e-12, atol=0))


def _sigma(case: Case, before: RoomState, after: RoomState) -> Array:
    """Return sigma of the stated materials: that of what is seen of them, and of the effects' sizes."""
    if after.alpha is before.alpha:
        return case.room.sigma
    base = _base(case)
    variance = (case.room.sigma * seen(case, base)) ** 2
    for i, p in enumerate(case.applied):
        if p.size_interval is not None:
            low, high = (
                state(replace(case, applied=_sized(case, i, end)), base).alpha
                for end in p.size_interval
            )
            variance = variance + ((high - low) / (2 * NORMAL_90)) ** 2
    return np.minimum(np.sqrt(variance), 1.0)


def _sized(case: Case, i: int, size: float) -> list[AppliedEffect]:
    """Return the case's effects, the one at ``i`` with another size."""
    out = list(case.applied)
    out[i] = out[i].resized(size)
    return out


def _spread(p: AppliedEffect) -> float:
    """The relative standard deviation of an absorber's size."""
    return p.size_sigma / max(abs(p.size), 1e-9)


def _absorption(s: RoomState) -> Array:
    """The equation's mean over walls, coverings and objects, without the air."""
    exponent = (s.surface_absorption + s.objects) / s.total_area
    return mean_equation(s.equation).inverse(exponent)


_STEP = 1e-4
"""Step of alpha for a derivative."""


def seen(case: Case, configuration: Configuration) -> Array:
    """Return d (alpha of the state) / d (alpha of the room), (n_materials, n_bands).

    It is 1 but where an applied effect changes alpha: what is covered is not seen.
    """
    at = np.array(case.room.alpha)
    unchanged = replace(configuration, changes={})
    after = state(case, unchanged, at).alpha
    if np.array_equal(after, at):
        return np.ones_like(at)
    step = np.where(at < 0.5, _STEP, -_STEP)
    return np.asarray((state(case, unchanged, at + step).alpha - after) / step)
