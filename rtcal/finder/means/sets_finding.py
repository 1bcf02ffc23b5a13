"""The finding of sets of effects: which are claimed, which stand for one another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from rtcal.finder.claim import SAID, Names, by_family_sets, family_of, numbers_of
from rtcal.finder.finding import Finding, listed
from rtcal.finder.prior import NONE, UNKNOWN

_NUMBERS = ("none", "one", "two", "three")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SetsFinding(Finding):
    """The finding of sets of effects; attributes beside those of `Finding`.

    Each set has one effect unless `rtcal.find` was told of more (``most``).

    Attributes
    ----------
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
    """

    named: Names
    named_families: Names
    named_set: Names
    members: Names
    sets: Mapping[Names, float]
    stand_ins: Mapping[str, Names]

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
    def claimed_of_members(self) -> str:
        """The claimed part of the set that `apply` adds, in words."""
        if set(self.members) <= set(self.named):
            return "It is claimed."
        families = dict.fromkeys((*self.families_claimed_alone, *self.named_set))
        claimed = [*self.named, *(f"the family {f}" for f in families)]
        return f"Of it, {listed(claimed)} is claimed." if claimed else "Nothing of it is claimed."

    @property
    def families_claimed_alone(self) -> list[str]:
        """The claimed families of which no effect is claimed."""
        of_named = {family_of(n, self.effects) for n in self.named}
        return [f for f in self.named_families if f not in of_named]

    @property
    def claims(self) -> str:
        """The claims about two or more effects."""
        claimed = self.claimed_in_words()
        said = f"Missing from the model, or not as stated: {claimed}." if claimed else ""
        return f"{said} {self.set_in_words}".strip()

    def claimed_in_words(self, family: Callable[[str], str] = str) -> str:
        """Return the claimed effects and families with their probabilities, in words; "" without any.

        ``family`` names a family in a sentence.
        """
        claimed = [f"{n} ({self.percent(n)})" for n in self.named]
        for name in self.families_claimed_alone:
            claimed.append(f"{family(name)} ({100 * self.families[name]:.0f} %)")
        return listed(claimed)

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
    def set_in_words(self) -> str:
        """The claim about several families together; "" where there is none."""
        if not self.named_set:
            return ""
        several, share = sum(self.numbers[2:]), self.family_sets[self.named_set]
        return (
            f"More than one thing is missing ({100 * several:.0f} %); most probable together: "
            f"{listed(self.named_set)} ({100 * share:.0f} %)."
        )

    @property
    def sets_in_words(self) -> list[str]:
        """Other explanations of each of two or more effects, and the probabilities of their number."""
        if not self.more_than_one:
            return []
        numbers = ", ".join(
            f"{word} with {100 * p:.0f} %"
            for word, p in zip(_NUMBERS, self.numbers, strict=False)
            if p >= 0.005
        )
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
