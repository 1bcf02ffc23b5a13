"""What commands print, as the pages show it: `python -m benchmarks.shown docs/design.md ...` stores it.

A block of ```text below a block of ```console is what the last of its commands prints, below a block of
```python what that block prints. A block with a title, as ```toml title="room.toml", is a file of this
name. The blocks of a page run one after the other, beginning in an empty folder; its Python runs in one
namespace. A line "[...]" stands for lines that are not shown.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = "[...]"
BLOCKS = re.compile(
    r'^```(?:(console|python)|\w+ title="([^"\n]+)")\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?',
    re.M | re.S,
)


def run(words: list[str], folder: Path) -> str:
    """Run Python with these arguments in a folder; return what it prints in 100 columns."""
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "COLUMNS": "100"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{words} ended with {done.returncode}: {done.stderr}")
    return "".join(f"{line.rstrip()}\n" for line in done.stdout.splitlines())


def printed(commands: str, folder: Path) -> tuple[str, Path]:
    """Run the commands of a block; return what the last prints, and the folder where they end."""
    text = ""
    for line in commands.splitlines():
        prompt, _, command = line.partition("$ ")
        words = shlex.split(command)
        if prompt or not words:
            raise ValueError(f"{line!r} is no command: begin it with '$ '")
        if words[0] == "cd":
            folder = folder / words[1]
            continue
        if words[0] != "rtcal":
            raise ValueError(f"{line!r}: only rtcal and cd can be run")
        files = [str(p) for w in words[1:] for p in (sorted(folder.glob(w)) if "*" in w else [])]
        arguments = [w for w in words[1:] if "*" not in w]
        text = run(["-m", "rtcal", *arguments[:1], *files, *arguments[1:]], folder)
    return text, folder


def outputs(page: Path) -> Iterator[tuple[str, str, str]]:
    """Yield each block that shows what it prints, that text, and what is shown."""
    blocks = BLOCKS.findall(page.read_text(encoding="utf-8"))
    last = max((i for i, (*_, shown) in enumerate(blocks) if shown), default=-1)
    before = ""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for language, file, block, shown in blocks[: last + 1]:
            text = ""
            if file:
                (folder / file).write_text(block, encoding="utf-8")
            elif language == "console":
                text, folder = printed(block, folder)
            elif shown:
                text = run(["-c", f"{before}\nprint('\\0')\n{block}"], folder).rpartition("\0\n")[2]
            if language == "python":
                before += block
            if shown:
                yield block, text, shown


def agrees(text: str, shown: str) -> bool:
    """Whether the shown lines are those printed, but for what a line "[...]" leaves out."""
    parts = [re.escape(part) for part in re.split(rf"(?m)^{re.escape(LEFT_OUT)}\n", shown)]
    return re.fullmatch("(?:.*\n)*".join(parts), text) is not None


def store(page: Path) -> None:
    """Put what the commands print into a page; blocks that leave lines out are not changed."""
    content = page.read_text(encoding="utf-8")
    for block, text, shown in outputs(page):
        if LEFT_OUT not in shown:
            above = f"{block}```\n\n```text\n"
            content = content.replace(f"{above}{shown}```\n", f"{above}{text}```\n")
        elif not agrees(text, shown):
            print(f"{page}: {block!r} prints\n{text}")
    page.write_text(content, encoding="utf-8")


if __name__ == "__main__":
    for name in sys.argv[1:]:
        store(Path(name))
