"""Hooks of the docs site: notebooks become pages, formulas become MathML, the footer has the version.

The notebooks are shown as they are stored, with their outputs; nothing is run here. MathML needs no
script and no font from elsewhere: every browser draws it, also from disk and on paper.
"""

from __future__ import annotations

import html
import re
from importlib.metadata import version
from pathlib import Path
from typing import Any

import nbformat
from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

NOTEBOOKS = Path(__file__).parent / "notebooks"


def on_config(config: Any) -> Any:
    """Put the version into the footer of every page."""
    config.copyright = f"rtcal {version('rtcal')}"
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the changelog, and a page and the pictures of each notebook, where it stands in the tree."""
    changes = (NOTEBOOKS.parent / "CHANGELOG.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "changes.md", content=changes))
    for path in sorted(NOTEBOOKS.glob("*/*.ipynb")):
        folder = f"notebooks/{path.parent.name}"
        keys = {"unique_key": path.stem, "output_files_dir": f"{path.stem}_files"}
        notebook = nbformat.read(path, as_version=4)
        body, resources = MarkdownExporter().from_notebook_node(notebook, dict(keys))
        page = _linked(_with_words(body, notebook)).replace("](../../docs/", "](../../")
        if path.parent.name == "studies":  # for reviewers: linked, and not found by a search
            page = f"---\nsearch:\n  exclude: true\n---\n{page}"
        files.append(File.generated(config, f"{folder}/{path.stem}.md", content=page))
        for name, content in resources["outputs"].items():
            files.append(File.generated(config, f"{folder}/{name}", content=content))
    return files


def _with_words(body: str, notebook: nbformat.NotebookNode) -> str:
    """Give each picture its alternative text, which `Image` and `SVG` keep in the metadata."""
    words = [
        out.metadata[kind]["alt"]
        for cell in notebook.cells
        for out in cell.get("outputs", [])
        for kind in ("image/png", "image/svg+xml")
        if kind in out.get("data", {})
    ]
    return re.sub(r"!\[(?:png|svg)\]", lambda _: f"![{words.pop(0)}]", body)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Lead links to notebooks and the changelog in the source tree to their pages."""
    markdown = markdown.replace("](../CHANGELOG.md)", "](changes.md)")
    return _linked(markdown).replace("](../notebooks/", "](notebooks/")


def on_page_content(content: str, **_: Any) -> str:
    """Turn the formulas that pymdownx.arithmatex has marked into MathML, and mark numbers in tables.

    A number in a cell is then not broken after the sign of its exponent.
    """
    content = re.sub(
        r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', _formula, content, flags=re.S
    )
    return re.sub(r"<td>([-+\d.e]+)</td>", r'<td class="number">\1</td>', content)


def _formula(found: re.Match[str]) -> str:
    tag, latex = found.groups()
    formula = convert(html.unescape(latex), display="inline" if tag == "span" else "block")
    return f'<{tag} class="formula">{formula}</{tag}>'


def _linked(markdown: str) -> str:
    return re.sub(r"(\]\([^)\s:]+)\.ipynb\)", r"\1.md)", markdown)
