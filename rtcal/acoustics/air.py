"""The air in the room: speed of sound, and its attenuation after ISO 9613-1."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_REFERENCE_PRESSURE = 101.325  # kPa
_REFERENCE_TEMPERATURE = 293.15  # K
_TRIPLE_POINT = 273.16  # K
_DB_PER_NEPER_OF_ENERGY = 10 / np.log(10)


@dataclass(frozen=True)
class Air:
    """Air of a room, from which the attenuation and the speed of sound follow.

    Parameters
    ----------
    temperature : float
        Temperature in °C, from -20 to 50 (the range of ISO 9613-1).
    humidity : float
        Relative humidity in %, above 1 and up to 100.
    pressure : float
        Ambient pressure in kPa, above 0 and up to 200 (ISO 9613-1).

    Raises
    ------
    DataError
        If a value is outside its range.

    References
    ----------
    ISO 9613-1:1993, Acoustics - Attenuation of sound during propagation outdoors - Part 1.

    Examples
    --------
    >>> air = Air(temperature=20, humidity=50)
    >>> round(air.speed_of_sound, 1)
    343.2
    >>> print(np.round(1000 * air.attenuation([1000, 4000]), 2))
    [1.07 6.83]
    """

    temperature: float = 20.0
    humidity: float = 50.0
    pressure: float = 101.325

    def __post_init__(self) -> None:
        for name in ("temperature", "humidity", "pressure"):
            checks.number(f"air.{name}", getattr(self, name))
        rules = (
            ("temperature", -20 <= self.temperature <= 50, "°C", "from -20 to 50 °C"),
            ("humidity", 0 < self.humidity <= 100, "%", "above 0 and at most 100 %"),
            ("pressure", 0 < self.pressure <= 200, "kPa", "above 0 and at most 200 kPa"),
        )
        for name, holds, unit, rule in rules:
            if not holds:  # every comparison with NaN is false, so NaN is refused too
                raise DataError(f"air.{name} = {getattr(self, name):g} {unit} must be {rule}")
        if self.humidity <= 1:  # no room is so dry
            raise DataError(
                f"air.humidity = {self.humidity:g} % looks like a fraction; write humidity = "
                f"{100 * self.humidity:g} for {100 * self.humidity:g} %"
            )

    @property
    def speed_of_sound(self) -> float:
        """Speed of sound c = 331.3 sqrt(1 + t / 273.15) in m/s, t the temperature in °C."""
        return float(331.3 * np.sqrt(1 + self.temperature / 273.15))

    def attenuation(self, frequencies: Iterable[float]) -> Array:
        """Return the air's energy attenuation coefficient m in 1/m at each frequency, (n_bands,).

        ``frequencies`` are in Hz. The intensity of a plane pure tone falls as exp(-m x) over the
        distance x in m (ISO 9613-1:1993, Eqs. 3 to 5 and B.2, B.3). Reverberation equations need m in
        1/m for their term 4mV. To convert m from dB/m to 1/m, divide it by 10 lg e = 4.34.
        """
        f = checks.array("frequencies", checks.listed("frequencies", frequencies))
        kelvin = self.temperature + 273.15
        t = kelvin / _REFERENCE_TEMPERATURE
        p = self.pressure / _REFERENCE_PRESSURE
        saturation = 10 ** (-6.8346 * (_TRIPLE_POINT / kelvin) ** 1.261 + 4.6151)
        h = self.humidity * saturation / p  # molar concentration of water vapour, %
        oxygen = p * (24 + 4.04e4 * h * (0.02 + h) / (0.391 + h))  # relaxation frequencies, Hz
        nitrogen = p / np.sqrt(t) * (9 + 280 * h * np.exp(-4.170 * (t ** (-1 / 3) - 1)))
        classical = 1.84e-11 * np.sqrt(t) / p
        relaxation = t**-2.5 * (
            0.01275 * np.exp(-2239.1 / kelvin) / (oxygen + f**2 / oxygen)
            + 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen + f**2 / nitrogen)
        )
        db_per_metre = 8.686 * f**2 * (classical + relaxation)
        return np.asarray(db_per_metre / _DB_PER_NEPER_OF_ENERGY)
