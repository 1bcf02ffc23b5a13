"""The page of any saved result: a finding's and a verification's, or that of `rtcal.report.page`."""

from __future__ import annotations

import os
from collections.abc import Callable

from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.verification import MeansVerification
from rtcal.finder.positions.finding import PositionsFinding
from rtcal.finder.positions.verification import PositionsVerification
from rtcal.report import gap_report, page, where_folder
from rtcal.report.document import Heading
from rtcal.support.arguments import checked
from rtcal.support.results import load


@checked
def page_of(
    path: str | os.PathLike[str],
    *,
    heading: Heading | None = None,
    progress: Callable[[], None] | None = None,
) -> str:
    """Return the page of a saved result; see `rtcal.report.page.page_of`.

    The result does not hold the names of its files. So the page of a finding of means has its case as
    a file within it, and that of a finding at positions has no command to reproduce it.
    """
    result = load(path)
    if isinstance(result, MeansFinding | MeansVerification):
        verified = result if isinstance(result, MeansVerification) else None
        found = result if isinstance(result, MeansFinding) else result.finding
        return gap_report.page(
            found, verified, gap_report.figures(found, verified), heading=heading
        )
    if isinstance(result, PositionsFinding | PositionsVerification):
        proved = result if isinstance(result, PositionsVerification) else None
        where = result if isinstance(result, PositionsFinding) else result.finding
        figures = where_folder.drawn(where, proved)
        return where_folder.page(where, proved, figures, heading or Heading())
    return page.page_of(path, heading=heading, progress=progress)
