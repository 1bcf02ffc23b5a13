"""One symbol per thing: `alpha` in code, α in sentences and formulas; S the areas, S_tot their sum."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*/*.ipynb"))

pytestmark = pytest.mark.skipif(not NOTEBOOKS, reason="needs the source tree")

_CODE_BLOCK = re.compile(r"^( *)(`{3,}).*?^ *\2", re.M | re.S)
_FORMULA = re.compile(r"\$\$.+?\$\$|\$[^$\n]+\$", re.S)
_CODE = re.compile(r"`[^`]+`")
_TARGET = re.compile(r"\]\([^)]*\)")
# A Greek letter that is spelled, a subscript or a power that is not typeset, a transpose as S'.
_SPELLED = re.compile(
    r"(?<![\w-])(alphas?|[Ss]igmas?|mu|gamma|theta)(?!\w|\.\w|-square)|\b[A-Za-z]_[A-Za-z]{1,2}\b|\bS'"
    r"|[^\W\d]²|\bsqrt\(|\bexp\(|[⁻^]"
)
_UNIT = re.compile(r"\b(k?m|s)²")
_AREA = re.compile(r"S_(?!\\mathrm\{tot\}|\{?[ijnN1-9])")


def violations(text: str) -> list[str]:
    """Return what breaks the rule of docs/glossary.md, in a page's Markdown."""
    text = _TARGET.sub("]", _CODE_BLOCK.sub("", text))
    wrong = [m[0] for f in _FORMULA.findall(text) for m in _AREA.finditer(f)]
    sentences = re.split(r"(?<=[.:;|])\s|\n\n", _FORMULA.sub("", text))
    wrong += [s for s in sentences if "`alpha`" in s and "α" in s]
    prose = _UNIT.sub("", _CODE.sub("", _FORMULA.sub("", text)))
    return wrong + [m[0] for m in _SPELLED.finditer(prose)]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_a_page_has_one_symbol_per_thing(page: Path) -> None:
    assert not violations(page.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_the_text_of_a_notebook_has_one_symbol_per_thing(path: Path) -> None:
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "markdown":
            assert not violations("".join(cell["source"]))


@pytest.mark.parametrize(
    "text",
    [
        "The error of alpha falls.",
        "the sum S'α",
        "a wall of $S_t$ in all",
        "`alpha` is the α of a material.",
    ],
)
def test_a_second_symbol_is_seen(text: str) -> None:
    assert violations(text)
