"""T of a changed room over T before: a function of the two states, with what is not known of it.

T of a state follows from the areas S of its materials, by direction, and from unknowns that all states
of a room share. So nothing changed gives exactly the T before, two changes one after the other give
what both give at once, and a change that is undone gives the T before, whatever the unknowns are:

    ln T = ln T_equation(S, a) + u (ln T_Arau-Puchades(S, a) - ln T_equation(S, a)),   a = alpha f.

- alpha has the distribution that a calibration left. A new material's is the stated one.
- f is what the equation errs by of each material's absorption: it depends on where a material lies, on
  edges, and on how the sound field reaches it. ln f is normal, one number for a material in all
  states. What two states have in common cancels: the error grows with the absorption exchanged.
- u is how far the field is from a diffuse one where the walls of one axis absorb more than the others:
  0 in a diffuse field, 1 in that of Arau-Puchades; between 1 and 2 Fitzroy's T takes its place. One
  number for a room. Where one axis absorbs nearly all, Arau-Puchades' T is the shortest, and u leads
  through the three T in their order: the larger u, the longer T.

T falls with every a for every u from 0 to 2. The unknowns are drawn, and T before says how likely each
draw is. A material's draws belong to its name, so that the order of materials moves nothing.

Where T before was not measured, T before and T after are both those of these models, so that a changed
room has the T that it has when it is entered as a room of its own.

References
----------
H. Arau-Puchades, Acustica 65, 163-180 (1988); D. Fitzroy, J. Acoust. Soc. Am. 31, 893-897 (1959).
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from rtcal.acoustics.changes import DIRECTIONS, FREE, UNKNOWN, Placed, facing, placed
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.marks import TrustMark, of_input
from rtcal.acoustics.room import Room, is_calibrated
from rtcal.acoustics.room_errors import (
    Assumptions,
    alpha_covariance,
    between_materials,
    of_climate,
)
from rtcal.support import checks
from rtcal.support.errors import DataError, ModelError
from rtcal.support.normal import NORMAL, symmetric_root, truncated_normal
from rtcal.support.types import Array, read_only_view

Flags = NDArray[np.bool_]

DRAWS = 8192
"""Number of random samples of every unknown."""
_LEAST_UNCERTAINTY = 0.02
"""Least standard uncertainty of ln T before as a weight of the draws: enough of them must be left."""
_KERNEL = 0.1
"""Width of the kernel of a probability, in standard deviations of the draws."""
_LARGEST = 0.999
"""Largest mean absorption coefficient of a draw, in shares of what the equation holds for."""
_FIRST = 16
"""Draws before T before is taken into account, over those after it."""
_LEAST = 1e-9
"""Least absorption coefficient of a draw: its logarithm is taken."""
_EVEN = 0.01
"""Relative difference of T below which the equations for uneven absorption say the same."""
_MOST_OF_AXIS = 0.6
"""Largest share of a room's surface that one axis is taken to have where directions are not known."""


@dataclass(frozen=True, eq=False)
class MeasuredState:
    """Hold another state of the room and its measured T, (n_bands,) each, NaN where it is missing."""

    name: str
    room: Room
    time: Array
    log_uncertainty: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownRoom:
    """Hold what is known about a room before it is changed, from a calibration or from its input.

    ``room`` has the input coefficients, and ``alpha`` (n_materials, n_bands) are the calibrated ones of
    the ``materials`` of the room and of its other measured states. ``quantiles`` (n_materials, n_bands,
    n_levels) are those of each coefficient at the probabilities of `NORMAL`, and ``correlation``
    (n_bands, n_materials, n_materials) is that between materials. ``time`` (n_bands,) is T before the
    change in s by ``equation``. ``measured`` is True in bands with a measured T, and ``exact`` is True
    if ``time`` is that T. ``log_uncertainty`` is the standard uncertainty of ln T, NaN if none is
    stated. ``others`` are further measured states, and ``doubts`` cautions about the input.
    """

    room: Room
    equation: LinearEquation
    materials: tuple[str, ...]
    alpha: Array
    quantiles: Array
    correlation: Array
    time: Array
    measured: Flags
    exact: bool
    log_uncertainty: Array
    others: tuple[MeasuredState, ...] = ()
    doubts: tuple[TrustMark, ...] = ()

    @property
    def n_measured(self) -> int:
        """Number of states of the room in which T was measured."""
        return int(self.measured.any()) + len(self.others)

    @classmethod
    def stated(cls, room: Room, equation: LinearEquation) -> KnownRoom:
        """Return a room in which nothing was measured, with its input coefficients.

        ``equation`` gives T of the ``room``.
        """
        checks.instance("room", room, Room)
        checks.instance("equation", equation, LinearEquation)
        between = between_materials(room.materials, [room])
        covariance = alpha_covariance(room.alpha.T, room.sigma.T, between, room.common_alpha_sigma)
        sigma, correlation = correlation_of(covariance)
        return cls(
            room=room,
            equation=equation,
            materials=tuple(room.materials),
            alpha=room.alpha,
            quantiles=normal_quantiles(room.alpha, sigma, room.least_alpha, room.most_alpha),
            correlation=correlation,
            time=equation.time(room, room.absorption_area),
            measured=np.zeros(room.n_bands, dtype=bool),
            exact=False,
            log_uncertainty=np.full(room.n_bands, np.nan),
            doubts=of_input(room),
        )


@functools.lru_cache(16)  # a mesh is read once for a calibration and all its predictions
def directions(room: Room) -> Array:
    """Return the shares of each material's area that face x, y and z, (n_materials, 3), NaN if unknown.

    They are those of the room's mesh, and without a mesh those of `rtcal.acoustics.changes.facing`.
    """
    if room.scene.mesh is None:
        return read_only_view(facing(room))
    from rtcal.io import geometry_files  # loads the simulators, which takes a while

    return read_only_view(geometry_files.directions(room))


def correlation_of(covariance: Array) -> tuple[Array, Array]:
    """Return sigma (n, n_bands) and the correlation (n_bands, n, n) of a covariance of that shape."""
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    scale = np.where(sigma > 0, sigma, 1.0)
    correlation = covariance / (scale[:, :, np.newaxis] * scale[:, np.newaxis, :])
    own = np.arange(correlation.shape[1])
    correlation[:, own, own] = 1.0
    return sigma.T, correlation


def normal_quantiles(centre: Array, sigma: Array, lower: Array, upper: Array) -> Array:
    """Return the quantiles at `NORMAL` of normal densities cut to their bounds, (..., n_levels)."""
    scale = np.where(sigma > 0, sigma, 1.0)[..., np.newaxis]
    middle = centre[..., np.newaxis]
    low, high = ((end[..., np.newaxis] - middle) / scale for end in (lower, upper))
    shape = (*centre.shape, len(NORMAL))
    least, most, levels = (np.broadcast_to(each, shape) for each in (low, high, ndtr(NORMAL)))
    cut = middle + scale * truncated_normal(least, most, levels)
    return np.asarray(np.where(sigma[..., np.newaxis] > 0, cut, middle))


@functools.lru_cache(64)
def normal_of(label: str, number: int) -> Array:
    """Return random values of a standard normal variable, (number,), that belong to a label.

    They are the quantiles of equal shares of the probability, in a random order that depends on the
    label alone.
    """
    seed = int.from_bytes(hashlib.sha256(label.encode()).digest()[:8], "big")
    levels = (np.arange(number) + 0.5) / number
    drawn: Array = ndtri(np.random.default_rng(seed).permutation(levels))
    drawn.setflags(write=False)
    return drawn


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Hold random values of the unknowns that all states of a room share.

    ``alpha`` and ``factor`` are (n_bands, n_materials, n_draws): the coefficients, and ln f of their
    factors f. The others are (n_bands, n_draws). ``evenness`` is from 0 to 2 and determines T where the
    absorption is uneven: 0 gives the shortest T of three equations, 1 the middle one, 2 the longest.
    ``air`` and ``volume`` are standard normal variables for ln m and for the volume that is added.
    ``alone`` is True where an exchange at an unknown place is on the walls of one axis.
    """

    alpha: Array
    factor: Array
    evenness: Array
    air: Array
    volume: Array
    alone: Flags

    @cached_property
    def absorption(self) -> Array:
        """The coefficients a = alpha f."""
        return np.maximum(self.alpha * np.exp(self.factor), _LEAST)


@dataclass(frozen=True, eq=False)
class TimeChange:
    """Hold two states of a room, and compute the ratio of T after the change to T before it.

    `rtcal.acoustics.changes.placed` returns the second ``state``, with the directions of its materials.
    ``known`` is the first state.
    """

    known: KnownRoom
    state: Placed
    assumptions: Assumptions

    @property
    def before(self) -> Room:
        """Room before the change, with its input coefficients."""
        return self.known.room

    @property
    def after(self) -> Room:
        """Room after the change, with its input coefficients."""
        return self.state.room

    def refuse(self) -> None:
        """Raise an error if the two states do not fit each other, or if the equation gives no T.

        DataError if the rooms differ in bands, or in a material's input alpha or sigma; ModelError if
        the equation gives no T before or after.
        """
        rooms = [*_rooms(self.known), self.after]
        refuse_other_priors(rooms, [f'room "{room.name}"' for room in rooms])
        for room in (self.before, self.after):
            mean = room.absorption_area / room.total_area
            with np.errstate(divide="ignore"):
                time = self.known.equation.time(room, room.absorption_area)
            if not (np.isfinite(time) & (time > 0)).all():
                raise ModelError(
                    f'room "{room.name}": {self.known.equation.name}\'s equation gives no T for '
                    f"a mean alpha of {np.min(mean):.3g} to {np.max(mean):.3g}: use another "
                    "equation, or a smaller change"
                )

    @cached_property
    def _both(self) -> tuple[Placed, Placed]:
        return _before(self.known), self.state

    @cached_property
    def _new(self) -> list[int]:
        """Rows of the materials that come in, in the room after."""
        every = enumerate(self.after.materials)
        return [i for i, name in every if name not in self.known.materials]

    @cached_property
    def materials(self) -> tuple[str, ...]:
        """Names of all materials: first those of the known room, then the new ones."""
        return (*self.known.materials, *(self.after.materials[i] for i in self._new))

    @cached_property
    def areas(self) -> Array:
        """Areas of each state in m² by material and direction, (2, n_materials, 5).

        Directions are those of `Placed`.
        """
        out = np.zeros((2, len(self.materials), len(DIRECTIONS)))
        for rows, state in zip(out, self._both, strict=True):
            rows[[self.materials.index(m) for m in state.room.materials]] = state.areas
        return out

    @cached_property
    def is_surface(self) -> Flags:
        """Whether each material has surfaces, and is no piece, (n_materials,)."""
        pieces = {
            *self.after.pieces,
            *(name for room in _rooms(self.known) for name in room.pieces),
        }
        return np.array([name not in pieces for name in self.materials])

    @cached_property
    def exchanged(self) -> Array:
        """Area in m² of each material that the other state lacks, (2, n_materials)."""
        whole = self.areas.sum(axis=2)
        return np.asarray(whole - whole.min(axis=0))

    @property
    def changing(self) -> Flags:
        """Which materials have another area in the two states, (n_materials,) of bool."""
        return np.asarray(self.exchanged.max(axis=0) > 0)

    @property
    def is_placed(self) -> bool:
        """Whether the directions of all that is exchanged are known."""
        unknown = self.areas[:, :, UNKNOWN].max(axis=0)
        return not (unknown[self.changing] > 0).any()

    @property
    def _sigma_of_new(self) -> Array:
        """Sigma of the materials that come in, (n_new, n_bands)."""
        return self.after.sigma[self._new]

    @cached_property
    def unknowns(self) -> Unknowns:
        """Random values of all unknowns, given every measured T."""
        before, known, room = _drawn_before(self.known, self.assumptions), self.known, self.after
        if not self._new:
            return before
        names, rows = self.materials[len(known.materials) :], self._new
        errors = _area_errors([*_rooms(known), room], names, self.assumptions)
        bounds = room.least_alpha[rows], room.most_alpha[rows]
        quantiles = normal_quantiles(room.alpha[rows], self._sigma_of_new, *bounds)
        alpha, factor = _draws(
            names,
            room.alpha[rows],
            quantiles,
            errors,
            self.assumptions,
            (np.eye(len(rows)), np.eye(len(rows))),
            DRAWS,
        )
        return replace(
            before,
            alpha=np.concatenate([before.alpha, alpha], axis=1),
            factor=np.concatenate([before.factor, factor], axis=1),
        )

    def log_ratio(self, unknowns: Unknowns | None = None) -> Array:
        """Return random values of ln (T after / T before), (n_bands, n_draws)."""
        if unknowns is None and self.is_placed:
            before = _log_time_before(self.known, self.assumptions)
        else:
            before = self.log_time(0, unknowns)
        after = self.log_time(1, unknowns)
        change = after - before
        if unknowns is None and not self.known.measured.all():
            off = self._central(1) - after.mean(axis=1) - self._central(0) + before.mean(axis=1)
            change += np.where(self.known.measured, 0.0, off)[:, np.newaxis]
        return self.possible(change)

    def _central(self, state: int) -> Array:
        """Return ln T of a state at the calibrated or stated alpha, (n_bands,): its mean over u."""
        drawn = self.unknowns
        at = replace(self.known_alpha, evenness=drawn.evenness, alone=drawn.alone)
        return np.asarray(self.log_time(state, at).mean(axis=1))

    @cached_property
    def known_alpha(self) -> Unknowns:
        """Unknowns with the calibrated or input alpha, and without any other error."""
        alpha = np.vstack([self.known.alpha, self.after.alpha[self._new]]).T[:, :, np.newaxis]
        nothing = np.zeros((len(alpha), 1))
        return Unknowns(alpha, 0 * alpha, nothing, nothing, nothing, nothing > 0)

    def possible(self, ratio: Array) -> Array:
        """Return ln (T after / T before), set to 0 where its sign is impossible for the change.

        ``ratio`` is this logarithm, (n_bands, ...). It cannot be above 0 if absorption is only added,
        nor below 0 if it is only removed, but an equation may give this for a hard object.
        """
        first, other = (state.room for state in self._both)
        if first.volume == other.volume and first.air == other.air:
            was, becomes = self.areas.sum(axis=2)
            if (becomes >= was).all():
                ratio = np.minimum(ratio, 0.0)
            if (becomes <= was).all():
                ratio = np.maximum(ratio, 0.0)
        return np.asarray(ratio)

    @cached_property
    def time_before(self) -> Array:
        """T before in s, (n_bands,): as measured, or else by the equation with uneven absorption.

        For a calibrated room whose measurement is not given, it is T by the equation alone: with the
        calibrated coefficients the equation gave the measured T.
        """
        known = self.known
        if known.measured.all() or is_calibrated(known.room):
            return known.time
        by_models = _central_before(known, self.assumptions)
        return np.where(known.measured, known.time, np.exp(by_models))

    @cached_property
    def by_equation(self) -> dict[str, Array]:
        """T after in s by each equation alone, at the calibrated coefficients, (n_bands,) each.

        If T before was measured, T after is T before times the equation's ratio of T. Arau-Puchades'
        and Fitzroy's equation are included if the absorption is uneven, before or after the change.
        """
        known, at = self.known, self.known_alpha
        by_state = []
        for state in (0, 1):
            even, air = self._even(state, at)
            by_state.append(even + self._uneven_terms(state, at, air))
        given = known.measured | is_calibrated(known.room)
        change = self.possible(by_state[1] - by_state[0])[:, :, 0]
        times = np.where(given, known.time * np.exp(change), np.exp(by_state[1][:, :, 0]))
        own, *uneven = times
        if all(np.abs(t / own - 1).max() < _EVEN for t in uneven):
            return {known.equation.name: own}
        return dict(zip((known.equation.name, "Arau-Puchades", "Fitzroy"), times, strict=True))

    def log_before(self) -> Array:
        """Return random values of ln (T before / `time_before`), (n_bands, DRAWS).

        They are 0 where T was measured. Elsewhere T before is the model's, and has the errors of all
        unknowns: of volume and areas together, and of the equation, whose error of ln T is the same in
        all states.
        """
        assumed, known, room = self.assumptions, self.known, self.known.room
        drawn = self.log_time(0)
        sizes = (room.volume_sigma or assumed.volume) * normal_of(
            "volume before", DRAWS
        ) - room.common_area_sigma * normal_of("areas before", DRAWS)
        of_walls = 1 - known.equation.air_share(room, room.absorption_area)
        common = assumed.common * normal_of("equation", DRAWS)
        level = drawn - np.log(known.time)[:, np.newaxis] + of_walls[:, np.newaxis] * sizes + common
        level -= level.mean(axis=1, keepdims=True)  # so that the mean is T before
        return np.where(known.measured[:, np.newaxis], 0.0, level)

    def log_time(
        self, state: int, unknowns: Unknowns | None = None, bands: slice = slice(None)
    ) -> Array:
        """Return random values of ln T in some bands, (n_bands, n_draws); state 0 is that before."""
        unknowns = unknowns or self.unknowns
        even, air = self._even(state, unknowns, bands)
        # u leads through the equations by the T that they give, the shortest first.
        low, middle, high = np.sort(self._uneven_terms(state, unknowns, air), axis=0)
        u = unknowns.evenness
        uneven = (
            low + np.minimum(u, 1.0) * (middle - low) + np.maximum(u - 1.0, 0.0) * (high - middle)
        )
        return np.asarray(even + uneven)

    def _even(
        self, state: int, unknowns: Unknowns, bands: slice = slice(None)
    ) -> tuple[Array, Array]:
        """Return ln T by the equation, and the air's absorption area in m², (n_bands, n_draws) each."""
        room, equation, first = self._both[state].room, self.known.equation, self._both[0].room
        areas = self.areas[state].sum(axis=1)
        total = areas[self.is_surface].sum()
        size = max(first.volume_sigma, room.volume_sigma) or self.assumptions.volume
        grown = np.exp(size * unknowns.volume)
        volume = first.volume + (room.volume - first.volume) * grown
        error = np.exp(self._air_sigma[bands, np.newaxis] * unknowns.air)
        air = 4 * room.air_attenuation[bands, np.newaxis] * error * volume
        mean = np.einsum("n,knd->kd", areas, unknowns.absorption) / total
        walls = total * self._exponent(mean)
        return np.log(equation.room_constant(room) * volume / (walls + air)), air

    @cached_property
    def _air_sigma(self) -> Array:
        """Relative error of the air's attenuation by the stated climate's, (n_bands,)."""
        found = np.zeros(self.known.room.n_bands)
        for state in self._both:
            of_m = np.linalg.norm(
                of_climate(state.room, lambda changed: changed.air_attenuation), axis=0
            )
            m = state.room.air_attenuation
            np.maximum(found, of_m / np.where(of_m > 0, m, 1.0), out=found)
        return found

    def _uneven_terms(self, state: int, unknowns: Unknowns, air: Array) -> Array:
        """Return what each equation adds to the even one's ln T of a state, (3, n_bands, n_draws)."""
        found = self._added(*self._by_axis(state, unknowns.absorption), air)
        if self.is_placed or not unknowns.alone.any():
            return found
        alone = self._added(*self._on_one_axis(state, unknowns.absorption), air)
        return np.where(unknowns.alone, alone, found)

    def _exponent(self, mean: Array) -> Array:
        """Return the equation's exponent of mean coefficients, at most what it holds for."""
        most = _LARGEST * min(self.known.equation.largest_mean, 1.0)
        return self.known.equation.exponent(np.minimum(mean, most))

    def _added(self, areas: Array, absorbed: Array, air: Array) -> Array:
        """Return 0, and what Arau-Puchades' and Fitzroy's equations add to ln T, (3, n_bands, n_draws).

        Each axis has the T of the calibration's equation; with Eyring's they are those of
        `ArauPuchades` and `Fitzroy`. ``absorbed`` (n_bands, n_axes, n_draws) is the absorption area of
        the walls of each axis, whose areas are (n_axes,); ``air`` is (n_bands, n_draws).
        """
        total = areas.sum()
        share = areas / total
        by_axis = total * self._exponent(absorbed / np.maximum(areas, 1e-9)[:, np.newaxis])
        axes = by_axis + air[:, np.newaxis]
        even = np.log(total * self._exponent(absorbed.sum(axis=1) / total) + air)
        arau = even - np.einsum("a,kad->kd", share, np.log(axes))
        fitzroy = even + np.log(np.einsum("a,kad->kd", share, 1 / axes))
        return np.stack([np.zeros_like(even), arau, fitzroy])

    def _by_axis(self, state: int, absorption: Array) -> tuple[Array, Array]:
        """Return areas (n_axes,) and absorption (n_bands, n_axes, DRAWS) of the axes in m².

        What stands free absorbs as if it were spread over all walls. What has no known direction is
        spread where a cube would have its area.
        """
        areas, walls = self.areas[state], self.is_surface
        axes = areas[:, :3].sum(axis=0)
        lacking = np.maximum(areas[walls].sum() / 3 - axes, 1e-9)
        axes = axes + areas[:, UNKNOWN].sum() * lacking / lacking.sum()
        spread = areas[:, :3] + np.outer(areas[:, UNKNOWN], lacking / lacking.sum())
        spread = spread + np.outer(areas[:, FREE], axes / axes.sum())
        return spread[walls].sum(axis=0), np.einsum("na,knd->kad", spread, absorption)

    def _on_one_axis(self, state: int, absorption: Array) -> tuple[Array, Array]:
        """Return the same of two axes, the first with all that is exchanged and has no direction."""
        areas, walls = self.areas[state].sum(axis=1), self.is_surface
        whole = self.areas.sum(axis=2)
        share = self.areas[:, :, UNKNOWN].max(axis=0) / whole.max(axis=0)
        exchanged = self.exchanged * share
        total, most = areas[walls].sum(), exchanged.sum(axis=1).max()
        first = min(max(2 * most, total / 3), max(_MOST_OF_AXIS * total, most))
        here = exchanged[state]
        rest = areas - here
        of_walls = rest[walls].sum()
        left = (first - here.sum()) / of_walls if of_walls > 0 else 0.0
        spread = np.stack([here + left * rest, (1 - left) * rest], axis=1)
        return spread[walls].sum(axis=0), np.einsum("na,knd->kad", spread, absorption)


@functools.lru_cache(16)
def _before(known: KnownRoom) -> Placed:
    return placed(known.room, (), shares=directions(known.room))


def _rooms(known: KnownRoom) -> list[Room]:
    return [known.room, *(state.room for state in known.others)]


@functools.lru_cache(4)
def _drawn_before(known: KnownRoom, assumptions: Assumptions) -> Unknowns:
    """Return draws of what is known, given every measured T; band by band, as memory allows."""
    each = [_given(known, assumptions, k) for k in range(known.room.n_bands)]
    drawn = Unknowns(
        **{
            field.name: np.concatenate([getattr(one, field.name) for one in each])
            for field in fields(Unknowns)
        }
    )
    return _given_others(known, assumptions, drawn) if known.others else drawn


@functools.lru_cache(4)
def _log_time_before(known: KnownRoom, assumptions: Assumptions) -> Array:
    """Return draws of ln T before, (n_bands, DRAWS), where the directions of the exchange are known."""
    return TimeChange(known, _before(known), assumptions).log_time(0)


@functools.lru_cache(4)
def _central_before(known: KnownRoom, assumptions: Assumptions) -> Array:
    """Return ln T before of the models, (n_bands,)."""
    return TimeChange(known, _before(known), assumptions)._central(0)


def _draws(
    names: Sequence[str],
    alpha: Array,
    quantiles: Array,
    area_errors: Array,
    assumptions: Assumptions,
    roots: tuple[Array, Array],
    number: int,
) -> tuple[Array, Array]:
    """Return draws of materials' alpha and ln f, (n_bands, n, n_draws) each.

    ``alpha`` is (n, n_bands) and ``roots`` are those of the materials' correlations in alpha and ln f.
    The sigma of ln f is the equation's and the area's.
    """
    own, factors = (
        root @ np.array([normal_of(f"{what} of {name}", number) for name in names])
        for what, root in zip(("alpha", "factor"), roots, strict=True)
    )
    out = np.empty((alpha.shape[1], *own.shape))
    for k, i in np.ndindex(out.shape[:2]):
        out[k, i] = np.interp(own[i], NORMAL, quantiles[i, k])
    least = assumptions.least / np.maximum(alpha, max(assumptions.least, _LEAST))
    sigma = np.sqrt(assumptions.factor**2 + least**2 + area_errors[:, np.newaxis] ** 2)
    return out, sigma.T[:, :, np.newaxis] * factors


def _stated_root(known: KnownRoom) -> Array:
    """Return a root of the correlation of materials that the room's states give."""
    rooms = _rooms(known)
    if not any(room.material_correlation for room in rooms):
        return np.eye(len(known.materials))
    return symmetric_root(between_materials(known.materials, rooms))


def _independent(known: KnownRoom, assumptions: Assumptions, band: int) -> Unknowns:
    """Return draws of what is known in a band, before T counts but by the calibration."""
    number = _FIRST * DRAWS

    def one(label: str) -> Array:
        return normal_of(label, number)[np.newaxis]

    here = slice(band, band + 1)
    alpha, factor = _draws(
        known.materials,
        known.alpha[:, here],
        known.quantiles[:, here],
        _area_errors(_rooms(known), known.materials, assumptions),
        assumptions,
        # What errs alike errs alike in the equation: a material in two parts is one.
        (symmetric_root(known.correlation[band]), _stated_root(known)),
        number,
    )
    # u is normal, cut to 0 to 2.
    even, mean, spread = (
        one("evenness"),
        assumptions.evenness,
        max(assumptions.evenness_sigma, 1e-9),
    )
    low, high = (np.full(even.shape, (end - mean) / spread) for end in (0.0, 2.0))
    return Unknowns(
        alpha=alpha,
        factor=factor,
        evenness=mean + spread * truncated_normal(low, high, ndtr(even)),
        air=one("air"),
        volume=one("volume"),
        alone=one("place") > ndtri(1 - assumptions.one_surface),
    )


def _given(known: KnownRoom, assumptions: Assumptions, band: int) -> Unknowns:
    """Return as many draws as are kept, drawn by the likelihood of T before: systematic resampling.

    ln T before is normal about that of the draw, with the uncertainty of the measured T. In a band
    without a measured T every draw is as likely.
    """
    drawn = _independent(known, assumptions, band)
    off = np.zeros(_FIRST * DRAWS)
    if known.measured[band]:
        same = TimeChange(known, _before(known), assumptions)
        log_time = same.log_time(0, drawn, slice(band, band + 1))[0]
        u = float(np.nan_to_num(known.log_uncertainty[band], nan=assumptions.time))
        off = (log_time - np.log(known.time[band])) / max(u, _LEAST_UNCERTAINTY)
    weight = np.cumsum(np.exp(-(off**2 - (off**2).min()) / 2))
    levels = (np.arange(DRAWS) + 0.5) / DRAWS
    kept = np.minimum(np.searchsorted(weight / weight[-1], levels), len(weight) - 1)
    return Unknowns(
        **{each.name: getattr(drawn, each.name)[..., kept] for each in fields(Unknowns)}
    )


def _given_others(known: KnownRoom, assumptions: Assumptions, drawn: Unknowns) -> Unknowns:
    """Return draws moved by T of further measured states, by a linear update of each draw.

    ln f and u move. A state's own error grows with its distance from that before.

    References
    ----------
    G. Evensen, Ocean Dynamics 53, 343-367 (2003).
    """
    before = _before(known)
    states = [placed(state.room, (), before) for state in known.others]
    simulated = np.array([TimeChange(known, s, assumptions).log_ratio(drawn) for s in states])
    moved = np.concatenate([drawn.factor, drawn.evenness[:, np.newaxis]], axis=1)
    u0 = np.nan_to_num(known.log_uncertainty, nan=assumptions.time)
    errors = np.array([normal_of(f"T of {state.name}", DRAWS) for state in known.others])
    for k in range(len(moved)):
        change = np.array([np.log(state.time[k] / known.time[k]) for state in known.others])
        used = np.isfinite(change)
        if not used.any():
            continue
        u = np.array([state.log_uncertainty[k] for state in known.others])
        own = np.hypot(np.nan_to_num(u, nan=assumptions.time), assumptions.own * change)[used]
        noise = own[:, np.newaxis] * errors[used] + u0[k] * normal_of("T before", DRAWS)
        h, x = simulated[used, k], moved[k]
        off, x_off = h - h.mean(axis=1, keepdims=True), x - x.mean(axis=1, keepdims=True)
        spread = off @ off.T / DRAWS + np.diag(own**2) + u0[k] ** 2
        gain = np.linalg.solve(spread, off @ x_off.T / DRAWS).T
        moved[k] += gain @ (change[used, np.newaxis] + noise - h)
    return replace(drawn, factor=moved[:, :-1], evenness=np.clip(moved[:, -1], 0.0, 2.0))


def _area_errors(rooms: Sequence[Room], names: Sequence[str], assumptions: Assumptions) -> Array:
    """Return the relative error of each material's area, (n,): stated, or assumed where none is."""
    if not any(room.area_sigma.any() for room in rooms):
        return np.full(len(names), assumptions.areas)
    stated = [dict(zip(room.materials, room.area_sigma.tolist(), strict=True)) for room in rooms]
    return np.array([max(of.get(name, 0.0) for of in stated) for name in names])


def probability_within(samples: Array, low: Array, high: Array) -> Array:
    """Return the probability, (n_bands,), that random values are from ``low`` to ``high``.

    ``samples`` are (n_bands, n_draws), the limits (n_bands,). NaN means no limit. So that the
    probability is a smooth function, a normal kernel is used, whose width is a tenth of the samples'
    standard deviation. The kernel widens the distribution by 0.5 %.
    """
    width = np.maximum(_KERNEL * samples.std(axis=1, keepdims=True), 1e-12)
    below = ndtr((np.where(np.isnan(high), np.inf, high)[:, np.newaxis] - samples) / width)
    under = ndtr((np.where(np.isnan(low), -np.inf, low)[:, np.newaxis] - samples) / width)
    return np.asarray((below - under).mean(axis=1))


def refuse_other_priors(rooms: Sequence[Room], places: Sequence[str]) -> None:
    """Raise DataError if states of one room differ in bands or in a material's alpha or sigma.

    Also if some have air and others have none.
    ``places`` are the names of the rooms in the message, such as ``room "box"``.
    """
    for place, room in list(zip(places, rooms, strict=True))[1:]:  # the first is that compared with
        if not np.array_equal(room.centre_frequencies, rooms[0].centre_frequencies):
            raise DataError(f"{place} has other bands than {places[0]}; both must have the same")
        if (room.air is None) != (rooms[0].air is None):
            lacks, has = (place, places[0]) if room.air is None else (places[0], place)
            raise DataError(f"{lacks} has no air, but {has} has air; give air to both")
        for i, material in enumerate(room.materials):
            owner = next(n for n, r in enumerate(rooms) if material in r.materials)
            j = rooms[owner].materials.index(material)
            for name in ("alpha", "sigma"):
                values, first = getattr(room, name)[i], getattr(rooms[owner], name)[j]
                if not np.array_equal(values, first):
                    k = int(np.flatnonzero(values != first)[0])
                    raise DataError(
                        f"{place}: {room.place(name, i, k)} = {values[k]:g}, but {places[owner]} "
                        f"has {first[k]:g}; a material must have the same values in all rooms"
                    )
