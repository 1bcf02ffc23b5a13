"""Draw the pictures of docs/gallery.md by the lines that the page shows.

Run: python docs/figures/gallery.py [SECTION ...]

With SECTION, only the pictures of the sections whose titles begin so; the first one always runs, since
the others use its names. A section that says whose names it uses begins with that page's first example.
"""

import re
import sys
from pathlib import Path
from typing import Any

from rtcal.report import figures

DOCS = Path(__file__).parents[1]
_EXAMPLE = re.compile(r"^```python\n(.*?)^```", re.M | re.S)
_PICTURE = re.compile(r"^```py(?:thon)?\n(.*?)^```\n\n!\[[^\]]*\]\(([^)]*)\)", re.M | re.S)
_WITH = re.compile(r"^With .*\]\((\w+\.md)\):", re.M)


def draw(section: str, names: dict[str, Any]) -> None:
    """Run the lines of a section and save its pictures."""
    for page in _WITH.findall(section):
        example = _EXAMPLE.findall((DOCS / page).read_text(encoding="utf-8"))[0]
        exec(compile(example, page, "exec"), names)
    for block, picture in _PICTURE.findall(section):
        exec(compile(block, "gallery.md", "exec"), names)
        figures.save(names["figure"], DOCS / picture)


if __name__ == "__main__":
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    first, *others = page.split("\n## ")[1:]
    names: dict[str, Any] = {}
    draw(first, names)
    for section in others:
        if len(sys.argv) == 1 or section.startswith(tuple(sys.argv[1:])):
            draw(section, names)
