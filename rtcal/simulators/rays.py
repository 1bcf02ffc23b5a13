"""A polyhedron for rays: its triangles' planes, directions, and which positions see each other."""

from __future__ import annotations

import numpy as np

from rtcal.errors import DataError
from rtcal.simulators import path_numpy
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.types import Array


def planes(geometry: Polyhedron) -> tuple[Array, Array]:
    """Return each triangle's plane (inward normal, offset) and its two barycentric functions.

    A point x of the plane lies in the triangle where n·x - d is 0 or more for both rows of
    ``sides`` (n_triangles, 2, 4), and their sum at most 1 (Havel & Herout 2010).
    """
    a, b, c = np.moveaxis(geometry.triangles, 1, 0)
    u, v = b - a, c - a
    normal = np.cross(u, v)
    square = np.sum(normal**2, axis=1, keepdims=True)
    rows = np.stack([np.cross(v, normal) / square, np.cross(normal, u) / square], axis=1)
    offsets = np.einsum("tij,tj->ti", rows, a)[..., np.newaxis]
    inward = -normal / np.sqrt(square)
    equations = np.hstack([inward, np.sum(inward * a, axis=1, keepdims=True)])
    return equations, np.ascontiguousarray(np.concatenate([rows, offsets], axis=2))


def sphere(n: int, rng: np.random.Generator) -> Array:
    """Return n directions of a Fibonacci lattice on the sphere, rotated at random."""
    height = 1 - (2 * np.arange(n) + 1) / n
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    across = np.sqrt(1 - height**2)
    lattice = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    rotation, upper = np.linalg.qr(rng.standard_normal((3, 3)))
    return np.ascontiguousarray(lattice @ (rotation * np.sign(np.diag(upper))))


def direct_lengths(geometry: Polyhedron, sources: Array, receivers: Array) -> Array:
    """Return the lengths of the direct sounds in m, (n_sources, n_receivers), NaN where hidden."""
    walls, sides = planes(geometry)
    lengths = np.empty((len(sources), len(receivers)))
    for s, source in enumerate(sources):
        vectors = receivers - source
        lengths[s] = np.linalg.norm(vectors, axis=1)
        if not lengths[s].all():
            raise DataError("a source and a receiver are at the same place")
        directions = vectors / lengths[s][:, np.newaxis]
        origins = np.tile(source, (len(vectors), 1))
        _, t = path_numpy.nearest(origins, directions, walls, sides)
        lengths[s, t < lengths[s]] = np.nan
    return lengths
