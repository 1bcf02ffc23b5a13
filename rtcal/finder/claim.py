"""Probabilities of each effect and family, and what is claimed of them.

Of both observation models. A `SetsFinding` says which sets of effects are claimed, and which effects
stand for one another. `rtcal.finder.records` says how often such claims were right.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.special import logsumexp

from rtcal.finder.effects import Effect
from rtcal.finder.finding import Finding
from rtcal.finder.prior import COEFFICIENTS, NONE, UNKNOWN, Prior
from rtcal.support.text import as_sentence, listed
from rtcal.support.types import Array

Key = TypeVar("Key")
CLAIMED = 0.9
"""Probability from which an effect, a family or a surface is claimed."""
SAID = 0.03
"""Probability below which an effect is not printed."""
CREDIBLE = 0.9
"""Probability, given that something is missing, that the candidates hold together."""
DISTINCT_NATS = 2.3
"""Evidence in nats from which two effects, or two surfaces, are told apart: odds of ten to one."""
_ABSORPTION = "added absorption"
_ALIKE = 1.25
"""Ratio of the upper and the lower bands, below which these are alike."""


def after_doubt(doubt: str) -> str:
    """Return how a claim begins that stands after a doubt about what is stated; "" without one."""
    return f"{as_sentence(doubt)} If there is none: " if doubt else ""


def over_frequency(values: Array) -> str:
    """Return how the size of values (n_bands,) goes with frequency.

    Examples
    --------
    >>> over_frequency(np.array([1.0, 2.0])), over_frequency(np.array([-2.0, -2.2]))
    ('rising with frequency', 'alike at all frequencies')
    """
    half, size = max(1, len(values) // 2), np.abs(values)
    low, high = size[:half].mean(), size[-half:].mean()
    if max(low, high) < _ALIKE * min(low, high):
        return "alike at all frequencies"
    return f"{'rising' if high > low else 'falling'} with frequency"


def posterior(evidence: Mapping[str, float], prior: Prior) -> dict[str, float]:
    """Return the probability of "none", "coefficients", "unknown" and each effect; they sum to 1.

    It is evidence times prior, to the power `Prior.sharpness`.
    """
    log = {k: prior.sharpness * (v + prior.log_probability[k]) for k, v in evidence.items()}
    total = float(logsumexp(list(log.values())))
    return {k: float(np.exp(v - total)) for k, v in sorted(log.items(), key=lambda kv: -kv[1])}


def by_family(
    probabilities: Mapping[str, float], effects: Mapping[str, Effect]
) -> dict[str, float]:
    """Return the probability of each family, the most probable first.

    "none", "coefficients" and "unknown" are families of their own. "added absorption" is the sum of the
    families whose names begin with it.
    """
    out: dict[str, float] = {}
    for name, probability in probabilities.items():
        family = family_of(name, effects)
        out[family] = out.get(family, 0.0) + probability
    return with_added(out)


def with_added(families: Mapping[str, float]) -> dict[str, float]:
    """Return the families with the sum of all added absorption, the most probable first."""
    out = dict(families)
    absorption = [p for family, p in out.items() if family.startswith(f"{_ABSORPTION},")]
    if len(absorption) > 1:
        out[_ABSORPTION] = sum(absorption)
    return most_probable_first(out)


def most_probable_first(values: Mapping[Key, float]) -> dict[Key, float]:
    """Return probabilities in their order."""
    return dict(sorted(values.items(), key=lambda kv: -kv[1]))


def family_of(name: str, effects: Mapping[str, Effect]) -> str:
    """Return the family of an effect, or of "none", "coefficients" or "unknown"."""
    return name if name in (NONE, COEFFICIENTS, UNKNOWN) else effects[name].family


Names = tuple[str, ...]
"""A set of effects or of families."""


def families_of(names: Names, effects: Mapping[str, Effect]) -> Names:
    """Return the families of a set, sorted; all of "added absorption" as one."""
    return tuple(sorted(family_of(name, effects).split(",")[0] for name in names))


def by_family_sets(
    sets: Mapping[Names, float], effects: Mapping[str, Effect]
) -> dict[Names, float]:
    """Return the probability of each set of families (`families_of`), the most probable first."""
    out: dict[Names, float] = {}
    for names, p in sets.items():
        families = families_of(names, effects)
        out[families] = out.get(families, 0.0) + p
    return most_probable_first(out)


def numbers_of(sets: Mapping[Names, float]) -> tuple[float, ...]:
    """Return the probabilities of 0, 1, 2, ... effects."""
    out = [0.0] * (1 + max(map(len, sets)))
    for names, p in sets.items():
        out[len(names)] += p
    return tuple(out)


def narrowest_family(families: Mapping[str, float], least: float) -> str | None:
    """Return the family of at least this probability, the narrower of two; None without one.

    A comma leads from a family to one of its kinds: "added absorption, rising".
    """
    probable = [f for f, p in families.items() if p >= least and f != NONE]
    return max(probable, key=lambda family: family.count(",")) if probable else None


def claimed(
    detected: str | None,
    probabilities: Mapping[str, float],
    families: Mapping[str, float],
    by_family_alone: Collection[str] = (),
) -> tuple[str, str | None]:
    """Return the verdict before any check, and the family that is probable enough to be claimed.

    Parameters
    ----------
    detected : str or None
        The verdict where nothing is detected, "none" or "hint"; None where something is.
    probabilities, families : mapping of str to float
        Of each effect and family, the most probable first.
    by_family_alone : collection of str
        The effects that are not claimed by their own names (`Effect.alone`).
    """
    if detected is not None:
        return detected, None
    best = next(k for k in probabilities if k != NONE)
    family = narrowest_family(families, CLAIMED)
    if best == UNKNOWN:
        return "unknown", family
    if probabilities[best] >= CLAIMED and best not in by_family_alone:
        return "named", family
    return ("ambiguous" if family is None else "family"), family


FAIR = 1 / 3
"""A fair part of the probability. Where nothing missing has it, as before the measurement
(`rtcal.finder.prior.NO_EFFECT`), or no effect and no family does, the data do not say enough to call
something missing. `python -m benchmarks.studies.means.chain weak` shows what it costs and saves."""


def too_weak(probabilities: Mapping[str, float], families: Mapping[str, float]) -> str:
    """Return why nothing is said to be missing although the score exceeds its threshold; "" if it is.

    Examples
    --------
    >>> too_weak({"none": 0.4, "opening": 0.35}, {"none": 0.4, "added absorption": 0.5})
    'that nothing is missing has a probability of 40 %'
    >>> too_weak({"none": 0.2, "opening": 0.3}, {"none": 0.2, "added absorption": 0.5})
    ''
    """
    nothing = probabilities.get(NONE, 0.0)
    if nothing >= FAIR:
        return f"that nothing is missing has a probability of {100 * nothing:.0f} %"
    every = [p for table in (probabilities, families) for k, p in table.items() if k != NONE]
    if max(every, default=0.0) < FAIR:
        return f"no effect and no family of effects has a probability of {100 * FAIR:.0f} %"
    return ""


def credible_set(probabilities: Mapping[str, float]) -> tuple[str, ...]:
    """Return the most probable hypotheses but "none" that hold `CREDIBLE` of the probability."""
    some = {k: p for k, p in probabilities.items() if k != NONE}
    total, held, out = sum(some.values()), 0.0, []
    for name, p in some.items():
        out.append(name)
        held += p
        if held >= CREDIBLE * total:
            break
    return tuple(out)


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
