"""The protocol that every simulator follows, and the checks around a call.

A simulator is built for one room with its sources and receivers. It turns absorption coefficients
into a `Measurement`, as often as it is called. Its random numbers depend on the seed alone: the same
alpha and seed give the same measurement.

The measurement's ``uncertainty["t20"]``, (n_pairs, n_bands), is the standard error of each T20 that
the random numbers cause. A deterministic simulator states none. A decay that ends before it holds
T20 raises `TooShortError`, since the mean over pairs would ignore a NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import SAME_PLACE, Measurement, note_of_repeats
from rtcal.acoustics.observables import TARGET
from rtcal.acoustics.room import Room, in_order
from rtcal.support import checks
from rtcal.support.errors import DataError, RtcalError, SimulatorError, of_bands
from rtcal.support.text import as_sentence, shortened
from rtcal.support.types import Array, read_only


@runtime_checkable
class Simulator(Protocol):
    """Absorption coefficients in, `Measurement` out.

    Attributes
    ----------
    name : str
        Calibrated coefficients belong to the simulator of this name. The name contains the
        settings that change T.
    materials : sequence of str (n_materials,)
        Materials of the rows of alpha, as in the `Room`.
    centre_frequencies : array (n_bands,)
        Bands of the columns of alpha in Hz.
    deterministic : bool
        Whether the result does not depend on the seed.
    """

    @property
    def name(self) -> str:
        """Name that calibrated coefficients belong to."""
        ...

    @property
    def materials(self) -> Sequence[str]:
        """Materials of the rows of alpha."""
        ...

    @property
    def centre_frequencies(self) -> Array:
        """Bands of the columns of alpha in Hz."""
        ...

    @property
    def deterministic(self) -> bool:
        """Whether the result does not depend on the seed."""
        ...

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return the simulated measurement for alpha (n_materials, n_bands), which is read-only."""
        ...


class RoomSimulator:
    """Base of the simulators that are built for a `Room`, with its materials and bands."""

    room: Room

    def __repr__(self) -> str:
        return (
            f'<{type(self).__name__} of "{shortened(self.room.name)}": {len(self.materials)} '
            f"material{'s' * (len(self.materials) != 1)}, {bands.span(self.centre_frequencies)}>"
        )

    @property
    def materials(self) -> tuple[str, ...]:
        """Materials of the rows of alpha."""
        return tuple(self.room.materials)

    @property
    def centre_frequencies(self) -> Array:
        """Bands of the columns of alpha in Hz."""
        return self.room.centre_frequencies


def check_alpha(of: Simulator | Room, alpha: Array) -> Array:
    """Return a read-only copy of alpha for a simulator or a room.

    The copy protects the caller's coefficients from a simulator that changes alpha in place.

    Raises
    ------
    DataError
        If alpha is not (n_materials, n_bands), or a coefficient is not in [0, 1].
    """
    ordered = in_order("alpha", alpha, of.materials, of.centre_frequencies)
    alpha = read_only(checks.array("alpha", ordered))
    shape = (len(of.materials), len(of.centre_frequencies))
    if alpha.shape != shape:
        raise DataError(
            f"alpha has shape {alpha.shape}; {of.name} asks for (n_materials, n_bands) = {shape}"
        )
    if (outside := ~((alpha >= 0) & (alpha <= 1))).any():
        i, k = (int(v) for v in np.argwhere(outside)[0])
        place = f'alpha["{of.materials[i]}", {bands.label(of.centre_frequencies[k])}]'
        raise DataError(f"{place} = {alpha[i, k]:g} is not in [0, 1]")
    return alpha


def run(simulator: Simulator, alpha: Array, *, seed: int = 0) -> Measurement:
    """Simulate a read-only copy of alpha and check the measurement.

    Raises
    ------
    DataError
        For a seed that is not a whole number of at least 0, or an alpha as in `check_alpha`.
    SimulatorError
        If the simulator raises anything but an `RtcalError`, or returns no `Measurement`, other
        bands, or no T20 for some pair.
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
            f"{simulator.name} returned {type(measurement).__name__}; a simulator returns a "
            "Measurement"
        )
    expected, returned = simulator.centre_frequencies, measurement.centre_frequencies
    if not np.array_equal(returned, expected):
        raise SimulatorError(
            f"{simulator.name} returned bands {returned.tolist()} Hz; the room has "
            f"{expected.tolist()} Hz"
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
    """Return a note of the paths that left through gaps of the geometry; () if none did."""
    share = getattr(simulator, "lost_share", 0.0)
    if not share:
        return ()
    return (
        f"{100 * share:.2g} % of the paths left through gaps between the faces. They were dropped, and "
        "the others weigh the more.",
    )


def _of_points(points: Mapping[str, Sequence[float]]) -> dict[str, str]:
    """Return the place of each name whose point in m is that of an earlier name.

    Examples
    --------
    >>> _of_points({"R1": (1, 2, 1.2), "R2": (1, 2, 1.2), "R3": (4, 2, 1.2)})
    {'R2': 'R1'}
    """
    first: dict[str, Array] = {}
    places = {}
    for name, point in points.items():
        here = np.asarray(point, dtype=float)
        near = (n for n, p in first.items() if np.linalg.norm(p - here) <= SAME_PLACE)
        if (place := next(near, None)) is None:
            first[name] = here
        else:
            places[name] = place
    return places


def at_places(simulator: Simulator, measured: Measurement) -> tuple[Measurement, tuple[str, ...]]:
    """Return the measurement with the pairs at one place averaged, and a note of them.

    Names that the simulator puts within `SAME_PLACE` of each other are repeats:
    counted as positions, they would make their mean surer than it is.
    """
    checks.instance("measured", measured, Measurement)
    same = {}
    for i, kind in enumerate(("sources", "receivers")):
        points = getattr(simulator, kind, None)
        names = dict.fromkeys(pair[i] for pair in measured.pairs)
        known = {n: points[n] for n in names if n in points} if isinstance(points, Mapping) else {}
        same[kind] = _of_points(known)
    if not any(same.values()):
        return measured, ()
    of_sources, of_receivers = same.values()
    placed = [(of_sources.get(s, s), of_receivers.get(r, r)) for s, r in measured.pairs]
    return measured.with_repeats(**same), tuple(map(as_sentence, note_of_repeats(placed)))


def check_fits(simulator: Simulator, room: Room) -> None:
    """Raise DataError unless the simulator is one, with the room's materials and bands."""
    checks.instance("room", room, Room)
    if isinstance(simulator, type) or not isinstance(simulator, Simulator):
        raise DataError(
            f"simulator = {simulator!r} is no Simulator: it lacks simulate() or an attribute of "
            "rtcal.simulators.Simulator"
        )
    if tuple(simulator.materials) != tuple(room.materials) or not np.array_equal(
        simulator.centre_frequencies, room.centre_frequencies
    ):
        raise DataError(f'{simulator.name} has other materials or bands than room "{room.name}"')
