"""Errors that a room states and a prediction assumes: of coefficients, volume, areas, climate.

Those of volume, areas and climate are absorption area that T asks for.

With the stated volume V and areas S the equation asks a measured T for b. The true room is a little
different, so that S'alpha of the true coefficients differs from b. To first order the difference is a
sum of changes, each with an independent standard normal size. `target_changes` returns them. All bands
share these sizes, which is why several bands tell them from errors of the coefficients.

Coefficients from one source have errors in common: a factor and a tilt over frequency. The stated
sigma of a coefficient is that of an error of its own. Errors that all coefficients of a room have
in common, or all bands of a material, come on top of it: the table is of another product, or the
mounting differs. `rtcal.calibrate`, `rtcal.finder` and `rtcal.finder.positions` take them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Assumed uncertainties of a prediction of T after a change of the room.

    All are numbers from 0 to 1. Their defaults are the usual values.

    Parameters
    ----------
    volume, areas : float
        Relative standard deviations of the volume, and of each material's area, where the room states
        none.
    common : float
        Standard deviation of the equation's error of ln T that is the same before and after the change.
        It includes the error of handbook coefficients that are all too high or too low, because T
        alone cannot distinguish the two errors.
    factor : float
        Standard deviation of ln f, where f is the factor by which the equation counts the absorption of
        a material too high or too low, the same before and after the change.
    least : float
        Standard deviation of a further error of each material, in units of the absorption coefficient,
        which is the same for large and small alpha. It adds least / alpha to the standard deviation of
        ln f, in the sum of squares.
    evenness, evenness_sigma : float
        Mean and standard deviation of the number that interpolates ln T if the surfaces of one axis
        absorb more than the others: 0 is the shortest T of three equations (the room's own and those
        of Arau-Puchades and Fitzroy), 1 the middle T and 2 the longest.
    one_surface : float
        Probability that all exchanged surfaces are on one axis, if the room does not give their axes.
    own : float
        Standard deviation of all further errors of the change of ln T between two states of the room,
        as a share of this change.
    changed : float
        Least standard deviation of a new material's coefficients in predictions at positions. A
        coefficient with sigma = 0 stays exact.
    time : float
        Relative standard uncertainty of a measured T that states none; by default one just noticeable
        difference.
    band_correlation : float
        Correlation of the errors of ln T in bands an octave apart; it falls as band_correlation **
        octaves. It serves only for the probability that all bands together reach a target.

    Raises
    ------
    DataError
        If a value is below 0 or above 1, or band_correlation is 1.

    Examples
    --------
    >>> Assumptions(volume=0.01).common
    0.2
    """

    volume: float = 0.03
    areas: float = 0.03
    common: float = 0.2
    factor: float = 0.15
    least: float = 0.06
    evenness: float = 0.6
    evenness_sigma: float = 0.8
    one_surface: float = 0.65
    own: float = 0.03
    changed: float = 0.1
    time: float = 0.05
    band_correlation: float = 0.7

    def __post_init__(self) -> None:
        for each in fields(self):
            checks.between(each.name, getattr(self, each.name), 0, 1)
        if self.band_correlation == 1:
            raise DataError("band_correlation = 1 must be below 1")


HANDBOOK_SIGMA = 0.3
"""Relative standard deviation of absorption coefficients from a handbook."""
COMMON, TILT = 0.15, 0.10
"""Usual standard deviations of ln alpha for handbook coefficients (sigma 30 %): of a factor that all
materials have in common, and of a common slope per octave from 1 kHz. Development rooms of
benchmarks/studies/second_world have 0.13 and 0.05; in a measured room (BRAS CR2, T of seven octaves)
the slope is -0.18."""
OWN, OWN_TILT = 0.25, 0.07
"""Usual standard deviations of ln alpha for one material: of its factor and of its slope per octave.
Carpets, plasters and glass of one name differ by 20 to 60 % between tables
(`rtcal.datasets.catalogue` and its sources)."""
POWER = 2.0
"""Power of (relative sigma / handbook's sigma) by which these errors fall, since a small sigma means
measured coefficients."""


def common_error_columns(
    alpha: Array, sigma: Array, frequencies: Array, power: float = POWER
) -> tuple[Array, Array]:
    """Return the changes of coefficients by one standard deviation of each error of handbook values.

    The errors are a factor and a slope over frequency: in the first array those that all materials have
    in common, in the second those of each material alone. Each array is (2, n_materials, n_bands).
    ``alpha`` and ``sigma`` (n_materials, n_bands) are the coefficients and their standard deviations,
    ``frequencies`` (n_bands,) are in Hz. Where sigma / alpha is below a handbook's 0.3, the changes are
    multiplied by the ratio of the two to the ``power``.

    Examples
    --------
    >>> alpha, sigma = np.full((1, 1), 0.2), np.full((1, 1), 0.06)
    >>> both, own = common_error_columns(alpha, sigma, np.array([2000.0]))
    >>> both[:, 0, 0].round(3), own[:, 0, 0].round(3)
    (array([0.03, 0.02]), array([0.05 , 0.014]))
    """
    octaves = np.log2(frequencies / 1000)
    # alpha, less where its sigma is smaller than a handbook's: it was measured.
    stated = sigma / np.maximum(alpha, 1e-6) / HANDBOOK_SIGMA
    level = alpha * np.minimum(1.0, stated) ** power
    both = np.stack([COMMON * level, TILT * level * octaves])
    return both, np.stack([OWN * level, OWN_TILT * level * octaves])


def of_absorption(areas: Array, alpha: Array, sigma: Array, frequencies: Array) -> Array:
    """Return the changes of the absorption area by one standard deviation of each handbook error.

    The changes are in m², (n_errors, n_bands), and the errors are those of `common_error_columns`.
    ``areas`` (n_materials,) are in m², ``alpha`` and ``sigma`` (n_materials, n_bands) are the
    coefficients and their standard deviations, ``frequencies`` (n_bands,) are in Hz.
    """
    both, own = common_error_columns(alpha, sigma, frequencies)
    each = areas[:, np.newaxis] * own
    return np.concatenate([np.einsum("m,tmb->tb", areas, both), *each])


def in_words(room: Room) -> str:
    """Return the stated uncertainty of a room in words: "volume 5 %, areas 3 %"; "" without any.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=60, materials=["all"], areas=[94], alpha=[[0.2]],
    ...                sigma=[[0.05]], centre_frequencies=[1000], volume_sigma=0.05, area_sigma=0.03)
    >>> in_words(room)
    'volume 5 %, areas 3 %'
    """
    least, most = 100 * room.area_sigma.min(), 100 * room.area_sigma.max()
    kelvin, percent = room.climate_sigma
    stated = (
        (room.volume_sigma, f"volume {100 * room.volume_sigma:.3g} %"),
        (most, f"areas {least:.3g} to {most:.3g} %" if least < most else f"areas {most:.3g} %"),
        (room.common_area_sigma, f"areas together {100 * room.common_area_sigma:.3g} %"),
        (kelvin, f"temperature {kelvin:.3g} K"),
        (percent, f"humidity {percent:.3g} %"),
        (room.common_alpha_sigma, f"coefficients together {100 * room.common_alpha_sigma:.3g} %"),
    )
    return ", ".join(words for value, words in stated if value)


def alpha_covariance(mean: Array, sigma: Array, correlation: Array, common: float) -> Array:
    """Return the covariance of coefficients, (..., n, n): sigma R sigma + t² mu mu'.

    mu is their ``mean`` (..., n), sigma (..., n) their standard deviation and R their ``correlation``
    (n, n). t is ``common``, the relative standard deviation that all coefficients have in common. A
    coefficient with sigma = 0 is exact.
    """
    together = np.where(sigma > 0, common * mean, 0.0)
    own = sigma[..., np.newaxis] * correlation * sigma[..., np.newaxis, :]
    return np.asarray(own + together[..., np.newaxis] * together[..., np.newaxis, :])


def between_materials(materials: Sequence[str], rooms: Iterable[Room]) -> Array:
    """Return the correlation of materials' errors that rooms state, (n_materials, n_materials)."""
    out = np.eye(len(materials))
    for room in rooms:
        for (a, b), r in room.material_correlation.items():
            i, j = materials.index(a), materials.index(b)
            out[i, j] = out[j, i] = r
    return out


def prior_covariance(room: Room) -> Array:
    """Return the covariance of a room's input coefficients, n_materials * n_bands rows and columns.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="box", volume=60, materials=["all"], areas=[94], alpha=[[0.2]],
    ...                sigma=[[0.05]], centre_frequencies=[1000], common_alpha_sigma=0.1)
    >>> prior_covariance(room).round(4)  # 0.05² + (0.1 x 0.2)²
    array([[0.0029]])
    """
    of_bands = bands.correlation(room.centre_frequencies, room.band_correlation)
    correlation = np.asarray(np.kron(between_materials(room.materials, [room]), of_bands), float)
    mean, sigma = room.alpha.ravel(), room.sigma.ravel()
    return alpha_covariance(mean, sigma, correlation, room.common_alpha_sigma)


def target_changes(equation: LinearEquation, room: Room, t: Array) -> Array:
    """Return the changes of b - S'alpha in m² by one standard deviation of each error of the room.

    b is the absorption area that the measured T needs, and S'alpha that of the coefficients. ``t``
    (n_bands,) is the measured T in s. The changes (n_changes, n_bands) are in this order: volume,
    common error of the areas, area of each material, temperature, humidity. In a band without T, or
    with a T that no absorption gives, they are 0. With b = S E^-1(a) and the exponent a = (k V / T - 4
    m V) / S, for the stated room and the measured T,

        V db/dV = S a / E',  db/dS = b / S - a / E',  d(S'alpha)/dS_i = mu_i.

    In Sabine's equation E' = 1 and db/dS = 0, so that only the products of two errors are neglected:
    (alpha - mu) times the error of an area. In Eyring's and Kuttruff's equations b is linearised as
    well: the climate changes b by S / E' times the change of a.
    """
    t = np.asarray(t, dtype=float)
    total = room.total_area
    asked = equation.exponent_of_time(room, t)
    mean = equation.inverse(asked)
    with np.errstate(divide="ignore", invalid="ignore"):
        of_exponent = 1 / equation.slope(mean)
        reach = asked * of_exponent
    of_climate_change = of_climate(room, lambda changed: equation.exponent_of_time(changed, t))
    sizes = np.concatenate([[room.volume_sigma, room.common_area_sigma], room.area_sigma, [1, 1]])
    walls = room.is_surface[:, np.newaxis]  # the number of pieces does not change S
    of_areas = room.areas[:, np.newaxis] * (room.alpha - np.where(walls, mean - reach, 0.0))
    by_size = np.vstack(
        [
            -total * reach,
            of_areas.sum(axis=0, where=walls),
            of_areas,
            *(total * of_exponent * change for change in of_climate_change),
        ]
    )
    return np.where(np.isfinite(mean), sizes[:, np.newaxis] * by_size, 0.0)


def alike_alpha(room: Room) -> Array:
    """Return changes of coefficients with the same effect as one standard deviation of each room error.

    Their shape is (n_changes, n_materials, n_bands), in the order of `target_changes`. A larger area
    has the effect of coefficients larger by the same ratio, a larger volume that of smaller
    coefficients, and a change of the air's attenuation m that of a change by 4 m V / S on every
    surface.
    """
    of_air = 4 * room.volume / room.total_area * np.ones((room.n_materials, 1))
    own = np.eye(room.n_materials)[:, :, np.newaxis] * room.area_sigma[:, np.newaxis, np.newaxis]
    return np.concatenate(
        [
            np.array([[[-room.volume_sigma]], [[room.common_area_sigma]]]) * room.alpha,
            own * room.alpha,
            [of_air * m for m in of_climate(room, lambda changed: changed.air_attenuation)],
        ]
    )


def value_changes(room: Room, matrix: Array, of_level: NDArray[np.bool_]) -> Array:
    """Return the changes of values at positions by one standard deviation of each room error.

    Their shape is (n_changes, n_values). ``matrix`` (n_values, n_materials * n_bands) has the
    derivatives of the values by the coefficients, because each room error acts as the change of
    coefficients that `alike_alpha` returns. ``of_level`` (n_values,) is True for levels, which an error
    of the volume does not change.
    """
    alike = alike_alpha(room)
    changes = alike.reshape(len(alike), -1) @ matrix.T
    changes[0, of_level] = 0.0
    return np.asarray(changes)


def of_climate(room: Room, quantity: Callable[[Room], Array]) -> tuple[Array, Array]:
    """Return the changes of a quantity by one standard deviation of the air's temperature and humidity.

    ``quantity`` is a function of a room that returns its value per band. Each of the two changes is
    (n_bands,): half the difference of the values one standard deviation above and below the room's.
    """
    air, (kelvin, percent) = room.air, room.climate_sigma
    none = np.zeros(room.n_bands)
    if air is None or not (kelvin or percent):
        return none, none

    def change(name: str, sigma: float, low: float, high: float) -> Array:
        if not sigma:
            return none
        stated = getattr(air, name)
        ends = max(stated - sigma, low), min(stated + sigma, high)
        first, last = (quantity(room.with_air(replace(air, **{name: end}))) for end in ends)
        return np.asarray((first - last) * sigma / (ends[1] - ends[0]))

    return change("temperature", kelvin, -20, 50), change("humidity", percent, 1.01, 100)
