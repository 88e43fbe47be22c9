"""The frequency response to a chirp, by the cross-spectrum of what was injected and what came of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agents.controllers.inject import TAPER, Inject
from agents.controllers.types import Array

PER_DECADE = 30
"""frequencies of the response"""
HALF_WIDTH = 2.0 ** (1.0 / 16.0)
"""a band reaches from its middle by this factor either way"""
LEAST_BINS = 5
"""of the Fourier transform in each band: from fewer, no coherence tells anything"""
TRUSTED = 0.6
"""coherence below which gain and phase are not relied upon"""
USABLE = 0.4
"""of the sampling rate: what is faster is not judged"""
DOWN = 1.0 / math.sqrt(2.0)
"""-3 dB"""
RESONANT = 1.02
"""a gain above that is told as a resonance"""


@dataclass
class Chirp:
    """The closed loop from reference to measured value. Arrays (K,), from the lowest frequency to the highest."""

    frequency: Array
    """Hz"""
    gain: Array
    """1: it follows wholly"""
    phase: Array
    """rad, negative: it lags; goes on past -pi"""
    coherence: Array
    """0 to 1: how much of the response comes of what was injected"""
    bandwidth: float | None = None
    """Hz up to which the gain is above -3 dB; None: not within the chirp"""
    phase_there: float | None = None
    """rad at the bandwidth"""
    peak: float | None = None
    """the greatest gain"""
    peak_frequency: float | None = None

    @property
    def trusted(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """(K,) where gain and phase are to be relied upon."""
        return self.coherence >= TRUSTED

    def rows(self) -> list[tuple[str, str]]:
        """Each measure's name and its value with its unit."""
        width, phase = "not within the chirp", "unknown"
        if self.bandwidth is not None and self.phase_there is not None:
            width, phase = f"{self.bandwidth:.3g} Hz", f"{math.degrees(self.phase_there):.0f}°"
        peak = "unknown" if self.peak is None else "none"
        if self.peak is not None and self.peak_frequency is not None and self.peak > max(RESONANT, self.gain[0]):
            peak = f"{decibel(self.peak):+.1f} dB at {self.peak_frequency:.3g} Hz"
        least = f"{self.coherence.min():.2f} to {self.coherence.max():.2f}"
        return [("bandwidth (-3 dB)", width), ("phase there", phase), ("resonance peak", peak), ("coherence", least)]


def decibel(gain: float) -> float:
    """dB of an amplitude's ratio."""
    return 20.0 * math.log10(max(gain, 1e-9))


def chirp_of(args: Inject, t: Array, response: Array, injected: Array, period: float, notes: list[str]) -> Chirp:
    """``t`` (N,) s, ``response`` and ``injected`` (N,) of the whole record; doubts are added to ``notes``.

    One transform of it all, averaged over bands that are as wide as their frequency is high: a chirp begins and ends at
    zero, so that no window is needed, and the cross-spectrum over the chirp's own is the gain that noise in the
    response leaves unbiased (J. Bendat and A. Piersol, "Random Data", chapter 6).
    """
    grid = np.arange(t[0], t[-1], period)
    u, y = np.interp(grid, t, injected), np.interp(grid, t, response)
    fade = min(len(grid) // 10, max(1, int((t[-1] - args.seconds) / period)))
    y[-fade:] *= 0.5 * (1.0 + np.cos(np.linspace(0.0, math.pi, fade)))  # what is left at the end would be a jump
    cross = np.fft.rfft(y) * np.conj(np.fft.rfft(u))
    power, came = np.abs(np.fft.rfft(u)) ** 2, np.abs(np.fft.rfft(y)) ** 2
    bins = np.fft.rfftfreq(len(grid), period)
    faded = args.f1 * (args.f0 / args.f1) ** (TAPER / 2.0)  # what is left above is too little
    top = min(faded, USABLE / period)
    if top < faded:
        notes.append(f"above {top:.3g} Hz there are too few samples a period")
    rows: list[tuple[float, float, float, float]] = []
    for middle in np.geomspace(args.f0, top, max(3, int(PER_DECADE * math.log10(top / args.f0)))):
        low, high = np.searchsorted(bins, (middle / HALF_WIDTH, middle * HALF_WIDTH))
        short = LEAST_BINS - (high - low)
        if short > 0:
            low = max(1, low - (short + 1) // 2)
            high = low + LEAST_BINS
        band = slice(int(low), int(high))
        sent, got, both = float(power[band].sum()), float(came[band].sum()), complex(cross[band].sum())
        where = float((bins[band] * power[band]).sum()) / sent
        if rows and where <= rows[-1][0]:
            continue
        rows.append(
            (where, abs(both) / sent, math.atan2(both.imag, both.real), abs(both) ** 2 / max(sent * got, 1e-30))
        )
    frequency, gain, phase, coherence = np.array(rows).T
    found = Chirp(frequency, gain, phase, coherence)
    good = found.trusted
    found.phase[good] = np.unwrap(phase[good])  # that of noise would lead astray
    _measure(found, notes)
    return found


def _measure(found: Chirp, notes: list[str]) -> None:
    """Bandwidth and peak, of what is to be relied upon."""
    good = found.trusted
    if good.sum() < 3:
        notes.append(f"coherence is below {TRUSTED:g} nearly everywhere: inject more, or for longer")
        return
    if not good.all():
        worst = found.frequency[~good]
        notes.append(f"coherence is below {TRUSTED:g} between {worst[0]:.2g} and {worst[-1]:.2g} Hz: not relied upon")
    frequency, gain, phase = found.frequency[good], found.gain[good], found.phase[good]
    top = int(np.argmax(gain))
    found.peak, found.peak_frequency = float(gain[top]), float(frequency[top])
    down = np.flatnonzero(gain < DOWN)
    if len(down) == 0:
        notes.append(f"the bandwidth is above {frequency[-1]:.3g} Hz")
        return
    k = int(down[0])
    if k == 0:
        notes.append(f"it is 3 dB down at {frequency[0]:.3g} Hz already")
        return
    pair = slice(k - 1, k + 1)
    levels, log = [-decibel(float(each)) for each in gain[pair]], np.log(frequency[pair])
    at = float(np.interp(-decibel(DOWN), levels, log))
    found.bandwidth, found.phase_there = math.exp(at), float(np.interp(at, log, phase[pair]))
