"""A Python function as a simulator. `rtcal.simulators.program` has a function that runs a program."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.bands import label
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET
from rtcal.acoustics.room import Room
from rtcal.simulators.base import RoomSimulator, check_alpha
from rtcal.support import checks
from rtcal.support.errors import DataError, SimulatorError, of_bands
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class External(RoomSimulator):
    """Calls a function that simulates, for example by running another program.

    Parameters
    ----------
    room : Room
        Alpha has its materials and bands.
    run : callable
        ``run(alpha, seed)`` returns a `Measurement` in the room's bands, or T20 in s, (n_bands,).
        Alpha, (n_materials, n_bands), is a read-only copy.
    name : str
        Calibrated coefficients belong to the program of this name.
    deterministic : bool
        Whether the result does not depend on the seed.
    time_limit : float, optional
        Limit in s; a longer call raises `SimulatorError`. Python cannot end the function, which
        continues in a thread. The limit of a `command` ends its program.

    Raises
    ------
    DataError
        For an argument of another type, an empty name, or a limit that is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> room = Room(name="box", volume=120, materials=["all"], areas=[158], alpha=[[0.2]],
    ...             sigma=[[0.1]], centre_frequencies=[1000])
    >>> program = External(room=room, run=lambda alpha, seed: 0.11 / alpha[0], name="reverb 3000")
    >>> print(program.simulate(room.alpha).values["t20"])
    [[0.55]]
    """

    room: Room
    run: Callable[[Array, int], Measurement | Array | Sequence[float]]
    name: str
    deterministic: bool = True
    time_limit: float | None = None

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        if not callable(self.run):
            raise DataError(f"run = {self.run!r} cannot be called")
        if not text_name("name", self.name).strip():
            raise DataError('name = "" is empty: coefficients belong to the program of this name')
        checks.flag("deterministic", self.deterministic)
        if self.time_limit is not None:
            checks.positive("time_limit", self.time_limit, "s")

    @property
    def smooth(self) -> bool:
        """Whether T counts as a smooth function of alpha: that of a deterministic function does."""
        return self.deterministic

    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return the function's result for alpha (n_materials, n_bands) as a measurement.

        Raises
        ------
        DataError
            For an alpha that is not (n_materials, n_bands) or not in [0, 1], or a negative seed.
        SimulatorError
            If the function exceeds the time limit, calls ``sys.exit``, or returns anything but a
            `Measurement` or n_bands finite times above 0. Its other exceptions pass unchanged.
        """
        alpha, seed = check_alpha(self, alpha), checks.whole("seed", seed, 0)
        try:
            answer = self._within_time_limit(lambda: self.run(alpha, seed))
        except SystemExit as error:
            raise SimulatorError(f"{self.name} called sys.exit({error.code!r})") from error
        if isinstance(answer, Measurement):
            return answer
        return Measurement.from_values(self.centre_frequencies, **{TARGET.key: self._times(answer)})

    def _times(self, answer: object) -> Array:
        """Return the answer as T20 in s, (n_bands,); SimulatorError if it is anything else."""
        try:
            values = np.asanyarray(answer)
        except (TypeError, ValueError):
            values = np.array(None)
        if values.dtype.kind not in "iuf":
            raise SimulatorError(
                f"{self.name} returned {type(answer).__name__} of {values.dtype}, neither a "
                "Measurement nor times in s"
            )
        times = checks.array(f"{self.name} returned T20, which", values, SimulatorError)
        if times.shape != (self.room.n_bands,):
            raise SimulatorError(
                f"{self.name} returned T20 of shape {times.shape}; the room's bands ask for "
                f"({self.room.n_bands},)"
            )
        if not (valid := np.isfinite(times) & (times > 0)).all():
            error = SimulatorError(
                f"{self.name} returned T20 = {times.tolist()} s; each must be a finite time above 0"
            )
            raise of_bands(error, np.flatnonzero(~valid))
        for frequency, time in zip(self.centre_frequencies, times, strict=True):
            try:
                TARGET.refuse(f"{TARGET.label}[{label(frequency)}]", float(time))
            except DataError as error:
                raise SimulatorError(f"{self.name} returned {error}") from error
        return times

    def _within_time_limit(self, call: Callable[[], object]) -> object:
        if self.time_limit is None:
            return call()
        answers: list[object] = []
        errors: list[BaseException] = []

        def work() -> None:
            try:
                answers.append(call())
            except BaseException as error:  # raised again in the caller's thread
                errors.append(error)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        thread.join(self.time_limit)
        if errors:
            raise errors[0]
        if not answers:
            raise SimulatorError(f"{self.name} ran for longer than {self.time_limit:g} s")
        return answers[0]
