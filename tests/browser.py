"""Headless Chromium, for tests of what a reader sees."""

import shutil
import subprocess
from pathlib import Path

import pytest


def chromium(place: Path, url: Path | str, *arguments: str) -> subprocess.CompletedProcess[str]:
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    if program is None:
        pytest.skip("needs Debian's chromium, which is not installed here")
    return subprocess.run(
        [
            program,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            f"--user-data-dir={place / 'profile'}",
            "--enable-logging=stderr",
            *arguments,
            url if isinstance(url, str) else url.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        cwd=place,
    )
