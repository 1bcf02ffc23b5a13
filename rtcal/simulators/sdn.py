"""Scattering delay network: the reverberation of a shoebox from six nodes on its walls.

Each node stands where the first-order reflection from source to receiver meets its wall. Delay lines
join the nodes. First-order reflections are exact. Later ones have the right density and the walls'
losses, and cost much less than image sources.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.observables import TARGET
from rtcal.simulators.base import check_alpha
from rtcal.simulators.shoebox import ShoeboxSimulator
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_NODES = 6
_STEP = 1e-20  # of the derivatives: its square vanishes beside 1 in floats
_PORTS = 5
# Per mean free path. Fewer samples change T at alpha = 0.3 by more than one JND
# (test_the_lowest_sampling_rate_has_the_right_t20).
_LEAST_SAMPLES = 10
# Port j of node k leads to node j if j < k, else to node j + 1: no line joins a node to itself.
_NEIGHBOUR = np.array([[j + (j >= k) for j in range(_PORTS)] for k in range(_NODES)])


class Network(NamedTuple):
    """The delays in samples and lengths in m of one source-receiver pair; its arrays are read-only.

    ``lines`` and ``line_lengths`` (6, 5) lead from node to node, ``source_delays`` and
    ``source_lengths`` (6,) from the source to the nodes, ``tap_delays`` and ``tap_lengths`` (6,)
    from the nodes to the receiver.
    """

    lines: NDArray[np.int64]
    line_lengths: Array
    source_delays: NDArray[np.int64]
    source_lengths: Array
    tap_delays: NDArray[np.int64]
    tap_lengths: Array
    direct_delay: int
    direct_length: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ScatteringDelayNetwork(ShoeboxSimulator):
    """A scattering delay network (SDN) of a shoebox, all bands at once.

    Node k scatters the waves p+ from its five neighbours and p_S from the source:

        p- = beta (A (p+ + p_S / 2)),   A = (2/5) 1 1' - I,   beta = sqrt(1 - alpha).

    The receiver hears (2/5) sum p-. The gain is 1/d from the source to a node,
    1/(1 + d_nr/d_sn) from a node to the receiver, 1 between nodes, and 1/d along the line of sight.
    Air attenuates every line by exp(-m d / 2). Delays are d fs / c, rounded so that first-order
    reflections arrive within half a sample.

    At high absorption T20 spans few arrivals and depends on the positions: average at least four
    positions, or leave the line of sight out.

    The method is covered by US patent 8,908,875 B2 (De Sena, Hacihabiboglu, Cvetkovic; granted
    2014). Its use in a product may need a licence.

    Parameters
    ----------
    room : Room
        A shoebox: with dimensions, and a surface for each of
        `rtcal.simulators.geometry.SHOEBOX_WALLS` or a single material. The simulation takes its
        bands, air and speed of sound, not its alpha.
    sources, receivers : mapping of name to (x, y, z)
        Positions in m, inside the room.
    sampling_rate : float
        In Hz. Delays are whole samples, so the mean free path 4V/S needs at least 10 samples.
    line_of_sight : bool
        Whether the response contains the direct sound.
    longest : float
        Largest length of the responses in s. They are as long as T20 needs, up to this limit.

    Raises
    ------
    DataError
        If the room is no shoebox, a position is outside it, or the sampling rate is too low.

    References
    ----------
    E. De Sena, H. Hacihabiboglu, Z. Cvetkovic, J. O. Smith: Efficient synthesis of room acoustics
    via scattering delay networks. IEEE/ACM Trans. Audio Speech Lang. Process. 23(9), 2015.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> room = Room(name="box", volume=105, materials=["all"], areas=[142], alpha=[[0.3]],
    ...             sigma=[[0.1]], centre_frequencies=[1000], dimensions=(5, 7, 3))
    >>> sdn = ScatteringDelayNetwork(
    ...     room=room, sources={"S": (4.5, 3.5, 2)}, receivers={"R": (2, 2, 1.5)})
    >>> print(sdn.simulate(room.alpha).mean("t20").round(2))
    [0.46]
    """

    sampling_rate: float = 44100.0
    line_of_sight: bool = True
    longest: float = 20.0
    networks: tuple[Network, ...] = field(init=False)

    def __post_init__(self) -> None:
        for name, unit in (("sampling_rate", "Hz"), ("longest", "s")):
            checks.positive(name, getattr(self, name), unit)
        checks.flag("line_of_sight", self.line_of_sight)
        super().__post_init__()
        rate = self.sampling_rate / self.room.speed_of_sound
        if (least := _LEAST_SAMPLES / self.mean_free_path) > rate * (1 + 1e-9):
            raise DataError(
                f"sampling_rate = {self.sampling_rate:g} Hz is too low for delays in whole samples: "
                f"at least {least * self.room.speed_of_sound:.0f} Hz are {_LEAST_SAMPLES} samples "
                "along this room's mean free path"
            )
        positions = product(self.box.sources, self.box.receivers)
        networks = (_network(self.box.dimensions, s, r, rate) for s, r in positions)
        object.__setattr__(self, "networks", tuple(networks))

    @property
    def name(self) -> str:
        """Name that calibrated coefficients belong to."""
        return f"scattering delay network ({self.sampling_rate:g} Hz)"

    @property
    def mean_free_path(self) -> float:
        """Mean free path 4V/S in m."""
        return 4 * self.room.volume / self.room.total_area

    def impulse_responses(self, alpha: Array, duration: float) -> Array:
        """Return the pressure responses, (n_pairs, n_bands, n_samples), from the emission on.

        ``duration`` is in s, at most ``longest``. A band's response is the full-band response with its
        coefficients, not filtered.
        """
        alpha = check_alpha(self, alpha)
        if checks.positive("duration", duration, "s") > self.longest:
            raise DataError(f"duration = {duration:g} s is above longest = {self.longest:g} s")
        n = max(int(np.ceil(duration * self.sampling_rate)), 1)
        reflection = np.sqrt(1 - alpha[self.box.walls])
        out = np.empty((len(self.networks), alpha.shape[1], n))
        for response, network in zip(out, self.networks, strict=True):
            self._render(network, reflection, response)
        return out

    def decays(self, alpha: Array) -> tuple[Array, float]:
        """Return energy decays that hold T20, or of ``longest``, and the width of their bins in s."""
        duration = min(self._estimate(check_alpha(self, alpha)), self.longest)
        while True:
            energy = self._from_onset(self.impulse_responses(alpha, duration)) ** 2
            if duration >= self.longest or not TARGET.too_short(energy).any():
                return energy / (4 * np.pi), 1 / self.sampling_rate
            duration = min(1.6 * duration, self.longest)

    def _wall_gradients(self, alpha: Array, n_bins: int) -> Iterator[Array]:
        """Yield each pair's derivatives, by an imaginary step of each wall's reflection factor.

        A response is a polynomial in the reflection factors, so Im p(beta + i h) / h is its derivative
        to rounding (Squire & Trapp 1998, SIAM Review 40(1)).
        """
        reflection = np.sqrt(1 - alpha[self.box.walls])
        n = n_bins + max(network.direct_delay for network in self.networks)
        steps = 1j * _STEP * np.eye(len(reflection))[:, :, np.newaxis]
        response = np.empty((alpha.shape[1], n), dtype=complex)
        for network in self.networks:
            gradient = np.empty((len(reflection), alpha.shape[1], n_bins))
            for wall, step in enumerate(steps):
                self._render(network, reflection + step, response)
                heard = response[:, network.direct_delay :][:, :n_bins]
                # E = p² / (4 pi), and d beta / d alpha = -1 / (2 beta).
                by_beta = 2 * heard.real * heard.imag / (_STEP * 4 * np.pi)
                gradient[wall] = -by_beta / (2 * reflection[wall])[:, np.newaxis]
            yield gradient

    def _estimate(self, alpha: Array) -> float:
        """Return Eyring's T in s of the most reverberant band, at least 0.1, plus the first delay.

        T20 needs two thirds of T.
        """
        t = Eyring().time(self.room, self.room.areas @ alpha).max()
        travel = max(n.direct_delay for n in self.networks) / self.sampling_rate
        return float(max(t, 0.1) + travel)

    def _from_onset(self, responses: Array) -> Array:
        """Return the responses from the time of the direct sound on, all of one length."""
        delays = [network.direct_delay for network in self.networks]
        length = responses.shape[2] - max(delays)
        return np.stack(
            [r[:, delay : delay + length] for r, delay in zip(responses, delays, strict=True)]
        )

    def _render(self, network: Network, reflection: NDArray[Any], out: NDArray[Any]) -> None:
        """Write one pair's responses, (n_bands, n_samples); complex for complex reflection factors."""
        from rtcal.simulators import kernels

        half = self.room.air_attenuation / 2
        lines = np.exp(-half * network.line_lengths[..., np.newaxis])
        source = network.source_lengths[:, np.newaxis]
        tap = network.tap_lengths[:, np.newaxis]
        injected = np.exp(-half * source) / source
        heard = np.exp(-half * tap) / (1 + tap / source)
        out[:] = kernels.blocks(
            network.lines,
            network.source_delays,
            network.tap_delays,
            lines,
            reflection,
            injected,
            heard,
            out.shape[1],
        )
        if self.line_of_sight and network.direct_delay < out.shape[1]:
            r = network.direct_length
            out[:, network.direct_delay] += np.exp(-half * r) / r


def _network(dimensions: Array, source: Array, receiver: Array, rate: float) -> Network:
    """Place the nodes of one pair on the walls; ``rate`` in samples per m."""
    nodes = np.empty((_NODES, 3))
    for wall in range(_NODES):
        axis, far = divmod(wall, 2)
        plane = dimensions[axis] if far else 0.0
        to_source, to_receiver = abs(source[axis] - plane), abs(receiver[axis] - plane)
        share = to_source / (to_source + to_receiver)
        nodes[wall] = source + share * (receiver - source)
        nodes[wall, axis] = plane
    between = np.linalg.norm(nodes[:, np.newaxis] - nodes, axis=-1)
    lengths = np.take_along_axis(between, _NEIGHBOUR, axis=1)
    from_source = np.linalg.norm(nodes - source, axis=1)
    from_nodes = np.linalg.norm(nodes - receiver, axis=1)
    direct = float(np.linalg.norm(receiver - source))
    source_delays = np.rint(rate * from_source).astype(np.int64)
    first_order_delays = np.rint(rate * (from_source + from_nodes)).astype(np.int64)
    made = Network(
        lines=np.maximum(np.rint(rate * lengths).astype(np.int64), 1),
        line_lengths=lengths,
        source_delays=source_delays,
        source_lengths=from_source,
        tap_delays=first_order_delays - source_delays,
        tap_lengths=from_nodes,
        direct_delay=int(np.rint(rate * direct)),
        direct_length=direct,
    )
    for values in made[:6]:
        values.setflags(write=False)
    return made
