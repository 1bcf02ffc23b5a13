"""The docs site builds without a warning, and nothing in it leads nowhere or needs the network."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zlib
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote, urlsplit

import pytest

import rtcal
from tests.browser import chromium, printed

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"

pytestmark = [
    pytest.mark.skipif(not DOCS.is_dir(), reason="needs the source tree"),
    pytest.mark.long,
]


class Page(HTMLParser):
    """A built page: its links, what it loads, and where it can be linked to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.tags: set[str] = set()
        self.emphasised: list[str] = []
        self._inside = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.add(tag)
        self._inside = tag
        self.anchors |= {v for k in ("id", "name") if (v := given.get(k))}
        if tag == "a" and (href := given.get("href")) is not None:
            self.links.append(href)
        source = given.get("src") or (given.get("href") if tag == "link" else None)
        if source is not None:
            self.loaded.append(source)

    def handle_data(self, data: str) -> None:
        if self._inside == "em":
            self.emphasised.append(data)
        self._inside = ""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
def pages(site: Path) -> dict[Path, Page]:
    # 404.html is served in place of any page, so its links begin at the root.
    return {p: Page(p) for p in site.rglob("*.html") if p.name != "404.html"}


def test_no_link_of_the_site_is_broken(site: Path, pages: dict[Path, Page]) -> None:
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


def test_the_site_is_read_without_network(site: Path, pages: dict[Path, Page]) -> None:
    for path, page in pages.items():
        for source in page.loaded:
            assert not urlsplit(source).netloc, f"{path.name} loads {source}"
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(@import|url\()[\"']?(https?:)?//", sheet.read_text("utf-8"))


def test_the_api_pages_hold_every_public_name(site: Path, pages: dict[Path, Page]) -> None:
    inventory = (site / "objects.inv").read_bytes().split(b"zlib.\n", 1)[1]
    documented = {line.split()[0] for line in zlib.decompress(inventory).decode().splitlines()}
    for value in (getattr(rtcal, name) for name in rtcal.__all__):
        if isinstance(value, ModuleType):
            module = value.__name__
            assert any(name.startswith(f"{module}.") for name in documented), module
        else:
            assert any(entry.endswith(f".{value.__qualname__}") for entry in documented), value
    assert "rtcal.calibration.result.CalibrationResult.gap_after" in documented


def test_text_is_not_taken_for_markup(pages: dict[Path, Page]) -> None:
    for path, page in pages.items():
        # A docstring's example without its heading "Examples" would be a quotation.
        assert "blockquote" not in page.tags, path.name
        # The stars of two alpha* would make what stands between them emphasised.
        for text in page.emphasised:
            assert re.match(r"\w", text), f"{path.name}: {text}"
    assert any(page.emphasised for page in pages.values())


def test_the_limits_page_leads_to_every_known_limit() -> None:
    text = (DOCS / "limits.md").read_text(encoding="utf-8")
    for page in sorted(DOCS.glob("*.md")):
        if "## Known limits" in page.read_text(encoding="utf-8"):
            assert f"({page.name}#known-limits)" in text, f"{page.name} has limits too"


def test_search_works_from_disk(site: Path, tmp_path: Path) -> None:
    url = (site / "index.html").as_uri()
    for query, least in (("schroeder", 3), ("xyzzyq", 0)):
        seen = chromium(tmp_path, f"{url}?q={query}", "--virtual-time-budget=15000", "--dump-dom")
        count = re.search(r'md-search-result__meta">(\d+|No) matching document', seen.stdout)
        assert count, seen.stdout[:500]
        assert (0 if count[1] == "No" else int(count[1])) >= least
        assert (count[1] == "No") == (least == 0)


_FRAMES = """<body><script>
const pages = %s, wide = [];
const frame = document.createElement("iframe");
frame.style.width = "400px";
document.body.append(frame);
frame.onload = () => {
  const root = frame.contentDocument.documentElement;
  if (root.scrollWidth > 400) wide.push(pages[0] + " " + root.scrollWidth);
  pages.shift();
  if (pages.length) frame.src = pages[0];
  else document.body.append("wide: [" + wide.join(", ") + "]");
};
frame.src = pages[0];
</script>"""


def test_no_page_is_wider_than_a_phone(site: Path, pages: dict[Path, Page], tmp_path: Path) -> None:
    harness = tmp_path / "frames.html"
    (tmp_path / "wide.html").write_text('<div style="width: 700px">x</div>')
    urls = [path.as_uri() for path in (*sorted(pages), tmp_path / "wide.html")]
    harness.write_text(_FRAMES % json.dumps(urls))
    arguments = ("--allow-file-access-from-files", "--virtual-time-budget=600000", "--dump-dom")
    seen = chromium(tmp_path, harness, *arguments)
    wide = re.findall(r"file://\S+ \d+", seen.stdout.rpartition("wide: [")[2])
    assert [w.rsplit("/", 1)[1] for w in wide] == ["wide.html 708"]


def test_formulas_are_drawn_without_a_script(site: Path) -> None:
    glossary = (site / "glossary.html").read_text(encoding="utf-8")
    assert glossary.count("<math") > 10
    for path in site.rglob("*.html"):
        assert "arithmatex" not in path.read_text(encoding="utf-8"), path.name


def test_a_printed_guide_is_the_guide_alone(site: Path, tmp_path: Path) -> None:
    """No navigation, numbered sheets, whole tables, no heading alone at the end of a sheet."""
    sheets = printed(tmp_path, site / "closed_loop.html")
    text = "\n".join(sheets)
    assert "Beside other documentation" not in text  # the last entry of the navigation
    assert "Table of contents" not in text
    for number, sheet in enumerate(sheets, start=1):
        assert f"Page {number} of {len(sheets)}" in sheet
    for rows in (
        ("ScatteringDelayNetwork", "EquationSimulator"),
        ("secant", "safeguarded"),
        ("converged  ", "not confirmed"),
    ):
        on = [[k for k, s in enumerate(sheets) if re.search(rf"^ *{r}", s, re.M)] for r in rows]
        assert on[0] == on[1], rows
        assert len(on[0]) == 1, rows
    for sheet in sheets:
        last = [line for line in sheet.splitlines() if line.strip()][-2]
        assert last.strip() not in ("Simulators", "A program run by hand", "Rules", "Known limits")
