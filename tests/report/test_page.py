"""The page of a calibration: what it says, and that names in it stay text."""

import base64
import re
from xml.etree import ElementTree

import numpy as np
import pytest

import rtcal as rt
from rtcal.report import document, pages
from rtcal.support.errors import DataError
from tests.conftest import run
from tests.report.pages import no_figure


@pytest.mark.long
def test_the_page_has_its_numbers_and_pictures(html, result):
    for text in ("15.6", "2.49", "1.40", "1.7e-05", "19.5 °C", result.measured_data.fingerprint):
        assert text in html, text
    assert len(html.encode()) < document.MAX_BYTES
    assert html.count("data:image/svg+xml") == 3


def test_the_page_needs_nothing_else(html, evil_html):
    for text in (html, evil_html):
        assert not re.search(r"<script|<iframe|<object|@import|url\(", text, re.I)
        targets = re.findall(r'(?:src|href)="([^"]*)"', text)
        assert len(targets) > 5
        assert all(t.startswith(("data:", "#")) for t in targets)


def test_names_are_text_in_page_and_pictures(evil_html):
    text = evil_html
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; &#34;double&#34; &#39;single&#39;" in text
    assert "&lt;img src=x onerror=alert(2)&gt;" in text
    assert not re.search(r"<script|<img src=x|<b>bold", text)
    pictures = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', text)
    assert len(pictures) == 3
    for picture in pictures:
        content = base64.b64decode(picture)
        tags = {
            e.tag.rpartition("}")[2]
            for e in ElementTree.fromstring(content).iter()
            if isinstance(e.tag, str)
        }
        assert "path" in tags
        assert not tags & {"script", "image", "foreignObject", "b"}


def test_the_page_reproduces_itself(html, result, tmp_path, monkeypatch):
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


@pytest.mark.long
def test_large_rooms_stay_below_the_limit(monkeypatch):
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
    monkeypatch.setattr(document, "source", no_figure)
    text = pages.page(rt.calibrate(room, [1.0, 1.0]))
    assert "30 further rows are in result.json" in text
    assert len(text.encode()) < document.MAX_BYTES
    monkeypatch.setattr(document, "MAX_BYTES", 1000)
    with pytest.raises(DataError, match="at most 1000"):
        pages.page(rt.calibrate(room, [1.0, 1.0]))


def test_title_author_and_date_are_text(result, monkeypatch):
    """Also in the style sheet that prints them on each sheet."""
    monkeypatch.setattr(document, "source", no_figure)
    heading = document.Heading('Hall "A" </style><b>', "B & Sons", "2026-11-22")
    text = pages.page(result, heading=heading)
    assert "<h1>Hall &#34;A&#34; &lt;/style&gt;&lt;b&gt;</h1>" in text
    assert "· 2026-11-22 · B &amp; Sons" in text
    assert text.count("</style>") == 1
    assert pages.page(result) == pages.page(result)
