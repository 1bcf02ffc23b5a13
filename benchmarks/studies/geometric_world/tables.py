"""Measured absorption coefficients at 125 Hz to 4 kHz, as tables print them. Nothing of rtcal.

Source, unless a row says otherwise: Vorländer, Auralization (2008), appendix, which collects
reverberation room measurements. ``BB93``: Building Bulletin 93 (2003), section 7. rtcal's effects are
formulas (Miki, Ingard, a resonance) and values of Beranek and EN 12354-6, so none of these rows is
theirs.
"""

from __future__ import annotations

import numpy as np

TABLE_BANDS = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0])
Rows = dict[str, tuple[float, ...]]

FLOORS: Rows = {
    "linoleum on concrete": (0.02, 0.03, 0.03, 0.03, 0.03, 0.02),
    "stage floor": (0.10, 0.07, 0.06, 0.06, 0.06, 0.06),
    "wood on sleepers": (0.09, 0.06, 0.05, 0.05, 0.05, 0.04),
    "wood on studs": (0.18, 0.12, 0.10, 0.09, 0.08, 0.07),
    "thin carpet": (0.02, 0.04, 0.08, 0.20, 0.35, 0.40),
    "carpet on closed-cell foam": (0.03, 0.09, 0.25, 0.31, 0.33, 0.44),
}
CEILINGS: Rows = {
    "plasterboard on battens": (0.20, 0.15, 0.10, 0.08, 0.04, 0.02),
    "rough concrete": (0.02, 0.03, 0.03, 0.03, 0.04, 0.07),
    "acoustical plaster": (0.17, 0.36, 0.66, 0.65, 0.62, 0.68),
    "fissured tile": (0.49, 0.53, 0.53, 0.75, 0.92, 0.99),
    "hard average": (0.02, 0.02, 0.03, 0.03, 0.04, 0.05),
}
WALLS: Rows = {
    "deep pointing": (0.08, 0.09, 0.12, 0.16, 0.22, 0.24),
    "stuccoed brick": (0.03, 0.03, 0.03, 0.04, 0.05, 0.07),
    "rough lime wash": (0.02, 0.03, 0.04, 0.05, 0.04, 0.03),
    "double plasterboard": (0.15, 0.10, 0.06, 0.04, 0.04, 0.05),
    "wooden lining": (0.27, 0.23, 0.22, 0.15, 0.10, 0.07),
    "glazing, 30 mm gap": (0.15, 0.05, 0.03, 0.03, 0.02, 0.02),
}
ABSORBING: Rows = {
    "fibre absorber": (0.20, 0.56, 0.82, 0.87, 0.70, 0.53),
    "mineral wool, glued": (0.15, 0.70, 0.60, 0.60, 0.85, 0.90),
    "melamine wedges": (0.12, 0.33, 0.83, 0.97, 0.98, 0.95),
    "perforated chipboard": (0.41, 0.67, 0.58, 0.59, 0.68, 0.35),
}
"""Stated of a surface, of which a part is not there."""

HIDDEN: dict[str, Rows] = {
    "opening": {"open window": (1.0,) * 6},
    "porous": {
        "rockwool 50 mm, 80 kg/m³": (0.22, 0.60, 0.92, 0.90, 0.88, 0.88),
        "rockwool 50 mm, 40 kg/m³": (0.23, 0.59, 0.86, 0.86, 0.86, 0.86),
        "fabric-covered panel": (0.21, 0.66, 1.0, 1.0, 0.97, 0.98),
        "fibrous web mats": (0.07, 0.07, 0.20, 0.41, 0.75, 0.97),
        "melamine wedges": (0.12, 0.33, 0.83, 0.97, 0.98, 0.95),
        "mineral wool 25 mm (BB93)": (0.10, 0.35, 0.60, 0.70, 0.75, 0.80),
    },
    "curtain": {
        "0.2 kg/m², 90 mm": (0.05, 0.06, 0.39, 0.63, 0.70, 0.73),
        "fabric, 150 mm": (0.10, 0.38, 0.63, 0.52, 0.55, 0.65),
        "cotton, draped, 130 mm": (0.30, 0.45, 0.65, 0.56, 0.59, 0.71),
        "glass mat, 50 mm": (0.03, 0.03, 0.15, 0.40, 0.50, 0.50),
        "studio curtain, 220 mm": (0.36, 0.26, 0.51, 0.45, 0.62, 0.76),
        "folded fabric, 150 mm": (0.12, 0.60, 0.98, 1.0, 1.0, 1.0),
    },
    "resonator": {
        "thin plywood": (0.42, 0.21, 0.10, 0.08, 0.06, 0.06),
        "plywood on battens (BB93)": (0.40, 0.35, 0.20, 0.15, 0.05, 0.05),
        "plywood, 75 mm cavity (BB93)": (0.50, 0.30, 0.10, 0.05, 0.05, 0.05),
        "metal panels, 350 mm cavity": (0.59, 0.80, 0.82, 0.65, 0.27, 0.23),
        "microperforated glass": (0.10, 0.45, 0.85, 0.30, 0.10, 0.05),
        "double glazing, leaded": (0.15, 0.30, 0.18, 0.10, 0.05, 0.05),
    },
    "audience": {
        "on wooden chairs, 2 per m²": (0.24, 0.40, 0.78, 0.98, 0.96, 0.87),
        "on wooden chairs, 1 per m²": (0.16, 0.24, 0.56, 0.69, 0.81, 0.78),
        "0.72 per m²": (0.10, 0.21, 0.41, 0.65, 0.75, 0.71),
        "moderately upholstered": (0.72, 0.82, 0.91, 0.93, 0.94, 0.87),
    },
    "covered surface": {
        "rendered brickwork": (0.01, 0.02, 0.02, 0.03, 0.03, 0.04),
        "smooth concrete": (0.01, 0.01, 0.02, 0.02, 0.02, 0.05),
        "hard average": (0.02, 0.02, 0.03, 0.03, 0.04, 0.05),
    },
}
"""By the name of the effect in rtcal that is right; "covered surface": the absorber is not there."""


def at(row: tuple[float, ...], bands: np.ndarray) -> np.ndarray:
    """Return a row at octave bands; beyond the table's bands its edge values."""
    return np.interp(np.log2(bands), np.log2(TABLE_BANDS), row)
