"""``zmav record``: record the fleet, and answer questions of what was."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

import zmav
from ground.record.folder import Folder
from ground.record.sources import check_mcap, open_all, readable
from zmav import keys, wire
from zmav.cli.common import amount, dialect_option, fleet_option, run, show_table, size, zenoh_options
from zmav.errors import BadConfig, BadInput, needs
from zmav.process import say, until_stopped
from zmav.session import SessionSettings

if TYPE_CHECKING:
    from ground.record.recorder import Wanted
    from ground.record.storage import RecordingSettings


RECORDINGS = Path("recordings")
"""where they go, and are played from, unless somebody says otherwise"""


@click.command("record")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=RECORDINGS,
    show_default=True,
    help="Folder of recordings; each session has a folder in it.",
)
@click.option(
    "--vehicles", "-v", multiple=True, metavar="PATTERN", help="Which vehicles: 'quad*' (repeatable). [default: all]"
)
@click.option(
    "--want", multiple=True, metavar="MSG=HZ", help="Have the autopilots send a message so fast (repeatable)."
)
@click.option(
    "--mcap/--no-mcap", default=True, show_default=True, help="Besides the .tlog files, one .mcap of everything."
)
@click.option("--ros2", is_flag=True, help="In the .mcap besides: what 'zmav ros2' would publish, for 3-D in Foxglove.")
@click.option("--video", is_flag=True, help="Besides, the video of the vehicles' cameras, as .ts files (MPEG-TS).")
@click.option(
    "--keep-free", callback=amount, default="1GB", show_default=True, help="Write nothing while less is free."
)
@click.option("--name", help="Name under which questions are answered. [default: the credentials', or this machine's]")
@click.option(
    "--repair",
    multiple=True,
    metavar="FILE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Do nothing but complete an .mcap that was cut short (repeatable).",
)
@click.option(
    "--orders",
    multiple=True,
    metavar="FILE",
    type=click.Path(exists=True, path_type=Path),
    help="Do nothing but show the orders in a recording that gateways were given (repeatable).",
)
@dialect_option
@fleet_option
@zenoh_options
def command(
    out: Path,
    vehicles: tuple[str, ...],
    want: tuple[str, ...],
    mcap: bool,
    ros2: bool,
    video: bool,
    keep_free: int,
    name: str | None,
    dialect: str,
    repair: tuple[Path, ...],
    orders: tuple[Path, ...],
    fleet: str,
    settings: SessionSettings,
) -> None:
    """Record the fleet: a .tlog of each vehicle, one .mcap of everything; and answer questions of what was.

    All that flows is recorded, as it came: frames, states, events, setpoints, plans, link qualities. --want asks the
    autopilots for more. Files are complete up to the last second, whatever ends the recorder.

    Afterwards 'zmav replay' plays them; Foxglove and PlotJuggler open the .mcap, MAVExplorer and QGroundControl the
    .tlog files.

    Meanwhile: zmav get '*/history/quad1/state' (--value '{"last": 10}').
    """
    if mcap or repair:
        check_mcap()
    if orders:
        _show_orders(orders)
        return
    if repair:
        for path in repair:
            _repair(path)
        return
    if ros2:
        check_ros2(mcap)
    from ground.record.recorder import Wanted
    from ground.record.storage import RecordingSettings

    how = RecordingSettings(mcap=mcap, ros2=ros2, keep_free=keep_free)
    whom = Wanted(vehicles=vehicles or ("*",), rates=dict(map(_rate, want)), video=video, name=name)
    with Folder(out) as folder:
        run(_record(folder, how, whom, dialect, fleet, settings))


async def _record(
    folder: Folder, how: RecordingSettings, whom: Wanted, dialect: str, fleet: str, settings: SessionSettings
) -> None:
    from ground.record.recorder import Recorder

    start = time.monotonic()
    unfinished = asyncio.create_task(asyncio.to_thread(complete, folder, how.keep_free)) if how.mcap else None
    async with (
        zmav.open(fleet=fleet, settings=settings, dialect=dialect) as z,
        Recorder(z, folder, how, whom, say) as recorder,
    ):
        say(f"recording {fleet}/{','.join(whom.vehicles)} to {recorder.storage.session}, as {recorder.name}")
        await until_stopped()
    if unfinished is not None:
        await unfinished
    counts = recorder.storage.counts
    rest = {"dropped": counts.dropped, "without room": counts.unwritten, "refused": counts.refused}
    lost = "".join(f", {number} {what}" for what, number in rest.items() if number)
    minutes = (time.monotonic() - start) / 60
    say(f"{counts.written} samples in {size(counts.bytes)}, {minutes:.1f} min{lost}: {recorder.storage.session}")


def complete(folder: Folder, keep_free: int) -> None:
    """What a recorder that was killed left behind gets its end, where there is room for each a second time."""
    for path in folder.unfinished:
        try:
            if folder.free() < keep_free + path.stat().st_size:
                say(f"{path}: not completed, for want of room: 'zmav record --repair' does it later")
            else:
                _repair(path)
        except OSError as e:
            say(f"{path}: not completed: {e.strerror}")
        except (BadInput, BadConfig) as e:
            say(str(e))


def _repair(path: Path) -> None:
    from ground.record.mcapfile import repair

    try:
        done = repair(path)
    except OSError as e:
        raise BadConfig(f"cannot complete {path}: {e.strerror}", field="repair", value=str(path)) from e
    say(f"{path}: is whole" if done.whole else f"{path}: completed; it holds {done.messages} messages")


def _show_orders(paths: Sequence[Path]) -> None:
    """One line an order, the earliest first; who, from where, what, to whom, outcome."""
    rows, ending = list[tuple[str, ...]](), f"/@fleet/{keys.ORDERED}"
    for source, _ in readable(open_all(paths), say):
        for record in source.records():
            if not record.key.endswith(ending):
                continue
            with contextlib.suppress(BadInput):
                line = wire.decode(record.data, wire.OrderLine, record.key)
                at = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(line.t))
                more = f" ({line.more} more before)" if line.more else ""
                who = "@".join(filter(None, (line.who, line.source)))
                rows.append((at, who, line.verb, ", ".join(line.vehicles), line.outcome + more, line.args))
    show_table(("at", "who", "order", "vehicles", "outcome", "arguments"), rows)
    say(f"{len(rows)} orders")


def check_ros2(mcap: bool) -> None:
    """Raise :class:`BadConfig` where a package is missing, or there is no .mcap to write to."""
    if not mcap:
        raise BadConfig("--ros2 is of the .mcap: leave out --no-mcap", field="ros2", value=True, expected="an .mcap")
    needs("'zmav record --ros2'", "ros2", "rosbags", "xxhash")


def _rate(text: str) -> tuple[str, float]:
    name, _, hz = text.partition("=")
    try:
        return keys.check_message(name), float(hz)
    except ValueError:
        raise BadInput(
            f"{text!r} is no rate: expected ATTITUDE=10", field="want", value=text, expected="MSG=HZ"
        ) from None
