"""The splitter against pymavlink's parser: the same frames, the same run, CPU time.

    python tests/bench/splitter.py [--frames 20000] [--rounds 15] [--json]

Both get the same bytes, once a frame a datagram and once in chunks of 512 bytes, in turns, and each round is timed by
process_time; the figures are medians. pymavlink's ``parse_buffer`` also decodes the fields, which is its only way to
check a frame; it uses fastcrc as we do.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pymavlink
from pymavlink.dialects.v20 import ardupilotmega

from zmav.links.tlog import TlogReader
from zmav.mavlink import Dialect, Packer, Splitter, load_dialect

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"

# Messages and their rates in Hz, as a companion computer asks an autopilot for them.
MIX = {
    "ATTITUDE": 50,
    "LOCAL_POSITION_NED": 30,
    "GLOBAL_POSITION_INT": 20,
    "HIGHRES_IMU": 15,
    "RAW_IMU": 10,
    "VFR_HUD": 10,
    "RC_CHANNELS": 10,
    "SERVO_OUTPUT_RAW": 10,
    "GPS_RAW_INT": 5,
    "SYS_STATUS": 2,
    "BATTERY_STATUS": 2,
    "STATUSTEXT": 1,
    "HEARTBEAT": 1,
}


def telemetry(dialect: Dialect, count: int) -> list[bytes]:
    """``count`` frames of the mix, evenly interleaved, with numbers that fill their fields."""
    due = sorted(((k + 0.5) / rate, name) for name, rate in MIX.items() for k in range(rate))
    packer = Packer(dialect, 1, 1)
    frames = []
    for index in range(count):
        name = due[index % len(due)][1]
        frames.append(packer.pack(name, **_fields(dialect, name, index)))
    return frames


def _fields(dialect: Dialect, name: str, index: int) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for place, field in enumerate(dialect.by_name[name].fields):
        number = math.sin(index / 50 + place) if field.type in ("float", "double") else (index + 13 * place) % 120 + 1
        if field.type not in ("float", "double", "int8_t", "uint8_t"):
            number *= 257  # both bytes of a 16-bit field
        if field.extension:
            continue
        if field.type == "char":
            values[field.name] = f"PreArm: check {index % 100}"
        else:
            values[field.name] = [number] * field.length if field.length else number
    return values


def recorded(path: Path) -> list[bytes]:
    """The frames of a .tlog."""
    with path.open("rb") as file:
        return [frame for _, frame in TlogReader(file)]


def by_pymavlink(parts: list[bytes]) -> int:
    parse = ardupilotmega.MAVLink(None).parse_buffer
    count = 0
    for part in parts:
        found = parse(part)
        if found:
            count += len(found)
    return count


def by_splitter(dialect: Dialect) -> Callable[[list[bytes]], int]:
    def run(parts: list[bytes]) -> int:
        feed = Splitter(dialect).feed
        count = 0
        for part in parts:
            found = feed(part)
            if found:
                count += len(found)
        return count

    return run


def timed(run: Callable[[list[bytes]], int], parts: list[bytes], expected: int, times: int) -> float:
    """CPU microseconds a frame, over that many times the whole input."""
    gc.collect()
    began = time.process_time()
    for _ in range(times):
        if run(parts) != expected:
            raise SystemExit(f"not all of the {expected} frames were found")
    return (time.process_time() - began) / (times * expected) * 1e6


def compare(dialect: Dialect, parts: list[bytes], frames: int, rounds: int) -> tuple[float, float, float]:
    """Median microseconds a frame of pymavlink and of the splitter, and the median of the rounds' ratios.

    They take turns, and the splitter has ten times the work, so that both are timed about equally long: a busy
    neighbour then slows both, or is outvoted.
    """
    theirs, ours = [], []
    run = by_splitter(dialect)
    for _ in range(rounds):
        theirs.append(timed(by_pymavlink, parts, frames, 1))
        ours.append(timed(run, parts, frames, 10))
    ratios = [a / b for a, b in zip(theirs, ours, strict=True)]
    return statistics.median(theirs), statistics.median(ours), statistics.median(ratios)


def main() -> None:
    options = argparse.ArgumentParser(description="The splitter against pymavlink's parser.")
    options.add_argument("--frames", type=int, default=20000, help="frames a round")
    options.add_argument("--rounds", type=int, default=15, help="rounds; the figures are their medians")
    options.add_argument("--json", action="store_true", help="one JSON object a line")
    given = options.parse_args()
    dialect = load_dialect("ardupilotmega")
    sets = {"telemetry mix": telemetry(dialect, given.frames)}
    if (DATA / "px4.tlog").exists():
        sets["px4.tlog"] = recorded(DATA / "px4.tlog")[: given.frames]
    if not given.json:
        print(f"pymavlink {pymavlink.__version__}; median of {given.rounds} rounds; CPU microseconds a frame")
    for name, frames in sets.items():
        stream = b"".join(frames)
        chunks = [stream[k : k + 512] for k in range(0, len(stream), 512)]
        for feeding, parts in (("one frame a datagram", frames), ("512-byte chunks", chunks)):
            figures = compare(dialect, parts, len(frames), given.rounds)
            report(given.json, name, feeding, len(stream) / len(frames), *figures)


def report(as_json: bool, name: str, feeding: str, size: float, theirs: float, ours: float, ratio: float) -> None:
    if as_json:
        row = {"frames": name, "fed": feeding, "bytes_a_frame": round(size, 1), "pymavlink_us": round(theirs, 3)}
        print(json.dumps(row | {"zmav_us": round(ours, 3), "ratio": round(ratio, 2)}))
        return
    print(f"{name}, {size:.1f} bytes a frame, {feeding}:")
    print(f"  pymavlink {1e6 / theirs:10,.0f} frames/s  {theirs:7.3f} us")
    print(f"  zmav      {1e6 / ours:10,.0f} frames/s  {ours:7.3f} us   {ratio:.1f} times as fast")


if __name__ == "__main__":
    main()
