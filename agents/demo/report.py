"""What a demo comes to: a table for the terminal, and the same as JSON beside the recording."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Group
from rich.text import Text

from agents.demo.play import Play
from zmav.cli.common import table

COLUMNS = ("vehicle", "is a", "relays", "flown", "highest", "setpoints", "dropped", "MAVLink lost", "RTT", "at the end")
SLOW = 0.95
"""of the pace that was asked for: a simulation that is slower is told of"""


def rows(play: Play) -> list[dict[str, Any]]:
    """One of each vehicle: distances in m by the simulator's truth, the rest as the ground heard it."""
    found = []
    for name in play.demo.vehicles:
        track = play.watch.tracks[name] if play.watch else None
        state = play.watch.state(name) if play.watch else None
        told = state.setpoints if state else {}
        found.append(
            {
                "vehicle": name,
                "kind": f"{state.autopilot} {state.kind}" if state else "?",
                "relays": play.demo.relays(name),
                "flown_m": play.truth.flown(name),
                "highest_m": play.truth.highest(name),
                "setpoints": told.get("flown", 0) + told.get("held", 0),
                "dropped": {reason: n for reason, n in told.items() if reason not in ("flown", "held") and n},
                "mavlink_lost": track.mavlink_lost if track else 0,
                "mavlink_frames": track.mavlink_frames if track else 0,
                "rtt_s": statistics.median(track.rtts) if track and track.rtts else None,
                "end": f"{'armed' if state.armed else 'disarmed'} in {state.mode}" if state else "not heard",
            }
        )
    return found


def summary(play: Play) -> Group:
    """For a person."""
    drawn = table(COLUMNS, right=COLUMNS[2:-1])
    for row in rows(play):
        rtt = row["rtt_s"]
        drawn.add_row(
            row["vehicle"],
            row["kind"],
            str(row["relays"]),
            f"{row['flown_m']:.0f} m",
            f"{row['highest_m']:.0f} m",
            str(row["setpoints"]),
            str(sum(row["dropped"].values())),
            f"{row['mavlink_lost']}/{row['mavlink_frames']}",
            "-" if rtt is None else f"{1e3 * rtt:.1f} ms",
            row["end"],
        )
    return Group(drawn, Text("; ".join(_words(play))))


def _words(play: Play) -> list[str]:
    truth, found = play.truth, []
    if len(truth.names) > 1 and truth.rows:
        a, b = truth.pair
        least = f" (at least {play.demo.story.apart:g} m asked)" if play.demo.story.apart else ""
        found.append(f"closest approach {truth.closest:.2f} m, {a} and {b} after {truth.closest_at:.0f} s{least}")
    if slow := slow_words(truth.pace):
        found.append(slow)
    per_hop = play.watch.delay_per_hop(play.demo.relays) if play.watch else None
    if per_hop is not None:
        found.append(f"delay per relay {1e3 * per_hop:.2f} ms one way")
    return found


def slow_words(pace: float) -> str:
    """What a person must know of simulated time that passed so fast (1: as it should); empty: nothing."""
    if pace >= SLOW:
        return ""
    return (
        f"simulated time passed {pace:.2f} times as fast as asked for: a vehicle that was late may be on time on a "
        "faster computer"
    )


def write(play: Play, path: Path, fault: str | None) -> None:
    """The summary for scripts; ``fault``: why the demo did not end as it should."""
    closest = {"m": play.truth.closest, "vehicles": play.truth.pair, "t": play.truth.closest_at}
    told = {
        "demo": play.demo.path.stem,
        "title": play.demo.story.title,
        "good": fault is None,
        "fault": fault,
        "seconds": play.now(),
        "pace": play.truth.pace,
        "vehicles": rows(play),
        "closest": closest if len(play.truth.names) > 1 and play.truth.rows else None,
        "marks": [{"t": mark.t, "text": mark.text} for mark in play.marks],
        "tracks": play.truth.rows,
    }
    path.write_bytes(msgspec.json.encode(told))
