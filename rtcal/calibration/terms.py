"""The parts of a calibration, each as its cvxpy expression: objective terms and constraints.

Every calibration is a QP: a weighted quadratic objective, the equality S'alpha = b of the absorption
area, and the box 0 <= alpha <= 1. A term is a function of a `Model`, or an object that is called as
one. It returns an expression to be minimised, or a list of constraints, as in the paper:

    def prior_deviation(m):  return 0.5 * cp.sum_squares(m.deviation)
    def exact_match(m):      return [m.absorption_area == m.target]

That is all that a term states. Solver, polish and certificate read the QP that cvxpy compiles of it
(`rtcal.calibration.qp`).

The numbers of a room and a measurement are parameters, so that a problem is compiled once for rooms
of one shape. A product of two parameters is not DPP (disciplined parametrised programming): cvxpy would
compile anew for every solve. So the unknown is the deviation x = (alpha - mu) / sigma, in which the
prior has no parameter. What else is linear in x has coefficients that are multiplied beforehand, such
as S sigma of the absorption area.
"""

from __future__ import annotations

import copy
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from rtcal.acoustics import bands
from rtcal.acoustics.observables import TARGET
from rtcal.calibration.unknowns import Integers, Layout, Numbers, cp
from rtcal.calibration.unknowns import Observed as Observed
from rtcal.support import checks
from rtcal.support.errors import DataError, ModelError
from rtcal.support.types import Array

__all__ = [
    "AddedAbsorption",
    "AtMost",
    "BandSmoothness",
    "Bounds",
    "ExactMatch",
    "Fixed",
    "GroupAbsorption",
    "HuberDeviation",
    "LinearObservations",
    "MatchWithin",
    "Model",
    "Observed",
    "PriorDeviation",
    "Shared",
    "SoftMatch",
    "Term",
]
__dir__ = __all__.copy

SMALLEST_UNCERTAINTY = 1e-6
"""Of T, relative. Below it the soft match dwarfs the prior, and rounding decides alpha."""


class Model:
    """The unknowns, and the numbers of room and measurement, as cvxpy expressions for terms.

    Attributes
    ----------
    layout : Layout
        The materials, bands, configurations and effects.
    x : variable (n_materials * n_bands,)
        (alpha - mu) / sigma, row by row. Materials that share their coefficients have one row. Where
        sigma = 0 the coefficient is mu, whatever x is.
    deviation : expression (n_materials, n_bands)
        The same by material and band.
    effects : variable (n_effects,), optional
        The deviations of the effects' sizes, (size - mean) / sigma.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = checks.instance("layout", layout, Layout)
        self.x = cp.Variable(layout.n_alpha, name="x")
        self.deviation = cp.reshape(self.x, (layout.n_alpha_rows, layout.n_bands), order="C")
        self.effects: Any = cp.Variable(len(layout.further)) if layout.further else None
        self.parameters: list[tuple[Any, Callable[[Numbers], Any]]] = []
        self.definitions: list[Any] = []
        self.nonnegative: list[Any] = []

    def parameter(self, shape: Any, compute: Callable[[Numbers], Any]) -> Any:
        """Return a cvxpy parameter that has the value ``compute(numbers)`` in every solve."""
        parameter = cp.Parameter(shape)
        self.parameters.append((parameter, compute))
        return parameter

    def by_band(self, compute: Callable[[Numbers], Any]) -> Any:
        """Return a parameter of one number per configuration and band."""
        return self.parameter((self.layout.n_configurations, self.layout.n_bands), compute)

    def defined(self, expression: Any) -> Any:
        """Return a variable that equals an expression, so that it may be multiplied by a parameter."""
        variable = cp.Variable(expression.shape)
        self.definitions.append(variable == expression)
        return variable

    def at_least_zero(self, shape: Any) -> Any:
        """Return a new auxiliary variable of one term, 0 or more."""
        variable = cp.Variable(shape)
        self.nonnegative.append(variable)
        return variable

    @cached_property
    def alpha(self) -> Any:
        """The absorption coefficients, (n_materials, n_bands)."""
        shape = self.deviation.shape
        sigma = self.parameter(shape, lambda numbers: numbers.alpha(numbers.sigma))
        mu = self.parameter(shape, lambda numbers: numbers.alpha(numbers.mu))
        return product(sigma, self.deviation) + mu

    @cached_property
    def absorption_area(self) -> Any:
        """S'alpha and what effects add, in m², (n_configurations, n_bands); 0 in bands without T."""
        return self._area(lambda numbers: np.where(numbers.matched, 1.0, 0.0))

    @cached_property
    def target(self) -> Any:
        """b of the measured T in m², (n_configurations, n_bands); 0 in bands without T."""
        return self.by_band(lambda numbers: np.where(numbers.matched, numbers.target, 0.0))

    @cached_property
    def misfit(self) -> Any:
        """(S'alpha - b) / u_b, (n_configurations, n_bands); 0 in bands without T."""

        def steep(numbers: Numbers) -> Array:
            u = np.where(numbers.matched, np.nan_to_num(numbers.target_uncertainty), 0.0)
            return np.divide(1.0, u, out=np.zeros_like(u), where=u > 0)

        target = self.by_band(lambda numbers: np.nan_to_num(numbers.target) * steep(numbers))
        return self.defined(self._area(steep) - target)

    def _area(self, scale: Callable[[Numbers], Array]) -> Any:
        """S'alpha and the effects' absorption area, each band and configuration times a scale."""
        layout, effects = self.layout, self.effects

        def of_one(c: int) -> Any:
            area = self.group_area(range(layout.n_alpha_rows), c, lambda of: scale(of)[c])
            if effects is None:
                return area
            gains = self.parameter(
                (layout.n_bands, effects.size),
                lambda of: of.gains[c] * of.further(of.sigma) * scale(of)[c, :, np.newaxis],
            )
            stated = self.parameter(
                layout.n_bands, lambda of: of.gains[c] @ of.further(of.mu) * scale(of)[c]
            )
            return area + gains @ effects + stated

        return cp.vstack([of_one(c) for c in range(layout.n_configurations)])

    def group_area(
        self,
        rows: Sequence[int],
        configuration: int,
        scale: Callable[[Numbers], Any] = lambda _: 1.0,
    ) -> Any:
        """Return the absorption area of some rows of unknowns, (n_bands,), in m² times a scale."""
        chosen = list(rows)
        x = self.deviation if len(chosen) == self.layout.n_alpha_rows else self.deviation[chosen]

        def area(numbers: Numbers, values: Array) -> Array:
            areas = numbers.areas[configuration, chosen, np.newaxis]
            return np.asarray(areas * numbers.alpha(values)[chosen] * scale(numbers))

        steep = self.parameter(x.shape, lambda numbers: area(numbers, numbers.sigma))
        stated = self.parameter(x.shape[1], lambda numbers: area(numbers, numbers.mu).sum(axis=0))
        return cp.hstack([steep[:, k] @ x[:, k] for k in range(self.layout.n_bands)]) + stated


def product(factors: Any, x: Any) -> Any:
    """Return the product by elements of a parameter and an expression, 40 of their rows at a time.

    cvxpy compiles a product of n factors with memory for n² numbers.
    """
    blocks = range(0, x.shape[0], 40)
    return cp.vstack([cp.multiply(factors[i : i + 40], x[i : i + 40]) for i in blocks])


def half_squares(expression: Any) -> Any:
    """Return half the sum of squares of an expression."""
    return 0.5 * cp.sum_squares(expression)


AnyTerm = Callable[["Model"], Any]


class _Summand:
    """What adds with ``+`` and scales with ``*``."""

    def __add__(self, other: Any) -> Objective:
        one, two = as_objective(self), as_objective(other)
        return Objective(one.terms + two.terms, one.weights + two.weights)

    def __radd__(self, other: Any) -> Objective:
        """Add to 0, with which `sum` begins, or to a function; anything else raises ModelError."""
        begins = isinstance(other, int) and other == 0
        return as_objective(self) if begins else as_objective(other) + self

    def __rmul__(self, factor: float) -> Objective:
        if not 0 <= checks.number("weight", factor) < np.inf:
            raise DataError(
                f"a weight of {factor:g} must be finite and 0 or more, because the problem is "
                "not convex otherwise"
            )
        one = as_objective(self)
        return Objective(one.terms, tuple(float(factor) * w for w in one.weights))

    __mul__ = __rmul__


@dataclass(frozen=True)
class Objective(_Summand):
    """A weighted sum of objective terms."""

    terms: tuple[AnyTerm, ...]
    weights: tuple[float, ...]


class Term(_Summand, ABC):
    """Base of the objective terms. A function of a `Model`, added to a term, is a term as well."""

    is_prior: ClassVar[bool] = False
    """Whether it makes alpha unique; a calibration has exactly one such term."""
    in_numbers: ClassVar[Mapping[str, Any]] = {}
    """The fields that enter through the parameters, with the values that the compiled problem has."""

    @abstractmethod
    def __call__(self, m: Model) -> Any:
        """Return the cvxpy expression to be minimised."""

    def convexity(self, numbers: Numbers) -> float:
        """Return m, at most the curvature by each deviation x; 0 if unknown."""
        return 0.0

    def structure(self) -> Term:
        """Return a term of the same compiled problem, one for all values of the parameters."""
        alike = copy.copy(self)
        vars(alike).update(self.in_numbers)
        return alike


def as_objective(term: Any) -> Objective:
    """Return a term, or a sum of them, as an `Objective`; ModelError for anything else."""
    if isinstance(term, Objective):
        return term
    if isinstance(term, type):
        raise ModelError(f"{term.__name__} is a class, not a term: write {term.__name__}()")
    if callable(term):
        return Objective((term,), (1.0,))
    raise ModelError(f"{term!r} is not an objective term: give a function of an rtcal.terms.Model")


@dataclass(frozen=True)
class PriorDeviation(Term):
    """½ x'R⁻¹x, x = (alpha - mu) / sigma: half the squared shift from the prior mean in sigmas.

    When to use it: always (or `HuberDeviation`); it makes the answer unique. The paper's
    maximum-likelihood estimate (Bellows & Katz 2025, Eq. 19) is this term, independent (R = 1),
    and `ExactMatch`; its least-squares estimate (Eq. 7) is the same with every sigma equal,
    ``PriorDeviation(sigma=1)``. Give correlations where errors go together: a data sheet that is
    too low at 500 Hz is likely too low at 1 kHz; two boards of one maker err alike. They change
    nothing with an exact match, no coefficient at a bound, and sigmas that are a material's factor
    times a band's (see docs/modelling.md).

    Parameters
    ----------
    sigma : float, optional
        One standard deviation for every coefficient in place of the room's (but 0 stays 0), above 0.
        It enters through x: `rtcal.calibration.problem.CalibrationProblem.numbers` takes it.
    band_correlation : float
        r below 1 is the correlation of two bands an octave apart: r ** octaves.
    material_correlation : mapping of pairs to float
        Between the same bands of two materials: ``{("door", "panel"): 0.7}``.
    common : bool
        Whether all coefficients may be off together, by the room's ``common_alpha_sigma`` t: then the
        covariance is sigma R sigma + t² mu mu' over all materials and bands.

    Raises
    ------
    ModelError
        For a band correlation not below 1, or (when built) materials' that is not positive definite.
    """

    sigma: float | None = None
    band_correlation: float = 0.0
    material_correlation: Any = ()
    common: bool = False

    is_prior: ClassVar[bool] = True
    in_numbers: ClassVar[Mapping[str, Any]] = {"sigma": None}

    def __post_init__(self) -> None:
        checks.flag("PriorDeviation: common", self.common)
        if self.sigma is not None:
            checks.positive("PriorDeviation: sigma", self.sigma)
        if not 0 <= checks.number("band_correlation", self.band_correlation) < 1:
            raise ModelError(
                f"band_correlation {self.band_correlation:g} must be from 0 to below 1"
            )
        pairs = self.material_correlation
        if not isinstance(pairs, tuple):
            # Kept as a tuple: a term is hashable, so that its compiled problem is found again.
            pairs = tuple(checks.mapped("material_correlation", pairs).items())
        for pair, r in pairs:
            if not (isinstance(pair, tuple) and len(pair) == 2):
                raise DataError(f"material_correlation: {pair!r} is not a pair of materials")
            checks.number(f"material_correlation of {pair}", r)
        object.__setattr__(self, "material_correlation", pairs)

    @property
    def correlated(self) -> bool:
        """Whether there is any correlation, or a part that all coefficients have in common."""
        return bool(self.band_correlation or self.material_correlation or self.common)

    def __call__(self, m: Model) -> Any:
        """½ x'R⁻¹x; with a common part t, ½ (x - q t)'R⁻¹(x - q t) + ½ t²."""
        x, of_common, n = m.x, 0.0, m.layout.n_alpha
        if self.common:
            together = cp.Variable()
            of_common = half_squares(together)
            shift = m.parameter(
                n, lambda numbers: (numbers.common_shift * numbers.inverse_sigma)[:n]
            )
            x = m.defined(x - shift * together)
        return 0.5 * cp.quad_form(x, _correlation(self, m.layout)[1], assume_PSD=True) + of_common

    def convexity(self, numbers: Numbers) -> float:
        """Return the least eigenvalue of the inverse correlation."""
        q = numbers.common_shift * numbers.inverse_sigma
        largest = _correlation(self, numbers.layout)[2]
        return float(1 / (largest + (q @ q if self.common else 0.0)))

    def correlate(self, columns: Array, layout: Layout) -> Array:
        """Return R @ columns, (size, n); further unknowns are independent."""
        root, *_ = _correlation(self, layout)
        alpha = root @ (root.T @ columns[: layout.n_alpha])
        return np.concatenate([alpha, columns[layout.n_alpha :]])


@functools.lru_cache(maxsize=16)
def _correlation(term: PriorDeviation, layout: Layout) -> tuple[Any, Any, float]:
    """A root of R (of materials times of bands), the inverse of R, and its largest eigenvalue."""
    parts: list[Any] = [np.eye(layout.n_alpha_rows if term.material_correlation else 1)]
    for (a, b), r in term.material_correlation:
        i, j = (layout.index(name)[0] // layout.n_bands for name in (a, b))
        if i == j:
            raise ModelError(
                f'material_correlation: "{a}" and "{b}" share their coefficients, so they cannot '
                "have a correlation; leave this pair out"
            )
        parts[0][i, j] = parts[0][j, i] = r
    parts.append(bands.correlation(np.array(layout.centre_frequencies), term.band_correlation))
    try:
        roots = [np.linalg.cholesky(part) for part in parts]
    except np.linalg.LinAlgError as error:
        raise ModelError("material_correlation is not positive definite") from error
    # Where no materials are correlated, each has the same part.
    alike = sp.eye_array(layout.n_alpha_rows // len(parts[0]))
    root = sp.csr_array(sp.kron(alike, sp.kron(*roots)))
    whitener = sp.csr_array(sp.kron(alike, sp.kron(*map(np.linalg.inv, roots))))
    inverse = sp.csr_array(whitener.T @ whitener)
    inverse.eliminate_zeros()
    return root, inverse, float(np.prod([np.linalg.norm(part, 2) for part in roots]) ** 2)


@dataclass(frozen=True)
class HuberDeviation(Term):
    """sum of e x²/2 + (1 - e) h(x): like `PriorDeviation` near mu, but straight beyond t sigmas.

    h(x) = x²/2 for |x| <= t, t |x| - t²/2 beyond (Huber 1964, Eq. 2.4).

    When to use it: when some sigma may be wrong (a material taken for another): one
    coefficient may then move far at a bounded price, and the others need not follow. Huber's own
    minimiser is not unique, so a small strictly convex part, e = 0.01 of the square, is mixed in.

    Parameters
    ----------
    threshold : float
        t, in sigmas, above 0; beyond it a coefficient counts as an outlier.
    """

    threshold: float = 1.5

    is_prior: ClassVar[bool] = True
    convex: ClassVar[float] = 0.01

    def __post_init__(self) -> None:
        checks.positive("HuberDeviation: threshold", self.threshold)

    def __call__(self, m: Model) -> Any:
        """½ e |x|² + (1 - e) (½ |x - p + q|² + t sum(p + q)), p and q >= 0 the parts beyond t."""
        above, below = (m.at_least_zero(m.x.shape) for _ in range(2))
        # A defined sum: cvxpy compiles an objective that is linear in n variables with memory for n
        # numbers per parameter.
        beyond = m.defined(cp.sum(above) + cp.sum(below))
        near = half_squares(m.x - above + below) + self.threshold * beyond
        return self.convex * half_squares(m.x) + (1 - self.convex) * near

    def convexity(self, numbers: Numbers) -> float:
        """Return e."""
        return self.convex


@dataclass(frozen=True)
class ExactMatch:
    """S'alpha = b in every band that has a measured T (Bellows & Katz 2025, Eq. 4).

    When to use it: as the paper does, or when the uncertainty of T is not known. It forces the
    noise of T into alpha; `SoftMatch` does not.
    """

    def __call__(self, m: Model) -> list[Any]:
        """One equality per configuration and band."""
        return [m.absorption_area == m.target]

    def target_limits(self, numbers: Numbers) -> tuple[Array, Array]:
        """Return the least and the most absorption area in m² that this match allows.

        Both are (n_configurations, n_bands). An exact match allows only the target b.
        """
        return numbers.target, numbers.target

    def label(self, row: int, layout: Layout) -> str:
        """Return the band that a row matches."""
        return f"exact match of T at {layout.band_label(row)} (m² of absorption)"


@dataclass(frozen=True)
class MatchWithin(ExactMatch):
    """|T - T measured| <= tolerance, in just noticeable differences of 5 %.

    When to use it: when nobody would hear a smaller deviation, so that coefficients should not move for
    it. The answer is the nearest to the prior that is within the tolerance.

    Parameters
    ----------
    jnd : float
        Above 0, below 20 (where T would have to be 0).
    """

    jnd: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < checks.number("MatchWithin: jnd", self.jnd) < 1 / TARGET.jnd:
            raise DataError(
                f"MatchWithin: jnd = {self.jnd:g} must be above 0 and below 20; for no tolerance "
                "use ExactMatch()"
            )

    def __call__(self, m: Model) -> list[Any]:
        """Two inequalities per band."""

        def limit(side: int) -> Any:
            # A band without T reads -1 <= 0 <= 1, which leaves the solver an interior.
            return m.by_band(
                lambda of: np.where(of.matched, self.target_limits(of)[side], 2.0 * side - 1)
            )

        return [m.absorption_area >= limit(0), m.absorption_area <= limit(1)]

    def target_limits(self, numbers: Numbers) -> tuple[Array, Array]:
        """Return the absorption areas in m² of the longest and of the shortest T within the tolerance.

        Both are (n_configurations, n_bands). Where the measured T cannot be reached, the tolerance is
        widened to the nearest T that can.
        """
        tolerance = TARGET.jnd * self.jnd
        low, high = (numbers.target_of(numbers.time * (1 + s * tolerance)) for s in (1, -1))
        # A T so short that no b gives it: the equation's largest b is the limit.
        beyond = np.isfinite(numbers.time) & np.isnan(high)
        high = np.where(beyond, numbers.largest_target, high)
        return np.fmin(low, numbers.target), np.fmax(high, numbers.target)

    def label(self, row: int, layout: Layout) -> str:
        """Return the band that a row matches."""
        return f"match of T within {self.jnd:g} JND at {layout.band_label(row)} (m² of absorption)"


@dataclass(frozen=True)
class SoftMatch(Term):
    """½ sum ((S'alpha - b) / u_b)²: match T within its uncertainty u_b.

    u_b = |db/dT| u_T. docs/modelling.md compares it with other terms.

    When to use it: whenever the uncertainty of T is known, or can be given; with several
    configurations always. It keeps the noise of T out of alpha. Weight 1 is the right one: then
    with `PriorDeviation` the answer is the most probable one.

    With ``room``, it is ½ r'C⁻¹r, r = b - S'alpha: C is the covariance of r over all bands, u_b² on its
    diagonal and what the room states of its volume, areas and climate
    (`rtcal.acoustics.room_errors.target_changes`). It is the QP with A_ik = alpha_ik S_i, every S_i and
    the volume unknown and shared by all bands, after these are minimised out. Eyring's and Kuttruff's b
    is linearised in them (docs/uncertain_room.md). An error of the volume then changes all bands alike,
    and goes less into the coefficients.

    Parameters
    ----------
    relative : float, optional
        u_T / T, at most 1, for bands whose measurement states no uncertainty. Without it those are
        refused.
    room : bool
        Whether the room's ``volume_sigma``, ``area_sigma`` and ``climate_sigma`` count. With them
        `rtcal.calibrate` sets it for every method but ``lse``.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> objective = rt.terms.PriorDeviation() + SoftMatch(room=True)
    >>> problem = rt.Calibration(objective).build(room.replace(volume_sigma=0.05))
    >>> problem.solve(measured).gap_after.round(1)
    array([1.9, 0.3, 0.4, 0.4, 0.4, 0.3])
    """

    relative: float | None = None
    room: bool = False

    in_numbers: ClassVar[Mapping[str, Any]] = {"relative": None}

    def __post_init__(self) -> None:
        u = self.relative
        checks.flag("SoftMatch: room", self.room)
        if u is not None and not 0 < checks.number("SoftMatch: relative", u) <= 1:
            percent = ": is it in percent?" if 1 < u <= 100 else ""
            raise DataError(f"SoftMatch: relative = {u:g} must be above 0 and at most 1{percent}")

    def __call__(self, m: Model) -> Any:
        """½ |(S'alpha - b) / u_b|²; with ``room`` ½ |W (S'alpha - b)|², W'W = C⁻¹."""
        if not self.room:
            return half_squares(m.misfit)
        n = m.layout.n_configurations * m.layout.n_bands

        def whitener(numbers: Numbers) -> Array:  # of the misfit, whose unit is u_b
            return numbers.match_whitener * np.nan_to_num(numbers.target_uncertainty).ravel()

        return half_squares(m.parameter((n, n), whitener) @ cp.vec(m.misfit, order="C"))

    def uncertainty(self, numbers: Numbers) -> Array:
        """Return u_b in m², (n_configurations, n_bands); DataError if unknown, 0 or infinite."""
        u = numbers.target_uncertainty
        unknown = numbers.matched & ~np.isfinite(u)
        if self.relative is not None and unknown.any():
            u = np.where(unknown, self.relative * numbers.time * numbers.target_sensitivity, u)
        for bad, message in (
            (
                np.isinf(u),
                "T[{band}] = {time:.4g} s is the shortest that the equation gives: there T does not "
                "determine the absorption. Take another equation, or leave out the band",
            ),
            (
                ~(u > 0),
                "u_T[{band}] is unknown or 0, and SoftMatch weighs by it: state it in the measurement, "
                "or leave out what is 0 and give SoftMatch(relative=...), as the methods do",
            ),
            (
                u < SMALLEST_UNCERTAINTY * np.abs(numbers.target),
                "u_T[{band}] is below a millionth of T, which no measurement reaches: state it as "
                "measured, or leave it out and take method mle",
            ),
        ):
            if (wrong := numbers.matched & bad).any():
                row = int(np.flatnonzero(wrong.ravel())[0])
                band, time = numbers.layout.band_label(row), numbers.time.ravel()[row]
                raise DataError(message.format(band=band, time=time))
        return np.where(numbers.matched, u, np.nan)


@dataclass(frozen=True)
class LinearObservations(Term):
    """½ (y - J alpha)' C⁻¹ (y - J alpha): linear observations y of alpha; C is the errors' covariance.

    The numbers are an `Observed`, and are given to `rtcal.Calibration`'s problem when it is solved:
    ``problem.solve(measured, observed={term: Observed(...)})``. So the problem is compiled once,
    whatever the number of observations, and solved for each of them.

    When to use it: where measurements determine more of alpha than one T per band. J and y come from
    a simulator's derivatives in `rtcal.calibrate_positions`; weight 1 is then the right one.

    Parameters
    ----------
    name : str
        Tells several of them apart.

    References
    ----------
    Aitken 1935, generalised least squares.
    """

    name: str = "observations"

    def __post_init__(self) -> None:
        checks.text("LinearObservations: name", self.name)

    def __call__(self, m: Model) -> Any:
        """½ |R x - z|², R and z those of `rtcal.calibration.unknowns.Observed.over`.

        What J alpha cannot reach of y is a constant.
        """
        n = m.layout.n_alpha
        both = m.parameter((n, n + 1), lambda numbers: numbers.observed[self])
        return half_squares(both[:, :n] @ m.x - both[:, n])


@dataclass(frozen=True)
class BandSmoothness(Term):
    """½ sum (x_k+1 - x_k)² / d_k, x = (alpha - mu) / sigma, d_k octaves from band k to k+1.

    When to use it: with `SoftMatch` or bands without T, when a material's error is expected to
    change slowly over frequency. It smooths the *shift* in sigmas, not alpha: a resonant absorber
    keeps its peak. With an exact match and separable sigma it changes nothing (see
    docs/modelling.md).
    """

    def __call__(self, m: Model) -> Any:
        """½ |differences|²; coefficients with sigma = 0 stand apart."""
        if m.layout.n_bands < 2:
            raise ModelError("BandSmoothness needs a room with two bands or more")
        octaves = np.diff(np.log2(np.array(m.layout.centre_frequencies)))

        def steep(numbers: Numbers) -> Array:
            moves = numbers.alpha(numbers.sigma) > 0
            return np.asarray((moves[:, 1:] & moves[:, :-1]) / np.sqrt(octaves))

        factor = m.parameter((m.layout.n_alpha_rows, m.layout.n_bands - 1), steep)
        return half_squares(product(factor, cp.diff(m.deviation, axis=1)))


@dataclass(frozen=True)
class AddedAbsorption(Term):
    """A further unknown theta >= 0: an effect that adds theta times its gain to S'alpha.

    ½ ((theta - mean) / sigma)² is its prior in the objective (docs/modelling.md).

    When to use it: when something other than the listed surfaces absorbs (an opening, furniture, an
    audience) and its spectrum is known but not its amount. theta comes out beside alpha.

    Parameters
    ----------
    name : str
    gain : sequence (n_bands,) or (n_configurations, n_bands)
        m² of absorption that theta = 1 adds in each band.
    sigma : float
        Prior standard deviation of theta, above 0.
    mean : float
        Prior mean of theta.
    """

    name: str
    gain: Sequence[Any]
    sigma: float
    mean: float = 0.0

    in_numbers: ClassVar[Mapping[str, Any]] = {"gain": (), "sigma": 1.0, "mean": 0.0}

    def __post_init__(self) -> None:
        own = f'AddedAbsorption("{checks.text("AddedAbsorption: name", self.name)}")'
        checks.positive(f"{own}: sigma", self.sigma)
        if not np.isfinite(checks.number(f"{own}: mean", self.mean)):
            raise DataError(f"{own}: mean = {self.mean:g} is not finite")
        gain = checks.array(f"{own}: gain", self.gain)
        if gain.ndim not in (1, 2) or not np.isfinite(gain).all():
            raise DataError(f"{own}: gain must be one finite number per band")
        frozen: Any = tuple(map(tuple, np.atleast_2d(gain).tolist()))
        object.__setattr__(self, "gain", frozen)

    def __call__(self, m: Model) -> Any:
        """½ ((theta - mean) / sigma)²."""
        return half_squares(m.effects[m.layout.further.index(self.name)])

    def gains(self, n_configurations: int, n_bands: int) -> Array:
        """Return the gain by configuration and band in m²; ModelError if it does not fit."""
        gain = np.array(self.gain)
        if gain.shape[1] != n_bands or gain.shape[0] not in (1, n_configurations):
            raise ModelError(
                f'AddedAbsorption("{self.name}"): gain has shape {gain.shape}; it must be '
                f"({n_configurations}, {n_bands}): configurations and bands"
            )
        return np.broadcast_to(gain, (n_configurations, n_bands))


@dataclass(frozen=True)
class Bounds:
    """lower <= alpha <= upper, for all materials and bands or for some.

    When to use it: where physics or a data sheet gives limits tighter than 0 to 1.

    Parameters
    ----------
    lower, upper : float, optional
        None is the prior mean.
    material : str, optional
        Only this material.
    band : float, optional
        Only this band, by its centre frequency in Hz.
    """

    lower: float | None = 0.0
    upper: float | None = 1.0
    material: str | None = None
    band: float | None = None

    def __post_init__(self) -> None:
        name = type(self).__name__
        stated = [end for end in (self.lower, self.upper) if end is not None]
        ends = [0.0, *(checks.number(name, end) for end in stated), 1.0]
        if not all(ends[i] <= ends[i + 1] for i in range(len(ends) - 1)):
            raise DataError(f"{name}: {stated} must satisfy 0 <= lower <= upper <= 1")

    def of(self, mu: Array) -> Any:
        """Return both bounds of coefficients whose prior means are ``mu``."""
        return [mu if end is None else end for end in (self.lower, self.upper)]


class Fixed(Bounds):
    """alpha = value (its prior mean if not given): a coefficient that the measurement may not move.

    When to use it: for a material that was measured in the laboratory, or whose answer must stay
    comparable. Alpha is as with sigma = 0 in the room. Unlike there, its input sigma still counts in z
    and Q, in correlations with other bands, and in the coefficients' uncertainty.

    Parameters
    ----------
    material : str
    value : float, optional
    band : float, optional
        Only this band, by its centre frequency in Hz.
    """

    def __init__(
        self, material: str, value: float | None = None, band: float | None = None
    ) -> None:
        super().__init__(value, value, material, band)


@dataclass(frozen=True)
class Shared:
    """The coefficients of several materials are the same unknowns: ``Shared("wall", "wall 2")``.

    When to use it: when one material goes by several names. Their rows become one, with the sum of
    their areas; their common prior counts once.
    """

    materials: tuple[str, ...]

    def __init__(self, *materials: str) -> None:
        if len(set(checks.texts("Shared: material", materials))) < 2:
            raise DataError("Shared needs at least two different materials")
        object.__setattr__(self, "materials", materials)


@dataclass(frozen=True)
class AtMost:
    """alpha of one material <= alpha of another: ``AtMost("glazing", "curtain")``.

    When to use it: when the order is certain though neither value is.

    Parameters
    ----------
    lesser, greater : str
        Materials.
    band : float, optional
        Only this band, by its centre frequency in Hz.
    """

    lesser: str
    greater: str
    band: float | None = None

    def __post_init__(self) -> None:
        checks.texts("AtMost: material", (self.lesser, self.greater))
        if self.lesser == self.greater:
            raise DataError(
                f'AtMost: "{self.lesser}" is on both sides; name two different materials'
            )

    def __call__(self, m: Model) -> list[Any]:
        """One inequality per band."""
        alpha = cp.vec(m.alpha, order="C")
        lesser, greater = (alpha[places] for places in self._places(m.layout))
        return [lesser <= greater]

    def label(self, row: int, layout: Layout) -> str:
        """Return the order and its band."""
        lesser, greater = self._places(layout)
        return f"{layout.place(int(lesser[row]))} at most {layout.place(int(greater[row]))}"

    def _places(self, layout: Layout) -> tuple[Integers, Integers]:
        return layout.index(self.lesser, self.band), layout.index(self.greater, self.band)


@dataclass(frozen=True)
class GroupAbsorption:
    """least <= S'alpha <= most over a group of materials, in m²; S is that of the first room.

    When to use it: when the total of a group is known better than its members, such as all seating
    from a table of audience absorption.

    Parameters
    ----------
    materials : sequence of str
    least, most : float, optional
        m²; at least one of them.
    band : float, optional
        Only this band, by its centre frequency in Hz.
    """

    materials: Sequence[str]
    least: float | None = None
    most: float | None = None
    band: float | None = None

    def __post_init__(self) -> None:
        materials = checks.texts("GroupAbsorption: materials", self.materials)
        object.__setattr__(self, "materials", materials)
        given = [
            checks.number(f"GroupAbsorption: {name}", v)
            for name, v in (("least", self.least), ("most", self.most))
            if v is not None
        ]
        ordered = given == sorted(given) and np.isfinite(given).all()
        if not (materials and given and ordered and given[0] >= 0):
            raise DataError(
                f"GroupAbsorption: materials = {materials}, least = {self.least}, most = "
                f"{self.most} m²; give at least one material, and least or most or both with 0 "
                "<= least <= most"
            )

    def __call__(self, m: Model) -> list[Any]:
        """One or two inequalities per band, or one equality if the two limits are the same."""
        layout = m.layout
        members = sorted({int(layout.index(of)[0]) // layout.n_bands for of in self.materials})
        for name, row in zip(layout.materials, layout.alpha_rows, strict=True):
            if row in members and name not in self.materials:
                raise ModelError(
                    f'GroupAbsorption: "{name}" shares its coefficients with a material of '
                    "the group; add it to the group"
                )
        area = m.group_area(members, 0)[self._bands(layout)]
        if self.least == self.most:
            return [area == self.least]
        return [
            *([] if self.least is None else [area >= self.least]),
            *([] if self.most is None else [area <= self.most]),
        ]

    def label(self, row: int, layout: Layout) -> str:
        """Return the group and the band."""
        band = bands.label(layout.centre_frequencies[self._bands(layout)[row]])
        return f"absorption of {', '.join(self.materials)} at {band} (m²)"

    def _bands(self, layout: Layout) -> Integers:
        return layout.index(layout.materials[0], self.band) % layout.n_bands
