"""Tables with known content: units, statistics and protocols are read right, or refused by name."""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from benchmarks import drawn_tables
from rtcal.io import library, table_columns, tables
from rtcal.io.table_columns import statistic_of
from rtcal.support.errors import DataError
from tests.corpus import book

LEAST_READ = {"materials": 0.75, "values": 0.75, "modes": 0.6}
"""Share of the drawn tables that must be read; of modes many state no unit, which is refused."""


def outcomes(folder: Path, seeds: range) -> dict[str, Counter[str]]:
    found: dict[str, Counter[str]] = {kind: Counter() for kind in LEAST_READ}
    for seed in seeds:
        what, why = drawn_tables.judged(seed, folder)
        found[drawn_tables.example(seed).kind][what] += 1
        assert what in ("right", "right as proposed", "refused"), (seed, what, why)
    print({kind: dict(counts) for kind, counts in found.items()})
    return found


@pytest.mark.parametrize(
    "seeds", [range(7000, 7060), pytest.param(range(500), marks=pytest.mark.long)], ids=len
)
def test_a_drawn_table_is_read_with_its_true_values_or_refused_by_its_place(
    tmp_path: Path, seeds: range
) -> None:
    for kind, counts in outcomes(tmp_path, seeds).items():
        read = counts["right"] + counts["right as proposed"]
        assert read >= LEAST_READ[kind] * counts.total(), (kind, counts)


@pytest.mark.parametrize("kind", ["own unit", "statistic", "role"])
def test_a_fault_of_a_reader_would_be_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """The judge must see the values that a reader without one of its rules reads."""
    if kind == "own unit":
        monkeypatch.setattr(library, "_own_unit", lambda _: "")
    elif kind == "role":
        monkeypatch.setattr(library, "_role", lambda _: "")
    else:
        for module in (table_columns, tables):
            monkeypatch.setattr(module, "statistic_of", lambda _: None)
    found = Counter(drawn_tables.judged(seed, tmp_path)[0] for seed in range(7000, 7050))
    assert found["silent"] > 0


# -- material lists


def of_text(folder: Path, text: str) -> tuple[library.MaterialList, str]:
    (folder / "Sample 3.csv").write_text(text, encoding="utf-8")
    return library.read(folder / "Sample 3.csv"), str(folder / "Sample 3.csv")


DOWN = "250;{0};{1}\n500;{0};{1}\n1000;{0};{1}\n"


@pytest.mark.parametrize(
    "unit", ["m² per chair", "m²/Platz", "A_obj", "[m²]", "m2 je Sitz", "Sabin"]
)
@pytest.mark.parametrize("where", ["cell", "name"])
def test_areas_of_objects_are_no_coefficients(tmp_path: Path, unit: str, where: str) -> None:
    if where == "cell":
        text = f"product;unit;250;500;1000\nRug;-;0,2;0,2;0,2\nChair;{unit};0,6;0,7;0,8\n"
    else:
        named = f"Chair ({unit.strip('[]')})"
        text = f"product;250;500;1000\nRug;0,2;0,2;0,2\n{named};0,6;0,7;0,8\n"
    listed, path = of_text(tmp_path, text)
    rug, chair = listed.materials
    assert (rug.alpha, rug.doubt) == ((0.2,) * 3, "")
    with pytest.raises(DataError, match=r"Sample 3\.csv, line \d: Chair.* names absorption areas"):
        listed.room(name="x", areas={chair.name: 20.0}, volume=100.0)
    room = listed.room(name="x", areas={"Rug": 20.0}, volume=100.0)
    assert room.materials == ("Rug",)
    assert path in chair.doubt


PROTOCOL = [
    ["T1", 5, 5, 5],
    ["T2", 1.2, 1.1, 1.3],
    ["alpha_s", 0.3, 0.4, 0.5],
    ["U(k=2)", 0.1, 0.1, 0.1],
]


@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("xlsx", [False, True])
@pytest.mark.parametrize("order", [[0, 1, 2, 3], [2, 3, 0, 1]])
@pytest.mark.parametrize(
    "named", ["alpha_s", "αs", "Absorptionsgrad", "absorption coefficient αs [-]"]
)
def test_of_a_protocol_the_coefficients_are_read(
    tmp_path: Path, across: bool, xlsx: bool, order: list[int], named: str
) -> None:
    rows = [[named if c == "alpha_s" else c for c in PROTOCOL[i]] for i in order]
    rows = [["f" if not across else "quantity", 250, 500, 1000], *rows]
    cells = rows if across else [list(column) for column in zip(*rows, strict=True)]
    path = tmp_path / ("Rug 3.xlsx" if xlsx else "Rug 3.csv")
    text = "\n".join(";".join(map(str, row)) for row in cells)
    path.write_bytes(book({"Rug 3": cells}) if xlsx else text.encode())
    (rug,) = library.read(path).materials
    assert (rug.name, rug.alpha) == ("Rug 3", (0.3, 0.4, 0.5))
    assert all(
        f'"{name}"' in rug.source.partition("left out: ")[2] for name in ("T1", "T2", "U(k=2)")
    )


@pytest.mark.parametrize(
    "text", ["[", "(", "s ", "αs", "absorption ", "T - ", "U(k", "m² per ", "in "]
)
def test_long_cells_are_read_in_time(tmp_path: Path, text: str) -> None:
    """Patterns that try every part of a text are kept from long ones."""
    long = text * (20000 // len(text))
    start = time.process_time()
    for table in (
        f"f;{long};b\n" + DOWN.format(1, 1),
        f"{long}\nproduct;250;500;1000\n{long};1;1;1\n",
    ):
        with contextlib.suppress(DataError):
            of_text(tmp_path, table)
    assert time.process_time() - start < 1


# -- measured values

NAMES = (
    "Gesamt",
    "Mean (n=2)",
    "T20 mean",
    "Average of 6",
    "Moyenne",
    "Mittel (alle)",
    "promedio (6)",
)


def layouts(name: str) -> dict[str, list[list[object]]]:
    """T20 of 1 and 2 s at two receivers, with a statistic of 1.5 s."""
    return {
        "rows": [["receiver", "T20 500 Hz"], ["R2", 1], ["R3", 2], [name, 1.5]],
        "row first": [["receiver", "T20 500 Hz"], [name, 1.5], ["R2", 1], ["R3", 2]],
        "across": [["f", "R2", "R3", name], [500, 1, 2, 1.5]],
        "long": [
            ["receiver", "parameter", "f", "value"],
            *([r, "T20", 500, v] for r, v in (("R2", 1), ("R3", 2), (name, 1.5))),
        ],
        "source": [
            ["source", "receiver", "f", "T20"],
            ["S1", "R2", 500, 1],
            ["S1", "R3", 500, 2],
            [name, "", 500, 1.5],
        ],
    }


OPTIONS = {"across": {"parameter": "t20"}}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("layout", layouts(""))
@pytest.mark.parametrize("xlsx", [False, True])
def test_a_statistic_over_positions_is_no_position(name: str, layout: str, xlsx: bool) -> None:
    rows = layouts(name)[layout]
    text = "\n".join(";".join(map(str, row)) for row in rows)
    content, options = book({"x": rows}) if xlsx else text.encode(), OPTIONS.get(layout, {})
    table = tables.parse(content, **options)
    assert table.measurement.pairs == (("S1", "R2"), ("S1", "R3"))
    assert table.measurement.values["t20"][:, 0].tolist() == [1, 2]
    assert any("left out" in line and f'"{name}' in line for line in table.columns)


@pytest.mark.parametrize("name", ["Mean stalls", "Mittelwert 2", "MW 2", "Soll", "N"])
@pytest.mark.parametrize("layout", layouts(""))
def test_what_may_be_a_statistic_or_a_position_is_refused(name: str, layout: str) -> None:
    text = "\n".join(";".join(map(str, row)) for row in layouts(name)[layout])
    with pytest.raises(DataError, match=name):
        tables.parse(text.encode(), **OPTIONS.get(layout, {}))


@pytest.mark.parametrize("name", ["Mittelgang", "Maxsaal", "Parkett Mitte", "Totale Nord"])
def test_places_that_sound_like_statistics(name: str) -> None:
    assert statistic_of(name) is None
    text = "\n".join(";".join(map(str, row)) for row in layouts(name)["rows"])
    assert tables.parse(text.encode()).measurement.pairs[-1] == ("S1", name)


@pytest.mark.parametrize("name", ["Gesamt", "Mean (n=2)", "Mittelwert"])
def test_a_sheet_of_means_is_no_position(name: str) -> None:
    sheets = {n: [["f", "T20"], [500, v]] for n, v in (("S1R2", 1), ("S1R3", 2), (name, 1.5))}
    table = tables.parse(book(sheets))
    assert table.measurement.pairs == (("S1", "R2"), ("S1", "R3"))
    assert any(
        "beside single positions are left out" in line and name in line for line in table.columns
    )


# -- modes


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("f;T [ms];u_T [ms]", "33;830;41,5"),
        ("f [kHz];T;u_T", "0,033;0,83;0,0415"),
        ("Frequenz / kHz;Nachhallzeit / ms;u_T / %", "0,033;830;5"),
        ("f;T;u_T\nkHz;ms;%", "0,033;830;5"),
        ("Fréquence;TR;u_T\n[Hz];[s];[ms]", "33;0,83;41,5"),
    ],
)
@pytest.mark.parametrize("xlsx", [False, True])
def test_units_of_modes_that_are_stated(tmp_path: Path, header: str, row: str, xlsx: bool) -> None:
    path = tmp_path / ("modes.xlsx" if xlsx else "modes.csv")
    text = f"{header}\n{row}\n"
    cells = [[c.replace(",", ".") for c in line.split(";")] for line in text.splitlines()]
    path.write_bytes(book({"modes": cells}) if xlsx else text.encode())
    modes = rt.modes.read(path)
    np.testing.assert_allclose(modes.frequencies, 33)
    np.testing.assert_allclose(modes.decay_times, 0.83)
    np.testing.assert_allclose(modes.decay_uncertainty / modes.decays, 0.05)


def test_a_mean_of_modes_is_no_mode(tmp_path: Path) -> None:
    (tmp_path / "modes.csv").write_text("f;T;u_T\n33;0,8;0,04\n41;0,6;0,04\nMean (n=2);0,7;0,04\n")
    modes = rt.modes.read(tmp_path / "modes.csv")
    assert modes.frequencies.tolist() == [33, 41]
    assert any('line 4: "Mean (n=2)" is no mode' in note for note in modes.notes)
