"""The result of a calibration: the room, its certificate and its plausibility."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics import room_errors
from rtcal.acoustics.changed_time import (
    KnownRoom,
    MeasuredState,
    correlation_of,
    normal_quantiles,
)
from rtcal.acoustics.changes import Change
from rtcal.acoustics.directions import facing
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.marks import (
    Plausibility,
    TrustMark,
    gap_jnd,
    in_room,
    plausibility,
    trust_marks,
    uneven_marks,
)
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.acoustics.room_errors import Assumptions, of_absorption
from rtcal.calibration import table
from rtcal.calibration.feasibility import Unreachable, where_valid
from rtcal.calibration.measured import MeasuredTimes, data_history
from rtcal.calibration.posterior import Densities, Draws, correlations, draws, intervals
from rtcal.calibration.qp import Active, Certificate, Iterate
from rtcal.calibration.solution import JointSolution
from rtcal.calibration.table import blocks_of
from rtcal.calibration.verdict import CalibrationVerdict, verdict
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.prediction.predicted import Prediction, predict
from rtcal.support import __version__, blocks, checks
from rtcal.support.errors import DataError, ModelError
from rtcal.support.text import shortened
from rtcal.support.types import Array, read_only_view

_SAME_TIME = 1e-6
"""Relative difference of T below which the calibrated T is the measured one."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointResult(JointSolution, Result):
    """One calibration of several configurations of a room: shared alpha, one T per configuration."""

    record_kind: ClassVar[str] = "joint 1"

    @cached_property
    def results(self) -> tuple[CalibrationResult, ...]:
        """The result of each configuration."""
        return tuple(
            CalibrationResult(joint=self, configuration=c)
            for c in range(len(self.configurations.rooms))
        )

    def known_room(self, configuration: int) -> KnownRoom:
        """Return what is known of a configuration before it is changed, for `rtcal.prediction`.

        Raises DataError for a configuration that there is not, and ModelError if the calibration has
        further unknowns or observations, which a prediction does not know of, or if its equation gives
        no T for the calibrated room.
        """
        last = len(self.configurations.rooms) - 1
        if checks.whole("configuration", configuration, 0) > last:
            raise DataError(
                f"configuration = {checks.shown(configuration)} is not from 0 to {last}"
            )
        if configuration not in self._known_rooms:
            self._known_rooms[configuration] = self._known_room(configuration)
        return self._known_rooms[configuration]

    @cached_property
    def _known_rooms(self) -> dict[int, KnownRoom]:
        """One of each configuration: what is drawn of it is kept by its identity."""
        return {}

    def _known_room(self, configuration: int) -> KnownRoom:
        if self.effects or self.composition.observations:
            raise ModelError(
                "a prediction knows of T alone: calibrate without effects and other observations, such "
                "as the corrected room of `rtcal apply`"
            )
        rooms = self.configurations.rooms
        room = rooms[configuration]
        rows = [self.materials.index(m) for m in room.materials]
        time = where_valid(self.equation.time, room, room.areas @ self.alpha[rows])
        if not np.isfinite(time).all():
            raise ModelError(f"{self.equation.name}'s equation gives no T for the calibrated room")
        states = [
            MeasuredState(name, other, m.reverberation_time, m.uncertainty / m.reverberation_time)
            for name, other, m in zip(
                self.configurations.names, rooms, self.measured_times, strict=True
            )
        ]
        own = states.pop(configuration)
        with np.errstate(invalid="ignore"):
            same = np.abs(time / own.time - 1) < _SAME_TIME
        measured = np.isfinite(own.time) & self.asks_for_measured_time
        quantiles, correlation = self._distribution
        return KnownRoom(
            room=room,
            equation=self.equation,
            materials=self.materials,
            alpha=self.alpha,
            quantiles=quantiles,
            correlation=correlation,
            time=time,
            measured=measured,
            exact=bool(same[measured].all()),
            log_uncertainty=own.log_uncertainty,
            others=tuple(states),
        )

    @cached_property
    def _separate(self) -> tuple[Densities, list[Draws]] | None:
        """The density and its draws where each band stands for itself; None else."""
        known = self.density() if self.has_density else None
        return (known, draws(known.posterior)) if known and known.separate else None

    @cached_property
    def interval(self) -> tuple[Array, Array] | None:
        """Ends of the coefficients' 90 % interval, each (n_materials, n_bands), within the bounds.

        It is `rtcal.posterior.distribution`'s: with the uncertainty of T, where one is stated, and it
        holds the calibrated coefficient. In a room that states an uncertainty of its volume, areas,
        climate or tables it is that of a normal density, cut at the bounds. None if that would need
        samples (correlations, order, several configurations), or if the method has no posterior (`lse`,
        `robust`).
        """
        if len(self.configurations.rooms) > 1 or not self.has_density:
            return None
        if self.has_shared_errors:
            return self.gaussian_interval
        if self._separate is None:
            return None
        known, parts = self._separate
        return intervals(self.alpha, known.quantiles(parts), 0.9)

    @cached_property
    def _distribution(self) -> tuple[Array, Array]:
        """Quantiles of the coefficients at `NORMAL`, and their correlation per band.

        The posterior's where each band stands for itself; else that of the linear estimate's error, cut
        at the bounds, which every method has.
        """
        if self._separate is not None:
            known, parts = self._separate
            return known.quantiles(parts), correlations(known, parts)
        layout = self.composition.layout
        covariance = self.estimate_covariance()
        centre = layout.expand(self.unbounded(self.estimate_sigma))
        lower = layout.expand(self.numbers.lower)
        sigma, correlation = correlation_of(covariance)
        quantiles = normal_quantiles(centre, sigma, lower)
        return np.where(
            sigma[:, :, np.newaxis] > 0, quantiles, self.alpha[:, :, np.newaxis]
        ), correlation

    def to_dict(self) -> dict[str, Any]:
        """Return each configuration's `CalibrationResult.to_dict` by name."""
        names = self.configurations.names
        by_name = zip(names, self.results, strict=True)
        return {"configurations": [{"name": n, **r.to_dict()} for n, r in by_name]}

    def __str__(self) -> str:
        parts = zip(self.configurations.names, self.results, strict=True)
        return "\n\n".join(f"configuration: {name}\n{result}" for name, result in parts)

    def __repr__(self) -> str:
        rooms = self.configurations.rooms
        return (
            f'<JointResult of "{shortened(rooms[0].name)}": {len(rooms)} '
            f"configuration{'s' * (len(rooms) > 1)}, method {self.method}>"
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CalibrationResult(Result):
    """A calibrated room, with the calibration's certificate, plausibility and trust marks.

    Of several configurations, it is the result of one; see `JointResult`.

    Attributes
    ----------
    joint : JointResult
    configuration : int
    shares : array (n_materials, 3), optional
        Directions of the materials, as `rtcal.acoustics.directions.facing` returns them of a mesh.
        Without it, those that the room itself states.
    """

    record_kind: ClassVar[str] = table.KIND

    joint: JointResult
    configuration: int
    shares: Array | None = None

    @property
    def prior(self) -> Room:
        """The room before the calibration."""
        return self.joint.configurations.rooms[self.configuration]

    @property
    def states(self) -> tuple[CalibrationResult, ...]:
        """The results of all measured configurations, for `rtcal.prediction.predict`."""
        return self.joint.results

    @property
    def equation(self) -> LinearEquation:
        """The equation that turned T into b."""
        return self.joint.equation

    @property
    def method(self) -> str:
        """The method's name."""
        return self.joint.method

    @property
    def solver(self) -> str:
        """The solver's name."""
        return self.joint.solver

    @property
    def measured_data(self) -> MeasuredTimes:
        """The measurement, in the room's bands."""
        return self.joint.measured_times[self.configuration]

    @cached_property
    def _rows(self) -> list[int]:
        """Indices of the room's materials among those of all configurations."""
        every = self.joint.materials
        return [every.index(m) for m in self.prior.materials]

    @cached_property
    def alpha(self) -> Array:
        """The calibrated coefficients, (n_materials, n_bands)."""
        return read_only_view(self.joint.alpha[self._rows])

    @property
    def target(self) -> Array:
        """b in m², (n_bands,), NaN where missing."""
        return np.asarray(self.joint.numbers.target[self.configuration])

    @property
    def target_uncertainty(self) -> Array:
        """Standard uncertainty of b in m², (n_bands,), NaN where unknown."""
        return np.asarray(self.joint.numbers.target_uncertainty[self.configuration])

    @property
    def multipliers(self) -> Array:
        """D in 1/m², (n_bands,): free coefficients are mu - D S sigma² (Eq. 25)."""
        return read_only_view(self.joint.match_multipliers[self.configuration])

    @cached_property
    def active(self) -> Active:
        """-1 at the lower bound, 1 at the upper, 0 free, (n_materials, n_bands)."""
        return read_only_view(self.joint.active[self._rows])

    @cached_property
    def certificate(self) -> Certificate:
        """Error bounds of the answer: its distance from the optimum."""
        of_all = self.joint.certificate
        return replace(of_all, alpha_error_bound=of_all.alpha_error_bound[self._rows])

    @property
    def raw(self) -> Iterate:
        """The solver's own answer."""
        return self.joint.raw

    @property
    def polished(self) -> bool:
        """Whether the answer is the polished one; else only the solver's own passed the certificate."""
        return self.joint.polished

    @property
    def unreachable(self) -> tuple[Unreachable, ...]:
        """Bands whose T could not be reached and was replaced by the nearest that could."""
        every = self.joint.unreachable
        return tuple(u for u in every if u.configuration == self.configuration)

    @property
    def effects(self) -> dict[str, float]:
        """The sizes of the further unknowns, by name."""
        return self.joint.effects

    @cached_property
    def added_absorption(self) -> Array:
        """Absorption area in m² that effects add to the room's S'alpha, (n_bands,)."""
        data = self.joint.numbers
        sizes = data.further(self.joint.unknowns)
        return read_only_view(np.asarray(data.gains[self.configuration] @ sizes))

    @property
    def measured(self) -> Array:
        """Measured T in s, (n_bands,), NaN where missing."""
        return read_only_view(self.measured_data.reverberation_time)

    @property
    def measured_uncertainty(self) -> Array:
        """Standard uncertainty of the measured T in s, (n_bands,), NaN where unknown."""
        return read_only_view(self.measured_data.uncertainty)

    @property
    def matched(self) -> Array:
        """Which bands were matched to T, (n_bands,) of bool; none without a term that uses T."""
        return np.asarray(np.isfinite(self.target) & self.joint.asks_for_measured_time)

    @cached_property
    def reverberation_time_before(self) -> Array:
        """T of the prior in s, (n_bands,); NaN where the equation does not hold for the prior."""
        times = where_valid(self.equation.time, self.prior, self.prior.absorption_area)
        return read_only_view(times)

    @cached_property
    def reverberation_time_after(self) -> Array:
        """T of the calibrated room in s, (n_bands,); NaN where the equation does not hold for it."""
        area = self.prior.areas @ self.alpha + self.added_absorption
        return read_only_view(where_valid(self.equation.time, self.prior, area))

    @property
    def gap_before(self) -> Array:
        """(T of the prior - measured) in JND of 5 %, signed, (n_bands,)."""
        return gap_jnd(self.reverberation_time_before, self.measured)

    @property
    def gap_after(self) -> Array:
        """(T calibrated - measured) in JND of 5 %, signed, (n_bands,)."""
        return gap_jnd(self.reverberation_time_after, self.measured)

    @property
    def shift(self) -> Array:
        """alpha - mu, (n_materials, n_bands)."""
        return self.alpha - self.prior.alpha

    @property
    def shift_in_sigmas(self) -> Array:
        """(alpha - mu) / sigma, (n_materials, n_bands); 0 where sigma = 0."""
        sigma = self.prior.sigma
        return np.divide(self.shift, sigma, out=np.zeros_like(sigma), where=sigma > 0)

    @cached_property
    def plausibility(self) -> Plausibility:
        """Distance of the measured T from the prior, with the room's sigma; see `Plausibility`."""
        deviation, covariance = self.joint.innovation
        bands = slice(
            self.configuration * self.prior.n_bands, (self.configuration + 1) * self.prior.n_bands
        )
        further = self.joint.at_bounds[self.joint.numbers.layout.n_alpha :]
        at_bound = bool(self.active[:, self.matched].any() or further.any())
        room = self.prior
        together = of_absorption(room.areas, room.alpha, room.sigma, room.centre_frequencies)
        return plausibility(deviation[bands], covariance[bands, bands], at_bound, together)

    @cached_property
    def air_share(self) -> Array:
        """The air's share of the whole absorption of the calibrated room, (n_bands,)."""
        area = self.prior.areas @ self.alpha + self.added_absorption
        return read_only_view(where_valid(self.equation.air_share, self.prior, area))

    @cached_property
    def trust_marks(self) -> tuple[TrustMark, ...]:
        """Reasons to doubt single bands or the whole room, with advice; likely typing errors first."""
        return (
            *self.measured_data.mistyped,
            *in_room(self.prior),
            *uneven_marks(self.room, facing(self.room) if self.shares is None else self.shares),
            *trust_marks(
                self.prior,
                self.measured,
                self.measured_uncertainty,
                self.air_share,
                self.active,
                self.plausibility.z,
                [u.frequency for u in self.unreachable],
                self.measured_data.bent,
            ),
        )

    @cached_property
    def posterior_sigma(self) -> Array:
        """Standard deviation of the calibrated coefficients, (n_materials, n_bands).

        It follows from the room's sigma and the uncertainty of T, and is that of `interval` before the
        bounds cut it: so is the stated sigma, which it is comparable with.
        """
        return read_only_view(self.joint.posterior_sigma[self._rows])

    @cached_property
    def room(self) -> Room:
        """The room with calibrated coefficients, the posterior's sigma and the `record`."""
        return self.prior.replace(
            alpha=self.alpha, sigma=self.posterior_sigma, calibration=self.record
        )

    @property
    def record(self) -> CalibrationRecord:
        """Method, equation, data, solver and version, for the calibrated room."""
        return CalibrationRecord(
            method=self.method,
            equation=self.equation.name,
            measured=data_history(self.prior, self.measured_data),
            solver=self.solver,
            version=__version__,
        )

    @property
    def interval(self) -> tuple[Array, Array] | None:
        """`JointResult.interval` of the room's materials."""
        if self.joint.interval is None:
            return None
        low, high = self.joint.interval
        return low[self._rows], high[self._rows]

    def density(self) -> Densities:
        """Return the density of the coefficients, for `rtcal.posterior.distribution`.

        Raises ModelError if the method has none (`lse`, `robust`).
        """
        return self.joint.density()

    def by_time(self) -> Array:
        """Return `JointResult.by_time`."""
        return self.joint.by_time()

    @property
    def known(self) -> KnownRoom:
        """The room as a prediction takes it; ModelError as `JointResult.known_room`."""
        return self.joint.known_room(self.configuration)

    def predict(
        self,
        changes: Change | Sequence[Change] | Room,
        *,
        name: str = "",
        assumptions: Assumptions | None = None,
    ) -> Prediction:
        """Predict T after a change of this room: T of the calibrated room times what the change does.

        See `rtcal.prediction.predict`. Of several configurations all measured T count.

        Raises ModelError as `JointResult.known_room`, and as `rtcal.prediction.predict`.
        """
        return predict(self, changes, assumptions=assumptions, name=name)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, lists and text; None where a value is missing.

        ``inputs`` holds the room and the mean T as the texts of their files, so that the record
        suffices to repeat the calibration.
        """
        room, composed = self.prior, self.joint.composition
        record = {
            "rtcal": table.KIND,
            "versions": dict(self.joint.versions),
            "room": room.name,
            "method": self.method,
            "equation": self.equation.name,
            "equation_parameters": table.equation_parameters(self.equation),
            "objective": [repr(term) for term in composed.objective.terms],
            "constraints": [repr(row) for row in composed.row_constraints],
            "matches_measured_time": self.joint.asks_for_measured_time,
            "volume": room.volume,
            "air": None if room.air is None else vars(room.air),
            "room_taken_as_exact": not self.joint.matches_uncertain_room,
            **({"room_uncertainty": words} if (words := room_errors.in_words(room)) else {}),
            **(
                {"gap_shares": shares}
                if (shares := self.joint.gap_shares(self.configuration))
                else {}
            ),
            "centre_frequencies": json_numbers(room.centre_frequencies),
            "measured": table.measurement(self.measured_data),
            "reverberation_time_before": json_numbers(self.reverberation_time_before),
            "reverberation_time_after": json_numbers(self.reverberation_time_after),
            "gap_before_jnd": json_numbers(self.gap_before),
            "gap_after_jnd": json_numbers(self.gap_after),
            "target": json_numbers(self.target),
            "target_uncertainty": json_numbers(self.target_uncertainty),
            "materials": table.materials(
                room,
                self.room,
                self.shift_in_sigmas,
                self.interval,
                self.active,
                self.certificate.alpha_error_bound,
            ),
            "material_correlation": [
                {"materials": list(pair), "value": value}
                for pair, value in room.material_correlation.items()
            ],
            "band_correlation": room.band_correlation,
            "plausibility": {
                "z": json_numbers(self.plausibility.z),
                "q": self.plausibility.q,
                "degrees_of_freedom": self.plausibility.degrees_of_freedom,
                "p_value": self.plausibility.p_value,
                "p_together": self.plausibility.p_together,
            },
            "effects": self.effects,
            "added_absorption": json_numbers(self.added_absorption),
            "air_share": json_numbers(self.air_share),
            "trust_marks": [vars(mark) for mark in self.trust_marks],
            "multipliers": json_numbers(self.multipliers),
            "unreachable": [str(band) for band in self.unreachable],
            "certificate": table.residuals(self.certificate),
            "solver": {
                "name": self.solver,
                "status": self.raw.status,
                "iterations": self.raw.iterations,
                "seconds": None if np.isnan(self.raw.seconds) else self.raw.seconds,
                "polished": self.polished,
                "raw_certificate": table.residuals(self.joint.raw_certificate),
                "raw_alpha": json_numbers(self.joint.raw_alpha[self._rows]),
            },
            "inputs": table.inputs(room, self.measured_data),
        }
        return {**record, "verdict": verdict(record)._asdict()}

    @cached_property
    def verdict(self) -> CalibrationVerdict:
        """Statement on model and measurement that text, page and JSON share."""
        return CalibrationVerdict(**self.to_dict()["verdict"])

    def __repr__(self) -> str:
        gaps = [np.nanmax(np.abs(gap)) for gap in (self.gap_before, self.gap_after)]
        return (
            f'<CalibrationResult of "{shortened(self.prior.name)}": method {self.method}, '
            f"{self.equation.name}'s equation, largest gap {gaps[0]:.1f} JND before, "
            f"{gaps[1]:.1f} JND after>"
        )

    def __str__(self) -> str:
        return "\n".join(blocks.lines(blocks_of(self.to_dict())))

    def _repr_html_(self) -> str:
        """Return the tables of the bands and the coefficients, shaded by gap and by shift."""
        return blocks.notebook("", blocks_of(self.to_dict()))
