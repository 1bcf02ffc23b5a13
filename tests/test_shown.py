"""The pages show what their commands print."""

import pytest

from benchmarks import shown

PAGES = [
    shown.ROOT / "README.md",
    *(p for p in sorted((shown.ROOT / "docs").glob("*.md")) if "```text" in p.read_text("utf-8")),
]

pytestmark = pytest.mark.skipif(
    not (shown.ROOT / "README.md").exists(), reason="needs the source tree"
)


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_a_page_shows_what_its_commands_print(page):
    for block, text, on_page in shown.outputs(page):
        assert shown.agrees(text, on_page), f"{block}prints\n{text}"


def test_a_page_runs_its_python_and_writes_its_files(tmp_path):
    page = tmp_path / "page.md"
    python = (
        "```python\nx = 1\nprint(x)\n```\n\n```python\nprint(open('a.csv').read(), x + 1)\n```\n"
    )
    page.write_text(f'```csv title="a.csv"\n1,2\n```\n\n{python}\n```text\n?\n```\n', "utf-8")
    shown.store(page)
    assert page.read_text("utf-8").endswith("```text\n1,2\n 2\n```\n")
