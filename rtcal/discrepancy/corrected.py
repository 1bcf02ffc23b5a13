"""The corrected room as a `Room` and as a `Simulator`, for use in other packages.

Each absorber becomes a further material, which replaces every wall in proportion to its area. Its
area equals its largest absorption area over the bands, with its size at the upper end of the 90 %
interval. So a calibration can increase the absorber as well as decrease it. Volume, areas and air are
those of the finding. A `Room` cannot represent the decay's shape or noise; only the `Simulator` does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.discrepancy.case import NORMAL_90, AppliedEffect, Case
from rtcal.discrepancy.configuration import Configuration
from rtcal.discrepancy.model import FEATURES, State, predict
from rtcal.discrepancy.states import distances, state, with_applied
from rtcal.discrepancy.wording import amount
from rtcal.errors import DataError
from rtcal.simulators.base import RoomSimulator, Simulator, check_alpha, run
from rtcal.support.arguments import checked
from rtcal.support.types import Array

_LARGEST_SHARE = 0.5
"""Share of the wall area up to which an absorber is enlarged for its size's interval.

Half of every wall remains. T of the corrected room does not depend on the share w, since the
absorber's coefficient is wall + (both - wall) / w. The limit only bounds how far a calibration can
enlarge the absorber."""


@checked
def corrected_room(case: Case) -> Room:
    """Return the case's room with its effects, not calibrated.

    By the model's equation it has the T of the case's model, without the decay's shape and noise. (A
    calibration of Millington's model uses Eyring's equation.) Absorbers are materials after the stated
    ones. Their sigma follows from the interval of the effect's size. Their area is larger than the
    effect's, so that alpha = 1 is the upper end of the interval. If volume or areas differ from the
    stated ones, dimensions and surfaces are left out.
    """
    return _corrected(case)[0]


def not_in_room(case: Case) -> list[str]:
    """Return, in words, the effects that a room cannot represent: decay shape, noise, equation."""
    out = [f"{p.name}: a room has surfaces and air only" for p in _corrected(case)[1]]
    if (equation := _bare(case).equation) != case.equation:
        out.append(f"formula: a room names no equation; calibrate it with {equation}")
    return out


@checked
def simulator(case: Case, make: Callable[[Room], Simulator] | None = None) -> Simulator:
    """Return a simulator of the corrected room; the rows of alpha are `corrected_room`'s.

    Parameters
    ----------
    case : Case
        With the effects that `Finding.apply` has added.
    make : function, optional
        Builds a simulator for a room of the stated materials, with the air, volume and areas of the
        finding: ``lambda room: PathTracing(room=room, geometry=..., ...)``. Absorbers are spread over
        all its walls: alpha = (1 - w) alpha_wall + w alpha_absorber, w their share of the area. By
        default the simulator is the case's model: equation, decay and noise.

    Raises
    ------
    DataError
        If ``make``'s simulator cannot represent an effect: a coupled room, a noise floor, a custom
        effect on the decay.
    """
    if make is None:
        return CaseModel(case)
    if not callable(make):
        raise DataError(f"make = {make!r} is not a function of a room")
    for p in _corrected(case)[1]:
        if p.effect.not_in_simulator is not None:
            raise DataError(f"{p.name}: {p.effect.not_in_simulator}")
    return Spread(case, make(_stated(case)))


@dataclass(frozen=True, eq=False, repr=False)
class CaseModel(RoomSimulator):
    """A case's model as a `Simulator`: T20, EDT, T30, C80 and G of its first configuration."""

    case: Case
    room: Room = field(init=False)
    remaining: tuple[AppliedEffect, ...] = field(init=False)
    deterministic: bool = field(default=True, init=False)
    smooth: bool = field(default=True, init=False)

    def __post_init__(self) -> None:
        room, remaining = _corrected(self.case)
        object.__setattr__(self, "room", room)
        object.__setattr__(self, "remaining", remaining)

    @property
    def name(self) -> str:
        """Name of the model to which calibrated coefficients belong."""
        return f"the model of {self.case.room.name}{_added(self.case)}"

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return what the model predicts for alpha (n_materials, n_bands)."""
        alpha = check_alpha(self, alpha)
        first = _base(self.case)
        facing = self.case.facing
        around = self.case.room.areas @ facing / self.case.room.total_area
        further = np.tile(around, (len(alpha) - len(facing), 1))
        bare = replace(
            _bare(self.case),
            areas=self.room.areas,
            alpha=alpha,
            facing=np.concatenate([facing, further]),
        )
        predicted = predict(
            [with_applied(bare, self.remaining, first)], distances(self.case, first)
        )
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
class Spread(RoomSimulator):
    """A simulator of the stated materials, with a corrected room's absorbers spread over its walls."""

    case: Case
    inner: Simulator
    room: Room = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "room", corrected_room(self.case))
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


def _added(case: Case) -> str:
    return "".join(f" with {p.name}" for p in case.applied)


def _base(case: Case) -> Configuration:
    """The first configuration, with nothing changed or removed in it."""
    return replace(case.configurations[0], changes={}, suspect_removed=False, air=None)


def _air(case: Case) -> Air | None:
    air = case.room.air
    for p in case.applied:
        air = p.effect.air(air, p.parameters)
    return air


def _bare(case: Case) -> State:
    """The room's state with the volume, areas, air and equation of the finding, without absorbers."""
    whole = state(case, _base(case))
    return replace(whole, covering=0.0, objects=0.0, shape=None, floor_db=None, direct_db=0.0)


def _stated(case: Case) -> Room:
    """The stated materials with the volume, areas and air of the finding."""
    room, bare = case.room, _bare(case)
    corrected = room.replace(air=_air(case))
    if bare.volume != room.volume or not np.array_equal(bare.areas, room.areas):
        corrected = corrected.replace(
            volume=bare.volume, areas=bare.areas, dimensions=None, surfaces=()
        )
    return corrected


def _corrected(case: Case) -> tuple[Room, tuple[AppliedEffect, ...]]:
    """The corrected room, and the effects that a `Room` cannot represent."""
    stated, at, base = _stated(case), _bare(case), _base(case)
    equation = mean_equation(at.equation)
    areas, alpha, sigma = stated.areas, [*stated.alpha], [*stated.sigma]
    names, remaining, sources = list(stated.materials), list[AppliedEffect](), dict(stated.sources)
    for p in case.applied:
        after = with_applied(at, [p], base)
        if after.shape is not None or after.floor_db is not None or after.direct_db:
            remaining.append(p)
            continue
        after = replace(at, covering=after.covering, objects=after.objects)
        wall, both = _absorption(at), _absorption(after)
        if np.allclose(wall, both, rtol=0, atol=1e-12):
            continue  # the room already has the other volume, area, air or equation
        top = float(equation.contribution(np.array(min(1.0, equation.largest_alpha))))
        w = float(max(((both - wall) / (top - wall)).max(), ((wall - both) / wall).max()))
        w = max(w, min(w * (1 + NORMAL_90 * _spread(p)), _LARGEST_SHARE))
        absorber = np.clip(wall + (both - wall) / w, 0, top)
        areas = np.append((1 - w) * areas, w * stated.total_area)
        names.append(p.name if p.name not in names else f"{p.name} (found)")
        alpha.append(equation.coefficient(absorber))
        if p.size_interval is not None:
            sources[names[-1]] = _source(p)
        sigma.append(np.abs(alpha[-1] - stated.absorption_area / stated.total_area) * _spread(p))
        at = after
    new = len(names) - stated.n_materials
    if not new:
        return stated, tuple(remaining)
    walls = {name: getattr(stated, name) for name in ("alpha_min", "scattering")}
    further = {"alpha_min": 0.0, "scattering": 0.5}
    return stated.replace(
        materials=names,
        areas=areas,
        alpha=alpha,
        sigma=sigma,
        surfaces=(),
        dimensions=None,
        sources=sources,
        **{
            name: np.vstack([rows, np.full((new, stated.n_bands), further[name])])
            for name, rows in walls.items()
            if rows is not None
        },
    ), tuple(remaining)


def _source(p: AppliedEffect) -> str:
    low, high = p.size_interval or (np.nan, np.nan)
    size = amount(p.parameters[p.effect.size], p.effect.unit)
    return f"rtcal gap: {size}, 90 % {low:.3g} to {high:.3g}; the area leaves room for more"


def _spread(p: AppliedEffect) -> float:
    """The relative standard deviation of an absorber's size."""
    return p.size_sigma / max(abs(p.parameters[p.effect.size]), 1e-9)


def _absorption(s: State) -> Array:
    """The equation's mean over walls, coverings and objects, without the air."""
    exponent = (s.surface_absorption + s.objects) / s.total_area
    return mean_equation(s.equation).inverse(exponent)
