"""``zmav agent inject``: have a controller answer a step or a doublet in flight, and see how it did."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np

import zmav
from agents.controllers.inject import CHANNELS, KINDS, Inject, duration
from agents.controllers.response import ResponseReport, examine, picture
from zmav import keys, wire
from zmav.cli.common import Between, Finite, Work, connected, json_option, tell
from zmav.errors import BadInput, TimedOut
from zmav.waiting import alongside, within

TOPIC = "signals"
BEFORE = 1.0
"""s recorded before it is injected"""
SILENT = 3.0
"""s without a signal after which nobody is waited for"""
DEPTH = 5000
"""signals that may wait for us"""
PATIENCE = 5.0
"""s for what was ordered to be seen among the signals"""
OWN = wire.Order.__struct_fields__
"""of every order: the one who tells it gives these"""
SECONDS = {"step": 5.0, "doublet": 1.0}


@click.command("inject")
@click.argument("agent")
@click.argument("kind", type=click.Choice(KINDS))
@click.option("--channel", required=True, type=click.Choice(list(CHANNELS)), help="What is added to; z is down.")
@click.option("--amplitude", required=True, type=Finite(), help="In m, m/s, rad or rad/s.")
@click.option("--seconds", type=Finite(), help="It lasts; of a doublet, each half.  [default: 5, of a doublet 1]")
@click.option("--after", type=Between(0.0, 60.0), default=2.0, show_default=True, help="Seconds recorded after it.")
@click.option("--vehicle", required=True, help="The vehicle that the agent flies.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.png",
    help="Draw it: png, svg or pdf.",
)
@json_option
@connected
def inject(
    agent: str,
    kind: str,
    channel: str,
    amplitude: float,
    seconds: float | None,
    after: float,
    vehicle: str,
    output: Path | None,
    as_json: bool,
) -> Work:
    """Add a signal to a controller's reference, and report how it follows.

    'zmav agent inject mine step --channel z --amplitude -1 --vehicle hex1 -o response.png'.
    Reports errors, and of a step rise time, overshoot and settling; 'zmav record' keeps the signals.
    """
    lasts = SECONDS[kind] if seconds is None else seconds
    args = Inject(kind=kind, channel=channel, amplitude=amplitude, seconds=lasts)  # type: ignore[arg-type]

    async def act(z: zmav.Client) -> None:
        report = await respond(z, vehicle, agent, args, after)
        tell(as_json, report.numbers(), report.text())
        if output is not None:
            picture(report, output)

    return act


async def respond(
    z: zmav.Client, vehicle: str, agent: str, args: Inject, after: float = 2.0, silent: float = SILENT
) -> ResponseReport:
    """Have ``agent`` inject, record its signals from a second before to ``after`` s past the end, and examine them.

    Raises :class:`~zmav.errors.TimedOut` where it says nothing for ``silent`` seconds, what the agent refuses the order
    with, and what :func:`~agents.controllers.response.examine` does.
    """
    target = z.vehicle(vehicle)
    key = keys.AGENT_OUT.key(target.fleet, vehicle, agent=keys.check_name(agent, "agent"), topic=TOPIC)
    heard: list[wire.Signals] = []
    async with z.subscribe(key, _signals, depth=DEPTH) as signals:
        if not await _hear(signals, heard, lambda: heard[-1].t - heard[0].t >= BEFORE, silent):
            await target.tell(agent, "params")  # raises where none of that name runs
            text = f"{agent} runs for {vehicle} and streams no signals: engage it, 'zmav agent do {agent} engage'"
            raise TimedOut(text, vehicle=vehicle, agent=agent)
        arguments = {name: value for name, value in msgspec.structs.asdict(args).items() if name not in OWN}
        async with alongside(target.tell(agent, "inject", **arguments)) as (order,):
            over = partial(_over, heard, heard[-1].t, duration(args) + after, order)
            if not await _hear(signals, heard, over, silent):
                over()  # raises what it was refused with
                text = "its signals ended before all was injected: it was released, or its link is gone"
                raise TimedOut(text, heard=len(heard))
            await asyncio.wait({order}, timeout=silent)
        slow, bad = signals.dropped, signals.bad
    report = _examined(args, heard, f"{vehicle}/{agent}")
    if slow:
        report.notes.append(f"{slow} signals were lost here: this computer was too slow")
    if bad:
        report.notes.append(f"{bad} signals could not be read")
    return report


def _signals(sample: Any) -> wire.Signals:
    return wire.decode(sample.payload.to_bytes(), wire.Signals, "signals")


async def _hear(
    signals: zmav.Subscription[wire.Signals], heard: list[wire.Signals], true: Callable[[], bool], silent: float
) -> bool:
    """Hear signals until it is so; False where nothing comes any more."""
    while not heard or not true():
        try:
            heard.append(await within(silent, signals.get()))
        except asyncio.TimeoutError:
            return False
    return True


def _over(heard: list[wire.Signals], told: float, seconds: float, order: asyncio.Task[dict[str, Any]]) -> bool:
    """Whether it has injected for so long, by the signals' own time; raises what the order is refused with."""
    if order.done():
        order.result()
    begun = next((each.t for each in heard if each.values.get("inject", 0.0) != 0.0), None)
    if begun is None and order.done() and heard[-1].t - told > PATIENCE:  # over bad hops an order takes some
        raise TimedOut(f"it took the order and injected nothing within {PATIENCE:g} s", heard=len(heard))
    return begun is not None and heard[-1].t >= begun + seconds


def _examined(args: Inject, heard: list[wire.Signals], title: str) -> ResponseReport:
    names = {"reference": f"ref.{args.channel}", "measured": f"is.{args.channel}", "injected": "inject"}
    columns = {}
    for what, name in names.items():
        if not any(name in each.values for each in heard):
            raise BadInput(f"there is no signal {name}", field=name, value=None, expected="one of the agent's signals")
        columns[what] = _column(heard, name)
    outputs = sorted({name for each in heard for name in each.values if name.startswith("out.")})
    shown = {name.removeprefix("out."): _column(heard, name) for name in outputs}
    return examine(args, np.array([each.t for each in heard]), **columns, outputs=shown, title=title)


def _column(heard: list[wire.Signals], name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array([each.values.get(name, np.nan) for each in heard])
