"""Results and their pages, made once per file."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.report import pages
from rtcal.simulators.external import of_equation
from tests.report.pages import evil_room

pytest.importorskip("matplotlib", reason="matplotlib is not installed (rtcal[report])")
pytest.importorskip("jinja2", reason="jinja2 is not installed (rtcal[report])")


@pytest.fixture(scope="module")
def result():
    return rt.calibrate(*rt.datasets.bras_cr2())


@pytest.fixture(scope="module")
def html(result):
    return pages.page(result)


@pytest.fixture(scope="module")
def evil():
    """A calibration whose names are markup; one band unmeasured, one out of reach."""
    return rt.calibrate(evil_room(), [100.0, np.nan, 0.4], unreachable="nearest")


@pytest.fixture(scope="module")
def evil_html(evil):
    return pages.page(evil)


@pytest.fixture(scope="module")
def loop_result():
    room, measured = rt.datasets.bras_cr2()
    simulator = of_equation(rt.Kuttruff(path_variance=0.9), room)
    return rt.calibrate_simulator(simulator, room, measured, rule="secant", tolerance=0.05)


@pytest.fixture(scope="module")
def loop(loop_result):
    return replace(loop_result, simulator="", before=None, after=None, returned=None)
