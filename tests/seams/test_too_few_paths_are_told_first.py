"""A law: too few paths are told before the reference simulations, and that more paths would help."""

import warnings

import pytest

import rtcal as rt
from rtcal.command.console import shown_warnings
from rtcal.loop import positions
from rtcal.support.errors import DataError, FewPathsWarning
from tests.conftest import in_hall

HALL = rt.datasets.halls.lecture_hall()


def tracer(n_paths):
    return in_hall(HALL, n_paths=n_paths, scattering=0.5)


@pytest.fixture
def measured(monkeypatch):
    """Return what was measured; reference simulations are not to begin."""

    def begun(*_, **__):
        raise AssertionError("the reference simulations have begun")

    heard = tracer(160).simulate(HALL.room.alpha * 1.1, seed=3)
    monkeypatch.setattr(positions, "simulated_controls", begun)
    return heard


def test_in_python(measured):
    with pytest.raises(DataError, match=r"paths per source are too few\. Take a larger n_paths"):
        rt.calibrate_positions(tracer(16), HALL.room, measured, match=("t20", "edt"), more_paths=1)
    with pytest.raises(AssertionError, match="have begun"):  # enough paths come to them
        rt.calibrate_positions(tracer(160), HALL.room, measured, match=("t20", "edt"))


def test_a_noise_that_hides_what_is_matched_is_said(measured):
    """Decays of 100 paths hold every parameter here, with a noise of nearly a JND."""
    said = r"100 paths .* are too few: T20 .* noise of (0\.[5-9]\d*|1\.\d) JND.* Use (\d+)00"
    with pytest.warns(FewPathsWarning, match=said) as told, pytest.raises(AssertionError):
        rt.calibrate_positions(tracer(100), HALL.room, measured, match=("t20",))
    enough = int(str(told[0].message).split()[-4])
    with warnings.catch_warnings(), pytest.raises(AssertionError, match="have begun"):
        warnings.simplefilter("error", FewPathsWarning)
        rt.calibrate_positions(tracer(2 * enough), HALL.room, measured, match=("t20",))


def test_commands_say_it_once(capsys):
    """A diagnosis fits several models, each of which warns; other warnings are all printed."""
    show = shown_warnings()
    for message in (FewPathsWarning("few: 100"), UserWarning("other"), FewPathsWarning("few: 120")):
        show(message, type(message), "file.py", 1)
    show(UserWarning("other"), UserWarning, "file.py", 1)
    assert capsys.readouterr().err.splitlines() == [
        "rtcal: few: 100",
        "rtcal: other",
        "rtcal: other",
    ]
