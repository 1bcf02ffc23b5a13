"""Path tracing against what is known: `python benchmarks/path_checks.py`; the figures of its page.

diffuse: a box of 5 x 7 x 3 m with scattering 1, T20 against Kuttruff's equation with gamma² from the
paths, and against Eyring's. specular: the same box with scattering 0, energy in 50 ms steps against
the image sources'. models: T20 of the two scattering models in the corridor. noise: the stated
standard error of T20 in the lecture hall against the spread over 12 seeds. engines: pyroomacoustics
against ours, both with vector scattering, in the lecture hall and the corridor; T20 (mean over
receivers) by the worst of seven bands with the noise of the difference there, and the energy of 0.5 s,
which pyroomacoustics counts up to twice where walls scatter. With scattering 0 the corridor's image
sources judge both, energy and T20.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

import rtcal as rt
from rtcal.acoustics.observables import TARGET
from rtcal.datasets import halls
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import PathTracing, jackknife
from rtcal.simulators.ray_tracing import RayTracing
from rtcal.simulators.shoebox import ImageSource

SIDES = (5.0, 7.0, 3.0)
ALPHAS = np.array([0.05, 0.1, 0.2, 0.3, 0.4])
POINTS = {
    "sources": {"S": (4.5, 3.5, 2.0)},
    "receivers": {"R1": (2.0, 2.0, 1.5), "R2": (1.2, 5.5, 1.6), "R3": (3.4, 5.1, 1.3)},
}
BIN = 0.002  # s, the tracers' own


def box(n_bands: int) -> rt.Room:
    """The box, all of one material, without air."""
    return rt.Room(
        name="box",
        volume=float(np.prod(SIDES)),
        materials=["wall"],
        areas=[142.0],
        alpha=np.full((1, n_bands), 0.2),
        sigma=np.full((1, n_bands), 0.1),
        dimensions=SIDES,
        centre_frequencies=125.0 * 2.0 ** np.arange(n_bands),
        scattering=np.ones((1, n_bands)),
    )


def t20(energy: np.ndarray) -> np.ndarray:
    """Mean over sources and receivers, (n_bands,)."""
    return TARGET.value(energy, BIN).mean(axis=(0, 1))


def diffuse(n_paths: int) -> None:
    room = box(len(ALPHAS))
    tracer = PathTracing(
        geometry=Polyhedron.shoebox(SIDES, "wall"), room=room, n_paths=n_paths, **POINTS
    )
    times = t20(tracer.energy(ALPHAS[np.newaxis], 4.0).mean(axis=0))
    gamma = tracer.traced(0, 1.0).free_paths[1]
    a = -np.log(1 - ALPHAS)
    eyring = 24 * np.log(10) / room.speed_of_sound * room.volume / (142.0 * a)
    kuttruff = eyring / (1 - gamma * a / 2)
    print(f"diffuse: gamma² {gamma:.3f}; alpha {ALPHAS}")
    print(f"  T20 over Kuttruff's, %: {(100 * (times / kuttruff - 1)).round(2)}")
    print(f"  T20 over Eyring's, %:   {(100 * (times / eyring - 1)).round(2)}")


def specular(n_paths: int) -> None:
    room, alpha, steps = box(1), np.full((1, 1), 0.15), 9
    tracer = PathTracing(
        geometry=Polyhedron.shoebox(SIDES, "wall"),
        room=room,
        n_paths=n_paths,
        scattering=0.0,
        **POINTS,
    )
    exact = ImageSource(room=room, duration=0.05 * steps, bin_width=BIN, **POINTS).decays(alpha)[0]
    found = tracer.energy(alpha, 0.6)[:, 0, :, 0]
    per, n = round(0.05 / BIN), round(0.05 / BIN) * steps
    found = found[..., :n].reshape(*found.shape[:2], steps, per).sum(axis=-1)
    exact = exact[:, 0, :n].reshape(-1, steps, per).sum(axis=-1)
    deviation = found.mean(axis=0) / exact - 1
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found)) / exact
    inside = np.mean(np.abs(deviation) < 2 * error)
    print(
        f"specular: {deviation.size} sums over 50 ms, {100 * inside:.0f} % within two standard "
        f"errors (median {100 * np.median(error):.1f} %), mean deviation "
        f"{100 * deviation.mean():.2f} %"
    )


def scattering_models(n_paths: int) -> None:
    hall = halls.corridor()
    alpha = np.full_like(hall.room.alpha, 0.2)
    times = [
        t20(
            PathTracing(
                geometry=hall.geometry,
                room=hall.room,
                sources=hall.sources,
                n_paths=n_paths,
                receivers=hall.receivers,
                scattering=0.1,
                scattering_model=scattering_model,
            )
            .energy(alpha, 2.0)
            .mean(axis=0)
        )[0]
        for scattering_model in ("random", "vector")
    ]
    print(
        f"models: corridor, scattering 0.1, alpha 0.2: T20 random {times[0]:.3f} s, vector "
        f"{times[1]:.3f} s, ratio {times[0] / times[1]:.2f}"
    )


def noise(n_paths: int) -> None:
    hall = halls.lecture_hall()
    tracer = PathTracing(
        geometry=hall.geometry,
        room=hall.room,
        sources={"S1": hall.sources["S1"]},
        receivers=hall.receivers,
        n_paths=n_paths,
    )
    runs = [tracer.simulate(hall.room.alpha, seed=seed) for seed in range(12)]

    def ratio(
        value: Callable[[rt.Measurement], np.ndarray],
        stated: Callable[[rt.Measurement], np.ndarray],
    ) -> float:
        spread = np.std([value(run) for run in runs], axis=0, ddof=1)
        return float(np.median(np.sqrt(np.mean([stated(r) ** 2 for r in runs], axis=0)) / spread))

    pair = ratio(lambda r: r.values["t20"], lambda r: r.uncertainty["t20"])
    mean = ratio(lambda r: r.mean("t20"), lambda r: r.mean_uncertainty("t20"))
    size = np.median([r.mean_uncertainty("t20") / r.mean("t20") for r in runs])
    print(
        f"noise: T20, {n_paths} paths, stated over found: pairs {pair:.2f}, their mean {mean:.2f} "
        f"(stated {100 * size:.1f} %)"
    )


def engines(name: str, scattering: float, seconds: float, n_rays: int) -> None:
    hall = getattr(halls, name)()
    common = {
        "geometry": hall.geometry,
        "room": hall.room,
        "scattering": scattering,
        "sources": {"S1": hall.sources["S1"]},
        "receivers": {**hall.receivers, **hall.held_out},
    }
    energies = [
        PathTracing(**common, n_paths=4 * n_rays, scattering_model="vector").energy(
            hall.room.alpha, seconds, seed=3
        ),
        RayTracing(**common, n_rays=n_rays, n_batches=16).energy(hall.room.alpha, seconds, seed=3),
    ]
    ours, theirs = (t20(e.mean(axis=0)) for e in energies)
    error = np.hypot(*(jackknife(t20, e) / t20(e.mean(axis=0)) for e in energies))
    deviation = theirs / ours - 1
    k = int(np.nanargmax(np.abs(deviation)))
    half = round(0.5 / BIN)
    means = [e.mean(axis=0) for e in energies]
    level = [e[0, ..., :half].sum(axis=-1) for e in means]
    print(
        f"engines: {name}, scattering {scattering:g}: T20 {100 * deviation[k]:+.1f} % (noise "
        f"{100 * error[k]:.1f} %) in the worst band, energy {(level[1] / level[0]).min():.2f} to "
        f"{(level[1] / level[0]).max():.2f} of ours",
        flush=True,
    )
    if scattering == 0 and hall.room.dimensions is not None:
        # One receiver at a time: each hears ten million images.
        exact = np.concatenate(
            [
                ImageSource(
                    room=hall.room,
                    sources=common["sources"],
                    receivers={r: place},
                    duration=seconds,
                    bin_width=BIN,
                ).decays(hall.room.alpha)[0]
                for r, place in common["receivers"].items()
            ]
        )
        times, sums = TARGET.value(exact, BIN), exact[..., :half].sum(axis=-1)
        for label, found, early in zip(("ours", "pyroomacoustics"), means, level, strict=True):
            ratio, share = TARGET.value(found[0], BIN) / times, early / sums
            print(
                f"  over the image sources', {label}: energy {share.min():.2f} to "
                f"{share.max():.2f}, mean {share.mean():.3f}; T20, of {np.isfinite(ratio).sum()} "
                f"that {seconds:g} s hold, {np.nanmin(ratio):.2f} to {np.nanmax(ratio):.2f}, mean "
                f"{np.nanmean(ratio):.3f}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--paths", type=int, default=64000)
    parser.add_argument("--rays", type=int, default=16000)
    arguments = parser.parse_args()
    diffuse(arguments.paths)
    specular(arguments.paths)
    scattering_models(arguments.paths // 4)
    noise(arguments.paths // 8)
    for name, seconds in (("lecture_hall", 1.6), ("corridor", 2.5)):
        for scattering in (1.0, 0.1, 0.0):
            engines(name, scattering, seconds, arguments.rays)


if __name__ == "__main__":
    main()
