"""Wrong types into public functions: one typed error that names function, argument, value and rule."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics import decay, quality, trust
from rtcal.finder import Case, ChangedMaterial, Configuration, plan, recalibrate, simulator
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.types import Array

PACKAGE = Path(rt.__file__).parent


@checked
def failing(
    array: Array = np.zeros(1),  # noqa: B008
    number: float = 1,
    whole: int = 1,
    flag: bool = True,
    text: str = "",
    choice: Literal["a", "b"] = "a",
    numbers: Sequence[float] = (),
    names: Iterable[str] = (),
    table: Mapping[str, float] = {},
    point: tuple[float, float] = (0, 0),
    call: Callable[[], Any] = print,
    room: rt.Room | None = None,
) -> None:
    raise AttributeError("from inside")


WRONG = [
    ("array", None, "an array of real numbers"),
    ("array", "text", "an array of real numbers"),
    ("array", [[1.0], [1.0, 2.0]], "an array of real numbers"),
    ("array", np.array([None]), "an array of real numbers"),
    ("array", [1j], "an array of real numbers"),
    ("number", True, "a number"),
    ("number", "1", "a number"),
    ("whole", 1.5, "a whole number"),
    ("flag", 0, "true or false"),
    ("text", b"x", "a text"),
    ("choice", "c", "one of 'a', 'b'"),
    ("choice", [], "one of 'a', 'b'"),
    ("numbers", "12", "a list whose members are each a number"),
    ("numbers", [None], "a list whose members are each a number"),
    ("names", "abc", "a list whose members are each a text"),
    ("table", [], "a mapping whose values are each a number"),
    ("table", {"a": "b"}, "a mapping whose values are each a number"),
    ("point", (1, 2, 3), "a tuple of 2: a number, a number"),
    ("call", 3, "a function of 0 arguments"),
    ("room", "room", "a rtcal.Room or None"),
]


@pytest.mark.parametrize(("name", "value", "rule"), WRONG)
def test_the_wrong_argument_is_named(name: str, value: object, rule: str) -> None:
    with pytest.raises(DataError) as caught:
        failing(**{name: value})
    assert str(caught.value).startswith(f"test_arguments.failing: {name} = ")
    assert str(caught.value).endswith(f" is not {rule}")
    assert isinstance(caught.value.__cause__, AttributeError)


def test_right_arguments_leave_the_error_alone() -> None:
    for right in (
        {"array": [1, 2.5]},
        {"number": np.float64(2)},
        {"number": np.array(2.0)},
        {"whole": np.int64(3)},
        {"numbers": np.ones(3)},
        {"point": [1, 2]},
        {"room": None},
    ):
        with pytest.raises(AttributeError, match="from inside"):
            failing(**right)


def test_a_typed_error_from_inside_comes_first() -> None:
    @checked
    def precise(number: float) -> None:
        raise rt.errors.ModelError("more precise")

    with pytest.raises(rt.errors.ModelError, match="more precise"):
        precise("text")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "place"),
    [
        (lambda: rt.find(3), "case = 3 is not a rtcal.finder.Case"),
        (lambda: rt.finder.positions.find(3), "is not a rtcal.finder.positions.PositionsCase"),
        (lambda: rt.finder.corrected_room(3), "finder.corrected_room: case = 3"),
    ],
)
def test_a_place_is_the_name_that_a_user_calls(call: Callable[[], Any], place: str) -> None:
    with pytest.raises(rt.errors.DataError, match=place):
        call()


class _Room:
    """Not a rtcal.Room."""


CALLS: list[Callable[[Any], Any]] = [
    lambda wrong: rt.io.catt.write(wrong, "x.txt"),
    lambda wrong: rt.io.odeon.write(wrong, "x.txt"),
    lambda wrong: rt.io.bras.write(wrong, "x.txt"),
    lambda wrong: rt.io.tables.write(wrong, "x.csv"),
    lambda wrong: rt.io.obj.write(wrong, "x.obj"),
    lambda wrong: rt.io.catt.parse(wrong),
    lambda wrong: rt.io.odeon.parse(wrong),
    lambda wrong: rt.io.bras.parse(wrong),
    lambda wrong: rt.io.obj.parse(wrong),
    lambda wrong: rt.io.pyroomacoustics.parse(wrong),
    lambda wrong: Configuration(name="a", measured=wrong),
    lambda wrong: ChangedMaterial(wrong, wrong),
    lambda wrong: Case(room=wrong, configurations=[]),
    lambda wrong: recalibrate(wrong),
    lambda wrong: simulator(wrong),
    lambda wrong: plan(wrong),
    lambda wrong: rt.datasets.catalogue.material(wrong, [500]),
    lambda wrong: rt.Room.from_surfaces(
        name="r", volume=1, surfaces=wrong, materials=wrong, centre_frequencies=[500]
    ),
    lambda wrong: rt.report.figures.gap(wrong),
    lambda wrong: rt.report.page.calibration_page(wrong),
    lambda wrong: trust.explained(wrong),
    lambda wrong: quality.gap_jnd(wrong, [1.0]),
    lambda wrong: decay.decay_time([1.0, 0.5], 0.1, wrong),
]


@pytest.mark.parametrize("number", range(len(CALLS)))
@pytest.mark.parametrize(
    "wrong",
    [None, object(), 3, {"a": 1}, [object()], _Room()],
    ids=["None", "object", "number", "dict", "list", "_Room"],  # the same in each process
)
def test_public_functions_raise_typed_errors(
    number: int, wrong: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if number == 21 and wrong == 3:
        pytest.skip("a number is a model of one band")
    with pytest.raises(rt.errors.RtcalError):
        CALLS[number](wrong)
    assert list(tmp_path.iterdir()) == []


def test_the_decorator_stands_below_the_others() -> None:
    """Above @classmethod it would wrap no function."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names = [ast.unparse(d) for d in node.decorator_list]
                if "checked" in names:
                    assert names[-1] == "checked", f"{path}:{node.lineno}"


def test_what_tells_progress_has_one_name() -> None:
    """It was called report, beside the package's reports."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.arg):
                tells = "Progress" in ast.unparse(node)
                assert node.arg == "progress" if tells else node.arg != "report", (
                    f"{path}:{node.lineno}"
                )


@checked
def combined(first: Array, second: Array, weights: Sequence[float] | Array = (1.0,)) -> Array:
    return first @ second.T * np.asarray(weights)[0]


def test_a_number_a_list_nothing_and_shapes_that_do_not_fit_are_named() -> None:
    square = np.ones((2, 2))
    for wrong, reason in (
        (0.5, "second = 0.5 is a single number; an array is needed"),
        ([], "second is empty"),
        ([[1.0, 2.0]], r"second = \[\[1.0, 2.0\]\] is a list; an array is needed"),
        (np.ones((3, 3)), r"shapes that do not fit: first \(2, 2\), second \(3, 3\)"),
        (10**400, "second = .* is not an array of real numbers"),
    ):
        with pytest.raises(DataError, match=f"test_arguments.combined: {reason}"):
            combined(square, wrong)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="weights is empty"):
        combined(square, square, [])


def test_what_would_have_no_end_is_refused() -> None:
    hall = rt.datasets.halls.corridor()
    tracer = rt.simulators.PathTracing(
        geometry=hall.geometry,
        room=hall.room,
        sources=hall.sources,
        receivers=hall.receivers,
        n_paths=32,
    )
    with pytest.raises(DataError, match=r"seconds = 1e\+300 s is above 60 s"):
        tracer.traced(0, 1e300)
    with pytest.raises(DataError, match="seconds = 61 s is above 60 s"):
        tracer.energy(hall.room.alpha, 61)
    with pytest.raises(DataError, match="band = 99 is not from 0 to 6"):
        tracer.traced(99, 0.1)
    with pytest.raises(DataError, match="Observations: parameters = None is not a list"):
        rt.simulators.Observations(
            parameters=None, pairs=(), centre_frequencies=np.ones(1), values=np.ones(1)
        )
    with pytest.raises(DataError, match=r"by = .* is not .*material"):
        tracer.jacobian(hall.room.alpha, by=np.ones(3))
    for scores in (
        lambda n: rt.studies.analytic_scores([10, 20], 0.05, n),
        lambda n: rt.studies.run([10, 20], 0.05, n, 10).scores(),
    ):
        with pytest.raises(DataError, match=r"realisations = .* is above 2\*\*53"):
            scores(10**400)


def test_the_figures_and_names_of_places_are_checked() -> None:
    figures, room = rt.report.figures, rt.datasets.bras_cr2()[0]
    with pytest.raises(DataError, match="height = -1"):
        figures.new_figure(height=-1)
    with pytest.raises(DataError, match="text: a figure ends with"):
        figures.rendered(figures.new_figure()[0], "text")
    with pytest.raises(DataError, match="rendered: figure = None is not a Figure"):
        figures.rendered(None, "png")
    for shown in (rt.report.material_figures.intervals, rt.report.figures.gap):
        with pytest.raises(DataError, match="is not a"):
            shown("text")
    with pytest.raises(DataError, match="band = 99 is not from 0 to 5"):
        room.place("alpha", 0, 99)
    with pytest.raises(DataError, match="is none of rtcal's errors"):
        rt.errors.of_bands(None, [1])
    with pytest.raises(DataError, match="is not a list of whole numbers"):
        rt.errors.of_bands(rt.errors.ModelError("no T"), ["a"])
