"""The bias of a short decay by an octave filter: forwards, as is usual, and backwards, as rtcal does.

White noise with an exact exponential decay goes through the filter of `rtcal.io.impulse_responses`;
the expected energy behind it is the decay convolved (forwards) or correlated (backwards) with the
square of the filter's response, so nothing is random: `python benchmarks/filter_bias.py`.
"""

from __future__ import annotations

import numpy as np

from rtcal.io import impulse_responses

RATE, LENGTH, CENTRE = 16_000, 32_000, 125.0


def main() -> None:
    pulse = np.zeros(LENGTH)
    pulse[-1] = 1  # filtered backwards: the response comes out turned round
    response = impulse_responses._filtered(pulse, RATE, CENTRE, 1)[::-1]
    spectrum = np.fft.rfft(response, 2 * LENGTH)
    print(f"{CENTRE:g} Hz octave; error of the decay times in %, forwards | backwards")
    for t in (0.05, 0.1, 0.2, 0.5):
        n = int(3 * t * RATE)
        decay = np.exp(-6 * np.log(10) / t * np.arange(LENGTH) / RATE)
        sound = np.fft.rfft(decay, 2 * LENGTH)
        forward = np.maximum(np.fft.irfft(spectrum * sound), 0)[:LENGTH]
        backward = np.maximum(np.fft.irfft(spectrum.conj() * sound), 1e-16)[:n]
        forward = forward[int(np.argmax(forward)) :][:n]
        shown = []
        for energy in (forward, backward):
            found = impulse_responses.of_energy(energy, RATE)[0]
            shown.append(
                "  ".join(
                    f"{p.upper()} {100 * (found[p] / t - 1):6.1f}" for p in ("edt", "t20", "t30")
                )
            )
        print(f"T {t:4} s, B T {0.71 * CENTRE * t:5.1f}: {' | '.join(shown)}")


if __name__ == "__main__":
    main()
