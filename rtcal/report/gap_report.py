"""The page of a finding by means, and its figures."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.room import MAX_BYTES
from rtcal.calibration.methods import calibrate
from rtcal.finder.claim import CLAIMED, SAID
from rtcal.finder.means.evidence import QUANTILE
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.recalibration import recalibrate
from rtcal.finder.means.verdict import TWO
from rtcal.finder.means.verification import MeansVerification
from rtcal.report import gap_figures
from rtcal.report.document import Heading, data_of, in_odds, material_rows, odds
from rtcal.report.page import finding_page
from rtcal.support.errors import MissingAirWarning
from rtcal.support.text import as_sentence, listed

__all__ = ["figures", "page", "summary"]
__dir__ = __all__.copy


_FAMILIES = {
    "added absorption": "something that absorbs sound",
    "added absorption, flat": "something that absorbs sound alike at all frequencies",
    "added absorption, rising": "something that absorbs sound, more at high frequencies",
    "added absorption, low": "something that absorbs low frequencies",
    "less absorption": "a covered surface",
    "climate": "the air as it was",
    "field": "that sound does not spread evenly",
    "scale": "the right area, volume or equation",
    "measurement": "something of the measurement",
}


def headline(finding: MeansFinding) -> str:
    """Return the verdict as one sentence for a reader who is no acoustician."""
    if len(finding.members) > 1 and finding.detected:
        return _headline_of_set(finding)
    several = f"The measurements do not tell which of these it is: {_candidates(finding)}."
    which = (
        several if len(finding.candidates) > 1 else f"Most probably it is {_candidates(finding)}."
    )
    lacks = finding.amount or f"The model lacks {family(str(finding.family))}."
    return {
        "none": "Nothing shows that the model lacks anything.",
        "hint": "The model may lack something, but the measurements do not establish it"
        f"{finding.or_nothing}.",
        "named": finding.sentence,
        "family": f"{lacks} {which}",
        "ambiguous": f"The model lacks something{finding.or_nothing}. {several}",
        "unknown": f"The model lacks something, and no known effect explains it{finding.or_nothing}.",
    }[finding.verdict]


def _headline_of_set(finding: MeansFinding) -> str:
    """Return what is claimed, or likely, of two or more effects."""
    if finding.verdict == "ambiguous":
        return (
            f"The model lacks something{finding.or_nothing}, and the measurements do not tell what: "
            f"{finding.likely_in_words}."
        )
    claimed = finding.claimed_in_words(family)
    said = f"The model lacks {claimed}." if claimed else ""
    return f"{said} {finding.set_in_words}".strip()


def family(name: str) -> str:
    """Return a family of effects as a sentence names it."""
    return _FAMILIES.get(name, f"an effect of the family “{name}”")


def level(finding: MeansFinding) -> str:
    """Return the kind of the box around the headline: "agrees", "open" or "contradicts"."""
    return {"none": "agrees", "hint": "open"}.get(finding.verdict, "contradicts")


def sizes(finding: MeansFinding) -> list[str]:
    """Return the sizes of the candidates, and how the coefficients are off, a sentence each."""
    off = [finding.coefficients_in_words] if finding.coefficients is not None else []
    return [as_sentence(words) for c in finding.names if (words := finding.size_of(c))] + [
        as_sentence(words) for words in off
    ]


def plain_heading(finding: MeansFinding) -> str:
    """Return the title of the calibration without the effect."""
    usable = finding.verdict in ("none", "hint")
    return "The calibration" if usable else "The plain calibration: the model lacks something"


def rests_on(finding: MeansFinding, verification: MeansVerification | None) -> list[str]:
    """Return what the verdict rests on, a sentence each."""
    said = [f"{k} {finding.percent(k)}" for k, p in finding.probabilities.items() if p >= SAID]
    sentences = [evidence(finding)]
    if finding.engines:
        sentences.append(
            "These rooms, and how large a model's errors are, come from simulations with "
            f"{listed(finding.engines)}."
        )
    sentences += [as_sentence(reason) for reason in finding.reasons]
    sentences += finding.not_judged_in_words
    if verification is not None:
        sentences.append(verification.sentence)
    sentences += map(as_sentence, finding.sets_in_words)
    if finding.more_than_one:
        sentences.append(
            "An effect or a family is claimed if the probability that it is there is at least "
            f"{100 * CLAIMED:.0f} %, and if it passes the checks. More than one is claimed from "
            f"{100 * TWO:.0f} % for more than one effect."
        )
    return [*sentences, f"Probabilities: {', '.join(said)}.", *filter(None, [finding.track_record])]


def to_do(finding: MeansFinding, verification: MeansVerification | None) -> list[str]:
    """Return what to do, a sentence each: the next measurement, and which coefficients to use."""
    steps = [] if finding.verdict == "none" else [as_sentence(finding.advice)]
    if finding.undecided:
        steps.append(
            f"Put none of the effects into the model before one is confirmed. {finding.undecided}"
        )
    elif verification is not None:
        steps.append(
            {
                "supported": "Use the corrected calibration below for T and level, not the plain one. "
                "Do not quote its coefficients before the effect is confirmed.",
                "not tested": "Measure C80 or G, or a second configuration, before the corrected "
                "calibration is used: nothing was measured that the finding was not fitted to.",
                "unproven": "Do this before the corrected calibration is used: the measurements do "
                "not tell the effect from coefficients other than the stated ones.",
                "withdrawn": "Use neither calibration: with the effect in the model the measurements "
                "fit worse.",
            }[verification.verdict]
        )
        steps += filter(None, [verification.misses_in_words])
    elif finding.can_be_added:
        steps += [
            "Ask what to measure next with rtcal plan: of this finding it goes on from these sets.",
            "Do this before the corrected calibration is used. Nothing has verified the set.",
        ]
    else:
        steps.append(
            "Do not use the calibration below: its coefficients make up for what is missing."
            if finding.verdict == "unknown"
            else "The calibration below can be used, with the reservations that it states."
        )
    return steps


def evidence(finding: MeansFinding) -> str:
    """Return the evidence and its threshold in words."""
    often = f"{100 * (1 - QUANTILE):.0f} %"
    return (
        f"{in_odds(finding.deciding_in_words)}The odds that something is missing are "
        f"{odds(finding.score)} from the measurement alone. The "
        f"threshold is {odds(finding.threshold)}: at most {often} of simulated rooms that lack nothing "
        "exceed it."
    )


def _candidates(finding: MeansFinding) -> str:
    names = [f"{finding.title_of(c)} ({finding.percent(c)})" for c in finding.names]
    return listed(names, last="or")


@dataclass(frozen=True)
class Reproduction:
    """The data that reproduce a finding: shell command, the case's files, seed."""

    command: str
    files: Sequence[str]
    seed: int


def figures(
    finding: MeansFinding, verification: MeansVerification | None
) -> dict[str, tuple[Any, str]]:
    """Return the figures by name, each with its caption."""
    drawn = {
        "evidence": (
            gap_figures.evidence(finding),
            "Evidence of every effect over the model; a finding must exceed the threshold. "
            "An arrow marks a bar that is cut: its number is printed.",
        )
    }
    if finding.more_than_one:
        drawn["probabilities"] = (
            gap_figures.probabilities(finding),
            "Probability of each effect that it is there at all, alone or with others. "
            "They do not sum to 100 %.",
        )
    if verification is None:
        drawn["residuals"] = (
            gap_figures.residuals(finding),
            "Model less measured, in standard deviations.",
        )
        return drawn
    drawn |= {
        "residuals": (
            gap_figures.residuals(finding, verification),
            "Model less measured, in standard deviations: before and after.",
        ),
        "reverberation_time": (
            gap_figures.reverberation_time(verification),
            "T(f). Plain calibration meets T whatever is missing: that proves nothing.",
        ),
        "shifts": (
            gap_figures.shifts(verification),
            "How far the coefficients had to move, with and without the effect in the model, and "
            "their 90 % intervals: a plain calibration's count on a model that lacks nothing.",
        ),
    }
    if gap_figures.bends(verification):
        drawn["decay"] = (
            gap_figures.decay(verification),
            "The decay in the band whose shape differs most: alpha cannot bend it, the effect does.",
        )
    return drawn


def page(
    finding: MeansFinding,
    verified: MeansVerification | None,
    drawn: dict[str, tuple[Any, str]],
    reproduction: Reproduction | None = None,
    heading: Heading | None = None,
) -> str:
    """Return the page; ``drawn`` are its `figures`, ``reproduction`` is printed on it."""
    entries = summary(finding, verified)
    entries["reproduce"] = _reproduce(finding, reproduction)
    first = finding.case.configurations[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MissingAirWarning)  # among the finding's notes
        usual = calibrate(
            finding.case.room,
            first.measured,
            unreachable="nearest",
            equation=mean_equation(finding.case.equation).linear(),
        )
    return finding_page(usual, entries, drawn, heading=heading)


def summary(finding: MeansFinding, verification: MeansVerification | None) -> dict[str, Any]:
    """Return the finding as plain values for the page.

    ``headline`` and ``level``, ``sizes``, ``rests_on``, ``to_do`` and ``notes`` (sentences),
    ``effects`` (name, probability in %, evidence), ``sets`` (names, probability in %, where sets of two
    and more were compared), ``plain_heading`` and ``plain`` (title of the calibration without the
    effect), ``corrected`` (title, use, effects, materials with their cells), ``unknowable`` (a
    sentence).
    """
    first = finding.case.configurations[0].name
    decided = finding.can_be_added and not finding.undecided
    supported = verification is not None and verification.verdict == "supported"
    time = finding.case.configurations[0].measured.time_label
    plain = f'plain calibration to {time} of "{first}"'
    if supported:
        lacking = listed([finding.title, *finding.rivals], last="or")
        plain += f": not to be used, the model lacks something ({lacking})"
    return {
        "headline": headline(finding),
        "level": level(finding),
        "sizes": sizes(finding),
        "rests_on": rests_on(finding, verification),
        "to_do": to_do(finding, verification),
        "notes": list(finding.notes),
        "effects": [
            (name, 100 * probability, finding.evidence.get(name, 0.0))
            for name, probability in finding.probabilities.items()
        ],
        "sets": [(names, 100 * p) for names, p in finding.likely_sets.items()],
        "plain_heading": plain_heading(finding),
        "plain": plain,
        "corrected": _corrected(finding, verification) if decided else None,
        "unknowable": _unknowable(finding, supported) if decided else "",
    }


def _reproduce(finding: MeansFinding, reproduction: Reproduction | None) -> dict[str, Any] | None:
    """Return command, files, seed and engines; of a saved finding its case, and the command for it.

    None if the case is too large for a page.
    """
    if reproduction is None:
        case = finding.case.to_json().encode()
        return None if len(case) > MAX_BYTES else {"case": data_of(case)}
    return {
        "case": "",
        "command": reproduction.command,
        "files": list(reproduction.files),
        "seed": reproduction.seed,
        "engines": list(finding.engines),
    }


def _corrected(finding: MeansFinding, verification: MeansVerification | None) -> dict[str, Any]:
    """The coefficients with the effect or the set in the model, and the sizes."""
    room = finding.case.room
    names = [f'"{c.name}"' for c in finding.case.configurations]
    time = finding.case.configurations[0].measured.time_label
    if verification is None:
        corrected = recalibrate(finding.with_effects(), finding.discrepancy)
        use = "They are right if these are the right names."
    else:
        corrected = verification.corrected
        use = {
            "supported": "To be quoted once the effect is confirmed.",
            "not tested": "Nothing but the evidence supports them.",
            "unproven": "Nothing but the evidence supports them.",
            "withdrawn": "Not to be used: the finding is withdrawn.",
        }[verification.verdict]
        if verification.misses:
            use = "Not to be used: with them the model misses T."
    return {
        "title": f"with {finding.title} in the model, calibrated to {time} of {listed(names)}",
        "use": use,
        "effects": corrected.effects_in_words,
        "materials": material_rows(
            room.materials, room.areas, room.alpha, corrected.alpha, corrected.interval
        ),
    }


def _unknowable(finding: MeansFinding, supported: bool) -> str:
    """Return the sentence on what no calibration can show: whether the name is right."""
    others = finding.rivals
    next_to = (
        f"{listed(others)} would explain the data about as well"
        if others
        else f"the next best is {finding.second_best}"
    )
    shrinks = (
        " That the gap shrinks says that the model is better, not which effect is in the room."
        if supported
        else ""
    )
    if len(finding.members) > 1:
        return (
            "What cannot be known: whether these are the right names. Other effects of the same family "
            "explain the measurement about as well."
        )
    name = f"whether it is {finding.title}. The name may be wrong; {next_to}"
    return f"What cannot be known: {name}.{shrinks}"
