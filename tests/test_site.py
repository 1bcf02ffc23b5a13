"""The docs site builds without a warning, and nothing in it leads nowhere or needs the network."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"

pytestmark = [
    pytest.mark.skipif(not DOCS.is_dir(), reason="needs the source tree"),
    pytest.mark.long,
]


class Page(HTMLParser):
    """A built page: its links, what it loads, and where it can be linked to."""

    def __init__(self, path):
        super().__init__()
        self.links = []
        self.loaded = []
        self.anchors = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.anchors |= {v for k in ("id", "name") if (v := given.get(k))}
        if tag == "a" and (href := given.get("href")) is not None:
            self.links.append(href)
        source = given.get("src") or (given.get("href") if tag == "link" else None)
        if source is not None:
            self.loaded.append(source)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    pytest.importorskip("mkdocstrings", reason="needs the extra docs")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site):
    # 404.html is served in place of any page, so its links begin at the root.
    return {p: Page(p) for p in site.rglob("*.html") if p.name != "404.html"}


def test_no_link_of_the_site_is_broken(site, pages):
    broken, count = [], 0
    for path, page in pages.items():
        for target in {*page.links, *page.loaded}:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            file = path if not parts.path else (path.parent / unquote(parts.path)).resolve()
            if file.is_dir():
                file = file / "index.html"
            anchors = pages[file].anchors if file in pages else set()
            count += 1
            if not file.is_file() or (parts.fragment and unquote(parts.fragment) not in anchors):
                broken.append(f"{path.relative_to(site)}: {target}")
    assert not broken
    assert count > 1000  # the pages and their links were found at all


def test_the_site_is_read_without_network(site, pages):
    for path, page in pages.items():
        for source in page.loaded:
            assert not urlsplit(source).netloc, f"{path.name} loads {source}"
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(@import|url\()[\"']?(https?:)?//", sheet.read_text("utf-8"))
