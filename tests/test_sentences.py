"""Sentences of the pages are short enough to be said back."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]
MOST = 34
"""Words of a sentence. The pages' mean is under 22."""

pytestmark = pytest.mark.skipif(not PAGES[0].exists(), reason="needs the source tree")

_BLOCK = re.compile(r"^( *)(`{3,}|\$\$).*?^ *\2|^ {4}[^\n]*$", re.M | re.S)
_AS_A_WORD = re.compile(r"`[^`]+`|\$[^$\n]+\$")
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_WORD = re.compile(r"\w*[^\W\d]\w*")  # a number is none: versions and intervals are lists
_ROW = re.compile(r"^\|.*$", re.M)  # a cell lists with semicolons
_NEXT_PARAGRAPH = re.compile(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )|\n(?=\s*\|)|\|")
_NEXT_SENTENCE = re.compile(r"(?<=[.!?])(?:\*\*)?\s+(?=[^a-z\s])")


def too_long(text, most=MOST):
    """Return the sentences of a page in Markdown with more than ``most`` words."""
    prose = _AS_A_WORD.sub("Code", _BLOCK.sub("\n\n", text))
    prose = _LINK.sub(r"\1", prose)
    prose = _ROW.sub(lambda row: row[0].replace(";", "|"), prose)
    sentences = (s for p in _NEXT_PARAGRAPH.split(prose) for s in _NEXT_SENTENCE.split(p))
    return [" ".join(s.split()) for s in sentences if len(_WORD.findall(s)) > most]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_no_sentence_is_too_long(page):
    assert not too_long(page.read_text(encoding="utf-8"))


def test_a_long_sentence_is_seen_and_a_list_is_none():
    words = " ".join(["word"] * 25)
    assert too_long(f"A {words} and\n{words}.")
    assert not too_long(f"A {words}. A\n{words}.")
    assert not too_long(f"- {words}\n- {words}\n\n| {words} | {words} |\n\n{words}")
    assert not too_long(f"```\n{words} {words}\n```\n`{words} {words}`")
