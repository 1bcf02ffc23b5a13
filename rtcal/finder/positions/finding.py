"""The finding at positions: what is other than stated, and where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rtcal.files.disk import json_numbers
from rtcal.finder.claim import DISTINCT_NATS, SAID, after_doubt, credible_set
from rtcal.finder.effects import CoupledRoom
from rtcal.finder.finding import LEAST_ADDED, LEAST_PAIRS, Candidate, Detection, Finding
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.weighing import Weighing
from rtcal.finder.prior import NONE, UNKNOWN
from rtcal.loop.control_runs import ControlRuns
from rtcal.loop.measured_pairs import without_place
from rtcal.support import checks
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError
from rtcal.support.text import listed
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.finder.corrected import Corrected

MOST = 0.5
"""Probability, or share of one, from which something holds most."""


def kind(candidate: Candidate) -> str:
    """Return the family of a candidate, all of added absorption as one."""
    return candidate.family.split(",")[0]


_CHOICE = 6
"""Most candidates of which a sentence gives the choice."""
_LEAST = 1e-3
"""Probability below which nothing is added to a surface, even where the user names it."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsFinding(Finding):
    """The finding at positions: what is other than stated, and where; see `Finding`, too.

    Attributes
    ----------
    case : Case
    effect : str or None
        The effect that is named.
    surface : str or None
        The surface that is claimed: something stands on it with a probability of at least 0.9, and the
        checks agree.
    surfaces : mapping of str to float
        Probability of each surface, given that something stands on one. The most probable first.
    groups : tuple of tuples of str
        Surfaces that these positions cannot tell apart.
    candidates : tuple of Candidate
        Every effect in every place, the most probable first.
    map : array (n_parameters, n_pairs, n_bands)
        Simulated less measured in standard deviations of what prior, simulator and measurement leave
        open; NaN where nothing was measured.
    parameters, pairs : tuple
        Of the map.
    controls : ControlRuns
        The simulator's error, to be given to another search or calibration.
    left_out : tuple of str
        What of the library was not tried.
    mistake : str
        The doubt of means over positions that T is twice or half the model's; "" without it.
    unexplained : float
        Probability that something is other than stated that no effect explains, alone or beside one.
    """

    record_kind: ClassVar[str] = "finding at positions 1"

    case: PositionsCase
    effect: str | None
    surface: str | None
    surfaces: Mapping[str, float]
    groups: tuple[tuple[str, ...], ...]
    map: Array
    parameters: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    controls: ControlRuns
    left_out: tuple[str, ...] = ()
    mistake: str = ""
    unexplained: float = 0.0

    @property
    def located(self) -> Candidate | None:
        """The most probable candidate on the most probable surface, None without one."""
        first = next(iter(self.surfaces), None)
        return next((c for c in self.candidates if c.surface == first and first), None)

    @property
    def likely_surfaces(self) -> tuple[str, ...]:
        """The fewest surfaces that hold `LIKELY` of the probability; none where hardly anything does.

        Where something stands on a surface with less than `SAID`, no effect on one is printed either.
        """
        if sum(c.probability for c in self.candidates if c.surface is not None) < SAID:
            return ()
        held, out = 0.0, []
        for name, probability in self.surfaces.items():
            out.append(name)
            held += probability
            if held >= LIKELY:
                break
        return tuple(out)

    @property
    def likeliest(self) -> Candidate | None:
        """The most probable candidate of the library, which `apply` adds; None without one.

        Where the verdict is "unknown", the candidate's surface or its family must hold at least half of
        the rest.
        """
        known = [c for c in self.candidates if c.effect != UNKNOWN] if self.best else []
        if not known or self.verdict != "unknown":
            return next(iter(known), None)
        first, rest = known[0], sum(c.probability for c in known)
        of_surface = sum(c.probability for c in known if c.surface == first.surface)
        of_family = sum(c.probability for c in known if kind(c) == kind(first))
        most = max(of_family, of_surface if first.surface is not None else 0.0)
        return first if most >= MOST * rest > 0 else None

    @property
    def can_be_added(self) -> bool:
        """Whether `apply` has something to add: detected, on a surface, and no second room."""
        best = self.likeliest
        return self.detected and best is not None and best.can_be_added

    @property
    def can_be_verified(self) -> bool:
        """Whether `verify` has enough pairs to predict half of them."""
        return self.can_be_added and len(self.pairs) >= LEAST_PAIRS

    @property
    def reason_for_none(self) -> str | None:
        """Why there is nothing to add, in words; None where there is something."""
        best = self.likeliest
        if self.can_be_added:
            return None
        if self.detected and best is not None and best.effect == CoupledRoom.name:
            return f"{best.title}: {CoupledRoom.not_in_simulator}"
        return f"{self.headline} So no surface lacks anything to add."

    @property
    def undecided(self) -> str:
        """Why `apply` must be told what it is to add, in words; "" where it need not be.

        What stands on a surface counts with its family: which porous absorber it is changes little.
        Where the verdict is "unknown", the shares are those of the rest.
        """
        best = self.likeliest
        if not self.can_be_added or best is None:
            return ""
        known = [c for c in self.candidates if c.effect != UNKNOWN]
        alike = [c for c in known if (c.surface, kind(c)) == (best.surface, kind(best))]
        share = sum(c.probability for c in alike)
        if self.verdict == UNKNOWN:
            share /= sum(c.probability for c in known)
        if share >= LEAST_ADDED:
            return ""
        some = [c for c in known if c.can_be_added and c.probability >= SAID][:_CHOICE]
        named = [f"{c.title} ({100 * c.probability:.0f} %)" for c in some or [best]]
        return (
            "Neither an effect nor a place is stated, and the most probable family on one surface has "
            f"less than {100 * LEAST_ADDED:.0f} %. Candidates: {listed(named, last='or')}. State one: "
            "effect = NAME, or its place: at = X,Y,Z."
        )

    def apply(
        self,
        form: str = "patch",
        *,
        at: Sequence[float] | None = None,
        effect: str | None = None,
    ) -> Corrected:
        """Return room and geometry with the most probable candidate in them, or one that is stated.

        Parameters
        ----------
        form : {"patch", "material"}
            A patch of the candidate's size on its surface, as a new material; or the whole surface as a
            new material that absorbs as much. A patch that does not fit becomes a material: see
            `Corrected.notes`.
        at : (x, y, z), optional
            Middle of the patch in m, by default the candidate's ``middle``, or without one the middle
            of the surface. The surface is the one at this place, and the candidate is the most probable
            one on it.
        effect : str, optional
            Of the candidate, by default of the most probable one. Needed, or ``at``, where the most
            probable family on one surface has less than 0.3.

        Raises
        ------
        DataError
            If nothing is other than stated, or not on a surface, or a second room; if ``at`` is on no
            surface, or on one on which nothing was found; if ``effect`` is no candidate there; or if
            neither is stated and the best candidate is improbable.
        """
        from rtcal.finder.corrected import corrected_geometry

        nothing, best = self.reason_for_none, self.likeliest
        if nothing is not None or best is None:
            raise DataError(nothing or self.headline)
        if at is not None or effect is not None:
            best = self._candidate(at, effect)
        elif why := self.undecided:
            raise DataError(why)
        every = {c.title: c.probability for c in self.candidates}
        rivals = [
            name for name in credible_set(every) if name != best.title and every[name] >= SAID
        ]
        one, *others = (f"{name} {100 * every[name]:.0f} %" for name in (best.title, *rivals))
        made = corrected_geometry(self.case, best, form, at)
        return replace(made, support=self.support_of(one, others))

    def _candidate(self, at: Sequence[float] | None, effect: str | None) -> Candidate:
        """Return the most probable candidate on the surface at a place, and of an effect."""
        from rtcal.finder.corrected import surface_at

        every = [c for c in self.candidates if c.can_be_added and c.probability >= _LEAST]
        if at is not None:
            surface = surface_at(self.case, at)
            every = [c for c in every if c.surface == surface]
            if not every:
                raise DataError(f'at lies on "{surface}", on which nothing was found')
        found = next((c for c in every if effect in (None, c.effect)), None)
        if found is None:
            named = dict.fromkeys(c.effect for c in every)
            raise DataError(
                f'effect = "{effect}" is no candidate. Candidates: {listed([*named], last="or")}'
            )
        return found

    @property
    def what(self) -> str:
        """The most probable candidate with its probability."""
        best = self.best
        return "nothing" if best is None else f"{best.title} {100 * best.probability:.0f} %"

    @property
    def headline(self) -> str:
        """The pairs without a place, the verdict, and how probable it is that nothing is other."""
        said = [*without_place(self.case.measured, self.case.simulator.pairs), self._verdict]
        if not self.or_nothing:
            nothing = self.percent(NONE)
            said.append(f"The probability that nothing is other than stated is {nothing}.")
        return " ".join(said)

    @property
    def _verdict(self) -> str:
        """The verdict in a sentence; what cannot be told stands first."""
        best = self.best
        if best is None:
            return "none: no disagreement beyond what prior, measurement and simulator allow."
        first = after_doubt(self.mistake)
        if self.verdict == "hint":
            said = f"hint{self.or_nothing}: {first}{best.title}, but not claimed."
            return f"{said} {' '.join(self.reasons[:1])}".rstrip()
        some = dict.fromkeys(c.effect for c in self.candidates if c.probability >= SAID)
        names = [f"{e} ({100 * self.probabilities[e]:.0f} %)" for e in some]
        claimed = {"named": self.effect, "family": self.family}
        what = f"Other than stated: {claimed.get(self.verdict, listed(names, last='or'))}."
        rest, likely = "", self.likeliest
        if self.verdict != UNKNOWN and self.unexplained >= MOST:
            rest = (
                " This does not explain everything that was measured "
                f"({100 * self.unexplained:.0f} %): something else is other than stated, too."
            )
        if self.verdict == UNKNOWN:
            what = "Something is other than stated that no effect of the library explains."
            if likely is not None:
                known = [c for c in self.candidates if c.effect != UNKNOWN]
                alike = sum(c.probability for c in known if kind(c) == kind(likely))
                share = 100 * alike / sum(c.probability for c in known)
                what += (
                    f" Of the library, {kind(likely)} explains most ({share:.0f} % of the rest)."
                )
        said = f"{self.verdict}{self.or_nothing}: {first}{what} {self.place_in_words}".rstrip()
        return f"{said}{rest}"

    @property
    def place_in_words(self) -> str:
        """The place, as far as the positions tell."""
        best = self.likeliest
        if best is None or best.surface is None:
            return "" if best is None or not best.place else f"Most probably {best.place}."
        if self.surface is not None:
            about = "" if self.located is None else self.located.about
            return f'It is on "{self.surface}" ({100 * self.surfaces[self.surface]:.0f} %){about}.'
        some = [f'"{n}" ({100 * self.surfaces[n]:.0f} %)' for n in self.likely_surfaces]
        return f"These positions do not say on which surface: {listed(some, last='or')}."

    @property
    def outside_groups(self) -> tuple[str, ...]:
        """Why surfaces on which it may be are in no group of those that are not told apart."""
        grouped = {name for group in self.groups for name in group}
        asked = self.likely_surfaces if grouped and self.surface is None else ()
        others = [n for n in asked if n not in grouped]
        least = np.exp(-DISTINCT_NATS) * max(self.surfaces.values(), default=0.0)
        less = [n for n in others if self.surfaces[n] < least]
        apart = [n for n in others if self.surfaces[n] >= least]
        # The groups are those of the most probable effect on a surface.
        effect = next((c.effect for c in self.candidates if c.surface is not None), "it")
        said = {
            "less probable than the first by more than ten to one": less,
            f"where {effect} would be told apart or is not tried; not ruled out": apart,
        }
        return tuple(
            f"Not among these: {listed(names)}, {why}." for why, names in said.items() if names
        )

    def blocks(self) -> list[Block]:
        """Return what the result says."""
        apart = (
            f"Not told apart by these positions: {listed(group, last='or')}."
            for group in self.groups
        )
        notes = (
            *apart,
            *self.outside_groups,
            detection_in_words(self.detection),
            *self.reasons,
            *self.notes,
        )
        table = [self.probable] if self.probable.rows else []
        return [Note(self.headline), *table, *map(Note, notes)]

    @property
    def probable(self) -> Table:
        """The most probable candidates with their sizes, as a table; no row if nothing is found."""
        said = [c for c in self.candidates if c.probability >= SAID and self.verdict != "none"]
        rows = [Row(c.title, [f"{100 * c.probability:.0f} %", c.in_words]) for c in said[:8]]
        return Table(["probability", "size"], rows)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            **super().to_dict(),
            "effect": self.effect,
            "surface": self.surface,
            "mistake": self.mistake or None,
            "unexplained": self.unexplained,
            "surfaces": dict(self.surfaces),
            "likely_surfaces": list(self.likely_surfaces),
            "groups": [list(group) for group in self.groups],
            "candidates": [c.to_dict() for c in self.candidates[:20]],
            "nats_of_noise": self.detection.noise,
            "nats_of_means": self.detection.means,
            "parameters": list(self.parameters),
            "pairs": [list(pair) for pair in self.pairs],
            "centre_frequencies": json_numbers(self.case.room.centre_frequencies),
            "map": json_numbers(self.map),
        }


BY_SEED = 0.5
"""Standard deviation in nats of the score by random numbers, in a development room in which something
is detected (`python -m benchmarks.studies.pairs.where_seeds --rooms 0.7 --seeds 0,1,2,3`)."""


def detection_in_words(detection: Detection) -> str:
    """Return the score and its threshold in a sentence or two."""
    score, threshold = detection.score, detection.threshold
    said = f"Evidence that something is other than stated: {score:+z.1f} nats; "
    said += f"threshold {threshold:.1f}."
    if abs(score - threshold) < BY_SEED:
        said += (
            f" In one room random numbers gave it a standard deviation of {BY_SEED:.1f} nats: look "
            "whether another seed says the same."
        )
    if detection.verdict is not None and detection.noise is not None and detection.noise > 0:
        said += f" That one pair is noisier than assumed: {detection.noise:+z.1f} nats."
    if detection.means is None:
        return said
    return f"{said} Means of these data over positions give {detection.means:+z.1f} nats."


LIKELY = 0.7
"""Probability that the likely surfaces hold."""


def strongest(map_: Array) -> tuple[int, int, int]:
    """Return the place of the largest disagreement."""
    p, i, k = np.unravel_index(int(np.nanargmax(np.abs(map_))), map_.shape)
    return int(p), int(i), int(k)


MARGIN = 0.7
"""Least distance in m of a proposed place from walls, and from sources."""
_RIVALS = 3
"""Most surfaces that are compared."""


@dataclass(frozen=True)
class Place:
    """A place for a further receiver.

    Attributes
    ----------
    point : (x, y, z)
        In m, at the mean height of the receivers.
    source : str
    nats : float
        What a measurement there is expected to add to the evidence between the two most probable
        surfaces.
    """

    point: tuple[float, float, float]
    source: str
    nats: float


def next_position(
    finding: PositionsFinding, *, number: int = 16, seed: int = 0
) -> tuple[Place, ...]:
    """Return places for a further receiver, the one that tells most first.

    Parameters
    ----------
    finding : PositionsFinding
        With at least two surfaces that may be it.
    number : int
        Places that are tried, on a grid over the room.
    seed : int

    Raises
    ------
    DataError
        If at most one surface is in question, or no place of the grid is free.
    """
    checks.whole("number", number, 1)
    rivals = _rivals(finding)
    case = finding.case
    places = _grid(case, number)
    tracer = replace(
        case.simulator,
        geometry=case.divided.geometry,
        receivers={f"place {i + 1}": p for i, p in enumerate(places)},
    )
    weighing = Weighing(tracer, finding.parameters, seed)
    alpha = weighing.alpha
    stated = weighing.observe(alpha)
    shifts = [weighing.observe(_with(case, alpha, rival)) - stated for rival in rivals]
    weights = [finding.surfaces[str(rival.surface)] for rival in rivals[1:]]
    precision = np.linalg.inv(_error(finding))
    nats = np.zeros(len(tracer.pairs))
    for shift, weight in zip(shifts[1:], weights, strict=True):
        apart = np.moveaxis(shifts[0] - shift, 1, 0).reshape(len(nats), -1)
        nats += weight / sum(weights) * 0.5 * np.einsum("in,nm,im->i", apart, precision, apart)
    points = dict(zip(tracer.receivers, places.tolist(), strict=True))
    every = [
        Place((points[r][0], points[r][1], points[r][2]), s, float(n))
        for (s, r), n in zip(tracer.pairs, nats, strict=True)
    ]
    return tuple(sorted(every, key=lambda place: -place.nats))


def _rivals(finding: PositionsFinding) -> list[Candidate]:
    """Return the most probable candidate on each surface that is in question."""
    out = []
    for name in list(finding.surfaces)[:_RIVALS]:
        best = next((c for c in finding.candidates if c.surface == name), None)
        if best is not None and finding.surfaces[name] > 0:
            out.append(best)
    if len(out) < 2:
        raise DataError("at most one surface is in question; there is nothing to tell apart")
    return out


def _grid(case: PositionsCase, number: int) -> Array:
    """Return up to ``number`` free places, (n, 3), spread over the room."""
    corners = case.geometry.vertices
    low, high = corners.min(axis=0), corners.max(axis=0)
    height = float(np.mean([p[2] for p in case.simulator.receivers.values()]))
    sources = np.array(list(case.simulator.sources.values()))
    for steps in range(2, 40):
        across = (np.arange(steps) + 0.5) / steps
        plan = [low[:2] + np.array(at) * (high - low)[:2] for at in product(across, across)]
        points = np.array([[*at, height] for at in plan])
        apart = np.linalg.norm(points[:, np.newaxis] - sources, axis=2).min(axis=1)
        free = points[
            case.geometry.contains(points)
            & (case.geometry.wall_distance(points) > MARGIN)
            & (apart > MARGIN)
        ]
        if len(free) >= number:
            chosen = np.linspace(0, len(free) - 1, number).round().astype(int)
            return np.asarray(free[chosen])
    raise DataError(f"the room has no {number} places {MARGIN:g} m from walls and sources")


def _with(case: PositionsCase, alpha: Array, rival: Candidate) -> Array:
    """Return alpha (n_faces, n_bands) of the divided geometry with a candidate.

    It is spread over the part that holds at least half of its probability, else over its surface.
    """
    divided = case.divided
    faces = divided.surfaces[list(case.faces).index(str(rival.surface))]
    if rival.middle is not None:
        faces = next(part.faces for part in divided.parts if part.middle == rival.middle)
    share = min(rival.size / float(divided.geometry.face_areas[faces].sum()), 1.0)
    out = alpha.copy()
    out[faces] += share * (rival.spectrum - out[faces])
    return np.clip(out, 0.0, 0.99)


def _error(finding: PositionsFinding) -> Array:
    """Return the covariance of a pair's error, (n, n), n = parameters x bands.

    What all pairs have in common is known from those that were measured. So it is that of the control
    runs within a run; the noise of the tracing stands for that of a response.
    """
    errors = finding.controls.at(finding.parameters, finding.pairs).errors
    within = errors - errors.mean(axis=2, keepdims=True)
    rows = np.moveaxis(within, 2, 1).reshape(len(errors) * errors.shape[2], -1)
    sample = rows.T @ rows / max(len(rows) - len(errors), 1)
    # Far from singular: a tenth of the variance is each value's own.
    return np.asarray(0.9 * sample + 0.1 * np.diag(np.diag(sample)) + 1e-9 * np.eye(len(sample)))
