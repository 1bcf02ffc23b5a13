"""Hooks of the docs site: every stored notebook becomes a page, and links to a notebook lead to it.

The notebooks are shown as they are stored, with their outputs; nothing is run here.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

NOTEBOOKS = Path(__file__).parent / "notebooks"


def on_files(files: Files, config: Any) -> Files:
    """Add a page and the pictures of each notebook under notebooks/, where it stands in the tree."""
    for path in sorted(NOTEBOOKS.glob("*/*.ipynb")):
        folder = f"notebooks/{path.parent.name}"
        keys = {"unique_key": path.stem, "output_files_dir": f"{path.stem}_files"}
        body, resources = MarkdownExporter().from_filename(str(path), dict(keys))
        page = _linked(body).replace("](../../docs/", "](../../")
        files.append(File.generated(config, f"{folder}/{path.stem}.md", content=page))
        for name, content in resources["outputs"].items():
            files.append(File.generated(config, f"{folder}/{name}", content=content))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Lead links to notebooks in the source tree to their pages."""
    return _linked(markdown).replace("](../notebooks/", "](notebooks/")


def _linked(markdown: str) -> str:
    return re.sub(r"(\]\([^)\s:]+)\.ipynb\)", r"\1.md)", markdown)
