"""The protocol that every simulator follows, the checks around a call, and simulated observations.

A simulator is built for one room with its sources and receivers. It turns absorption coefficients
into a `Measurement`, as often as it is called. Its random numbers depend on the seed alone: the same
alpha and seed give the same measurement.

The measurement's ``uncertainty["t20"]``, (n_pairs, n_bands), is the standard error of each T20 that
the random numbers cause. A deterministic simulator states none. A decay that ends before it holds
T20 raises `TooShortError`, since the mean over pairs would ignore a NaN.

An `Observations` holds numbers that are nearly linear in alpha: ln T20, ln T30, ln EDT and ln Ts, and
C50, C80 and the level in dB. `observe` and `jacobian` give them for any simulator. A simulator that
can weigh its paths anew has methods of its own (`derivatives`); others are differentiated
by central differences with the same seed, so that their random numbers cancel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.measurement import SAME_PLACE, Measurement, note_of_repeats
from rtcal.acoustics.observables import (
    MATCH,
    OBSERVABLES,
    TARGET,
    DecaySlope,
    checked_decay,
    decay_curve_db,
    observable,
    parameter_label,
)
from rtcal.acoustics.room import Room, in_order
from rtcal.support import checks
from rtcal.support.errors import DataError, RtcalError, SimulatorError, TooShortError, of_bands
from rtcal.support.text import as_sentence, shortened
from rtcal.support.types import Array, put


@runtime_checkable
class Simulator(Protocol):
    """Simulator of a room, which returns room-acoustic parameters for absorption coefficients."""

    @property
    def name(self) -> str:
        """Name of the simulator, with the settings that change T."""
        ...

    @property
    def materials(self) -> Sequence[str]:
        """Names of the materials, (n_materials,): row i of the coefficients is that of material i."""
        ...

    @property
    def centre_frequencies(self) -> Array:
        """Centre frequencies of the bands in Hz, (n_bands,), one for each column of coefficients."""
        ...

    @property
    def deterministic(self) -> bool:
        """Whether the same coefficients give the same result for any seed of the random numbers."""
        ...

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return the simulated parameters, at least T20, for absorption coefficients ``alpha``.

        ``alpha`` (n_materials, n_bands) is read-only: the method must not change it. ``seed`` is that
        of the random numbers.
        """
        ...


class RoomSimulator:
    """Base of the simulators that are built for a `Room`, with its materials and bands.

    It has the methods that `rtcal.calibrate_positions` needs beyond those of `Simulator`, with defaults
    for a simulator that does not trace paths.
    """

    room: Room

    @property
    def tracing(self) -> Any:
        """Path tracing of the same room, for reference simulations; None without a geometry."""
        return None

    @property
    def fits_scattering(self) -> bool:
        """Whether scattering coefficients can be fitted, because derivatives by them are known."""
        return False

    @property
    def notes(self) -> tuple[str, ...]:
        """Cautions and assumptions about the geometry and the sources."""
        return ()

    def denser(self, factor: int = 1, n_batches: int | None = None) -> Any:
        """Return the simulator with more paths and less noise; unchanged if it has no noise.

        ``factor`` multiplies the number of paths, and ``n_batches`` is the new number of their batches.
        """
        return self

    def trace_ahead(self, alpha: Array, factor: float, *, seed: int = 0) -> None:
        """Trace paths for ``factor`` times Eyring's T, so that later simulations reuse them.

        ``alpha`` (n_materials, n_bands) are the coefficients for which T is calculated, and ``seed`` is
        that of the random numbers. Without paths nothing is done.
        """

    def observe_in_groups(
        self, alpha: Array, number: int, match: Sequence[str] = MATCH, *, seed: int = 0
    ) -> Array | None:
        """Return parameters from groups of the paths, which differ by noise; None without paths.

        ``alpha`` (n_materials, n_bands) are the coefficients, ``number`` is that of the groups,
        ``match`` are keys of the parameters, and ``seed`` is that of the random numbers.
        """
        return None

    def trusted(self, match: Sequence[str]) -> tuple[str, ...]:
        """Return the parameters that do not need the directivities of sources.

        ``match`` are the keys of the parameters to choose from.
        """
        return tuple(match)

    def with_air(self, air: Air) -> Any:
        """Return the simulator of the room with other air; DataError if its air cannot change."""
        raise DataError("this simulator cannot change its air; for another climate use PathTracing")

    def __repr__(self) -> str:
        return (
            f'<{type(self).__name__} of "{shortened(self.room.name)}": {len(self.materials)} '
            f"material{'s' * (len(self.materials) != 1)}, {bands.span(self.centre_frequencies)}>"
        )

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of the room's materials, (n_materials,)."""
        return tuple(self.room.materials)

    @property
    def centre_frequencies(self) -> Array:
        """Centre frequencies of the room in Hz, (n_bands,)."""
        return self.room.centre_frequencies


class _Foreign(RoomSimulator):
    """A simulator of a user's own class, with the defaults of `RoomSimulator`."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator

    def denser(self, factor: int = 1, n_batches: int | None = None) -> Simulator:
        return self.simulator


def complete(simulator: Simulator) -> RoomSimulator:
    """Return a simulator with all methods that `rtcal.calibrate_positions` needs."""
    return simulator if isinstance(simulator, RoomSimulator) else _Foreign(simulator)


def check_alpha(of: Simulator | Room, alpha: Array) -> Array:
    """Return a read-only copy of coefficients, once they are checked for a simulator or a room.

    Raises DataError if ``alpha`` does not have the shape (n_materials, n_bands) of the simulator or
    room ``of``, or if a coefficient is not from 0 to 1; that of pieces (`Room.pieces`) may be larger.
    """
    materials, frequencies = of.materials, of.centre_frequencies
    ordered = in_order("alpha", alpha, materials)
    alpha = checks.shaped("alpha", ordered, len(materials), len(frequencies))
    room = getattr(of, "room", of)
    most = np.ones(alpha.shape)
    if isinstance(room, Room) and room.n_materials == len(materials):
        most = room.most_alpha
    checks.entries(
        lambda i, k: f'alpha["{materials[i]}", {bands.label(float(frequencies[k]))}]',
        alpha,
        (alpha >= 0) & (alpha <= most),
        lambda i, k: f"from 0 to {most[i, k]:g}",
    )
    return alpha


def run(simulator: Simulator, alpha: Array, *, seed: int = 0) -> Measurement:
    """Return a simulator's result for coefficients, once coefficients and result are checked.

    ``alpha`` (n_materials, n_bands) are the coefficients, ``seed`` is that of the random numbers.

    Raises
    ------
    DataError
        For a seed that is no whole number of at least 0, and for the reasons of `check_alpha`.
    SimulatorError
        If the simulator raises an error that is no `RtcalError`, or returns no `Measurement`, other
        bands, or no T20 for a pair.
    """
    checks.whole("seed", seed, 0)
    alpha = check_alpha(simulator, alpha)
    try:
        measurement: object = simulator.simulate(alpha, seed=seed)
    except RtcalError:
        raise
    except (Exception, SystemExit) as error:  # a script's sys.exit() must not end the caller
        text = " ".join(str(error).split())
        raise SimulatorError(f"{simulator.name} raised {type(error).__name__}: {text}") from error
    if not isinstance(measurement, Measurement):
        raise SimulatorError(
            f"{simulator.name} returned {type(measurement).__name__}; it must return a Measurement"
        )
    expected, returned = simulator.centre_frequencies, measurement.centre_frequencies
    if not np.array_equal(returned, expected):
        raise SimulatorError(
            f"{simulator.name} returned the bands {returned.tolist()} Hz; they must be the "
            f"room's, {expected.tolist()} Hz"
        )
    if TARGET.key not in measurement.values:
        raise SimulatorError(
            f"{simulator.name} returned no {TARGET.key}, only {', '.join(measurement.values)}"
        )
    if (missing := np.isnan(measurement.values[TARGET.key])).any():
        pair, band = (int(i) for i in np.argwhere(missing)[0])
        incomplete = SimulatorError(
            f"{simulator.name} returned NaN for {TARGET.key}[{' to '.join(measurement.pairs[pair])}, "
            f"{bands.label(expected[band])}]; a mean over the other pairs would hide it"
        )
        raise of_bands(incomplete, np.flatnonzero(missing.any(axis=0)))
    return measurement


def lost_paths(simulator: Simulator) -> tuple[str, ...]:
    """Return a note on paths that left the room through gaps of the geometry; () without any."""
    share = getattr(simulator, "lost_share", 0.0)
    if not share:
        return ()
    return (
        f"{100 * share:.2g} % of the paths left through gaps between the faces. They were dropped, and "
        "the weight of the others was raised.",
    )


def at_places(simulator: Simulator, measured: Measurement) -> tuple[Measurement, tuple[str, ...]]:
    """Return the measurement with repeats at one position averaged, and notes on these repeats.

    Positions with different names count as repeats if they are within `SAME_PLACE` of each other in the
    simulator. As separate positions they would make the uncertainty of the mean too small.
    """
    checks.instance("measured", measured, Measurement)
    same: dict[str, dict[str, str]] = {"sources": {}, "receivers": {}}
    for i, (kind, of_kind) in enumerate(same.items()):
        points = getattr(simulator, kind, None)
        places: dict[str, Array] = {}
        for name in dict.fromkeys(pair[i] for pair in measured.pairs):
            if isinstance(points, Mapping) and name in points:
                here = np.asarray(points[name], dtype=float)
                near = (n for n, p in places.items() if np.linalg.norm(p - here) <= SAME_PLACE)
                if (place := next(near, None)) is None:
                    places[name] = here
                else:
                    of_kind[name] = place
    of_sources, of_receivers = same.values()
    if not of_sources and not of_receivers:
        return measured, ()
    placed = [(of_sources.get(s, s), of_receivers.get(r, r)) for s, r in measured.pairs]
    return measured.with_repeats(**same), tuple(map(as_sentence, note_of_repeats(placed)))


def check_fits(simulator: Simulator, room: Room) -> None:
    """Raise DataError if an object is no simulator, or has other materials or bands than the room."""
    checks.instance("room", room, Room)
    if isinstance(simulator, type) or not isinstance(simulator, Simulator):
        raise DataError(
            f"simulator = {simulator!r} is not a Simulator: simulate() or an attribute of "
            "rtcal.simulators.Simulator is missing"
        )
    if tuple(simulator.materials) != tuple(room.materials) or not np.array_equal(
        simulator.centre_frequencies, room.centre_frequencies
    ):
        raise DataError(
            f'{simulator.name} has other materials or bands than room "{room.name}": make the '
            "simulator with this room"
        )


LARGEST_ALPHA = 0.999
"""Largest coefficient in an analytic derivative, because nothing is reflected at 1."""
STEP = 0.01
"""Step of alpha in derivatives by differences. T of a diffuse field changes by 1 to 20 % over it, far
more than by rounding, and its curvature changes the slope by less than 1 %."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observations:
    """Room-acoustic parameters by pair and band, on a scale that is nearly linear in alpha.

    ``parameters`` are keys of `rtcal.acoustics.observables.OBSERVABLES`. Values of decay times and Ts
    are logarithms, all others are the parameters themselves.

    ``values`` (n_parameters, n_pairs, n_bands) are NaN where missing. ``pairs`` are (source, receiver),
    and ``centre_frequencies`` are in Hz. ``direct`` (n_pairs, n_bands) is the direct sound's share of
    the energy, None if it is unknown.
    """

    parameters: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]  # source and receiver
    centre_frequencies: Array  # Hz
    values: Array  # (n_parameters, n_pairs, n_bands), NaN where missing
    direct: Array | None = None  # share of the direct sound in the energy, (n_pairs, n_bands)

    def __post_init__(self) -> None:
        place = "Observations: "
        f = checks.shaped(f"{place}centre_frequencies", self.centre_frequencies, "n_bands")
        shape = (len(self.parameters), len(self.pairs), len(f))
        put(
            self,
            parameters=checks.texts(f"{place}parameters", self.parameters),
            pairs=checks.pairs(f"{place}pairs", self.pairs),
            centre_frequencies=f,
            values=checks.shaped(f"{place}values", self.values, *shape),
        )
        if self.direct is not None:
            put(self, direct=checks.shaped(f"{place}direct", self.direct, *shape[1:]))

    def __repr__(self) -> str:
        return (
            f"<Observations of {', '.join(parameter_label(p) for p in self.parameters)}: "
            f"{len(self.pairs)} pairs, {bands.span(self.centre_frequencies)}>"
        )

    def natural(self, parameter: str) -> Array:
        """Return the values of a parameter in s or dB, (n_pairs, n_bands)."""
        values = self.values[self.parameters.index(parameter)]
        return observable(parameter).natural(values)

    @property
    def one_jnd(self) -> Array:
        """One just noticeable difference (JND) of each value, (n_parameters, n_pairs, n_bands)."""
        found = np.empty(self.values.shape)
        for row, name in zip(found, self.parameters, strict=True):
            kind, own = observable(name), self.natural(name)
            row[:] = kind.of_observed(np.broadcast_to(kind.jnd_of(own), own.shape), own)
        return found

    def at(self, like: Observations) -> Observations:
        """Return these observations for the parameters and pairs of other observations, ``like``."""
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
        """Return the observations from measured or simulated values, NaN where a value is missing.

        ``parameters`` are keys, such as ``"t20"``, and ``pairs`` are (source, receiver) in the wanted
        order. The relative level is that of ``"level"``, or of ``"g"`` if ``"level"`` is not measured.
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


def given(measurement: Measurement) -> tuple[str, ...]:
    """Return the parameters that a measurement has; G counts as a relative level, too."""
    stood_in = [k for k, o in OBSERVABLES.items() if o.stand_in in measurement.values]
    return tuple(dict.fromkeys((*measurement.values, *stood_in)))


def checked_parameters(match: Sequence[str]) -> tuple[str, ...]:
    """Return names of parameters; DataError for an unknown name, a repeated one or none."""
    names = checks.listed("match", match)
    if not names:
        raise DataError("match is empty; give at least one parameter")
    for name in names:
        checks.choice("match", name, OBSERVABLES)
    checks.distinct("match", names, "give each parameter once")
    return names


def derivatives(simulator: Simulator) -> Any:
    """Return the simulator if it has the methods ``observe`` and ``jacobian``; None otherwise.

    ``observe(alpha, match, *, seed)`` must return `Observations`, and ``jacobian(alpha, match, *,
    seed)`` their derivatives by alpha, (n_parameters, n_pairs, n_bands, n_materials). An observation
    must not depend on coefficients of another band.
    """
    return simulator if hasattr(simulator, "observe") and hasattr(simulator, "jacobian") else None


def observe(
    simulator: Simulator, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0
) -> Observations:
    """Return the simulated parameters at a simulator's positions, as `Observations`.

    ``alpha`` (n_materials, n_bands) are the coefficients, ``match`` the keys of the parameters, and
    ``seed`` that of the random numbers. Raises DataError for an unknown parameter or a wrong seed or
    alpha, and SimulatorError if the simulator does not return a parameter.
    """
    if (own := derivatives(simulator)) is not None:
        if not isinstance(own, RoomSimulator):  # those check it themselves
            alpha, match = check_alpha(simulator, alpha), checked_parameters(match)
        observations: Observations = own.observe(alpha, match, seed=seed)
        return observations
    match = checked_parameters(match)
    simulated = run(simulator, alpha, seed=seed)
    if lacking := [parameter_label(m) for m in match if m not in given(simulated)]:
        raise SimulatorError(
            f"{simulator.name} does not calculate {', '.join(lacking)}, only "
            f"{', '.join(parameter_label(p) for p in simulated.values)}; leave it out of match"
        )
    return Observations.of_measurement(simulated, match, simulated.pairs)


def jacobian(
    simulator: Simulator, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0
) -> Array:
    """Return the derivatives of `observe` by alpha, (n_parameters, n_pairs, n_bands, n_materials).

    They come from the simulator's method ``jacobian`` or, without this method, from `differences`. The
    arguments are those of `observe`.
    """
    match = checked_parameters(match)
    if (own := derivatives(simulator)) is not None:
        return np.asarray(own.jacobian(check_alpha(simulator, alpha), match, seed=seed))
    return differences(simulator, alpha, match, seed=seed)


def differences(
    simulator: Simulator, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0
) -> Array:
    """Return the derivatives of `observe` by alpha from differences between simulations.

    Their shape is (n_parameters, n_pairs, n_bands, n_materials), and the arguments are those of
    `observe`. Each material needs two simulations, in which its alpha is changed by `STEP` in all
    bands, with the same seed. If one of the two gives too short a decay, it is replaced by a
    simulation with the unchanged alpha.
    """
    alpha = check_alpha(simulator, alpha)
    columns = []
    for j in range(len(alpha)):
        ends = list[tuple[Array, Array]]()
        for step in (-STEP, STEP, 0.0):
            moved = alpha.copy()
            moved[j] = np.clip(alpha[j] + step, 0.0, 1.0)
            try:
                ends.append((moved[j], observe(simulator, moved, match, seed=seed).values))
            except TooShortError:
                if not step:
                    raise
            if len(ends) == 2:
                break
        (low, below), (high, above) = ends
        columns.append((above - below) / (high - low))
    return np.stack(columns, axis=-1)


def of_decays(
    energy: Array,
    bin_width: float,
    match: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    centre_frequencies: Array,
    cause: str = "too little sound is reflected",
) -> Observations:
    """Return the observations from energy decays, (n_pairs, n_bands, n_bins) in 1/m².

    ``bin_width`` is the width of the time bins in s, and ``match`` are keys of the parameters. The
    level is G: that of a source of unit energy, relative to 10 m in the free field. ``cause`` is the
    reason that error messages give for a missing parameter. Raises TooShortError if a decay is too
    short for a decay time, and DataError if another parameter is missing.
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
    cause: str = "too little sound is reflected",
) -> Array:
    """Return the values of parameters from energy decays, as `of_decays` but without its checks.

    ``energy`` (..., n_pairs, n_bands, n_bins) gives values (n_parameters, ..., n_pairs, n_bands). The
    arguments are those of `of_decays`.
    """
    values = np.empty((len(match), *energy.shape[:-1]))
    of_slopes = any(isinstance(OBSERVABLES[name], DecaySlope) for name in match)
    level = decay_curve_db(energy) if of_slopes else energy
    for row, name in zip(values, match, strict=True):
        kind = OBSERVABLES[name]
        if isinstance(kind, DecaySlope):
            value = kind.of_decay(energy, level, bin_width)
        else:
            value = kind.value(energy, bin_width)
        row[:] = kind.observed(value) if kind.logarithmic else value
        if (lost := ~np.isfinite(row)).any():
            first = tuple(np.argwhere(lost)[0].tolist())
            *_, pair, band = first
            place = f"{' to '.join(pairs[pair])}, {bands.label(centre_frequencies[band])}"
            if kind.too_short(energy)[first]:
                raise TooShortError(
                    f"the decay from {place} is too short for {parameter_label(name)}: {cause}"
                )
            raise DataError(f"the decay from {place} has no {parameter_label(name)}: {cause}")
    return values
