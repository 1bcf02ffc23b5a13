"""The words and the page of a diagnosis: where, what, added, calibrated, and what is left."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics.marks import rms
from rtcal.finder.apply import ROOM
from rtcal.finder.diagnosis import Diagnosis
from rtcal.loop.positions import PositionsResult
from rtcal.report import finding_words as words
from rtcal.report import of_finding, verification_words
from rtcal.report.document import Code, Heading, Items, Page, Section, coefficients, page_files
from rtcal.support.blocks import Block, Note

_MET = 0.05
"""Root mean square of T's deviation over its uncertainty up to which a model has the measured T."""


def steps(result: Diagnosis) -> str:
    """Return the commands that the diagnosis stands for, a line each; of means `apply` calibrates."""
    found = shlex.join([*result.given, *result.options])
    said = [f"rtcal find {found} --out found"]
    if result.verification is not None:
        said.append("rtcal verify found")
    if result.corrected is not None:
        said.append("rtcal apply found --out corrected")
    if isinstance(result.calibrated, PositionsResult):
        room = result.given[0] if result.corrected is None else "corrected/room.toml"
        fitted = shlex.join([room, *result.given[1:], *result.options])
        said.append(f"rtcal fit {fitted} --out fitted")
    elif result.corrected is None and len(result.given) > 1:
        said.append(f"rtcal calibrate {shlex.join(result.given)} --out calibrated")
    return "\n".join(said)


def as_steps(result: Diagnosis) -> str:
    """Return the sentence before the commands: a fit draws other reference simulations than `find`."""
    if isinstance(result.calibrated, PositionsResult):
        return (
            "These commands do the same step by step; `rtcal fit` makes reference simulations of its "
            "own, so its result may differ:"
        )
    return "These commands give the same results step by step:"


def added(result: Diagnosis) -> str:
    """Return a sentence on the effect that was added to the model, or the reason why none was."""
    finding, corrected = result.finding, result.corrected
    if corrected is None:
        why = str(of_finding.chosen(finding, "DIAGNOSIS") or finding.refusal or "")
        if said := why.partition("Nothing to add: ")[2]:
            return f"Nothing is added to the model: {said}"
        return f"Nothing is added to the model. {why}".strip()
    if corrected.added is None:
        return words.added(finding, finding.members)
    what = f"{corrected.added.title}, {corrected.added.in_words}"
    return f'The corrected model contains {what}, as the material "{corrected.material}".'


def calibrated(result: Diagnosis) -> str:
    """Return deviations of the model from all measured values, before and after the calibration."""
    found, verified = result.calibrated, result.verification
    which = "model as given" if result.corrected is None else "corrected model"
    if isinstance(found, PositionsResult):
        before, after = rms(found.gap_before), rms(found.gap_after)
        scattering = ""
        if found.scattering is not None and found.start is not None:
            fitted, start = (
                " to ".join(dict.fromkeys([f"{s.min():.2f}", f"{s.max():.2f}"]))
                for s in (found.scattering.coefficients, found.start)
            )
            scattering = f", with scattering coefficients of {fitted} (before the fit: {start})"
        said = (
            f"At last, the {which} was fitted to all pairs{scattering}. At these pairs, the fit "
            f"reduced its deviation from {before:.1f} to {after:.1f} JND (root mean square)."
        )
        if result.corrected is not None and verified is not None and verified.misses:
            said += (
                " No pair was left out of the fit, so this does not show that the model is right."
            )
        return said
    if found.off < _MET:
        return f"Calibrated to T, the {which} reproduces the measured T."
    return (
        f"Calibrated to T, the {which} differs from the measured T by {found.off:.1f} "
        "times its uncertainty, root mean square."
    )


def shrunk(result: Diagnosis) -> str:
    """Return the mean deviation of the input model at the data that were not fitted."""
    verified = result.verification
    if verified is None or np.isnan(verified.before):
        return ""
    gap = verified.by_seed.mean(axis=1)[0]
    which = "as simulated" if verified.runs else "with its input coefficients"
    return (
        f"The mean deviation of the model {which}, without the effect, is {gap:.2f} JND at the data "
        "that were not fitted."
    )


def blocks(result: Diagnosis) -> list[Block]:
    """Return a diagnosis as blocks: the answer, deviations, the effect, candidates and commands."""
    finding, verified = result.finding, result.verification
    table, step = words.candidates(finding), words.first_step(finding, verified)
    said = [
        " ".join(words.headline(finding)),
        *(f"Caution: {caution}" for caution in words.cautions(finding)),
        "" if verified is None else verified.sentence,
        shrunk(result),
        added(result),
        calibrated(result),
        f"Next: {step}" if step else "",
    ]
    rests_on = [
        words.evidence(finding),
        words.track_record(finding),
        as_steps(result),
    ]
    return [
        *map(Note, filter(None, said)),
        *([] if table is None else [table]),
        *map(Note, filter(None, rests_on)),
        *(Note(line, "  ") for line in steps(result).splitlines()),
    ]


def page(result: Diagnosis) -> Page:
    """Return the page of a diagnosis: that of its finding, with the effect and the calibration."""
    found = result.calibrated
    more: list[Any] = [
        Section("The calibrated model", "calibrated", new_sheet=True),
        Items([*filter(None, (added(result), calibrated(result), shrunk(result)))]),
    ]
    if isinstance(found, PositionsResult):
        more.append(
            coefficients(
                "Absorption coefficients: input → calibrated, below it the 90 % interval",
                found.prior,
                found.alpha,
                found.interval,
            )
        )
    more += [
        Section("The same in single commands", "commands"),
        Note(as_steps(result), kind="keep"),
        Code(steps(result)),
    ]
    made = of_finding.page(result.finding, result.verification, more=more)
    return replace(made, subject="where simulation and measurement disagree, and why")


def contents(result: Diagnosis, folder: Path, heading: Heading | None = None) -> dict[Path, bytes]:
    """Return the content of each file of a diagnosis, by path: page, figures, numbers and room."""
    corrected = result.corrected
    if corrected is None:
        out = {folder / ROOM: result.room.to_text(folder).encode()}
    else:
        verified = result.verification
        caution = "" if verified is None else verification_words.misses(verified)
        out = replace(corrected, room=result.room, caution=caution).contents(folder)
    return out | page_files(page(result), result, folder, heading)
