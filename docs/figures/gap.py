"""Draw the README's figure: the gap of the seminar room that ships, before and after.

Run: python docs/figures/gap.py
"""

from pathlib import Path

import rtcal as rt
from rtcal.report import figures

if __name__ == "__main__":
    result = rt.calibrate(*rt.datasets.bras_cr2())
    figures.save(figures.gap(result), Path(__file__).with_suffix(".svg"))
