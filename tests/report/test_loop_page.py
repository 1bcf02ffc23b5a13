"""The page of a closed loop says what the terminal says."""

import re

import numpy as np

import rtcal as rt
from rtcal.report import pages


def test_a_loops_page(loop, tmp_path):
    path = tmp_path / "loop.json"
    loop.save(str(path))
    text = pages.page_of(path)
    assert f"After {len(loop.steps)} simulations" in text
    assert "to no other" in text
    assert len(re.findall(r"<td[^>]*>converged</td>", text)) == 6
    assert f"{loop.steps[0].simulated[0]:.3f}" in text


def test_a_loop_results_page(loop_result, tmp_path):
    path = loop_result.save(tmp_path)
    text = pages.page_of(path)
    assert text == pages.page_of(tmp_path) == pages.page(loop_result)
    assert "valid only for Kuttruff&#39;s equation for BRAS CR2, seminar room" in text
    after = loop_result.after.mean("t20")
    row = re.search(r"simulated / s</th>(.*?)</tr>", text, re.S)[1]
    simulated = re.findall(r">([\d.]+)</td>", row)
    assert [float(v) for v in simulated] == np.round(after, 3).tolist()
    assert "the simulated T deviates from the measured T by up to 0.0 JND" in text
    assert len(rt.load(path).steps) == loop_result.simulations
