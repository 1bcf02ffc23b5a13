"""The pages in a browser, on a phone, in the dark and on paper."""

from __future__ import annotations

import re

import numpy as np
import pytest

import rtcal as rt
from rtcal.report import (
    document,
    figures,
    loop_page,
    page,
    positions_page,
)
from tests.browser import chromium, printed
from tests.report.pages import FINDING
from tests.report.rooms import MEASURED, calibrated, renamed
from tests.seams.test_exports_hold_the_room_or_say_what_they_lose import fitted

pytestmark = pytest.mark.long


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
        "loop": loop_page.page(loop),
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


_WIDE = """<body><iframe style="width: 1400px; height: 900px" src="%s"></iframe><script>
document.querySelector("iframe").onload = event => {
  const inside = event.target.contentDocument, beyond = [];
  for (const box of inside.querySelectorAll(".wide"))
    if (box.scrollWidth > box.clientWidth + 1) beyond.push(box.textContent.trim().slice(0, 30));
  document.body.append("beyond: [" + beyond.join("; ") + "] ");
};</script>"""


def test_no_table_is_behind_a_scrollbar_on_a_screen(tmp_path) -> None:
    """The third column of materials and the last of six bands were."""
    long = calibrated(tmp_path)
    names = [f"{name}_with_a_name_of_some_length" for name in long.prior.materials]
    mesh = (tmp_path / "room.obj").read_text(encoding="utf-8")
    for old, new in zip(long.prior.materials, names, strict=True):
        mesh = re.sub(rf"(?m)^usemtl {re.escape(old)}$", f"usemtl {new}", mesh)
    (tmp_path / "room.obj").write_text(mesh, encoding="utf-8")
    pages = {
        "room": page.calibration_page(rt.calibrate(renamed(long.prior, names), MEASURED)),
        "fit": positions_page.page(fitted(), document.Heading(), lambda: None),
        "control": '<div class="wide" style="overflow: auto"><p style="width: 2000px">wide</p></div>',
    }
    assert "Decay times: means" in pages["fit"]
    assert 'id="room-parts"' in pages["room"]
    seen = {}
    for name, text in pages.items():
        document.write(tmp_path / f"{name}.html", text)
        frame = tmp_path / "frame.html"
        frame.write_text(_WIDE % f"{name}.html")
        arguments = ("--allow-file-access-from-files", "--virtual-time-budget=9000", "--dump-dom")
        found = re.findall(r"beyond: \[(.*?)\] ", chromium(tmp_path, frame, *arguments).stdout)
        seen[name] = found[-1]
    assert seen == {"room": "", "fit": "", "control": "wide"}


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
    document.write(
        tmp_path / "p.html", page.calibration_page(rt.calibrate(room, [1.6] * 6), heading=heading)
    )
    sheets = printed(tmp_path, tmp_path / "p.html")
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
