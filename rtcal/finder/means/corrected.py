"""The corrected room as a `Room` and as a `Simulator`, for use in other packages.

Volume and areas stay as stated, unless an effect is about that very number. Absorption that belongs to
no stated material becomes a further material, which stands free: means over positions do not tell which
wall it hides. Its area is such that alpha = 1 in its most absorbing band is the upper end of the size's
90 % interval, so that a calibration can increase the absorber as well as decrease it. A `Room` cannot
represent the decay's shape or noise (`not_in_room`); the `Simulator` does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.changes import new_name
from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import Material, Room, Surface
from rtcal.finder.case import Case, Configuration
from rtcal.finder.claim import amount
from rtcal.finder.effects import AppliedEffect
from rtcal.finder.means.problem import distances, state, with_applied
from rtcal.finder.model import FEATURES, RoomState, highest, mean_contributions, predict
from rtcal.simulators.base import RoomSimulator, Simulator, check_alpha, run
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.checks import shown
from rtcal.support.errors import DataError
from rtcal.support.text import listed
from rtcal.support.types import Array

_LARGEST_SHARE = 0.5
"""Share of the wall area up to which an absorber is enlarged for its size's interval. The limit only
bounds how far a calibration can enlarge the absorber."""
_MOST = 10.0
"""Area of an absorber over that of the walls beyond which no such absorber is made."""
_NO_ABSORPTION = 1e-12
"""Change of the absorption over the wall area under which an effect absorbs nothing."""
_OFF_GEOMETRY = 0.01
"""Share by which a geometry may differ from an area or a volume that the finding has changed."""
_HELD = ("volume", "areas", "alpha", "air", "speed_of_sound", "covering", "objects", "equation")
"""Parts of a state that a room, or the equation that is named beside it, represents."""


def corrected_room(case: Case) -> Room:
    """Return the case's room with its effects, not calibrated.

    By the model's equation it has the absorption area and T of the case's model, without what
    `not_in_room` lists. (A calibration of Millington's model uses Eyring's equation.) A change of a
    stated material, such as a cover, is in its row, and its source says so. Absorbers are materials
    after the stated ones, which stand free and have the walls' mean scattering. Their sigma, and that
    of a changed material, contains the interval of the effect's size. An absorber's area is larger than
    the effect's, so that alpha = 1 is the upper end of the interval.

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
    if changed := _resized(case.room, c.room):
        out.append(f"{listed([*lost, 'areas as stated'])}: {listed(changed)}")
    return out


def _resized(stated: Room, room: Room) -> list[str]:
    """Return in words whether the volume, and which areas, are other than stated."""
    out = []
    if room.volume != stated.volume:
        out = [f"the volume is {room.volume:.4g} m³ and was {stated.volume:.4g}"]
    for name, was, area in zip(stated.materials, stated.areas, room.areas, strict=False):
        if area != was:
            out.append(f'the area of "{name}" is {area:.4g} m² and was {was:.4g}')
    return out


def simulator(case: Case, make: Callable[[Room], Simulator] | None = None) -> Simulator:
    """Return a simulator of the corrected room; the rows of alpha are `corrected_room`'s.

    Parameters
    ----------
    case : Case
        With the effects that `Finding.apply` has added.
    make : function, optional
        Builds a simulator for a room of the stated materials, with the air, volume and areas of the
        finding: ``lambda room: PathTracing(room=room, geometry=..., ...)``. Absorbers are spread over
        all its walls, each of which absorbs the same share of what it reflected. By default the
        simulator is the case's model: equation, decay and noise.

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
        why = c.absent.get(p.name, "")
        why = next((cause for cause in (_DECAY, _NO_AIR, _TOO_MUCH) if cause in why), "")
        if why and p.effect.not_in_simulator is not None:
            raise DataError(f"{p.name}: {p.effect.not_in_simulator if why == _DECAY else why}")
    made = make(c.stated)
    if not isinstance(made, Simulator):
        raise DataError(f"make returned {shown(made)}, which is no rtcal.simulators.Simulator")
    return SpreadAbsorbers(case, made)


@dataclass(frozen=True, eq=False, repr=False)
class CaseModel(RoomSimulator):
    """A case's model as a `Simulator`: T20, EDT, T30, C80 and G of its first configuration."""

    case: Case
    room: Room = field(init=False)
    deterministic: bool = field(default=True, init=False)
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

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Simulate alpha (n_materials, n_bands)."""
        alpha = check_alpha(self, alpha)
        s = _corrected(self.case).state(alpha)
        linear = mean_equation(s.equation).linear()
        bare = replace(s, covering=0.0, objects=0.0)
        whole, walls = (
            linear.inverse((at.surface_absorption + at.objects) / at.total_area) for at in (s, bare)
        )
        whole = np.where(np.isfinite(whole), np.minimum(whole, 1.0), 1.0)
        more = (whole - walls) / (1 - walls)
        spread = np.where(more > 0, s.alpha + more * (1 - s.alpha), s.alpha * whole / walls)
        return run(self.inner, np.clip(spread, 0.0, 1.0), seed=seed)


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
_TOO_MUCH = "no area of a further material absorbs so much"
_HIDES = "it hides wall that absorbs more than it does, which the stated areas keep,"
_LARGER = ", so that a calibration can make it absorb more"
_TAKES = "it takes absorption away, and no stated surface is known that loses it"


@dataclass(frozen=True, eq=False)
class _Corrected:
    """A corrected room, and what links it to the case's state.

    ``stated`` has the stated materials alone. ``whole`` is the state with all effects. ``absorbers``
    are the area in m² of each further material, and whether the effect covers wall in the model.
    ``left`` (2, n_bands) is what the state's covering and objects have beside these materials.
    ``absent`` says why a room cannot represent an effect.
    """

    room: Room
    stated: Room
    whole: RoomState
    absorbers: tuple[tuple[float, bool], ...]
    left: Array
    absent: dict[str, str]

    def state(self, alpha: Array) -> RoomState:
        """Return the state with the room's coefficients (n_materials, n_bands).

        Coverings and objects stay what they are, so that a decay's shape is the same, too.
        """
        n = self.stated.n_materials
        bare = replace(self.whole, alpha=alpha[:n], covering=0.0, objects=0.0)
        covering, objects = _added_by(bare, self.absorbers, alpha[n:]) + self.left
        return replace(bare, covering=covering, objects=objects)


def _added_by(bare: RoomState, absorbers: Sequence[tuple[float, bool]], alpha: Array) -> Array:
    """Return a state's covering and objects, (2, n_bands), that absorb what absorbers standing free do.

    ``alpha`` are the absorbers' rows.
    """
    equation, walls = mean_equation(bare.equation), bare.total_area
    mean = mean_contributions(equation, [bare])[0]
    area, contribution = walls, walls * mean
    covered = before = walls * equation.exponent(mean)
    objects = np.zeros_like(mean)
    for (further, covers), row in zip(absorbers, alpha, strict=True):
        area = area + further
        h = equation.contribution(np.minimum(row, equation.largest_alpha))
        contribution = contribution + further * h
        after = area * equation.exponent(np.minimum(contribution / area, highest(equation)))
        if covers:
            covered = covered + after - before
        else:
            objects = objects + after - before
        before = after
    with_cover = equation.inverse(covered / walls)
    with_cover = np.where(with_cover <= highest(equation), with_cover, mean)
    # Where no mean over the walls absorbs as much, it stands free in the state, too.
    objects = objects + covered - walls * equation.exponent(with_cover)
    return np.array([walls * (with_cover - mean), objects])


def _corrected(case: Case) -> _Corrected:
    """Return the corrected room: a step per effect, then an absorber for each change of absorption."""
    base, room, air = _base(case), case.room, case.room.air
    first = before = state(replace(case, applied=()), base)
    absent, last_air = dict[str, str](), "air"
    gains: list[tuple[AppliedEffect, Array]] = []
    sources = dict(room.sources)
    for p in case.applied:
        after = with_applied(before, [p], base)
        for row in np.flatnonzero((after.alpha != before.alpha).any(axis=1)).tolist():
            name = room.materials[row]
            sources[name] = "; ".join(filter(None, [sources.get(name, ""), _changed_by(p)]))
        pairs = [(getattr(after, k), getattr(before, k)) for k in ("covering", "objects")]
        gain = np.array([one - other + np.zeros(room.n_bands) for one, other in pairs])
        if gain.any():
            gains.append((p, gain))
        if any(
            not np.array_equal(getattr(after, f.name), getattr(before, f.name))
            for f in fields(RoomState)
            if f.name not in _HELD
        ):
            absent[p.name] = _DECAY
        climate = p.effect.air(air, p.parameters)
        air = climate if _is_air(climate, after) else air
        if not np.array_equal(after.air, before.air):
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
    gains: Sequence[tuple[AppliedEffect, Array]],
    absent: dict[str, str],
) -> _Corrected:
    """Return the room with a material for each effect that adds absorption.

    ``gains`` (2, n_bands) are what each effect changes of the state's covering and objects.
    """
    equation, walls = mean_equation(whole.equation), whole.total_area
    at = bare = replace(whole, covering=0.0, objects=0.0)
    scattering = None
    if stated.scattering is not None:
        scattering = (stated.areas @ stated.scattering / stated.total_area).tolist()
    names, further, absorbers = list(stated.materials), list[Material](), list[tuple[float, bool]]()
    area, contribution = walls, walls * mean_contributions(equation, [bare])[0]
    absorbed = bare.surface_absorption
    for p, (covering, objects) in gains:
        before, at = at, replace(at, covering=at.covering + covering, objects=at.objects + objects)
        gain = (
            at.surface_absorption + at.objects - before.surface_absorption - before.objects
        ) / walls
        if (gain <= _NO_ABSORPTION).all():
            if (gain < -_NO_ABSORPTION).any():
                absent[p.name] = "; ".join(filter(None, [_TAKES, absent.get(p.name)]))
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

        top = float(equation.contribution(np.array(min(1.0, equation.largest_alpha))))
        least = _smallest(standing, top, walls)
        if least is None:
            absent[p.name] = "; ".join(filter(None, [_TOO_MUCH, absent.get(p.name)]))
            continue
        larger = _smallest(standing, top / (1 + NORMAL_90 * _spread(p)), walls) or least
        size = max(least, min(larger, _LARGEST_SHARE * walls))
        h = standing(size)
        if (h < 0).any():
            places = listed(bands.labels(stated.centre_frequencies[h < 0]))
            hides = f"{_HIDES} at {places}"
            absent[p.name] = "; ".join(filter(None, [hides, absent.get(p.name)]))
        h = np.clip(h, 0, top)
        alpha = equation.coefficient(h)
        names.append(new_name(names, p.name))
        further.append(
            Material(
                names[-1],
                alpha.tolist(),
                np.minimum(alpha * _spread(p), 1.0).tolist(),
                0.0,
                scattering,
                f"rtcal find: {_size(p)}. It stands free with {size:.3g} m²{_LARGER}",
                size,
            )
        )
        absorbers.append((size, bool(covering.any())))
        area, contribution = area + size, contribution + size * h
        absorbed = area * equation.exponent(np.minimum(contribution / area, highest(equation)))
    room = stated
    if further:
        surfaces = stated.surfaces and (
            *stated.surfaces,
            *(Surface(name=f.name, material=f.name, area=float(f.area or 0)) for f in further),
        )
        room = stated.with_rows(
            [*map(stated.material, stated.materials), *further], surfaces=surfaces
        )
    made = tuple(absorbers)
    both = np.array([whole.covering + 0 * absorbed, whole.objects + 0 * absorbed])
    left = both - _added_by(bare, made, room.alpha[stated.n_materials :])
    return _Corrected(room, stated, whole, made, left, absent)


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
    if np.array_equal(after.alpha, before.alpha):
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
