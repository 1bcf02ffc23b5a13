"""The pages in a browser, on a phone, in the dark and on paper."""

import numpy as np
import pytest

from tests.browser import chromium

pytestmark = pytest.mark.long


def test_in_a_browser(html, evil_html, tmp_path):
    """The text is there, nothing is complained of on the console, and the pictures are drawn."""
    from matplotlib.image import imread

    ordinary, nasty, control = (tmp_path / f"{n}.html" for n in ("page", "evil", "control"))
    ordinary.write_text(html, encoding="utf-8")
    nasty.write_text(evil_html, encoding="utf-8")
    seen = chromium(tmp_path, ordinary, "--dump-dom")
    assert "Technical details" in seen.stdout
    assert "plaster" in seen.stdout
    assert "CONSOLE" not in seen.stderr
    picture = tmp_path / "page.png"
    shot = chromium(tmp_path, nasty, f"--screenshot={picture}", "--window-size=1000,4000")
    assert "CONSOLE" not in shot.stderr
    pixels = imread(picture)[:, :, :3]
    blue = np.abs(pixels - np.array([0x00, 0x72, 0xB2]) / 255).max(axis=2) < 0.02
    assert blue.sum() > 200  # dots and lines of the pictures; nothing else on the page is blue
    # The console is read indeed: a script, which the page's policy forbids, is complained of.
    control.write_text(
        html.replace("</body>", "<script>alert(1)</script></body>"), encoding="utf-8"
    )
    assert "CONSOLE" in chromium(tmp_path, control, "--dump-dom").stderr


def test_dark_mode_is_dark_in_its_figures_too(html, tmp_path):
    """A white figure in a dark page dazzles."""
    from matplotlib.image import imread

    (tmp_path / "p.html").write_text(html, encoding="utf-8")
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
