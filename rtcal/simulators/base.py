"""What every simulator is to the rest of the package.

A simulator is built for one room, its sources and receivers; then it turns absorption coefficients
into a `Measurement`, as often as it is asked. It draws its random numbers from the seed alone: the
same alpha and seed give the same measurement.

Its noise stands in what it returns: where the measurement's ``uncertainty["t20"]`` is given,
(n_pairs, n_bands), it is the standard error of each T20 from the random numbers. A deterministic
simulator states none. A decay that ends before it holds T20 is a `TooShortError`, never a NaN that
a mean over pairs would swallow: `rtcal.acoustics.decay.measurement` sees to both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.errors import DataError, RtcalError, SimulatorError, of_bands
from rtcal.support import checks
from rtcal.support.types import Array


@runtime_checkable
class Simulator(Protocol):
    """Absorption coefficients in, `Measurement` out.

    Attributes
    ----------
    name : str
        Calibrated coefficients belong to the simulator of this name, settings that matter included.
    materials : sequence of str (n_materials,)
        What the rows of alpha are, as in the `Room`.
    centre_frequencies : array (n_bands,)
        Hz; what the columns of alpha are.
    deterministic : bool
        Whether the seed changes nothing.
    smooth : bool
        Whether with one seed T moves smoothly with alpha, as where all alpha weigh the same paths.
        The steps of a closed loop share a seed: they then differ by alpha and by no noise.
    """

    @property
    def name(self) -> str:
        """The simulator's name."""
        ...

    @property
    def materials(self) -> Sequence[str]:
        """What the rows of alpha are."""
        ...

    @property
    def centre_frequencies(self) -> Array:
        """What the columns of alpha are, in Hz."""
        ...

    @property
    def deterministic(self) -> bool:
        """Whether the seed changes nothing."""
        ...

    @property
    def smooth(self) -> bool:
        """Whether with one seed T moves smoothly with alpha."""
        ...

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return what is measured in the simulated room for alpha (n_materials, n_bands)."""
        ...


def check_alpha(simulator: Simulator, alpha: Array) -> Array:
    """Return alpha as an array; DataError unless it is (n_materials, n_bands) and within [0, 1]."""
    alpha = checks.array("alpha", alpha)
    shape = (len(simulator.materials), len(simulator.centre_frequencies))
    if alpha.shape != shape:
        raise DataError(
            f"alpha has shape {alpha.shape}; {simulator.name} asks for (n_materials, n_bands) = {shape}"
        )
    if (bad := ~((alpha >= 0) & (alpha <= 1))).any():
        i, k = (int(v) for v in np.argwhere(bad)[0])
        place = f'alpha["{simulator.materials[i]}", {bands.label(simulator.centre_frequencies[k])}]'
        raise DataError(f"{place} = {alpha[i, k]:g} is not in [0, 1]")
    return alpha


def run(simulator: Simulator, alpha: Array, *, seed: int = 0) -> Measurement:
    """Simulate and check what comes back.

    Raises
    ------
    SimulatorError
        If the simulator raises anything but an `RtcalError`, returns no `Measurement`, other bands,
        or a T20 that is missing for some pair.
    """
    alpha = check_alpha(simulator, alpha)
    try:
        found = simulator.simulate(alpha, seed=seed)
    except RtcalError:
        raise
    except Exception as error:
        said = " ".join(str(error).split())
        raise SimulatorError(f"{simulator.name} raised {type(error).__name__}: {said}") from error
    return check_measurement(simulator, found)


def check_measurement(simulator: Simulator, found: object) -> Measurement:
    """Return a simulator's answer; SimulatorError where it is none (see `run`)."""
    if not isinstance(found, Measurement):
        raise SimulatorError(
            f"{simulator.name} returned {type(found).__name__}; a simulator returns a Measurement"
        )
    own = simulator.centre_frequencies
    if found.centre_frequencies.shape != own.shape or (found.centre_frequencies != own).any():
        raise SimulatorError(
            f"{simulator.name} returned bands {found.centre_frequencies.tolist()} Hz; it was asked "
            f"for {own.tolist()} Hz"
        )
    if "t20" not in found.values:
        raise SimulatorError(f"{simulator.name} returned no t20, only {', '.join(found.values)}")
    if (lost := np.isnan(found.values["t20"])).any():
        pair, band = (int(i) for i in np.argwhere(lost)[0])
        error = SimulatorError(
            f"{simulator.name} returned NaN for t20[{' to '.join(found.pairs[pair])}, "
            f"{bands.label(own[band])}]; a mean over the other pairs would hide it"
        )
        raise of_bands(error, np.flatnonzero(lost.any(axis=0)))
    return found
