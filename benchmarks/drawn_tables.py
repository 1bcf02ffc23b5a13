"""500 tables whose content is known: each is read with the true values, or refused by its place.

    python -m benchmarks.drawn_tables [number]

Drawn are material lists, tables of measured values and tables of modes: in six languages, as text
with four separators and in a workbook; with bands across, bands down, positions across, one value per
row, one sheet per position, and as ISO 354's protocols. Units stand in a title, in headers, in a row of
units above or below them, in a column, in a cell or nowhere; numbers are fractions, percent or m² per
object, s or ms, Hz or kHz. Beside the values stand rows, columns and sheets of statistics, times and
uncertainties.
"""

from __future__ import annotations

import csv
import io
import re
import sys
import tempfile
import tomllib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl

from rtcal.acoustics.observables import SUMMARY
from rtcal.io import library, tables
from rtcal.modes import measured
from rtcal.modes.room_modes import DECAY
from rtcal.support.errors import DataError

Cells = list[list[Any]]
STEM = "Sample 7"
"""The file's name, which a product without one takes."""
DRAWN_FROM = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
LANGUAGES: dict[str, dict[str, list[str]]] = DRAWN_FROM["words"]
PRODUCTS, TITLES = DRAWN_FROM["products"], DRAWN_FROM["titles"]
PLACES = (
    "title", "header", "row below", "row above", "column", "cell", "name", "nowhere",
)  # fmt: skip
STYLES = (
    (";", ","), (";", "."), (",", "."), ("\t", ","), ("\t", "."), ("xlsx", "."), ("|", "."), (",", ","),
)  # fmt: skip
"""Separator and decimal mark; a text of two commas has quotes."""
THIRDS = (100, 125, 160, 200, 250, 315, 400, 500, 630, 800, 1000, 1250, 1600, 2000, 2500)
OCTAVES = (63, 125, 250, 500, 1000, 2000, 4000)


@dataclass
class Drawn:
    """A table as it is written, and what it means.

    ``truth`` is, of materials, the coefficients by product and band; of measured values the value by
    source, receiver, parameter and band; of modes the frequency in Hz, the decay and its uncertainty in
    1/s by number. ``objects`` are the products in m² per object, which no room may use.
    """

    kind: str
    name: str
    content: bytes
    truth: dict[Any, Any]
    what: str
    objects: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)


class _Draw:
    """Draws from a seed, in one language and one way to write tables."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([58, seed])
        self.language = str(self.rng.choice(list(LANGUAGES)))
        self.separator, self.mark = self.one(STYLES)

    def one(self, choices: Any) -> Any:
        return choices[int(self.rng.integers(len(choices)))]

    def word(self, key: str) -> str:
        return str(self.one(LANGUAGES[self.language][key]))

    def some(self, choices: Any, number: int) -> list[Any]:
        at = self.rng.permutation(len(choices))[:number]
        return [choices[int(i)] for i in at]

    def chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    def content(self, sheets: dict[str, Cells]) -> tuple[str, bytes]:
        """Return the file's ending and its bytes; text takes the first sheet."""
        if self.separator == "xlsx" or len(sheets) > 1:
            return ".xlsx", workbook(sheets)
        stream = io.StringIO()
        writer = csv.writer(stream, delimiter=self.separator, lineterminator="\r\n")
        for row in next(iter(sheets.values())):
            writer.writerow(["" if c is None else self.text(c) for c in row])
        encoding = self.one(["utf-8", "utf-8-sig", "utf-16"])
        return ".csv", stream.getvalue().encode(encoding)

    def text(self, cell: Any) -> str:
        return cell if isinstance(cell, str) else f"{cell:.12g}".replace(".", self.mark)

    def with_unit(self, header: str, unit: str) -> str:
        return header + str(self.one([" [{}]", " ({})", " in {}", " / {}"])).format(unit)


def workbook(sheets: dict[str, Cells]) -> bytes:
    """Return the bytes of a workbook; percent are cells of this format."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
        for cell in (c for row in sheet.iter_rows() for c in row):
            if isinstance(cell.value, str) and re.fullmatch(r"[\d.]+ %", cell.value):
                cell.value = round(float(cell.value[:-2]) / 100, 10)
                cell.number_format = "0%"
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def example(seed: int) -> Drawn:
    """Return the table of a seed."""
    return (_materials, _values, _modes)[seed % 3](_Draw(seed))


def _materials(draw: _Draw) -> Drawn:
    bands = list(draw.one([OCTAVES, THIRDS, OCTAVES[1:5]]))
    protocol = draw.chance(0.25)
    names = [STEM] if protocol else draw.some(PRODUCTS, int(draw.rng.integers(1, 5)))
    across = draw.chance(0.5)
    place = draw.one(PLACES)
    unit = draw.one(["%", "%", "-", ""]) if place != "nowhere" else draw.one(["", "", "% unstated"])
    if place == "column" and not across:
        place = "row below"
    small = unit == "%" and draw.chance(0.5)
    factor = 100 if unit.startswith("%") else 1
    spelt = (
        draw.one(["%", "%", *LANGUAGES[draw.language]["percent"]])
        if unit == "%"
        else unit.partition(" ")[0]
    )
    truth = {
        name: {f: float(draw.rng.integers(1, 2 if small else 96)) / 100 for f in bands}
        for name in names
    }
    if unit == "% unstated":
        for values in truth.values():
            values[bands[0]] = 0.5
    objects: list[str] = []
    if not protocol and len(names) > 1 and draw.chance(0.4):
        place = draw.one(
            ["column" if across else "row below", "name", "row below"[: 9 * (not across)] or "name"]
        )
        objects = [names[-1]]
    per_object = draw.word("per object")
    written: dict[str, list[Any]] = {
        name: [round(factor * a, 10) for a in truth[name].values()] for name in names
    }
    if place == "cell" and unit == "%":
        written = {n: [draw.text(v) + " %" for v in vs] for n, vs in written.items()}
    units = {n: per_object if n in objects else spelt for n in names}
    if unit == "% unstated":
        units = dict.fromkeys(names, "")
    labels = {n: n for n in names}
    if protocol:
        labels = {STEM: draw.word("alpha")}
    if place in ("name", "header") and (not across or place == "name"):
        labels = {
            n: draw.with_unit(text, units[n]) if units[n] else text for n, text in labels.items()
        }
        if not protocol:
            truth = {labels[n]: values for n, values in truth.items()}
            objects = [labels[n] for n in objects]
    extra: list[tuple[str, list[Any]]] = []
    if protocol:
        times = draw.one([["T1", "T2"], ["T1 [s]", "T2 [s]"], ["T20 (s)"], ["T1", "T2"]])
        extra = [(t, [round(float(draw.rng.uniform(0.4, 1.4)), 2) for _ in bands]) for t in times]
        if place == "row below" and across:
            place = "title"
    if draw.chance(0.7 if protocol else 0.3):
        extra.append((draw.word("uncertainty"), [0.05 for _ in bands]))
    if draw.chance(0.2):
        extra.append((draw.word("mean"), [0.2 for _ in bands]))
    titles: Cells = [[t] for t in draw.some(TITLES, int(draw.rng.integers(0, 3)))]
    if place == "title" and unit in ("%", "-"):
        titles.append([draw.with_unit(draw.word("title"), spelt)])
    columns = [(labels[n], units[n], written[n]) for n in names]
    before = draw.chance(0.5)
    stats = [(n, "" if place != "row below" else "-", v) for n, v in extra]
    columns = [*stats, *columns] if before and protocol else [*columns, *stats]
    if across:
        of_unit = place == "column"
        heads = [draw.one([f"{f}", f"{f} Hz", f]) for f in bands]
        if place == "header" and unit:
            heads = [f"{f} Hz [{spelt}]" for f in bands]
        rows: Cells = [[draw.word("product"), *([draw.word("unit")] if of_unit else []), *heads]]
        for label, own, values in columns:
            rows.append([label, *([own] if of_unit else []), *values])
        of_row = ["", *([""] if of_unit else []), *([spelt] * len(bands))]
    else:
        heads = [label for label, _, _ in columns]
        rows = [[draw.word("band"), *heads]]
        rows += [[f, *(values[i] for _, _, values in columns)] for i, f in enumerate(bands)]
        of_row = [draw.one(["Hz", "", "[Hz]"])]
        of_row += [
            (f"{draw.word('alpha')} ({own})" if draw.chance(0.3) and own == spelt and own else own)
            if label not in dict(extra)
            else "s"
            if label.startswith("T")
            else own
            for label, own, _ in columns
        ]
        if len(columns) == 1:  # of one column the name is the file's
            (only,) = truth.values()
            truth = {STEM: only}
            objects = [STEM] if objects else []
    if place in ("row below", "row above") and any(of_row[1:]):
        rows.insert(1 if place == "row below" else 0, of_row)
    ending, content = draw.content({STEM: [*titles, *rows]})
    layout = "across" if across else "down"
    layout += ", protocol" if protocol else ""
    what = f"{layout}, unit {unit or '(none)'} {place}, {[n for n, _ in extra]}"
    return Drawn("materials", STEM + ending, content, truth, what, tuple(objects))


def _values(draw: _Draw) -> Drawn:
    bands = list(OCTAVES[1 : int(draw.rng.integers(4, 7))])
    layout = draw.one(["long", "rows", "corner", "across", "sheets", "merged"])
    sources = ["S1", "S2"][: int(draw.rng.integers(1, 3))]
    receivers = [f"R{n}" for n in range(1, int(draw.rng.integers(3, 6)))]
    if layout in ("long", "rows") and draw.chance(0.3):
        receivers = ["Parkett Mitte", "Mittelgang", "row 5, left", "MW 1", "Maxsaal"][
            : len(receivers)
        ]
    pairs = [(s, r) for s in sources for r in receivers]
    if draw.chance(0.3):
        pairs = draw.some(pairs, max(2, len(pairs) - 1))
    truth = {
        (s, r, "t20", float(f)): round(float(draw.rng.uniform(0.5, 2.5)), 2)
        for s, r in pairs
        for f in bands
    }
    unit, place = draw.one(["s", "ms"]), draw.one(["header", "row below", "cell", "nowhere"])
    factor = 1000 if unit == "ms" else 1

    def written(value: float) -> Any:
        value = round(factor * value, 6)
        return f"{draw.text(value)} {unit}" if place == "cell" else value

    def name(word: str) -> str:
        return draw.with_unit(word, unit) if place == "header" else word

    def values_of(pair: tuple[str, str]) -> list[Any]:
        return [written(truth[(*pair, "t20", float(f))]) for f in bands]

    means = [
        written(round(float(np.mean([truth[(*p, "t20", float(f))] for p in pairs])), 3))
        for f in bands
    ]
    statistics = [draw.word("mean")] if draw.chance(0.8) else []
    if draw.chance(0.4):
        statistics.append(draw.word("other"))
    at_end, middle = draw.chance(0.6), draw.one([0, 0, 1])

    if draw.chance(0.05):  # which may be anything
        statistics.append(draw.one(["Mean stalls", "Soll", "N", "Mittelwert 2"]))

    def in_order(of_pairs: list[Any], of_statistics: list[Any]) -> list[Any]:
        at = len(of_pairs) if at_end else middle
        return [*of_pairs[:at], *of_statistics, *of_pairs[at:]]

    sheets: dict[str, Cells] = {}
    titles: Cells = [[draw.one(["Hall X", "ISO 3382-2"])]] if draw.chance(0.3) else []
    if layout in ("corner", "across", "merged") and place == "row below":
        place = "header"
    below = place == "row below"
    if layout == "long":
        head = [*(draw.word(w) for w in ("source", "receiver", "parameter")), "f"]
        head.append(name(draw.word("value")))
        where = draw.one([0, 1, 2])  # the column of the statistic's name: source, receiver, both
        rows = [
            [*pair, "T20", f, v]
            for pair in pairs
            for f, v in zip(bands, values_of(pair), strict=True)
        ]
        more = []
        for statistic in statistics:
            of = [(statistic, ""), ("", statistic), (statistic, statistic)][where]
            more += [[*of, "T20", f, v] for f, v in zip(bands, means, strict=True)]
        units = [["", "", "", "Hz", unit]]
        table = [head, *(units if below else []), *in_order(rows, more)]
    elif layout == "rows":
        head = [draw.word("source"), draw.word("receiver"), *(name(f"T20 {f} Hz") for f in bands)]
        rows = [[*pair, *values_of(pair)] for pair in pairs]
        more = [["" if draw.chance(0.5) else "S1", s, *means] for s in statistics]
        units = [["", "", *([unit] * len(bands))]]
        table = [head, *(units if below else []), *in_order(rows, more)]
    elif layout == "corner":
        head = [name("T20"), *(draw.one([f"{f} Hz", f"{f}"]) for f in bands)]
        rows = [["".join(pair), *values_of(pair)] for pair in pairs]
        table = [head, *in_order(rows, [[s, *means] for s in statistics])]
    elif layout == "across":
        one_source = len(sources) == 1 and draw.chance(0.5)
        heads = [r if one_source else s + r for s, r in pairs]
        columns = in_order([values_of(p) for p in pairs], [means] * len(statistics))
        table = [[name("T20"), *in_order(heads, statistics)]]
        table += [[f, *row] for f, row in zip(bands, zip(*columns, strict=True), strict=True)]
    elif layout == "sheets":
        of_sheets = {"".join(pair): values_of(pair) for pair in pairs}
        of_sheets |= dict.fromkeys((s.replace("/", " ")[:30] for s in statistics), means)
        for sheet, values in of_sheets.items():
            sheets[sheet] = [["Frequency [Hz]", name("T20")], *([["Hz", unit]] if below else [])]
            sheets[sheet] += [[f, v] for f, v in zip(bands, values, strict=True)]
    else:
        blocks = in_order([s + r for s, r in pairs], statistics)
        columns = in_order([values_of(p) for p in pairs], [means] * len(statistics))
        table = [["", *(c for b in blocks for c in (b, ""))]]
        table.append(["Frequency", *(c for _ in blocks for c in (name("T20"), name("EDT")))])
        table += [
            [f, *np.repeat(np.array(row, dtype=object), 2).tolist()]
            for f, row in zip(bands, zip(*columns, strict=True), strict=True)
        ]
        truth |= {(*key[:2], "edt", key[3]): value for key, value in list(truth.items())}
        titles = []
    ending, content = draw.content(sheets or {"Sheet": [*titles, *table]})
    what = f"{layout}, {unit} {place}, statistics {statistics}"
    return Drawn("values", "table" + ending, content, truth, what)


def _modes(draw: _Draw) -> Drawn:
    n = int(draw.rng.integers(2, 7))
    f = np.sort(draw.rng.choice(np.arange(200, 1200), n, replace=False)) / 10
    time = np.round(draw.rng.uniform(0.4, 3.5, n), 2)
    relative = np.round(draw.rng.uniform(0.02, 0.08, n), 3)
    units = {
        "f": draw.one(["Hz", "kHz"]),
        "T": draw.one(["s", "ms"]),
        "u_T": draw.one(["s", "ms", "%"]),
    }
    place = draw.one(["header", "header", "row below", "nowhere", "some"])
    scale = {"Hz": 1, "kHz": 1e-3, "s": 1, "ms": 1e3}
    u = relative * time
    columns = {
        "f": f * scale[units["f"]],
        "T": time * scale[units["T"]],
        "u_T": 100 * relative if units["u_T"] == "%" else u * scale[units["u_T"]],
    }
    words = {"f": draw.word("f"), "T": draw.word("T"), "u_T": "u_T"}
    named = {k: place == "header" or (place == "some" and draw.chance(0.5)) for k in columns}
    rows: Cells = [[draw.with_unit(words[k], units[k]) if named[k] else words[k] for k in columns]]
    if place == "row below":
        rows.append([units[k] for k in columns])
    rows += [[round(float(columns[k][i]), 9) for k in columns] for i in range(n)]
    if draw.chance(0.2):
        rows.append([draw.word("mean"), float(time.mean()), float(u.mean())])
    ending, content = draw.content({"modes": rows})
    truth = {i: (f[i], DECAY / time[i], DECAY * u[i] / time[i] ** 2) for i in range(n)}
    stated = place != "nowhere" or units == {"f": "Hz", "T": "s", "u_T": "s"}
    what = f"{units} {place}{'' if stated else ', not stated'}"
    return Drawn("modes", "modes" + ending, content, truth, what)


def filled_in(refusal: str) -> str:
    """Return the ``columns`` that a refusal proposes, with - for a column that is to be filled in."""
    proposed = re.search(r'columns="([^"]*)"', refusal)
    text = proposed[1].replace("[?]", "[-]") if proposed else ""
    return re.sub(r"(?<=[:;] )\?(?=;|$)", "-", text)


def judged(seed: int, folder: Path) -> tuple[str, str]:
    """Return what came of a table, and why.

    It is "right", "refused", "refused without a place", or "silent" for values that are not true. One
    that is refused with a proposal of its columns is read again with it: "right as proposed".
    """
    drawn = example(seed)
    path = folder / drawn.name
    path.write_bytes(drawn.content)
    judge = {"materials": _of_materials, "values": _of_values, "modes": _of_modes}[drawn.kind]
    right = "right"
    try:
        wrong = judge(path, drawn)
    except DataError as error:
        named = str(path) in str(error) or "line " in str(error)
        refused = ("refused" if named else "refused without a place"), f"{drawn.what}: {error}"
        filled = filled_in(str(error))
        if not filled:
            return refused
        drawn.options["columns"], right = filled, "right as proposed"
        try:
            wrong = judge(path, drawn)
        except DataError:
            return refused
    finally:
        path.unlink()
    return ("silent" if wrong else right), f"{drawn.what}: {wrong}"


def _differ(found: dict[Any, float], true: dict[Any, float]) -> str:
    """Return the first difference of values by key; empty without one."""
    for key in [*true, *found]:
        a, b = found.get(key), true.get(key)
        if a is None or b is None or abs(a - b) > 1e-9 * abs(b):
            return f"{key}: {a} read, {b} true"
    return ""


def _of_materials(path: Path, drawn: Drawn) -> str:
    listed = library.read(path, **drawn.options).materials
    found = {
        (m.name, f): a
        for m in listed
        if not m.doubt
        for f, a in zip(m.centre_frequencies, m.alpha, strict=True)
    }
    true = {
        (name, float(f)): min(a, 1.0)
        for name, values in drawn.truth.items()
        if name not in drawn.objects
        for f, a in values.items()
    }
    return _differ(found, true)


def _of_values(path: Path, drawn: Drawn) -> str:
    m = tables.read(path, **drawn.options).measurement
    found = {
        (*pair, parameter, float(f)): float(values[i, k])
        for parameter, values in m.values.items()
        for i, pair in enumerate(m.pairs)
        for k, f in enumerate(m.centre_frequencies)
        if np.isfinite(values[i, k])
    }
    return _differ(found, drawn.truth) if (SUMMARY, SUMMARY) not in m.pairs else "means alone"


def _of_modes(path: Path, drawn: Drawn) -> str:
    modes = measured.read(path)
    found = np.stack([modes.frequencies, modes.decays, modes.decay_uncertainty], axis=1)
    true = np.array([drawn.truth[i] for i in range(len(drawn.truth))])
    same = found.shape == true.shape and np.allclose(found, true, rtol=1e-6, atol=0)
    return "" if same else f"{found.tolist()} read, {true.tolist()} true"


def main() -> None:
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    with tempfile.TemporaryDirectory() as folder:
        results = [judged(seed, Path(folder)) for seed in range(number)]
    for seed, (what, why) in enumerate(results):
        if not what.startswith("right") and what != "refused":
            print(f"{seed}: {what}: {why}\n")
    for first, kind in enumerate(("material lists", "measured values", "modes")):
        print(f"{kind}: {dict(Counter(what for what, _ in results[first::3]))}")
    print(dict(Counter(what for what, _ in results)))


if __name__ == "__main__":
    main()
