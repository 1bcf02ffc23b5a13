"""Probabilities and sizes of what explains a measurement, and the rules by which it is identified.

These rules are the same for means over positions, for every position and for two states. The sentences
are made in `rtcal.report.finding_words`. `rtcal.finder.records` has how often such results were right.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal, TypeVar

import numpy as np
from scipy.special import logsumexp

from rtcal.files.disk import json_numbers
from rtcal.finder.effects import AppliedEffect, CoupledRoom, Effect, WrongArea
from rtcal.finder.evidence import COEFFICIENTS, NONE, UNKNOWN, OffTogether, Prior
from rtcal.support.errors import ModelError
from rtcal.support.types import Array

Key = TypeVar("Key")
CLAIMED = 0.9
"""Probability from which an effect, a group of effects or a surface is identified."""
SAID = 0.03
"""Probability below which an effect is not printed."""
CREDIBLE = 0.9
"""Probability that the listed candidates have together, if something is missing."""
LIKELY = 0.7
"""Probability that the listed surfaces have together."""
MOST = 0.5
"""Probability, or share of a probability, that counts as most of it."""
DISTINCT_NATS = 2.3
"""Difference of ln Bayes factors from which two effects or surfaces are distinguished: odds of ten to
one."""
_ABSORPTION = "added absorption"
_ALIKE = 1.25  # ratio of both ends of the line through the bands, below which these are alike


def over_frequency(values: Array) -> str:
    """Return in words how the absolute value of ``values`` (n_bands,) changes with frequency.

    A straight line is fitted to the absolute values over the band numbers by least squares. They count
    as alike if the larger end of the line is less than 1.25 times the other, and for a single band.

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
    """Return the probability of each explanation after the measurement, the most probable first.

    ``evidence`` has the ln Bayes factor of each. Its product with the prior is raised to the power
    `Prior.sharpness` and scaled so that the probabilities sum to 1.
    """
    log = {k: prior.sharpness * (v + prior.log_probability[k]) for k, v in evidence.items()}
    total = float(logsumexp(list(log.values())))
    return {k: float(np.exp(v - total)) for k, v in sorted(log.items(), key=lambda kv: -kv[1])}


def by_family(
    probabilities: Mapping[str, float], effects: Mapping[str, Effect]
) -> dict[str, float]:
    """Return the probability of each group of effects, and of all added absorption together."""
    return with_added(summed((family_of(name, effects), p) for name, p in probabilities.items()))


def with_added(families: Mapping[str, float]) -> dict[str, float]:
    """Return probabilities of groups of effects with one more: the sum of all added absorption."""
    out = dict(families)
    absorption = [p for family, p in out.items() if family.startswith(f"{_ABSORPTION},")]
    if len(absorption) > 1:
        out[_ABSORPTION] = sum(absorption)
    return most_probable_first(out)


def summed(parts: Iterable[tuple[Key, float]]) -> dict[Key, float]:
    """Return the sums of probabilities by key, the most probable first."""
    out: dict[Key, float] = {}
    for key, p in parts:
        out[key] = out.get(key, 0.0) + p
    return most_probable_first(out)


def most_probable_first(values: Mapping[Key, float]) -> dict[Key, float]:
    """Return the entries of a mapping, sorted by falling probability."""
    return dict(sorted(values.items(), key=lambda kv: -kv[1]))


def family_of(name: str, effects: Mapping[str, Effect]) -> str:
    """Return the group of an effect; "none", "coefficients" and "unknown" are their own groups."""
    return name if name in (NONE, COEFFICIENTS, UNKNOWN) else effects[name].family


def wide(family: str) -> str:
    """Return the first part of a group's name: "added absorption" for "added absorption, rising"."""
    return family.split(",")[0]


Names = tuple[str, ...]
"""Names of several effects, or of several groups of effects, that are there together."""


def families_of(names: Names, effects: Mapping[str, Effect]) -> Names:
    """Return the names of the groups of several effects, sorted; of absorption the wide one."""
    return tuple(sorted(wide(family_of(name, effects)) for name in names))


def numbers_of(sets: Mapping[Names, float]) -> tuple[float, ...]:
    """Return the probabilities that 0, 1, 2, ... effects are missing."""
    by_number = summed((len(names), p) for names, p in sets.items())
    return tuple(by_number.get(n, 0.0) for n in range(1 + max(by_number, default=0)))


def narrowest_family(families: Mapping[str, float], least: float) -> str | None:
    """Return the most specific group with a probability of at least ``least``, or None."""
    probable = [f for f, p in families.items() if p >= least and f != NONE]
    return max(probable, key=lambda family: family.count(",")) if probable else None


@dataclass(frozen=True)
class Reason:
    """Hold a reason, caution or advice, which ``str`` returns as a sentence.

    ``code`` is a short text that identifies the sentence, such as "gap grows". ``values`` are the
    numbers and names that are inserted in it. The sentences are in `rtcal.report.finding_words`.
    """

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        # `report` stands above this package, so its words are looked up when they are printed.
        words: str = import_module(WORDS).sentence(self)
        return words

    def to_dict(self) -> dict[str, Any]:
        """Return the code, the values and the sentence for JSON."""
        return {"code": self.code, "values": json_numbers(self.values), "text": str(self)}


WORDS = "rtcal.report.finding_words"
"""The module that makes the words of a finding."""
LEADING, MISTAKE = "T far off, effect stands", "T far off"
"""Codes of the reasons that T is about twice or half the model's; the first is printed before the
result."""
EQUATION_OFF = "equation off"
"""Code of the reason that the equation's T differs from that of a program's run."""
OWN_FIELD = "field of the program"
"""Code of the reason that the difference may be the own error of a geometrical program."""
LEAVES: Mapping[str, str] = {
    **dict.fromkeys(("size unbounded", "too large", "not explained", "gap may grow"), "family"),
    LEADING: "family",
    **dict.fromkeys((MISTAKE, "gap grows", "contradicted", "below Schroeder"), "hint"),
    "not the climate alone": "ambiguous",
}
"""Verdict that each reason leaves. Doubts about the size, the fit or an input value leave the group of
effects identified; doubts about the effect leave nothing identified."""
FAIR = 1 / 3
"""Probability from which data suffice to call something missing: they do not if "none" still has as
much (`rtcal.finder.evidence.NO_EFFECT` before the measurement), or if no effect and no group has as
much. Chosen on development rooms."""


@dataclass(frozen=True, kw_only=True)
class Claim:
    """Hold the verdict of a search and what is identified, as `conclude` decides it for a `Finding`."""

    verdict: str
    family: str | None = None
    named: Names = ()
    reasons: tuple[Reason, ...] = ()


def conclude(
    detected: str | None,
    probabilities: Mapping[str, float],
    families: Mapping[str, float],
    by_family_alone: Collection[str] = (),
    reasons: Sequence[Reason] = (),
    weak: Reason | None = None,
) -> Claim:
    """Return the verdict of a search, what is identified, and the reasons.

    ``detected`` is "none" or "hint" if no difference is detected, and then the verdict. ``reasons`` are
    doubts about the most probable effect: `LEAVES` has what remains. With the reason ``weak`` of
    `too_weak` the verdict is "hint" unless something is identified. With that of `of_program` nothing
    is identified if an uneven field is the most probable group.
    """
    own = weak is not None and weak.code == OWN_FIELD
    if weak is not None and own and (detected is None or next(iter(families)) == FIELD):
        return Claim(verdict="hint", reasons=(weak, *reasons))
    if detected is not None:
        return Claim(verdict=detected, reasons=tuple(reasons))
    best = next(k for k in probabilities if k != NONE)
    family = narrowest_family(families, CLAIMED)
    if best == UNKNOWN:
        verdict = "unknown"
    elif probabilities[best] >= CLAIMED and best not in by_family_alone:
        verdict = "named"
    else:
        verdict = "ambiguous" if family is None else "family"
    if verdict in ("named", "family"):
        left = {LEAVES.get(reason.code, verdict) for reason in reasons} | {verdict}
        if "hint" in left or (family is None and "family" in left):
            verdict = "hint"
        elif "ambiguous" in left:
            verdict, family = "ambiguous", None
        elif "family" in left:
            verdict = "family"
    elif weak is not None:
        verdict, reasons = "hint", (weak, *reasons)
    named = (best,) if verdict == "named" else ()
    return Claim(verdict=verdict, family=family, named=named, reasons=tuple(reasons))


def too_weak(probabilities: Mapping[str, float], families: Mapping[str, float]) -> Reason | None:
    """Return the reason why the data are too weak to report something missing (`FAIR`), or None."""
    nothing = probabilities.get(NONE, 0.0)
    if nothing >= FAIR:
        return Reason("nothing likely", {"probability": nothing})
    every = [p for table in (probabilities, families) for k, p in table.items() if k != NONE]
    return Reason("no effect likely", {"least": FAIR}) if max(every, default=0.0) < FAIR else None


FIELD = "field"
"""Name of the group of effects that a geometrical program includes, if it scatters as the room does."""


def of_program(families: Mapping[str, float]) -> Reason | None:
    """Return the reason why a difference may be a geometrical program's own error, or None.

    A geometrical program (rays or image sources) simulates uneven sound fields and second rooms, which
    are the group "field"; and in uneven fields two such programs differ by more than rtcal's reference
    simulations show (benchmarks/studies/runs). There is a reason if "field" or "unknown" is probable
    and all other groups are improbable. ``families`` are the probabilities of groups of effects, by
    name.

    Examples
    --------
    >>> of_program({"none": 0.2, "field": 0.7}).code
    'field of the program'
    >>> of_program({"none": 0.1, "unknown": 0.6, "added absorption": 0.3}).code
    'field of the program'
    >>> of_program({"none": 0.05, "field": 0.04, "added absorption": 0.9})
    """
    own = families.get(FIELD, 0.0) + families.get(UNKNOWN, 0.0)
    if own + families.get(NONE, 0.0) < FAIR or own < SAID:
        return None
    return Reason(OWN_FIELD, {"probability": own})


def credible_set(probabilities: Mapping[str, float]) -> tuple[str, ...]:
    """Return the explanations other than "none" that have 0.9 of their probability together."""
    some = {k: p for k, p in probabilities.items() if k != NONE}
    total, held, out = sum(some.values()), 0.0, []
    for name, p in some.items():
        out.append(name)
        held += p
        if held >= CREDIBLE * total:
            break
    return tuple(out)


End = Literal["", "least", "most"]
"""End of the sizes that were tried at which the data allow any size: "least", "most" or ""."""


def amount(value: float, unit: str, interval: tuple[float, float] | None = None) -> str:
    """Return a size with its unit and its 90 % interval as text; a ratio as "2 times".

    Examples
    --------
    >>> amount(2.0, "of the input area"), amount(12.3, "m²", (8.0, 17.0))
    ('2 times the input area', '12.3 m² (90 % interval 8 to 17)')
    >>> amount(0.875, "of its area covered", (0.47, 1.0))
    '0.875 of its area covered (90 % interval 0.47 to 1)'
    """
    times = unit.replace("of the input ", "times the input ")
    ends = "" if interval is None else f" (90 % interval {interval[0]:.3g} to {interval[1]:.3g})"
    return f"{value:.3g} {times}{ends}"


@dataclass(frozen=True)
class Size:
    """Hold the size of an effect: its mean and its 90 % interval, such as 12 m² (8 to 17).

    ``mean``, ``low`` and ``high`` are in ``unit``. ``end`` is "least" if the data allow any size above
    ``low``, "most" if they allow any size below ``high``, and "" if both ends are known.
    """

    mean: float
    low: float
    high: float
    unit: str
    end: End = ""

    @property
    def words(self) -> str:
        """Size of the effect with its 90 % interval, as text; if one end is open, with its only limit.

        The limit holds with a probability of 95 %.

        Examples
        --------
        >>> Size(12.3, 8.0, 17.0, "m²").words
        '12.3 m² (90 % interval 8 to 17)'
        >>> Size(61.0, 26.0, 109.0, "m²", "least").words
        'at least 26 m² (95 %)'
        """
        if self.end:
            value = self.low if self.end == "least" else self.high
            return f"at {self.end} {amount(value, self.unit)} (95 %)"
        return amount(self.mean, self.unit, (self.low, self.high))

    @property
    def fields(self) -> dict[str, Any]:
        """Fields of a `Candidate` that has this size."""
        return {"size": self.mean, **{k: v for k, v in vars(self).items() if k != "mean"}}


Point = tuple[float, float, float]
LOCATED = 0.5
"""Share of a candidate's probability from which the object is located on one part of its surface."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """Hold one possible explanation of the data: an effect, its probability, its size and its place.

    ``family`` is the name of the effect's group, and ``probability`` that of this explanation.
    ``end`` is "least" or "most" if the data allow any size beyond that end of those that were
    tried, otherwise "".
    """

    effect: str
    family: str
    probability: float
    surface: str | None = None
    """Name of the surface. None for the whole room, for an error of the measurement, and for means."""
    place: str = ""
    """Name of the surface at positions, for means the material in quotes, of an error of measurement
    "receiver R1", "source S1" or "S1 to R1"; "" for the whole room."""
    size: float = math.nan
    low: float = math.nan
    high: float = math.nan
    """Mean of the size, and lower and upper end of its 90 % interval, in ``unit``. NaN for a common
    error of the coefficients and for "unknown"."""
    unit: str = ""
    end: End = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Most probable values of the effect's parameters."""
    spectrum: Array = field(default_factory=lambda: np.zeros(0))
    """Most probable absorption coefficient alpha of the object on the surface, (n_bands,)."""
    parts: tuple[tuple[Point, float], ...] = ()
    """Middle (x, y, z) in m of each part of a large surface, and the probability that the object is on
    this part alone; the rest is that of an object spread over the surface."""
    coefficients: OffTogether | None = None
    """Error that all input coefficients have in common beside the effect, if likely, for means."""
    absorption: Array | None = None
    """Absorption area that the effect adds over the room's mean one, for means, (3, n_bands): by the
    mean of the size, and by the lower and upper end of its interval."""

    @property
    def extent(self) -> Size | None:
        """Size of the effect with its interval; None for an effect without a size."""
        if not np.isfinite(self.size):
            return None
        return Size(self.size, self.low, self.high, self.unit, self.end)

    def applied(self, effect: Effect) -> AppliedEffect:
        """Return the effect with this candidate's parameters and size, for the model of a case."""
        ends = None if self.extent is None else (self.low, self.high)
        return AppliedEffect(effect, self.parameters, ends)

    def to_dict(self) -> dict[str, Any]:
        """Return the candidate as plain values for JSON."""
        left_out = ("coefficients", "absorption")
        return {k: json_numbers(v) for k, v in vars(self).items() if k not in left_out}

    @property
    def middle(self) -> Point | None:
        """Middle (x, y, z) in m of the part of the surface with half of the probability, or None."""
        middle, probability = max(self.parts, key=lambda part: part[1], default=(None, 0.0))
        return middle if probability >= LOCATED * self.probability else None

    @property
    def shown_as(self) -> str:
        """Name of the effect as printed: for a wrong number of pieces "number" instead of "area"."""
        return WrongArea.NUMBER if self.unit == WrongArea.OF_NUMBER else self.effect

    @property
    def title(self) -> str:
        """Name of the effect and its place, as part of a sentence, such as ``curtain on "west"``."""
        return f"{self.shown_as} {self.where}".rstrip()

    @property
    def where(self) -> str:
        """Place of the effect as part of a sentence, such as ``on "west"``; "" for the whole room."""
        if self.surface is not None:
            return f'on "{self.surface}"'
        return f"of {self.place}" if self.place else ""

    @property
    def kind(self) -> str:
        """Name of the effect's group; all groups of "added absorption" have this one name."""
        return wide(self.family)

    @property
    def can_be_added(self) -> bool:
        """Whether `Finding.apply` can add the effect at positions: on a surface, and no second room."""
        return self.surface is not None and self.effect != CoupledRoom.name

    @property
    def in_words(self) -> str:
        """Size of the effect with its 90 % interval as text; "" for an effect without a size."""
        return "" if self.extent is None else self.extent.words


@dataclass(frozen=True)
class Detection:
    """Hold how clearly the data differ from the room's model: a score and the threshold for it.

    The score is a ln Bayes factor: the natural logarithm of how many times more probable the data
    are if something is missing from the model than if nothing is. A difference is detected if the
    score of all data, or of one of the ``parts``, exceeds its threshold. Raises ModelError for a
    score that is not a finite number.
    """

    score: float
    threshold: float
    """ln Bayes factor that at most 5 % of simulated rooms with nothing missing exceed."""
    noise: float | None = None
    """ln Bayes factor that a single pair is noisier than assumed and nothing else differs, at
    positions; None where this was not tried."""
    means: float | None = None
    """Detection from means over positions, where positions decide; None where means were not
    compared."""
    parts: Mapping[str, Detection] = field(default_factory=dict)
    """Detection from a part of the data, for means, by the part's name. What one part detects is
    detected. The score and the threshold above are those of all data."""

    def __post_init__(self) -> None:
        for name in ("score", "noise", "means"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise ModelError(
                    f"the odds of {name} cannot be calculated: the ln Bayes factor is "
                    f"{value}. Check the uncertainties of the coefficients and of the "
                    "measurement"
                )

    @property
    def deciding(self) -> str | None:
        """Name of the part of the data that alone detects a difference; None if no part does."""
        excess = {words: part.score - part.threshold for words, part in self.parts.items()}
        most = max(excess, key=lambda words: excess[words], default="")
        return most if self.score <= self.threshold and excess.get(most, 0.0) > 0 else None

    @property
    def verdict(self) -> str | None:
        """Verdict if nothing is detected: "hint" for a score above 0, else "none"; or None."""
        if self.score > self.threshold or self.deciding is not None:
            return None
        return "hint" if max(self.score, self.noise or 0.0) > 0 else "none"
