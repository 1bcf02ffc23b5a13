"""The library of effects, and the rules that each must obey; a message names effect and rule."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from math import isfinite
from typing import Any, TypeVar

import numpy as np

from rtcal.acoustics.directions import NOT_KNOWN
from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import Room
from rtcal.finder.effects.absorbers import (
    Audience,
    Curtain,
    Furniture,
    Membrane,
    Opening,
    People,
    Porous,
    Resonator,
)
from rtcal.finder.effects.base import Effect, Limits, Parameters
from rtcal.finder.effects.whole_room import (
    CoupledRoom,
    CoveredSurface,
    DirectSound,
    NoiseFloor,
    NonDiffuse,
    OmittedAir,
    WrongArea,
    WrongFormula,
    WrongVolume,
)
from rtcal.finder.model import Decay, RoomState
from rtcal.support import checks
from rtcal.support.errors import DataError, RtcalError
from rtcal.support.text import shortened
from rtcal.support.types import Array

T = TypeVar("T")
_TEXTS = ("name", "size", "unit")
_RESERVED = ("none", "unknown")
SURFACES = ("floor", "wall", "ceiling")
_ARRAYS = {
    "areas": (0.0, np.inf),
    "alpha": (0.0, 1.0),
    "air": (0.0, np.inf),
    "covering": (-np.inf, np.inf),
    "objects": (-np.inf, np.inf),
}
_NUMBERS = {
    "volume": (1e-6, np.inf),
    "speed_of_sound": (1e-6, np.inf),
    "record": (1e-6, np.inf),
    "direct_db": (-np.inf, np.inf),
}


def library() -> tuple[Effect, ...]:
    """Return every effect that rtcal has."""
    return (
        OmittedAir(),
        Opening(),
        Audience(),
        People(),
        Furniture(),
        Porous(),
        Curtain(),
        Resonator(),
        Membrane(),
        CoveredSurface(),
        WrongArea(),
        WrongVolume(),
        WrongFormula(),
        CoupledRoom(),
        NonDiffuse(),
        NoiseFloor(),
        DirectSound(),
    )


def checked_effects(effects: object | None) -> tuple[Effect, ...]:
    """Return the effects, the whole library for None.

    Raises DataError unless each is complete and has a name of its own.
    """
    if effects is None:
        return library()
    every: tuple[Any, ...] = checks.listed("effects", effects)
    if not every:
        raise DataError("effects is empty; there is at least one to try")
    for i, effect in enumerate(every):
        _check(f"effects[{i}]", effect)
    names = [effect.name for effect in every]
    if twice := next((n for n in names if names.count(n) > 1), None):
        raise DataError(f'effects has "{twice}" twice; each has a name of its own')
    return every


def _check(place: str, effect: Any) -> None:
    if isinstance(effect, type):
        raise DataError(
            f"{place} = {effect.__name__} is a class; an effect is made: {effect.__name__}()"
        )
    if not isinstance(effect, Effect):
        raise DataError(f"{place} = {effect!r} is no effect: not a rtcal.finder.Effect")
    for name in _TEXTS:
        if (text := getattr(effect, name, None)) is None:
            raise DataError(f"{place} = {effect!r}: {name} is not stated; it is a text of one line")
        blank = name != "unit" and not str(text).strip()
        if not isinstance(text, str) or blank or not text.isprintable():
            raise DataError(f"{place} = {effect!r}: {name} = {text!r} is not a text of one line")
    if effect.name in _RESERVED:
        raise DataError(f'{place}: name = "{effect.name}" is a verdict\'s; an effect has another')
    where = f'effect "{effect.name}"'
    checks.number(f"{where}: neutral", getattr(effect, "neutral", None))
    error = checks.number(f"{where}: size_error", getattr(effect, "size_error", None))
    if not 0 <= error < np.inf:
        raise DataError(f"{where}: size_error = {error:g} is not finite and 0 or more")
    checks.flag(f"{where}: removable", getattr(effect, "removable", None))
    checks.listed(f"{where}: discrete", getattr(effect, "discrete", None))
    for kind in checks.listed(f"{where}: stands_on", getattr(effect, "stands_on", None)):
        if kind not in SURFACES:
            raise DataError(
                f"{where}: stands_on has {kind!r}, which is not one of {', '.join(SURFACES)}"
            )
    for share in checks.listed(f"{where}: shares", getattr(effect, "shares", None)):
        if not 0 < checks.number(f"{where}: shares", share) <= 1:
            raise DataError(f"{where}: shares has {share:g}, which is not above 0 and at most 1")


def judged_effects(
    effects: Sequence[Effect], directions_known: bool
) -> tuple[tuple[Effect, ...], dict[str, str]]:
    """Return the effects that can be judged, and by name why others cannot.

    Raises DataError where none is left.
    """
    lacking = {e.name: NOT_KNOWN for e in effects if e.needs_directions and not directions_known}
    tried = tuple(e for e in effects if e.name not in lacking)
    if not tried:
        raise DataError(f"{', '.join(lacking)} cannot be judged: {NOT_KNOWN}")
    return tried, lacking


def checked_grid(
    effect: Effect, state: RoomState, room: Room | None = None
) -> Sequence[Parameters]:
    """Return the effect's grid: at least one set of the same finite numbers, its size among them.

    Sets outside the limits of the room (`Effect.limits`) are left out, if others are within.
    """
    where = f'effect "{effect.name}": grid'
    grid = checks.listed(where, _run(where, lambda: effect.grid(state)))
    if not grid:
        raise DataError(f"{where} is empty; there is at least one set of parameters to try")
    names = set(checks.mapped(where, grid[0]))
    if effect.size not in names:
        raise DataError(f'{where} has no "{effect.size}", which is the effect\'s size')
    for theta in grid:
        if not isinstance(theta, Mapping) or set(theta) != names:
            raise DataError(f"{where} has {theta!r}; each of it has {', '.join(map(str, names))}")
        for name, value in theta.items():
            if not isinstance(value, float):
                value = checks.number(f"{where}: {name}", value)
            if not isfinite(value):
                raise DataError(f"{where}: {name} = {value:g} is not finite")
    limits = _limits(effect, room)
    possible = [
        theta
        for theta in grid
        if all(least <= theta.get(k, least) <= most for k, (least, most) in limits.items())
    ]
    return possible or grid


def beyond(
    effect: Effect, grid: Sequence[Parameters], likeliest: Parameters, room: Room
) -> list[Parameters]:
    """Return the grid, `_MORE` sizes longer where the ``likeliest`` parameters have its last size.

    It goes on in its own steps, away from the size that changes nothing, to the limits of the room.
    """
    every, value = list(grid), likeliest[effect.size]
    sizes = np.unique([theta[effect.size] for theta in grid])
    if not isfinite(effect.neutral) or effect.size in effect.discrete or len(sizes) < 2:
        return every
    limits = _limits(effect, room).get(effect.size, (-np.inf, np.inf))
    logs = sizes[0] > 0
    for end, inner in ((-1, -2), (0, 1)):
        away = (sizes[end] - effect.neutral) * (sizes[end] - sizes[inner]) > 0
        if value == sizes[end] and away and value not in limits:
            last, inside = (np.log(sizes[[end, inner]])) if logs else sizes[[end, inner]]
            more = last + (last - inside) * np.arange(1, _MORE + 1)
            more = np.unique(np.clip(np.exp(more) if logs else more, *limits))
            at_end = [theta for theta in grid if theta[effect.size] == value]
            every += [{**theta, effect.size: float(s)} for theta in at_end for s in more]
    return every


_MORE = 4
"""Sizes by which a grid goes on at once."""


def check_parameters(
    effect: Effect,
    parameters: Parameters,
    room: Room | None = None,
    interval: tuple[float, float] | None = None,
) -> None:
    """Refuse parameters that are missing or outside the effect's `Effect.limits`.

    ``room`` narrows the limits; without one, they are those that hold in any room. The size's
    ``interval`` lies within them, too.
    """
    where, limits = f'effect "{effect.name}"', _limits(effect, room)
    place = "" if room is None else f' in "{shortened(room.name)}"'
    for name, (least, most) in limits.items():
        if name not in parameters:
            raise DataError(f'{where} has no "{name}"; it has {", ".join(limits)}')
        stated = [(name, parameters[name])]
        if name == effect.size and interval is not None:
            stated += [("size_interval", end) for end in interval]
        for what, value in stated:
            if not (isfinite(value) and least <= value <= most):
                raise DataError(f"{where}: {what} = {value:g} is not {_rule(least, most)}{place}")
        if name in effect.discrete and parameters[name] != int(parameters[name]):
            raise DataError(f"{where}: {name} = {parameters[name]:g} is not a whole number")


def _limits(effect: Effect, room: Room | None) -> Limits:
    where = f'effect "{effect.name}": limits'
    return checks.mapped(where, _run(where, lambda: effect.limits(room)))


def changed_states(effect: Effect, state: RoomState, grid: Sequence[Parameters]) -> list[RoomState]:
    """Return the state with the effect in it, by parameters; DataError if a state is impossible."""
    where = f'effect "{effect.name}": change'
    made = added(effect, state, grid)
    for after in made:
        if not isinstance(after, RoomState):
            raise DataError(f"{where} returns {type(after).__name__}; it returns a RoomState")
    for name in _FIELDS:
        before, values = getattr(state, name), [getattr(after, name) for after in made]
        new = [i for i, value in enumerate(values) if value is not before]
        if not _plainly_right(name, [values[i] for i in new], state):
            for i in new:
                _check_field(f"{where} with {_said(grid[i])}: {name}", name, values[i], state)
    for after in made:
        if after.shape is not state.shape and not hasattr(after.shape, "together"):
            _check_shape(effect.name, after)
    return made


def added(effect: Effect, state: RoomState, grid: Sequence[Parameters]) -> list[RoomState]:
    """Return the state with the effect in it, by parameters, where `changed_states` passed it alone."""
    where = f'effect "{effect.name}": change'
    return _run(where, partial(effect.changes, state, grid), grid[0])


_FIELDS = tuple(f.name for f in fields(RoomState))


def _plainly_right(name: str, values: Sequence[Any], state: RoomState) -> bool:
    """Return whether all values of a field are plain and obey its rule: quicker than one by one."""
    if name in _NUMBERS:
        return all(type(v) is float for v in values) and _within(np.array(values), *_NUMBERS[name])
    if name not in _ARRAYS:
        return False
    shape = _shape(name, state)
    return all(
        type(v) is np.ndarray and v.dtype == float and v.shape == shape for v in values
    ) and _within(np.array(values), *_ARRAYS[name])


def _shape(name: str, state: RoomState) -> tuple[int, ...]:
    return np.shape(getattr(state, name) if name in ("areas", "alpha") else state.air)


def _within(array: Array, least: float, most: float) -> bool:
    return bool((np.isfinite(array) & (array >= least) & (array <= most)).all())


def _check_field(where: str, name: str, value: Any, state: RoomState) -> None:
    if name in _ARRAYS:
        array, shape = checks.array(where, value), _shape(name, state)
        if array.shape != shape and not (array.shape == () and name in ("covering", "objects")):
            raise DataError(f"{where} has shape {array.shape}; it is {shape}")
        if not _within(array, *_ARRAYS[name]):
            raise DataError(f"{where} is not {_rule(*_ARRAYS[name])} in every band")
    elif name in _NUMBERS or (name == "floor_db" and value is not None):
        least, most = _NUMBERS.get(name, (-np.inf, np.inf))
        number = checks.number(where, value)
        if not (np.isfinite(number) and least <= number <= most):
            raise DataError(f"{where} = {number:g} is not {_rule(least, most)}")
    elif name == "equation":
        mean_equation(value, where)
    elif name == "shape" and not (value is None or callable(value)):
        raise DataError(f"{where} = {value!r} does not turn a state into a Decay")


def _rule(least: float, most: float) -> str:
    if np.isinf(least):
        return "finite"
    return f"finite and {least:g} or more" if np.isinf(most) else f"from {least:g} to {most:g}"


def _check_shape(name: str, made: RoomState) -> None:
    where = f'effect "{name}": shape'
    shape = made.shape
    if shape is None:
        return
    decay = _run(where, lambda: shape(made))
    if not isinstance(decay, Decay):
        raise DataError(f"{where} returns {type(decay).__name__}; it returns a Decay")
    weights = checks.array(f"{where}: weights", decay.weights)
    rates = checks.array(f"{where}: rates", decay.rates)
    n_bands = len(made.frequencies)
    if weights.ndim != 2 or len(weights) != n_bands or rates.shape != weights.shape:
        raise DataError(
            f"{where}: weights and rates have shapes {weights.shape} and {rates.shape}; both are "
            f"(n_bands = {n_bands}, n_terms)"
        )
    if not (np.isfinite(weights).all() and np.isfinite(rates).all() and (rates > 0).all()):
        raise DataError(f"{where}: weights and rates are not finite, the rates above 0")


def _said(parameters: Parameters) -> str:
    return ", ".join(f"{k} {v:.3g}" for k, v in parameters.items())


def _run(where: str, call: Callable[[], T], parameters: Parameters | None = None) -> T:
    """Call a user's code; report whatever it raises in one line that names the effect."""
    try:
        return call()
    except RtcalError:
        raise
    except Exception as error:  # a user's code may raise anything
        what = " ".join(str(error).split())
        with_what = "" if parameters is None else f" with {', '.join(parameters) or 'no parameter'}"
        raise DataError(f"{where}{with_what} raises {type(error).__name__}: {what}") from error


@dataclass(frozen=True)
class AppliedEffect:
    """An effect that was added to the model.

    Parameters
    ----------
    name : str
        The effect's name.
    parameters : mapping of str to float
        Values of the effect's parameters.
    size_interval : (float, float), optional
        90 % interval of the effect's size.
    custom : Effect, optional
        An effect that is not in the library. A case that holds such an effect cannot be saved.

    Raises
    ------
    DataError
        If ``custom`` is not stated and the library has no effect of this name, or if a parameter is
        missing or outside the effect's `Effect.limits`.
    """

    name: str
    parameters: Mapping[str, float]
    size_interval: tuple[float, float] | None = None
    custom: Effect | None = None

    def __post_init__(self) -> None:
        checks.text("effect: name", self.name)
        for name, value in checks.mapped("effect: parameters", self.parameters).items():
            checks.number(f"effect: parameters[{name!r}]", value)
        if self.size_interval is not None:
            ends = checks.array("effect: size_interval", self.size_interval)
            if ends.shape != (2,) or not ends[0] <= ends[1]:
                raise DataError(
                    f"effect: size_interval = {self.size_interval!r} is not two numbers in order"
                )
        if self.custom is not None and not isinstance(self.custom, Effect):
            raise DataError(f"effect: custom = {self.custom!r} is no rtcal.finder.Effect")
        check_parameters(self.effect, self.parameters, interval=self.size_interval)

    @classmethod
    def of(
        cls,
        effect: Effect,
        parameters: Mapping[str, float],
        size_interval: tuple[float, float] | None = None,
    ) -> AppliedEffect:
        """Return an effect of the library, or another one, with these parameters."""
        if not isinstance(effect, Effect):
            raise DataError(f"effect = {checks.shown(effect)} is no rtcal.finder.Effect")
        custom = None if effect in library() else effect
        return cls(effect.name, parameters, size_interval, custom)

    @cached_property
    def effect(self) -> Effect:
        """The effect, from the library or ``custom``."""
        effect = self.custom or next((e for e in library() if e.name == self.name), None)
        if effect is None:
            raise DataError(f'effect "{self.name}" is not in the library')
        return effect

    @property
    def size(self) -> float:
        """The value of the parameter that says how much of the effect there is."""
        return float(self.parameters[self.effect.size])

    def resized(self, size: float) -> AppliedEffect:
        """Return the effect with another size."""
        return replace(self, parameters={**self.parameters, self.effect.size: size})

    @property
    def size_sigma(self) -> float:
        """Standard deviation of the size; 0 if the effect has none."""
        if self.size_interval is None:
            return 0.0
        return (self.size_interval[1] - self.size_interval[0]) / (2 * NORMAL_90)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, as `from_dict` reads them."""
        ends = None if self.size_interval is None else list(self.size_interval)
        return {"effect": self.name, "parameters": dict(self.parameters), "size_interval": ends}
