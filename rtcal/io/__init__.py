"""Formats of other programs; most are ``read(path)`` and ``write(room, path)``.

`catt`, `odeon`, `pyroomacoustics` and `bras` are formats of material lists (`material_formats`),
`library` reads product data, `mesh` a room's mesh as it comes, `obj` one that closes, `tables` measured
values, `sofa` responses with their positions, `balloon` what a loudspeaker radiates. `geometry_files`
makes a path tracing of a room that states its scene. `impulse_responses` turns sound and SOFA files
into a `Measurement`, `recordings` those of a sweep or of noise that is stopped; both need
``rtcal[measurement]``. Each module is imported at its first use.
"""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.io import balloon as balloon
    from rtcal.io import geometry_files as geometry_files
    from rtcal.io import impulse_responses as impulse_responses
    from rtcal.io import library as library
    from rtcal.io import mesh as mesh
    from rtcal.io import obj as obj
    from rtcal.io import recordings as recordings
    from rtcal.io import sofa as sofa
    from rtcal.io import tables as tables
    from rtcal.io.material_list import bras as bras
    from rtcal.io.material_list import catt as catt
    from rtcal.io.material_list import odeon as odeon
    from rtcal.io.material_list import pyroomacoustics as pyroomacoustics
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
