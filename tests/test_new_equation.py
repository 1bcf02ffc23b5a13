"""A new reverberation equation costs one file: calibration, cases, loops and commands ask it."""

import sys
import types
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.equations import EQUATIONS, LinearEquation, equation_keys, register
from rtcal.finder.means.problem import state
from rtcal.finder.means.recalibration import plain, recalibrate
from rtcal.finder.model import STEEPEST, sensitivities
from rtcal.loop.closed import Loop, start
from rtcal.simulators.external import of_equation
from rtcal.support.errors import DataError

ONE_FILE = '''
class Quadratic(LinearEquation):
    """a = mean alpha + mean alpha² / 2: Eyring's series to the second order."""

    name: ClassVar[str] = "Quadratic"
    key: ClassVar[str] = "quadratic"

    def exponent(self, mean):
        return mean + mean**2 / 2

    def inverse(self, exponent):
        return np.sqrt(1 + 2 * np.asarray(exponent)) - 1

    def slope(self, mean):
        return 1 + mean
'''


@pytest.fixture
def quadratic():
    module = types.ModuleType("quadratic_equation")
    vars(module).update(LinearEquation=LinearEquation, ClassVar=ClassVar, np=np)
    exec(ONE_FILE, vars(module))
    sys.modules[module.__name__] = module
    yield register(module.Quadratic)
    del EQUATIONS["quadratic"], sys.modules[module.__name__]


def test_each_equation_is_registered():
    assert set(EQUATIONS) == {"arau", "eyring", "fitzroy", "kuttruff", "millington", "sabine"}
    assert equation_keys(LinearEquation) == ("eyring", "kuttruff", "sabine")


def test_a_new_equation_calibrates(quadratic, cr2):
    room, measured = cr2
    result = rt.calibrate(room, measured, equation=quadratic())
    np.testing.assert_allclose(result.gap_after, 0, atol=1e-9)
    assert type(result.equation) is quadratic
    simulated = of_equation(quadratic(), room).simulate(result.alpha)
    np.testing.assert_allclose(simulated.mean("t20"), result.measured, rtol=1e-5)


def test_a_new_equation_is_a_case_s_model(quadratic):
    case, _ = rt.datasets.hidden_room()
    case = replace(case, equation="quadratic")
    made = state(case, case.configurations[0])
    expected = quadratic(case.room.speed_of_sound).reverberation_time(case.room)
    np.testing.assert_allclose(6 * np.log(10) / made.rate, expected, rtol=1e-12)
    step = np.zeros_like(made.alpha)
    step[1] = 1e-6
    numeric = (replace(made, alpha=made.alpha + step).rate - made.rate) / 1e-6
    np.testing.assert_allclose(sensitivities([made])[0, 1], numeric, rtol=1e-5)
    assert made.alpha.max() < STEEPEST
    room = recalibrate(case).room
    assert room.calibration.equation == "Quadratic"


def test_a_new_equation_is_kept_in_a_saved_loop(quadratic, cr2, tmp_path, monkeypatch):
    room, measured = cr2
    loop = start(room, measured, equation=quadratic())
    loop.save(str(tmp_path / "loop.json"))
    assert Loop.load(str(tmp_path / "loop.json")).equation == quadratic()
    monkeypatch.delitem(sys.modules, "quadratic_equation")
    with pytest.raises(DataError, match="import the module first if the class is your own"):
        Loop.load(str(tmp_path / "loop.json"))


@pytest.mark.parametrize("equation", ["sabine", "eyring", "kuttruff", "millington"])
def test_a_case_is_calibrated_with_its_own_equation(equation):
    """Kuttruff's was calibrated by one step of Eyring's, which missed T by 0.4 %."""
    case, _ = rt.datasets.hidden_room()
    case = replace(case, equation=equation)
    measured = case.configurations[0].measured.mean("t20")
    np.testing.assert_allclose(np.exp(plain(case).features[0, 0]), measured, rtol=1e-5)
