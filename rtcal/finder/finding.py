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

from rtcal.acoustics.comparison import Comparison, compare
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
"""Probability below which `Finding.apply` adds an effect only if you name it. Of the most probable
candidates with a lower probability 9 of 41 were right."""
LEAST_PAIRS = 4
"""Smallest number of pairs for a check at held-out pairs: half of the pairs must find the effect
again."""
_CHOICE = 6  # most candidates of which a sentence gives the choice
_LEAST = 1e-3  # probability below which nothing is added to a surface, even where the user names it
Kind = Literal["means", "positions", "states"]
DATA = {"means": "means over positions", "positions": "positions", "states": "two states"}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Finding(Result):
    """Hold what `rtcal.find` found: what is missing from a room's model, or what changed in the room.

    ``print`` shows it in words. `apply` adds what was found to the model, and `rtcal.finder.verify`
    checks it. Some fields are for one kind of data only: means over positions, every position, or two
    states (measurements before and after a change of the room).

    Notes
    -----
    ``score`` is a ln Bayes factor: the natural logarithm of how many times more probable the
    measurement is if something is missing (or has changed) than if nothing is. For two states the
    threshold is ln 20: if nothing changed and the noise is as assumed, the mean Bayes factor is 1, so
    that at most one of twenty cases exceeds it (Markov's inequality). If you exchange the two
    measurements, "added" and "removed" are exchanged and every change has the other sign.
    """

    record_kind: ClassVar[str] = "finding 7"
    words_in: ClassVar[str] = WORDS

    case: Any
    """Room and data that were compared: a `Case`, `PositionsCase` or `StatesCase`."""
    verdict: str
    """Result in one word. ``named``: one effect is identified, with a probability of at least 0.9, and
    it passes every check; for two states this may be the climate alone. ``family``: a group of effects
    is identified, but no single one. ``ambiguous``: something is missing, and effects of several groups
    explain it. ``unknown``: something is missing that no effect of the library explains. ``hint``: a
    weak indication, because the ``score`` is above 0 but not above its threshold, no probability is
    high enough, or a check failed (see ``reasons``). ``none``: nothing is missing."""
    family: str | None
    """Group of effects whose probability is at least 0.9, None without one."""
    probabilities: Mapping[str, float]
    families: Mapping[str, float]
    """Probability of "none", "coefficients", "unknown" and each group of effects, the most probable
    first. "added absorption" is the sum of all groups whose names begin with it."""
    detection: Detection
    """Score, the ln Bayes factor for a room that differs from its model, with the threshold of this
    score."""
    reasons: tuple[Reason, ...]
    """Reasons why the most probable effect is not identified, or only its group; `LEAVES` has the
    verdict after each. ``str`` of a reason is its sentence."""
    notes: tuple[Reason | str, ...]
    """Notes on what was left out or assumed, and cautions. A note that is a text comes from the
    measurement or the simulator."""
    effects: Mapping[str, Effect]
    """Effects that were tried, by name."""
    candidates: tuple[Candidate, ...]
    """Effects that explain the data, the most probable first. For means: the missing effects, and those
    that could replace one. At positions: every effect in every place. For two states: each change, such
    as "added porous", with the change of the absorption area in m² over the bands ``middle``."""
    named: Names = ()
    """Names of the effects that are identified."""
    modelled: tuple[Measurement, ...] = ()
    """Values of the model at the input coefficients, or of a program's run: one entry per configuration
    for means, one with a row per pair at positions, none for two states."""
    left_out: Names = ()
    """Names of the effects that were left out on your request."""
    mistake: Reason | None = None
    """Caution that the measured T is about twice or half the model's; None without it."""
    surfaces: Mapping[str, float] = field(default_factory=dict)
    """Probability of each surface: that the missing object is on it if it is on any; for two states
    that it changed."""
    sets: Mapping[Names, float] = field(default_factory=dict)
    """Probability of each combination of effects for means, and of changed surfaces for two states."""
    size: Size | None = None
    """Size of the most probable effect, or change of the absorption area in m² over ``middle``."""

    named_families: Names = ()
    named_set: Names = ()
    members: Names = ()
    """Names of the missing effects in the most probable combination, for means, as `apply` adds them.
    ``named_families`` are the groups that are identified, ``named_set`` those identified together."""
    stand_ins: Mapping[str, Names] = field(default_factory=dict)
    """Effects that explain the data as well as a missing effect, by the name of that effect."""
    evidence: Mapping[str, float] = field(default_factory=dict)
    """ln Bayes factor over "none" of each effect alone, of "coefficients" and of "unknown"."""
    likely: Sequence[tuple[tuple[AppliedEffect, ...], float]] = ()
    """Most probable combinations of effects with parameters, with probabilities whose sum is 1."""
    alpha: Array = field(default_factory=partial(np.zeros, 0))
    """Absorption coefficients, (n_materials, n_bands), averaged over all combinations of effects."""
    prior: Any = None
    advice: Reason | None = None
    """Next measurement that would decide; None where the data show nothing that is missing."""
    residuals: Array = field(default_factory=partial(np.zeros, 0))
    """Modelled minus measured values over their standard deviation, (n_configurations, n_features,
    n_bands). The features are ln T20, EDT/T20, T30/T20, C80 and G. NaN where nothing was measured."""
    discrepancy: Any = None
    """Error of the model itself, as bias and covariance: a `ModelDiscrepancy`."""
    not_judged: Mapping[str, str] = field(default_factory=dict)
    """Names of effects that were not tried, each with the reason."""

    surface: str | None = None
    """Surface that is identified at positions, with a probability of at least 0.9."""
    groups: tuple[Names, ...] = ()
    """Groups of surfaces that these positions do not distinguish."""
    map: Array = field(default_factory=partial(np.zeros, 0))
    """Simulated minus measured values at positions, (n_parameters, n_pairs, n_bands), over the standard
    deviation from coefficients, simulator and measurement together. NaN where nothing was measured.
    ``parameters`` and ``pairs`` name the first two axes."""
    parameters: tuple[str, ...] = ()
    pairs: tuple[tuple[str, str], ...] = ()
    controls: Any = None
    """Error of the simulator, as `ControlRuns` that you can give to another search or calibration."""
    unexplained: float = 0.0
    """Probability that the room differs from its model by something that no effect explains."""

    area: Array = field(default_factory=partial(np.zeros, 0))
    """Absorption area of all surfaces before a change in m², by the equation, (n_bands,); NaN where T
    is missing. For two states only."""
    change: Array = field(default_factory=partial(np.zeros, 0))
    """Change of the absorption area in m² if absorption was added or removed, (3, n_bands): mean, and
    lower and upper end of the 90 % interval. NaN where this was not tried."""
    shift: Array = field(default_factory=partial(np.zeros, 0))
    """Mean of ln(T after / T before) if something changed, by absorption and by climate, (n_bands,)."""
    middle: tuple[float, ...] = ()
    """Bands in Hz over which means are taken: 500 Hz to 2 kHz, or all if none of these was measured."""
    climate: float = 0.0
    """Probability that the climate of the air changed as well, if absorption was added or removed."""

    @property
    def kind(self) -> Kind:
        """Kind of data: "means" over positions, "positions" or "states" (before and after a change)."""
        of: Kind = self.case.kind
        return of

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Comparisons of the ``modelled`` with the measured values, relative to their uncertainty."""
        case = self.case
        if not self.modelled:
            return ()
        if self.kind == "positions":
            each = [(case.in_room.select(case.pairs), None)]
        else:
            each = [(c.measured, c.simulated) for c in case.configurations]
        made = list[Comparison]()
        for model, (values, run) in zip(self.modelled, each, strict=True):
            with suppress(DataError):  # they have nothing in common
                made.append(compare(case.room, values, Run(run.room if run else case.room, model)))
        return tuple(made)

    @property
    def differs(self) -> bool:
        """Whether model and measurement disagree, even if coefficients could explain it."""
        return any(at.any() for c in self.comparisons for at in c.disagrees.values())

    @property
    def best(self) -> Candidate | None:
        """Most probable explanation (`Candidate`); None if the verdict is "none"."""
        return self.candidates[0] if self.candidates and self.verdict != "none" else None

    @property
    def best_effect(self) -> str | None:
        """Name of the most probable effect, "coefficients" or "unknown"; None if nothing is missing."""
        return None if self.best is None else self.best.effect

    @property
    def effect(self) -> str | None:
        """Name of the identified effect, or for means over positions of the most probable one.

        None if the verdict is "none" or only a group of effects is identified ("family"); at positions
        and for two states also if no single effect is identified.
        """
        if self.named or self.kind != "means" or self.verdict == "family":
            return self.named[0] if self.named and self.verdict not in ("none", "family") else None
        return self.best_effect

    @property
    def names(self) -> Names:
        """Names of the candidates' effects, which may include "coefficients" and "unknown"."""
        return tuple(c.effect for c in self.candidates)

    @property
    def score(self) -> float:
        """Natural logarithm of the Bayes factor that something is missing or changed."""
        return self.detection.score

    @property
    def threshold(self) -> float:
        """Value that the score exceeds in at most 5 % of rooms in which nothing is missing."""
        return self.detection.threshold

    @property
    def detected(self) -> bool:
        """Whether something is missing or changed: the verdict is neither "none" nor "hint"."""
        return self.verdict not in ("none", "hint")

    @property
    def numbers(self) -> tuple[float, ...]:
        """Probabilities that 0, 1, 2, ... effects are missing from the model, for means."""
        return numbers_of(self.sets)

    @property
    def more_than_one(self) -> bool:
        """Whether combinations of two or more effects were tried."""
        return self.kind == "means" and len(self.numbers) > 2

    @property
    def likely_sets(self) -> dict[Names, float]:
        """Probability of each combination of effects with at least 0.03; empty for single effects."""
        return {s: p for s, p in self.sets.items() if p >= SAID} if self.more_than_one else {}

    @property
    def family_sets(self) -> dict[Names, float]:
        """Probability of each combination of groups of effects, for means."""
        sets = self.sets if self.kind == "means" else {}
        return summed((families_of(names, self.effects), p) for names, p in sets.items())

    @property
    def coefficients(self) -> OffTogether | None:
        """Error that all input coefficients have in common beside the effects, None below 0.5."""
        of = self.candidate(self.members[-1]) if self.members else None
        return None if of is None else of.coefficients

    def candidate(self, effect: str | None) -> Candidate | None:
        """Return the most probable candidate with the effect of this name; None if there is none."""
        return next((c for c in self.candidates if c.effect == effect), None)

    @property
    def located(self) -> Candidate | None:
        """Most probable candidate on the most probable surface; None without one."""
        first = next(iter(self.surfaces), None)
        return next((c for c in self.candidates if c.surface == first and first), None)

    @property
    def likely_surfaces(self) -> Names:
        """Names of the most probable surfaces, whose probabilities together reach 0.7."""
        if sum(c.probability for c in self.candidates if c.surface is not None) < SAID:
            return ()
        before = np.cumsum([0.0, *self.surfaces.values()])
        return tuple(n for n, held in zip(self.surfaces, before, strict=False) if held < LIKELY)

    @property
    def likeliest(self) -> Candidate | None:
        """Most probable effect of the library, which `apply` adds; None if no effect is probable.

        If the verdict is "unknown" at positions, this is the most probable effect that is known,
        provided that its surface or its group has at least half of the probability of all known
        effects.
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
        """Names of the surfaces that changed between two states with a probability of 0.9 or more."""
        return tuple(name for name, p in self.surfaces.items() if p >= CLAIMED)

    @property
    def spectrum(self) -> str:
        """Trend of the change of absorption between two states over frequency; "" for a single band."""
        change = np.atleast_2d(self.change)[0]
        change = change[np.isfinite(change)]
        return over_frequency(change) if len(change) > 1 else ""

    @property
    def can_be_added(self) -> bool:
        """Whether `apply` can add what was found to the model.

        For means, an effect of the library must be detected. At positions, something must be detected
        on a surface, and it must not be an aperture to a second room. For two states, the absorption
        must have changed, and not only the climate.
        """
        if self.kind == "means":
            return self.verdict in ("named", "family", "ambiguous") and bool(self.members)
        if self.kind == "states":
            return self.detected and self.family != "climate"
        return self.detected and self.likeliest is not None and self.likeliest.can_be_added

    @property
    def can_be_verified(self) -> bool:
        """Whether `rtcal.finder.verify` can check the finding on data that were held out.

        For means, exactly one effect must be found, with a probability of at least 0.3. At positions
        and for two states, there must be at least four source-receiver pairs, because one half of them
        predicts the other half.
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
        """Caution that T is far from the model's, to be read before the result; None without it."""
        if self.kind == "positions":
            return self.mistake
        first = next(iter(self.reasons), None)
        leads = first is not None and first.code == LEADING and self.verdict == "family"
        return first if leads else None

    @property
    def refusal(self) -> Reason | None:
        """Reason why `apply` has nothing to add to the model; None if it has."""
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
        """Reason why `apply` needs the name of an effect; None if it needs none.

        The name is needed if no effect has a probability of at least 0.3. At positions, effects of one
        group on one surface count together, because they change the model alike; if the verdict is
        "unknown", the probability is the share among the known effects. For means, a wrong volume also
        needs its name unless it is identified.
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
        return Reason("volume undecided", values)

    def apply(
        self,
        *,
        effect: str | None = None,
        form: str | None = None,
        at: Sequence[float] | None = None,
    ) -> Corrected:
        """Return the model with the effect that was found, as a room and as a simulator.

        For means over positions, the most probable effect (with ``most`` above 1 the most probable
        combination of effects) is added with the mean of its size, even if it is not identified
        (verdicts "family" and "ambiguous"). An error that all input coefficients have in common is
        corrected in alpha, and increases sigma. At positions, the most probable effect becomes a patch
        on its surface. For two states, the result is the room after the change. An effect with a
        probability below 0.3, or any where nothing was detected, is added only if you name it as
        ``effect``.

        Parameters
        ----------
        effect : str, optional
            Name of the candidate to add instead of the most probable one.
        form : {"patch", "material"}, optional
            Form of the effect at positions. "patch", the default, is an area of the effect's size with
            a new material. "material" gives the whole surface a new material with the same absorption.
            A patch that does not fit becomes a material: see `Corrected.notes`.
        at : (x, y, z), optional
            Middle of the patch in m, at positions; it also chooses the surface. By default the
            candidate's ``middle``, or the middle of its surface.

        Returns
        -------
        Corrected
            Room and, at positions, geometry with the effect, and notes on what was changed.

        Raises
        ------
        DataError
            If there is nothing to add; if ``effect`` is not a candidate; if ``effect`` is not given and
            the most probable candidate has a probability below 0.3; for a wrong volume that is not
            identified; if ``at`` is on no surface, or on one on which nothing was found; for an
            argument that does not apply to the data.

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
        by_user = self.kind == "positions" and not (at is None and effect is None)
        every = [c for c in self.candidates if c.can_be_added and c.probability >= _LEAST]
        if self.refusal is not None and not (by_user and every):
            raise DataError(str(self.refusal))
        if self.kind == "states":
            kinds = [c.effect for c in self.candidates]
            return changed_room(self.case, self.area, self.change, self.identified_surfaces, kinds)
        best = self.likeliest
        if not by_user and self.undecided is not None:
            raise DataError(str(self.undecided))
        if best is None or by_user:
            if at is not None:
                surface = surface_at(self.case, at)
                every = [c for c in every if c.surface == surface]
                if not every:
                    raise DataError(
                        f'at is on "{surface}", but nothing was found there; give a point '
                        "on another surface, or leave at out"
                    )
            best = next((c for c in every if effect in (None, c.effect)), None)
            if best is None:
                named = listed([*dict.fromkeys(c.effect for c in every)], last="or")
                raise DataError(f'effect = "{effect}" is not a candidate. Candidates: {named}')
        made = corrected_geometry(self.case, best, form or "patch", at)
        return replace(made, support=str(support(self, best)))

    def chosen(self, effect: str | None = None) -> Names:
        """Return the names of the effects that `apply` adds, for means over positions.

        ``effect`` is the name that you would give to `apply`; None means the most probable combination.
        Raises DataError as `apply` does.
        """
        if not self.can_be_added and (effect is None or not self.candidates):
            raise DataError(f'nothing was found that can be added (verdict "{self.verdict}")')
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
        """Return a case with effects in its model, for means over positions, however probable they are.

        ``case`` is the case to which they are added; None means the case of this finding. ``added`` are
        the candidates to add; None means the most probable combination.
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
        """Return the finding as plain values for JSON."""
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
    """Return the printed names of the five features that means are compared by."""
    time = measured.time_label
    return time, f"EDT/{time}", "T30/T20", "C80", "G"


def rivals(f: Finding, best: Candidate | None = None) -> tuple[Candidate, ...]:
    """Return the other explanations of the data, beside the most probable one or ``best``."""
    if f.kind == "means":
        if best is not None and best.effect not in f.names[: max(1, len(f.members))]:
            return tuple(c for c in f.candidates if c is not best)
        return f.candidates[max(1, len(f.members)) :]
    every = {c.title: c.probability for c in f.candidates}
    credible = [name for name in credible_set(every) if every[name] >= SAID]
    return tuple(c for c in f.candidates if c is not best and c.title in credible)


def support(f: Finding, best: Candidate) -> Reason:
    """Return a sentence (`Reason`) on how sure an effect is, and what else explains the data."""
    return Reason("support", {"verdict": f.verdict, "best": best, "others": rivals(f, best)})
