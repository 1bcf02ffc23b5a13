"""The page of a calibration: what it says, and that names in it stay text."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import rtcal as rt
from rtcal.report import (
    document,
    loop_page,
    page,
    pages,
    words,
)
from rtcal.support.errors import DataError
from tests.report.pages import FINDING, evil_room, no_figures, run


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


@pytest.mark.parametrize(
    ("stated", "words_of_it"),
    [({}, "those of the exact posterior"), ({"volume_sigma": 0.05}, "those of a normal density")],
)
def test_the_page_says_what_its_intervals_are(stated, words_of_it, monkeypatch) -> None:
    monkeypatch.setattr(page, "_figures", no_figures)
    room, measured = rt.datasets.bras_cr2()
    text = page.calibration_page(rt.calibrate(room.replace(**stated), measured))
    assert f"The intervals are {words_of_it}" in " ".join(text.split())


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
    again = rt.load(tmp_path / "calibrated")
    np.testing.assert_allclose(again.alpha, result.alpha, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.plausibility.z, result.plausibility.z, rtol=1e-9)
    np.testing.assert_allclose(again.measured_uncertainty, result.measured_uncertainty, rtol=1e-12)


def test_a_composed_calibration_does_not_claim_a_command() -> None:
    room = evil_room()
    terms = rt.terms
    soft = rt.Calibration(terms.PriorDeviation() + 2 * terms.SoftMatch(0.05), []).build(room)
    seen = soft.solve([0.4, 0.4, 0.4])
    assert words.command(seen) is None
    assert any("SoftMatch" in text for text in words.assumed(seen))
    kuttruff = rt.calibrate(room, [0.4] * 3, equation=rt.Kuttruff(path_variance=0.3))
    assert words.command(kuttruff) is None
    assert "path_variance = 0.3" in " ".join(words.assumed(kuttruff))
    usual = rt.calibrate(room, [0.4] * 3, equation=rt.Kuttruff())
    assert "--equation kuttruff" in str(words.command(usual))


def test_verdicts() -> None:
    room = evil_room()
    near = 1.05 * rt.Eyring().reverberation_time(room)
    assert rt.calibrate(room, near).verdict.level == "agrees"
    assert rt.calibrate(room, 0.6 * near).verdict.level == "contradicts"
    alike = rt.calibrate(room, near)
    assert "within what was stated" in words.lead(alike, alike.verdict)["headline"]
    assert words.large_shifts(rt.calibrate(room, near)) == ([], 0)
    shifts, count = words.large_shifts(rt.calibrate(room, 0.6 * near))
    assert count == len(shifts) > 1
    assert shifts[0].sigmas >= shifts[-1].sigmas > 2


def test_a_gap_that_nobody_hears_is_met_and_printed() -> None:
    room = evil_room().replace(common_area_sigma=0.03)
    result = rt.calibrate(room, 0.95 * rt.Eyring().reverberation_time(room))
    gap = np.nanmax(np.abs(result.gap_after))
    assert 0.05 < gap < 0.5
    n = int(np.isfinite(result.gap_after).sum())
    assert f"in all {n} bands, to within {gap:.1f} JND." in " ".join(
        words.summary(result, result.verdict)
    )
    assert "bands" not in words.lead(result, result.verdict)["headline"]
    assert not any("gap remains" in sentence for sentence in words.not_met(result))


def test_a_calibrations_page_opens_with_a_headline_three_sentences_and_a_figure(html) -> None:
    lead = html.split("<main>")[1].split("<h2")[0]
    said = "The model has the measured reverberation time, but not with its materials as they were"
    assert said in lead
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
            page.calibration_page(result, heading=heading),
            loop_page.page(loop, heading=heading),
            page.finding_page(result, FINDING, {}, heading=heading),
        ]
        assert page.calibration_page(result) == page.calibration_page(result)
        assert "2026" not in page.calibration_page(result).split("<main>")[0]
        (tmp_path / "result.json").write_text(result.to_json(), encoding="utf-8")
        options = ["--title", "Hall B", "--author", "C", "--date", "today"]
        assert run("report", tmp_path, *options, "--quiet") == 0
        (tmp_path / "empty").mkdir()
        assert run("report", tmp_path / "empty") == 2
        assert "has no result.json" in capsys.readouterr().err
        assert run("report", tmp_path, "--title", "two\nlines") == 2
        assert "title has 'two\\nlines'" in capsys.readouterr().err
    for text in texts:
        assert "<h1>Hall &#34;A&#34; &lt;/style&gt;&lt;b&gt;</h1>" in text
        assert "· 2026-11-22 · B &amp; Sons" in text
        assert '"Hall \\22 A\\22  \\3c \\2f style\\3e \\3c b\\3e , 2026-11-22"' in text
        assert text.count("</style>") == 1
    written = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>Hall B</h1>" in written
    assert "· today · C" in written
    assert "BRAS CR2, seminar room: calibration" in written


def test_the_author_of_a_room_stands_on_its_pages(loop, tmp_path) -> None:
    room, measured = rt.datasets.bras_cr2()
    signed = rt.Room.from_text(room.replace(author="B & Sons").to_text(), "room.toml")
    assert signed.author == "B & Sons"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "_figures", no_figures)
        result = rt.calibrate(signed, measured)
        (tmp_path / "result.json").write_text(result.to_json(), encoding="utf-8")
        heading = document.Heading(author="C")
        for text in (
            page.calibration_page(result),
            pages.page_of(tmp_path),
            loop_page.page(replace(loop, room=signed)),
        ):
            assert "· B &amp; Sons" in text
        assert "· C" in page.calibration_page(result, heading=heading)
        assert "Sons" not in page.calibration_page(result, heading=heading).split("<main>")[0]
    with pytest.raises(DataError, match="author has"):
        room.replace(author="two\nlines")


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
    calibration = rt.calibrate(room, measured)
    assert words.compared(calibration) == "6 bands, 250 to 8000 Hz"


def test_half_a_surrogate_pair_is_refused_before_a_page_is_begun(result, tmp_path, capsys) -> None:
    text = result.to_json().replace("BRAS CR2", "BRAS \\ud800", 1)
    (tmp_path / "result.json").write_text(text, encoding="utf-8")
    assert run("report", tmp_path) == 2
    assert "half of a surrogate pair" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir() if not p.name.startswith(".rtcal_files")] == [
        "result.json"
    ]


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
    text = page.calibration_page(rt.calibrate(room, [1.0, 1.0]))
    assert "the 100 of 130 materials that absorb most" in text
    assert len(text.encode()) < document.MAX_BYTES
    monkeypatch.setattr(document, "MAX_BYTES", 1000)
    with pytest.raises(DataError, match="more than 1000"):
        page.calibration_page(rt.calibrate(room, [1.0, 1.0]))
