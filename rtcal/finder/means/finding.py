"""The result of a search: verdict, evidence and the effect that explains the data best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.files.disk import json_numbers
from rtcal.finder.case import Case
from rtcal.finder.claim import (
    CLAIMED,
    SAID,
    Names,
    after_doubt,
    by_family_sets,
    family_of,
    numbers_of,
    unexplained,
)
from rtcal.finder.effects import AppliedEffect, WrongVolume, checked_effects
from rtcal.finder.finding import LEAST_ADDED, NATS, Finding, Size
from rtcal.finder.means.problem import ModelDiscrepancy
from rtcal.finder.means.verdict import Fit
from rtcal.finder.prior import COEFFICIENTS, NONE, UNKNOWN, OffTogether, Prior
from rtcal.finder.records import data_of, record_of_means, record_of_several
from rtcal.support import text
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence, listed
from rtcal.support.types import Array


def feature_names(measured: Measurement) -> tuple[str, ...]:
    """Return the features' names as printed, by the reverberation time that was measured."""
    time = measured.time_label
    return time, f"EDT/{time}", "T30/T20", "C80", "G"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MeansFinding(Finding):
    """The finding of means over positions; attributes beside those of `Finding`.

    It is of sets of effects, each of which has one effect unless `rtcal.find` was given ``most``.

    Attributes
    ----------
    case : Case
    candidates : tuple of Candidate
        The members, then what explains the data in place of one. Of single effects, these are the most
        probable ones that hold 0.9 of what is not "none"; one where the verdict is "named".
    named, named_families : tuple of str
        The effects and the families that are claimed.
    named_set : tuple of str
        The families of two or three effects that are claimed together: the most probable ones, where
        two or more effects are probable enough (`rtcal.finder.means.verdict.TWO`); else ().
    members : tuple of str
        The effects of the most probable set, in the order in which they act: what `apply` adds.
    sets : mapping of tuple of str to float
        Probabilities of the sets of effects, the most probable first; () is no effect.
    stand_ins : mapping of str to tuple of str
        Of each of two or more members, the effects that explain the data as well in its place.
    evidence : mapping of str to float
        Log evidence over "none" in nats, by effect alone, of "coefficients" and of "unknown".
    probabilities, families : mapping of str to float
        Of an effect, or of one of the family, that it is there at all. They sum to 1 where each set has
        one effect.
    likely : sequence of (tuple of AppliedEffect, float)
        The most probable sets with their parameters, and their probabilities, which sum to 1: what
        `rtcal.finder.plan` goes on from.
    alpha : array (n_materials, n_bands)
        Posterior mean of the coefficients, averaged over all sets: what `apply` cannot give, since it
        adds one set.
    prior : Prior
    fits : mapping of str to Fit
        Parameters, size and gap of each candidate; of a member with the other members in the model.
    alone : mapping of str to Fit
        The same of two or more members without the others.
    advice : str
        The next measurement that would decide.
    residuals : array (n_configurations, n_features, n_bands)
        Modelled less measured, as every gap, over its standard deviation: amount (ln T20), shape
        (EDT/T20, T30/T20), level (C80, G). NaN where nothing was measured.
    reasons, leads, mistake : tuple of str, bool, str
        Doubts about what is most probable. One about the size, the fit or what is stated leaves its
        family claimed; the last stands first and ``leads``. Any other takes the claim back. The
        ``mistake`` is that T is twice or half the model's; "" where it is not.
    discrepancy : ModelDiscrepancy
        Bias and covariance of the model's error.
    not_judged : mapping of str to str
        Effects that were not tried, since the room does not state what they act by: each with the
        reason.
    """

    record_kind: ClassVar[str] = "finding 2"

    case: Case
    named: Names
    named_families: Names
    named_set: Names
    members: Names
    sets: Mapping[Names, float]
    stand_ins: Mapping[str, Names]
    evidence: Mapping[str, float]
    likely: Sequence[tuple[tuple[AppliedEffect, ...], float]]
    alpha: Array
    prior: Prior
    fits: Mapping[str, Fit]
    alone: Mapping[str, Fit]
    advice: str
    residuals: Array
    discrepancy: ModelDiscrepancy
    leads: bool = False
    mistake: str = ""
    not_judged: Mapping[str, str] = field(default_factory=dict)

    @property
    def engines(self) -> tuple[str, ...]:
        """The simulators of the control rooms, from which threshold and discrepancy were estimated."""
        return self.discrepancy.engines

    @property
    def numbers(self) -> tuple[float, ...]:
        """Probabilities of 0, 1, 2, ... effects."""
        return numbers_of(self.sets)

    @property
    def more_than_one(self) -> bool:
        """Whether sets of two and more effects were compared."""
        return len(self.numbers) > 2

    @property
    def family_sets(self) -> dict[Names, float]:
        """Probabilities of sets of families; all of "added absorption" as one."""
        return by_family_sets(self.sets, self.effects)

    @property
    def names(self) -> Names:
        """The candidates' effects; "coefficients" and "unknown" may be among them."""
        return tuple(c.effect for c in self.candidates)

    @property
    def best_effect(self) -> str | None:
        """The most probable effect, "coefficients" or "unknown"; None where the verdict is "none"."""
        return None if self.best is None else self.best.effect

    @property
    def effect(self) -> str | None:
        """The effect that is named, else the best; None where the verdict is "none" or "family"."""
        if self.verdict in ("none", "family"):
            return None
        return self.named[0] if self.named else self.best_effect

    @property
    def runner_up(self) -> str:
        """The second best."""
        others = [k for k in self.probabilities if k not in (NONE, self.best_effect)]
        return others[0] if others else NONE

    @property
    def best_parameters(self) -> Mapping[str, float]:
        """The best effect's parameters; the size among them is the `size`'s mean."""
        fit = self.fits.get(str(self.best_effect))
        return {} if fit is None else fit.parameters

    @property
    def size(self) -> Size | None:
        """The best effect's size with its interval, where it has one."""
        fit = self.fits.get(str(self.best_effect))
        return None if fit is None else fit.size

    @property
    def coefficients(self) -> OffTogether | None:
        """The common error of the coefficients, if one is likely beside the most probable set."""
        return self.fits[self.members[-1]].coefficients if self.members else None

    @property
    def can_be_added(self) -> bool:
        """Whether `apply` has something to add."""
        return self.verdict in ("named", "family", "ambiguous") and bool(self.members)

    @property
    def can_be_verified(self) -> bool:
        """Whether `rtcal.finder.verify` can compare the gap: for one effect that is probable."""
        return self.can_be_added and len(self.members) == 1 and self._least >= LEAST_ADDED

    @property
    def _least(self) -> float:
        """The smallest probability of the members, that each is there at all."""
        return min((self.probabilities[n] for n in self.members), default=0.0)

    @property
    def undecided(self) -> str:
        """Why `apply` must be told which effect it is to add, in words; "" where it need not be."""
        if not self.can_be_added:
            return ""
        if self._least < LEAST_ADDED:
            return (
                f"No effect is stated, and the most probable has less than {100 * LEAST_ADDED:.0f} %. "
                f"Candidates: {self._listed_candidates}. State one: effect = NAME."
            )
        return self._volume_in_words(self.members)

    @property
    def _listed_candidates(self) -> str:
        return listed([f"{n} ({self.percent(n)})" for n in self.names if n != UNKNOWN], last="or")

    def _volume_in_words(self, members: Names) -> str:
        """Why a volume among the members is not changed, in words; "" where it is, or none is there."""
        name = WrongVolume.name
        if name not in members or name in self.named:
            return ""
        others = [n for n in self.names if n not in (name, UNKNOWN)]
        instead = f", or state another effect: {listed(others, last='or')}" if others else ""
        return (
            f"effect = {name} has {self.percent(name)}, and a stated volume is changed only where its "
            f"error is claimed, from {100 * CLAIMED:.0f} %. Measure the volume and state it in the "
            f"room's file{instead}."
        )

    def apply(self, case: Case | None = None, *, effect: str | None = None) -> Case:
        """Return the case with the most probable effects in its model, or with one that is named.

        An ambiguous finding, and a family, add their best candidate if it has a probability of 0.3 or
        more. Each effect has its size with the others in the model. Where the coefficients are off
        together, the room's alpha is moved and its sigma widened. An effect that the case has already
        is left as it is.

        Parameters
        ----------
        case : Case, optional
            To which it is added; by default the finding's own.
        effect : str, optional
            The candidate to add instead of the most probable one.

        Raises
        ------
        DataError
            If the verdict names no effect ("none", "hint", "unknown"); if ``effect`` is no candidate;
            if it is not stated and the most probable one has less than 0.3; for a volume that is not
            claimed.
        """
        return self.with_effects(case, self.chosen(effect))

    def chosen(self, effect: str | None = None) -> Names:
        """Return the effects that `apply` adds; DataError as it does."""
        if not self.can_be_added:
            raise DataError(f'the verdict is "{self.verdict}"; there is no effect to add')
        if effect is None:
            if why := self.undecided:
                raise DataError(why)
            return self.members
        if effect not in self.fits:
            raise DataError(
                f'effect = "{effect}" is no candidate. Candidates: {self._listed_candidates}'
            )
        if why := self._volume_in_words((effect,)):
            raise DataError(why)
        return (effect,)

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
        case = self.case if case is None else case
        members = self.members if members is None else members
        present = {a.name for a in case.applied}
        if present.issuperset(members):
            return case
        fits = self.fits if fits is None else fits
        off = fits[members[-1]].coefficients
        if off is not None:
            case = off.apply(case)
        missing = [n for n in members if n in self.effects and n not in present]
        added = [fits[name].applied(self.effects[name]) for name in missing]
        return replace(case, applied=(*case.applied, *added)) if added else case

    def title_of(self, name: str) -> str:
        """A candidate as a sentence names it."""
        if name == COEFFICIENTS:
            return "coefficients that are off together"
        if name not in self.effects or name not in self.fits:
            return name
        return self.effects[name].title(self.fits[name].parameters, self.case.room)

    @property
    def title(self) -> str:
        """The best effect, or the most probable set, as a sentence names it."""
        return listed([self.title_of(n) for n in self.members or (str(self.best_effect),)])

    @property
    def rivals(self) -> list[str]:
        """The candidates beside the most probable set."""
        return list(self.names[max(1, len(self.members)) :])

    @property
    def support(self) -> str:
        """Verdict, the best effect's probability and the next best effects, in words."""
        best = f"{self.title} {self.percent(str(self.best_effect))}"
        best += "" if self.rivals else f"; next {self.second_best}"
        return self.support_of(best, [f"{self.title_of(r)} {self.percent(r)}" for r in self.rivals])

    @property
    def second_best(self) -> str:
        """The runner-up with its probability."""
        return f"{self.runner_up} {self.percent(self.runner_up)}"

    @property
    def reason_for_none(self) -> str | None:
        """Why there is no effect to add, in words; None where there is one."""
        if self.verdict == "hint" and self.reasons:
            return f"Nothing to add: a hint of {self.title} only. {as_sentence(self.reasons[0])}"
        return {
            "none": "Nothing to add: prior, measurement and model agree (verdict none).",
            "hint": f"Nothing to add: a hint of {self.title} only, {self.score:.1f} nats of the "
            f"{self.threshold:.1f} that it must exceed (verdict hint).",
            "unknown": "Nothing to add: something is missing that no effect of the library explains "
            "(verdict unknown).",
        }.get(self.verdict)

    def added(self, members: Names) -> str:
        """The effects that `apply` adds, and those that explain the data nearly as well, in words."""
        if members != self.members:
            (name,) = members
            others = [f"{n} ({self.percent(n)})" for n in self.names if n != name]
            beside = f" Candidates beside it: {listed(others)}." if others else ""
            return f"Added, as stated: {self.title_of(name)} ({self.percent(name)}).{beside}"
        if len(members) == 1:
            return f"Added: {self.title} ({self.support})."
        titles = [f"{self.title_of(n)} ({self.percent(n)})" for n in members]
        families = dict.fromkeys((*self._families_alone, *self.named_set))
        claimed = [*self.named, *(f"the family {f}" for f in families)]
        said = f"Of it, {listed(claimed)} is claimed." if claimed else "Nothing of it is claimed."
        if set(members) <= set(self.named):
            said = "It is claimed."
        share = 100 * self.sets[members]
        return f"Added: {listed(titles)}, the most probable set ({share:.0f} %). {said}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        size, off = self.size, self.coefficients
        effect = self.effects.get(str(self.best_effect))
        return {
            **super().to_dict(),
            "detected_by": self.detection.deciding,
            "effect": self.effect,
            "named": list(self.named),
            "named_families": list(self.named_families),
            "named_set": list(self.named_set),
            "members": list(self.members),
            "undecided": self.undecided or None,
            "amount": self.amount or None,
            "candidates": list(self.names),
            "numbers": list(self.numbers),
            "sets": [{"effects": list(s), "probability": p} for s, p in self.sets.items()],
            "evidence": {k: json_numbers(v) for k, v in self.evidence.items()},
            "sizes": {name: f.size and f.size.to_dict() for name, f in self.fits.items()},
            "sizes_alone": {n: f.size and f.size.to_dict() for n, f in self.alone.items()},
            "stand_ins": {name: list(others) for name, others in self.stand_ins.items()},
            "alpha": self.alpha.tolist(),
            "coefficients": off and {"probability": off.probability, "ratio": off.ratio.tolist()},
            "engines": list(self.engines),
            "parameters": dict(self.best_parameters),
            "material": effect and effect.material(self.best_parameters, self.case.room),
            "size": size and size.to_dict(),
            "runner_up": self.runner_up,
            "advice": self.advice,
            "not_judged": dict(self.not_judged),
            "residuals": [
                {
                    "configuration": c.name,
                    "feature": feature_names(c.measured)[f],
                    "values": [None if np.isnan(v) else round(float(v), 2) for v in row],
                }
                for c, table in zip(self.case.configurations, self.residuals, strict=True)
                for f, row in enumerate(table)
                if np.isfinite(row).any()
            ],
        }

    @property
    def what(self) -> str:
        """The members of a set, or the candidates, with their probabilities."""
        some = self.members if len(self.members) > 1 else self.names
        return text.shortened(", ".join(f"{c} {self.percent(c)}" for c in some)) or "no effect"

    def blocks(self) -> list[Block]:
        """Return verdict, sizes, probabilities, residuals, advice and notes."""
        rows = [
            Row(
                name,
                [
                    self.percent(name),
                    f"{self.evidence[name]:+z.1f}" if name in self.evidence else "",
                    "candidate" if name in self.names else "",
                ],
            )
            for name, p in self.probabilities.items()
            if p >= SAID
        ]
        there = "probability" if not self.more_than_one else "probability of being there at all"
        tables = [Table([there, "evidence / nats", ""], rows, corner="effect")]
        labels = bands.labels(self.case.room.centre_frequencies)
        for c, residuals in zip(self.case.configurations, self.residuals, strict=True):
            named = zip(feature_names(c.measured), residuals, strict=True)
            measured = [Row(name, row, "+z.1f") for name, row in named if np.isfinite(row).any()]
            title = f'residuals of "{c.name}", in standard deviations (model - measured)'
            tables.append(Table(labels, measured, title))
        last = (f"next: {self.advice}", *(f"note: {n}" for n in self.notes))
        indented = [Note(sentence, "  ") for sentence in self.sentences]
        return [Note(self.headline), *indented, *tables, *(Note(n, "  ") for n in last)]

    @property
    def sentences(self) -> tuple[str, ...]:
        """What text and page have below the headline: sizes, sets, what was not judged, evidence."""
        sets = ", ".join(f"{names} {100 * p:.0f} %" for names, p in self.likely_sets.items())
        said = [*self.in_words, *self.sets_in_words, f"sets: {sets}" if sets else ""]
        said += [*self.not_judged_in_words, self.evidence_in_words, self.track_record]
        return tuple(filter(None, said))

    @property
    def evidence_in_words(self) -> str:
        """The evidence that something is missing, and its threshold."""
        return (
            f"{self.deciding_in_words}Evidence that something is missing, whatever it is: "
            f"{self.score:+z.1f} nats ({NATS}). Threshold: {self.threshold:.1f} nats, which at most "
            "5 % of simulated rooms exceed that lack nothing "
            f"({', '.join(self.engines) or 'no engine'})."
        )

    @property
    def deciding_in_words(self) -> str:
        """The part of the data that detects what all data do not; "" without one."""
        words = self.detection.deciding
        if words is None:
            return ""
        part = self.detection.parts[words]
        said = f"{part.score:+z.1f} nats; threshold {part.threshold:.1f}"
        return f"Detected by {words} alone: {said}. All data together say less. "

    @property
    def track_record(self) -> str:
        """The share of such verdicts that were right in rooms that were not used to make the finder."""
        if self.more_than_one and self.verdict not in ("none", "hint"):
            claimed = {"families": self.named_families, "sets of families": self.named_set}
            return record_of_several([kind for kind, names in claimed.items() if names])
        return record_of_means(self.verdict, data_of(self.case))

    @property
    def headline(self) -> str:
        """The verdict and its `sentence`."""
        return f"{self.verdict}{self.or_nothing}: {self.sentence}"

    @property
    def sentence(self) -> str:
        """The verdict as a sentence about the model, after the doubt that comes first."""
        first = after_doubt(self.reasons[0] if self.leads else "")
        if len(self.members) > 1 or (self.named and self.named != self.members):
            likely = f"Something is missing; {self.likely_in_words}."
            return likely if self.verdict == "ambiguous" else f"{first}{self._claims}"
        others = ", ".join(f"{self.title_of(c)} ({self.percent(c)})" for c in self.names)
        hint = f"A hint of {self.title}, under the threshold."
        if self.reasons:
            hint = f"{as_sentence(self.reasons[0])} So it is a hint of {self.title} only."
        named = f"{self.kind}: {self.title}."
        if self.best_effect == COEFFICIENTS:
            named = "The coefficients are off together."
        which = "most probably" if len(self.names) == 1 else "one of"
        lead = f"{self.amount} " if self.amount else ""
        return {
            "none": "No disagreement beyond what prior, measurement and model error allow.",
            "hint": hint,
            "named": f"{lead}{named}",
            "family": f"{first}{lead}{self.kind}: {self.family}, {which} {others}.",
            "ambiguous": f"{self.kind}: one of {others}.",
            "unknown": self._unknown,
        }[self.verdict]

    @property
    def _unknown(self) -> str:
        library = {effect.name for effect in checked_effects(None)}
        if library <= {*self.effects, *self.not_judged}:
            return "Something is missing that no effect of the library explains."
        return as_sentence(f"{unexplained(tuple(self.effects))}: something else is missing")

    @property
    def amount(self) -> str:
        """The absorption that the room has more or less; "" where that is not claimed."""
        fit = self.fits.get(str(self.best_effect))
        alone = self.verdict in ("named", "family") and len(self.members) < 2
        if not alone or fit is None or fit.absorption is None:
            return ""
        return f"The room has {fit.absorption.words}."

    @property
    def kind(self) -> str:
        """Whether the candidates contradict what is stated, or add to it, or either."""
        contradicting = {
            name == COEFFICIENTS
            or (name in self.effects and self.effects[name].contradicts(self.case.room))
            for name in self.names
        }
        if contradicting == {True}:
            return "Not as stated"
        if contradicting == {False}:
            return "Missing from the model"
        return "Missing from the model, or not as stated"

    @property
    def in_words(self) -> list[str]:
        """The sizes of candidates with a row, the coefficients, and what the sentence leaves out."""
        with_row = [n for n in self.names if self.probabilities.get(n, 0.0) >= SAID]
        said = [*map(self.size_of, with_row), self.coefficients_in_words]
        return [*filter(None, said), *self.reasons[self.verdict == "hint" or self.leads :]]

    @property
    def not_judged_in_words(self) -> list[str]:
        """The effects that were not tried, why, and which others may stand for them."""
        library = {effect.name: effect for effect in checked_effects(None)}
        said = []
        for name, reason in self.not_judged.items():
            of_family = library[name].family if name in library else None
            alike = [k for k, e in self.effects.items() if e.family == of_family]
            stands = (
                f" If it is there, {listed(alike, last='or')} may stand for it." if alike else ""
            )
            said.append(f"Not judged: {name}, because {reason}.{stands}")
        return said

    @property
    def coefficients_in_words(self) -> str:
        """The common error of the coefficients, in words; "" where there is none."""
        off = self.coefficients
        if off is None:
            return ""
        what = off.words(self.case.room.centre_frequencies)
        beside = "" if self.best_effect == COEFFICIENTS else f"beside {self.title}, "
        return (
            f"{beside}the coefficients are off together ({100 * off.probability:.0f} %): {what}; "
            "look for another source"
        )

    def size_of(self, name: str) -> str:
        """A candidate's size with its interval, and its other parameters; "" without any."""
        fit = self.fits.get(name)
        if fit is None or not fit.parameters:
            return ""
        effect, s = self.effects[name], fit.size
        if s is None:
            return f"{self.title_of(name)}: {effect.describe(fit.parameters)}"
        others = effect.describe(fit.parameters, without=effect.size)
        alone = None if name not in self.alone else self.alone[name].size
        words = f"size of {self.title_of(name)}: {s.words}"
        words += "" if alone is None else f", without the others {alone.words}"
        return words + (f"; {others}" if others else "")

    @property
    def _families_alone(self) -> list[str]:
        """The claimed families of which no effect is claimed."""
        of_named = {family_of(n, self.effects) for n in self.named}
        return [f for f in self.named_families if f not in of_named]

    @property
    def _claims(self) -> str:
        """The claims about effects, families and sets of families."""
        claimed = [f"{n} ({self.percent(n)})" for n in self.named]
        claimed += [f"{n} ({100 * self.families[n]:.0f} %)" for n in self._families_alone]
        said = [f"Missing from the model, or not as stated: {listed(claimed)}."] if claimed else []
        if self.named_set:
            several, share = sum(self.numbers[2:]), self.family_sets[self.named_set]
            said.append(
                f"More than one thing is missing ({100 * several:.0f} %); most probable together: "
                f"{listed(self.named_set)} ({100 * share:.0f} %)."
            )
        return " ".join(said)

    @property
    def likely_in_words(self) -> str:
        """The most probable set, and the probability of an unknown effect where that is larger."""
        likely = listed([f"{n} ({self.percent(n)})" for n in self.members])
        known = max(self.probabilities[n] for n in self.members)
        if self.probabilities.get(UNKNOWN, 0.0) <= known:
            return f"most probable is {likely}"
        return (
            f"most probable of the library is {likely}, and something that no effect of the library "
            f"explains is missing ({self.percent(UNKNOWN)})"
        )

    @property
    def sets_in_words(self) -> list[str]:
        """Other explanations of each of two or more effects, and the probabilities of their number."""
        if not self.more_than_one:
            return []
        words = zip(("none", "one", "two", "three"), self.numbers, strict=False)
        numbers = ", ".join(f"{word} with {100 * p:.0f} %" for word, p in words if p >= 0.005)
        stand_ins = [
            f"{name} may stand for {listed(others)}"
            for name, others in self.stand_ins.items()
            if others and len(self.members) > 1
        ]
        return [*stand_ins, f"number of effects: {numbers}"]

    @property
    def likely_sets(self) -> dict[str, float]:
        """The sets that are probable enough to be printed; {} where each has one effect."""
        if not self.more_than_one:
            return {}
        return {" + ".join(s) or NONE: p for s, p in self.sets.items() if p >= SAID}
