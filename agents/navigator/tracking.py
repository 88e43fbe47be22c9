"""How well a trajectory was followed: errors at each moment, and where the greatest of them are."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from agents.navigator.path import Array
from agents.navigator.routes import Route
from agents.navigator.trajectory import Trajectory

NEAR = 1.5
"""m along the way from a corner within which a peak is near it"""
HIGH = 1.5
"""times the RMS: an error above it begins a peak, which lasts until the error is below the RMS again"""


@dataclass(frozen=True)
class Errors:
    """(N,) each, but for ``off``."""

    t: Array
    """s since the beginning of what was flown"""
    off: Array
    """(N, 3) m NED: where it was, less where it should have been then"""
    along: Array
    """m of the route at which it should have been"""

    @property
    def size(self) -> Array:
        """(N,) m"""
        found: Array = np.linalg.norm(self.off, axis=1)
        return found


@dataclass(frozen=True)
class Peak:
    t: float
    """s"""
    error: float
    """m"""
    along: float
    """m of the route"""
    to_corner: float
    """m along the route to the nearest corner"""


@dataclass(frozen=True)
class Summary:
    """Metres, off where it should have been at the time, and seconds."""

    samples: int
    seconds: float
    length: float
    """of the route"""
    rms: float
    peak: float
    peaks: tuple[Peak, ...]
    near: float
    """m from a corner that count as near it"""
    share_near: float
    """of the peaks that are near a corner"""
    time_near: float
    """of the samples that are: what the share of the peaks would be if they were anywhere"""

    def document(self) -> dict[str, Any]:
        """For a status: plain and rounded."""
        found = {name: round(value, 3) if isinstance(value, float) else value for name, value in asdict(self).items()}
        found["peaks"] = [{name: round(value, 3) for name, value in asdict(peak).items()} for peak in self.peaks]
        return found

    def __str__(self) -> str:
        peaks = f"{round(self.share_near * len(self.peaks))} of {len(self.peaks)} peaks"
        return (
            f"{self.length:.1f} m in {self.seconds:.1f} s: RMS {self.rms:.3f} m, peak {self.peak:.3f} m; "
            f"{peaks} within {self.near:g} m of a corner, where {100 * self.time_near:.0f} % of the time is spent"
        )


def errors(times: npt.ArrayLike, positions: npt.ArrayLike, trajectory: Trajectory) -> Errors:
    """``times`` (N,) s since the trajectory's beginning, ``positions`` (N, 3) m NED: what of it is on the route itself,
    neither on the way to it nor after its end.
    """
    t, places = np.asarray(times, dtype=float), np.asarray(positions, dtype=float).reshape(-1, 3)
    mine = (t >= trajectory.begins) & (t <= trajectory.duration) & np.isfinite(places).all(axis=1)
    t, places = t[mine], places[mine]
    meant = trajectory.at(t)
    return Errors(t, places - meant.pos, meant.along - trajectory.route.begins)


def summarise(found: Errors, route: Route, near: float = NEAR) -> Summary:
    """Of the errors along a route."""
    if not len(found.t):
        raise ValueError("no position is on the route")
    size, corners = found.size, route.corners - route.begins
    away = np.abs(found.along[:, None] - corners).min(axis=1)
    rms = float(np.sqrt(np.mean(np.square(size))))
    where = _peaks(size, rms)
    peaks = tuple(Peak(float(found.t[k]), float(size[k]), float(found.along[k]), float(away[k])) for k in where)
    return Summary(
        samples=len(size),
        seconds=float(found.t[-1] - found.t[0]),
        length=route.length,
        rms=rms,
        peak=float(size.max()),
        peaks=peaks,
        near=near,
        share_near=sum(peak.to_corner <= near for peak in peaks) / len(peaks),
        time_near=float(np.mean(away <= near)),
    )


def _peaks(size: Array, rms: float) -> list[int]:
    """The greatest error of each stretch that rises above :data:`HIGH`; where none does, the greatest of all."""
    found: list[int] = []
    inside = False
    for k, error in enumerate(size):
        if not inside and error > HIGH * rms:
            inside = True
            found.append(k)
        elif inside and error < rms:
            inside = False
        elif inside and error > size[found[-1]]:
            found[-1] = k
    return found or [int(size.argmax())]
