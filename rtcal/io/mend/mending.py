"""One mesh while it is mended: its corners, its limits, and the defects found so far."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from rtcal.io.mend.defects import Defect, MeshError, combined
from rtcal.io.mend.faces import Edge, Faces, Work
from rtcal.support.types import Array

MOST_PLACES = 5
ANY_SHARE = 1 / np.sqrt(3)
"""Of an area of which any share may count, all shares alike: rms of what is missing or too much."""
_FOUND = ". Found, too: "


class Mending:
    """One mesh while it is mended; ``points`` are the corners in m."""

    def __init__(
        self, drawn: Faces, weld: float, offset: float, largest_hole: float | None
    ) -> None:
        self.path, self.weld, self.offset, self.largest_hole = (
            drawn.path,
            weld,
            offset,
            largest_hole,
        )
        self.defects: list[Defect] = []
        self.drawn = drawn
        self.points: Array = np.zeros((0, 3))
        self.used: list[int] = []

    def found(
        self,
        kind: str,
        done: str,
        places: Sequence[str],
        area: float = 0.0,
        volume: float = 0.0,
        surface: float = 0.0,
        uncertainty: float = 0.0,
        number: int | None = None,
        unsure: Iterable[tuple[str, float]] = (),
    ) -> None:
        """Add a defect of these places, with its effects in m², m³ and m².

        ``unsure`` are materials with a standard uncertainty of area in m² each.
        """
        self.defects.append(
            Defect(
                kind,
                len(places) if number is None else number,
                area,
                volume,
                surface,
                uncertainty,
                tuple(places[:MOST_PLACES]),
                done,
                combined(unsure),
            )
        )

    def refused(self, message: str, edges: Sequence[Edge] = ()) -> MeshError:
        """Return the error that says what is wrong; all defects that were found are in it, too."""
        error = MeshError(f"{self.path}: {message}")
        error.edges = self.points[np.array(edges, dtype=int).reshape(-1, 2)]
        return self.told(error)

    def told(self, error: MeshError) -> MeshError:
        """Return an error of this mesh with all defects that were found."""
        reason = str(error).partition(_FOUND)[0]
        others = f"{_FOUND}{'; '.join(map(str, self.defects))}" if self.defects else ""
        complete = MeshError(f"{reason}{others}")
        complete.defects, complete.edges = tuple(self.defects), error.edges
        return complete

    def corners(self, work: Work) -> Array:
        """Return the corners of some faces in m, (n, 3)."""
        return self.points[sorted({v for face in work.faces for v in face})]

    def place(self, corner: int) -> str:
        """Return a corner's coordinates in words."""
        return "(" + ", ".join(f"{x:.4g}" for x in self.points[corner]) + ") m"
