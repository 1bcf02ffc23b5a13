"""Draw the pictures of docs/gallery.md by the lines that the page shows.

Run: python docs/figures/gallery.py
"""

import re
from pathlib import Path
from typing import Any

from rtcal.report import figures

DOCS = Path(__file__).parents[1]

if __name__ == "__main__":
    names: dict[str, Any] = {}
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    for block, picture in re.findall(
        r"^```python\n(.*?)^```\n\n!\[[^\]]*\]\(([^)]*)\)", page, re.M | re.S
    ):
        exec(compile(block, "gallery.md", "exec"), names)
        figures.save(names["figure"], DOCS / picture)
