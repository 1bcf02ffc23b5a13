"""What a search found: one class for means over positions, for every position and for two states.

A `Finding` is data: its case, the verdict, probabilities, sizes, and reasons as codes with values. What
differs by the kind of data are further fields. Its words are made in `rtcal.report.finding_words`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib import import_module
from operator import attrgetter
from typing import Any, ClassVar, Literal

import numpy as np

from rtcal.acoustics.comparison import Comparison
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.run import Run
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.finder.apply import (
    Corrected,
    changed_room,
    corrected_case,
    corrected_geometry,
    surface_at,
)
from rtcal.finder.case import Case
from rtcal.finder.claim import (
    CLAIMED,
    LEADING,
    LIKELY,
    MOST,
    SAID,
    WORDS,
    Candidate,
    Detection,
    Names,
    Reason,
    Size,
    credible_set,
    families_of,
    numbers_of,
    over_frequency,
    summed,
)
from rtcal.finder.effects import AppliedEffect, CoupledRoom, Effect, WrongVolume
from rtcal.finder.evidence import UNKNOWN, OffTogether
from rtcal.support.errors import DataError
from rtcal.support.text import listed
from rtcal.support.types import Array

LEAST_ADDED = 0.3
"""Probability below which ``apply`` adds an effect only where it is stated by its name. Of first
candidates with less 9 of 41 were right."""
LEAST_PAIRS = 4
"""Fewest pairs of a verification at held-out pairs: half of them have to find it again."""
_CHOICE = 6
"""Most candidates of which a sentence gives the choice."""
_LEAST = 1e-3
"""Probability below which nothing is added to a surface, even where the user names it."""
Kind = Literal["means", "positions", "states"]
DATA = {"means": "means over positions", "positions": "positions", "states": "two states"}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Finding(Result):
    """The result of a search: in means over positions, at every position or between two states.

    Notes
    -----
    If you exchange the two states, "added" and "removed" are exchanged and every change has the
    other sign; the finding is otherwise the same. For two states, ``score`` is the ln Bayes factor:
    the natural logarithm of how many times more probable the measurements are if something changed
    than if nothing did. If nothing changed and the noise is as assumed, the mean Bayes factor is 1, so
    that the score exceeds the threshold ln 20 in at most one of twenty cases (Markov's inequality).
    """

    record_kind: ClassVar[str] = "finding 6"
    words_in: ClassVar[str] = WORDS

    case: Any
    """A `Case`, `PositionsCase` or `StatesCase`."""
    verdict: str
    """``named``: an effect whose probability is at least 0.9, and that passes every check; of two
    states the climate alone, where it explains T by chi-square. ``family``: a family has this
    probability, but none of its effects, or the effect's size or fit is doubtful. ``ambiguous``:
    something is missing, and effects of several families explain it. ``unknown``: the model lacks
    something that no effect of the library explains. ``hint``: the score does not exceed the threshold
    but is above 0, nothing missing has a third of the probability, no effect and no family has (both of
    means over positions), or a check has failed (``reasons``)."""
    family: str | None
    """The family whose probability is at least 0.9."""
    probabilities: Mapping[str, float]
    families: Mapping[str, float]
    """Of "none", "coefficients", "unknown" and each effect, and of each family, that it is there; the
    most probable first. "added absorption" has the families whose names begin with it."""
    detection: Detection
    """ln Bayes factor for a model that differs from the input, and its threshold."""
    reasons: tuple[Reason, ...]
    """Why what is most probable is not identified, or not by its name; `rtcal.finder.claim.LEAVES` has
    what each leaves. ``str`` of a reason is its sentence."""
    notes: tuple[Reason | str, ...]
    """Notes on what was left out and assumed, and reasons to doubt the result. A text is a note of the
    measurement's or of the simulator's."""
    effects: Mapping[str, Effect]
    """The effects that were tried, by name."""
    candidates: tuple[Candidate, ...]
    """Candidates, the most probable first. Of means, the members, then what explains the data in place
    of one, or single effects that hold 0.9 of what is not "none". At positions, every effect in every
    place. Of two states, the kinds of change with 0.03 and more: "added porous", each with the change
    of the absorption area in m², mean over the bands of ``middle``."""
    named: Names = ()
    """The effects that are identified."""
    modelled: tuple[Measurement, ...] = ()
    """What the model gives at the stated coefficients, with a run what the run gave: of means by
    configuration, at positions one, by pair; of two states none."""
    left_out: Names = ()
    """Names that were left out on request; of means they are among the ``notes``."""
    mistake: Reason | None = None
    """The doubt that T is twice or half the model's, of means also among the ``reasons``."""
    surfaces: Mapping[str, float] = field(default_factory=dict)
    """At positions, the probability of each surface, given that something stands on one. Of two states,
    that something changed on it; empty where none is identified."""
    sets: Mapping[Names, float] = field(default_factory=dict)
    """Of means, the sets of effects, () being none; of two states, the surfaces that changed
    together."""
    size: Size | None = None
    """Of the best effect; of two states the change of the absorption area in m², mean over the bands of
    ``middle``."""

    named_families: Names = ()
    named_set: Names = ()
    members: Names = ()
    """Of means. The groups that are identified; those of two or three that are identified together
    (`rtcal.finder.means.search.TWO`); the effects of the most probable set, in the order in which they
    act: what `apply` adds."""
    stand_ins: Mapping[str, Names] = field(default_factory=dict)
    """Effects that explain the data as well as a member in its place, by member."""
    evidence: Mapping[str, float] = field(default_factory=dict)
    """ln Bayes factor over "none", by effect alone, of "coefficients" and of "unknown"."""
    likely: Sequence[tuple[tuple[AppliedEffect, ...], float]] = ()
    """The most probable sets with their parameters, and their probabilities, which sum to 1: what
    `rtcal.finder.plan` goes on from."""
    alpha: Array = field(default_factory=partial(np.zeros, 0))
    """Posterior mean of the coefficients, averaged over all sets, (n_materials, n_bands): what `apply`
    cannot give, since it adds one set."""
    prior: Any = None
    advice: Reason | None = None
    """The next measurement that would decide; None where the data show nothing that is missing."""
    residuals: Array = field(default_factory=partial(np.zeros, 0))
    """Modelled less measured, over its standard deviation, (n_configurations, n_features, n_bands):
    amount (ln T20), shape (EDT/T20, T30/T20), level (C80, G). NaN where nothing was measured."""
    discrepancy: Any = None
    """Bias and covariance of the model's error: a `ModelDiscrepancy`."""
    not_judged: Mapping[str, str] = field(default_factory=dict)
    """Effects that were not tried, since the room does not state what they act by: each with the
    reason."""

    surface: str | None = None
    """At positions, the surface that is identified: something stands on it with a probability of 0.9 or
    more, and the checks agree."""
    groups: tuple[Names, ...] = ()
    """Surfaces that these positions do not distinguish."""
    map: Array = field(default_factory=partial(np.zeros, 0))
    """Simulated less measured in standard deviations of what prior, simulator and measurement leave
    open, (n_parameters, n_pairs, n_bands); NaN where nothing was measured. ``parameters`` and ``pairs``
    are its axes."""
    parameters: tuple[str, ...] = ()
    pairs: tuple[tuple[str, str], ...] = ()
    controls: Any = None
    """The simulator's error, to be given to another search or calibration: `ControlRuns`."""
    unexplained: float = 0.0
    """Probability that the model differs by something that no effect explains, alone or beside one."""

    area: Array = field(default_factory=partial(np.zeros, 0))
    """Of two states, the surfaces' absorption area before in m², by the equation, (n_bands,); NaN where
    T is missing."""
    change: Array = field(default_factory=partial(np.zeros, 0))
    """Its change in m², if absorption was added or removed, (3, n_bands): mean and both ends of the 90
    % interval. NaN where that was not tried."""
    shift: Array = field(default_factory=partial(np.zeros, 0))
    """Mean of ln(T after / T before) if something changed, by absorption and by climate, (n_bands,)."""
    middle: tuple[float, ...] = ()
    """Bands in Hz: those of 500 Hz to 2 kHz, or all where none of them was measured."""
    climate: float = 0.0
    """Probability that the climate of the air is another as well, if absorption was added or
    removed."""

    @property
    def kind(self) -> Kind:
        """What was compared: means over positions, every position, or two states."""
        of: Kind = self.case.kind
        return of

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Comparisons of the ``modelled`` values with the measured ones, by their uncertainty."""
        case = self.case
        if not self.modelled:
            return ()
        if self.kind == "positions":
            measured = [case.in_room.select(case.pairs)]
        else:
            measured = [c.measured for c in case.configurations]
        made = list[Comparison]()
        for model, values in zip(self.modelled, measured, strict=True):
            run = Run(case.room, model)
            with suppress(DataError):  # they have nothing in common
                made.append(Comparison(run=run, measured=values, equation=Eyring()))
        return tuple(made)

    @property
    def differs(self) -> bool:
        """Whether model or run and measurement disagree, whether or not coefficients explain it."""
        return any(at.any() for c in self.comparisons for at in c.disagrees.values())

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
        """ln Bayes factor for something missing, which must exceed the ``threshold``."""
        return self.detection.score

    @property
    def threshold(self) -> float:
        """ln Bayes factor that at most 5 % of simulated rooms with nothing missing exceed."""
        return self.detection.threshold

    @property
    def detected(self) -> bool:
        """Whether something is missing or has changed: the verdict is neither "none" nor "hint"."""
        return self.verdict not in ("none", "hint")

    @property
    def numbers(self) -> tuple[float, ...]:
        """Probabilities that 0, 1, 2, ... effects are missing; for means over positions only."""
        return numbers_of(self.sets)

    @property
    def more_than_one(self) -> bool:
        """Whether sets of two and more effects were compared."""
        return self.kind == "means" and len(self.numbers) > 2

    @property
    def likely_sets(self) -> dict[Names, float]:
        """Sets of effects that are probable enough to be printed; empty if each has one effect."""
        return {s: p for s, p in self.sets.items() if p >= SAID} if self.more_than_one else {}

    @property
    def family_sets(self) -> dict[Names, float]:
        """Probabilities of sets of families, for means; every family of "added absorption" is one."""
        sets = self.sets if self.kind == "means" else {}
        return summed((families_of(names, self.effects), p) for names, p in sets.items())

    @property
    def coefficients(self) -> OffTogether | None:
        """The common error of the coefficients, if likely in addition to the most probable set."""
        of = self.candidate(self.members[-1]) if self.members else None
        return None if of is None else of.coefficients

    def candidate(self, effect: str | None) -> Candidate | None:
        """Return the most probable candidate of an effect, or None."""
        return next((c for c in self.candidates if c.effect == effect), None)

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
    def identified_surfaces(self) -> Names:
        """The surfaces that changed between two states, each with a probability of 0.9."""
        return tuple(name for name, p in self.surfaces.items() if p >= CLAIMED)

    @property
    def spectrum(self) -> str:
        """The trend of a change over frequency: rising, falling or constant; "" for a single band."""
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
        """Whether `rtcal.finder.verify` can compare the deviation with and without what was found.

        By means: one probable effect. At positions: enough pairs for half to predict the others.
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
    def leading(self) -> Reason | None:
        """The caution that precedes the answer, because T is far off; None without one."""
        if self.kind == "positions":
            return self.mistake
        first = next(iter(self.reasons), None)
        leads = first is not None and first.code == LEADING and self.verdict == "family"
        return first if leads else None

    @property
    def refusal(self) -> Reason | None:
        """Why there is nothing to add; None where there is something."""
        if self.can_be_added:
            return None
        if self.kind == "states":
            return Reason("climate changed" if self.detected else "no change to add")
        best = self.likeliest if self.kind == "positions" else self.best
        if self.verdict == "none":
            return Reason("nothing to add")
        if self.verdict == "hint":
            return Reason("too weak to add", {"best": best})
        if best is not None and best.effect == CoupledRoom.name:
            return Reason("second room", {"best": best, "why": CoupledRoom.not_in_simulator})
        code = "none of the library" if self.verdict == UNKNOWN else "no surface"
        return Reason(code, {"best": best})

    @property
    def undecided(self) -> Reason | None:
        """Why `apply` needs the name of an effect; None where it does not.

        What stands on a surface counts with its family: which porous absorber it is changes little.
        Where the verdict is "unknown", the shares are those of the rest.
        """
        best, known = self.likeliest, [c for c in self.candidates if c.effect != UNKNOWN]
        if not self.can_be_added or self.kind == "states" or best is None:
            return None
        if self.kind == "means":
            if self._least >= LEAST_ADDED:
                return self._unclaimed_volume(self.members)
            some = [(c.effect, c.probability) for c in known]
            return Reason("effect undecided", {"least": LEAST_ADDED, "candidates": some})
        alike = (c for c in known if (c.surface, c.kind) == (best.surface, best.kind))
        share = sum(c.probability for c in alike)
        if self.verdict == UNKNOWN:
            share /= sum(c.probability for c in known)
        if share >= LEAST_ADDED:
            return None
        shown = [c for c in known if c.can_be_added and c.probability >= SAID][:_CHOICE] or [best]
        return Reason("place undecided", {"least": LEAST_ADDED, "candidates": shown})

    def _unclaimed_volume(self, members: Names) -> Reason | None:
        """Return why a volume among the members is not changed; None where it is, or none is there."""
        name = WrongVolume.name
        if name not in members or name in self.named:
            return None
        others = [n for n in self.names if n not in (name, UNKNOWN)]
        values = {"probability": self.probabilities[name], "least": CLAIMED, "others": others}
        return Reason("volume undecided" if others else "volume alone undecided", values)

    def apply(
        self,
        *,
        effect: str | None = None,
        form: str | None = None,
        at: Sequence[float] | None = None,
    ) -> Corrected:
        """Return the model with the effect that was found: room, simulator and, for means, case.

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
            If there is nothing to add; if ``effect`` is no candidate; if none is chosen and the most
            probable one has less than 0.3; for a volume that is not identified; if ``at`` is on no
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
        taken = {"means": ("effect",), "positions": ("effect", "form", "at"), "states": ()}
        for name, value in {"effect": effect, "form": form, "at": at}.items():
            if value is not None and name not in taken[self.kind]:
                raise DataError(
                    f"{name} cannot be used with a finding from {DATA[self.kind]}: leave it out"
                )
        if self.kind == "means":
            chosen = self.chosen(effect)
            added = [c for c in self.candidates if c.effect in chosen]
            return corrected_case(self.with_effects(added=added))
        if self.refusal is not None:
            raise DataError(str(self.refusal))
        if self.kind == "states":
            kinds = [c.effect for c in self.candidates]
            return changed_room(self.case, self.area, self.change, self.identified_surfaces, kinds)
        best = self.likeliest
        if at is None and effect is None and self.undecided is not None:
            raise DataError(str(self.undecided))
        if best is None or not (at is None and effect is None):
            every = [c for c in self.candidates if c.can_be_added and c.probability >= _LEAST]
            if at is not None:
                surface = surface_at(self.case, at)
                every = [c for c in every if c.surface == surface]
                if not every:
                    raise DataError(f'at is on "{surface}", but nothing was found on this surface')
            best = next((c for c in every if effect in (None, c.effect)), None)
            if best is None:
                named = listed([*dict.fromkeys(c.effect for c in every)], last="or")
                raise DataError(f'effect = "{effect}" is not a candidate. Candidates: {named}')
        made = corrected_geometry(self.case, best, form or "patch", at)
        return replace(made, support=str(support(self, best)))

    def chosen(self, effect: str | None = None) -> Names:
        """Return the effects that `apply` adds, for means; DataError as `apply` raises it."""
        if not self.can_be_added:
            raise DataError(f'the verdict is "{self.verdict}", so there is no effect to add')
        found = self.candidate(effect)
        fitted = found is not None and (found.parameters or found.coefficients is not None)
        if effect is not None and not fitted:
            candidates = listed([n for n in self.names if n != UNKNOWN], last="or")
            raise DataError(f'effect = "{effect}" is not a candidate. Candidates: {candidates}')
        why = self.undecided if effect is None else self._unclaimed_volume((effect,))
        if why is not None:
            raise DataError(str(why))
        return self.members if effect is None else (effect,)

    def with_effects(
        self, case: Case | None = None, added: Sequence[Candidate] | None = None
    ) -> Case:
        """Return the case with candidates in its model; by default those of the most probable set.

        It is what a verification compares with the case, however probable the effects are.
        """
        base: Case = self.case if case is None else case
        present = {a.name for a in base.applied}
        if added is None:
            added = [c for c in self.candidates if c.effect in self.members]
        if present.issuperset(c.effect for c in added):
            return base
        off = added[-1].coefficients
        if off is not None:
            base = off.apply(base)
        new = [c for c in added if c.effect in self.effects and c.effect not in present]
        applied = [c.applied(self.effects[c.effect]) for c in new]
        return replace(base, applied=(*base.applied, *applied)) if applied else base

    def __repr__(self) -> str:
        """Return one line: the verdict, and the answer's first sentence."""
        return f"<Finding {self.verdict}: {import_module(WORDS).headline(self)[0]}>"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        named = f"{_RECORDED['all']} {_RECORDED[self.kind]}".split()
        paths = {key: path or key for key, _, path in (name.partition("=") for name in named)}
        record = {key: json_numbers(attrgetter(path)(self)) for key, path in paths.items()}
        record["sets"] = [
            {"effects": list(names), "probability": p} for names, p in self.sets.items()
        ]
        return {**record, "text": import_module(WORDS).headline(self)}


_RECORDED = {
    "all": "verdict effect family named probabilities families score threshold mistake reasons notes "
    "candidates size left_out",
    "means": "detected_by=detection.deciding named_families named_set members undecided numbers "
    "evidence stand_ins alpha coefficients engines=discrepancy.engines advice not_judged residuals",
    "positions": "surface unexplained surfaces likely_surfaces groups parameters pairs map "
    "nats_of_noise=detection.noise nats_of_means=detection.means "
    "centre_frequencies=case.room.centre_frequencies",
    "states": "surfaces identified_surfaces change shift climate bands_of_size=middle "
    "absorption_area_before=area times=case.times pairs=case.pairs "
    "centre_frequencies=case.room.centre_frequencies",
}
"""Entries of a record, key=path where the attribute has another name."""


def feature_names(measured: Measurement) -> tuple[str, ...]:
    """Return the features' names as printed, by the reverberation time that was measured."""
    time = measured.time_label
    return time, f"EDT/{time}", "T30/T20", "C80", "G"


def rivals(f: Finding, best: Candidate | None = None) -> tuple[Candidate, ...]:
    """Return the candidates beside the most probable set, or beside another one."""
    if f.kind == "means":
        if best is not None and best.effect not in f.names[: max(1, len(f.members))]:
            return tuple(c for c in f.candidates if c is not best)
        return f.candidates[max(1, len(f.members)) :]
    every = {c.title: c.probability for c in f.candidates}
    credible = [name for name in credible_set(every) if every[name] >= SAID]
    return tuple(c for c in f.candidates if c is not best and c.title in credible)


def support(f: Finding, best: Candidate) -> Reason:
    """Return the verdict, the best effect, and the others that explain the data."""
    others = rivals(f, best)
    values = {"verdict": f.verdict, "best": best, "others": others}
    return Reason("support" if others else "sole", values)
