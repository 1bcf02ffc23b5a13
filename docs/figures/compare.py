"""Draw the figure of docs/compare.md: `rtcal example compare`.

Run: python docs/figures/compare.py
"""

from pathlib import Path

import rtcal as rt
from rtcal.datasets.examples import example
from rtcal.report import figures

if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        for name, content in example("compare").files.items():
            (Path(folder) / name).write_bytes(content)
        room = rt.Room.from_file(f"{folder}/room.toml")
        measured, simulated = (
            rt.Measurement.from_file(f"{folder}/{name}.csv") for name in ("pairs", "run")
        )
    found = rt.compare(room, measured, rt.Run(room, simulated))
    figures.save(figures.disagreement(found), Path(__file__).with_suffix(".svg"))
