"""The cheapest treatments that meet a range of T with a stated probability.

    minimise c'x  subject to  0 <= x <= largest,  G x <= h,  z_k(x) >= 0 in every band k,
    and x_j a whole number of panels where a treatment has panels.

z_k is the margin of a band, ndtri(P_k(x)) - ndtri(p), of the probability P_k that a prediction states.
Where p is well above one half, the areas that keep the margins are a convex set, but for a little. Then
the method of supporting planes finds the cheapest (Veinott 1967; with whole numbers Kronqvist, Lundell
& Westerlund 2016): the linear program's answer that misses a margin is joined to areas that keep all of
them, and the plane that touches the margin where the line crosses it is added. Each linear program is a
relaxation, so its first answer that keeps all margins is the cheapest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from rtcal.acoustics import bands
from rtcal.acoustics.changes import Target, Treatment, check_treatments, name_of
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.files.saved import Result
from rtcal.prediction import words
from rtcal.prediction.changed_time import KnownRoom
from rtcal.prediction.predicted import Known, Prediction, known_room, predict
from rtcal.support import checks
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError, InfeasibleError, SolverError
from rtcal.support.text import listed, shortened
from rtcal.support.types import Array

LEAST = 0.8
"""Smallest probability that a design may require, because the search is reliable only from there."""
Margins = Callable[[Array], Array]
"""Function that returns the margins (n_margins,) of areas in m² (n_treatments,); 0 or more is
enough."""

_KEEPS = -2e-4
"""Margin in standard deviations that counts as kept: 0.00004 of a probability."""
_PLANES = 60
"""Most planes; two treatments need about five."""
_STEP = 1e-4
"""Step of the derivatives, in shares of a treatment's largest area."""
_WELL = 0.1
"""Margin from which an inner point is not improved."""
_LEAST_AREA = 1e-4
"""What a square metre adds to its cost, in shares of the dearest: of designs of one cost the one with
less area is taken. With a smaller share the linear program's tolerance, 1e-7, would hide small panels
that cost nothing."""
_ROUNDING = 1e-6
_CUTS = 1e-3
"""Least sine of the angle between a plane and the line that it crosses."""
_HALVINGS, _TOUCHES = 60, 1e-4
"""Most steps to the edge of the areas that keep the margins, and the margin that counts as on it."""
_SPARE = 0.005
"""Least margin of an answer, some of whose areas are above their least, that is searched once more."""


@dataclass(frozen=True, eq=False)
class Choice:
    """Hold the treatments that may be placed, and the ranges of T to keep, as a search for areas."""

    cost: Array  # per m²
    largest: Array  # m²
    unit: Array  # m² of one panel, NaN where any area may be had
    covers: Array  # 1 where a treatment covers a surface, else 0, (n_surfaces, n_treatments)
    surfaces: Array  # their areas in m², (n_surfaces,)
    margins: Margins

    @cached_property
    def whole(self) -> NDArray[np.bool_]:
        """Whether each treatment consists of whole panels, (n_treatments,)."""
        return np.isfinite(self.unit)

    @cached_property
    def size(self) -> Array:
        """Area in m² of one unit of each unknown: one panel, or a treatment's largest area."""
        return np.where(self.whole, self.unit, self.largest)

    @cached_property
    def most(self) -> Array:
        """Largest value of each unknown, (n_treatments,)."""
        return np.where(self.whole, np.floor(self.largest / self.size + _ROUNDING), 1.0)

    @cached_property
    def _rows(self) -> Array:
        """Share of each surface that 1 of the unknowns covers, (n_surfaces, n_treatments)."""
        return self.covers * self.size / self.surfaces[:, np.newaxis]

    def at(self, v: Array) -> Array:
        """Return the margins of the ranges for given unknowns, (n_margins,)."""
        return self.margins(v * self.size)

    def price(self, v: Array) -> float:
        """Return the cost of given unknowns."""
        return float(self.cost @ (v * self.size))

    def widest(self, enough: float = np.inf) -> tuple[Array, float]:
        """Return the unknowns for which the smallest margin of the ranges is largest, and that margin.

        The unknowns are numbers of panels, not necessarily whole, or shares of a treatment's largest
        area. The search ends when the margin is at least ``enough``.
        """
        from scipy.optimize import minimize
        from scipy.stats import qmc

        scale = np.maximum(self.most, 1e-12)

        def within(share: Array) -> Array:
            v = np.clip(share, 0, 1) * scale
            over = float(np.max(self._rows @ v, initial=0.0))
            return v / over if over > 1 else v

        n = len(scale)
        best = np.zeros(n), float(self.at(np.zeros(n)).min())

        def kept(share: Array) -> Array:
            """Margins of shares; the best so far stays, wherever a search ends."""
            nonlocal best
            v = within(share)
            at = self.at(v)
            best = max(best, (v, float(at.min())), key=lambda each: each[1])
            return at

        alike = np.array([0.5, 0.75, 0.25, 0.9, 0.1, 1.0])[:, np.newaxis] * np.ones(n)
        even = qmc.Sobol(n, seed=np.random.default_rng(0)).random(16)  # fills the unit cube evenly
        for share in (*alike, *even):
            if best[1] >= enough:
                return best
            kept(share)
        if best[1] >= enough:
            return best
        minimize(
            lambda s: -s[-1],
            np.append(best[0] / scale, best[1]),
            jac=lambda s: np.append(np.zeros(n), -1.0),
            bounds=[*[(0.0, 1.0)] * n, (None, None)],
            constraints=[
                {"type": "ineq", "fun": lambda s: kept(s[:-1]) - s[-1]},
                {"type": "ineq", "fun": lambda s: 1 - self._rows @ (s[:-1] * scale)},
            ],
            method="SLSQP",
            options={"maxiter": 40, "ftol": 1e-5, "eps": _STEP},
        )
        return best

    def cheapest(self) -> Array | None:
        """Return the cheapest areas in m², (n_treatments,), that keep all margins; None if none do."""
        box = np.zeros(len(self.most)), self.most
        inside, margin = self.widest(_WELL)
        if margin <= _KEEPS:
            return None
        found = self._in_part(box, inside, np.inf)
        return None if found is None else self._less(box, found) * self.size

    def _in_part(self, box: tuple[Array, Array], inside: Array, most: float) -> Array | None:
        """Return the cheapest unknowns of a part; None if none do at less than ``most``.

        Raises SolverError where `_PLANES` planes do not find them.
        """
        planes: list[tuple[Array, float]] = []
        for whole in (False, True) if self.whole.any() else (False,):
            while True:
                v = self._relaxed(box, planes, whole)
                if v is None or self.price(v) >= most:
                    return None
                if float(self.at(v).min()) >= _KEEPS:
                    break
                if len(planes) == _PLANES:
                    raise SolverError(f"no design was found with {_PLANES} supporting planes")
                planes.append(self._touching(inside, v))
        return v

    def _less(self, box: tuple[Array, Array], v: Array) -> Array:
        """Return unknowns, with less of what may be of any area where they keep every margin by far.

        Planes that cut off what keeps the margins leave too much: new ones stand for these panels.
        """
        low, high = (np.where(self.whole, v, end) for end in box)
        if not (v > low).any() or float(self.at(v).min()) <= _SPARE:
            return v
        try:
            found = self._in_part((low, high), v, self.price(v))
        except SolverError:  # what was found keeps every margin, too
            return v
        return v if found is None else found

    def _relaxed(
        self, box: tuple[Array, Array], planes: list[tuple[Array, float]], whole: bool
    ) -> Array | None:
        """Return the cheapest unknowns that keep the planes; None if there are none."""
        from scipy.optimize import Bounds, LinearConstraint, milp

        price = self.cost / max(float(self.cost.max()), 1e-300) + _LEAST_AREA
        rows = [self._rows, *(gradient[np.newaxis] for gradient, _ in planes)]
        lower = [*[-np.inf] * len(self._rows), *(level for _, level in planes)]
        upper = [*[1.0] * len(self._rows), *[np.inf] * len(planes)]
        found = milp(
            price * self.size / np.max(price * self.size),
            integrality=self.whole & whole,
            bounds=Bounds(*box),
            constraints=LinearConstraint(np.vstack(rows), lower, upper),
            options={"mip_rel_gap": 1e-7},
        )
        if found.status == 2:
            return None
        if found.x is None:
            raise SolverError(f"the design's linear program was not solved: {found.message}")
        v = np.clip(np.where(self.whole & whole, np.round(found.x), found.x), *box)
        over = float(np.max(self._rows @ v, initial=0.0))  # the solver's tolerance
        return np.asarray(np.where(self.whole & whole, v, v / max(over, 1.0)))

    def _touching(self, inside: Array, outside: Array) -> tuple[Array, float]:
        """Return the plane that touches a margin where the line from inside to outside leaves it."""
        v, at = self._edge(inside, outside)
        k = int(np.argmin(at))
        gradient = self._gradient(v, k, float(at[k]))
        length = float(np.linalg.norm(gradient))
        if not gradient @ (outside - v) < -_CUTS * length * float(np.linalg.norm(outside - v)):
            # The margin has an edge here: the plane across the line cuts off what is outside.
            gradient = inside - outside
            length = float(np.linalg.norm(gradient))
        return gradient / length, float(gradient @ v) / length

    def _edge(self, inside: Array, outside: Array) -> tuple[Array, Array]:
        """Return where a line leaves the areas that keep the margins, and the margins there.

        Regula falsi, with the value of an end that stays halved (Illinois). The end of the line that is
        returned keeps the margins.
        """
        near, far, at = inside, outside, self.at(inside)
        ends = [max(float(at.min()), 0.0), float(self.at(outside).min())]
        last = 2
        for _ in range(_HALVINGS):
            if float(at.min()) <= _TOUCHES:
                break
            share = ends[0] / (ends[0] - ends[1])
            v = near + float(np.clip(share, 0.01, 0.99)) * (far - near)
            here = self.at(v)
            side = int(here.min() < 0)
            ends[side] = float(here.min())
            if side == last:
                ends[1 - side] /= 2
            near, far, at = (near, v, at) if side else (v, far, here)
            last = side
        return near, at

    def _gradient(self, v: Array, k: int, here: float) -> Array:
        """Return the derivatives of a margin by the unknowns, (n_treatments,), where it is ``here``."""
        out = np.empty(len(v))
        for j, step in enumerate(_STEP * self.most):
            covered = self._rows @ v + step * self._rows[:, j]
            step = step if v[j] + step <= self.most[j] and (covered <= 1).all() else -step
            out[j] = (self.at(np.where(np.arange(len(v)) == j, v[j] + step, v))[k] - here) / step
        return out


_LEAST, _MOST = 1e-3, 1 - 1e-6
"""Probabilities beyond which a margin is that of a normal ln T: there samples are too few."""
_NONE = 1e-9
"""Areas below this, in shares of a treatment's largest, are 0."""
_MOST_PREDICTIONS = 100
"""Most predictions that are kept."""
_WIDEST, _WIDENED = 100.0, 0.002
"""Largest factor by which a range is widened, and its accuracy."""
_FAR = 50.0
"""Largest margin in standard deviations: where nothing changes, T is exact."""


@dataclass(frozen=True, eq=False)
class DesignModel:
    """Hold the treatments that a room allows, the target, and what is known about the room."""

    known: KnownRoom
    treatments: tuple[Treatment, ...]
    target: Target
    assumptions: Assumptions

    @property
    def before(self) -> Room:
        """Room before the treatment, with its input coefficients."""
        return self.known.room

    @cached_property
    def prices(self) -> Array:
        """Cost of 1 m² of each treatment, (n_treatments,)."""
        return np.array([t.cost for t in self.treatments], dtype=float)

    @cached_property
    def covering(self) -> tuple[Array, Array]:
        """Which treatments cover which surface, (n_surfaces, n_treatments), and its area in m²."""
        names = sorted({t.covers for t in self.treatments if t.covers is not None})
        rows = np.array([[float(t.covers == n) for t in self.treatments] for n in names])
        areas = [float(self.before.areas[self.before.material_index(n)]) for n in names]
        return rows.reshape(len(names), len(self.treatments)), np.array(areas)

    def prediction(self, x: Array) -> Prediction:
        """Return the predicted T of the room with given areas of the treatments in m²."""
        put = sorted(zip(self.treatments, x.tolist(), strict=True), key=lambda each: _what(each[0]))
        return predict(
            self.known,
            [t.change(area) for t, area in put if area > _NONE * t.largest],
            assumptions=self.assumptions,
            name="design",
        )

    @cached_property
    def _kept(self) -> dict[bytes, Prediction]:
        """The last predictions, by the bytes of their areas; they go with the model."""
        return {}

    def _known(self, x: Array) -> Prediction:
        """Return the prediction of areas, made once."""
        key = x.tobytes()
        if key not in self._kept:
            if len(self._kept) == _MOST_PREDICTIONS:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = self.prediction(x)
        return self._kept[key]

    def probability(self, x: Array, target: Target | None = None) -> Array:
        """Return the probability that T is within its range, (n_bands,), for given areas in m²."""
        target = target or self.target
        return self._known(x).probability(target.low, target.high)

    def margins(self, probability: float) -> Margins:
        """Return the function that returns ndtri(P) - ndtri(probability) of the bands with a range."""
        bounded = self.target.bounded
        low, high = np.log(self.target.low[bounded]), np.log(self.target.high[bounded])

        def of(x: Array) -> Array:
            found = self.probability(x)[bounded]
            made = self._known(x)
            mean, sigma = made.log_mean[bounded], made.log_sigma[bounded]
            # Further off than samples reach, ln T is taken as normal: the search must see a slope.
            ends = np.fmin(high - mean, mean - low) / np.maximum(sigma, 1e-9)
            sampled = ndtri(np.clip(found, _LEAST, _MOST))
            level = np.where(found < _LEAST, np.minimum(ends, sampled), sampled)
            level = np.where(found > _MOST, np.maximum(ends, sampled), level)
            return np.asarray(np.clip(level, -_FAR, _FAR) - ndtri(probability))

        return of

    @cached_property
    def _order(self) -> NDArray[np.int64]:
        """Numbers of the treatments in an order that does not depend on that of the user's list."""
        places = range(len(self.treatments))
        return np.array(sorted(places, key=lambda j: _what(self.treatments[j])), dtype=np.int64)

    @cached_property
    def _places(self) -> NDArray[np.int64]:
        """Place of each treatment in `_order`."""
        return np.argsort(self._order)

    def _choice(self, margins: Margins) -> Choice:
        """Return what may be placed, in `_order`, and what it must keep."""
        (covers, surfaces), order = self.covering, self._order
        units = np.array([np.nan if t.unit is None else t.unit for t in self.treatments])
        return Choice(
            cost=self.prices[order],
            largest=np.array([t.largest for t in self.treatments])[order],
            unit=units[order],
            covers=covers[:, order],
            surfaces=surfaces,
            margins=lambda x: margins(x[self._places]),
        )

    def cheapest(self, probability: float) -> Array | None:
        """Return the cheapest areas in m², (n_treatments,), in whole panels; None if none is enough."""
        found = self._choice(self.margins(probability)).cheapest()
        return None if found is None else found[self._places]

    def _widest(self, margins: Margins) -> Array:
        """Return the areas in m² whose least margin is largest. Panels need not be whole."""
        choice = self._choice(margins)
        return np.asarray((choice.widest()[0] * choice.size)[self._places])

    @cached_property
    def most_probable(self) -> Array:
        """Areas in m² for which the least probable band is most probable; panels need not be whole."""
        return self._widest(self.margins(LEAST))

    def widening(self, probability: float) -> float | None:
        """Return the factor by which the ranges of T must widen for a design to exist; None above 100.

        The design may have parts of panels. ``probability`` is the required one in each band.
        """
        bounded = self.target.bounded
        low, high = np.log(self.target.low[bounded]), np.log(self.target.high[bounded])

        def spare(x: Array) -> Array:
            """Return the distance by which ln T keeps the nearer end."""
            made = self._known(x)
            mean, sigma = made.log_mean[bounded], made.log_sigma[bounded]
            return np.asarray(np.fmin(high - mean, mean - low) - ndtri(probability) * sigma)

        x = self._widest(spare)

        def kept(factor: float) -> bool:
            found = self.probability(x, self.target.widened(factor))
            return bool((found[bounded] >= probability).all())

        least, most = 1.0, _WIDEST
        if not kept(most):
            return None
        while most / least > 1 + _WIDENED:
            middle = float(np.sqrt(least * most))
            least, most = (least, middle) if kept(middle) else (middle, most)
        return most


def _what(t: Treatment) -> tuple[object, ...]:
    return t.cost, t.largest, t.unit or 0.0, t.covers or "", name_of(t.material), t.name


FRONTIER = (0.8, 0.85, 0.9, 0.95)
"""Probabilities for which `Design.frontier` gives the cost."""
_BEST = 0.99
_LEAST_CHANCE = 0.01
"""Least probability of a target for which the cost of the areas that come closest is printed."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Design(Result):
    """Hold the cheapest areas of treatments for a required T, and the T that they give."""

    record_kind: ClassVar[str] = "design 1"
    in_file: ClassVar[str] = (
        "room=model.before.name promised cost treatments target=model.target probability "
        "probability_together frontier prediction"
    )

    model: DesignModel
    """Treatments that are possible, the target, and what is known about the room."""
    promised: float
    """Probability that was required, in each band."""
    areas: Array
    """Area of each treatment in m², (n_treatments,)."""

    @property
    def cost(self) -> float:
        """Cost of all treatments together."""
        return float(self.model.prices @ self.areas)

    @cached_property
    def prediction(self) -> Prediction:
        """Predicted T of the treated room."""
        return self.model.prediction(self.areas)

    @cached_property
    def probability(self) -> Array:
        """Probability in each band that T is within its range, (n_bands,)."""
        return self.prediction.probability(self.model.target.low, self.model.target.high)

    @cached_property
    def probability_together(self) -> float:
        """Probability that T is within its range in all bands at once."""
        return self.prediction.probability_together(self.model.target.low, self.model.target.high)

    @cached_property
    def alternatives(self) -> dict[float, Design | None]:
        """Designs for several required probabilities, including this one.

        None if no areas are enough.
        """
        found: dict[float, Design | None] = {}
        for p in sorted({*FRONTIER, self.promised}):
            found[p] = self if p == self.promised else _cheapest(self.model, p)
        return found

    @property
    def frontier(self) -> dict[float, float]:
        """Cost of the design for several required probabilities; infinite if no areas are enough."""
        return {p: float("inf") if d is None else d.cost for p, d in self.alternatives.items()}

    @property
    def treatments(self) -> list[dict[str, Any]]:
        """Name, material, area in m², number of panels and cost of each treatment."""
        return [
            {
                "name": t.name,
                "material": name_of(t.material),
                "covers": t.covers or "",
                "area": area,
                "largest": t.largest,
                "unit": t.unit,
                "panels": None if t.unit is None else round(area / t.unit),
                "cost": t.cost * area,
            }
            for t, area in zip(self.model.treatments, self.areas.tolist(), strict=True)
        ]

    def __repr__(self) -> str:
        return (
            f'<Design of "{shortened(self.model.before.name)}": {self.areas.sum():.4g} m², cost '
            f"{self.cost:.4g}, probability {np.nanmin(self.probability):.2f} or more>"
        )

    def blocks(self) -> list[Block]:
        """Return the tables and sentences that the design prints."""
        made, target = self.prediction, self.model.target
        treatments = [
            Row(
                t["name"],
                [
                    t["covers"] or "free-standing",
                    f"{t['area']:.1f}",
                    f"{t['largest']:.1f}",
                    "-" if t["panels"] is None else str(t["panels"]),
                    f"{t['cost']:.0f}",
                ],
            )
            for t in self.treatments
        ]
        columns = ["covers", "area / m²", "largest area / m²", "panels", "cost"]
        parts = [
            f"{t['area']:.1f} m² of {t['name']}"
            + (f" ({t['panels']} panels)" if t["panels"] else "")
            for t in self.treatments
            if t["area"]
        ]
        needed = (
            f"{listed(parts)} bring T into the target in each band with a probability of "
            f"{np.nanmin(self.probability[target.bounded]):.2f} or more. This is the cheapest design; "
            f"the cost is {self.cost:.0f}."
            if parts
            else "Nothing is needed: T is in the target in each band with the required probability."
        )
        frontier = ", ".join(
            f"{'not possible' if np.isinf(cost) else f'{cost:.0f}'} for {p:g}"
            for p, cost in self.frontier.items()
        )
        drawn = "" if made.known.n_measured > 1 else ", with an error of at most 0.01"
        return [
            *map(Note, made.heads[:-1]),
            Note(needed),
            *map(Note, words.of_target(target)),
            Note(
                "T is in the target in all bands at once with a probability of "
                f"{self.probability_together:.2f}. Probabilities are means over random draws{drawn}."
            ),
            Note(f"Cost by the probability required in each band: {frontier}."),
            *map(Note, made.sentences or [words.EXACT_BEFORE]),
            Table(columns, treatments, corner="treatment"),
            Table(bands.labels(made.after.centre_frequencies), [*made.rows, *made.within(target)]),
        ]


def design(
    result: Known,
    treatments: Sequence[Treatment],
    target: Target,
    probability: float = LEAST,
    *,
    assumptions: Assumptions | None = None,
) -> Design:
    """Return the cheapest treatments with which T is within a range, with a required probability.

    The required probability is that of T in the range after the change, in each band, as
    `rtcal.prediction.predict` gives it for the same changes. Only whole panels are used. If no
    treatment is needed, all areas are 0. Of two designs with the same cost, the one with the
    smaller area is returned.

    Parameters
    ----------
    result : CalibrationResult
        Calibration of the room; with several configurations every measured T counts.
    treatments : sequence of Treatment
        Treatments that may be used, in any order, each with a different name.
    target : Target
        Range of T: a `Target`, or the result of `din_18041` or `ansi_s12_60`.
    probability : float
        Required probability in each band, from 0.8 to 0.99.
    assumptions : Assumptions, optional
        Assumed uncertainties, such as that of the new materials; by default usual values.

    Returns
    -------
    Design
        Design with the ``areas`` in m² of the treatments, and the ``probability`` by band.

    Raises
    ------
    DataError
        For a probability below 0.8 or above 0.99, or treatments that do not fit the room.
    InfeasibleError
        If no areas are enough; the message has the best that is possible.
    SolverError
        If the solver finds no solution.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> result = rt.calibrate(room, measured)
    >>> panel = rt.Material("panel", [0.3, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)
    >>> on_ceiling = rt.prediction.Treatment("panels", panel, 40, cost=90, covers="ceiling")
    >>> none = float("nan")
    >>> target = rt.prediction.Target([none] * 6, [none, 1.2, 1.0, 1.0, 1.0, none])
    >>> found = rt.design(result, [on_ceiling], target)
    >>> print(29 < found.areas[0] < 32, bool((found.probability[1:5] > 0.79).all()))
    True True
    """
    why = ": below, which design is the cheapest is not sure"
    checks.between("probability", probability, LEAST, _BEST, why=why)
    model = design_model(result, treatments, target, assumptions)
    found = _cheapest(model, probability)
    if found is None:
        raise InfeasibleError(" ".join(can_be_had(model, probability)))
    return found


def design_model(
    result: Known,
    treatments: Sequence[Treatment],
    target: Target,
    assumptions: Assumptions | None = None,
) -> DesignModel:
    """Return the model of a design: the treatments, and the room with its coefficients and its T.

    For the parameters see `design`, which raises the same DataErrors.
    """
    if isinstance(result, Room):
        raise DataError(
            "result must be the result of a calibration (rtcal.calibrate), and not a Room"
        )
    known = known_room(result)
    room = known.room
    if target.low.shape != (room.n_bands,):
        raise DataError(
            f"target has {len(target.low)} bands; it must have the room's {room.n_bands}"
        )
    return DesignModel(
        known,
        check_treatments(treatments, room),
        target,
        assumptions or Assumptions(),
    )


def _cheapest(model: DesignModel, probability: float) -> Design | None:
    """Return the cheapest design; None if there is none."""
    areas = model.cheapest(probability)
    return None if areas is None else Design(model=model, promised=probability, areas=areas)


def can_be_had(model: DesignModel, probability: float) -> list[str]:
    """Return sentences on what is possible if no design meets the target.

    The sentences give the best probabilities, the smallest widening of the range, the effect of parts
    of panels, and the measurement that would narrow the interval. ``probability`` is the required one.
    """
    labels, target = bands.labels(model.before.centre_frequencies), model.target
    if any(t.unit is not None for t in model.treatments):
        free = replace(model, treatments=tuple(replace(t, unit=None) for t in model.treatments))
        if (found := _cheapest(free, probability)) is not None:
            areas = ", ".join(
                f"{area:.1f} m² of {t.name}"
                for t, area in zip(free.treatments, found.areas.tolist(), strict=True)
            )
            return [
                "No number of whole panels brings T into the range with a probability of "
                f"{probability:g}.",
                f"If panels may be cut, these areas do: {areas}. {_price(model, found.areas)}.",
            ]
    at = model.most_probable
    chances = model.probability(at)
    each = [f"{labels[k]} {chances[k]:.2f}" for k in np.flatnonzero(target.bounded)]
    has_chance = chances[target.bounded].min() >= _LEAST_CHANCE
    said = [
        "No areas of these treatments bring T into the range with a probability of "
        f"{probability:g}.",
        *_already_short(model),
        f"The areas that come closest have these probabilities by band: {', '.join(each)}.",
        *([f"{_price(model, at)}."] if has_chance else []),
    ]
    wider = model.widening(probability)
    if wider is None:
        said.append(f"Not even a range {_WIDEST:g} times as wide at both ends can be met.")
    else:
        percent = 100 * (wider - 1)
        by = f"{percent:.0f} %" if percent >= 1 else "less than 1 %"
        said.append(f"A range that is wider by {by} at both ends can be met.")
    made = model.prediction(at)
    too_long = np.nan_to_num(made.mean / target.high - 1)
    too_short = np.nan_to_num(target.low / made.mean - 1)
    k = int(np.argmax(np.maximum(too_long, too_short)))
    reached = f"T with these areas is {made.mean[k]:.2f} s at {labels[k]}, but the range"
    if too_long[k] > 0:
        said.append(f"{reached} ends at {target.high[k]:.3g} s.")
    elif too_short[k] > 0:
        said.append(f"{reached} begins at {target.low[k]:.3g} s.")
    if has_chance:
        part = next(iter(made.parts))
        said.append(f"To narrow the interval, {words.advice(part, model.known.n_measured)}.")
    return said


def _price(model: DesignModel, areas: Array) -> str:
    """Return the cost of areas in m², (n_treatments,), also if cut panels are bought whole."""
    units = np.array([np.nan if t.unit is None else t.unit for t in model.treatments])
    panels = np.ceil(areas / units - _ROUNDING) * units
    bought = float(model.prices @ np.where(np.isnan(units), areas, panels))
    cost = float(model.prices @ areas)
    said = f"The cost is {cost:.0f}"
    if bought > cost * (1 + _ROUNDING):
        said += f" if a cut panel is paid by its area, and {bought:.0f} if it is paid whole"
    return said


def _already_short(model: DesignModel) -> list[str]:
    """Return that T is below the range, and no treatment lengthens it; [] where that is not so."""
    before = model.prediction(np.zeros(len(model.treatments))).mean
    longest = np.max(
        [model.prediction(row).mean for row in np.diag([t.largest for t in model.treatments])],
        axis=0,
    )
    short = (before < model.target.low) & (longest <= before)
    if not short.any():
        return []
    labels = bands.labels(model.before.centre_frequencies)
    each = [
        f"{before[k]:.2f} s at {labels[k]} (the range begins at {model.target.low[k]:.2f} s)"
        for k in np.flatnonzero(short).tolist()
    ]
    return [
        f"T is already too short for this target, and these treatments shorten it: {', '.join(each)}."
    ]
