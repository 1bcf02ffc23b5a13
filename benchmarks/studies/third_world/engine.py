"""An echogram by misuka, of a room of the third world. Nothing else imports misuka."""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path
from typing import Any

import misuka
import numpy as np

from benchmarks.studies.second_world.rooms import BANDS
from benchmarks.studies.third_world.rooms import HIDDEN, PATHS, RADIUS, WIDTH, Made

misuka.set_variant("llvm_ad_acoustic")


def surface(alpha: np.ndarray, scattering: float) -> dict[str, Any]:
    bands = [(float(f), float(a)) for f, a in zip(BANDS, alpha, strict=True)]
    return {
        "type": "acousticbsdf",
        "absorption": {"type": "spectrum", "value": bands},
        "scattering": scattering,
    }


def quad(a: np.ndarray, b: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return the upright rectangle above the segment from a to b, seen from its left: (4, 3)."""
    return np.array([[*a, low], [*a, high], [*b, high], [*b, low]])


def faces(made: Made, alpha: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray | None]]:
    """Return quadrilaterals, what they absorb inside, and behind where there is a second room."""
    out: list[tuple[np.ndarray, np.ndarray, np.ndarray | None]] = []
    ends = {"floor": 0.0, "ceiling": made.height}
    for (x0, y0), (x1, y1) in made.boxes:
        for name, z in ends.items():
            corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
            out.append((corners, alpha[made.owner[name]], None))
    steps = np.roll(made.plan, -1, axis=0) - made.plan
    along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    behind, depth, other = made.second if made.second is not None else (-1, 0.0, None)
    for strip in made.strips:
        if strip.material == HIDDEN and made.hidden is None:
            continue  # an aperture
        absorbs = made.hidden if strip.material == HIDDEN else alpha[strip.material]
        a, b = (made.plan[strip.wall] + at * along[strip.wall] for at in (strip.begin, strip.end))
        back = other if strip.wall == behind else None
        out.append((quad(a, b, 0.0, made.height), absorbs, back))
    if other is not None:
        a, b = made.plan[behind], made.plan[behind] + steps[behind]
        outward = depth * np.array([along[behind][1], -along[behind][0]])
        round_it = [a, a + outward, b + outward, b]
        for p, q in itertools.pairwise(round_it):
            out.append((quad(p, q, 0.0, made.height), other, None))
        for z in ends.values():
            out.append((np.array([[*p, z] for p in round_it]), other, None))
    return out


def ply(path: Path, corners: np.ndarray) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    rows = "".join("{:.9g} {:.9g} {:.9g}\n".format(*p) for p in corners)
    path.write_text(head + rows + "3 0 1 2\n3 0 2 3\n")


def echogram(
    made: Made,
    alpha: np.ndarray,
    source: np.ndarray,
    receiver: np.ndarray,
    length: float,
    c: float,
    seed: int,
) -> np.ndarray:
    """Return energy per bin without the direct sound and without air, (n_bands, n_bins), in 1/m²."""
    n_bins = round(length / WIDTH)
    scene: dict[str, Any] = {
        "type": "scene",
        "source": {
            "type": "sphere",
            "center": source.tolist(),
            "radius": RADIUS,
            "bsdf": surface(np.full(len(BANDS), 1e-3), 1.0),
            "emitter": {"type": "area", "radiance": {"type": "uniform", "value": 1.0}},
        },
        "microphone": {
            "type": "microphone",
            "origin": receiver.tolist(),
            "direction": [1, 0, 0],
            "kappa": 0.0,
            "film": {
                "type": "tape",
                "frequencies": ", ".join(f"{f:g}" for f in BANDS),
                "time_bins": n_bins,
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent", "sample_count": PATHS},
        },
    }
    with tempfile.TemporaryDirectory() as folder:
        for i, (corners, inside, behind) in enumerate(faces(made, alpha)):
            path = Path(folder) / f"{i}.ply"
            ply(path, corners)
            sides = {"front": surface(inside, made.scattering)}
            if behind is not None:
                sides["back"] = surface(behind, made.scattering)
            scene[f"face{i}"] = {
                "type": "ply",
                "filename": str(path),
                "face_normals": True,
                "sides": {"type": "twosided", **sides},
            }
        loaded = misuka.load_dict(scene)
    integrator = misuka.load_dict(
        {
            "type": "acoustic_path",
            "max_time": n_bins * WIDTH,
            "speed_of_sound": c,
            "max_energy_loss": -1.0,
            "hide_emitters": True,
        }
    )
    heard = np.array(misuka.render(loaded, integrator=integrator, seed=seed, spp=PATHS))
    # The direct sound is r²/(4 d²); of a unit source it is 1/(4 pi d²).
    return heard[:, :, 0].T.astype(float) / (np.pi * RADIUS**2)
