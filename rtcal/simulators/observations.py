"""Observations: room-acoustic parameters by pair and band, and their derivatives by alpha.

An `Observations` holds numbers that are nearly linear in alpha: ln T20, ln T30, ln EDT and ln Ts, and
C50, C80 and the level in dB. `observe` and `jacobian` give them for any simulator. A simulator that
can weigh its paths anew has methods of its own (`DifferentiableSimulator`); others are differentiated
by central differences with the same seed, so that their random numbers cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.decay import checked_decay, gradients
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MATCH, OBSERVABLES, observable, parameter_label
from rtcal.simulators import base
from rtcal.simulators.base import Simulator
from rtcal.support import checks
from rtcal.support.errors import DataError, SimulatorError, TooShortError
from rtcal.support.types import Array, read_only

LARGEST_ALPHA = 0.999
"""Largest alpha in an analytic derivative: beyond it nothing is reflected, and it would be 0 / 0."""
STEP = 0.01
"""Step in alpha of the differences. T of a diffuse field changes by 1 to 20 % over it, far more than
rounding, and its curvature adds less than 1 % to the slope."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observations:
    """Parameters by pair and band, in units in which they are nearly linear in alpha.

    Attributes
    ----------
    parameters : tuple of str (n_parameters,)
        Keys of `rtcal.acoustics.observables.OBSERVABLES`. Decay times and Ts are logarithms.
    pairs : tuple of (source, receiver) (n_pairs,)
    centre_frequencies : array (n_bands,)
        Hz.
    values : array (n_parameters, n_pairs, n_bands)
        NaN where missing.
    direct : array (n_pairs, n_bands), optional
        Share of the direct sound in the energy, where it is simulated.
    """

    parameters: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    centre_frequencies: Array
    values: Array
    direct: Array | None = None

    def __post_init__(self) -> None:
        f = checks.array("Observations: centre_frequencies", self.centre_frequencies)
        if f.ndim != 1:
            raise DataError(f"Observations: centre_frequencies has shape {f.shape}, not (n_bands,)")
        parameters = checks.texts("Observations: parameters", self.parameters)
        pairs = checks.pairs("Observations: pairs", self.pairs)
        shape = (len(parameters), len(pairs), len(f))
        values = read_only(checks.array("observations", self.values))
        if values.shape != shape:
            raise DataError(
                f"observations have shape {values.shape}; (n_parameters, n_pairs, n_bands) = {shape}"
            )
        if self.direct is not None:
            direct = checks.array("Observations: direct", self.direct)
            if direct.shape != shape[1:]:
                raise DataError(
                    f"Observations: direct has shape {direct.shape}; (n_pairs, n_bands) = {shape[1:]}"
                )
        for name, value in (
            ("parameters", parameters),
            ("pairs", pairs),
            ("centre_frequencies", f),
            ("values", values),
        ):
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        return (
            f"<Observations of {', '.join(parameter_label(p) for p in self.parameters)}: "
            f"{len(self.pairs)} pairs, {bands.span(self.centre_frequencies)}>"
        )

    def natural(self, parameter: str) -> Array:
        """Return a parameter in its own unit, s or dB, (n_pairs, n_bands)."""
        values = self.values[self.parameters.index(parameter)]
        return observable(parameter).natural(values)

    def at(self, like: Observations) -> Observations:
        """Return the observations of another's parameters and pairs, which these have, too."""
        rows = [self.parameters.index(p) for p in like.parameters]
        columns = [self.pairs.index(pair) for pair in like.pairs]
        shape = (len(rows), len(columns), len(self.centre_frequencies))
        return Observations(
            parameters=like.parameters,
            pairs=like.pairs,
            centre_frequencies=self.centre_frequencies,
            values=self.values[np.ix_(rows, columns)].reshape(shape),
        )

    @classmethod
    def of_measurement(
        cls, measurement: Measurement, parameters: Sequence[str], pairs: Sequence[tuple[str, str]]
    ) -> Observations:
        """Return the observations of measured or simulated values, NaN where missing.

        Parameters
        ----------
        measurement : Measurement
        parameters : sequence of str
            The level is ``"level"``, or else ``"g"``.
        pairs : sequence of (source, receiver)
            NaN where the measurement lacks a pair.
        """
        checks.instance("measurement", measurement, Measurement)
        parameters = checks.texts("parameters", parameters)
        pairs = checks.pairs("pairs", pairs)
        rows = {pair: i for i, pair in enumerate(measurement.pairs)}
        values = np.full((len(parameters), len(pairs), len(measurement.centre_frequencies)), np.nan)
        names = checked_parameters(parameters) if parameters else ()
        for of_parameter, name in zip(values, names, strict=True):
            key = observable(name).key_in(measurement.values)
            if key not in measurement.values:
                continue
            for of_pair, pair in zip(of_parameter, pairs, strict=True):
                if pair in rows:
                    of_pair[:] = measurement.values[key][rows[pair]]
            of_parameter[:] = observable(name).observed(of_parameter)
        return cls(
            parameters=tuple(parameters),
            pairs=tuple(pairs),
            centre_frequencies=measurement.centre_frequencies,
            values=np.where(np.isfinite(values), values, np.nan),
        )


@runtime_checkable
class DifferentiableSimulator(Protocol):
    """A `Simulator` that gives observations and their derivatives itself."""

    def observe(self, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0) -> Observations:
        """Return the observations for alpha (n_materials, n_bands)."""
        ...

    def jacobian(self, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0) -> Array:
        """Return their derivatives, (n_parameters, n_pairs, n_bands, n_materials).

        No observation depends on alpha of another band.
        """
        ...


def given(measurement: Measurement) -> tuple[str, ...]:
    """Return the parameters that a measurement has; G is a level too."""
    stood_in = [k for k, o in OBSERVABLES.items() if o.stand_in in measurement.values]
    return tuple(dict.fromkeys((*measurement.values, *stood_in)))


def by_surface(by: object) -> bool:
    """Return whether derivatives are by surface, not by material; DataError for anything else."""
    if not isinstance(by, str) or by not in ("material", "surface"):
        raise DataError(f'by = {by!r} is not "material" or "surface"')
    return by == "surface"


def checked_parameters(match: Sequence[str]) -> tuple[str, ...]:
    """Return the names of parameters; DataError for an unknown one, a repeated one or none."""
    names = checks.listed("match", match)
    if not names:
        raise DataError("match is empty; it has at least one parameter")
    for name in names:
        if not isinstance(name, str) or name not in OBSERVABLES:
            raise DataError(f'match has "{name}"; it has some of {", ".join(OBSERVABLES)}')
    if len(set(names)) < len(names):
        raise DataError(f"match has a parameter twice: {', '.join(names)}")
    return tuple(names)


def observe(
    simulator: Simulator, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0
) -> Observations:
    """Return what a simulator's positions hear for alpha (n_materials, n_bands).

    Raises
    ------
    DataError
        For an unknown parameter, a seed or an alpha that breaks its rule.
    SimulatorError
        If the simulator raises it, or does not give a parameter. The message names it.
    """
    match = checked_parameters(match)
    if isinstance(simulator, DifferentiableSimulator):
        return simulator.observe(base.check_alpha(simulator, alpha), match, seed=seed)
    simulated = base.run(simulator, alpha, seed=seed)
    if lacking := [parameter_label(m) for m in match if m not in given(simulated)]:
        raise SimulatorError(
            f"{simulator.name} does not give {', '.join(lacking)}, only "
            f"{', '.join(parameter_label(p) for p in simulated.values)}; leave it out of match"
        )
    return Observations.of_measurement(simulated, match, simulated.pairs)


def jacobian(
    simulator: Simulator, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0
) -> Array:
    """Return the derivatives of `observe`, (n_parameters, n_pairs, n_bands, n_materials).

    A simulator without a method of its own is differentiated by `differences`.
    """
    match = checked_parameters(match)
    if isinstance(simulator, DifferentiableSimulator):
        return simulator.jacobian(base.check_alpha(simulator, alpha), match, seed=seed)
    return differences(simulator, alpha, match, seed=seed)


def differences(
    simulator: Simulator, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0
) -> Array:
    """Return the derivatives by differences, (n_parameters, n_pairs, n_bands, n_materials).

    Each material takes two simulations with alpha changed by `STEP` in all bands. Both have the same
    seed, so that random numbers that do not depend on alpha cancel.
    """
    alpha = base.check_alpha(simulator, alpha)
    columns = []
    for j in range(len(alpha)):
        ends = []
        for step in (-STEP, STEP):
            moved = alpha.copy()
            moved[j] = np.clip(alpha[j] + step, 0.0, 1.0)
            ends.append((moved[j], observe(simulator, moved, match, seed=seed).values))
        (low, below), (high, above) = ends
        columns.append((above - below) / (high - low))
    return np.stack(columns, axis=-1)


def of_decays(
    energy: Array,
    bin_width: float,
    match: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    centre_frequencies: Array,
    cause: str = "too little is reflected",
) -> Observations:
    """Return the observations of energy decays, (n_pairs, n_bands, n_bins) in 1/m².

    The level is that of a source of unit energy, relative to 10 m in the free field: G. ``cause`` is
    why a decay may lack a parameter.

    Raises
    ------
    TooShortError
        If a decay is cut off before it holds a decay time.
    DataError
        If a decay lacks a parameter.
    """
    energy = checked_decay(energy, bin_width)
    return Observations(
        parameters=tuple(match),
        pairs=tuple(pairs),
        centre_frequencies=centre_frequencies,
        values=values_of_decays(energy, bin_width, match, pairs, centre_frequencies, cause),
        direct=energy[..., 0] / energy.sum(-1),
    )


def values_of_decays(
    energy: Array,
    bin_width: float,
    match: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    centre_frequencies: Array,
    cause: str = "too little is reflected",
) -> Array:
    """Return the values of `of_decays`, of decays that need no check.

    Decays (..., n_pairs, n_bands, n_bins) give (n_parameters, ..., n_pairs, n_bands).
    """
    values = np.empty((len(match), *energy.shape[:-1]))
    for row, name in zip(values, match, strict=True):
        kind = OBSERVABLES[name]
        value = kind.value(energy, bin_width)
        row[:] = kind.observed(value) if kind.logarithmic else value
        if (lost := ~np.isfinite(row)).any():
            first = tuple(np.argwhere(lost)[0].tolist())
            *_, pair, band = first
            place = f"{' to '.join(pairs[pair])}, {bands.label(centre_frequencies[band])}"
            if kind.too_short(energy)[first]:
                raise TooShortError(
                    f"the decay from {place} is too short to hold {parameter_label(name)}: {cause}"
                )
            raise DataError(f"the decay from {place} has no {parameter_label(name)}: {cause}")
    return values


def chained(
    energy: Array, gradient: Array, bin_width: float, match: Sequence[str]
) -> NDArray[np.float64]:
    """Return the derivatives of the observations, (n_parameters, n_pairs, n_bands, n_unknowns).

    ``energy`` (n_pairs, n_bands, n_bins), its ``gradient`` (n_pairs, n_bins, n_unknowns, n_bands).
    """
    by_bin = gradients(energy, bin_width, match)
    return np.asarray(np.einsum("prkb,rbjk->prkj", by_bin, gradient, optimize=True))
