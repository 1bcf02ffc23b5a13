"""A finding in a client's words: headline, what it rests on, what to do."""

from __future__ import annotations

import numpy as np

from rtcal.finder.claim import CLAIMED, SAID
from rtcal.finder.means.bootstrap import QUANTILE
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.verdict import TWO
from rtcal.finder.means.verification import MeansVerification
from rtcal.finder.wording import as_sentence, listed
from rtcal.report.evidence_words import odds

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
        "hint": "The model may lack something, but the measurements do not establish it.",
        "named": finding.sentence,
        "family": f"{lacks} {which}",
        "ambiguous": f"The model lacks something. {several}",
        "unknown": "The model lacks something, and no known effect explains it.",
    }[finding.verdict]


def _headline_of_set(finding: MeansFinding) -> str:
    """Return what is claimed, or likely, of two or more effects."""
    if finding.verdict == "ambiguous":
        return (
            "The model lacks something, and the measurements do not tell what: "
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
    return [as_sentence(words) for c in finding.candidates if (words := finding.size_of(c))] + [
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
    if verification is not None:
        sentences.append(_proof(verification))
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
    if verification is not None:
        steps.append(
            {
                "supported": "Use the corrected calibration below for T and level, not the plain one. "
                "Do not quote its coefficients before the effect is confirmed.",
                "unproven": "Do this before the corrected calibration is used: the measurements do "
                "not tell the effect from coefficients other than the stated ones.",
                "withdrawn": "Use neither calibration: with the effect in the model the measurements "
                "fit worse.",
            }[verification.verdict]
        )
    elif finding.can_be_added:
        steps += [
            "Ask what to measure next with rtcal plan --next: it goes on from these sets.",
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
        f"The odds that something is missing are {odds(finding.score)} from the measurement alone. The "
        f"threshold is {odds(finding.threshold)}: at most {often} of simulated rooms that lack nothing "
        "exceed it."
    )


def _proof(verification: MeansVerification) -> str:
    """Return what became of the gaps that no choice of coefficients can close."""
    name, before, after = verification.finding.title, verification.before, verification.after
    if np.isnan(before):
        return (
            f"Nothing but T was measured, which other coefficients than the stated ones give without "
            f"{name}, too. The finding rests on the stated ones."
        )
    gap = (
        "Coefficients can hardly change the decay's shape, the level, and T of a second configuration. "
        f"There the mean gap goes from {before:.2f} to {after:.2f} JND with {name} in the model"
    )
    return {
        "supported": f"{gap}, which supports the finding.",
        "unproven": f"{gap}, which neither supports nor refutes the finding. It rests on T and on the "
        "stated coefficients.",
        "withdrawn": f"{gap}, which speaks against the finding.",
    }[verification.verdict]


def _candidates(finding: MeansFinding) -> str:
    names = [f"{finding.title_of(c)} ({finding.percent(c)})" for c in finding.candidates]
    return listed(names, last="or")
