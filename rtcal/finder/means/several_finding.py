"""What is said of several effects: probabilities, sizes, claims, and their words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from rtcal.errors import DataError
from rtcal.finder.case import AppliedEffect, Case
from rtcal.finder.claim import SAID, family_of
from rtcal.finder.coefficients import OffTogether
from rtcal.finder.effects import Effect
from rtcal.finder.means import track_record
from rtcal.finder.means.finding import Finding
from rtcal.finder.means.model_error import ModelDiscrepancy
from rtcal.finder.means.set_posterior import Names
from rtcal.finder.means.verdict import Fit
from rtcal.finder.prior import NONE, UNKNOWN
from rtcal.finder.wording import listed
from rtcal.support import text
from rtcal.support.arguments import checked
from rtcal.support.results import Result
from rtcal.support.types import Array

_NUMBERS = ("none", "one", "two", "three")


@dataclass(frozen=True, eq=False)
class Member:
    """An effect of the most probable set.

    Attributes
    ----------
    alone, together : Fit
        Its parameters and size if it were the only one, and with the others in the model.
    stand_ins : tuple of str
        Effects that explain the data as well in its place.
    reasons : tuple of str
        Why it is not claimed, though its probability would allow it.
    """

    alone: Fit
    together: Fit
    stand_ins: tuple[str, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False)
class SeveralFinding(Result):
    """What the data say of several effects at once.

    Attributes
    ----------
    single : Finding
        The search for one effect; its threshold decides whether anything is missing.
    expected : float
        Expected number of effects, before anything was measured.
    verdict : {"none", "hint", "named", "family", "ambiguous", "unknown"}
        ``none`` and ``hint`` as the single search says. ``named``: at least one effect is there with a
        probability of 0.9 and passes every check. ``family``: no effect, but a family or a set of
        families is claimed. ``ambiguous``: something is missing, and nothing of it is claimed.
        ``unknown``: an effect that the library lacks has a probability of 0.9.
    named : tuple of str
        The effects that are claimed.
    named_families : tuple of str
        The families that are claimed; those of ``named`` among them.
    named_set : tuple of str
        The families of two or three effects that are claimed together: the most probable ones, where
        two or more effects are probable enough (`several.TWO`) and pass every check; else ().
    probabilities : mapping of str to float
        Of each effect, "coefficients" and "unknown" that it is there at all, the most probable first.
        They do not sum to 1.
    families : mapping of str to float
        The same of each family.
    numbers : tuple of float
        Probabilities of 0, 1, 2, ... effects.
    sets : mapping of tuple of str to float
        Probabilities of the sets of effects, the most probable first; () is "none".
    family_sets : mapping of tuple of str to float
        The same of sets of families; all of "added absorption" as one.
    members : mapping of str to Member
        The effects of the most probable set without an unknown one, of ``named_set`` if there is one,
        in the order in which they act.
    alpha : array (n_materials, n_bands)
        Posterior mean of the coefficients, averaged over all sets: what `apply` cannot give, since it
        adds one set.
    likely : sequence of (tuple of AppliedEffect, float)
        The most probable sets with their parameters, and their probabilities, which sum to 1: what
        `plan` goes on from.
    """

    record_kind: ClassVar[str] = "several effects 1"

    single: Finding
    expected: float
    verdict: str
    named: tuple[str, ...]
    named_families: tuple[str, ...]
    named_set: tuple[str, ...]
    probabilities: Mapping[str, float]
    families: Mapping[str, float]
    numbers: tuple[float, ...]
    sets: Mapping[Names, float]
    family_sets: Mapping[Names, float]
    members: Mapping[str, Member]
    alpha: Array
    likely: Sequence[tuple[tuple[AppliedEffect, ...], float]]

    @property
    def case(self) -> Case:
        """The case that was searched."""
        return self.single.case

    @property
    def discrepancy(self) -> ModelDiscrepancy:
        """Bias and covariance of the model's error."""
        return self.single.discrepancy

    @property
    def coefficients(self) -> OffTogether | None:
        """How the coefficients are off together, if that is likely beside the most probable set."""
        every = [m.together.coefficients for m in self.members.values()]
        return every[-1] if every else None

    @property
    def can_be_added(self) -> bool:
        """Whether `apply` has something to add."""
        return self.verdict in ("named", "family", "ambiguous") and bool(self.members)

    @checked
    def apply(self, case: Case | None = None) -> Case:
        """Return the case with the most probable set of effects in its model.

        Each has its size with the others in the model. Where the coefficients are off together, the
        room's alpha is moved and its sigma widened. An effect that the case has already is left as it
        is.

        Raises
        ------
        DataError
            If the verdict is "none", "hint" or "unknown".
        """
        case = self.case if case is None else case
        if not self.can_be_added:
            raise DataError(f'the verdict is "{self.verdict}"; there is no effect to add')
        if self.coefficients is not None:
            case = self.coefficients.apply(case)
        present = {a.name for a in case.applied}
        added = [
            applied_with(self.single.effects[name], m.together)
            for name, m in self.members.items()
            if name not in present
        ]
        return replace(case, applied=(*case.applied, *added))

    @property
    def notes(self) -> tuple[str, ...]:
        """Data that were dropped, origins of the uncertainties, and reasons to doubt the result."""
        return self.single.notes

    @property
    def reason_for_none(self) -> str | None:
        """Why there is no effect to add, in words; None where there is one."""
        if self.verdict == "unknown":
            return f"Nothing to add: {self.unknown_in_words} (verdict unknown)."
        return None if self.can_be_added else self.single.reason_for_none

    @property
    def added(self) -> str:
        """What `apply` adds, in words."""
        titles = [
            f"{self.single.effects[n].title(m.together.parameters, self.case.room)} "
            f"({self.percent(n)})"
            for n, m in self.members.items()
        ]
        share = 100 * next(p for s, p in self.sets.items() if s == tuple(self.members))
        return (
            f"Added {listed(titles)}, the most probable set ({share:.0f} %). {self._claimed_of_it}"
        )

    @property
    def _claimed_of_it(self) -> str:
        """What of the set that `apply` adds is claimed, in words."""
        if set(self.members) <= set(self.named):
            return "It is claimed."
        families = dict.fromkeys((*self._families_claimed_alone, *self.named_set))
        claimed = [*self.named, *(f"the family {f}" for f in families)]
        return f"Of it, {listed(claimed)} is claimed." if claimed else "Nothing of it is claimed."

    def percent(self, name: str) -> str:
        """The probability that an effect is there at all, in percent."""
        return f"{100 * self.probabilities.get(name, 0.0):.0f} %"

    @property
    def sentence(self) -> str:
        """What the verdict says of the model."""
        if self.verdict in ("none", "hint"):
            return self.single.sentence
        if self.verdict == "unknown":
            return f"{self.unknown_in_words.capitalize()}."
        if self.verdict == "ambiguous":
            return f"Something is missing; {self.likely_in_words}."
        claimed = [f"{n} ({self.percent(n)})" for n in self.named]
        claimed += [f"{f} ({100 * self.families[f]:.0f} %)" for f in self._families_claimed_alone]
        sentences = []
        if claimed:
            sentences.append(f"Missing from the model, or not as stated: {listed(claimed)}.")
        if self.named_set:
            sentences.append(self.set_in_words)
        return " ".join(sentences)

    @property
    def likely_in_words(self) -> str:
        """The most probable set, and the probability of an unknown effect where that is larger."""
        likely = listed([f"{n} ({self.percent(n)})" for n in self.members])
        known = max(self.probabilities[n] for n in self.members)
        if self.probabilities.get(UNKNOWN, 0.0) <= known:
            return f"most probable is {likely}"
        return f"most probable of the library is {likely}, and {self.unknown_in_words}"

    @property
    def unknown_in_words(self) -> str:
        """The probability of an effect that the library lacks, in words."""
        return (
            f"something that no effect of the library explains is missing ({self.percent(UNKNOWN)})"
        )

    @property
    def set_in_words(self) -> str:
        """What is claimed of several families together; "" where nothing is."""
        if not self.named_set:
            return ""
        several, share = sum(self.numbers[2:]), self.family_sets[self.named_set]
        return (
            f"More than one thing is missing ({100 * several:.0f} %); most probable together: "
            f"{listed(self.named_set)} ({100 * share:.0f} %)."
        )

    @property
    def track_record(self) -> list[str]:
        """How often such claims were right in rooms that were not used to make the finder."""
        return track_record.of_sets(bool(self.named_families), bool(self.named_set))

    @property
    def _families_claimed_alone(self) -> list[str]:
        """The claimed families of which no effect is claimed."""
        of_named = {family_of(n, self.single.effects) for n in self.named}
        return [f for f in self.named_families if f not in of_named]

    @property
    def numbers_in_words(self) -> str:
        """The probabilities of none, one and more effects."""
        return "number of effects: " + ", ".join(
            f"{word} with {100 * p:.0f} %"
            for word, p in zip(_NUMBERS, self.numbers, strict=False)
            if p >= 0.005
        )

    def in_words(self, name: str) -> list[str]:
        """One effect of the most probable set: probability, sizes, what stands for it, doubts."""
        m = self.members[name]
        effect = self.single.effects[name]
        title = effect.title(m.together.parameters, self.case.room)
        said = f"{title}: there with {self.percent(name)}"
        if m.together.size is None:
            said += f"; {effect.describe(m.together.parameters)}"
        else:
            said += f"; {m.together.size.words}"
            if len(self.members) > 1 and m.alone.size is not None:
                said += f", without the others {m.alone.size.words}"
        out = [said]
        if m.stand_ins:
            out.append(f"{name} may stand for {listed(m.stand_ins)}")
        return [*out, *m.reasons]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "expected": self.expected,
            "named": list(self.named),
            "named_families": list(self.named_families),
            "named_set": list(self.named_set),
            "probabilities": dict(self.probabilities),
            "families": dict(self.families),
            "numbers": list(self.numbers),
            "sets": [{"effects": list(s), "probability": p} for s, p in self.sets.items()],
            "family_sets": [
                {"families": list(s), "probability": p} for s, p in self.family_sets.items()
            ],
            "alpha": self.alpha.tolist(),
            "members": {
                name: {
                    "parameters": dict(m.together.parameters),
                    "size": m.together.size and m.together.size.to_dict(),
                    "size_without_others": m.alone.size and m.alone.size.to_dict(),
                    "stand_ins": list(m.stand_ins),
                    "reasons": list(m.reasons),
                }
                for name, m in self.members.items()
            },
            "single": self.single.to_dict(),
        }

    def __repr__(self) -> str:
        """Return one line: verdict and the most probable set."""
        likely = text.shortened(", ".join(f"{n} {self.percent(n)}" for n in self.members))
        return f"<SeveralFinding {self.verdict}: {likely or 'no effect'}>"

    def __str__(self) -> str:
        """Return verdict, probabilities, numbers, sets, sizes and doubts."""
        lines = text.wrapped(f"{self.verdict}: {self.sentence}")
        likely = ", ".join(
            f"{n} {self.percent(n)}" for n, p in self.probabilities.items() if p >= SAID
        )
        sets = ", ".join(
            f"{' + '.join(s) or NONE} {100 * p:.0f} %" for s, p in self.sets.items() if p >= SAID
        )
        sentences = [self.numbers_in_words, f"there at all: {likely or 'nothing'}", f"sets: {sets}"]
        for name in self.members:
            sentences += self.in_words(name)
        if self.members and self.coefficients is not None:
            words = self.coefficients.words(self.case.room.centre_frequencies)
            sentences.append(f"the coefficients are off together: {words}")
        sentences += self.track_record
        sentences += [f"note: {n}" for n in self.notes]
        for sentence in sentences:
            lines += text.wrapped(sentence, indent="  ")
        return "\n".join(lines)


def applied_with(effect: Effect, fitted: Fit) -> AppliedEffect:
    """Return an effect with its size and interval, to be put into a case."""
    ends = None if fitted.size is None else (fitted.size.low, fitted.size.high)
    return AppliedEffect.of(effect, fitted.parameters, ends)
