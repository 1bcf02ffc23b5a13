"""Draw the picture of docs/where.md and the README: the plan with the surface that was found, the gap.

Run: python docs/figures/where.py
"""

import re
from pathlib import Path
from typing import Any

from rtcal.report import figures

DOCS = Path(__file__).parents[1]

if __name__ == "__main__":
    names: dict[str, Any] = {}
    page = (DOCS / "where.md").read_text(encoding="utf-8")
    example = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)[0]
    exec(compile(example, "where.md", "exec"), names)
    figure, axes = figures.new_figure(9.0, 5.0, 1, 2)
    figures.plan(names["finding"], axes=axes[0])
    figures.bars(names["verification"], axes[1])
    figures.save(figure, DOCS / "figures" / "where.svg")
