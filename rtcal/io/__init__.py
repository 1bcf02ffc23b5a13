"""Foreign formats, each ``read(path)`` and ``write(room, path)``.

`catt`, `odeon`, `pyroomacoustics`, `bras`: material lists. `obj`: a room's mesh. `tables`:
measured values in CSV. `impulse_responses`: WAV files to a `Measurement` (``rtcal[measurement]``).
"""

from rtcal.io import bras, catt, impulse_responses, obj, odeon, pyroomacoustics, tables

__all__ = ["bras", "catt", "impulse_responses", "obj", "odeon", "pyroomacoustics", "tables"]
