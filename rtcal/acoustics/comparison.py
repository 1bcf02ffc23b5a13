"""Where a simulation and a measurement disagree: by parameter, band and pair.

A deviation is the run's value less the measured one, in just noticeable differences (JND): of T, 5 % of
the measured T each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.marks import LARGE_Z, gap_jnd
from rtcal.acoustics.measurement import MAX_POSITIONS, Measurement, Pair
from rtcal.acoustics.observables import (
    OBSERVABLES,
    REVERBERATION,
    Observable,
    decay_curve_db,
)
from rtcal.acoustics.room import Room, is_calibrated
from rtcal.acoustics.room_errors import of_absorption, prior_covariance
from rtcal.acoustics.run import Beside, Lacking, Run
from rtcal.files.saved import Result
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

WORDS = "rtcal.report.of_comparison"
NOTICED = 1.0
"""Deviation in JND from which on run and measurement disagree, unless its uncertainty is larger."""
_BINS = 2000  # of an exponential decay over twice its T


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Comparison(Result):
    """Deviation of simulated values from the measured ones, as `rtcal.compare` returns it.

    `deviation`, `uncertainty` and `disagrees` are mappings from a parameter, such as ``"t20"``, to
    values (n_bands,) for the means over the pairs. `at_pairs` has values (n_pairs, n_bands). Deviations
    are in just noticeable differences (JND). `sentence` says what disagrees, by how much and where.

    ``run`` is the simulation, ``measured`` the measurement, and ``equation`` the reverberation equation
    with which the share of the coefficients in a deviation is calculated. ``of_equation`` is True if
    the run is T of the equation itself and no program's. ``stated`` is the room with the input
    coefficients if the run had others, else None.
    """

    record_kind: ClassVar[str] = "comparison"
    words_in: ClassVar[str] = WORDS
    in_file: ClassVar[str] = (
        "room=run.room.name centre_frequencies=run.room.centre_frequencies sentence parameters pairs "
        "deviation_jnd=deviation at_pairs_jnd=at_pairs uncertainty_jnd=uncertainty "
        "coefficients_jnd=coefficients disagrees explained lacking equation_jnd=of_the_equation"
    )

    run: Run
    """Simulation run that is compared: a program's, or T of the equation itself."""
    measured: Measurement
    equation: LinearEquation
    of_equation: bool = False
    """Whether the run is T of the equation and no program's."""
    stated: Room | None = None
    """Room with the input coefficients, if the run had others."""

    def __post_init__(self) -> None:
        _ = self.compared  # raises where nothing is in common

    @cached_property
    def compared(self) -> Beside:
        """Values that both run and measurement have, and what one of them lacks (`Run.beside`)."""
        return self.run.beside(self.measured)

    @property
    def sides(self) -> tuple[Measurement, Measurement]:
        """Simulated and measured values that are compared, in this order."""
        return self.compared.run, self.compared.measured

    @property
    def lacking(self) -> Mapping[str, Lacking]:
        """Parameters that cannot be compared, each with the side (run or measurement) that lacks it."""
        return {} if self.of_equation else self.compared.lacking

    @property
    def left_out(self) -> list[str]:
        """Sentences on the values that are not compared."""
        return [] if self.of_equation else self.compared.left_out()

    @cached_property
    def pairs(self) -> tuple[Pair, ...]:
        """Source-receiver pairs that both sides have, (n_pairs,); () where means are compared."""
        run, measured = self.sides
        return () if run.is_summary or run.pairs != measured.pairs else tuple(run.pairs)

    @cached_property
    def deviation(self) -> dict[str, Array]:
        """Deviation of the simulated from the measured mean over the pairs, in JND, by parameter.

        It is simulated - measured, (n_bands,). The parameter with the largest deviation is first.
        """
        run, measured = self.sides
        found = {p: gap_jnd(run.mean(p), measured.mean(p), p) for p in measured.values}
        return dict(sorted(found.items(), key=lambda each: -np.nanmax(np.abs(each[1]))))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the compared parameters, the one with the largest deviation first."""
        return (*self.deviation,)

    @cached_property
    def at_pairs(self) -> dict[str, Array]:
        """Deviation simulated - measured at each pair, in JND, (n_pairs, n_bands); {} without pairs."""
        run, measured = self.sides
        each = self.parameters if self.pairs else ()
        return {p: gap_jnd(run.values[p], measured.values[p], p) for p in each}

    @cached_property
    def pair_uncertainty(self) -> dict[str, Array]:
        """Standard uncertainty of the measured value at each pair in JND, by parameter.

        It is (n_pairs, n_bands). The measurement states the uncertainty; for a value without one it is
        the standard deviation between measuring teams.
        """
        found, measured = {}, self.sides[1]
        for p in self.at_pairs:
            kind, values = OBSERVABLES[p], measured.values[p]
            teams = kind.of_value(kind.between_teams(measured.centre_frequencies), values)
            common = np.nan_to_num(measured.common_uncertainty.get(p, 0.0))
            stated = np.hypot(measured.uncertainty.get(p, np.nan), common)
            found[p] = _in_jnd(np.where(np.isfinite(stated), stated, teams), values, kind)
        return found

    @cached_property
    def uncertainty(self) -> dict[str, Array]:
        """Standard uncertainty of the mean `deviation` in JND by parameter, (n_bands,).

        It is NaN where it is unknown. It combines the uncertainty of the measured mean with the
        uncertainty that the run states. If the measurement states no uncertainty and pairs are
        compared, the scatter of the deviations over the pairs replaces the scatter of the measured
        values, because the values of run and measurement vary alike from pair to pair.
        """
        run, measured = self.sides
        found = {}
        for p in self.parameters:
            kind, mean = OBSERVABLES[p], measured.mean(p)
            stated = p in measured.uncertainty or p in measured.common_uncertainty
            if self.pairs and not stated:
                own = self._of_pairs(p)
            else:
                own = _in_jnd(measured.mean_uncertainty(p), mean, kind)
            of_run = run.mean_uncertainty(p) if p in run.uncertainty else np.zeros_like(mean)
            found[p] = np.hypot(own, _in_jnd(np.nan_to_num(of_run), mean, kind))
        return found

    def _of_pairs(self, parameter: str) -> Array:
        """Return the standard error of the mean deviation over pairs in JND, at least ISO 3382-2's."""
        off, kind, measured = self.at_pairs[parameter], OBSERVABLES[parameter], self.sides[1]
        n, mean = np.isfinite(off).sum(axis=0), measured.mean(parameter)
        effective = min(
            max(len({*names}) for names in zip(*self.pairs, strict=True)), MAX_POSITIONS
        )
        with np.errstate(all="ignore"):
            centred = off - np.nansum(off, axis=0) / n
            spread = np.sqrt(np.nansum(centred**2, axis=0) / (n - 1) / effective)
        iso = kind.variance_of_mean(measured.centre_frequencies, mean, np.minimum(n, MAX_POSITIONS))
        return np.asarray(np.fmax(spread, _in_jnd(np.sqrt(iso), mean, kind)))

    @cached_property
    def _times(self) -> Array:
        """T in s of the run's coefficients by the equation, (n_bands,)."""
        return self.equation.reverberation_time(self.run.room)

    @cached_property
    def _prior(self) -> Array:
        """Standard deviation of T in JND by errors of the coefficients, (n_bands,)."""
        room, n = self.stated or self.run.room, self.run.room.n_bands
        own_covariance = prior_covariance(room).reshape(room.n_materials, n, room.n_materials, n)
        common = of_absorption(room.areas, room.alpha, room.sigma, room.centre_frequencies)
        variance = np.einsum("m,mbnb,n->b", room.areas, own_covariance, room.areas)
        area = np.sqrt(variance + np.sum(common**2, axis=0)) * (
            not any(map(is_calibrated, (self.run.room, room)))
        )  # of S'alpha
        with np.errstate(all="ignore"):
            slope = self._times * self.equation.target_sensitivity(room, self._times)
            prior = np.nan_to_num(np.abs(area / slope)) / REVERBERATION[0].jnd  # of T, in JND
        return np.asarray(prior)

    @cached_property
    def of_other_coefficients(self) -> Array:
        """Deviation of T in JND because the run had other coefficients than the input, (n_bands,).

        The equation gives it. It is 0 where the run had the input coefficients or calibrated ones.
        """
        if self.stated is None or is_calibrated(self.run.room):
            return np.zeros(self.run.room.n_bands)
        off = gap_jnd(
            self._times, self.equation.reverberation_time(self.stated), REVERBERATION[0].key
        )
        return np.nan_to_num(off)

    @property
    def had_other_coefficients(self) -> NDArray[np.bool_]:
        """Whether other coefficients than the input's changed T by more than one JND, (n_bands,)."""
        return np.asarray(np.abs(self.of_other_coefficients) > NOTICED)

    @cached_property
    def _per_jnd_of_time(self) -> dict[str, Array]:
        """Change of each parameter in JND with one JND of T in an exponential decay, (n_bands,)."""
        found = {}
        for p in self.parameters:
            kind, values = OBSERVABLES[p], self.sides[1].mean(p)
            by_log_time = np.array([_by_log_time(kind, t) for t in self._times])
            off = _in_jnd(kind.of_value(by_log_time, values), values, kind)
            found[p] = off * REVERBERATION[0].jnd
        return found

    @cached_property
    def coefficients(self) -> dict[str, Array]:
        """Deviation that errors of the coefficients can cause, in JND: mean and standard deviation.

        They are an array (2, n_bands) by parameter. The errors are the sigma of the input coefficients
        and errors that all coefficients have in common (`rtcal.acoustics.room_errors`); the equation
        gives the change of T that they cause. The mean is `of_other_coefficients` for T20, or for T30
        if T20 is not compared.
        Other parameters change with T as in an exponential decay, so that the deviation of T gives
        their mean. Both are 0 for a calibrated room, whose coefficients were chosen for T.
        """
        prior, n, other = self._prior, self.run.room.n_bands, self.of_other_coefficients
        mean, left, own = other, prior, [""] * n
        for o in reversed(REVERBERATION):
            if o.key in self.deviation:
                off, u = self.deviation[o.key], self.known(o.key)
                with np.errstate(all="ignore"):
                    share = np.nan_to_num(prior**2 / (prior**2 + u**2))
                known = np.isfinite(off)
                mean = np.where(known, other + share * (off - other), mean)
                left = np.where(known, np.sqrt(1 - share) * prior, left)
                own = [o.key if k else key for k, key in zip(known, own, strict=True)]
        found = {}
        for p in self.parameters:
            per_jnd = self._per_jnd_of_time[p]
            first = np.array([key in ("", p) for key in own])
            ends = np.where(first, [other, prior], [mean, left])
            found[p] = np.nan_to_num(np.array([per_jnd, np.abs(per_jnd)]) * ends)
        return found

    @cached_property
    def disagrees(self) -> dict[str, NDArray[np.bool_]]:
        """Whether a `deviation` exceeds one JND and twice its uncertainty, (n_bands,) of bool."""
        return {
            p: np.abs(d) > np.fmax(NOTICED, LARGE_Z * self.uncertainty[p])
            for p, d in self.deviation.items()
        }

    @cached_property
    def explained(self) -> dict[str, NDArray[np.bool_]]:
        """Whether errors of the coefficients explain a disagreement, (n_bands,) of bool by parameter.

        They explain it if two deviations are within one JND or twice their standard uncertainty: the
        one from the input coefficients, by their errors, and what is left of it beside the mean that
        `coefficients` gives.
        """
        found = {}
        for p, where in self.disagrees.items():
            off, (mean, left) = self.deviation[p], self.coefficients[p]
            per_jnd = np.nan_to_num(self._per_jnd_of_time[p])
            whole, other = self._prior * per_jnd, self.of_other_coefficients * per_jnd
            within = [
                np.abs(each) <= np.fmax(NOTICED, LARGE_Z * np.hypot(self.known(p), deviation))
                for each, deviation in ((off - other, whole), (off - mean, left))
            ]
            found[p] = where & np.all(within, axis=0) & (self.coefficients[p] != 0).any(axis=0)
        return found

    def known(self, parameter: str) -> Array:
        """Return the `uncertainty` of a parameter's mean deviation in JND, (n_bands,); 0 if unknown."""
        return np.nan_to_num(self.uncertainty[parameter])

    @cached_property
    def of_the_equation(self) -> Array:
        """Deviation T of the equation - T of the run, in JND, (n_bands,); NaN without T of the run."""
        run = self.run.simulated
        return gap_jnd(self._times, run.reverberation_time, REVERBERATION[0].key)

    @property
    def sentence(self) -> str:
        """Sentence on what disagrees, by how much and in which bands."""
        words: str = import_module(WORDS).sentence(self)
        return words

    def __repr__(self) -> str:
        """Return one line: the answer."""
        return f"<Comparison: {self.sentence}>"


def _in_jnd(uncertainty: Array, values: Array, kind: Observable) -> Array:
    """Return an uncertainty of values in JND."""
    with np.errstate(all="ignore"):
        return np.asarray(uncertainty / kind.jnd_of(values))


def _by_log_time(kind: Observable, time: float) -> float:
    """Return d observed / d ln T of the exponential decay of T in s."""
    if not 0 < time < np.inf:
        return 0.0
    width = 2 * time / _BINS
    nepers = 6 * np.log(10) / time * width * (np.arange(_BINS) + 0.5)
    energy = np.exp(-nepers)
    return float(kind.gradient(energy, decay_curve_db(energy), width) @ (energy * nepers))


def compare(
    room: Room,
    measured: Measurement,
    run: Run | None = None,
    *,
    equation: LinearEquation | None = None,
) -> Comparison:
    """Compare a simulation program's values with the measurement, by parameter, band and pair.

    Parameters
    ----------
    room : Room
        Room that was measured.
    measured : Measurement
        Measured room-acoustic parameters.
    run : Run, optional
        Results of the program for ``room``, with any coefficients. By default T of the equation is
        compared.
    equation : LinearEquation, optional
        Reverberation equation, Eyring's by default. It also gives the change of T that errors of the
        coefficients can cause.

    Returns
    -------
    Comparison
        Comparison, which prints a sentence on where run and measurement disagree, and a table.

    Raises
    ------
    DataError
        If the run is of another room, or run and measurement have no parameter and band in common.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> run = rt.Run(room, rt.Measurement.from_values(
    ...     room.centre_frequencies, t30=1.2 * measured.reverberation_time))
    >>> rt.compare(room, measured, run)
    <Comparison: The program's T30 is 20 % too long in all bands.>
    """
    equation, by_equation, stated = equation or Eyring(), run is None, None
    checks.instance("measured", measured, Measurement).refuse_other_units()
    if run is None:
        times = equation.reverberation_time(checks.instance("room", room, Room))
        if not np.isfinite(times).any():
            raise DataError(
                f"{equation.name}'s equation gives an infinite T in every band, because "
                "all coefficients are 0 and the room has no air: give coefficients above "
                "0"
            )
        each = {o.key: np.where(np.isfinite(times), times, np.nan) for o in REVERBERATION}
        run = Run(room, Measurement.from_values(room.centre_frequencies, **each))
    else:
        checks.instance("run", run, Run).refuse_other(room)
        stated = None if np.array_equal(run.room.alpha, room.alpha) else room
    return Comparison(
        run=run, measured=measured, equation=equation, of_equation=by_equation, stated=stated
    )
