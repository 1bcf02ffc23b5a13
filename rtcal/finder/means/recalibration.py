"""Calibrate a case's room without and with the effects that were added to its model.

The observations are ln T of the configurations, as the whole model has them: with its equation, the
decay's shape and noise that effects add. `rtcal.calibration.problem` takes Gauss-Newton steps to them
around the QP of the prior's deviation. The configurations share coefficients, and the effects keep the
sizes with which they were added.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import LinearEquation, mean_equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.calibration.measured import data_history, times_in_room
from rtcal.calibration.methods import calibrate
from rtcal.calibration.problem import Calibration, fit
from rtcal.calibration.result import JointResult
from rtcal.calibration.terms import LinearObservations, PriorDeviation
from rtcal.files.saved import Result
from rtcal.finder.apply import corrected_case
from rtcal.finder.case import Case, Configuration
from rtcal.finder.claim import WORDS
from rtcal.finder.means.problem import (
    ModelDiscrepancy,
    observe,
    offset_of,
    predict_in,
    state,
    states,
)
from rtcal.finder.model import FEATURES
from rtcal.support import __version__, checks, text
from rtcal.support.blocks import Block
from rtcal.support.errors import DataError, MissingAirWarning
from rtcal.support.speed import single_threaded_blas
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False, repr=False)
class Recalibrated(Result):
    """Hold the calibrated coefficients of a case, and the values that the model predicts with them.

    ``case`` is the case with its effects.
    """

    record_kind: ClassVar[str] = "recalibration 1"

    case: Case
    alpha: Array
    """Calibrated coefficients of the room, (n_materials, n_bands). Coefficients that a configuration
    changes are in ``changed``."""
    changed: Mapping[tuple[str, str], Array]
    """Calibrated coefficients that a configuration changes, by configuration and material, (n_bands,)
    each."""
    features: Array
    """Predicted ln T20, ln EDT/T20, ln T30/T20, and C80 and G in dB, without the model's bias,
    (n_configurations, n_features, n_bands)."""
    off: float
    """Root mean square of the fitted minus the measured ln T, over its standard deviation."""
    joint: JointResult
    """Result of the calibration, which has further rows for the materials that configurations
    change."""

    @cached_property
    def sigma(self) -> Array:
        """Standard uncertainty of alpha, (n_materials, n_bands), if the effects are right."""
        return np.asarray(self.joint.posterior_sigma[: self.case.room.n_materials])

    @property
    def interval(self) -> tuple[Array, Array]:
        """Lower and upper end of the 90 % interval of alpha, (n_materials, n_bands) each."""
        low, high = self.joint.interval
        return low[: len(self.alpha)], high[: len(self.alpha)]

    @cached_property
    def room(self) -> Room:
        """Corrected room with calibrated coefficients, their sigma, and a record of the calibration."""
        stated = self.case.room
        data = [times_in_room(stated, c.measured) for c in self.case.configurations]
        calibrated = stated.replace(
            alpha=self.alpha,
            sigma=self.sigma,
            calibration=CalibrationRecord(
                method="gap",
                equation=self.joint.equation.name,
                solver=self.joint.solver,
                measured=" ".join(
                    [data_history(stated, data[0]), *(d.fingerprint for d in data[1:])]
                ),
                version=__version__,
            ),
        )
        return corrected_case(replace(self.case, room=calibrated)).room

    @property
    def sizes(self) -> dict[str, float]:
        """Sizes of the effects that have one, by the effect's name, in the effect's unit."""
        return {p.name: p.size for p in self.case.applied if np.isfinite(p.effect.neutral)}

    def blocks(self, plain: Recalibrated | None = None) -> list[Block]:
        """Return tables of each material's alpha, with a ``plain`` calibration's, and of effects."""
        made: list[Block] = import_module(WORDS).of_recalibration(self, plain)
        return made

    def __repr__(self) -> str:
        """Return one line: the room, and the effects."""
        effects = text.shortened(", ".join(p.name for p in self.case.applied)) or "no effect"
        name = text.shortened(self.case.room.name)
        return f'<Recalibrated "{name}": {len(self.alpha)} materials, with {effects}>'

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        room = self.case.room
        tables = {"alpha": self.alpha, "sigma": self.sigma}
        tables |= dict(zip(("low", "high"), self.interval, strict=True))
        return {
            "effects": [
                {
                    **p.to_dict(),
                    "size": self.sizes.get(p.name),
                    "unit": p.effect.unit_in(p.parameters, room),
                    "material": p.effect.material(p.parameters, room),
                }
                for p in self.case.applied
            ],
            "materials": [
                {"name": name, **{key: values[i].tolist() for key, values in tables.items()}}
                for i, name in enumerate(room.materials)
            ],
            "changed": [
                {"configuration": c, "material": m, "alpha": v.tolist()}
                for (c, m), v in self.changed.items()
            ],
        }


_ROUNDS = 12
_SETTLED = 1e-4  # largest change of alpha after which no further step is taken
_STEP = 1e-5  # change of alpha over which ln T is differentiated
_LEAST_U = 0.002
"""Relative uncertainty of T at least: a stated one of 0 would leave the prior no weight."""
_EXACT_U = 1e-4
"""That with which a T is matched exactly by an equation that is no function of the mean alpha."""
_T20 = FEATURES.index("t20")
_TIMES = LinearObservations("ln T")


def plain(case: Case) -> Recalibrated:
    """Return a calibration to T20 of the first configuration, or nearly, without effects."""
    case.require_fresh()
    case, equation = replace(case, applied=()), mean_equation(case.equation)
    if not isinstance(equation, LinearEquation):
        return LogTimes.of(case, [0], exact=True).calibrated()
    data, first = LogTimes.of(case, [0]), case.configurations[0]
    times = np.exp(data.measured - np.nan_to_num(offset_of(case, first)[_T20]))
    measured = Measurement(
        centre_frequencies=case.room.centre_frequencies,
        values={"t20": times},
        uncertainty={"t20": times * np.minimum(data.u, 0.9)},
    )
    room = _room(case, {}, *first.coefficients(case.room)).replace(air=first.air or case.room.air)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MissingAirWarning)  # it is among the finding's notes
        solved = calibrate(room, measured, equation=equation.linear(), unreachable="nearest")
    alpha = np.array(case.room.alpha)
    own = [m not in first.changes for m in case.room.materials]
    alpha[own] = solved.alpha[own]
    changed = [solved.alpha[case.room.material_index(m)] for m in first.changes]
    others = [c.changes[m].alpha for c, m in data.changed if c is not first]
    return data.result(np.array([*alpha, *changed, *others]), solved.joint)


@single_threaded_blas()
def recalibrate(
    case: Case,
    discrepancy: ModelDiscrepancy | None = None,
    *,
    left_out: Sequence[int] = (),
) -> Recalibrated:
    """Calibrate a case's coefficients, with the effects in its model, to T20 of every configuration.

    Parameters
    ----------
    case : Case
        Case whose room is calibrated, for example `Corrected.case`.
    discrepancy : ModelDiscrepancy, optional
        Error of the model, `Finding.discrepancy`. Its mean error of ln T is subtracted from the
        measurement; by default nothing is.
    left_out : sequence of int
        Numbers, from 0, of configurations whose T is predicted and not used; 0 must not be among them.

    Returns
    -------
    Recalibrated
        Calibrated coefficients, and the values that the model predicts with them.

    Raises
    ------
    DataError
        If the room was already calibrated to one of the case's T, or ``discrepancy`` is of another
        case.
    """
    case.require_fresh()
    bias = None
    if discrepancy is not None:
        bias = checks.instance("discrepancy", discrepancy, ModelDiscrepancy).bias
        n = len(case.configurations) * len(FEATURES) * case.room.n_bands
        if bias.shape != (n,):
            raise DataError(
                f"discrepancy is of another case: its bias has shape {bias.shape}, and "
                f"this case needs ({n},)"
            )
    fitted = [c for c in range(len(case.configurations)) if c not in left_out]
    return LogTimes.of(case, fitted, bias).calibrated()


def _room(case: Case, further: Mapping[str, str], alpha: Array, sigma: Array) -> Room:
    """Return the case's room with other coefficients, and ``further`` materials, each like another."""
    room = case.room
    rows = [*range(room.n_materials), *map(room.material_index, further.values())]
    return Room(
        name=room.name,
        volume=room.volume,
        materials=[*room.materials, *further],
        areas=room.areas[rows],
        alpha=alpha,
        sigma=sigma,
        centre_frequencies=room.centre_frequencies,
        air=room.air,
        alpha_min=None if room.alpha_min is None else np.minimum(room.alpha_min[rows], alpha),
        band_correlation=room.band_correlation,
        pieces=(*room.pieces, *(name for name, like in further.items() if like in room.pieces)),
    )


@dataclass(frozen=True, eq=False)
class LogTimes:
    """Hold ln T of a case's configurations, to which its coefficients are calibrated.

    The unknown coefficients are those of the room, then those of materials that configurations
    change.
    """

    case: Case
    fitted: Sequence[int]  # numbers of the configurations that are used
    measured: Array  # ln T less the model's bias, (n_fitted, n_bands); NaN where T is missing
    u: Array  # its standard uncertainty

    @classmethod
    def of(
        cls, case: Case, fitted: Sequence[int], bias: Array | None = None, *, exact: bool = False
    ) -> LogTimes:
        """Return the observation of these configurations; ``bias`` is that of all features."""
        part = replace(case, configurations=[case.configurations[c] for c in fitted])
        observed, _ = observe(part)
        variance = np.full(observed.used.shape, np.nan)
        variance[observed.used] = np.diag(observed.covariance)
        measured = observed.features[:, _T20]
        if bias is not None:
            shape = (len(case.configurations), len(FEATURES), case.room.n_bands)
            measured = measured - bias.reshape(shape)[fitted, _T20]
        u = np.sqrt(np.maximum(variance[:, _T20], _LEAST_U**2))
        return cls(case, fitted, measured, np.where(exact, _EXACT_U, u))

    @property
    def changed(self) -> list[tuple[Configuration, str]]:
        """The materials that configurations change: each is an unknown of its own."""
        return [(c, m) for c in self.case.configurations for m in c.changes]

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """Which T are known, (n_fitted, n_bands)."""
        return np.isfinite(self.measured)

    @property
    def values(self) -> Array:
        """The known ln T, (n,)."""
        return np.asarray(self.measured[self.used])

    @property
    def covariance(self) -> Array:
        """Their covariance, (n, n)."""
        return np.diag(self.u[self.used] ** 2)

    def rows(self, c: int) -> list[int]:
        """Return the numbers of the coefficients that a configuration has, (n_materials,)."""
        configuration, n = self.case.configurations[c], self.case.room.n_materials
        return [
            n + self.changed.index((configuration, m)) if m in configuration.changes else i
            for i, m in enumerate(self.case.room.materials)
        ]

    def features(self, c: int, alphas: Array) -> Array:
        """Return a configuration's features under coefficients (n, n_unknowns, n_bands)."""
        configuration = self.case.configurations[c]
        unchanged = replace(configuration, changes={})
        made = states(self.case, unchanged, list(alphas[:, self.rows(c)]))
        return predict_in(self.case, configuration, made).features

    def predict(self, alpha: Array) -> Array:
        """Return the model's ln T."""
        every = np.array([self.features(c, alpha[None])[0, _T20] for c in self.fitted])
        return np.asarray(every[self.used])

    def jacobian(self, alpha: Array) -> Array:
        """Return their derivatives by alpha, (n, n_unknowns * n_bands), by differences."""
        step = np.where(alpha > 0.5, -_STEP, _STEP)
        n, n_bands = alpha.shape
        moved = np.concatenate([alpha[None], alpha + np.eye(n)[:, :, None] * step])
        out = np.zeros((*self.used.shape, n, n_bands))
        for i, c in enumerate(self.fitted):
            log_t = self.features(c, moved)[:, _T20]
            slopes = (log_t[1:] - log_t[0]) / step
            out[i, np.arange(n_bands), :, np.arange(n_bands)] = slopes.T
        return np.asarray(out[self.used].reshape(-1, n * n_bands))

    def calibrated(self) -> Recalibrated:
        """Return where Gauss-Newton steps end."""
        case, room = self.case, self.case.room
        further = {f"{m} in {c.name}": m for c, m in self.changed}
        alpha = np.array([*room.alpha, *(c.changes[m].alpha for c, m in self.changed)])
        sigma = np.array([*room.sigma, *(c.changes[m].sigma for c, m in self.changed)])
        unknowns = _room(case, further, alpha, sigma)
        equation = mean_equation(state(case, case.configurations[0]).equation).linear()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MissingAirWarning)  # it is among the finding's notes
            prior = PriorDeviation(band_correlation=room.band_correlation)
            found = fit(
                Calibration(prior + _TIMES).build(unknowns, equation),
                self,
                unknowns.alpha,
                term=_TIMES,
                method="gap",
                most=_ROUNDS,
                settled=lambda step, end: bool(np.abs(end - step.alpha).max() < _SETTLED),
            )
        return self.result(found.alpha, found.answer.joint)

    def result(self, alpha: Array, joint: JointResult) -> Recalibrated:
        """Return the calibration with the coefficients ``alpha`` (n_unknowns, n_bands)."""
        case, n = self.case, self.case.room.n_materials
        fitted = [case.configurations[c] for c in self.fitted]
        off = (self.predict(alpha) - self.values) / self.u[self.used]
        return Recalibrated(
            case,
            alpha[:n],
            {
                (c.name, m): row
                for (c, m), row in zip(self.changed, alpha[n:], strict=True)
                if c in fitted
            },
            np.array([self.features(c, alpha[None])[0] for c in range(len(case.configurations))]),
            float(np.sqrt(np.mean(off**2))),
            joint,
        )
