"""A real room below its Schroeder frequency: held-out modes, before and after a calibration.

    python -m benchmarks.studies.room_modes.modes_real measurements_200_1kHz.mat

EPFL's room of Peić Tukuljac, Pham Vu, Lissek & Vandergheynst 2018 ("Joint estimation of the room
geometry and modes with compressed sensing", ICASSP): 3 x 5.6 x 3.53 m at 25 °C, T of 2.8 s, a
loudspeaker in one half, and 49 microphones of known place in the other. The file is of the public
repository epfl-lts2/joint_estimation_of_room_geometry_and_modes (matlab_code/data), which states no
licence: it is not part of this one. Where the loudspeaker stood is not published. It is put where the
patterns of the room's modes leave least of the responses, on a coarse grid of that half; decays are
not looked at.
"""

from __future__ import annotations

import itertools
import sys
import warnings

import numpy as np
from scipy.io import loadmat

import rtcal as rt
from rtcal.modes.measured import Spectra, fitted
from rtcal.modes.room_modes import RoomPoles
from rtcal.simulators.geometry import SHOEBOX_WALLS

LOWEST, HIGHEST = 20.0, 100.0
GRID = ((1.6, 2.2, 2.8), (3.4, 4.4, 5.4), (0.2, 0.8, 1.5, 2.4))
"""Places of the loudspeaker that are tried, m."""
SHARE = 0.5  # standard deviation of a coefficient, of itself
FOLDS = 3


def read(path):
    """Positions (49, 3) in m, responses (49, n), samples per second, sides in m, T in s, °C."""
    file = loadmat(path)
    names = ("RECEIVER_NUMBER", "SAMPLING_FREQUENCY", "REVERBERATON_TIME_60", "TEMPERATURE")
    count, rate, t, warm = (float(file[name].item()) for name in names)
    table = file["measurements"]
    n = len(table) // int(count)
    sides = np.array([float(file[name].item()) for name in ("Lx", "Ly", "Lz")])
    return table[::n, 1:4], table[:, 4].reshape(int(count), n), rate, sides, t, warm


def room_of(places, source, sides, t, warm):
    """The room, with the one coefficient of all walls that gives the published T."""

    def room(names, alpha):
        box = rt.simulators.Polyhedron.shoebox(sides, dict(zip(SHOEBOX_WALLS, names, strict=True)))
        return rt.Room.from_geometry(
            box,
            name="EPFL",
            materials=[rt.Material(m, alpha, SHARE * alpha) for m in dict.fromkeys(names)],
            dimensions=sides,
            centre_frequencies=[63, 125],
            air=rt.Air(warm, 50),
        )

    alike = rt.calibrate(room(["wall"] * 6, np.full(2, 0.1)), [t] * 2).alpha[0]
    heard_at = {f"R{k}": x for k, x in enumerate(places.tolist())}
    return room(SHOEBOX_WALLS, alike).replace(
        scene=rt.Scene(sources={"S": source}, receivers=heard_at)
    )


def left(room, responses, rate, pairs):
    """The larger of the shares that the room's modes leave: of power, and of amplitudes."""
    model = RoomPoles.of(room, 1.08 * HIGHEST)
    heard = Spectra.of(responses, rate, LOWEST, HIGHEST)
    fit = fitted(heard, model.calculated, model.amplitudes(pairs))
    return max(fit.unexplained, fit.strange)


def main(path):
    """Print the modes that were heard, and how well each third is predicted from the others."""
    warnings.simplefilter("ignore", RuntimeWarning)
    places, responses, rate, *stated = read(path)
    pairs = [("S", f"R{k}") for k in range(len(places))]
    tried = {
        source: left(room_of(places, source, *stated), responses, rate, pairs)
        for source in itertools.product(*GRID)
    }
    source = min(tried, key=tried.get)
    room = room_of(places, source, *stated)
    others = [v for k, v in tried.items() if k != source]
    print(
        f"loudspeaker at {source} m: {tried[source]:.2f} left; elsewhere {min(others):.2f} or more"
    )
    heard = rt.modes.find_modes(room, responses, rate, pairs, lowest=LOWEST, highest=HIGHEST)
    print(*heard.notes, sep="\n")
    n = len(heard.frequencies)
    before, after = np.empty(n), np.empty(n)
    for fold in range(FOLDS):
        out = np.arange(fold, n, FOLDS)
        result = rt.calibrate_modes(room, heard.only(np.setdiff1d(np.arange(n), out)))
        number = heard.calculated[out]
        before[out], after[out] = result.decays_before[number], result.decays_after[number]
    print("| mode / Hz | decay / 1/s | by T alone | by the other modes |\n|---|---|---|---|")
    rows = zip(heard.frequencies, heard.decays, heard.decay_uncertainty, before, after, strict=True)
    for f, d, u, old, new in rows:
        print(f"| {f:.1f} | {d:.2f} ± {u:.2f} | {old:.2f} | {new:.2f} |")
    off = [np.abs(np.log(x / heard.decays)).mean() for x in (before, after)]
    print(f"| mean error | | {off[0]:.2f} | {off[1]:.2f} |")
    same = np.abs(np.log(heard.decays / np.exp(np.log(heard.decays).mean()))).mean()
    print(f"One decay for all modes, their geometric mean, has a mean error of {same:.2f}.")
    result = rt.calibrate_modes(room, heard)
    print("| wall | stated | found | sigma |\n|---|---|---|---|")
    for name, old, new, sigma in zip(
        SHOEBOX_WALLS, room.alpha[:, 0], result.alpha[:, 0], result.sigma[:, 0], strict=True
    ):
        print(f"| {name} | {old:.3f} | {new:.3f} | {sigma:.3f} |")


if __name__ == "__main__":
    main(sys.argv[1])
