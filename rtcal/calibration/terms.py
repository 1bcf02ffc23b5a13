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
from rtcal.support.types import Array, put

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
"""Smallest relative uncertainty of T for a soft match. With a smaller one rounding decides alpha."""


class Model:
    """Unknowns and numbers of a calibration as cvxpy expressions, with which you write your own terms.

    `rtcal.Calibration` makes the model and calls your functions with it. A function that returns an
    expression to be minimised, such as ``lambda m: cp.sum_squares(m.deviation)``, is a term of the
    objective. A function that returns a list of cvxpy constraints is a constraint.

    Attributes
    ----------
    layout : Layout
        Order of the unknowns: materials, bands, configurations, and names of `AddedAbsorption` terms.
    x : variable (n_materials * n_bands,)
        Deviation (alpha - mu) / sigma of each coefficient from the input mu, material by material.
        Materials that share their coefficients (`Shared`) count as one material. Where sigma = 0 the
        coefficient is mu.
    deviation : expression (n_materials, n_bands)
        The same deviations ``x``, by material and band.
    effects : variable (n_effects,), optional
        Deviation (size - mean) / sigma of the size of each `AddedAbsorption`; None without such terms.
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
        """Return a cvxpy parameter for your expression, with a value that changes between solves.

        ``shape`` is the parameter's shape, () for a number. Before each solve, its value is set to
        ``compute(numbers)``: a function of the values of room and measurement, such as ``numbers.time``
        (`rtcal.calibration.unknowns.Numbers`).
        """
        parameter = cp.Parameter(shape)
        self.parameters.append((parameter, compute))
        return parameter

    def by_band(self, compute: Callable[[Numbers], Any]) -> Any:
        """Return a cvxpy parameter, (n_configurations, n_bands), as `parameter` with this shape.

        ``compute`` is the function that returns the values, as for `parameter`.
        """
        return self.parameter((self.layout.n_configurations, self.layout.n_bands), compute)

    def defined(self, expression: Any) -> Any:
        """Return a new cvxpy variable that is constrained to equal an expression.

        ``expression`` is any linear expression, such as `alpha`. An expression that depends on room or
        measurement must not be multiplied by a `parameter` p, because cvxpy would then compile the
        problem anew in each solve. Write ``cp.multiply(p,
        m.defined(expression))`` instead.
        """
        variable = cp.Variable(expression.shape)
        self.definitions.append(variable == expression)
        return variable

    def at_least_zero(self, shape: Any) -> Any:
        """Return a new auxiliary cvxpy variable that is 0 or more.

        ``shape`` is the variable's shape, () for a number.
        """
        variable = cp.Variable(shape)
        self.nonnegative.append(variable)
        return variable

    @cached_property
    def alpha(self) -> Any:
        """Absorption coefficients, (n_materials, n_bands)."""
        shape = self.deviation.shape
        sigma = self.parameter(shape, lambda numbers: numbers.alpha(numbers.sigma))
        mu = self.parameter(shape, lambda numbers: numbers.alpha(numbers.mu))
        return product(sigma, self.deviation) + mu

    @cached_property
    def absorption_area(self) -> Any:
        """Absorption area of materials and effects in m², (n_configurations, n_bands); 0 without T."""
        return self._area(lambda numbers: np.where(numbers.matched, 1.0, 0.0))

    @cached_property
    def target(self) -> Any:
        """Absorption area in m² that the measured T needs, (n_configurations, n_bands); 0 without T."""
        return self.by_band(lambda numbers: np.where(numbers.matched, numbers.target, 0.0))

    @cached_property
    def misfit(self) -> Any:
        """Deviation of the absorption area from that of the measured T, in its standard uncertainties.

        It is (S'alpha - b) / u_b, (n_configurations, n_bands), and 0 in a band without T: S'alpha is
        the absorption area, b the area that T needs, and u_b its standard uncertainty.
        """

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
        """Return the absorption area in m² of some materials in one configuration, (n_bands,).

        ``rows`` are rows of `deviation` and ``configuration`` is a number from 0. ``scale`` returns a
        factor of the area, (n_bands,) or one number, from the values of room and measurement.
        """
        chosen = list(rows)
        x = self.deviation if len(chosen) == self.layout.n_alpha_rows else self.deviation[chosen]

        def area(numbers: Numbers, values: Array) -> Array:
            areas = numbers.areas[configuration, chosen, np.newaxis]
            return np.asarray(areas * numbers.alpha(values)[chosen] * scale(numbers))

        steep = self.parameter(x.shape, lambda numbers: area(numbers, numbers.sigma))
        stated = self.parameter(x.shape[1], lambda numbers: area(numbers, numbers.mu).sum(axis=0))
        return cp.hstack([steep[:, k] @ x[:, k] for k in range(self.layout.n_bands)]) + stated


def product(factors: Any, x: Any) -> Any:
    """Return the elementwise product of a cvxpy parameter and a cvxpy expression of the same shape.

    ``factors`` is the parameter and ``x`` the expression. The product is made in blocks of 40 rows to
    save memory, because cvxpy compiles a product of n factors with n² numbers.
    """
    blocks = range(0, x.shape[0], 40)
    return cp.vstack([cp.multiply(factors[i : i + 40], x[i : i + 40]) for i in blocks])


def _half_squares(expression: Any) -> Any:
    """Return half the sum of squares of a cvxpy expression."""
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
    """Weighted sum of objective terms."""

    terms: tuple[AnyTerm, ...]
    weights: tuple[float, ...]


class Term(_Summand, ABC):
    """Base class of objective terms, which are added with ``+`` and weighted with ``*``.

    `rtcal.Calibration` minimises such a sum, as ``PriorDeviation() + 0.3 * BandSmoothness()``. A
    function of a `Model` that returns a cvxpy expression can be added to a term, too.
    """

    is_prior: ClassVar[bool] = False
    """Whether the term keeps coefficients near the input; a calibration has exactly one such term."""
    in_numbers: ClassVar[Mapping[str, Any]] = {}
    """Fields that may change without compiling anew, with their values in the compiled problem."""

    @abstractmethod
    def __call__(self, m: Model) -> Any:
        """Return the cvxpy expression to be minimised."""

    def convexity(self, numbers: Numbers) -> float:
        """Return a lower limit of the term's curvature, with the values ``numbers``; 0 if unknown.

        The curvature is the least eigenvalue of the second derivatives by the deviations `Model.x`.
        ``numbers`` are the values of room and measurement.
        """
        return 0.0

    def structure(self) -> Term:
        """Return a copy of the term without the numbers that may change in a compiled problem.

        Terms with equal copies share one compiled problem.
        """
        alike = copy.copy(self)
        vars(alike).update(self.in_numbers)
        return alike


def as_objective(term: Any) -> Objective:
    """Return a term, or a sum of terms, as an `Objective`; ModelError for any other value."""
    if isinstance(term, Objective):
        return term
    if isinstance(term, type):
        raise ModelError(f"{term.__name__} is a class, not a term: write {term.__name__}()")
    if callable(term):
        return Objective((term,), (1.0,))
    raise ModelError(f"{term!r} is not an objective term: give a function of an rtcal.terms.Model")


@dataclass(frozen=True)
class PriorDeviation(Term):
    """Objective term that keeps coefficients near the input: half the squared deviations in sigmas.

    The term is ½ x'R⁻¹x with x = (alpha - mu) / sigma, the input coefficients mu, and the correlation R
    of their errors.

    When to use it: always, or `HuberDeviation` in its place. With `ExactMatch` and no correlation it
    gives the maximum-likelihood estimate of Bellows & Katz (2025), Eq. 19, and with
    ``PriorDeviation(sigma=1)`` their least-squares estimate (Eq. 7). Give correlations where errors go
    together: a data sheet that is too low at 500 Hz is likely too low at 1 kHz. With exact matches, a
    band correlation may change no coefficient (docs/modelling.md gives the conditions).

    Parameters
    ----------
    sigma : float, optional
        One standard deviation for all coefficients in place of the room's, above 0. Coefficients with
        sigma = 0 in the room stay exact.
    band_correlation : float
        Correlation r, below 1, of errors in bands an octave apart; bands n octaves apart have r ** n.
    material_correlation : mapping of pairs to float
        Correlation of two materials' errors in the same band: ``{("door", "panel"): 0.7}``.
    common : bool
        Whether all coefficients may be too high or too low together, by the room's
        ``common_alpha_sigma`` t: the covariance is then sigma R sigma + t² mu mu'.

    Raises
    ------
    ModelError
        For a band correlation that is not below 1, or (when built) a correlation of materials that is
        not positive definite.
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
        put(self, material_correlation=_pairs(self.material_correlation))

    @property
    def correlated(self) -> bool:
        """Whether errors of different coefficients are correlated: by band, material, or in common."""
        return bool(self.band_correlation or self.material_correlation or self.common)

    def __call__(self, m: Model) -> Any:
        """½ x'R⁻¹x; with a common part t, ½ (x - q t)'R⁻¹(x - q t) + ½ t²."""
        x, of_common, n = m.x, 0.0, m.layout.n_alpha
        if self.common:
            together = cp.Variable()
            of_common = _half_squares(together)
            shift = m.parameter(
                n, lambda numbers: (numbers.common_shift * numbers.inverse_sigma)[:n]
            )
            x = m.defined(x - shift * together)
        return 0.5 * cp.quad_form(x, _correlation(self, m.layout)[1], assume_PSD=True) + of_common

    def convexity(self, numbers: Numbers) -> float:
        """Return a lower limit of the term's curvature, 1 over the largest eigenvalue of R.

        With ``common``, the largest eigenvalue of t² mu mu' in units of sigma is added to that of R.
        ``numbers`` are the values of room and measurement.
        """
        q = numbers.common_shift * numbers.inverse_sigma
        largest = _correlation(self, numbers.layout)[2]
        return float(1 / (largest + (q @ q if self.common else 0.0)))

    def correlate(self, columns: Array, layout: Layout) -> Array:
        """Return R @ columns, (size, n), where R is the correlation of the errors of all unknowns.

        ``columns`` (size, n) has one row per unknown, in the order of ``layout``: the coefficients, and
        the sizes of `AddedAbsorption` terms, whose errors are independent.
        """
        root, *_ = _correlation(self, layout)
        alpha = root @ (root.T @ columns[: layout.n_alpha])
        return np.concatenate([alpha, columns[layout.n_alpha :]])


def _pairs(stated: Any) -> tuple[Any, ...]:
    """Correlations of materials as a tuple: a term is hashable, so that its problem is found again."""
    pairs = stated
    if not isinstance(pairs, tuple):
        pairs = tuple(checks.mapped("material_correlation", pairs).items())
    for pair, r in pairs:
        if not (isinstance(pair, tuple) and len(pair) == 2):
            raise DataError(
                f"material_correlation: each key must be a pair of materials, but one is {pair!r}"
            )
        checks.number(f"material_correlation of {pair}", r)
    return pairs


def _root_of_materials(pairs: tuple[Any, ...], layout: Layout) -> Array:
    """A root of the materials' correlation; of one material where no pair has any."""
    correlation = np.eye(layout.n_alpha_rows if pairs else 1)
    for (a, b), r in pairs:
        i, j = (layout.index(name)[0] // layout.n_bands for name in (a, b))
        if i == j:
            raise ModelError(
                f'material_correlation: "{a}" and "{b}" share their coefficients, so they cannot '
                "have a correlation; leave this pair out"
            )
        correlation[i, j] = correlation[j, i] = r
    try:
        return np.asarray(np.linalg.cholesky(correlation))
    except np.linalg.LinAlgError as error:
        raise ModelError(
            "material_correlation is not positive definite: its values contradict each "
            "other; make the correlations smaller"
        ) from error


@functools.lru_cache(maxsize=16)
def _correlation(term: PriorDeviation, layout: Layout) -> tuple[Any, Any, float]:
    """A root of R (of materials times of bands), the inverse of R, and its largest eigenvalue."""
    of_bands = bands.correlation(np.array(layout.centre_frequencies), term.band_correlation)
    roots: list[Any] = [
        _root_of_materials(term.material_correlation, layout),
        np.linalg.cholesky(of_bands),
    ]
    # Where no materials are correlated, each has the same part.
    alike = sp.eye_array(layout.n_alpha_rows // len(roots[0]))
    root = sp.csr_array(sp.kron(alike, sp.kron(*roots)))
    whitener = sp.csr_array(sp.kron(alike, sp.kron(*map(np.linalg.inv, roots))))
    inverse = sp.csr_array(whitener.T @ whitener)
    inverse.eliminate_zeros()
    return root, inverse, float(np.prod([np.linalg.norm(part, 2) for part in roots]) ** 2)


@dataclass(frozen=True)
class HuberDeviation(Term):
    """Objective term that keeps coefficients near the input, but allows few of them to be far from it.

    The term is the sum of e x²/2 + (1 - e) h(x) over x = (alpha - mu) / sigma, with h(x) = x²/2 for |x|
    <= t and t |x| - t²/2 beyond (Huber 1964, Eq. 2.4). e = 0.01 makes the answer unique.

    When to use it: when some sigma may be wrong, as when a material was taken for another one. One
    coefficient may then move far from its input, so that the others need not move.

    Parameters
    ----------
    threshold : float
        Deviation t in sigmas, above 0, beyond which a coefficient counts as an outlier.
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
        near = _half_squares(m.x - above + below) + self.threshold * beyond
        return self.convex * _half_squares(m.x) + (1 - self.convex) * near

    def convexity(self, numbers: Numbers) -> float:
        """Return e = 0.01, the lower limit of the term's curvature, for any ``numbers``."""
        return self.convex


@dataclass(frozen=True)
class ExactMatch:
    """Constraint that the coefficients give the measured T exactly, in every band that has one.

    The constraint is S'alpha = b: the absorption area equals that of T (Bellows & Katz 2025, Eq. 4).

    When to use it: when the uncertainty of T is not known. Errors of T then change the coefficients,
    which `SoftMatch` avoids.
    """

    def __call__(self, m: Model) -> list[Any]:
        """One equality per configuration and band."""
        return [m.absorption_area == m.target]

    def target_limits(self, numbers: Numbers) -> tuple[Array, Array]:
        """Return the least and the largest absorption area in m² that this match allows.

        Both arrays are (n_configurations, n_bands) and equal: an exact match allows only the absorption
        area that the measured T needs. ``numbers`` are the values of room and measurement.
        """
        return numbers.target, numbers.target

    def label(self, row: int, layout: Layout) -> str:
        """Return the text for messages by which a user knows the matched band.

        ``row`` is the band's number from 0, counted over all bands of all configurations, and
        ``layout`` the order of the unknowns.
        """
        return f"exact match of T at {layout.band_label(row)} (m² of absorption)"


@dataclass(frozen=True)
class MatchWithin(ExactMatch):
    """Constraint that T is within a tolerance of the measured T, in every band that has one.

    When to use it: when nobody would hear a smaller deviation, so that coefficients should not change
    for it. The calibrated coefficients are the nearest to the input that give a T within the tolerance.

    Parameters
    ----------
    jnd : float
        Tolerance of T in just noticeable differences of 5 %, above 0 and below 20.
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
        """Return the least and the largest absorption area in m² that this match allows.

        They are those of the longest and of the shortest T within the tolerance, (n_configurations,
        n_bands) each. Where no coefficients reach the measured T, the tolerance is widened to the
        nearest T that they reach. ``numbers`` are the values of room and measurement.
        """
        tolerance = TARGET.jnd * self.jnd
        low, high = (numbers.target_of(numbers.time * (1 + s * tolerance)) for s in (1, -1))
        # A T so short that no b gives it: the equation's largest b is the limit.
        beyond = np.isfinite(numbers.time) & np.isnan(high)
        high = np.where(beyond, numbers.largest_target, high)
        return np.fmin(low, numbers.target), np.fmax(high, numbers.target)

    def label(self, row: int, layout: Layout) -> str:
        """Return the text for messages by which a user knows the matched band.

        ``row`` is the band's number from 0, counted over all bands of all configurations, and
        ``layout`` the order of the unknowns.
        """
        return f"match of T within {self.jnd:g} JND at {layout.band_label(row)} (m² of absorption)"


@dataclass(frozen=True)
class SoftMatch(Term):
    """Objective term that matches T within its uncertainty, so that errors of T change alpha less.

    The term is ½ sum ((S'alpha - b) / u_b)², with the absorption area S'alpha, the area b that T needs,
    and its standard uncertainty u_b = |db/dT| u_T. docs/modelling.md compares it with other terms.

    When to use it: whenever the uncertainty of T is known, and always for several configurations. The
    sum ``PriorDeviation() + SoftMatch()`` has its minimum at the most probable coefficients.

    With ``room=True`` the term is ½ r'C⁻¹r, r = b - S'alpha. C is the covariance of r in all bands from
    the uncertainties of T and of the room's volume, areas and climate
    (`rtcal.acoustics.room_errors.target_changes`, docs/uncertain_room.md). An error of the volume,
    which is the same in all bands, then changes the coefficients less.

    Parameters
    ----------
    relative : float, optional
        Relative uncertainty u_T / T, at most 1, for bands whose measurement states none. Without it
        such bands raise an error.
    room : bool
        Whether the room's ``volume_sigma``, ``area_sigma`` and ``climate_sigma`` count. In a room that
        states them, `rtcal.calibrate` sets it for every method but ``lse``.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> objective = rt.terms.PriorDeviation() + SoftMatch(room=True)
    >>> problem = rt.Calibration(objective).build(room.replace(volume_sigma=0.05))
    >>> problem.solve(measured).gap_after.round(1)  # calibrated T minus measured T, in JND of 5 %
    array([1.9, 0.3, 0.4, 0.4, 0.4, 0.3])
    """

    relative: float | None = None
    room: bool = False

    in_numbers: ClassVar[Mapping[str, Any]] = {"relative": None}

    def __post_init__(self) -> None:
        u = self.relative
        checks.flag("SoftMatch: room", self.room)
        if u is not None and not 0 < checks.number("SoftMatch: relative", u) <= 1:
            percent = checks.IN_PERCENT if 1 < u <= 100 else ""
            raise DataError(f"SoftMatch: relative = {u:g} must be above 0 and at most 1{percent}")

    def __call__(self, m: Model) -> Any:
        """½ |(S'alpha - b) / u_b|²; with ``room`` ½ |W (S'alpha - b)|², W'W = C⁻¹."""
        if not self.room:
            return _half_squares(m.misfit)
        n = m.layout.n_configurations * m.layout.n_bands

        def whitener(numbers: Numbers) -> Array:  # of the misfit, whose unit is u_b
            return numbers.match_whitener * np.nan_to_num(numbers.target_uncertainty).ravel()

        return _half_squares(m.parameter((n, n), whitener) @ cp.vec(m.misfit, order="C"))

    def uncertainty(self, numbers: Numbers) -> Array:
        """Return the standard uncertainty in m² of the absorption area that T needs.

        The uncertainty u_b = |db/dT| u_T is (n_configurations, n_bands). Raises DataError if the
        uncertainty of T is unknown or 0. ``numbers`` are the values of room and measurement.
        """
        u = numbers.target_uncertainty
        unknown = numbers.matched & ~np.isfinite(u)
        if self.relative is not None and unknown.any():
            u = np.where(unknown, self.relative * numbers.time * numbers.target_sensitivity, u)
        unstated, remedy = "0", "give the measured uncertainty, or leave it out"
        if self.relative is None:
            unstated = "unknown or 0"
            remedy = "give it with the measurement, or give the term's `relative` one"
        for bad, message in (
            (
                np.isinf(u),
                "T[{band}] = {time:.4g} s is the shortest T of the equation, where T "
                "does not determine the absorption. Use another equation, or leave out "
                "the band",
            ),
            (
                ~(u > 0),
                f"the uncertainty of T[{{band}}] is {unstated}, but a soft match weights T by "
                f"it: {remedy}",
            ),
            (
                u < SMALLEST_UNCERTAINTY * np.abs(numbers.target),
                "the uncertainty of T[{band}] is below a millionth of T, which no "
                "measurement reaches: give the measured uncertainty, or leave it out and "
                "use method mle",
            ),
        ):
            if (wrong := numbers.matched & bad).any():
                row = int(np.flatnonzero(wrong.ravel())[0])
                band, time = numbers.layout.band_label(row), numbers.time.ravel()[row]
                raise DataError(message.format(band=band, time=time))
        return np.where(numbers.matched, u, np.nan)


@dataclass(frozen=True)
class LinearObservations(Term):
    """Objective term for measured values, other than T, that depend linearly on the coefficients.

    The term is ½ (y - J alpha)' C⁻¹ (y - J alpha), with the values y, their derivatives J by alpha and
    the covariance C of their errors. Give y, J and C as an `Observed` to the problem that
    `rtcal.Calibration.build` returns: ``problem.solve(measured, observed={term: Observed(...)})``.

    When to use it: where you have such values, as `rtcal.calibrate_positions` has for each position.
    They determine more of alpha than one T per band. Give the term no weight, because C has it.

    Parameters
    ----------
    name : str
        Name of the term, which distinguishes several of them.

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
        return _half_squares(both[:, :n] @ m.x - both[:, n])


@dataclass(frozen=True)
class BandSmoothness(Term):
    """Objective term that keeps the changes of a material's coefficients similar in neighbouring bands.

    The term is ½ sum (x_k+1 - x_k)² / d_k over bands k and materials, with the deviation x = (alpha -
    mu) / sigma from the input and d_k octaves between bands k and k+1. If materials are correlated, the
    sum of squares over the materials becomes s'R⁻¹s, with their steps s and their correlation R.

    When to use it: with `SoftMatch` or bands without T, when a material's error is expected to change
    slowly over frequency. The term smooths the change and not alpha, so that a resonant absorber
    keeps its peak. Begin with the weight 0.3. With exact matches the term may change no coefficient
    (docs/modelling.md gives the conditions).

    Parameters
    ----------
    material_correlation : mapping of pairs to float
        Correlation of two materials' errors, as in `PriorDeviation`.
    """

    material_correlation: Any = ()

    def __post_init__(self) -> None:
        put(self, material_correlation=_pairs(self.material_correlation))

    def __call__(self, m: Model) -> Any:
        """½ |differences|²; coefficients with sigma = 0 stand apart."""
        if m.layout.n_bands < 2:
            raise ModelError("BandSmoothness needs a room with two bands or more")
        octaves = np.diff(np.log2(np.array(m.layout.centre_frequencies)))

        def steep(numbers: Numbers) -> Array:
            moves = numbers.alpha(numbers.sigma) > 0
            return np.asarray((moves[:, 1:] & moves[:, :-1]) / np.sqrt(octaves))

        factor = m.parameter((m.layout.n_alpha_rows, m.layout.n_bands - 1), steep)
        steps = product(factor, cp.diff(m.deviation, axis=1))
        if self.material_correlation:
            steps = np.linalg.inv(_root_of_materials(self.material_correlation, m.layout)) @ steps
        return _half_squares(steps)


@dataclass(frozen=True)
class AddedAbsorption(Term):
    """Objective term that adds absorption of unknown size and known spectrum to the room.

    The size theta >= 0 is calibrated with the coefficients, and theta times ``gain`` is added to the
    absorption area. The term is ½ ((theta - mean) / sigma)² (docs/modelling.md).

    When to use it: when something other than the listed materials absorbs, such as an opening,
    furniture or an audience.

    Parameters
    ----------
    name : str
        Name of the added absorption.
    gain : sequence (n_bands,) or (n_configurations, n_bands)
        Absorption area in m² that the size theta = 1 adds in each band.
    sigma : float
        Standard deviation of theta before the calibration, above 0.
    mean : float
        Expected theta before the calibration.
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
        put(self, gain=frozen)

    def __call__(self, m: Model) -> Any:
        """½ ((theta - mean) / sigma)²."""
        return _half_squares(m.effects[m.layout.further.index(self.name)])

    def gains(self, n_configurations: int, n_bands: int) -> Array:
        """Return the gain in m², (n_configurations, n_bands); ModelError if its shape does not fit."""
        gain = np.array(self.gain)
        if gain.shape[1] != n_bands or gain.shape[0] not in (1, n_configurations):
            raise ModelError(
                f'AddedAbsorption("{self.name}"): gain has shape {gain.shape}; it must be '
                f"({n_configurations}, {n_bands}): configurations and bands"
            )
        return np.broadcast_to(gain, (n_configurations, n_bands))


@dataclass(frozen=True)
class Bounds:
    """Constraint that coefficients are within bounds, for all or some materials and bands.

    When to use it: where physics or a data sheet gives limits tighter than 0 to 1.

    Parameters
    ----------
    lower, upper : float, optional
        Bounds of the coefficients; None stands for the input coefficient.
    material : str, optional
        Material that the bounds are for; all materials by default.
    band : float, optional
        Centre frequency in Hz of the band that the bounds are for; all bands by default.
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
        """Return the lower and the upper bound for coefficients whose input values are ``mu``."""
        return [mu if end is None else end for end in (self.lower, self.upper)]


class Fixed(Bounds):
    """Constraint that coefficients of a material do not change in the calibration.

    When to use it: for a material that was measured in the laboratory, or whose result must stay
    comparable. The coefficients are the same as with sigma = 0 in the room, but sigma still counts in
    the plausibility, in correlations with other bands, and in the coefficients' uncertainty.

    Parameters
    ----------
    material : str
        Name of the material.
    value : float, optional
        Value of the coefficients; the input coefficients by default.
    band : float, optional
        Centre frequency in Hz of the only band that is fixed; all bands by default.
    """

    def __init__(
        self, material: str, value: float | None = None, band: float | None = None
    ) -> None:
        super().__init__(value, value, material, band)


@dataclass(frozen=True)
class Shared:
    """Constraint that several materials have the same coefficients: ``Shared("wall", "wall 2")``.

    When to use it: when one material has several names. The materials become one, with the sum of their
    areas, and their input coefficients, which must be equal, count once.

    ``materials`` are the names of the room's materials, two or more.
    """

    materials: tuple[str, ...]

    def __init__(self, *materials: str) -> None:
        if len(set(checks.texts("Shared: material", materials))) < 2:
            raise DataError("Shared needs at least two different materials")
        put(self, materials=materials)


@dataclass(frozen=True)
class AtMost:
    """Constraint that a material absorbs at most as much as another: ``AtMost("glazing", "curtain")``.

    When to use it: when the order of two coefficients is certain, but not their values.

    Parameters
    ----------
    lesser, greater : str
        Names of the less and of the more absorbing material.
    band : float, optional
        Centre frequency in Hz of the only band that the constraint is for; all bands by default.
    """

    lesser: str
    greater: str
    band: float | None = None

    def __post_init__(self) -> None:
        checks.texts("AtMost: material", (self.lesser, self.greater))
        if self.lesser == self.greater:
            raise DataError(
                f'AtMost compares "{self.lesser}" with itself; name two different materials'
            )

    def __call__(self, m: Model) -> list[Any]:
        """One inequality per band."""
        alpha = cp.vec(m.alpha, order="C")
        lesser, greater = (alpha[places] for places in self._places(m.layout))
        return [lesser <= greater]

    def label(self, row: int, layout: Layout) -> str:
        """Return the text for messages by which a user knows one inequality of this constraint.

        ``row`` is the number of the inequality, from 0: one for each band, in the order of the bands.
        ``layout`` is the order of the unknowns.
        """
        lesser, greater = self._places(layout)
        return f"{layout.place(int(lesser[row]))} at most {layout.place(int(greater[row]))}"

    def _places(self, layout: Layout) -> tuple[Integers, Integers]:
        return layout.index(self.lesser, self.band), layout.index(self.greater, self.band)


@dataclass(frozen=True)
class GroupAbsorption:
    """Constraint that the absorption area of a group of materials is within limits.

    When to use it: when the total of a group is known better than each material, such as that of all
    seating. For several configurations the areas are those of the first.

    Parameters
    ----------
    materials : sequence of str
        Names of the materials of the group.
    least, most : float, optional
        Limits of the absorption area in m²; give at least one.
    band : float, optional
        Centre frequency in Hz of the only band that the constraint is for; all bands by default.
    """

    materials: Sequence[str]
    least: float | None = None
    most: float | None = None
    band: float | None = None

    def __post_init__(self) -> None:
        materials = checks.texts("GroupAbsorption: materials", self.materials)
        put(self, materials=materials)
        given = [
            checks.number(f"GroupAbsorption: {name}", v)
            for name, v in (("least", self.least), ("most", self.most))
            if v is not None
        ]
        ordered = given == sorted(given) and np.isfinite(given).all()
        if not (materials and given and ordered and given[0] >= 0):
            raise DataError(
                f"GroupAbsorption: materials = {materials}, least = {self.least} m², most "
                f"= {self.most} m². Give at least one material, and least, most or both; "
                "0 <= least <= most must hold"
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
        """Return the text for messages by which a user knows the group and the limited band.

        ``row`` is the number of the limited band, from 0, and ``layout`` the order of the unknowns.
        """
        band = bands.label(layout.centre_frequencies[self._bands(layout)[row]])
        return f"absorption of {', '.join(self.materials)} at {band} (m²)"

    def _bands(self, layout: Layout) -> Integers:
        return layout.index(layout.materials[0], self.band) % layout.n_bands
