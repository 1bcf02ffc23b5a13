"""Probabilities of each effect and family, and what is claimed of them.

Of all observation models. `rtcal.finder.records` says how often such claims were right.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TypeVar

import numpy as np
from scipy.special import logsumexp

from rtcal.finder.effects import Effect
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
"""Ratio of both ends of the line through the bands, below which these are alike."""


def after_doubt(doubt: str) -> str:
    """Return how a claim begins that stands after a doubt about what is stated; "" without one."""
    return f"{as_sentence(doubt)} If there is none: " if doubt else ""


def over_frequency(values: Array) -> str:
    """Return how the size of values (n_bands,) goes with frequency, by a straight line through them.

    The line is the least squares' over the bands in their order. A single band is alike.

    Examples
    --------
    >>> over_frequency(np.array([1.0, 2.0])), over_frequency(np.array([-2.0, -2.2]))
    ('rising with frequency', 'alike at all frequencies')
    """
    size, place = np.abs(values), np.arange(len(values)) - (len(values) - 1) / 2
    slope = float(place @ size) / max(1.0, float(place @ place))
    low, high = (float(size.mean()) + slope * float(place[end]) for end in (0, -1))
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


_FEW = 3
"""Most effects that are listed as not explaining what was measured."""


def unexplained(names: Collection[str]) -> str:
    """Return in words that these effects do not explain it.

    Examples
    --------
    >>> unexplained(["air"]), unexplained(["opening", "porous"])
    ('air does not explain it', 'opening and porous do not explain it')
    >>> unexplained(["opening", "porous", "curtain", "people"])
    'none of the effects that were tried explains it'
    """
    if len(names) > _FEW:
        return "none of the effects that were tried explains it"
    return f"{listed(list(names))} {'does' if len(names) == 1 else 'do'} not explain it"


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
