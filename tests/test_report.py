"""Figures, the page, and what all commands have in common."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import click
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rtcal as rt
from rtcal.command import console
from rtcal.command.gap import NOTHING_TO_ADD
from rtcal.command.main import EXIT_CODES, cli, main
from rtcal.errors import DataError, MissingDependencyError
from rtcal.loop import Loop, LoopResult
from rtcal.report import saved as saving
from rtcal.report import words
from rtcal.simulators.equation import EquationSimulator
from tests.browser import chromium

pytest.importorskip("matplotlib", reason="matplotlib is not installed (rtcal[report])")
pytest.importorskip("jinja2", reason="jinja2 is not installed (rtcal[report])")

from rtcal.report import document, figures, loop_figures, material_figures, page, result_folder

ROOT = Path(__file__).resolve().parents[1]
EVIL = "<script>alert(1)</script> & \"double\" 'single' $x_1$ --> ]]>"


@pytest.fixture(scope="module")
def result() -> rt.calibration.result.CalibrationResult:
    return rt.calibrate(*rt.datasets.bras_cr2())


@pytest.fixture(scope="module")
def html(result) -> str:
    return page.page(result)


def evil_room() -> rt.Room:
    return rt.Room(
        name=f"Hall <b>bold</b> {EVIL}",
        volume=100,
        materials=[EVIL, "<img src=x onerror=alert(2)>"],
        areas=[80.0, 60.0],
        alpha=[[0.1, 0.2, 0.2], [0.3, 0.4, 0.5]],
        sigma=np.full((2, 3), 0.05),
        centre_frequencies=[500, 1000, 2000],
        air=rt.Air(),
        sources={EVIL: EVIL},
    )


@pytest.fixture(scope="module")
def evil():
    """A calibration whose names are markup; one band unmeasured, one out of reach."""
    return rt.calibrate(evil_room(), [100.0, np.nan, 0.4], unreachable="nearest")


@pytest.fixture(scope="module")
def evil_html(evil) -> str:
    return page.page(evil)


@pytest.fixture(scope="module")
def loop_result() -> LoopResult:
    room, measured = rt.datasets.bras_cr2()
    simulator = EquationSimulator(rt.Kuttruff(path_variance=0.9), room)
    return rt.calibrate_simulator(simulator, room, measured, rule="secant", tolerance=0.05)


@pytest.fixture(scope="module")
def loop(loop_result) -> Loop:
    return loop_result.loop


def no_figures(*_: object) -> dict[str, dict[str, str]]:
    """In place of the page's figures, where their drawing is not what is tested."""
    names = ("gap", "reverberation_time", "coefficients", "shares", "plane")
    return {name: {"source": "data:,", "alt": "", "caption": ""} for name in names}


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def line(axes, label):
    return next(x for x in axes.get_lines() if x.get_label() == label)


# Figures: what is drawn is what was found.


def test_axes_have_units(result, loop) -> None:
    every = [
        figures.reverberation_time(result),
        figures.gap(result),
        material_figures.coefficients(result),
        material_figures.shares(result),
        material_figures.plane_of(result),
        loop_figures.path(loop),
    ]
    for figure in every:
        for axes in (a for a in figure.axes if a.get_visible()):
            assert re.search(r"/ Hz|Simulation number|^α of .* m²$", axes.get_xlabel())
            assert re.search(r"/ (s|JND|%)$|^α", axes.get_ylabel())


def test_gap_and_reverberation_time(result) -> None:
    bars = figures.gap(result).axes[0].containers[0]
    assert [b.get_height() for b in bars] == pytest.approx(result.gap_before.tolist())
    axes = figures.reverberation_time(result).axes[0]
    assert line(axes, "before calibration").get_ydata() == pytest.approx(
        result.reverberation_time_before
    )
    assert line(axes, "after calibration").get_ydata() == pytest.approx(result.measured)


def test_coefficients_and_their_intervals(result) -> None:
    axes = material_figures.coefficients(result).axes
    assert len([a for a in axes if a.get_visible()]) == 5
    for i, panel in enumerate(axes[:5]):
        prior, after = (c.lines[0].get_ydata() for c in panel.containers)
        assert prior == pytest.approx(result.prior.alpha[i])
        assert after == pytest.approx(result.alpha[i])
        bars = np.array(panel.containers[1].lines[2][0].get_segments())
        low, high = bars[:, 0, 1], bars[:, 1, 1]
        assert low == pytest.approx(result.interval[0][i])
        assert high == pytest.approx(result.interval[1][i])
        assert (low < result.alpha[i]).all()


def test_intervals_without_an_exact_posterior_are_the_linear_estimates() -> None:
    found = rt.calibrate(*rt.datasets.bras_cr2(), method="lse")
    assert found.interval is None
    low, high = material_figures.intervals(saving.saved(found))
    np.testing.assert_allclose((high - low)[0] / 2, 1.6449 * found.posterior_sigma[0], rtol=1e-9)


def test_shares_add_up_and_are_the_areas(result) -> None:
    names, parts = material_figures.absorption_shares(saving.saved(result), 7)
    np.testing.assert_allclose(parts.sum(axis=0), 100, rtol=1e-12)
    assert names[-1] == "air"
    np.testing.assert_allclose(parts[-1], 100 * result.air_share, rtol=1e-12)
    own = parts[names.index("windows")] / parts[names.index("floor")]
    area = result.prior.areas[:, np.newaxis] * result.alpha
    np.testing.assert_allclose(own, area[2] / area[3], rtol=1e-12)
    names, parts = material_figures.absorption_shares(saving.saved(result), 3)
    assert names[2:] == ["3 other materials", "air"]
    np.testing.assert_allclose(parts.sum(axis=0), 100, rtol=1e-12)


def test_plane_of_two_materials(result) -> None:
    axes = material_figures.plane_of(result, ("floor", "windows"), 500).axes[0]
    x, y = line(axes, "gives the measured T").get_data()
    k, rows = 2, [3, 2]
    rest = np.delete(np.arange(5), rows)
    left = result.target[k] - result.prior.areas[rest] @ result.alpha[rest, k]
    np.testing.assert_allclose(result.prior.areas[rows] @ np.array([x, y]), left, rtol=1e-9)
    point = [v[0] for v in line(axes, "calibrated").get_data()]
    assert point == pytest.approx(result.alpha[rows, k].tolist())
    ellipse = np.array(line(axes, "prior, 2 σ").get_data()) - result.prior.alpha[rows, k][:, None]
    distance = np.linalg.norm(ellipse / result.prior.sigma[rows, k][:, None], axis=0)
    np.testing.assert_allclose(distance, 2, rtol=1e-12)
    for pair, frequency, said in (
        (("floor", "roof"), None, "roof"),
        (("floor",) * 2, None, "twice"),
        (None, 501, "501 Hz is no band"),
    ):
        with pytest.raises(DataError, match=said):
            material_figures.plane_of(result, pair, frequency)


def test_the_papers_plane() -> None:
    """Fig. 3b: mu (0.6, 0.5), sigma (0.05, 0.1) gives (0.54, 0.26); the truth is (0.6, 0.2)."""
    mu, sigma, areas = np.array([0.6, 0.5]), np.array([0.05, 0.1]), np.array([47.0, 47.0])
    alpha = rt.closed_form.maximum_likelihood(mu[:, None], sigma[:, None], areas, [47 * 0.8])[:, 0]
    assert alpha == pytest.approx([0.54, 0.26], abs=1e-9)
    axes = material_figures.plane(mu, sigma, areas, 47 * 0.8, alpha, truth=[0.6, 0.2]).axes[0]
    assert [v[0] for v in line(axes, "true").get_data()] == [0.6, 0.2]


def test_the_loops_path(loop) -> None:
    left, right = loop_figures.path(loop).axes
    assert line(left, "first simulation").get_ydata() == pytest.approx(loop.steps[0].simulated)
    assert len(loop.steps) >= 2
    drawn = line(right, "125 Hz").get_ydata()
    assert drawn[loop.best[0]] == pytest.approx(loop.gap[0])
    assert abs(drawn[0]) > abs(drawn[loop.best[0]])
    begun = rt.loop.start(*rt.datasets.bras_cr2())
    with pytest.raises(DataError, match="no simulation yet"):
        loop_figures.path(begun)


def test_the_same_figure_has_the_same_bytes(result) -> None:
    first, second = (figures.rendered(figures.gap(result), "svg") for _ in range(2))
    assert first == second
    assert len(first) > 5000


# What is saved.


def test_a_file_and_a_result_are_read_alike(result, tmp_path) -> None:
    (tmp_path / "result.json").write_text(result.to_json(), encoding="utf-8")
    one, other = saving.read(tmp_path), saving.saved(result)
    assert one.record == json.loads(result.to_json()) == other.record
    np.testing.assert_array_equal(one.interval, other.interval)
    np.testing.assert_array_equal(one.alpha_after, result.alpha)
    assert one.trust_marks == result.trust_marks


def paths_of(value, own=()):
    yield own
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        if isinstance(inner, dict | list):
            yield from paths_of(inner, (*own, key))
        else:
            yield (*own, key)


@settings(max_examples=200)
@given(data=st.data())
def test_broken_files_are_refused_or_shown(data) -> None:
    """Whatever stands in the file, the page is written or a DataError says what is wrong."""
    record = json.loads(RECORD)
    where = data.draw(st.sampled_from(PATHS))
    junk = data.draw(
        st.sampled_from(
            [None, "text", -1, 1e308, float("inf"), [], {}, [1, "a"], True, {"a": None}, "remove"]
        )
    )
    inner = record
    for key in where[:-1]:
        inner = inner[key]
    if junk == "remove":
        del inner[where[-1]]
    else:
        inner[where[-1]] = junk
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "_figures", no_figures)
        try:
            text = page.page(saving.from_dict(record))
        except DataError as error:
            text = str(error)
    assert "no saved calibration" in text or "What was assumed" in text


def _record() -> str:
    return rt.calibrate(evil_room(), [0.4, np.nan, 0.4]).to_json()


RECORD = _record()
PATHS = [p for p in paths_of(json.loads(RECORD)) if p]


def test_what_is_no_result_is_refused(tmp_path) -> None:
    path = tmp_path / "x.json"
    for content, said in (
        ("{", "not JSON"),
        ("[1]", "not a JSON object"),
        ("{}", '"rtcal" is not'),
        ("[" * 100_000, "not JSON"),
    ):
        path.write_text(content)
        with pytest.raises(DataError, match=said):
            page.page_of(path)
    with pytest.raises(DataError, match=r"result\.json: No such file"):
        page.page_of(tmp_path)


def test_a_loops_file_holds_its_room_and_equation(loop, tmp_path) -> None:
    path = str(tmp_path / "loop.json")
    loop.save(path)
    again = Loop.load(path)
    assert again.room.name == loop.room.name
    np.testing.assert_array_equal(again.room.sigma, loop.room.sigma)
    assert again.status == loop.status
    assert again.equation == rt.Eyring()
    other = rt.loop.start(*rt.datasets.bras_cr2(), equation=rt.Kuttruff(path_variance=0.3))
    other.save(path)
    assert Loop.load(path).equation == rt.Kuttruff(path_variance=0.3)
    path = tmp_path / "loop.json"
    path.write_text(path.read_text().replace('"name": "Kuttruff"', '"name": "Nobody"'))
    with pytest.raises(DataError, match="Nobody"):
        Loop.load(str(path))


# The page.


def test_the_page_says_what_it_must(html, result) -> None:
    for text in (
        "Summary",
        "15.6 JND at worst: at 125 Hz it had 2.49 s where 1.40 s were measured",
        "proves nothing",
        "p = 1.7e-05",
        "What not to believe",
        "below the Schroeder frequency",
        "What could not be met",
        "What was assumed",
        "19.5 °C",
        "Certificate",
        "rtcal calibrate room.toml t.csv --method mle --equation eyring",
        "cvxpy",
        result.measured_data.fingerprint,
        "250, 500, 1000 and 2000 Hz",
    ):
        assert text in html, text
    assert len(html.encode()) < document.MAX_BYTES
    assert html.count("data:image/svg+xml") == 5


def test_the_page_needs_nothing_else(html, evil_html) -> None:
    for text in (html, evil_html):
        assert not re.search(r"<script|<iframe|<object|@import|url\(", text, re.I)
        targets = re.findall(r'(?:src|href)="([^"]*)"', text)
        assert len(targets) > 6
        assert all(t.startswith(("data:", "#")) for t in targets)


def test_names_are_text_in_page_and_pictures(evil_html) -> None:
    text = evil_html
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; &#34;double&#34; &#39;single&#39;" in text
    assert "&lt;img src=x onerror=alert(2)&gt;" in text
    assert not re.search(r"<script|<img src=x|<b>bold", text)
    pictures = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', text)
    assert len(pictures) == 5
    for picture in pictures:
        content = base64.b64decode(picture)
        tags = {
            e.tag.rpartition("}")[2]
            for e in ElementTree.fromstring(content).iter()
            if isinstance(e.tag, str)
        }
        assert "path" in tags
        assert not tags & {"script", "image", "foreignObject", "b"}


def test_what_was_not_measured_or_met_is_said(evil_html) -> None:
    text = evil_html
    assert "beyond reach" in text
    assert "1000 Hz: no T was measured" in text
    assert "--unreachable nearest" in text
    assert "No coefficient moved by more than" not in text


def test_the_page_reproduces_itself(html, result, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("room.toml", "t.csv"):
        (coded,) = re.findall(rf'download="{name}" href="data:text/plain;base64,([^"]+)"', html)
        (tmp_path / name).write_bytes(base64.b64decode(coded))
    (command,) = re.findall(r"<pre>rtcal (.*)</pre>", html)
    assert run(*command.split(), "--quiet") == 0
    again = saving.read(tmp_path / "calibrated")
    np.testing.assert_allclose(again.alpha_after, result.alpha, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.z, result.plausibility.z, rtol=1e-9)
    np.testing.assert_allclose(again.uncertainty, result.measured_uncertainty, rtol=1e-12)


def test_a_composed_calibration_does_not_claim_a_command() -> None:
    room = evil_room()
    terms = rt.terms
    soft = rt.Calibration(terms.PriorDeviation() + 2 * terms.SoftMatch(0.05), []).build(room)
    seen = saving.saved(soft.solve([0.4, 0.4, 0.4]))
    assert words.command(seen) is None
    assert any("SoftMatch" in text for text in words.assumed(seen))
    kuttruff = rt.calibrate(room, [0.4] * 3, equation=rt.Kuttruff(path_variance=0.3))
    assert words.command(saving.saved(kuttruff)) is None
    assert "path_variance = 0.3" in " ".join(words.assumed(saving.saved(kuttruff)))
    usual = rt.calibrate(room, [0.4] * 3, equation=rt.Kuttruff())
    assert "--equation kuttruff" in str(words.command(saving.saved(usual)))


def test_verdicts() -> None:
    room = evil_room()
    near = rt.Eyring().reverberation_time(room)
    assert words.verdict(saving.saved(rt.calibrate(room, near)))[0] == "agrees"
    assert words.verdict(saving.saved(rt.calibrate(room, 0.6 * near)))[0] == "contradicts"
    assert words.large_shifts(saving.saved(rt.calibrate(room, near))) == ([], 0)
    shifts, count = words.large_shifts(saving.saved(rt.calibrate(room, 0.6 * near)))
    assert count == len(shifts) > 1
    assert shifts[0].sigmas >= shifts[-1].sigmas > 2


FINDING = {
    "headline": "The model lacks <i>this</i>.",
    "level": "contradicts",
    "sizes": ["Size of opening: 12 m²."],
    "rests_on": ["The odds are high."],
    "to_do": ["Measure once without it."],
    "notes": ["A note."],
    "effects": [("opening", 93.0, 12.3), ("none", 7.0, 0.0)],
    "plain_heading": "The plain calibration: the model lacks something",
    "plain": "plain calibration: not to be used",
    "corrected": None,
    "unknowable": "",
    "reproduce": None,
}


def test_a_findings_page_opens_with_the_finding(result) -> None:
    """Not with the sentence that the plain calibration meets the measured T, which proves nothing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "_figures", no_figures)
        pictures = {
            "residuals": (figures.gap(result), "Map"),
            "evidence": (figures.gap(result), "E"),
        }
        text = page.finding_page(result, FINDING, pictures)
        usual = page.page(result)
    met = "now the model has the measured T in all 6 bands"
    order = [
        "The model lacks &lt;i&gt;this&lt;/i&gt;.",
        "Size of opening",
        "The odds are high.",
        "Measure once without it.",
        "opening</td><td>93</td><td>+12.3",
        "From here on, text, tables and pictures are of the plain calibration: not to be used",
        met,
    ]
    assert [text.index(sentence) for sentence in order] == sorted(map(text.index, order))
    assert text.count("data:image/svg+xml") == 2
    assert met in usual
    assert "What to do" not in usual.split('id="doubts"')[0]


def test_a_calibrations_page_opens_with_three_sentences_and_a_figure(html) -> None:
    summary = html.split('id="summary"')[1].split("<h2")[0]
    sentences = re.findall(r"<p[^>]*>(.*?)</p>", summary)
    assert len(sentences) == 3
    assert all(len(re.findall(r"\.(?: |$)", sentence)) == 1 for sentence in sentences)
    assert summary.count("<img") == 1


def test_title_author_and_date_are_settable(result, loop, tmp_path, capsys) -> None:
    """They are text, also in the style sheet that prints them on each sheet."""
    heading = document.Heading('Hall "A" </style><b>', "B & Sons", "2026-11-22")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "_figures", no_figures)
        texts = [
            page.page(result, heading=heading),
            page.loop_page(loop, heading=heading),
            page.finding_page(result, FINDING, {}, heading=heading),
        ]
        assert page.page(result) == page.page(result)
        assert "2026" not in page.page(result).split("<main>")[0]
        (tmp_path / "result.json").write_text(result.to_json(), encoding="utf-8")
        options = ["--title", "Hall B", "--author", "C", "--date", "today"]
        assert run("report", tmp_path, *options, "--quiet") == 0
        assert run("report", tmp_path, "--title", "two\nlines") == 2
        assert "title is not one line" in capsys.readouterr().err
    for text in texts:
        assert "<h1>Hall &#34;A&#34; &lt;/style&gt;&lt;b&gt;</h1>" in text
        assert "· 2026-11-22 · B &amp; Sons" in text
        assert '"Hall \\22 A\\22  \\3c \\2f style\\3e \\3c b\\3e , 2026-11-22"' in text
        assert text.count("</style>") == 1
    written = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>Hall B</h1>" in written
    assert "· today · C" in written
    assert "BRAS CR2, seminar room: calibration" in written


def test_the_page_names_the_bands_that_were_compared() -> None:
    room = rt.Room(
        name="box",
        volume=60,
        materials=["wall"],
        areas=[94],
        alpha=[[0.3] * 8],
        sigma=[[0.1] * 8],
        centre_frequencies=[125, 250, 500, 1000, 2000, 4000, 8000, 16000],
    )
    measured = rt.Measurement.from_values([250, 500, 1000, 2000, 4000, 8000], t20=[0.35] * 6)
    calibration = saving.saved(rt.calibrate(room, measured))
    assert words.compared(calibration) == "6 bands, 250 to 8000 Hz"


def test_half_a_surrogate_pair_is_refused_before_a_page_is_begun(result, tmp_path, capsys) -> None:
    text = result.to_json().replace("BRAS CR2", "BRAS \\ud800", 1)
    (tmp_path / "result.json").write_text(text, encoding="utf-8")
    assert run("report", tmp_path) == 2
    assert "half of a surrogate pair" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


def test_a_loops_page(loop, tmp_path) -> None:
    path = tmp_path / "loop.json"
    loop.save(str(path))
    text = page.page_of(path)
    assert f"A simulator was run {len(loop.steps)} times" in text
    assert "to no other" in text
    assert text.count("<td>converged</td>") == 6
    assert f"{loop.steps[0].simulated[0]:.3f}" in text
    assert "Before and after" not in text


def test_a_loop_results_page(loop_result, tmp_path) -> None:
    path = tmp_path / "loop.json"
    loop_result.save(str(path))
    text = page.page_of(path)
    assert text == page.loop_page(loop_result)
    assert "Simulated by Kuttruff&#39;s equation for BRAS CR2" in text
    after = loop_result.after.mean("t20")
    row = text.split("T20, with the coefficients returned / s")[1].split("</tr>")[0]
    assert [float(v) for v in re.findall(r"<td>([\d.]+)</td>", row)] == np.round(after, 3).tolist()
    assert "With all the coefficients returned, T20 is off by 0.0 JND at most" in text
    assert "no finding" not in text
    assert len(Loop.load(str(path)).steps) == loop_result.simulations
    steps = [
        replace(s, alpha=np.where(s.alpha > 0.1, 1.0, s.alpha)) for s in loop_result.loop.steps
    ]
    text = page.loop_page(replace(loop_result.loop, steps=tuple(steps)))
    assert "windows: α = 1 at 125 and 2000 Hz" in text
    good = json.loads(path.read_text())
    for broken, said in (
        ({}, "result lacks"),
        (good["result"] | {"before": {"t20": [1.0]}}, r"result\.before\.t20 has 1 values"),
        (good["result"] | {"before": {"t20": [1e300] * 6}}, r"t20\[0\] = 1e\+300 is not from"),
        (good["result"] | {"simulator": 3}, r"result\.simulator = 3 is not a text"),
        (good["result"] | {"status": ["fine"]}, r"result\.status = \['fine'\] is not a status"),
        (good["result"] | {"afetr": {}}, 'has the key "afetr"'),
    ):
        path.write_text(json.dumps(good | {"result": broken}))
        with pytest.raises(DataError, match=f"no result of a loop: .*{said}"):
            page.page_of(path)


def test_a_loops_page_says_what_the_terminal_says(
    loop_result, tmp_path, capsys, monkeypatch
) -> None:
    """It lacked z, the reservations, and called a band of an unfinished loop "not converging"."""
    text = page.loop_page(loop_result)
    for mark in loop_result.trust_marks:
        assert mark.advice in text
    row = text.split('<th scope="row">z</th>')[1].split("</tr>")[0]
    shown = [float(v.replace("−", "-")) for v in re.findall(r"<td>([-−+\d.]+)</td>", row)]
    assert shown == loop_result.loop.outcome.plausibility.z.round(1).tolist()
    monkeypatch.chdir(tmp_path)
    room, measured = rt.datasets.bras_cr2()
    room.save("room.toml")
    measured.save("t.csv")
    rt.Measurement.from_values(room.centre_frequencies, t20=[1.0] * 6).save("simulated.csv")
    files = ["--state", "loop.json", "--out", "next.toml"]
    assert run("loop", "start", "room.toml", "t.csv", *files, "--quiet") == 0
    assert run("loop", "next", "room.toml", "simulated.csv", *files) == 0
    said = capsys.readouterr().out
    unfinished = page.page_of("loop.json")
    assert said.count("not yet") == 6
    assert unfinished.count("<td>not yet</td>") == 6
    assert "not converging" not in unfinished


def test_large_rooms_stay_below_the_limit(monkeypatch) -> None:
    """The table takes a hundred materials; a page beyond the limit is refused."""
    n, f = 130, [500.0, 1000.0]
    room = rt.Room(
        name="large",
        volume=5000,
        materials=[f"m{i}" for i in range(n)],
        areas=np.full(n, 20.0),
        alpha=np.full((n, 2), 0.2),
        sigma=np.full((n, 2), 0.05),
        centre_frequencies=f,
        air=rt.Air(),
    )
    monkeypatch.setattr(page, "_figures", no_figures)
    text = page.page(rt.calibrate(room, [1.0, 1.0]))
    assert "the 100 of 130 materials that absorb most" in text
    assert len(text.encode()) < document.MAX_BYTES
    monkeypatch.setattr(document, "MAX_BYTES", 1000)
    with pytest.raises(DataError, match="more than 1000"):
        page.page(rt.calibrate(room, [1.0, 1.0]))


# In a browser.


def test_in_a_browser(html, evil_html, tmp_path) -> None:
    """The text is there, nothing is complained of on the console, and the pictures are drawn."""
    from matplotlib.image import imread

    ordinary, nasty, control = (tmp_path / f"{n}.html" for n in ("page", "evil", "control"))
    document.write(ordinary, html)
    document.write(nasty, evil_html)
    seen = chromium(tmp_path, ordinary, "--dump-dom")
    assert "What not to believe" in seen.stdout
    assert "plaster" in seen.stdout
    assert "CONSOLE" not in seen.stderr
    picture = tmp_path / "page.png"
    shot = chromium(tmp_path, nasty, f"--screenshot={picture}", "--window-size=1000,4000")
    assert "CONSOLE" not in shot.stderr
    pixels = imread(picture)[:, :, :3]
    blue = np.abs(pixels - np.array([0x00, 0x72, 0xB2]) / 255).max(axis=2) < 0.02
    assert blue.sum() > 500  # dots and lines of the pictures; nothing else on the page is blue
    # The console is read indeed: a script, which the page's policy forbids, is complained of.
    document.write(control, html.replace("</body>", "<script>alert(1)</script></body>"))
    assert "CONSOLE" in chromium(tmp_path, control, "--dump-dom").stderr


def test_dark_mode_is_dark_in_its_figures_too(html, tmp_path) -> None:
    """A white figure in a dark page dazzles."""
    from matplotlib.image import imread

    document.write(tmp_path / "p.html", html)
    bright = []
    for setting in ("0", "1"):
        picture = tmp_path / f"{setting}.png"
        scheme = f"--blink-settings=preferredColorScheme={setting}"
        size = "--window-size=1000,900"
        chromium(tmp_path, tmp_path / "p.html", scheme, size, f"--screenshot={picture}")
        bright.append((imread(picture)[:, :, :3].min(axis=2) > 0.5).mean())
    dark, light = bright
    assert dark < 0.1
    assert light > 0.8


_FRAME = """<body><iframe style="width: 400px" src="%s"></iframe><script>
document.querySelector("iframe").onload = event => {
  const root = event.target.contentDocument.documentElement;
  document.body.append("width: " + root.scrollWidth + " ");
};</script>"""


def test_no_page_is_wider_than_a_phone(html, evil_html, loop, result, tmp_path) -> None:
    """Tables, figures and long names scroll or wrap within their own box."""
    drawn = {"evidence": (figures.gap(result), "E"), "residuals": (figures.gap(result), "R")}
    pages = {
        "page": html,
        "evil": evil_html,
        "loop": page.loop_page(loop),
        "finding": page.finding_page(result, FINDING, drawn),
        "wide": '<div style="width: 700px">x</div>',
    }
    seen = {}
    for name, text in pages.items():
        document.write(tmp_path / f"{name}.html", text)
        frame = tmp_path / "frame.html"
        frame.write_text(_FRAME % f"{name}.html")
        arguments = ("--allow-file-access-from-files", "--virtual-time-budget=9000", "--dump-dom")
        seen[name] = (
            chromium(tmp_path, frame, *arguments).stdout.rpartition("width: ")[2].split()[0]
        )
    assert [name for name, width in seen.items() if int(width) > 400] == ["wide"]


def printed(folder: Path, text: str) -> list[str]:
    """The text of each sheet of a printed page, as poppler reads it."""
    program = shutil.which("pdftotext")
    if program is None:
        pytest.skip("needs Debian's poppler-utils, which is not installed here")
    document.write(folder / "p.html", text)
    pdf = folder / "p.pdf"
    chromium(folder, folder / "p.html", "--no-pdf-header-footer", f"--print-to-pdf={pdf}")
    command = [program, "-layout", str(pdf), "-"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.removesuffix("\f").split("\f")


def test_a_printed_page_can_be_handed_to_a_client(result, tmp_path) -> None:
    """Each sheet has title, date and number; no table is split, no command is cut off."""
    n, f = 14, [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]
    room = rt.Room(
        name="A hall",
        volume=900,
        materials=[f"material {i}" for i in range(n)],
        areas=np.full(n, 45.0),
        alpha=np.full((n, 6), 0.2),
        sigma=np.full((n, 6), 0.02),
        centre_frequencies=f,
        air=rt.Air(),
    )
    heading = document.Heading("Hall “A”", "A. Consultant", "2026-11-22")
    sheets = printed(tmp_path, page.page(rt.calibrate(room, [1.6] * 6), heading=heading))
    assert len(sheets) >= 3
    for number, sheet in enumerate(sheets, start=1):
        assert f"Page {number} of {len(sheets)}" in sheet
        assert "Hall “A”, 2026-11-22" in sheet
    for rows in (("measured T / s", "reservations"), ("material 0 .*→", "material 13 .*→")):
        on = [[k for k, s in enumerate(sheets) if re.search(rf"^ *{r}", s, re.M)] for r in rows]
        assert on[0] == on[1]
        assert len(on[0]) == 1
    assert "--out calibrated" in " ".join(sheets[-1].split())
    assert "A. Consultant" in sheets[0]
    assert sheets[0].index("off by") < sheets[0].index("What not to believe")


# The command.


def test_report_command(result, evil, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(page, "_figures", no_figures)
    folder = tmp_path / "calibrated"
    folder.mkdir()
    (folder / "result.json").write_text(evil.to_json(), encoding="utf-8")
    assert run("report", folder) == 0
    assert capsys.readouterr().out.split() == ["Written:", str(folder / "report.html")]
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert run("report", folder / "result.json", "--out", folder / "b.html", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"written": str(folder / "b.html"), "bytes": len(text.encode())}
    assert (folder / "b.html").read_text(encoding="utf-8") == text
    kept = sorted(p.name for p in folder.iterdir())
    for out, said in (
        (folder / "no" / "p.html", "No such file"),
        (folder, "is a directory"),
        (folder / "result.json", "would be written over"),
        ("", "--out is empty"),
    ):
        assert run("report", folder / "result.json", "--out", out) == 2
        assert said in capsys.readouterr().err
    for (
        name
    ) in result_folder.FILES:  # what calibrate keeps there stays as it is, however it is named
        (folder / name).touch()
        before = (folder / name).read_bytes()
        for source in (folder, folder / "result.json"):
            assert run("report", source, "--out", folder / ".." / folder.name / name) == 2
            assert f"would be written over {folder / name}" in capsys.readouterr().err
        assert (folder / name).read_bytes() == before
    kept = sorted(p.name for p in folder.iterdir())
    (folder / "result.json").write_text("{}")
    assert run("report", folder) == 2
    assert (folder / "report.html").read_text(encoding="utf-8") == text
    assert sorted(p.name for p in folder.iterdir()) == kept
    monkeypatch.setitem(__import__("sys").modules, "jinja2", None)
    document._environment.cache_clear()
    with pytest.raises(MissingDependencyError, match=r"rtcal\[report\]"):
        document.render("layout.html", {}, document.Heading("x"))


def commands():
    for name, command in cli.commands.items():
        if hasattr(command, "commands"):
            yield from ((f"{name} {n}", c) for n, c in command.commands.items())
        else:
            yield name, command


@pytest.mark.parametrize(("name", "command"), list(commands()), ids=lambda v: str(v))
def test_every_command_has_the_same_manners(name, command, capsys) -> None:
    options = {o for p in command.params for o in p.opts}
    assert {"--json", "--quiet", "-q"} <= options
    unsaid = [p.name for p in command.params if isinstance(p, click.Option) and not p.help]
    assert not unsaid, f"{name}: options without help"
    assert run(*name.split(), "--help") == 0
    text = capsys.readouterr().out
    assert f"Example: rtcal {name} " in " ".join(text.split())
    assert len(command.short_help or "") <= 65
    assert run(*name.split(), "--nonsense") == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_help_names_the_exit_codes(capsys) -> None:
    assert run("--help") == 0
    assert NOTHING_TO_ADD in EXIT_CODES
    text = capsys.readouterr().out
    assert "..." not in text.split("Commands:")[1]
    for code, meaning in EXIT_CODES.items():
        assert f"{code:3d}  {meaning}" in text
    page_text = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    for code, meaning in EXIT_CODES.items():
        assert f"| {code} | {meaning} |" in page_text
    for name, _ in commands():
        assert f"`rtcal {name}`" in page_text


def test_quiet_and_json(result, loop, tmp_path, monkeypatch, capsys) -> None:
    """Quiet prints nothing; JSON is JSON and nothing else, and both write the same files."""
    monkeypatch.chdir(tmp_path)
    room, measured = rt.datasets.bras_cr2()
    room.save("room.toml")
    measured.save("t.csv")
    Path("hall.geo").write_bytes(b"ABS wood = <10 10 10 10 10 10>\r\n")
    Path("table.csv").write_text("f,T20\n500,1.5\n1000,1.4\n")
    rt.Measurement.from_values(room.centre_frequencies, t20=[1.0] * 6).save("s.csv")
    state = ["--state", "loop.json", "--out", "next.toml"]
    calls = [
        (
            ["import", "catt", "hall.geo", "--volume", 9, "--area", "wood=30", "--out", "w.toml"],
            "areas",
        ),
        (["export", "catt", "w.toml", "hall.geo"], "change_jnd"),
        (["table", "table.csv", "--out", "u.csv"], "values"),
        (["loop", "start", "room.toml", "t.csv", *state], "simulate"),
        (["loop", "next", "room.toml", "s.csv", *state, "--again"], "finished"),
        (["loop", "back", "room.toml", *state], "simulations"),
        (["study", "--trials", 0, "--realisations", 20, "--sigma-r", 0.1], "studies"),
        (["calibrate", "room.toml", "t.csv"], "materials"),
    ]
    for arguments, key in calls:
        assert run(*arguments, "--quiet") == 0
        said = capsys.readouterr()
        assert said.out == said.err == ""
        assert run(*arguments, "--json") == 0
        said = capsys.readouterr()
        assert key in json.loads(said.out)
        assert said.err == ""
    assert Path("w.toml").exists()
    assert Path("u.csv").exists()
    assert run("study", "--trials", 0, "--realisations", 20, "--sigma-r", 0.1, "--json") == 0
    rows = json.loads(capsys.readouterr().out)["studies"][0]["scores"]
    assert run("study", "--trials", 0, "--realisations", 20, "--sigma-r", -1) == 2
    assert "rtcal: --sigma-r = -1 is not above 0" in capsys.readouterr().err
    assert {r["method"] for r in rows} == {"none", "scaling", "lse", "mle"}
    assert rows[3]["score"] > rows[1]["score"] > 0


def test_progress_bars_only_where_someone_looks(tmp_path, monkeypatch, capsys, evil) -> None:
    pytest.importorskip("tqdm", reason="tqdm is not installed (rtcal[studies])")
    assert not console.bar_wanted(quiet=False)  # standard error is caught here, no terminal
    (tmp_path / "result.json").write_text(evil.to_json(), encoding="utf-8")
    monkeypatch.setattr(page, "source", lambda _, step: step() or "data:,")
    monkeypatch.setattr("rtcal.command.report.bar_wanted", lambda quiet: not quiet)
    assert run("report", tmp_path) == 0
    assert capsys.readouterr().err == ""  # done within two seconds
    monkeypatch.setattr("rtcal.support.progress.DELAY", 0.0)
    assert run("report", tmp_path) == 0
    assert "5/5" in capsys.readouterr().err
    assert run("report", tmp_path, "--quiet") == 0
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert console.bar_wanted(quiet=False)
    assert not console.bar_wanted(quiet=True)
    monkeypatch.setitem(__import__("sys").modules, "tqdm", None)
    assert not console.bar_wanted(quiet=False)
