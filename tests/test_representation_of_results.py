"""The display of a calibration: one line, the printed table, the notebook's table."""

from __future__ import annotations

import re

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.table import blocks_of
from rtcal.support import blocks


@pytest.fixture(scope="module")
def result() -> rt.calibration.CalibrationResult:
    return rt.calibrate(*rt.datasets.bras_cr2())


def test_every_object_of_a_calibration_shows_as_one_line(result) -> None:
    joint = result.joint
    problem = rt.Calibration(rt.terms.PriorDeviation()).build(result.prior)
    whitened = problem.whitened(result.measured)
    objects = [result, joint, joint.solution, result.raw, result.certificate, result.measured_data]
    objects += [joint.solution.model, joint.solution.model.data, joint.configurations, problem]
    objects += [problem._joint, whitened, whitened.matrices]
    for shown in objects:
        text = repr(shown)
        assert "\n" not in text
        assert len(text) < 160
        assert type(shown).__name__ in text


def test_line_tells_the_method_and_the_gaps(result) -> None:
    assert repr(result) == (
        '<CalibrationResult of "BRAS CR2, seminar room": method mle, Eyring\'s equation, largest gap '
        "15.6 JND before, 0.0 JND after>"
    )


def test_printed_table_comes_from_the_record_alone(result) -> None:
    record = result.to_dict()
    assert str(result) == "\n".join(blocks.lines(blocks_of(record)))
    record["measured"]["reverberation_time"][0] = None
    record["air"] = None
    record["matches_measured_time"] = False
    text = "\n".join(blocks.lines(blocks_of(record)))
    assert re.search(r"measured T / s +- +1\.720", text)
    assert "no air stated" in text
    assert "T30 NOT matched" in text
    assert "Nothing in this calibration asks for the measured T" in text


def test_signs_are_said_below_the_numbers(result) -> None:
    """A gap of +15.6 did not say whether the model or the measurement has the longer T."""
    assert (result.gap_before[0] > 0) == (result.reverberation_time_before[0] > result.measured[0])
    for said in (str(result), result._repr_html_()):
        assert "gap: T of the model less the measured T" in " ".join(said.split())
        assert "z: the absorption that T asks for less the stated" in " ".join(said.split())


def test_notebook_table_says_in_text_what_it_shades(result) -> None:
    page = result._repr_html_()
    assert page == blocks.notebook("", blocks_of(result.to_dict()))
    assert page.count("<tr>") == 4 + 9 + 3 * 5  # headers, quantities, materials in three tables
    assert 'background: rgba(230, 159, 0, 0.45)">+15.6</td>' in page  # the gap before at 125 Hz
    assert re.search(r"rgba\(230, 159, 0, 0.45\)\">\+3\.1</td>", page)  # concrete at 125 Hz
    assert page.count(">0.097</td>") == 1
    assert "p = 1.7e-05); at 125 and 4000 Hz the measurement asks" in page


def test_coefficients_at_a_bound_are_marked() -> None:
    room, measured = rt.datasets.bras_cr2()
    bounded = rt.Calibration(
        rt.terms.PriorDeviation(), [rt.terms.ExactMatch(), rt.terms.Bounds(0, 0.09)]
    )
    result = bounded.build(room).solve(measured)
    assert (result.active == 1).any()
    at_bound = np.argwhere(result.active == 1)[0]
    assert f"{result.alpha[tuple(at_bound)]:.3f}*" in str(result)
    assert f"{result.alpha[tuple(at_bound)]:.3f}*</td>" in result._repr_html_()
    assert (
        "There is no p-value for all bands together, because a coefficient stands at a bound"
        in " ".join(str(result).split())
    )
