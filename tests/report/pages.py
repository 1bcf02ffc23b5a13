"""Shared by the tests of the pages: a room of evil names, a finding, the command."""

import numpy as np

import rtcal as rt

EVIL = "<script>alert(1)</script> & \"double\" 'single' $x_1$ --> ]]>"


def evil_room() -> rt.Room:
    return rt.Room(
        name=f"Hall <b>bold</b> {EVIL}",
        volume=100,
        materials=[EVIL, "<img src=x onerror=alert(2)>"],
        areas=[80.0, 60.0],
        alpha=[[0.1, 0.2, 0.2], [0.3, 0.4, 0.5]],
        sigma=np.full((2, 3), 0.05),
        centre_frequencies=[500, 1000, 2000],
        air=rt.Air(),
        sources={EVIL: EVIL},
    )


def no_figure(*_: object) -> str:
    """In place of a page's figure, where its drawing is not what is tested."""
    return "data:,"
