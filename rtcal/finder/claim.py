"""Probabilities and sizes of what explains the data, and what is claimed of it.

Of all observation models; words are made of them in `rtcal.report.finding_words` alone.
`rtcal.finder.records` has how often such claims were right.
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
from rtcal.finder.effects import AppliedEffect, CoupledRoom, Effect
from rtcal.finder.evidence import COEFFICIENTS, NONE, UNKNOWN, OffTogether, Prior
from rtcal.support.errors import ModelError
from rtcal.support.types import Array

Key = TypeVar("Key")
CLAIMED = 0.9
"""Probability from which an effect, a family or a surface is claimed."""
SAID = 0.03
"""Probability below which an effect is not printed."""
CREDIBLE = 0.9
"""Probability, given that something is missing, that the candidates hold together."""
LIKELY = 0.7
"""Probability that the likely surfaces hold."""
MOST = 0.5
"""Probability, or share of one, from which something holds most."""
DISTINCT_NATS = 2.3
"""Evidence in nats from which two effects, or two surfaces, are distinguished: odds of ten to one."""
_ABSORPTION = "added absorption"
_ALIKE = 1.25
"""Ratio of both ends of the line through the bands, below which these are alike."""


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
    return with_added(summed((family_of(name, effects), p) for name, p in probabilities.items()))


def with_added(families: Mapping[str, float]) -> dict[str, float]:
    """Return the families with the sum of all added absorption, the most probable first."""
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
    """Return probabilities in their order."""
    return dict(sorted(values.items(), key=lambda kv: -kv[1]))


def family_of(name: str, effects: Mapping[str, Effect]) -> str:
    """Return the family of an effect, or of "none", "coefficients" or "unknown"."""
    return name if name in (NONE, COEFFICIENTS, UNKNOWN) else effects[name].family


def wide(family: str) -> str:
    """Return the family of a kind: "added absorption" of "added absorption, rising"."""
    return family.split(",")[0]


Names = tuple[str, ...]
"""A set of effects or of families."""


def families_of(names: Names, effects: Mapping[str, Effect]) -> Names:
    """Return the families of a set, sorted; every family of "added absorption" is one."""
    return tuple(sorted(wide(family_of(name, effects)) for name in names))


def numbers_of(sets: Mapping[Names, float]) -> tuple[float, ...]:
    """Return the probabilities of 0, 1, 2, ... effects."""
    by_number = summed((len(names), p) for names, p in sets.items())
    return tuple(by_number.get(n, 0.0) for n in range(1 + max(by_number, default=0)))


def narrowest_family(families: Mapping[str, float], least: float) -> str | None:
    """Return the family of at least this probability, the narrower of two; None without one.

    A comma leads from a family to one of its kinds: "added absorption, rising".
    """
    probable = [f for f, p in families.items() if p >= least and f != NONE]
    return max(probable, key=lambda family: family.count(",")) if probable else None


@dataclass(frozen=True)
class Reason:
    """Why something is identified or not, what to do, or what to know: a code with its values.

    ``values`` are numbers, names and sizes. `rtcal.report.finding_words` has a sentence for each code,
    which ``str`` returns.
    """

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        # `report` stands above this package, so its words are looked up when they are printed.
        words: str = import_module(WORDS).sentence(self)
        return words

    def to_dict(self) -> dict[str, Any]:
        """Return code, values and sentence for JSON."""
        return {"code": self.code, "values": json_numbers(self.values), "text": str(self)}


WORDS = "rtcal.report.finding_words"
"""The module that makes the words of a finding."""
LEADING, MISTAKE = "T far off, effect stands", "T far off"
"""Codes of the reasons that T is about twice or half the model's; the first stands before a claim."""
EQUATION_OFF = "equation off"
"""Code of the reason that the equation's T is not that of a program's run."""
OWN_FIELD = "field of the program"
"""Code of the reason that what differs may be the field of a geometrical program."""
LEAVES: Mapping[str, str] = {
    **dict.fromkeys(("size unbounded", "too large", "not explained", "gap may grow"), "family"),
    LEADING: "family",
    **dict.fromkeys((MISTAKE, "gap grows", "contradicted", "below Schroeder"), "hint"),
    "not the climate alone": "ambiguous",
}
"""The verdict that a reason leaves of a claim. Doubts about the size, the fit or an input value leave
the family as probable as it is; doubts about the effect leave nothing of it identified."""
FAIR = 1 / 3
"""A fair part of the probability. Where nothing missing has it, as before the measurement
(`rtcal.finder.evidence.NO_EFFECT`), or no effect and no family does, the data do not suffice to call
something missing. Chosen on development rooms."""


@dataclass(frozen=True, kw_only=True)
class Claim:
    """What is identified: the fields of a `Finding` that `conclude` decides."""

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
    """Return what is identified from any kind of data.

    ``detected`` is the verdict where nothing is detected, "none" or "hint"; None where something is.
    The probabilities of each effect and family are the most probable first. Effects that are not
    identified by their own names (`Effect.alone`) are ``by_family_alone``. Of doubts about the most
    probable effect, ``reasons``, `LEAVES` has what they leave. Where data are ``weak`` (`too_weak`),
    nothing but a name or a family is more than a hint. Where that is the field of a program
    (`of_program`), nothing is, and a field that is likelier than all else is said in any case.
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
    """Return why nothing is said to be missing although the score exceeds its threshold, or None."""
    nothing = probabilities.get(NONE, 0.0)
    if nothing >= FAIR:
        return Reason("nothing likely", {"probability": nothing})
    every = [p for table in (probabilities, families) for k, p in table.items() if k != NONE]
    return Reason("no effect likely", {"least": FAIR}) if max(every, default=0.0) < FAIR else None


FIELD = "field"
"""The family of effects that a geometrical program has by itself, if it scatters as the room does."""


def of_program(families: Mapping[str, float]) -> Reason | None:
    """Return why nothing is said of a room where a geometrical program's field may be what differs.

    A program scatters as it is told, and a second room is in it if it was drawn. So its own field is
    no error of the room, and counts as nothing missing.

    Examples
    --------
    >>> of_program({"none": 0.2, "field": 0.7}).code
    'field of the program'
    >>> of_program({"none": 0.05, "field": 0.04, "added absorption": 0.9})
    """
    own = families.get(FIELD, 0.0)
    if own + families.get(NONE, 0.0) < FAIR or own < SAID:
        return None
    return Reason(OWN_FIELD, {"probability": own})


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


End = Literal["", "least", "most"]
"""At which end of what is tried the data allow any size."""


def amount(value: float, unit: str, interval: tuple[float, float] | None = None) -> str:
    """Return a size with its unit and its 90 % interval; a ratio as so many times.

    Examples
    --------
    >>> amount(2.0, "of the input area"), amount(12.3, "m²", (8.0, 17.0))
    ('2 times the input area', '12.3 m² (90 %: 8 to 17)')
    >>> amount(0.875, "of its area covered", (0.47, 1.0))
    '0.875 of its area covered (90 %: 0.47 to 1)'
    """
    times = unit.replace("of the input ", "times the input ")
    ends = "" if interval is None else f" (90 %: {interval[0]:.3g} to {interval[1]:.3g})"
    return f"{value:.3g} {times}{ends}"


@dataclass(frozen=True)
class Size:
    """Size of an effect: mean and 90 % interval, in ``unit``.

    ``end`` is "least" where the data allow any size above ``low``, "most" where they allow any below
    ``high``: the evidence does not fall within what is tried, and physics does not end there.
    """

    mean: float
    low: float
    high: float
    unit: str
    end: End = ""

    @property
    def words(self) -> str:
        """The size with its interval.

        Examples
        --------
        >>> Size(12.3, 8.0, 17.0, "m²").words
        '12.3 m² (90 %: 8 to 17)'
        >>> Size(61.0, 26.0, 109.0, "m²", "least").words
        'at least 26 m² (95 %)'
        """
        if self.end:
            value = self.low if self.end == "least" else self.high
            return f"at {self.end} {amount(value, self.unit)} (95 %)"
        return amount(self.mean, self.unit, (self.low, self.high))

    @property
    def fields(self) -> dict[str, Any]:
        """The fields of a `Candidate` of this size."""
        return {"size": self.mean, **{k: v for k, v in vars(self).items() if k != "mean"}}


Point = tuple[float, float, float]
LOCATED = 0.5
"""Share of a candidate's probability from which a part of its surface is where it stands."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """An effect that explains the data; at positions, in one place."""

    effect: str
    family: str
    probability: float
    surface: str | None = None
    """None for the whole room, the measurement, and of means over positions."""
    place: str = ""
    """The surface's name; of means a material in quotes, where the effect is about one; of the
    measurement's errors "receiver R1", "source S1" or "S1 to R1"; "" for the whole room."""
    size: float = math.nan
    low: float = math.nan
    high: float = math.nan
    """Posterior mean and 90 % interval, in ``unit``; NaN for coefficients off together and for
    "unknown"."""
    unit: str = ""
    end: End = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """The most probable ones."""
    spectrum: Array = field(default_factory=lambda: np.zeros(0))
    """Posterior mean alpha of what stands on the surface, (n_bands,)."""
    parts: tuple[tuple[Point, float], ...] = ()
    """Of a large surface: the middle (x, y, z) of each part in m, and the probability that it stands on
    this part alone. With the rest of its probability it is spread over the surface."""
    coefficients: OffTogether | None = None
    """Of means, coefficients that are off in common, where they are likely beside it."""
    absorption: Array | None = None
    """Of means, what an effect of absorption adds over the room's mean absorption, (3, n_bands): of the
    size's mean and of both ends of its interval."""

    @property
    def extent(self) -> Size | None:
        """The size with its interval; None where there is none."""
        if not np.isfinite(self.size):
            return None
        return Size(self.size, self.low, self.high, self.unit, self.end)

    def applied(self, effect: Effect) -> AppliedEffect:
        """Return the effect with its size and interval, to be put into a case."""
        ends = None if self.extent is None else (self.low, self.high)
        return AppliedEffect(effect, self.parameters, ends)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        left_out = ("coefficients", "absorption")
        return {k: json_numbers(v) for k, v in vars(self).items() if k not in left_out}

    @property
    def middle(self) -> Point | None:
        """Middle in m of the part that holds at least half of the probability; None without one."""
        middle, probability = max(self.parts, key=lambda part: part[1], default=(None, 0.0))
        return middle if probability >= LOCATED * self.probability else None

    @property
    def title(self) -> str:
        """Effect and place, as a sentence names them."""
        return f"{self.effect} {self.where}".rstrip()

    @property
    def where(self) -> str:
        """The place of the candidate as a sentence has it; "" for the whole room."""
        if self.surface is not None:
            return f'on "{self.surface}"'
        return f"of {self.place}" if self.place else ""

    @property
    def kind(self) -> str:
        """The family; every family of added absorption is one."""
        return wide(self.family)

    @property
    def can_be_added(self) -> bool:
        """Whether the candidate stands on a surface, and a room of one geometry can have it."""
        return self.surface is not None and self.effect != CoupledRoom.name

    @property
    def in_words(self) -> str:
        """Size with its interval; "" where there is none."""
        return "" if self.extent is None else self.extent.words


@dataclass(frozen=True)
class Detection:
    """Evidence in nats that anything differs from the model.

    Raises ModelError for a score that is no finite number.
    """

    score: float
    threshold: float
    """ln Bayes factor that at most 5 % of simulated rooms with nothing missing exceed."""
    noise: float | None = None
    """Of positions, that a single pair is noisier than assumed and nothing else is other; None where
    that was not tried."""
    means: float | None = None
    """Of means over positions, where positions decide; None where they were not compared."""
    parts: Mapping[str, Detection] = field(default_factory=dict)
    """Of means over positions, the same from a part of the data, by what it is: what a part detects is
    detected. The score and threshold above are those of all data."""

    def __post_init__(self) -> None:
        for name in ("score", "noise", "means"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise ModelError(
                    f"the ln Bayes factor for a model other than the input ({name}) is {value}, "
                    "which is not finite: check the uncertainties of coefficients and measurement"
                )

    @property
    def deciding(self) -> str | None:
        """The part of the data that detects most where all data detect nothing; None without one."""
        excess = {words: part.score - part.threshold for words, part in self.parts.items()}
        most = max(excess, key=lambda words: excess[words], default="")
        return most if self.score <= self.threshold and excess.get(most, 0.0) > 0 else None

    @property
    def verdict(self) -> str | None:
        """The verdict where nothing is detected, "none" or "hint"; None where something is."""
        if self.score > self.threshold or self.deciding is not None:
            return None
        return "hint" if max(self.score, self.noise or 0.0) > 0 else "none"
