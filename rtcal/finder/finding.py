"""What a search found: one class for means over positions, for every position and for two states.

A `Finding` is data: its case, the verdict, probabilities, sizes and doubts. What differs by the kind of
data are further fields. Behind the class stand the sentences that terminal, notebook and page print of
it, by kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, ClassVar, Literal

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.finder.apply import (
    Corrected,
    changed_room,
    corrected_case,
    corrected_geometry,
    surface_at,
)
from rtcal.finder.case import Case, StatesCase
from rtcal.finder.claim import (
    CLAIMED,
    DISTINCT_NATS,
    LIKELY,
    MOST,
    SAID,
    Candidate,
    Detection,
    Names,
    Size,
    after_doubt,
    amount,
    by_family_sets,
    credible_set,
    family_of,
    numbers_of,
    over_frequency,
    percent,
    unexplained,
)
from rtcal.finder.effects import AppliedEffect, CoupledRoom, Effect, WrongVolume, checked_effects
from rtcal.finder.evidence import COEFFICIENTS, NONE, UNKNOWN, OffTogether
from rtcal.finder.means.verdict import Fit
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.records import data_of, record_of_means, record_of_several
from rtcal.loop.measured_pairs import without_place
from rtcal.support import blocks, checks, text
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence, listed
from rtcal.support.types import Array

LEAST_ADDED = 0.3
"""Probability below which ``apply`` adds an effect only where it is stated by its name. Of first
candidates with less 9 of 41 were right."""
LEAST_PAIRS = 4
"""Fewest pairs of a verification at held-out pairs: half of them have to find it again."""
NATS = "2.3 nats are odds of ten to one"
_NOTHING = 0.1
"""Probability that nothing is other than stated, from which a verdict says it first."""
_CHOICE = 6
"""Most candidates of which a sentence gives the choice."""
_LEAST = 1e-3
"""Probability below which nothing is added to a surface, even where the user names it."""
BY_SEED = 0.5
"""Standard deviation in nats of the score at positions by random numbers, in a development room in
which something is detected (room 0.7 of
benchmarks/studies/geometric_world, four seeds)."""

Kind = Literal["means", "positions", "states"]


def _no_numbers() -> Array:
    return np.zeros(0)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Finding(Result):
    """The result of a search, of means over positions, of every position or of two states.

    Attributes
    ----------
    case : Case, PositionsCase or StatesCase
    verdict : {"none", "hint", "named", "family", "ambiguous", "unknown"}
        ``named``: an effect whose probability is at least 0.9, and that passes every check; of two
        states the climate alone, where it explains T by chi-square. ``family``: a family of that
        probability, but no member, or one with a doubt about its size or fit. ``ambiguous``: something
        is missing, and effects of several families explain it. ``unknown``: the model lacks something
        that no effect of the library explains. ``hint``: the score does not exceed the threshold but is
        above 0, nothing missing has a third of the probability, no effect and no family has (both of
        means over positions), or a check has failed (``reasons``).
    family : str or None
        The family whose probability is at least 0.9.
    probabilities, families : mapping of str to float
        Of "none", "coefficients", "unknown" and each effect, and of each family, that it is there; the
        most probable first. "added absorption" has the families whose names begin with it.
    detection : Detection
        The evidence that something is other than stated, and its threshold.
    reasons : tuple of str
        Why what is most probable is not claimed, or not by its name. Of means, a doubt about the size,
        the fit or what is stated leaves its family claimed; the last stands first and ``leads``.
    notes : tuple of str
        What was dropped and assumed, and reasons to doubt the result, whatever it is.
    effects : mapping of str to Effect
        The effects that were tried, by name.
    candidates : tuple of Candidate
        What explains the data, the most probable first. Of means, the members, then what explains the
        data in place of one, or single effects that hold 0.9 of what is not "none". At positions, every
        effect in every place. Of two states, the kinds of change with 0.03 and more: "added porous",
        each with the change of the absorption area in m², mean over the bands of ``middle``.
    named : tuple of str
        The effects that are claimed.
    left_out : tuple of str
        What was not tried, as asked; of means it is among the ``notes``.
    mistake : str
        The doubt that T is twice or half the model's; "" without it.
    surfaces : mapping of str to float
        At positions, the probability of each surface, given that something stands on one. Of two
        states, that something changed on it; empty where none is told.
    sets : mapping of (names) to float
        Of means, the sets of effects, () being none; of two states, the surfaces that changed together.
    size : Size or None
        Of the best effect; of two states the change of the absorption area in m², mean over the bands
        of ``middle``.
    named_families, named_set, members : tuple of str
        Of means. The families that are claimed; those of two or three effects that are claimed together
        (`rtcal.finder.means.verdict.TWO`); the effects of the most probable set, in the order in which
        they act: what `apply` adds.
    stand_ins : mapping of str to tuple of str
        Of each of two or more members, the effects that explain the data as well in its place.
    evidence : mapping of str to float
        Log evidence over "none" in nats, by effect alone, of "coefficients" and of "unknown".
    likely : sequence of (tuple of AppliedEffect, float)
        The most probable sets with their parameters, and their probabilities, which sum to 1: what
        `rtcal.finder.plan` goes on from.
    alpha : array (n_materials, n_bands)
        Posterior mean of the coefficients, averaged over all sets: what `apply` cannot give, since it
        adds one set.
    prior : Prior
    fits, alone : mapping of str to Fit
        Parameters, size and gap of each candidate; of a member with the other members in the model, and
        of two or more members without the others.
    advice : str
        The next measurement that would decide.
    residuals : array (n_configurations, n_features, n_bands)
        Modelled less measured, as every gap, over its standard deviation: amount (ln T20), shape
        (EDT/T20, T30/T20), level (C80, G). NaN where nothing was measured.
    leads : bool
    discrepancy : ModelDiscrepancy
        Bias and covariance of the model's error.
    not_judged : mapping of str to str
        Effects that were not tried, since the room does not state what they act by: each with the
        reason.
    surface : str or None
        At positions, the surface that is claimed: something stands on it with a probability of at least
        0.9, and the checks agree.
    groups : tuple of tuples of str
        Surfaces that these positions cannot tell apart.
    map : array (n_parameters, n_pairs, n_bands)
        Simulated less measured in standard deviations of what prior, simulator and measurement leave
        open; NaN where nothing was measured. ``parameters`` and ``pairs`` are its axes.
    controls : ControlRuns
        The simulator's error, to be given to another search or calibration.
    unexplained : float
        Probability that something is other than stated that no effect explains, alone or beside one.
    area : array (n_bands,)
        Of two states, the surfaces' absorption area before in m², by the equation; NaN where T is
        missing.
    change : array (3, n_bands)
        Its change in m², if absorption was added or removed: mean and both ends of the 90 % interval.
        NaN where that was not tried.
    shift : array (n_bands,)
        Mean of ln(T after / T before) if something changed, by absorption and by climate.
    middle : tuple of float
        Bands in Hz: those of 500 Hz to 2 kHz, or all where none of them was measured.
    climate : float
        Probability that the climate of the air is another as well, if absorption was added or removed.

    Notes
    -----
    Two states that are exchanged have the same finding, but for "added" and "removed", which are
    exchanged, and all changes, which have the other sign. Their score is the log evidence that
    something changed over that nothing did. Where nothing changed, and the noise is as assumed, it
    exceeds the threshold ln 20 in at most one of twenty cases, whatever was measured: the mean of a
    likelihood ratio is then 1.
    """

    record_kind: ClassVar[str] = "finding 3"

    case: Any
    verdict: str
    family: str | None
    probabilities: Mapping[str, float]
    families: Mapping[str, float]
    detection: Detection
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    effects: Mapping[str, Effect]
    candidates: tuple[Candidate, ...]
    named: Names = ()
    left_out: Names = ()
    mistake: str = ""
    surfaces: Mapping[str, float] = field(default_factory=dict)
    sets: Mapping[Names, float] = field(default_factory=dict)
    size: Size | None = None

    named_families: Names = ()
    named_set: Names = ()
    members: Names = ()
    stand_ins: Mapping[str, Names] = field(default_factory=dict)
    evidence: Mapping[str, float] = field(default_factory=dict)
    likely: Sequence[tuple[tuple[AppliedEffect, ...], float]] = ()
    alpha: Array = field(default_factory=_no_numbers)
    prior: Any = None
    fits: Mapping[str, Fit] = field(default_factory=dict)
    alone: Mapping[str, Fit] = field(default_factory=dict)
    advice: str = ""
    residuals: Array = field(default_factory=_no_numbers)
    leads: bool = False
    discrepancy: Any = None
    not_judged: Mapping[str, str] = field(default_factory=dict)

    surface: str | None = None
    groups: tuple[Names, ...] = ()
    map: Array = field(default_factory=_no_numbers)
    parameters: tuple[str, ...] = ()
    pairs: tuple[tuple[str, str], ...] = ()
    controls: Any = None
    unexplained: float = 0.0

    area: Array = field(default_factory=_no_numbers)
    change: Array = field(default_factory=_no_numbers)
    shift: Array = field(default_factory=_no_numbers)
    middle: tuple[float, ...] = ()
    climate: float = 0.0

    @property
    def kind(self) -> Kind:
        """What was compared: means over positions, every position, or two states."""
        if isinstance(self.case, PositionsCase):
            return "positions"
        return "states" if isinstance(self.case, StatesCase) else "means"

    @property
    def best(self) -> Candidate | None:
        """The most probable candidate; None where the verdict is "none"."""
        return self.candidates[0] if self.candidates and self.verdict != "none" else None

    @property
    def best_effect(self) -> str | None:
        """The most probable effect, "coefficients" or "unknown"; None where the verdict is "none"."""
        return None if self.best is None else self.best.effect

    @property
    def effect(self) -> str | None:
        """The effect that is named; of means, else the best, but of a family none."""
        if self.named or self.kind != "means" or self.verdict == "family":
            return self.named[0] if self.named and self.verdict not in ("none", "family") else None
        return self.best_effect

    @property
    def names(self) -> Names:
        """The candidates' effects; "coefficients" and "unknown" may be among them."""
        return tuple(c.effect for c in self.candidates)

    @property
    def score(self) -> float:
        """The evidence in nats that must exceed the ``threshold``."""
        return self.detection.score

    @property
    def threshold(self) -> float:
        """Score that few rooms exceed in which nothing is other than stated."""
        return self.detection.threshold

    @property
    def detected(self) -> bool:
        """Whether something is other than stated, whatever it is."""
        return self.verdict not in ("none", "hint")

    @property
    def best_parameters(self) -> Mapping[str, float]:
        """The best effect's parameters; the size among them is the `size`'s mean."""
        return {} if self.best is None else self.best.parameters

    @property
    def engines(self) -> tuple[str, ...]:
        """The simulators of the control rooms, from which threshold and discrepancy were estimated."""
        return () if self.discrepancy is None else self.discrepancy.engines

    @property
    def numbers(self) -> tuple[float, ...]:
        """Of means, the probabilities of 0, 1, 2, ... effects."""
        return numbers_of(self.sets)

    @property
    def more_than_one(self) -> bool:
        """Whether sets of two and more effects were compared."""
        return self.kind == "means" and len(self.numbers) > 2

    @property
    def likely_sets(self) -> dict[str, float]:
        """The sets that are probable enough to be printed; {} where each has one effect."""
        if not self.more_than_one:
            return {}
        return {" + ".join(s) or NONE: p for s, p in self.sets.items() if p >= SAID}

    @property
    def family_sets(self) -> dict[Names, float]:
        """Of means, probabilities of sets of families; all of "added absorption" as one."""
        return by_family_sets(self.sets if self.kind == "means" else {}, self.effects)

    @property
    def coefficients(self) -> OffTogether | None:
        """The common error of the coefficients, if one is likely beside the most probable set."""
        return self.fits[self.members[-1]].coefficients if self.members else None

    @property
    def located(self) -> Candidate | None:
        """The most probable candidate on the most probable surface, None without one."""
        first = next(iter(self.surfaces), None)
        return next((c for c in self.candidates if c.surface == first and first), None)

    @property
    def likely_surfaces(self) -> Names:
        """The fewest surfaces that hold `LIKELY` of the probability; none where hardly anything does.

        Where something stands on a surface with less than `SAID`, no effect on one is printed either.
        """
        if sum(c.probability for c in self.candidates if c.surface is not None) < SAID:
            return ()
        before = np.cumsum([0.0, *self.surfaces.values()])
        return tuple(n for n, held in zip(self.surfaces, before, strict=False) if held < LIKELY)

    @property
    def likeliest(self) -> Candidate | None:
        """The most probable candidate of the library, which `apply` adds; None without one.

        Where the verdict at positions is "unknown", the candidate's surface or its family must hold at
        least half of the rest.
        """
        known = [c for c in self.candidates if c.effect != UNKNOWN] if self.best else []
        if not known or self.verdict != UNKNOWN:
            return next(iter(known), None)
        first, rest = known[0], sum(c.probability for c in known)
        of_surface = sum(c.probability for c in known if c.surface == first.surface)
        of_family = sum(c.probability for c in known if c.kind == first.kind)
        most = max(of_family, of_surface if first.surface is not None else 0.0)
        return first if most >= MOST * rest > 0 else None

    @property
    def claimed_surfaces(self) -> Names:
        """The surfaces of two states that are claimed: each changed, at a probability of 0.9."""
        return tuple(name for name, p in self.surfaces.items() if p >= CLAIMED)

    @property
    def spectrum(self) -> str:
        """The trend of a change over frequency: rising, falling or alike; "" of a single band."""
        change = np.atleast_2d(self.change)[0]
        change = change[np.isfinite(change)]
        return over_frequency(change) if len(change) > 1 else ""

    @property
    def can_be_added(self) -> bool:
        """Whether `apply` has something to add.

        Of means a member of the library; at positions what is detected and stands on a surface, and is
        no second room; of two states absorption that changed.
        """
        if self.kind == "means":
            return self.verdict in ("named", "family", "ambiguous") and bool(self.members)
        if self.kind == "states":
            return self.detected and self.family != "climate"
        return self.detected and self.likeliest is not None and self.likeliest.can_be_added

    @property
    def can_be_verified(self) -> bool:
        """Whether `rtcal.finder.verify` can compare the gap with and without what was found.

        Of means for one effect that is probable; else for pairs of which half can predict the others.
        """
        if self.kind == "means":
            return self.can_be_added and len(self.members) == 1 and self._least >= LEAST_ADDED
        if self.kind == "states":
            return self.detected and len(self.case.pairs) >= LEAST_PAIRS
        return self.can_be_added and len(self.pairs) >= LEAST_PAIRS

    @property
    def _least(self) -> float:
        """The smallest probability of the members, that each is there at all."""
        return min((self.probabilities[n] for n in self.members), default=0.0)

    @property
    def reason_for_none(self) -> str | None:
        """Why there is nothing to add, in words; None where there is something."""
        return None if self.can_be_added else _nothing_to_add(self)

    @property
    def undecided(self) -> str:
        """Why `apply` must be told what it is to add, in words; "" where it need not be."""
        return _undecided(self) if self.can_be_added else ""

    def apply(
        self,
        *,
        effect: str | None = None,
        form: str | None = None,
        at: Sequence[float] | None = None,
    ) -> Corrected:
        """Return the model with what was found in it: its room, its simulator and, of means, its case.

        Of means the most probable effects are added, each with its size beside the others; of an
        ambiguous finding and a family the best candidate. Where the coefficients are off together, the
        room's alpha is moved and its sigma widened. An effect that the case has already is left as it
        is. At positions the most probable candidate becomes a patch on its surface. Of two states the
        room is that of the second one. What has a probability of less than 0.3 is added only where it
        is stated.

        Parameters
        ----------
        effect : str, optional
            The candidate to add instead of the most probable one.
        form : {"patch", "material"}, optional
            At positions, by default a patch of the candidate's size as a new material; or the whole
            surface as a new material that absorbs as much. A patch that does not fit becomes a
            material: see `Corrected.notes`.
        at : (x, y, z), optional
            At positions, the middle of the patch in m; by default the candidate's ``middle``, or
            without one the middle of the surface. The surface is the one at this place.

        Raises
        ------
        DataError
            If there is nothing to add; if ``effect`` is no candidate; if none is stated and the most
            probable one has less than 0.3; for a volume that is not claimed; if ``at`` is on no
            surface, or on one on which nothing was found; for what belongs to another kind of data.

        Examples
        --------
        >>> import rtcal as rt
        >>> room = rt.Room(name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1] * 2],
        ...                sigma=[[0.05] * 2], centre_frequencies=[500, 1000], air=rt.Air())
        >>> t = {"before": [[1.5, 1.4]], "after": [[0.9, 0.7]]}
        >>> before, after = (
        ...     rt.Measurement(centre_frequencies=[500, 1000], values={"t20": v}, n_sources=6,
        ...                    n_receivers=6) for v in t.values())
        >>> changed = rt.find(room, after, before=before).apply()
        >>> now = rt.Eyring().reverberation_time(changed.room)
        >>> print(abs(now / [0.9, 0.7] - 1) < 0.1)  # within 10 %
        [ True  True]
        """
        if self.kind == "means":
            _refuse(self, form=form, at=at)
            return corrected_case(self.with_effects(members=self.chosen(effect)))
        if (nothing := self.reason_for_none) is not None:
            raise DataError(nothing)
        if self.kind == "states":
            _refuse(self, effect=effect, form=form, at=at)
            kinds = [c.effect for c in self.candidates]
            return changed_room(self.case, self.area, self.change, self.claimed_surfaces, kinds)
        best = self._candidate(at, effect)
        made = corrected_geometry(self.case, best, form or "patch", at)
        return replace(made, support=support(self, best))

    def chosen(self, effect: str | None = None) -> Names:
        """Return the effects of means that `apply` adds; DataError as it does."""
        if not self.can_be_added:
            raise DataError(f'the verdict is "{self.verdict}"; there is no effect to add')
        if effect is not None and effect not in self.fits:
            raise DataError(
                f'effect = "{effect}" is no candidate. Candidates: {_listed_candidates(self)}'
            )
        why = self.undecided if effect is None else _volume_in_words(self, (effect,))
        if why:
            raise DataError(why)
        return self.members if effect is None else (effect,)

    def with_effects(
        self,
        case: Case | None = None,
        members: Names | None = None,
        fits: Mapping[str, Fit] | None = None,
    ) -> Case:
        """Return the case with effects in its model; by default those of the most probable set.

        It is what a verification compares with the case, however probable the effects are. ``fits`` are
        the effects' parameters and sizes, by default those that were found.
        """
        base: Case = self.case if case is None else case
        members = self.members if members is None else checks.texts("members", members)
        present = {a.name for a in base.applied}
        if present.issuperset(members):
            return base
        fits = self.fits if fits is None else checks.mapped("fits", fits)
        missing = [n for n in members if n in self.effects and n not in present]
        for name in (*missing, members[-1]):
            if name not in fits:
                has = checks.shown([*fits])
                raise DataError(f'members has "{name}", which is not in fits; there are {has}')
        off = fits[members[-1]].coefficients
        if off is not None:
            base = off.apply(base)
        added = [fits[name].applied(self.effects[name]) for name in missing]
        return replace(base, applied=(*base.applied, *added)) if added else base

    def _candidate(self, at: Sequence[float] | None, effect: str | None) -> Candidate:
        """Return the candidate to add to a surface: the most probable, at a place, of an effect."""
        if at is None and effect is None and (why := self.undecided):
            raise DataError(why)
        every = [c for c in self.candidates if c.can_be_added and c.probability >= _LEAST]
        if at is None and effect is None and self.likeliest is not None:
            return self.likeliest
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

    def percent(self, name: str) -> str:
        """The probability of an effect, or of "none", in percent."""
        return percent(self.probabilities.get(name, 0.0))

    @property
    def what(self) -> str:
        """What was found, in a few words."""
        if self.kind == "states":
            return _change_in_words(self)
        if self.kind == "positions":
            return "nothing" if self.best is None else f"{self.best.title} {_chance(self.best)}"
        some = self.members if len(self.members) > 1 else self.names
        return text.shortened(", ".join(f"{c} {self.percent(c)}" for c in some)) or "no effect"

    @property
    def headline(self) -> str:
        """The verdict in a sentence or two."""
        return _SAID[self.kind][0](self)

    def blocks(self) -> list[Block]:
        """Return the headline, and what else is printed."""
        return _SAID[self.kind][1](self)

    def _repr_html_(self) -> str:
        return blocks.notebook(self.headline, self.blocks()[1:])

    def __repr__(self) -> str:
        """Return one line: verdict, what was found, score and threshold."""
        score = f"{self.score:+.1f} nats, threshold {self.threshold:.1f}"
        return f"<Finding {self.verdict}: {self.what}; {score}>"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        made = _RECORDS[self.kind](self)
        names = f"{_RECORDED['all']} {_RECORDED[self.kind]}".split()
        return {n: made[n] if n in made else json_numbers(getattr(self, n)) for n in names}


_RECORDED = {
    "all": "verdict family probabilities families score threshold reasons notes",
    "means": "detected_by effect named named_families named_set members undecided amount candidates "
    "numbers sets evidence sizes sizes_alone stand_ins alpha coefficients engines parameters material "
    "size runner_up advice not_judged residuals",
    "positions": "effect surface mistake unexplained surfaces likely_surfaces groups candidates "
    "nats_of_noise nats_of_means parameters pairs centre_frequencies map",
    "states": "surfaces claimed_surfaces sets size bands_of_size kinds centre_frequencies before after "
    "absorption_area_before change pairs",
}
"""Entries of a record in their order: what `_RECORDS` makes, else attributes as they are."""


def _refuse(f: Finding, **stated: object) -> None:
    """Raise DataError for what is stated, and belongs to another kind of data."""
    of = {"means": "means over positions", "positions": "positions", "states": "two states"}
    for name, value in stated.items():
        if value is not None:
            raise DataError(f"{name} is not of a finding of {of[f.kind]}")


def or_nothing(f: Finding) -> str:
    """Return what stands behind a verdict where "none" has `_NOTHING` or more; else ""."""
    probable = f.verdict != "none" and f.probabilities.get(NONE, 0.0) >= _NOTHING
    return f" (nothing: {f.percent(NONE)})" if probable else ""


def _chance(candidate: Candidate) -> str:
    return percent(candidate.probability)


def rivals(f: Finding, best: Candidate | None = None) -> tuple[Candidate, ...]:
    """Return the candidates beside the most probable set, or at positions beside another one."""
    if f.kind == "means":
        return f.candidates[max(1, len(f.members)) :]
    every = {c.title: c.probability for c in f.candidates}
    credible = [name for name in credible_set(every) if every[name] >= SAID]
    return tuple(c for c in f.candidates if c is not best and c.title in credible)


def support(f: Finding, best: Candidate) -> str:
    """Return verdict, what is best and what else explains the data."""
    title = best_title(f) if f.kind == "means" else best.title
    others = ", ".join(f"{c.title} {_chance(c)}" for c in rivals(f, best))
    said = f"{f.verdict}: {title} {_chance(best)}"
    return f"{said}; {others}, not told apart" if others else said


def _listed_candidates(f: Finding) -> str:
    return listed([f"{n} ({f.percent(n)})" for n in f.names if n != UNKNOWN], last="or")


def _nothing_to_add(f: Finding) -> str:
    """Return why there is nothing to add."""
    if f.kind == "states":
        if not f.detected:
            return f"{f.headline} There is nothing to add to the room."
        return "The climate of the air changed: state temperature and humidity in the room's file."
    if f.kind == "positions":
        best = f.likeliest
        if f.detected and best is not None and best.effect == CoupledRoom.name:
            return f"{best.title}: {CoupledRoom.not_in_simulator}"
        return f"{f.headline} So no surface lacks anything to add."
    if f.verdict == "hint" and f.reasons:
        return f"Nothing to add: a hint of {best_title(f)} only. {as_sentence(f.reasons[0])}"
    if f.verdict == "hint":
        return (
            f"Nothing to add: a hint of {best_title(f)} only, {f.score:.1f} nats of the "
            f"{f.threshold:.1f} that it must exceed (verdict hint)."
        )
    if f.verdict == "none":
        return "Nothing to add: prior, measurement and model agree (verdict none)."
    return (
        "Nothing to add: something is missing that no effect of the library explains "
        f"(verdict {f.verdict})."
    )


def _undecided(f: Finding) -> str:
    """Return why the user must state what is to be added; "" where it is clear.

    What stands on a surface counts with its family: which porous absorber it is changes little. Where
    the verdict is "unknown", the shares are those of the rest.
    """
    if f.kind == "means":
        if f._least >= LEAST_ADDED:
            return _volume_in_words(f, f.members)
        return (
            f"No effect is stated, and the most probable has less than {percent(LEAST_ADDED)}. "
            f"Candidates: {_listed_candidates(f)}. State one: effect = NAME."
        )
    best = f.likeliest
    if f.kind == "states" or best is None:
        return ""
    known = [c for c in f.candidates if c.effect != UNKNOWN]
    share = sum(c.probability for c in known if (c.surface, c.kind) == (best.surface, best.kind))
    if f.verdict == UNKNOWN:
        share /= sum(c.probability for c in known)
    if share >= LEAST_ADDED:
        return ""
    some = [c for c in known if c.can_be_added and c.probability >= SAID][:_CHOICE]
    return (
        "Neither an effect nor a place is stated, and the most probable family on one surface has "
        f"less than {percent(LEAST_ADDED)}. Candidates: "
        f"{listed([c.likely for c in some or [best]], last='or')}. State one: "
        "effect = NAME, or its place: at = X,Y,Z."
    )


def _volume_in_words(f: Finding, members: Names) -> str:
    """Return why a volume among the members is not changed; "" where it is, or none is there."""
    name = WrongVolume.name
    if name not in members or name in f.named:
        return ""
    others = [n for n in f.names if n not in (name, UNKNOWN)]
    instead = f", or state another effect: {listed(others, last='or')}" if others else ""
    return (
        f"effect = {name} has {f.percent(name)}, and a stated volume is changed only where its "
        f"error is claimed, from {percent(CLAIMED)}. Measure the volume and state it in the "
        f"room's file{instead}."
    )


# Means over positions.


def feature_names(measured: Measurement) -> tuple[str, ...]:
    """Return the features' names as printed, by the reverberation time that was measured."""
    time = measured.time_label
    return time, f"EDT/{time}", "T30/T20", "C80", "G"


def title_of(f: Finding, name: str) -> str:
    """Return a candidate as a sentence names it."""
    return next((c.title for c in f.candidates if c.effect == name), name)


def best_title(f: Finding) -> str:
    """Return the best effect, or the most probable set, as a sentence names it."""
    return listed([title_of(f, n) for n in f.members or (str(f.best_effect),)])


def runner_up(f: Finding) -> str:
    """Return the second most probable effect, or "none"."""
    return next((k for k in f.probabilities if k not in (NONE, f.best_effect)), NONE)


def added(f: Finding, members: Names) -> str:
    """Return the effects that `Finding.apply` adds, and those that explain the data as well."""
    titles = listed([f"{title_of(f, n)} ({f.percent(n)})" for n in members])
    if len(members) > 1:
        families = dict.fromkeys((*_families_alone(f), *f.named_set))
        claimed = listed([*f.named, *(f"the family {name}" for name in families)])
        said = f"Of it, {claimed} is claimed." if claimed else "Nothing of it is claimed."
        if set(members) <= set(f.named):
            said = "It is claimed."
        return f"Added: {titles}, the most probable set ({percent(f.sets[members])}). {said}"
    others = listed([f"{n} ({f.percent(n)})" for n in f.names if n not in members])
    beside = f" Candidates beside it: {others}." if others else ""
    return f"Added{'' if members == f.members else ', as stated'}: {titles}.{beside}"


def _families_alone(f: Finding) -> list[str]:
    """Return the claimed families of which no effect is claimed."""
    of_named = {family_of(n, f.effects) for n in f.named}
    return [name for name in f.named_families if name not in of_named]


def sentence_of(f: Finding) -> str:
    """Return the verdict as a sentence about the model, after the doubt that comes first."""
    first = after_doubt(f.reasons[0] if f.leads else "")
    if len(f.members) > 1 or (f.named and f.named != f.members):
        return _of_several(f, first)
    if f.verdict == "none":
        return "No disagreement beyond what prior, measurement and model error allow."
    if f.verdict == "hint" and f.reasons:
        return f"{as_sentence(f.reasons[0])} So it is a hint of {best_title(f)} only."
    if f.verdict == "hint":
        return f"A hint of {best_title(f)}, under the threshold."
    if f.verdict == "unknown":
        library = {effect.name for effect in checked_effects(None)}
        if library <= {*f.effects, *f.not_judged}:
            return "Something is missing that no effect of the library explains."
        return as_sentence(f"{unexplained(tuple(f.effects))}: something else is missing")
    others = ", ".join(f"{title_of(f, c)} ({f.percent(c)})" for c in f.names)
    if f.verdict == "ambiguous":
        return f"{_contradiction(f)}: one of {others}."
    fit = f.fits.get(str(f.best_effect))
    lead = "" if fit is None or not _amount(f) else f"{_amount(f)} "
    if f.verdict == "family":
        which = "most probably" if len(f.names) == 1 else "one of"
        return f"{first}{lead}{_contradiction(f)}: {f.family}, {which} {others}."
    if f.best_effect == COEFFICIENTS:
        return f"{lead}The coefficients are off together."
    return f"{lead}{_contradiction(f)}: {best_title(f)}."


def _of_several(f: Finding, doubt: str) -> str:
    """Return the claims about effects, families and sets of families; what is likely without one."""
    likely = listed([f"{n} ({f.percent(n)})" for n in f.members])
    if f.verdict == "ambiguous":
        known = max(f.probabilities[n] for n in f.members)
        if f.probabilities.get(UNKNOWN, 0.0) <= known:
            return f"Something is missing; most probable is {likely}."
        return (
            f"Something is missing; most probable of the library is {likely}, and something that no "
            f"effect of the library explains is missing ({f.percent(UNKNOWN)})."
        )
    claimed = [f"{n} ({f.percent(n)})" for n in f.named]
    claimed += [f"{n} ({percent(f.families[n])})" for n in _families_alone(f)]
    said = [f"Missing from the model, or not as stated: {listed(claimed)}."] if claimed else []
    if f.named_set:
        said.append(
            f"More than one thing is missing ({percent(sum(f.numbers[2:]))}); most probable together: "
            f"{listed(f.named_set)} ({percent(f.family_sets[f.named_set])})."
        )
    return doubt + " ".join(said)


def _amount(f: Finding) -> str:
    """Return the absorption that the room has more or less; "" where that is not claimed."""
    fit = f.fits.get(str(f.best_effect))
    alone = f.verdict in ("named", "family") and len(f.members) < 2
    if not alone or fit is None or fit.absorption is None:
        return ""
    return f"The room has {fit.absorption.words}."


def _contradiction(f: Finding) -> str:
    """Return whether the candidates contradict what is stated, or add to it, or either."""
    contradicting = {
        name == COEFFICIENTS or (name in f.effects and f.effects[name].contradicts(f.case.room))
        for name in f.names
    }
    if len(contradicting) > 1:
        return "Missing from the model, or not as stated"
    return "Not as stated" if contradicting == {True} else "Missing from the model"


def sentences(f: Finding) -> tuple[str, ...]:
    """Return what text and page have below the headline: sizes, sets, what was not judged, evidence."""
    sizes = [size_of(f, n) for n in f.names if f.probabilities.get(n, 0.0) >= SAID]
    sets = ", ".join(f"{names} {percent(p)}" for names, p in f.likely_sets.items())
    return tuple(
        filter(
            None,
            [
                *sizes,
                _off_in_words(f),
                *f.reasons[f.verdict == "hint" or f.leads :],
                *_sets_in_words(f),
                f"sets: {sets}" if sets else "",
                *_not_judged_in_words(f),
                evidence_in_words(f),
                track_record(f),
            ],
        )
    )


def size_of(f: Finding, name: str) -> str:
    """Return a candidate's size with its interval, and its other parameters; "" without any."""
    fit = f.fits.get(name)
    if fit is None or not fit.parameters:
        return ""
    effect, called = f.effects[name], title_of(f, name)
    if fit.size is None:
        return f"{called}: {effect.describe(fit.parameters)}"
    others = effect.describe(fit.parameters, without=effect.size)
    alone = None if name not in f.alone else f.alone[name].size
    words = f"size of {called}: {fit.size.words}"
    words += "" if alone is None else f", without the others {alone.words}"
    return words + (f"; {others}" if others else "")


def _off_in_words(f: Finding) -> str:
    """Return the common error of the coefficients; "" where there is none."""
    off = f.coefficients
    if off is None:
        return ""
    what = off.words(f.case.room.centre_frequencies)
    beside = "" if f.best_effect == COEFFICIENTS else f"beside {best_title(f)}, "
    return (
        f"{beside}the coefficients are off together ({percent(off.probability)}): {what}; "
        "look for another source"
    )


def _sets_in_words(f: Finding) -> list[str]:
    """Return other explanations of each of two or more effects, and probabilities of their number."""
    if not f.more_than_one:
        return []
    words = zip(("none", "one", "two", "three"), f.numbers, strict=False)
    numbers = ", ".join(f"{word} with {percent(p)}" for word, p in words if p >= 0.005)
    stand_ins = [
        f"{name} may stand for {listed(others)}"
        for name, others in f.stand_ins.items()
        if others and len(f.members) > 1
    ]
    return [*stand_ins, f"number of effects: {numbers}"]


def _not_judged_in_words(f: Finding) -> list[str]:
    """Return the effects that were not tried, why, and which others may stand for them."""
    library = {effect.name: effect for effect in checked_effects(None)}
    said = []
    for name, reason in f.not_judged.items():
        of_family = library[name].family if name in library else None
        alike = [k for k, e in f.effects.items() if e.family == of_family]
        stands = f" If it is there, {listed(alike, last='or')} may stand for it." if alike else ""
        said.append(f"Not judged: {name}, because {reason}.{stands}")
    return said


def evidence_in_words(f: Finding) -> str:
    """Return the evidence that something is missing, and its threshold; first the part that decides."""
    said, words = "", f.detection.deciding
    if words is not None:
        part = f.detection.parts[words]
        said = (
            f"Detected by {words} alone: {part.score:+z.1f} nats; threshold {part.threshold:.1f}. "
            "All data together say less. "
        )
    return (
        f"{said}Evidence that something is missing, whatever it is: {f.score:+z.1f} nats ({NATS}). "
        f"Threshold: {f.threshold:.1f} nats, which at most 5 % of simulated rooms exceed that lack "
        f"nothing ({', '.join(f.engines) or 'no engine'})."
    )


def track_record(f: Finding) -> str:
    """Return how many such verdicts were right in rooms that were not used to make the finder."""
    if f.more_than_one and f.detected:
        claimed = {"families": f.named_families, "sets of families": f.named_set}
        return record_of_several([kind for kind, names in claimed.items() if names])
    return record_of_means(f.verdict, data_of(f.case))


def _headline_of_means(f: Finding) -> str:
    return f"{f.verdict}{or_nothing(f)}: {sentence_of(f)}"


def _blocks_of_means(f: Finding) -> list[Block]:
    """Return verdict, sizes, probabilities, residuals, advice and notes."""
    rows = [
        Row(
            name,
            [
                f.percent(name),
                f"{f.evidence[name]:+z.1f}" if name in f.evidence else "",
                "candidate" if name in f.names else "",
            ],
        )
        for name, p in f.probabilities.items()
        if p >= SAID
    ]
    there = "probability" if not f.more_than_one else "probability of being there at all"
    tables = [Table([there, "evidence / nats", ""], rows, corner="effect")]
    labels = bands.labels(f.case.room.centre_frequencies)
    for c, residuals in zip(f.case.configurations, f.residuals, strict=True):
        named = zip(feature_names(c.measured), residuals, strict=True)
        measured = [Row(name, row, "+z.1f") for name, row in named if np.isfinite(row).any()]
        heading = f'residuals of "{c.name}", in standard deviations (model - measured)'
        tables.append(Table(labels, measured, heading))
    last = (f"next: {f.advice}", *(f"note: {n}" for n in f.notes))
    indented = [Note(sentence, "  ") for sentence in sentences(f)]
    return [Note(f.headline), *indented, *tables, *(Note(n, "  ") for n in last)]


def _record_of_means(f: Finding) -> dict[str, Any]:
    off, effect = f.coefficients, f.effects.get(str(f.best_effect))
    return {
        "detected_by": f.detection.deciding,
        "undecided": f.undecided or None,
        "amount": _amount(f) or None,
        "candidates": list(f.names),
        "sets": [{"effects": list(s), "probability": p} for s, p in f.sets.items()],
        "sizes": {name: json_numbers(fit.size) for name, fit in f.fits.items()},
        "sizes_alone": {name: json_numbers(fit.size) for name, fit in f.alone.items()},
        "coefficients": off and {"probability": off.probability, "ratio": off.ratio.tolist()},
        "parameters": dict(f.best_parameters),
        "material": effect and effect.material(f.best_parameters, f.case.room),
        "runner_up": runner_up(f),
        "residuals": [
            {
                "configuration": c.name,
                "feature": feature_names(c.measured)[k],
                "values": json_numbers(np.round(row, 2)),
            }
            for c, table in zip(f.case.configurations, f.residuals, strict=True)
            for k, row in enumerate(table)
            if np.isfinite(row).any()
        ],
    }


# Every position.


def _headline_at_positions(f: Finding) -> str:
    """Return the pairs without a place, the verdict, and how probable it is that nothing is other."""
    said = [*without_place(f.case.measured, f.case.simulator.pairs), _verdict_at_positions(f)]
    if not or_nothing(f):
        said.append(f"The probability that nothing is other than stated is {f.percent(NONE)}.")
    return " ".join(said)


def _verdict_at_positions(f: Finding) -> str:
    """Return the verdict in a sentence; what cannot be told stands first."""
    if f.best is None:
        return "none: no disagreement beyond what prior, measurement and simulator allow."
    first = after_doubt(f.mistake)
    if f.verdict == "hint":
        said = f"hint{or_nothing(f)}: {first}{f.best.title}, but not claimed."
        return f"{said} {' '.join(f.reasons[:1])}".rstrip()
    some = dict.fromkeys(c.effect for c in f.candidates if c.probability >= SAID)
    names = [f"{e} ({f.percent(e)})" for e in some]
    claimed = {"named": f.effect, "family": f.family}
    what = f"Other than stated: {claimed.get(f.verdict, listed(names, last='or'))}."
    rest = ""
    if f.verdict == UNKNOWN:
        what = "Something is other than stated that no effect of the library explains."
        if f.likeliest is not None:
            known = [c for c in f.candidates if c.effect != UNKNOWN]
            alike = sum(c.probability for c in known if c.kind == f.likeliest.kind)
            share = percent(alike / sum(c.probability for c in known))
            what += f" Of the library, {f.likeliest.kind} explains most ({share} of the rest)."
    elif f.unexplained >= MOST:
        rest = (
            " This does not explain everything that was measured "
            f"({percent(f.unexplained)}): something else is other than stated, too."
        )
    return f"{f.verdict}{or_nothing(f)}: {first}{what} {_place_in_words(f)}".rstrip() + rest


def _place_in_words(f: Finding) -> str:
    """Return the place, as far as the positions tell."""
    best = f.likeliest
    if best is None or best.surface is None:
        return "" if best is None or not best.place else f"Most probably {best.place}."
    if f.surface is not None:
        about = "" if f.located is None else f.located.about
        return f'It is on "{f.surface}" ({percent(f.surfaces[f.surface])}){about}.'
    some = [f'"{n}" ({percent(f.surfaces[n])})' for n in f.likely_surfaces]
    return f"These positions do not say on which surface: {listed(some, last='or')}."


def _outside_groups(f: Finding) -> list[str]:
    """Return why surfaces on which it may be are in no group of those that are not told apart."""
    grouped = {name for group in f.groups for name in group}
    asked = f.likely_surfaces if grouped and f.surface is None else ()
    least = np.exp(-DISTINCT_NATS) * max(f.surfaces.values(), default=0.0)
    # The groups are those of the most probable effect on a surface.
    effect = next((c.effect for c in f.candidates if c.surface is not None), "it")
    why = {
        True: "less probable than the first by more than ten to one",
        False: f"where {effect} would be told apart or is not tried; not ruled out",
    }
    said = {
        less: [n for n in asked if n not in grouped and (f.surfaces[n] < least) == less]
        for less in why
    }
    return [
        f"Not among these: {listed(names)}, {why[less]}." for less, names in said.items() if names
    ]


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
    if detection.means is not None:
        said += f" Means of these data over positions give {detection.means:+z.1f} nats."
    return said


def _blocks_at_positions(f: Finding) -> list[Block]:
    """Return the headline, the most probable candidates with their sizes, and notes."""
    probable = [c for c in f.candidates if c.probability >= SAID and f.verdict != "none"]
    rows = [Row(c.title, [_chance(c), c.in_words]) for c in probable[:8]]
    notes = (
        *(f"Not told apart by these positions: {listed(g, last='or')}." for g in f.groups),
        *_outside_groups(f),
        detection_in_words(f.detection),
        *f.reasons,
        *f.notes,
    )
    table = [Table(["probability", "size"], rows)] if rows else []
    return [Note(f.headline), *table, *map(Note, notes)]


def _record_at_positions(f: Finding) -> dict[str, Any]:
    return {
        "mistake": f.mistake or None,
        "candidates": [c.to_dict() for c in f.candidates[:20]],
        "nats_of_noise": f.detection.noise,
        "nats_of_means": f.detection.means,
        "centre_frequencies": json_numbers(f.case.room.centre_frequencies),
    }


# Two states.


def _change_in_words(f: Finding) -> str:
    """Return the change: more or less absorption, its spectrum and its amount."""
    if f.verdict == NONE:
        return "nothing"
    if f.family == "climate":
        return "another climate of the air, and nothing else"
    size = f.size
    if size is None or not np.isfinite(size.mean):  # nothing but the climate was tried
        return "another climate of the air"
    more = f.families.get("added absorption", 0.0) > (1 - f.probabilities[NONE]) / 2
    said = f"{'more' if more else 'less'} absorption{f', {f.spectrum}' if f.spectrum else ''}"
    low, high = sorted((abs(size.low), abs(size.high)))
    at = bands.label(f.middle[0])
    if len(f.middle) > 1:
        at = f"{f.middle[0]:g} to {f.middle[-1]:g} Hz"
    return f"{said}; {amount(abs(size.mean), 'm²', (low, high))} at {at}"


def _headline_of_states(f: Finding) -> str:
    """Return the doubt that leads, the verdict, and how probable it is that nothing changed."""
    said = {
        NONE: "Nothing changed beyond the noise of both measurements.",
        "hint": f"A hint, not claimed{or_nothing(f)}: {_change_in_words(f)}.",
    }.get(f.verdict, f"Changed{or_nothing(f)}: {_change_in_words(f)}.")
    if f.claimed_surfaces:
        names = [f'"{name}"' for name in f.claimed_surfaces]
        said += f" It is on {listed(names)}."
    if not or_nothing(f):
        said += f" The probability that nothing changed is {f.percent(NONE)}."
    return " ".join([*f.reasons, said])


def _sentences_of_states(f: Finding) -> list[str]:
    """Return what is not told apart, a climate that changed as well, where else, the score, notes."""
    said, changed = list[str](), f.verdict != NONE
    if changed and len(f.candidates) > 1:
        kinds = [f"{c.effect} ({_chance(c)})" for c in f.candidates]
        said.append(f"Not told apart by T: {listed(kinds)}.")
    if changed and f.family != "climate" and f.climate >= 0.5:
        share = percent(f.climate)
        said.append(f"Another climate of the air explains a part of it ({share}).")
    some = [f'"{n}" ({percent(p)})' for n, p in f.surfaces.items() if 1 - CLAIMED <= p < CLAIMED]
    if some:
        together = "Several may have changed together, so these need not add up to 100 %."
        said.append(f"It may be on {listed(some)} as well. {together}")
    return [
        *said,
        f"Evidence that something changed: {f.score:+z.1f} nats; threshold {f.threshold:.1f} nats.",
        *f.notes,
        as_sentence(NATS),
    ]


def _decimals(change: Array) -> int:
    """Return the decimals with which changes (3, n_bands) are printed: the interval shows its width.

    Examples
    --------
    >>> _decimals(np.array([[10.0], [8.0], [13.0]])), _decimals(np.array([[0.04], [-0.01], [0.09]]))
    (1, 2)
    """
    width = change[2] - change[1]
    known = width[np.isfinite(width) & (width > 0)]
    return int(np.clip(np.ceil(-np.log10(known.min() / 2)), 1, 6)) if len(known) else 1


def _interval(change: Array, digits: int) -> str:
    """Return a change (3,) in m² with its 90 % interval; that nothing was tried, where it is NaN."""
    if not np.isfinite(change).all():
        return "not tried"
    mean, low, high = (f"{value:+.{digits}f}" for value in change)
    return f"{mean} ({low} to {high})"


def _blocks_of_states(f: Finding) -> list[Block]:
    """Return the headline, both T and the change by band, and notes."""
    case, digits = f.case, _decimals(f.change)
    measured = np.flatnonzero(case.known).tolist()
    columns = {
        "T / s": [f"{case.times[0, k]:.2f}" for k in measured],
        "after / s": [f"{case.times[1, k]:.2f}" for k in measured],
        "area / m²": [f"{f.area[k]:.1f}" for k in measured],
        "change / m² (90 %)": [_interval(f.change[:, k], digits) for k in measured],
    }
    names = bands.labels(case.room.centre_frequencies[measured])
    table = Table.of_columns(names, columns)
    return [Note(f.headline), table, *map(Note, _sentences_of_states(f))]


def _record_of_states(f: Finding) -> dict[str, Any]:
    most = islice(f.sets.items(), 20)
    return {
        "sets": [{"surfaces": list(names), "probability": p} for names, p in most],
        "bands_of_size": list(f.middle),
        "kinds": [
            {
                "name": c.effect,
                "family": c.family,
                "probability": c.probability,
                "size": Size(c.size, c.low, c.high, c.unit).to_dict(),
            }
            for c in f.candidates
        ],
        "centre_frequencies": json_numbers(f.case.room.centre_frequencies),
        "before": json_numbers(f.case.times[0]),
        "after": json_numbers(f.case.times[1]),
        "absorption_area_before": json_numbers(f.area),
        "pairs": [list(pair) for pair in f.case.pairs],
    }


_SAID: dict[Kind, tuple[Callable[[Finding], str], Callable[[Finding], list[Block]]]] = {
    "means": (_headline_of_means, _blocks_of_means),
    "positions": (_headline_at_positions, _blocks_at_positions),
    "states": (_headline_of_states, _blocks_of_states),
}
"""Headline and blocks by kind of data."""
_RECORDS: dict[Kind, Callable[[Finding], dict[str, Any]]] = {
    "means": _record_of_means,
    "positions": _record_at_positions,
    "states": _record_of_states,
}
