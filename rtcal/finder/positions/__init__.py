"""Say where: what is other than stated in a geometry, and on which surface.

    >>> import rtcal as rt
    >>> case = rt.finder.case_of(room, measured)     # doctest: +SKIP
    >>> print(rt.find(case))                         # doctest: +SKIP

docs/where.md has the method and what it can and cannot do.
"""

from typing import TYPE_CHECKING

from rtcal import support

if TYPE_CHECKING:
    from rtcal.finder.positions.places import next_position as next_position
else:
    __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
