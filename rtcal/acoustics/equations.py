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
"""Speed of sound in m/s that gives the rounded constant 0.164 s/m of Bellows & Katz (2025). It serves
only to reproduce their numbers."""


@runtime_checkable
class Equation(Protocol):
    """Reverberation equation: any object with a ``name`` and a method ``reverberation_time(room)``."""

    name: ClassVar[str]

    def reverberation_time(self, room: Room) -> Array:
        """Return the reverberation time T of a room in s, (n_bands,).

        ``room`` gives volume, areas, coefficients and air.
        """
        ...


@dataclass(frozen=True)
class ReverberationEquation(ABC):
    """Base class of rtcal's reverberation equations, T = k V / (S a + 4 m V) with k = 24 ln 10 / c.

    V is the volume, S the area and a the absorption exponent of the surfaces, m the attenuation
    coefficient of the air (ISO 9613-1), and c the speed of sound.
    """

    speed_of_sound: float | None = None
    """Speed of sound c in m/s; that of the room's air by default."""

    name: ClassVar[str] = ""
    key: ClassVar[str] = ""
    """Name of the equation in commands, cases and saved loops."""

    def __post_init__(self) -> None:
        c = self.speed_of_sound
        if c is not None and not 0 < checks.number("speed_of_sound", c) < np.inf:
            raise DataError(f"speed_of_sound = {c:g} m/s must be finite and above 0")

    @abstractmethod
    def reverberation_time(self, room: Room) -> Array:
        """Return the reverberation time T of a room in s, (n_bands,).

        ``room`` gives volume, areas, coefficients and air.
        """

    def absorption_area(self, room: Room, t: Array) -> Array:
        """Raise ModelError: T determines the absorption area in a `LinearEquation`, but not here."""
        raise ModelError(
            f"{self.name}'s equation is not a function of the mean absorption coefficient, so T does "
            "not determine the absorption area; calibrate it in the closed loop with "
            "calibrate_simulator"
        )

    def room_constant(self, room: Room) -> float:
        """Return the constant k = 24 ln 10 / c of T = k V / A in s/m, about 0.161."""
        checks.instance("room", room, Room)
        return float(24 * np.log(10) / (self.speed_of_sound or room.speed_of_sound))

    def _time(self, room: Room, absorbed: Array) -> Array:
        """T in s where the surfaces absorb S a = ``absorbed`` m², (..., n_bands); the air is added."""
        total = absorbed + 4 * room.air_attenuation * room.volume
        with np.errstate(divide="ignore"):
            return np.asarray(self.room_constant(room) * room.volume / total)


EQUATIONS: dict[str, type[ReverberationEquation]] = {}
"""Reverberation equations by their keys."""

E = TypeVar("E", bound=ReverberationEquation)


def register(equation: type[E]) -> type[E]:
    """Add an equation to `EQUATIONS` (a class decorator)."""
    EQUATIONS[equation.key] = equation
    return equation


def equation_keys(kind: type[Any] = ReverberationEquation) -> tuple[str, ...]:
    """Return the keys, such as "eyring", of all equations of the class ``kind``, in alphabetical order.

    Examples
    --------
    >>> from rtcal.acoustics.equations import LinearEquation
    >>> equation_keys(LinearEquation)
    ('eyring', 'kuttruff', 'sabine')
    """
    return tuple(sorted(key for key, e in EQUATIONS.items() if issubclass(e, kind)))


@dataclass(frozen=True)
class MeanEquation(ReverberationEquation):
    """Equation in which T depends on one mean over the walls, such as the mean absorption coefficient.

    The absorption exponent is a = E(mean), with the mean of h(alpha) over the walls, weighted by area.
    E is the method `exponent` and h the method `contribution`. In Sabine's equation both are the
    identity, in Eyring's E(mean) = -ln(1 - mean), in Millington's h(alpha) = -ln(1 - alpha). They take
    arrays of any shape, element by element.

    ``speed_of_sound`` c in m/s is by default the room's, by its air.
    """

    largest_alpha: ClassVar[float] = np.inf
    """Absorption coefficient of one wall up to which its contribution h is finite in a room model."""
    wrong_when_diffuse: ClassVar[bool] = False
    """Whether theory gives another T than the equation in a diffuse field."""

    @property
    def largest_mean(self) -> float:
        """Largest mean up to which the absorption exponent rises, so that T determines the mean."""
        return np.inf

    def contribution(self, alpha: Array) -> Array:
        """Return the contribution h(alpha) of a wall to the mean.

        ``alpha`` is the wall's absorption coefficient, of any shape.
        """
        return np.asarray(alpha)

    def coefficient(self, contribution: Array) -> Array:
        """Return the absorption coefficient of a wall from its contribution (inverse of h)."""
        return np.asarray(contribution)

    def contribution_slope(self, alpha: Array) -> Array:
        """Return the derivative of a wall's `contribution` by its absorption coefficient.

        ``alpha`` is this coefficient, of any shape.
        """
        return np.ones_like(alpha)

    def exponent(self, mean: Array) -> Array:
        """Return the absorption exponent a = E(mean).

        ``mean`` is the mean of h(alpha) over the walls, of any shape.
        """
        return np.asarray(mean)

    def inverse(self, exponent: Array) -> Array:
        """Return the mean that gives an absorption exponent (inverse of `exponent`), or else NaN.

        ``exponent`` is of any shape.
        """
        return np.asarray(exponent)

    def slope(self, mean: Array) -> Array:
        """Return the derivative of the absorption exponent by the mean.

        ``mean`` is the mean of h(alpha) over the walls, of any shape.
        """
        return np.ones_like(mean)

    def linear(self) -> LinearEquation:
        """Return the equation by which a calibration calculates the absorption area from T.

        This is the equation itself if its T depends on the absorption area alone. Otherwise it is
        Eyring's, which gives the same T if all coefficients are equal.
        """
        return self if isinstance(self, LinearEquation) else Eyring(self.speed_of_sound)

    def diffuse_field(self) -> MeanEquation:
        """Return the equation with which to compare a simulator that makes the sound field diffuse.

        This is Eyring's equation instead of Sabine's or Millington's, whose T is wrong in a diffuse
        field (`wrong_when_diffuse`). Any other equation is returned unchanged.
        """
        return Eyring(self.speed_of_sound) if self.wrong_when_diffuse else self

    def reverberation_time(self, room: Room) -> Array:
        """Return the reverberation time T of a room in s, (n_bands,), infinite without absorption.

        Source: Bellows & Katz (2025), Eqs. 1 to 3.

        ``room`` gives volume, areas, coefficients and air.
        """
        checks.instance("room", room, Room)
        walls = room.is_surface
        mean = room.areas[walls] @ self.contribution(room.alpha[walls]) + room.area_of_pieces
        mean = mean / room.total_area
        return self._time(room, room.total_area * self.exponent(mean))


@dataclass(frozen=True)
class LinearEquation(MeanEquation):
    """Equation in which T depends on the absorption coefficients only through the absorption area.

    The absorption area S'alpha is the sum of area times coefficient in m². A calibration needs such an
    equation, because the measured T then gives the absorption area.

    ``speed_of_sound`` in m/s is by default the room's, by its air.
    """

    @property
    def largest_mean(self) -> float:
        """Mean absorption coefficient up to which T falls; T is inverted only up to there."""
        return 1.0

    def time(self, room: Room, absorption_area: Array) -> Array:
        """Return the reverberation time T in s, (..., n_bands), for an absorption area of the surfaces.

        ``absorption_area`` (..., n_bands) is in m².

        ``room`` gives volume, total area and air.
        """
        checks.instance("room", room, Room)
        exponent = self.exponent(absorption_area / room.total_area)
        return self._time(room, room.total_area * exponent)

    def target(self, room: Room, t: Array) -> Array:
        """Return the absorption area in m² that gives T, even if no coefficients reach it.

        The area is (..., n_bands). ``t`` (..., n_bands) is T in s. The area is below 0 if T is longer
        than the air alone allows, and NaN if T is NaN or no mean absorption coefficient gives T.

        ``room`` gives volume, total area and air.
        """
        return np.asarray(room.total_area * self.inverse(self.exponent_of_time(room, t)))

    def exponent_of_time(self, room: Room, t: Array) -> Array:
        """Return the absorption exponent (k V / T - 4 m V) / S for T = ``t`` in s, (..., n_bands).

        ``room`` gives the volume V in m³, the area S in m² and the attenuation m of the air in 1/m.
        """
        with np.errstate(over="ignore"):
            total = self.room_constant(room) * room.volume / np.asarray(t, dtype=float)
        return np.asarray((total - 4 * room.air_attenuation * room.volume) / room.total_area)

    def target_sensitivity(self, room: Room, t: Array) -> Array:
        """Return the derivative of the absorption area by T in m²/s, (n_bands,).

        The derivative is negative, because a longer T needs less absorption. ``t`` (n_bands,) is T in
        s.

        ``room`` gives volume, total area and air.
        """
        t = np.asarray(t, dtype=float)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            total_slope = -self.room_constant(room) * room.volume / t**2
            return np.asarray(total_slope / self.slope(self.target(room, t) / room.total_area))

    def air_share(self, room: Room, absorption_area: Array) -> Array:
        """Return the air's share of the whole absorption, 4mV / (S a + 4mV), (n_bands,).

        ``absorption_area`` is that of the surfaces in m², from which the exponent a follows.

        ``room`` gives volume, total area and air.
        """
        air = 4 * room.air_attenuation * room.volume
        total = room.total_area * self.exponent(absorption_area / room.total_area) + air
        return np.asarray(np.divide(air, total, out=np.zeros_like(air), where=total > 0))

    def absorption_area(self, room: Room, t: Array) -> Array:
        """Return the absorption area that the surfaces need for a measured reverberation time T.

        Source: Bellows & Katz (2025), Eqs. 5 and 6.

        Parameters
        ----------
        room : Room
            Room with its volume, areas and air.
        t : array (n_bands,)
            Measured T in s; NaN where missing.

        Returns
        -------
        array (n_bands,)
            Absorption area in m², from 0 to the total area; NaN where T is missing.

        Raises
        ------
        DataError
            If T has another shape, is infinite, or is not above 0.
        InfeasibleError
            If no coefficients from 0 to 1 give T; the message names the T that can be reached.
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
            why = "too long" if t[i] > longest[i] else "too short"
            raise InfeasibleError(
                f"T[{bands.label(room.centre_frequencies[i])}] = {t[i]:.4g} s is {why}: in "
                f"this room {self.name}'s equation gives T from {shortest[i]:.4g} s, with "
                f"the largest absorption, to {longest[i]:.4g} s, with that of the air "
                "alone"
            )
        return b


def mean_equation(key: str, place: str = "equation") -> MeanEquation:
    """Return the equation with this key, whose T depends on one mean over the walls.

    ``key`` is the name of the equation in files and options, such as "eyring". Raises DataError, which
    names the ``place`` of the key, for an unknown key and for equations that treat the axes separately,
    such as Fitzroy's.

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
    """Eyring's equation, with the absorption exponent a = -ln(1 - mean alpha).

    T = k V / (S a + 4 m V), with k = 24 ln 10 / c (Eyring 1930; Bellows & Katz 2025, Eqs. 3, 6).

    ``speed_of_sound`` c in m/s is by default the room's, by its air.

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
        """Largest mean coefficient, 1 - exp(-25), above which rounding errors of T are too large."""
        return float(-np.expm1(-_LARGEST_EXPONENT))

    def exponent(self, mean: Array) -> Array:
        """Return the absorption exponent -ln(1 - mean alpha), infinite for a mean of 1.

        ``mean`` is the mean absorption coefficient of the walls, of any shape.
        """
        with np.errstate(divide="ignore"):
            return np.asarray(-np.log1p(-np.minimum(mean, 1.0)))

    def inverse(self, exponent: Array) -> Array:
        """Return the mean coefficient 1 - exp(-exponent), or NaN for an exponent above 25.

        There the coefficient is so near to 1 that rounding errors of T are too large.
        """
        with np.errstate(over="ignore"):
            mean = -np.expm1(-np.asarray(exponent, dtype=float))
        return np.asarray(np.where(np.asarray(exponent) > _LARGEST_EXPONENT, np.nan, mean))

    def slope(self, mean: Array) -> Array:
        """Return the derivative 1 / (1 - mean alpha) of the absorption exponent by the mean.

        ``mean`` is the mean absorption coefficient of the walls, of any shape.
        """
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (1 - np.minimum(mean, 1.0)))


@register
@dataclass(frozen=True)
class Sabine(LinearEquation):
    """Sabine's equation, with the mean absorption coefficient as absorption exponent.

    T = k V / (S mean alpha + 4 m V), k = 24 ln 10 / c (Sabine 1922; Bellows & Katz 2025, Eqs. 2, 5).

    ``speed_of_sound`` c in m/s is by default the room's, by its air.

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
    """Millington and Sette's equation, which averages the surfaces' exponents -ln(1 - alpha_i) by area.

    The absorption exponent is a = -sum S_i ln(1 - alpha_i) / S. One surface with alpha = 1 makes T
    zero. T equals Eyring's if and only if all coefficients are equal. Rooms with the same T can differ
    in absorption area (the sum of S_i alpha_i), so that `rtcal.calibrate` cannot use this equation: use
    `rtcal.calibrate_simulator`, which repeats simulation and calibration in turn.

    ``speed_of_sound`` c in m/s is by default the room's, by its air.

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
        """Return a wall's absorption exponent -ln(1 - alpha), infinite for alpha = 1."""
        with np.errstate(divide="ignore"):
            return np.asarray(-np.log1p(-np.asarray(alpha, dtype=float)))

    def coefficient(self, contribution: Array) -> Array:
        """Return 1 - exp(-contribution), the absorption coefficient of a wall with this exponent."""
        return np.asarray(-np.expm1(-np.asarray(contribution, dtype=float)))

    def contribution_slope(self, alpha: Array) -> Array:
        """Return the derivative 1 / (1 - alpha) of a wall's exponent by its coefficient.

        ``alpha`` is this coefficient, of any shape.
        """
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (1 - np.asarray(alpha, dtype=float)))


@register
@dataclass(frozen=True)
class Kuttruff(LinearEquation):
    """Kuttruff's equation, which corrects Eyring's exponent for the variance of the free paths.

    The absorption exponent is a = a' (1 - gamma² a' / 2), with Eyring's a' = -ln(1 - mean alpha) and
    the relative variance gamma² of the free paths. It peaks at a' = 1 / gamma², for gamma² = 0.4 at a
    mean coefficient of 0.918. The equation does not hold beyond the peak: a T shorter than at the peak
    raises an error.

    Parameters
    ----------
    speed_of_sound : float, optional
        Speed of sound in m/s; that of the room's air by default.
    path_variance : float
        Relative variance gamma² of the free paths, above 0 and at most 1; 0.4 suits rooms of usual
        proportions.

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
        """Largest mean coefficient of the equation, 1 - exp(-1 / gamma²), at which T is shortest."""
        return float(-np.expm1(-1 / self.path_variance))

    def exponent(self, mean: Array) -> Array:
        """Return the absorption exponent a' (1 - gamma² a' / 2); ModelError beyond its peak.

        ``mean`` is the mean absorption coefficient of the walls, of any shape.
        """
        beyond = np.atleast_1d(mean) > self.largest_mean * (1 + 1e-12)
        if beyond.any():
            error = ModelError(
                "Kuttruff's equation holds for a mean absorption coefficient up to "
                f"{self.largest_mean:.3f}, but this room has {np.max(mean):.3f}; use "
                "another equation"
            )
            raise of_bands(error, np.flatnonzero(beyond.reshape(-1, beyond.shape[-1]).any(axis=0)))
        eyring = -np.log1p(-np.asarray(mean, dtype=float))
        return np.asarray(eyring * (1 - self.path_variance * eyring / 2))

    def inverse(self, exponent: Array) -> Array:
        """Return the mean coefficient that gives an absorption exponent; NaN above its peak.

        ``exponent`` is of any shape.
        """
        # The quotient keeps the digits of small exponents. Up to 1e-14 is rounding at the peak.
        inside = 1 - 2 * self.path_variance * np.asarray(exponent, dtype=float)
        inside = np.where(inside < 0, np.where(inside > -1e-14, 0.0, np.nan), inside)
        eyring = 2 * np.asarray(exponent, dtype=float) / (1 + np.sqrt(inside))
        return np.asarray(-np.expm1(-eyring))

    def slope(self, mean: Array) -> Array:
        """Return the derivative (1 - gamma² a') / (1 - mean alpha) of the absorption exponent.

        ``mean`` is the mean absorption coefficient of the walls, of any shape.
        """
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
    """Fitzroy's equation: T is the arithmetic mean of the axes' Eyring T, weighted by area.

    T = sum (S_x / S) T_x,  T_x = (24 ln 10 / c) V / (-S ln(1 - alpha_x) + 4 m V), where S_x is the area
    of the surfaces perpendicular to axis x, and alpha_x their mean absorption coefficient.

    ``speed_of_sound`` c in m/s is by default the room's, by its air.

    References
    ----------
    D. Fitzroy, J. Acoust. Soc. Am. 31, 893-897 (1959).
    """

    name: ClassVar[str] = "Fitzroy"
    key: ClassVar[str] = "fitzroy"

    def combined(self, shares: Array, times: Array) -> Array:
        """Return the arithmetic mean of the axes' T in s, weighted by their shares of the area.

        ``shares`` are (n_axes, 1), ``times`` (n_axes, n_bands), and the mean is (n_bands,).
        """
        return np.asarray(np.sum(shares * times, axis=0))


@register
@dataclass(frozen=True)
class ArauPuchades(_AxisEquation):
    """Arau-Puchades' equation: T is the geometric mean of the axes' Eyring T, weighted by area.

    T = product T_x^(S_x / S). S_x is the area of the surfaces perpendicular to axis x, and T_x is as in
    `Fitzroy`.

    ``speed_of_sound`` c in m/s is by default the room's, by its air.

    References
    ----------
    H. Arau-Puchades, Acustica 65, 163-180 (1988).
    """

    name: ClassVar[str] = "Arau-Puchades"
    key: ClassVar[str] = "arau"

    def combined(self, shares: Array, times: Array) -> Array:
        """Return the geometric mean of the axes' T in s, weighted by their shares of the area.

        ``shares`` are (n_axes, 1), ``times`` (n_axes, n_bands), and the mean is (n_bands,).
        """
        with np.errstate(divide="ignore"):
            return np.asarray(np.exp(np.sum(shares * np.log(times), axis=0)))
