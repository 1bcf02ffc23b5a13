"""The page of a calibration to room modes."""

from __future__ import annotations

import numpy as np

from rtcal.acoustics import bands
from rtcal.modes.calibrate import ModesResult
from rtcal.report import figures
from rtcal.report.document import Code, Page, Picture, Section, coefficients, summary, tables
from rtcal.report.of_calibration import SOLVED
from rtcal.support import __version__
from rtcal.support.blocks import Note, Row, Table


def page(result: ModesResult) -> Page:
    """Return the page of a calibration to room modes."""
    room, printed = result.prior, result.blocks()
    measured = np.isfinite(result.data.reverberation_time)
    carries = np.where(result.below, np.where(result.carried, "modes", "–"), "T")
    carried = Row("carried by", np.where(result.below | measured, carries, "–").tolist())
    picture = Picture(
        lambda: figures.decays_of_modes(result),
        "Decay time of each mode used: measured, with the input coefficients, and after the "
        "calibration.",
    )
    command = "rtcal.calibrate_modes(room, modes)"
    if measured.any():
        command = "rtcal calibrate room.toml t.csv --modes modes.csv --out calibrated"
    blocks = [
        *summary(printed, picture),
        Section("By band", "bands"),
        Table(
            bands.labels(room.centre_frequencies),
            [carried],
            "Modes of each band",
            note="Below the Schroeder frequency the sound field is not diffuse, so T is not used. "
            "Coefficients hold there where at least three modes lie in the band.",
        ),
        coefficients(
            "Absorption coefficients: input → calibrated, with the 90 % interval",
            room,
            result.alpha,
            result.interval,
            np.isin(result.alpha, (0.0, 1.0)),
        ),
        Section("Modes", "modes"),
        *tables(printed)[:1],
        Note(
            "The last column names the walls whose sigma moves the mode's decay most. In a box, "
            "opposite walls have the same effect on every mode: the decays determine what both absorb "
            "together, and the input coefficients share it between them."
        ),
        Section("Technical details", "details"),
        Note(
            "Each step is a convex problem. The largest error bound of the last one, computed from "
            f"its own numbers, is {result.certificate.worst:.1e}. {SOLVED}"
        ),
        Code(command),
        Note(f"rtcal {__version__}."),
    ]
    subject = "absorption coefficients that match room modes"
    return Page(room.name, room.author, subject, blocks)
