"""Reverberation equations: they predict T from volume, areas, absorption and air.

A new equation is one class. It registers itself in `EQUATIONS`, where commands, cases, saved loops and
the discrepancy model look it up.

There are three kinds, each a special case of the one before:

- `Equation` predicts the T of a `Room`.
- `MeanEquation` has one absorption exponent per room, a function of a mean over the walls.
- `LinearEquation` takes the mean of alpha itself, so a measured T is one linear equality in alpha,
  which `rtcal.calibrate` solves.

Fitzroy's and Arau-Puchades' equations treat the surfaces of each axis separately. They are not
functions of a mean over all walls and give no linear target. They are calibrated like a simulator, in
the closed loop.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.room import AXES, Room
from rtcal.support import checks
from rtcal.support.errors import DataError, InfeasibleError, ModelError, of_bands
from rtcal.support.types import Array

PAPER_SPEED_OF_SOUND = 24 * np.log(10) / 0.164
"""Speed of sound (336.97 m/s) that gives the paper's rounded constant 0.164 s/m. It serves only to
reproduce the paper's numbers."""


@runtime_checkable
class Equation(Protocol):
    """Anything that predicts the reverberation time of a room."""

    name: ClassVar[str]

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,)."""
        ...


@dataclass(frozen=True)
class ReverberationEquation(ABC):
    """Base of rtcal's equations, with the constant 24 ln 10 / c and the air's 4mV."""

    speed_of_sound: float | None = None
    """c in m/s; from the room's air if it is not given."""

    name: ClassVar[str] = ""
    key: ClassVar[str] = ""
    """Name of the equation in commands, cases and saved loops."""

    def __post_init__(self) -> None:
        c = self.speed_of_sound
        if c is not None and not 0 < checks.number("speed_of_sound", c) < np.inf:
            raise DataError(f"speed_of_sound = {c:g} m/s must be finite and above 0")

    @abstractmethod
    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,)."""

    def absorption_area(self, room: Room, t: Array) -> Array:
        """Raise ModelError: T does not determine the absorption area in this equation."""
        raise ModelError(
            f"{self.name}'s equation is not a function of the mean absorption coefficient, so T does "
            "not determine the absorption area; calibrate it in the closed loop with "
            "calibrate_simulator"
        )

    def room_constant(self, room: Room) -> float:
        """Return 24 ln 10 / c in s/m."""
        checks.instance("room", room, Room)
        return float(24 * np.log(10) / (self.speed_of_sound or room.speed_of_sound))

    def _time(self, room: Room, absorbed: Array) -> Array:
        """T in s where the surfaces absorb S a = ``absorbed`` m², (..., n_bands); the air is added."""
        total = absorbed + 4 * room.air_attenuation * room.volume
        with np.errstate(divide="ignore"):
            return np.asarray(self.room_constant(room) * room.volume / total)


EQUATIONS: dict[str, type[ReverberationEquation]] = {}
"""Every equation by its key."""

E = TypeVar("E", bound=ReverberationEquation)


def register(equation: type[E]) -> type[E]:
    """Name an equation in `EQUATIONS`; a class decorator."""
    EQUATIONS[equation.key] = equation
    return equation


def equation_keys(kind: type[Any] = ReverberationEquation) -> tuple[str, ...]:
    """Return the keys of the equations that are of one class, in alphabetical order.

    Examples
    --------
    >>> from rtcal.acoustics.equations import LinearEquation
    >>> equation_keys(LinearEquation)
    ('eyring', 'kuttruff', 'sabine')
    """
    return tuple(sorted(key for key, e in EQUATIONS.items() if issubclass(e, kind)))


@dataclass(frozen=True)
class MeanEquation(ReverberationEquation):
    """An equation whose exponent is a function E of the mean of h(alpha) over the walls.

    E and h are the identity unless an equation defines them. All methods take arrays of any shape,
    element by element.
    """

    largest_alpha: ClassVar[float] = np.inf
    """The coefficient of one wall up to which h is finite in a room model."""
    wrong_when_diffuse: ClassVar[bool] = False
    """Whether theory says another T of a diffuse field."""

    @property
    def largest_mean(self) -> float:
        """The mean up to which the exponent rises and can be inverted."""
        return np.inf

    def contribution(self, alpha: Array) -> Array:
        """Return h(alpha), the contribution of a wall to the mean."""
        return np.asarray(alpha)

    def coefficient(self, contribution: Array) -> Array:
        """Return the alpha of a wall that makes this contribution (the inverse of `contribution`)."""
        return np.asarray(contribution)

    def contribution_slope(self, alpha: Array) -> Array:
        """Return dh / d alpha."""
        return np.ones_like(alpha)

    def exponent(self, mean: Array) -> Array:
        """Return the absorption exponent a = E(mean)."""
        return np.asarray(mean)

    def inverse(self, exponent: Array) -> Array:
        """Return the mean that has this exponent, NaN where none has: the inverse of `exponent`."""
        return np.asarray(exponent)

    def slope(self, mean: Array) -> Array:
        """Return d exponent / d mean."""
        return np.ones_like(mean)

    def linear(self) -> LinearEquation:
        """Return the linear equation that a calibration inverts for this one: itself, or Eyring's.

        Eyring's has the same T if all coefficients are equal.
        """
        return self if isinstance(self, LinearEquation) else Eyring(self.speed_of_sound)

    def diffuse_field(self) -> MeanEquation:
        """Return the equation that the T of simulators follows in a diffuse field: itself, or Eyring's.

        The difference between a simulator and it then shows the error of the room's model alone.
        """
        return Eyring(self.speed_of_sound) if self.wrong_when_diffuse else self

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,); infinite where nothing absorbs (Eqs. 1 to 3)."""
        checks.instance("room", room, Room)
        walls = room.is_surface
        mean = room.areas[walls] @ self.contribution(room.alpha[walls]) + room.area_of_pieces
        mean = mean / room.total_area
        return self._time(room, room.total_area * self.exponent(mean))


@dataclass(frozen=True)
class LinearEquation(MeanEquation):
    """An equation in which T depends on alpha only through S'alpha: h(alpha) = alpha."""

    @property
    def largest_mean(self) -> float:
        """The mean coefficient up to which T falls; the inverse covers only this branch."""
        return 1.0

    def time(self, room: Room, absorption_area: Array) -> Array:
        """Return T in s for the surfaces' absorption area S'alpha in m², both (..., n_bands)."""
        checks.instance("room", room, Room)
        exponent = self.exponent(absorption_area / room.total_area)
        return self._time(room, room.total_area * exponent)

    def target(self, room: Room, t: Array) -> Array:
        """Return b in m², (..., n_bands), for T in s, without a check that the bounds can reach it.

        b is below 0 where T is longer than the air alone allows, and NaN where T is NaN or where
        no mean absorption coefficient has the exponent that T asks for.
        """
        return np.asarray(room.total_area * self.inverse(self.exponent_of_time(room, t)))

    def exponent_of_time(self, room: Room, t: Array) -> Array:
        """Return the absorption exponent (k V / T - 4 m V) / S that T in s asks for, (..., n_bands)."""
        with np.errstate(over="ignore"):
            total = self.room_constant(room) * room.volume / np.asarray(t, dtype=float)
        return np.asarray((total - 4 * room.air_attenuation * room.volume) / room.total_area)

    def target_sensitivity(self, room: Room, t: Array) -> Array:
        """Return db/dT in m²/s, (n_bands,): negative, since a longer T needs less absorption."""
        t = np.asarray(t, dtype=float)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            total_slope = -self.room_constant(room) * room.volume / t**2
            return np.asarray(total_slope / self.slope(self.target(room, t) / room.total_area))

    def air_share(self, room: Room, absorption_area: Array) -> Array:
        """Return the air's share 4mV / (S a + 4mV) of the whole absorption, (n_bands,)."""
        air = 4 * room.air_attenuation * room.volume
        total = room.total_area * self.exponent(absorption_area / room.total_area) + air
        return np.asarray(np.divide(air, total, out=np.zeros_like(air), where=total > 0))

    def absorption_area(self, room: Room, t: Array) -> Array:
        """Return the absorption area b that the surfaces need for T (Eqs. 5 and 6).

        Parameters
        ----------
        room : Room
        t : array (n_bands,)
            Measured T in s; NaN where missing.

        Returns
        -------
        array (n_bands,)
            b in m², from 0 to the total area; NaN where T is.

        Raises
        ------
        DataError
            If T has another shape, is infinite, or is not above 0.
        InfeasibleError
            If no coefficients from 0 to 1 give T; the message says which T would do.
        """
        checks.instance("room", room, Room)
        t = checks.array("T", t)
        if t.shape != (room.n_bands,):
            raise DataError(
                f"T has shape {t.shape}; it must be ({room.n_bands},), one value per band of the "
                "room"
            )
        for frequency, value in zip(room.centre_frequencies, t, strict=True):
            if np.isinf(value) or value <= 0:
                raise DataError(
                    f"T[{bands.label(frequency)}] = {value:g} s must be finite and above 0"
                )
        b = self.target(room, t)
        longest = self.time(room, np.zeros(room.n_bands))
        top = self.largest_mean * room.total_area
        shortest = self.time(room, np.full(room.n_bands, top))
        for i in range(room.n_bands):
            if np.isnan(t[i]) or 0 <= b[i] <= top * (1 + 1e-15):
                continue
            why = "longer than the air alone allows" if t[i] > longest[i] else "too short"
            raise InfeasibleError(
                f"T[{bands.label(room.centre_frequencies[i])}] = {t[i]:.4g} s is {why} in "
                f"{self.name}'s equation, which can give T from {shortest[i]:.4g} to "
                f"{longest[i]:.4g} s within the bounds"
            )
        return b


def mean_equation(key: str, place: str = "equation") -> MeanEquation:
    """Return the equation with this key, which must have one exponent per room.

    Raises DataError, which names ``place``, for any other key.

    Examples
    --------
    >>> mean_equation("millington").name
    'Millington'
    """
    equation = EQUATIONS.get(key) if isinstance(key, str) else None
    if equation is None or not issubclass(equation, MeanEquation):
        raise DataError(
            f"{place} = {key!r} must be one of {', '.join(equation_keys(MeanEquation))}"
        )
    return equation()


# At an exponent of about 36, 1 - exp(-a) rounds to 1 and the mean coefficient does not determine T.
# At 25 it determines T to 1e-6. No real room has such an exponent.
_LARGEST_EXPONENT = 25.0


@register
@dataclass(frozen=True)
class Eyring(LinearEquation):
    """Eyring's equation: a = -ln(1 - mean alpha) (Eyring 1930; Bellows & Katz 2025, Eqs. 3, 6).

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> print(Eyring(speed_of_sound=343).reverberation_time(room).round(4))
    [0.5484]
    """

    name: ClassVar[str] = "Eyring"
    key: ClassVar[str] = "eyring"

    @property
    def largest_mean(self) -> float:
        """1 - exp(-25): above it, the mean coefficient determines T only to rounding."""
        return float(-np.expm1(-_LARGEST_EXPONENT))

    def exponent(self, mean: Array) -> Array:
        """Return -ln(1 - mean alpha), infinite at 1."""
        with np.errstate(divide="ignore"):
            return np.asarray(-np.log1p(-np.minimum(mean, 1.0)))

    def inverse(self, exponent: Array) -> Array:
        """Return 1 - exp(-exponent); NaN above 25, where it would lose T to rounding."""
        with np.errstate(over="ignore"):
            mean = -np.expm1(-np.asarray(exponent, dtype=float))
        return np.asarray(np.where(np.asarray(exponent) > _LARGEST_EXPONENT, np.nan, mean))

    def slope(self, mean: Array) -> Array:
        """Return 1 / (1 - mean alpha)."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (1 - np.minimum(mean, 1.0)))


@register
@dataclass(frozen=True)
class Sabine(LinearEquation):
    """Sabine's equation: a = mean alpha (Sabine 1922; Bellows & Katz 2025, Eqs. 2 and 5).

    E and h of a `MeanEquation` are both the identity.

    Examples
    --------
    >>> from rtcal.acoustics.equations import PAPER_SPEED_OF_SOUND
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=60, materials=["floor", "rest"], areas=[20, 74],
    ...             alpha=[[0.2], [0.4]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])
    >>> print(Sabine(speed_of_sound=PAPER_SPEED_OF_SOUND).reverberation_time(room).round(2))
    [0.29]
    """

    name: ClassVar[str] = "Sabine"
    key: ClassVar[str] = "sabine"
    wrong_when_diffuse: ClassVar[bool] = True  # T stays above 0 where every wall absorbs everything


@register
@dataclass(frozen=True)
class Millington(MeanEquation):
    """Millington and Sette: the surfaces' exponents are averaged, S a = -sum S_i ln(1 - alpha_i).

    One surface with alpha = 1 makes T zero. T equals Eyring's if and only if all coefficients are
    equal. T does not determine the absorption area, the sum of S_i alpha_i, so that a calibration needs
    the closed loop (`rtcal.calibrate_simulator`).

    References
    ----------
    G. Millington, J. Acoust. Soc. Am. 4, 69-82 (1932); W. J. Sette, ibid. 193-210 (1932).

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=100, materials=["a", "b"], areas=[60, 40],
    ...             alpha=[[0.3], [0.6]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])
    >>> print(Millington(speed_of_sound=343).reverberation_time(room).round(4))
    [0.2775]
    """

    name: ClassVar[str] = "Millington"
    key: ClassVar[str] = "millington"
    # An opening has alpha = 1 and would make T zero; 0.999 counts it as 6.9 times its area.
    largest_alpha: ClassVar[float] = 0.999
    wrong_when_diffuse: ClassVar[bool] = True  # a small open window makes T zero

    def contribution(self, alpha: Array) -> Array:
        """Return the wall's exponent -ln(1 - alpha), infinite at 1."""
        with np.errstate(divide="ignore"):
            return np.asarray(-np.log1p(-np.asarray(alpha, dtype=float)))

    def coefficient(self, contribution: Array) -> Array:
        """Return 1 - exp(-contribution)."""
        return np.asarray(-np.expm1(-np.asarray(contribution, dtype=float)))

    def contribution_slope(self, alpha: Array) -> Array:
        """Return 1 / (1 - alpha)."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (1 - np.asarray(alpha, dtype=float)))


@register
@dataclass(frozen=True)
class Kuttruff(LinearEquation):
    """Kuttruff's equation: a = a' (1 - gamma² a' / 2), a' = -ln(1 - mean alpha).

    gamma² is the relative variance of the free paths. The exponent peaks at a' = 1 / gamma², for
    gamma² = 0.4 at a mean coefficient of 0.918. The equation does not hold beyond the peak. A T
    shorter than at the peak is refused.

    Parameters
    ----------
    speed_of_sound : float, optional
        c in m/s; from the room's air if it is not given.
    path_variance : float
        gamma², above 0 and at most 1; 0.4 suits rooms of usual proportions.

    References
    ----------
    H. Kuttruff, Room Acoustics, 5th ed. (2009), Eqs. 5.23 to 5.25.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> print(Kuttruff(speed_of_sound=343).reverberation_time(room).round(4))
    [0.574]
    """

    path_variance: float = 0.4

    name: ClassVar[str] = "Kuttruff"
    key: ClassVar[str] = "kuttruff"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < checks.number("path_variance", self.path_variance) <= 1:
            raise DataError(f"path_variance = {self.path_variance:g} must be above 0 and at most 1")

    @property
    def largest_mean(self) -> float:
        """Largest mean alpha of the equation, 1 - exp(-1 / gamma²), where T is shortest."""
        return float(-np.expm1(-1 / self.path_variance))

    def exponent(self, mean: Array) -> Array:
        """Return a' (1 - gamma² a' / 2); ModelError beyond the peak, where it does not hold."""
        beyond = np.atleast_1d(mean) > self.largest_mean * (1 + 1e-12)
        if beyond.any():
            error = ModelError(
                f"a mean absorption coefficient of {np.max(mean):.3f} is beyond "
                f"{self.largest_mean:.3f}, up to which Kuttruff's equation holds"
            )
            raise of_bands(error, np.flatnonzero(beyond.reshape(-1, beyond.shape[-1]).any(axis=0)))
        eyring = -np.log1p(-np.asarray(mean, dtype=float))
        return np.asarray(eyring * (1 - self.path_variance * eyring / 2))

    def inverse(self, exponent: Array) -> Array:
        """Return the mean coefficient below the peak; NaN for an exponent above the peak's."""
        # The quotient keeps the digits of small exponents. Up to 1e-14 is rounding at the peak.
        inside = 1 - 2 * self.path_variance * np.asarray(exponent, dtype=float)
        inside = np.where(inside < 0, np.where(inside > -1e-14, 0.0, np.nan), inside)
        eyring = 2 * np.asarray(exponent, dtype=float) / (1 + np.sqrt(inside))
        return np.asarray(-np.expm1(-eyring))

    def slope(self, mean: Array) -> Array:
        """Return (1 - gamma² a') / (1 - mean alpha), 0 at the peak."""
        eyring = -np.log1p(-np.asarray(mean, dtype=float))
        return np.asarray((1 - self.path_variance * eyring) / (1 - np.asarray(mean)))


@dataclass(frozen=True)
class _AxisEquation(ReverberationEquation):
    """An equation that combines three times, one per axis."""

    @abstractmethod
    def combined(self, shares: Array, times: Array) -> Array:
        """Return T in s of the axes' shares of the area (n_axes, 1) and times (n_axes, n_bands)."""

    def reverberation_time(self, room: Room) -> Array:
        """Return T in s, (n_bands,); ModelError where a surface has no axis."""
        if not checks.instance("room", room, Room).surfaces:
            raise ModelError(
                f"{self.name}'s equation needs the axis (x, y or z) of every surface; room "
                f'"{room.name}" has no surfaces'
            )
        along = np.zeros((room.n_materials, 3))
        for surface in room.surfaces:
            if surface.axis is None:
                raise ModelError(
                    f"{self.name}'s equation needs the axis (x, y or z) of every surface; "
                    f'"{surface.name}" has none'
                )
            along[room.material_index(surface.material), AXES.index(surface.axis)] += surface.area
        if (empty := along.sum(axis=0) == 0).any():
            missing = AXES[int(np.argmax(empty))]
            raise ModelError(
                f'{self.name}\'s equation needs a surface with axis = "{missing}", and the room '
                "has none"
            )
        return self.by_axes(room, along)

    def by_axes(self, room: Room, along: Array) -> Array:
        """Return T in s, (n_bands,), of materials' areas along each axis in m², (n_materials, 3)."""
        areas = along.sum(axis=0)
        along, areas = along[:, areas > 0], areas[areas > 0, np.newaxis]
        mean = along.T @ room.alpha / areas + room.area_of_pieces / room.total_area
        times = self._time(room, room.total_area * Eyring().exponent(mean))
        return self.combined(areas / areas.sum(), times)


@register
@dataclass(frozen=True)
class Fitzroy(_AxisEquation):
    """Fitzroy: the arithmetic mean of the axes' Eyring times, weighted by their areas.

    T = sum (S_x / S) T_x,  T_x = (24 ln 10 / c) V / (-S ln(1 - alpha_x) + 4 m V).

    References
    ----------
    D. Fitzroy, J. Acoust. Soc. Am. 31, 893-897 (1959).
    """

    name: ClassVar[str] = "Fitzroy"
    key: ClassVar[str] = "fitzroy"

    def combined(self, shares: Array, times: Array) -> Array:
        """Return the arithmetic mean."""
        return np.asarray(np.sum(shares * times, axis=0))


@register
@dataclass(frozen=True)
class ArauPuchades(_AxisEquation):
    """Arau-Puchades: the geometric mean of the axes' Eyring times, weighted by their areas.

    T = product T_x^(S_x / S),  T_x as in `Fitzroy`.

    References
    ----------
    H. Arau-Puchades, Acustica 65, 163-180 (1988).
    """

    name: ClassVar[str] = "Arau-Puchades"
    key: ClassVar[str] = "arau"

    def combined(self, shares: Array, times: Array) -> Array:
        """Return the geometric mean."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.exp(np.sum(shares * np.log(times), axis=0)))
