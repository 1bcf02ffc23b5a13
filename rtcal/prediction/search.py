"""The cheapest amounts that keep every margin: supporting planes, and whole panels.

    minimise c'x  subject to  0 <= x <= largest,  G x <= h,  z_k(x) >= 0 in every band k,
    and x_j a whole number of panels where a treatment has panels.

z_k is the margin of a band, ndtri(P_k(x)) - ndtri(p), of the probability P_k that a prediction states.
Where p is well above one half, the areas that keep the margins are a convex set, but for a little. Then
the method of supporting planes finds the cheapest (Veinott 1967; with whole numbers Kronqvist, Lundell
& Westerlund 2016): the linear program's answer that misses a margin is joined to areas that keep all of
them, and the plane that touches the margin where the line crosses it is added. Each linear program is
a relaxation, so its first answer that keeps all margins is the cheapest.

The set is not taken to be convex: cheaper areas are looked at for some that keep all margins and that a
plane cuts off. Where there are any, the areas are split in two parts, each with planes of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.support.errors import SolverError
from rtcal.support.types import Array

Margins = Callable[[Array], Array]
"""Margins (n_margins,) of areas in m² (n_treatments,); 0 or more keeps them."""

KEPT = -2e-4
"""Margin in standard deviations that counts as kept: 0.00004 of a probability."""
_PLANES = 60
"""Most planes of one part; two treatments need about five."""
_PARTS = 24
"""Most parts that are searched."""
_STEP = 1e-4
"""Step of the derivatives, in shares of a treatment's largest area."""
_WELL = 0.1
"""Margin from which an inner point is not improved."""
_LEAST_AREA = 1e-6
"""What a square metre adds to its cost, in shares of the dearest: of designs of one cost the one with
less area is taken."""
_ROUNDING = 1e-6
_CUTS = 1e-3
"""Least sine of the angle between a plane and the line that it crosses."""
_HALVINGS, _TOUCHES = 60, 1e-4
"""Most steps to the edge of the areas that keep the margins, and the margin that counts as on it."""
_SPARE = 0.005
"""Least margin of an answer, some of whose areas are above their least, that is searched once more."""
_POINTS, _LOOKS = 512, 16
"""Of so many cheaper areas, so many of those that a plane cuts off, the nearest, are looked at."""
_SPARED = 2e-3
"""Share of the cost that must be spared for a further part to be searched."""
_SMALLEST = 1 / 32
"""Width of a part, in shares of the largest amounts, that is not split further."""


@dataclass(frozen=True, eq=False)
class Choice:
    """Areas that may be placed, and the ranges that they must keep.

    Attributes
    ----------
    cost : array (n_treatments,)
        Per m².
    largest : array (n_treatments,)
        m².
    unit : array (n_treatments,)
        m² of one panel, NaN where any area may be had.
    covers : array (n_surfaces, n_treatments)
        1 where a treatment covers a surface, else 0.
    surfaces : array (n_surfaces,)
        Their areas in m².
    margins : callable
        Margins (n_margins,) of areas in m² (n_treatments,); 0 or more keeps them.
    """

    cost: Array
    largest: Array
    unit: Array
    covers: Array
    surfaces: Array
    margins: Margins

    @cached_property
    def whole(self) -> NDArray[np.bool_]:
        """Which treatments are whole panels."""
        return np.isfinite(self.unit)

    @cached_property
    def size(self) -> Array:
        """m² of 1 of the unknowns, which are numbers of panels, or shares of the largest area."""
        return np.where(self.whole, self.unit, self.largest)

    @cached_property
    def most(self) -> Array:
        """Upper bounds of the unknowns."""
        return np.where(self.whole, np.floor(self.largest / self.size + _ROUNDING), 1.0)

    @cached_property
    def everything(self) -> tuple[Array, Array]:
        """The bounds of the unknowns."""
        return np.zeros(len(self.most)), self.most

    @cached_property
    def _rows(self) -> Array:
        """Share of each surface that 1 of the unknowns covers, (n_surfaces, n_treatments)."""
        return self.covers * self.size / self.surfaces[:, np.newaxis]

    def at(self, v: Array) -> Array:
        """Return the margins of unknowns."""
        return self.margins(v * self.size)

    def price(self, v: Array) -> float:
        """Return the cost of unknowns."""
        return float(self.cost @ (v * self.size))

    def widest(self, box: tuple[Array, Array], enough: float = np.inf) -> tuple[Array, float]:
        """Return the unknowns whose least margin is largest, and that margin; panels need not be whole.

        Unknowns with a margin that is ``enough`` are not improved.
        """
        from scipy.optimize import minimize

        low, high = box
        scale = np.maximum(high - low, 1e-12)

        def within(share: Array) -> Array:
            v = low + np.clip(share, 0, 1) * scale
            over = float(np.max(self._rows @ v, initial=0.0))
            return v / over if over > 1 else v

        n = len(low)
        best = low, float(self.at(low).min())
        alike = np.array([0.5, 0.75, 0.25, 0.9, 0.1, 1.0])[:, np.newaxis] * np.ones(n)
        for share in (*alike, *_even(16, n)):
            if best[1] >= enough:
                return best
            v = within(share)
            best = max(best, (v, float(self.at(v).min())), key=lambda each: each[1])
        if best[1] >= enough:
            return best
        start = (best[0] - low) / scale
        found = minimize(
            lambda s: -s[-1],
            np.append(start, best[1]),
            jac=lambda s: np.append(np.zeros(n), -1.0),
            bounds=[*[(0.0, 1.0)] * n, (None, None)],
            constraints=[
                {"type": "ineq", "fun": lambda s: self.at(within(s[:-1])) - s[-1]},
                {"type": "ineq", "fun": lambda s: 1 - self._rows @ (low + s[:-1] * scale)},
            ],
            method="SLSQP",
            options={"maxiter": 40, "ftol": 1e-5, "eps": _STEP},
        )
        v = within(found.x[:-1])
        margin = float(self.at(v).min())
        return (v, margin) if margin > best[1] else best

    def cheapest(self) -> Array | None:
        """Return the cheapest areas in m², (n_treatments,), that keep all margins; None if none do."""
        best: Array | None = None
        waiting, unfinished = [self.everything], False
        for _ in range(_PARTS):
            if not waiting:
                break
            box = waiting.pop()
            most = np.inf if best is None else (1 - _SPARED) * self.price(best)
            if self.price(box[0]) >= most:
                continue
            inside, margin = self.widest(box, _WELL)
            if margin <= KEPT:
                continue
            planes: list[tuple[Array, float]] = []
            found = self._in_part(box, inside, planes, most)
            unfinished |= len(planes) == _PLANES
            if found is not None:
                best = self._less(box, found)
                most = (1 - _SPARED) * self.price(best)
            if self._cuts_off(box, planes, most):
                waiting += self._halves(box)
        if best is None and unfinished:
            raise SolverError(f"no design was found with {_PLANES} supporting planes")
        return None if best is None else best * self.size

    def _in_part(
        self,
        box: tuple[Array, Array],
        inside: Array,
        planes: list[tuple[Array, float]],
        most: float,
    ) -> Array | None:
        """Return the cheapest unknowns of a part; None if none do at less than ``most``."""
        for whole in (False, True) if self.whole.any() else (False,):
            while True:
                v = self._relaxed(box, planes, whole)
                if v is None or self.price(v) >= most:
                    return None
                if float(self.at(v).min()) >= KEPT:
                    break
                if len(planes) == _PLANES:
                    return None
                planes.append(self._touching(inside, v))
        return v

    def _less(self, box: tuple[Array, Array], v: Array) -> Array:
        """Return unknowns, with less of what may be of any area where they keep every margin by far.

        Planes that cut off what keeps the margins leave too much: new ones stand for these panels.
        """
        low, high = (np.where(self.whole, v, end) for end in box)
        if not (v > low).any() or float(self.at(v).min()) <= _SPARE:
            return v
        found = self._in_part((low, high), v, [], self.price(v))
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

    def _cuts_off(
        self, box: tuple[Array, Array], planes: list[tuple[Array, float]], most: float
    ) -> bool:
        """Return whether some unknowns below a cost keep all margins, but not the planes."""
        low, high = box
        if not planes or np.max((high - low) / self.most) < _SMALLEST:
            return False
        normals, levels = (
            np.array([normal for normal, _ in planes]),
            np.array([h for _, h in planes]),
        )
        share = _even(_POINTS, len(low))
        v = low + share * (high - low)
        price = self.cost * self.size
        spent, least = v @ price, float(low @ price)
        # What costs too much is moved towards the cheapest corner, to different distances.
        kept = np.where(
            spent >= most, share[:, 0] * (most - least) / np.maximum(spent - least, 1e-300), 1
        )
        v = low + kept[:, np.newaxis] * (v - low)
        missed = np.min(v @ normals.T - levels, axis=1)
        possible = np.flatnonzero((missed < -_CUTS) & (v @ self._rows.T <= 1).all(axis=1))
        nearest = possible[np.argsort(-missed[possible])][:_LOOKS]
        return any(float(self.at(v[i]).min()) >= 0 for i in nearest)

    def _halves(self, box: tuple[Array, Array]) -> list[tuple[Array, Array]]:
        """Return the two halves of a part, along its longest side; panels of both are whole."""
        low, high = box
        j = int(np.argmax((high - low) / self.most))
        middle = (low[j] + high[j]) / 2
        ends = (np.floor(middle), np.floor(middle) + 1) if self.whole[j] else (middle, middle)
        here = np.arange(len(low)) == j
        return [(low, np.where(here, ends[0], high)), (np.where(here, ends[1], low), high)]


def _even(number: int, size: int) -> Array:
    """Return points that fill the unit cube evenly (Sobol 1967), (number, size)."""
    from scipy.stats import qmc

    return np.asarray(qmc.Sobol(size, seed=np.random.default_rng(0)).random(number))
