"""Figures and pages of results, loops and findings."""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.report import document as document
    from rtcal.report import figures as figures
    from rtcal.report import pages as pages
    from rtcal.report import study_report as study_report
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
