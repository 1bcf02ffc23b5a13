"""Calibrate a simulator: calibrate an equation, and move its target until the simulator agrees.

`calibrate_simulator` runs the loop of `rtcal.loop.state` with a simulator that Python can call. For a
program that is run by hand, use `start`, `Loop.next_alpha` and `Loop.record`, or ``rtcal loop``.

Each step by hand leaves two files: the state of the loop, and the room to simulate. The room states
the digest of its coefficients, so that a table simulated with other coefficients is refused.
"""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics.band_conversion import measurement_in_room_bands, notes
from rtcal.acoustics.bands import label, labels
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.marks import TrustMark, explained, gap_jnd, rms
from rtcal.acoustics.measurement import MAX_BYTES, Measurement
from rtcal.acoustics.observables import TARGET, observable, parameter_label
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import in_words
from rtcal.calibration.measured import times_in_room
from rtcal.calibration.result import CalibrationResult
from rtcal.files.disk import json_numbers, read_text, write_all
from rtcal.files.saved import Result
from rtcal.loop.matched import SHOWN, Gaps, ParameterGap, Weights, left, sentences
from rtcal.loop.measured_pairs import Pair, left_out, refuse_unknown
from rtcal.loop.rules import Rule
from rtcal.loop.state import LEFT_ALONE, Loop, start
from rtcal.modes.result import ModesResult
from rtcal.simulators.base import Simulator, at_places, check_fits, lost_paths, run
from rtcal.support import blocks, checks, text
from rtcal.support.blocks import Block, Note, Table
from rtcal.support.errors import (
    DataError,
    OtherBandsWarning,
    RtcalError,
    SimulatorError,
)
from rtcal.support.text import as_sentence
from rtcal.support.types import Array

_STRONGEST_SHADE = 5.0  # JND


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LoopResult(Result):
    """A calibrated simulator.

    Attributes
    ----------
    room : Room
        The room with the coefficients for the simulator, and a record of the calibration.
    simulator : str
        Name of the simulator. The coefficients belong to no other.
    loop : Loop
        All steps, and the `status` and `gap` of each band.
    simulations : int
        Number of all calls of the simulator.
    before : Measurement
        Simulated with the stated coefficients. If some band has no T20 with them, or fewer than three
        simulations were allowed, with those of the equation's calibration.
    after : Measurement
        Simulated with the coefficients returned. What is matched was fitted, by default T20.
    confirmation : Measurement or None
        Simulated with the coefficients returned and another seed. None for a deterministic
        simulator, and if no band converged.
    measured : Measurement or None
        What was measured, in the room's bands, also what was not fitted.
    notes : tuple of str
        What is to be known of the simulations, such as paths that left through gaps of the mesh.
    """

    record_kind: ClassVar[str] = "loop result 1"

    room: Room
    simulator: str
    loop: Loop
    simulations: int
    before: Measurement
    after: Measurement
    confirmation: Measurement | None
    measured: Measurement | None = None
    notes: tuple[str, ...] = ()

    @property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return self.room.alpha

    @property
    def final(self) -> Measurement:
        """The simulation that judges the result: `confirmation` if there is one, else `after`."""
        return self.confirmation or self.after

    @property
    def status(self) -> tuple[str, ...]:
        """Status of each band: one of `rtcal.loop.state.STATUSES`."""
        return self.loop.confirmed(self.final)

    @property
    def gap(self) -> Array:
        """Gap of what is matched, of `final`, in JND, (n_bands,), NaN without a measured T."""
        return self.loop.matched.gap(self.final)

    @property
    def compromise(self) -> dict[str, ParameterGap]:
        """Each matched parameter's share, its gaps before and after, and what it lost, in JND."""
        return self.loop.matched.compromise(self.before.mean, self.final.mean)

    def gaps(self, parameter: str) -> tuple[Array, Array]:
        """Return simulated less measured before and after in JND, each (n_bands,).

        Of the means over pairs; NaN where the parameter was not measured or not simulated.
        """
        observable(parameter)
        if self.measured is None:
            return np.full(self.loop.wanted.shape, np.nan), np.full(self.loop.wanted.shape, np.nan)
        wanted = self.measured.mean(parameter)
        return (
            gap_jnd(self.before.mean(parameter), wanted, parameter),
            gap_jnd(self.final.mean(parameter), wanted, parameter),
        )

    @property
    def farther(self) -> tuple[str, ...]:
        """Parameters that are not fitted and whose gap grew by more than one JND, in some band.

        The mean T20 is fitted; what it costs in EDT, C50 and C80 stands here; `compromise` has that
        of what is matched.
        """
        return left(self.gaps_beside)

    @property
    def of_uncertain_room(self) -> CalibrationResult | None:
        """The calibration to the same targets with volume, areas and climate uncertain.

        None for an exact room. See `Loop.of_uncertain_room`.
        """
        return self.loop.of_uncertain_room

    @property
    def gaps_beside(self) -> Gaps:
        """`gaps` of each parameter that is shown and was not matched."""
        return {p: self.gaps(p) for p in SHOWN if p not in self.loop.matched.shares}

    @property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Reasons to doubt the coefficients of a band; see `Loop.trust_marks`."""
        return self.loop.trust_marks

    def __repr__(self) -> str:
        return f"<{self._description}>"

    @property
    def _description(self) -> str:
        measured = int(np.isfinite(self.loop.wanted).sum())
        converged = self.status.count("converged")
        return (
            f'LoopResult of "{text.shortened(self.simulator)}": {self.simulations} '
            f"simulation{'s' * (self.simulations != 1)}, {converged} of {measured} bands converged"
        )

    def ends(self) -> dict[str, Any]:
        """Return the parameters before and after, means by parameter and band, as plain values."""
        return {
            "simulator": self.simulator,
            "confirmed": self.confirmation is not None,
            "status": list(self.status),
            **{
                name: {} if of is None else {p: json_numbers(of.mean(p)) for p in of.values}
                for name, of in (
                    ("measured", self.measured),
                    ("before", self.before),
                    ("after", self.final),
                )
            },
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the loop and the parameters before and after as plain values."""
        return {**self.loop.to_dict(), "result": self.ends()}

    def __str__(self) -> str:
        return "\n".join(blocks.lines(self.blocks()))

    def _repr_html_(self) -> str:
        """Return the tables with shaded gaps: orange for a T that is too long, blue for too short."""
        return blocks.notebook(self._description, self.blocks()[1:])

    def blocks(self) -> list[Block]:
        """Return what the result says."""
        shades = np.nan_to_num(self.gap) / _STRONGEST_SHADE
        outcome = {
            "T wanted / s": text.numbers(self.loop.wanted, ".3f"),
            "simulated / s": text.numbers(self.loop.matched.combined(self.final.mean), ".3f"),
            "gap / JND": text.numbers(self.gap, "+.2f"),
            "z": text.numbers(self.loop.outcome.plausibility.z, "+.1f"),
            "status": self.status,
        }
        compromise: dict[str, Sequence[str]] = {}  # of what is matched together
        for parameter, part in self.compromise.items() if len(self.compromise) > 1 else ():
            name = parameter_label(parameter)
            compromise[f"{name} gap / JND before"] = text.numbers(part.before, "+.1f")
            compromise[f"{name} gap / JND after"] = text.numbers(part.after, "+.1f")
            compromise[f"{name} lost / JND"] = text.numbers(part.lost, ".1f")
        beside: dict[str, Sequence[str]] = {}  # EDT, C50 and C80
        for parameter in (p for p in SHOWN if p != TARGET.key and p in self.before.values):
            name = f"{parameter_label(parameter)} / {observable(parameter).unit}"
            measured = self.measured and self.measured.values
            for when, of in (
                ("measured", self.measured if measured and parameter in measured else None),
                ("before", self.before),
                ("after", self.final),
            ):
                if of is not None:
                    beside[f"{name} {when}"] = text.numbers(of.mean(parameter), ".2f")
        by_band = labels(self.room.centre_frequencies)
        return [
            Note(f"Coefficients only for {self.simulator}; {self.simulations} simulations"),
            *(
                Table.of_columns(by_band, columns, {"gap / JND": shades})
                for columns in (outcome, compromise, beside)
                if columns
            ),
            *(Note(n, hanging="       " if n.startswith(" ") else "    ") for n in self._notes()),
        ]

    def _notes(self) -> list[str]:
        notes = explained(self.trust_marks)
        if "not confirmed" in self.status:
            notes.insert(
                0,
                "Not confirmed: with another seed the gap exceeds tolerance plus noise, or the noise "
                "exceeds the tolerance. Simulate with less noise (more paths).",
            )
        notes[:0] = sentences(self.gaps_beside, self.room.centre_frequencies)
        if self.loop.room.is_uncertain:
            notes.append(
                f"The room is uncertain ({in_words(self.loop.room)}). These coefficients serve the "
                "simulator in the room as stated, and carry the room's error, too. Those of the "
                "materials are in result.of_uncertain_room."
            )
        if self.loop.low is not None:
            notes.append(self.loop.low.note)
        return [*notes, *self.notes]


def calibrate_simulator(
    simulator: Simulator,
    room: Room | ModesResult,
    measured: Measurement,
    rule: Rule = "safeguarded",
    *,
    exclude: Sequence[tuple[str, str]] = (),
    weights: Weights | None = None,
    method: str = "mle",
    equation: LinearEquation | None = None,
    decimals: int | None = None,
    tolerance: float = 1.0,
    max_simulations: int = 12,
    seed: int = 0,
    after_step: Callable[[Loop], None] | None = None,
) -> LoopResult:
    """Calibrate a room's coefficients so that a simulator has the measured mean T20.

    The stated coefficients are simulated first, so that no band ends farther away than it began.
    `calibrate_positions` matches the values at every position.

    Parameters
    ----------
    simulator : Simulator
    room : Room or ModesResult
        Its alpha and sigma are the prior. A result of ``calibrate_modes(room, ...)`` without T stands
        in place of T below the Schroeder frequency: coefficients stay there as it left them. In large
        rooms with hard walls, sigma should be
        proportional to alpha: equal sigmas drive large hard walls to alpha = 0.
    measured : Measurement
    rule : {"secant", "safeguarded"}
        See `rtcal.loop.rules`.
    exclude : sequence of (source, receiver)
        Measured pairs that are left out, of what is simulated, too.
    weights : mapping of "t20" and "edt" to a number or one per band, optional
        A compromise of the mean T20 and the mean EDT: each band's target is moved until their weighted
        geometric mean is the measured one. ``result.compromise`` states what each lost. By default
        T20 alone is matched.
    method, equation
        Of the equation's calibration; see `rtcal.calibrate`.
    decimals : int, optional
        Decimals of alpha that the program reads.
    tolerance : float
        In JND. A band is done if its gap is within the tolerance less the simulator's noise. It is
        confirmed if its gap with another seed is within the tolerance plus the noise.
    max_simulations : int
        Limit of all calls of the simulator, at least 2 for a simulator with random numbers. One
        call is kept for the coefficients returned: for the confirmation with another seed, or for
        bands whose best steps differ.
    seed : int
        Seed of all steps, so that they differ by alpha only. The confirmation uses ``seed + 1``.
    after_step : callable, optional
        Called with the loop after every step, for example to `Loop.save` it.

    Returns
    -------
    LoopResult
        Its ``status`` says for each band whether it converged and was confirmed.

    Raises
    ------
    SimulatorError, TooShortError
        From the simulator. The error's ``loop`` is the `Loop` with all steps so far. A band that
        has a T20 for some coefficients only does not raise, but ends as unreachable.
    DataError
        If simulator and room differ in materials or bands, or an argument breaks its rule.

    References
    ----------
    Bellows & Katz 2025, Sects. 4.2 and 4.3, Eqs. 38 to 40.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> program = rt.simulators.External(
    ...     room=room, name="reverb 3000",
    ...     run=lambda alpha, seed: 1.2 * rt.Eyring().time(room, room.areas @ alpha))
    >>> rt.calibrate_simulator(program, room, measured)
    <LoopResult of "reverb 3000": 2 simulations, 6 of 6 bands converged>
    """
    modes = room if isinstance(room, ModesResult) else None
    room = room.prior if isinstance(room, ModesResult) else room
    check_fits(simulator, room)
    exclude = checks.pairs("exclude", exclude)
    checks.whole("seed", seed, 0)
    measured, repeated = at_places(simulator, measured)
    if exclude:
        refuse_unknown(exclude, measured)
        measured = _without(measured, exclude)
        repeated = (*repeated, left_out(exclude))
    # The result's notes and marks say it.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OtherBandsWarning)
        loop = start(
            room,
            measured,
            modes=modes,
            rule=rule,
            method=method,
            equation=equation,
            decimals=decimals,
            tolerance=tolerance,
            weights=weights,
        )
    result = _run(simulator, loop, max_simulations, seed, after_step, exclude)
    of_bands = notes(measured.centre_frequencies, room.centre_frequencies)
    notes_of_data = [*map(as_sentence, of_bands)]
    parameters = times_in_room(room, measured).parameter
    named = zip(room.centre_frequencies, parameters, strict=True)
    if in_place := [label(f) for f, p in named if p not in ("", TARGET.key)]:
        where = f" at {', '.join(in_place)}" if TARGET.key in parameters else ""
        notes_of_data.append(f"T30 is matched{where} in place of T20, which was not measured.")
    return replace(
        result,
        measured=measurement_in_room_bands(measured, room.centre_frequencies),
        notes=(*repeated, *notes_of_data, *result.notes),
    )


def _run(
    simulator: Simulator,
    loop: Loop,
    max_simulations: int,
    seed: int,
    after_step: Callable[[Loop], None] | None,
    exclude: Sequence[Pair],
) -> LoopResult:
    """Simulate and step until the loop is finished or no call is left; see `calibrate_simulator`."""
    if after_step is not None and not callable(after_step):
        raise DataError(f"after_step = {after_step!r} cannot be called")
    checks.whole("max_simulations", max_simulations, 1 if simulator.deterministic else 2)
    calls = _Calls(simulator, max(max_simulations - 1, 1), exclude)
    try:
        if calls.left > 1:
            loop = _with_stated(calls, loop, seed)
            if loop.steps and after_step is not None:
                after_step(loop)
        while not loop.finished and calls.left:
            step = _simulate_step(calls, loop, seed)
            if step is None:
                break
            loop = loop.record(*step)
            if after_step is not None:
                after_step(loop)
        calls.limit = max_simulations
        return _result(calls, loop, seed)
    except RtcalError as error:
        error.loop = loop
        raise


def _without(measurement: Measurement, exclude: Sequence[Pair]) -> Measurement:
    """Return a measurement without some pairs, so that means are over the same ones."""
    kept = [pair for pair in measurement.pairs if pair not in exclude]
    if not kept:
        raise DataError("exclude has every pair: none is left")
    return measurement if len(kept) == len(measurement.pairs) else measurement.select(kept)


@dataclass
class _Calls:
    """The calls of a simulator, with their coefficients and measurements, and their limit."""

    simulator: Simulator
    limit: int
    exclude: Sequence[Pair]
    number: int = 0
    answers: list[tuple[Array, int, Measurement]] = field(default_factory=list)

    @property
    def left(self) -> int:
        return self.limit - self.number

    def simulate(self, alpha: Array, seed: int) -> Measurement:
        self.number += 1
        measurement = _without(run(self.simulator, alpha, seed=seed), self.exclude)
        self.answers.append((alpha, seed, measurement))
        return measurement


def _with_stated(calls: _Calls, loop: Loop, seed: int) -> Loop:
    """Return the loop after a simulation of the stated coefficients, so that none ends farther away.

    Coefficients that some band has no T20 for are no start: the equation's are simulated first.
    """
    alpha = loop.prior_alpha()
    try:
        return loop.record(alpha, calls.simulate(alpha, seed), stated=True)
    except RtcalError as error:
        if not error.bands and not isinstance(error, DataError):
            raise
        return loop


def _simulate_step(
    calls: _Calls, loop: Loop, seed: int
) -> tuple[Array, Measurement, tuple[int, ...]] | None:
    """Simulate the next coefficients: return them, the measurement, and the bands without a T20.

    If some bands have no T20, they are simulated again with coefficients that gave one, before the
    first step with the prior; None if no call is left for that. An error in every band is raised,
    and so is NaN in the first step.
    """
    alpha = loop.next_alpha
    try:
        return alpha, calls.simulate(alpha, seed), ()
    except RtcalError as error:
        nan_at_first = isinstance(error, SimulatorError) and not loop.steps
        if not error.bands or nan_at_first or 1 < len(alpha[0]) == len(error.bands):
            raise
        if not calls.left and not loop.steps:
            raise
        without_t20 = error.bands
    if not calls.left:
        return None
    with_t20 = alpha.copy()
    for k in without_t20:
        steps = [step for step in loop.steps if np.isfinite(step.simulated[k])]
        with_t20[:, k] = steps[-1].alpha[:, k] if steps else loop.prior_alpha()[:, k]
    return alpha, calls.simulate(with_t20, seed), without_t20


def _result(calls: _Calls, loop: Loop, seed: int) -> LoopResult:
    """Return the result: the coefficients of each band's best step, simulated together.

    If bands differ in their best step, their coefficients were never simulated together. Where bands
    depend on each other and are farther together than a step was, those of that step are returned.
    """
    simulator, alpha = calls.simulator, loop.best_alpha
    confirmation = None
    if not simulator.deterministic and "converged" in loop.status:
        confirmation = calls.simulate(alpha, seed + 1)
    simulated = [m for a, s, m in calls.answers if s == seed and np.array_equal(a, alpha)]
    after = simulated[-1] if simulated else confirmation or calls.simulate(alpha, seed)
    if simulator.deterministic:
        nearest = rms(loop.matched.gap(after)) - _AS_NEAR
        for tried, _, measurement in calls.answers:
            if (gap := rms(loop.matched.gap(measurement))) < nearest:
                nearest, alpha, after = gap, tried, measurement
    calibrated = loop.outcome.room
    record = calibrated.calibration and replace(
        calibrated.calibration,
        measured=loop.measured,
        equation=f"{calibrated.calibration.equation}, in the loop with {simulator.name}",
    )
    return LoopResult(
        room=calibrated.replace(alpha=alpha, calibration=record),
        simulator=simulator.name,
        loop=loop,
        simulations=calls.number,
        before=calls.answers[0][2],  # the stated coefficients, where they have a T20
        after=after,
        confirmation=confirmation,
        notes=lost_paths(simulator),
    )


_AS_NEAR = 1e-6
"""JND by which gaps differ that are the same."""
_COEFFICIENTS = re.compile(r"^#\s*Coefficients ([0-9a-f]{12})\b", re.M)


def refuse_progress(state: str) -> None:
    """Raise DataError if the state at this path already holds simulations."""
    if Path(state).exists() and (n := len(Loop.load(state).steps)):
        raise DataError(
            f"{state} holds {n} simulation{'s' * (n > 1)} of a loop: delete it to begin anew, or name "
            "another state"
        )


def record(loop: Loop, table: str, state: str, out: str, *, again: bool = False) -> Loop:
    """Return the loop after the simulation that the file ``table`` holds.

    Parameters
    ----------
    loop : Loop
        As read from the file ``state``.
    table, state, out : str
        Paths of the simulated table, the state and the room that was to be simulated.
    again : bool
        Whether to accept a table with the same T20 as the last step's, or at first as the measured T.

    Raises
    ------
    DataError
        If the loop is finished, the table is no measurement, or it repeats the last step's or has the
        measured T itself. Also if the table belongs to other coefficients, as far as the files show.
    """
    if loop.finished:
        raise DataError(
            f"{state}: the loop is done, so {table} was not taken in; the room that `rtcal loop "
            "next` wrote last has the coefficients, and `rtcal report` shows the path"
        )
    simulated = Measurement.from_file(table)
    alpha = loop.next_alpha
    # Two files may show that a table belongs to other coefficients: it may repeat the room's line
    # "# Coefficients ...", and the room at ``out`` holds the coefficients themselves.
    asked = _digest(alpha)
    stated = _COEFFICIENTS.search(read_text(table, MAX_BYTES))
    if stated is not None and stated[1] != asked:
        raise DataError(f"{table}: it is of the coefficients {stated[1]}; {state} asks for {asked}")
    written = None
    with suppress(DataError):  # another name than last time, or no room: it shows nothing
        written = Room.from_file(out)
    if written is not None and _digest(written.alpha) != asked:
        raise DataError(
            f"{out}: it has other coefficients than {state} asks for, so {table} may be of those: "
            f"rtcal loop back writes what to simulate; or delete {out} if it was not simulated"
        )
    if not again and not loop.steps and loop.matched.gives(simulated, loop.wanted):
        raise DataError(
            f"{table}: every T20 is the measured one to the last digit: is it the measurement itself, "
            "and not what was simulated? (--again takes it all the same)"
        )
    if not again and loop.repeats(alpha, simulated):
        raise DataError(
            f"{table}: the table is the last step's, though alpha changed: was the room that was "
            "written last simulated? (--again takes it all the same)"
        )
    try:
        return loop.record(alpha, simulated)
    except DataError as error:
        raise DataError(f"{table}: {error}") from error


def write(loop: Loop, state: str, out: str) -> None:
    """Write the state and the room to simulate: both files or none.

    A state without its room would accept a table that belongs to the room of the step before.
    """
    room = loop.room.replace(alpha=loop.next_alpha, calibration=None)
    digest = _digest(room.alpha)
    n, of = len(loop.steps), f"of the loop in {Path(state).name!r}"
    note = f"# To simulate: run {n + 1} {of}.\n"
    if n and loop.finished:
        note = f"# Calibrated for the program simulated: the end {of}, after {n} runs.\n"
    note += f"# Coefficients {digest}.\n"
    content = note + room.to_text(Path(out).parent)
    write_all({out: content.encode(), state: loop.to_json(Path(state).parent).encode()})


def conclusion(loop: Loop, out: str) -> str:
    """Return what a user does with the last room written, for a finished loop."""
    left = len([s for s in loop.status if s not in LEFT_ALONE])
    missed = f", but {left} of {loop.room.n_bands} bands were not reached" if left else ""
    return (
        f"Done{missed}. {out} has the coefficients, those of each band's best step: give it to the "
        "program a last time."
    )


def _digest(alpha: Array) -> str:
    """Return a short identifier of coefficients, (n_materials, n_bands), to nine decimals."""
    rounded = np.round(alpha, 9) + 0.0  # no -0
    return hashlib.sha256(repr(rounded.shape).encode() + rounded.tobytes()).hexdigest()[:12]
