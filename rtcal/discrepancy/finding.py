"""The result of a search: verdict, evidence and the effect that explains the data best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.discrepancy.case import AppliedEffect, Case
from rtcal.discrepancy.effects import Effect, library
from rtcal.discrepancy.evidence import UNKNOWN, ModelDiscrepancy
from rtcal.discrepancy.wording import NATS, amount, listed
from rtcal.errors import DataError
from rtcal.support import html, text
from rtcal.support.arguments import checked
from rtcal.support.types import Array

FEATURE_NAMES = ("T20", "EDT/T20", "T30/T20", "C80", "G")


@dataclass(frozen=True)
class Size:
    """Size of an effect: mean and 90 % interval, in ``unit``."""

    mean: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True, eq=False, repr=False)
class Finding:
    """What the data of a case say about its model.

    Attributes
    ----------
    case : Case
    verdict : {"none", "hint", "named", "ambiguous", "unknown"}
        ``named``: the best effect exceeds the threshold, and no other is within
        `rtcal.discrepancy.search.CANDIDATE_NATS` of it. ``ambiguous``: others are (``candidates``).
        ``unknown``: the model lacks something that no effect of the library explains. ``hint``: the
        evidence does not exceed the threshold, but exceeds half of it and 0.5 nats.
    effect : str or None
        The best supported effect, unless the verdict is "none".
    candidates : tuple of str
        Effects within `rtcal.discrepancy.search.CANDIDATE_NATS` of the best, the best first.
    evidence : mapping of str to float
        Log evidence over "none" in nats, by effect and for "unknown".
    score, threshold : float
        The best effect's evidence and the threshold that it must exceed, in nats.
    engines : tuple of str
        The simulators of the control rooms, from which threshold and discrepancy were estimated.
    parameters : mapping of str to float
        The best effect's parameters.
    size : Size or None
        The best effect's size, where it has one.
    runner_up : str
        The second best.
    advice : str
        The next measurement that would decide.
    residuals : array (n_configurations, n_features, n_bands)
        Measured less modelled over its standard deviation: amount (ln T20), shape (EDT/T20,
        T30/T20), level (C80, G). NaN where nothing was measured.
    notes : tuple of str
        Data that were dropped, and reasons to doubt the result.
    discrepancy : ModelDiscrepancy
        Bias and covariance of the model's error.
    effects : mapping of str to Effect
        The effects that were tried, by name.
    """

    case: Case
    verdict: str
    effect: str | None
    candidates: tuple[str, ...]
    evidence: Mapping[str, float]
    score: float
    threshold: float
    engines: tuple[str, ...]
    parameters: Mapping[str, float]
    size: Size | None
    runner_up: str
    advice: str
    residuals: Array
    notes: tuple[str, ...]
    discrepancy: ModelDiscrepancy
    effects: Mapping[str, Effect]

    @checked
    def apply(self, case: Case | None = None) -> Case:
        """Return the case with the named effect in its model.

        An ambiguous finding adds its best candidate. A case that has the effect already is returned
        as it is.

        Raises
        ------
        DataError
            If the verdict names no effect ("none", "hint", "unknown").
        """
        case = self.case if case is None else case
        if self.verdict in ("none", "hint") or self.effect in (None, UNKNOWN):
            raise DataError(f'the verdict is "{self.verdict}"; there is no named effect to add')
        if any(a.name == self.effect for a in case.applied):
            return case
        ends = None if self.size is None else (self.size.low, self.size.high)
        effect = self.effects[str(self.effect)]
        custom = None if effect in library() else effect
        added = AppliedEffect(str(self.effect), dict(self.parameters), ends, custom)
        return replace(case, applied=(*case.applied, added))

    @property
    def title(self) -> str:
        """The best effect as a sentence names it."""
        effect = self.effects.get(str(self.effect))
        if effect is None:
            return str(self.effect)
        return effect.title(self.parameters, self.case.room)

    @property
    def rivals(self) -> list[str]:
        """The candidates other than the best."""
        return [name for name in self.candidates if name != self.effect]

    @property
    def support(self) -> str:
        """Verdict, the best effect's evidence and the next best effects, in words."""
        best = f"{self.verdict}: {self.title} {self.score:+.1f} nats"
        if self.rivals:
            others = ", ".join(f"{r} {self.evidence[r]:+.1f}" for r in self.rivals)
            return f"{best}; {others}, not told apart"
        return f"{best}; next {self.second_best}"

    @property
    def second_best(self) -> str:
        """The runner-up with its evidence."""
        return f"{self.runner_up} {self.evidence.get(self.runner_up, 0.0):+.1f}"

    @property
    def reason_for_none(self) -> str | None:
        """Why there is no effect to add, in words; None where there is one."""
        return {
            "none": "Nothing to add: prior, measurement and model agree (verdict none).",
            "hint": f"Nothing to add: a hint of {self.effect} only, {self.score:.1f} nats of the "
            f"{self.threshold:.1f} that it must exceed (verdict hint).",
            "unknown": "Nothing to add: something is missing that no effect of the library explains "
            "(verdict unknown).",
        }.get(self.verdict)

    @property
    def added(self) -> str:
        """What `apply` adds, and what explains the data nearly as well, in words."""
        if not self.rivals:
            return f"Added {self.title} ({self.support})."
        behind = [
            f"{r} is only {self.score - self.evidence[r]:.1f} nats behind" for r in self.rivals
        ]
        return f"Added {self.title}. Ambiguous: it is the best, but {listed(behind)} ({NATS})."

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        size, effect = self.size, self.effects.get(str(self.effect))
        return {
            "verdict": self.verdict,
            "effect": self.effect,
            "candidates": list(self.candidates),
            "evidence": dict(self.evidence),
            "score": self.score,
            "threshold": self.threshold,
            "engines": list(self.engines),
            "parameters": dict(self.parameters),
            "material": effect and effect.material(self.parameters, self.case.room),
            "size": None
            if size is None
            else {"mean": size.mean, "low": size.low, "high": size.high, "unit": size.unit},
            "runner_up": self.runner_up,
            "advice": self.advice,
            "notes": list(self.notes),
            "residuals": [
                {
                    "configuration": c.name,
                    "feature": FEATURE_NAMES[f],
                    "values": [None if np.isnan(v) else round(float(v), 2) for v in row],
                }
                for c, table in zip(self.case.configurations, self.residuals, strict=True)
                for f, row in enumerate(table)
                if np.isfinite(row).any()
            ],
        }

    def __repr__(self) -> str:
        """Return one line: verdict, candidates, evidence and threshold."""
        names = text.shortened(", ".join(self.candidates)) or "no effect"
        return (
            f"<Finding {self.verdict}: {names}; {self.score:+.1f} nats, threshold "
            f"{self.threshold:.1f}>"
        )

    def _repr_html_(self) -> str:
        """Return the evidence as a table, candidates and threshold in words."""
        rows = [
            [name, f"{nats:+.1f}", "candidate" if name in self.candidates else ""]
            for name, nats in self.evidence.items()
        ]
        return html.table(
            f"{self.headline}; threshold {self.threshold:.1f} nats",
            ["effect", "evidence / nats", ""],
            rows,
            [*filter(None, [self.size_in_words]), f"Next: {self.advice}", *self.notes],
        )

    def __str__(self) -> str:
        """Return verdict, size, evidence, residuals, advice and notes."""
        sentences = [*filter(None, [self.size_in_words]), self.evidence_in_words]
        lines = text.wrapped(self.headline)
        for sentence in sentences:
            lines += text.wrapped(sentence, indent="  ")
        header = ("", [bands.label(f) for f in self.case.room.centre_frequencies])
        for c, residuals in zip(self.case.configurations, self.residuals, strict=True):
            lines += text.wrapped(
                f'residuals of "{c.name}", in standard deviations (measured - model):', indent="  "
            )
            rows = [
                (f"    {name}", ["-" if np.isnan(v) else f"{v:+.1f}" for v in row])
                for name, row in zip(FEATURE_NAMES, residuals, strict=True)
                if np.isfinite(row).any()
            ]
            lines += text.table(rows, header=header)
        for sentence in (f"next: {self.advice}", *(f"note: {n}" for n in self.notes)):
            lines += text.wrapped(sentence, indent="  ")
        return "\n".join(lines)

    @property
    def evidence_in_words(self) -> str:
        """The best effect's evidence, the threshold, and the second best effect."""
        return (
            f"evidence {self.score:+.1f} nats ({NATS}); threshold {self.threshold:.1f}, "
            f"bootstrapped on {' and '.join(self.engines) or 'no engine'}; "
            f"runner-up {self.second_best}"
        )

    @property
    def headline(self) -> str:
        """The verdict and its `sentence`."""
        return f"{self.verdict}: {self.sentence}"

    @property
    def sentence(self) -> str:
        """What the verdict says of the model."""
        return {
            "none": "No disagreement beyond what prior, measurement and model error allow.",
            "hint": f"A hint of {self.title}, under the threshold.",
            "named": f"{self.kind}: {self.title}.",
            "ambiguous": f"{self.kind}: one of {', '.join([self.title, *self.rivals])}.",
            "unknown": "Something is missing that no effect of the library explains.",
        }[self.verdict]

    @property
    def kind(self) -> str:
        """Whether the candidates contradict what is stated, or add to it, or either."""
        contradicting = {
            name in self.effects and self.effects[name].contradicts(self.case.room)
            for name in self.candidates
        }
        if contradicting == {True}:
            return "Not as stated"
        if contradicting == {False}:
            return "Missing from the model"
        return "Missing from the model, or not as stated"

    @property
    def size_in_words(self) -> str:
        """The best effect's size with its interval, and its other parameters; "" without any."""
        if not self.parameters:
            return ""
        effect = self.effects[str(self.effect)]
        if self.size is None or self.verdict not in ("named", "ambiguous"):
            return effect.describe(self.parameters)
        s = self.size
        others = effect.describe(self.parameters, without=effect.size)
        return (
            f"size of {self.title}: {amount(s.mean, s.unit)} (mean; 90 %: {s.low:.3g} to {s.high:.3g})"
            + (f"; {others}" if others else "")
        )
