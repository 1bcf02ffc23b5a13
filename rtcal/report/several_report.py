"""The page of a finding of several effects: the set first, each effect with its probability."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rtcal.finder.claim import CLAIMED, SAID, family_of
from rtcal.finder.means.recalibration import recalibrate
from rtcal.finder.means.several import TWO
from rtcal.finder.means.several_finding import SeveralFinding
from rtcal.finder.wording import as_sentence, listed
from rtcal.report import gap_figures, gap_words
from rtcal.report.document import material_rows
from rtcal.report.figures import BLACK, ORANGE, new_figure, shown
from rtcal.support.arguments import checked


@checked
def probabilities(finding: SeveralFinding) -> Any:
    """Return the figure of the probability of each effect that it is there at all."""
    names = [n for n, p in finding.probabilities.items() if p >= SAID]
    figure, axes = new_figure(6.0, 1.2 + 0.32 * max(len(names), 1))
    at = np.arange(len(names))[::-1]
    member = [n in finding.members for n in names]
    values = np.array([finding.probabilities[n] for n in names])
    axes.barh(
        at,
        100 * values,
        color=["#9DC6E0" if m else "0.85" for m in member],
        edgecolor=BLACK,
        hatch=["//" if m else "" for m in member],
    )
    for y, name, value in zip(at, names, values, strict=True):
        axes.text(100 * value, y, f" {finding.percent(name)}", va="center", fontsize=9)
    axes.axvline(100 * CLAIMED, color=ORANGE, linestyle="--", label="claimed from here on")
    axes.set_xlim(0, 115)
    axes.set_yticks(at, [shown(n) for n in names])
    axes.set_xlabel("Probability that it is there / %; hatched: the most probable set")
    axes.legend(loc="lower right")
    return figure


@checked
def figures(finding: SeveralFinding) -> dict[str, tuple[Any, str]]:
    """Return the figures by name, each with its caption."""
    return {
        "probabilities": (
            probabilities(finding),
            "Probability of each effect that it is there at all, alone or with others. "
            "They do not sum to 100 %.",
        ),
        "residuals": (
            gap_figures.residuals(finding.single),
            "Model as stated less measured, in standard deviations.",
        ),
    }


@checked
def summary(finding: SeveralFinding) -> dict[str, Any]:
    """Return the finding as plain values for the page, as `rtcal.report.gap_report.summary` does."""
    first = finding.case.configurations[0].name
    added = finding.can_be_added
    plain = f'plain calibration to T20 of "{first}"'
    if finding.verdict in ("named", "family"):
        plain += ": not to be used, the model lacks something"
    return {
        "headline": _headline(finding),
        "level": gap_words.level(finding.single),
        "sizes": [as_sentence(s) for name in finding.members for s in finding.in_words(name)],
        "rests_on": _rests_on(finding),
        "to_do": _to_do(finding),
        "notes": list(finding.notes),
        "effects": [
            (name, 100 * p, finding.single.evidence.get(name, 0.0))
            for name, p in finding.probabilities.items()
        ],
        "sets": [(" + ".join(s) or "none", 100 * p) for s, p in finding.sets.items() if p >= SAID],
        "plain_heading": gap_words.plain_heading(finding.single),
        "plain": plain,
        "corrected": _corrected(finding) if added else None,
        "unknowable": "What cannot be known: whether these are the right names. Other effects of the "
        "same family explain the measurement about as well."
        if added
        else "",
    }


def _headline(finding: SeveralFinding) -> str:
    """Return the verdict as one sentence for a reader who is no acoustician."""
    if finding.verdict in ("named", "family"):
        named = {family_of(n, finding.single.effects) for n in finding.named}
        families = [f for f in finding.named_families if f not in named]
        claimed = [f"{n} ({finding.percent(n)})" for n in finding.named]
        claimed += [f"{gap_words.family(f)} ({100 * finding.families[f]:.0f} %)" for f in families]
        sentences = [f"The model lacks {listed(claimed)}."] if claimed else []
        return " ".join([*sentences, finding.set_in_words]).strip()
    if finding.verdict == "ambiguous":
        return (
            "The model lacks something, and the measurements do not tell what: "
            f"{finding.likely_in_words}."
        )
    if finding.verdict == "unknown":
        return f"{finding.unknown_in_words.capitalize()}."
    return gap_words.headline(finding.single)


def _rests_on(finding: SeveralFinding) -> list[str]:
    """Return what the verdict rests on, a sentence each."""
    sentences = [
        gap_words.evidence(finding.single),
        as_sentence(finding.numbers_in_words),
        f"An effect or a family is claimed if the probability that it is there is at least "
        f"{100 * CLAIMED:.0f} %, and if it passes the checks of a single finding. More than one is "
        f"claimed from {100 * TWO:.0f} % for more than one effect.",
    ]
    if finding.coefficients is not None:
        words = finding.coefficients.words(finding.case.room.centre_frequencies)
        sentences.append(as_sentence(f"the coefficients are off together: {words}"))
    return sentences + finding.track_record


def _to_do(finding: SeveralFinding) -> list[str]:
    """Return what to do, a sentence each."""
    steps = [] if finding.verdict == "none" else [as_sentence(finding.single.advice)]
    if finding.can_be_added:
        return [
            *steps,
            "Ask what to measure next with rtcal plan --next: it goes on from these sets.",
            "Do this before the corrected calibration is used. Nothing has verified the set.",
        ]
    return [*steps, "The calibration below can be used, with the reservations that it states."]


def _corrected(finding: SeveralFinding) -> Mapping[str, Any]:
    """The coefficients with the most probable set in the model, and the sizes of its effects."""
    case = finding.apply()
    calibrated = recalibrate(case, finding.discrepancy)
    room = finding.case.room
    return {
        "title": f"with {listed(list(finding.members))} in the model",
        "use": "They are right if these are the right names.",
        "effects": calibrated.effects_in_words,
        "materials": material_rows(
            room.materials, room.areas, room.alpha, calibrated.alpha, calibrated.interval
        ),
    }
