"""The paper's claims in a notebook: one line each with its number and ours, and how many hold."""

from __future__ import annotations

from dataclasses import dataclass, field

VERDICTS = ("holds", "does not hold", "cannot be judged (stand-in)")


@dataclass
class Claims:
    """Lines of claim, the paper's number, ours, and one of `VERDICTS`.

    Examples
    --------
    >>> claims = Claims()
    >>> claims.add("Table 9: score / %", "4.4", "4.38", True)
    >>> claims.add("Fig. 99: a hall's T / s", "1.2", "1.3", None)
    >>> print(claims)
    claim                    paper  ours
    Table 9: score / %       4.4    4.38  holds
    Fig. 99: a hall's T / s  1.2    1.3   cannot be judged (stand-in)
    2 claims; holds: 1, does not hold: 0, cannot be judged (stand-in): 1
    """

    lines: list[tuple[str, str, str, str]] = field(default_factory=list)

    def add(self, what: str, paper: str, ours: str, holds: bool | None) -> None:
        """Note a claim; None for one of a room that is not published, of which we have a stand-in."""
        verdict = VERDICTS[2] if holds is None else VERDICTS[0 if holds else 1]
        self.lines.append((what, paper, ours, verdict))

    @property
    def counts(self) -> dict[str, int]:
        """The number of lines of each verdict."""
        return {verdict: sum(line[3] == verdict for line in self.lines) for verdict in VERDICTS}

    def __str__(self) -> str:
        rows = [("claim", "paper", "ours", ""), *self.lines]
        widths = [max(len(row[i]) for row in rows) for i in range(3)]
        shown = [
            "  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[3]])
            for row in rows
        ]
        counted = ", ".join(f"{verdict}: {n}" for verdict, n in self.counts.items())
        end = f"{len(self.lines)} claims; {counted}"
        return "\n".join([*(line.rstrip() for line in shown), end])
