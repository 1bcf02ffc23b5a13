"""Pictures of the site as a reader sees it: on a wide screen, on a phone and on paper.

Run: python docs/screenshots.py FOLDER

Builds the site into FOLDER/site and opens it there with headless Chromium: start, a guide, the gallery,
a notebook and an API page, and a result's page, at 1400 and at 400 px, and as PDF.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import rtcal as rt
from rtcal.report import pages

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    "home": "index.html",
    "start": "start.html",
    "guide": "closed_loop.html",
    "gallery": "gallery.html",
    "notebook": "notebooks/studies/hidden_effects.html",
    "api": "api/terms.html",
}
SCREENS = {"wide": (1400, 1800), "phone": (400, 1600)}


def chromium(profile: str, url: str, *arguments: str) -> None:
    """Run headless Chromium once, without the network."""
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")
    place = f"--user-data-dir={profile}"
    command = ["chromium", *options, place, "--virtual-time-budget=4000", *arguments, url]
    subprocess.run(command, check=True, capture_output=True)


def framed(folder: Path, url: str, width: int, height: int) -> str:
    """Return the address of a page that shows ``url`` so wide: Chromium's own window is wider."""
    frame = folder / "frame.html"
    style = f"width:{width}px;height:{height}px;border:0"
    body = f'<body style="margin:0"><iframe src="{url}" style="{style}"></iframe>'
    frame.write_text(body, encoding="utf-8")
    return frame.as_uri()


def main(folder: Path) -> None:
    """Write every picture into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(folder / "site")],
        cwd=ROOT,
        check=True,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )
    page = pages.page(rt.calibrate(*rt.datasets.bras_cr2()))
    (folder / "report.html").write_text(page, encoding="utf-8")
    places = {name: folder / "site" / path for name, path in PAGES.items()}
    places["page"] = folder / "report.html"
    with tempfile.TemporaryDirectory() as profile:
        for name, path in places.items():
            for screen, (width, height) in SCREENS.items():
                shot = folder / f"{name}_{screen}.png"
                url = framed(folder, path.as_uri(), width, height)
                size = f"--window-size={width},{height}"
                chromium(
                    profile, url, size, f"--screenshot={shot}", "--allow-file-access-from-files"
                )
            chromium(profile, path.as_uri(), f"--print-to-pdf={folder / f'{name}.pdf'}")
    (folder / "frame.html").unlink()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
