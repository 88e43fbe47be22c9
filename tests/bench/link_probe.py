"""How true the figures of 'zmav mesh graph' are, on links whose delay, loss and rate are known, and what probing costs.

Needs root and /dev/net/tun: a lab of one hub and a host behind each kind of link, each with its own router, first over
``udp/?rel=1;mixed_rel=1`` and then with credentials over ``quic/``. Prints tables; asserts nothing.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from mesh.lab.lab import Lab  # noqa: E402
from mesh.lab.network import LabError  # noqa: E402
from mesh.quality.publisher import LinkQualities  # noqa: E402
from mesh.units import milliseconds, percent  # noqa: E402
from tests.mesh.quality.relay import HEADERS, Relay  # noqa: E402
from zmav.session import SessionSettings, open_session  # noqa: E402

SETTLE_S = 40.0
COUNT_S = 60.0
LINKS: dict[str, dict[str, Any]] = {
    "clean": {},
    "delay": {"delay": "50 ms"},
    "loss": {"delay": "5 ms", "loss": 0.1},
    "heavy": {"delay": "100 ms", "loss": 0.2},
    "slow": {"delay": "5 ms", "rate": "1 Mbit/s"},
    "slower": {"delay": "20 ms", "rate": "200 kbit/s"},
    "both": {"delay": "20 ms", "rate": "500 kbit/s", "loss": 0.05},
}
"""each direction alike, but for ``uneven``"""
UNEVEN = {"delay": "10 ms", "ends": {"uneven>hub": {"loss": 0.3}}}


def scenario(credentials: bool) -> str:
    lines = ['name = "probe"', 'profile = "lan"', f"credentials = {str(credentials).lower()}", "[hosts.hub]"]
    links = {**LINKS, "uneven": UNEVEN}
    lines += [f"[hosts.{name}]" for name in links]
    for name, values in links.items():
        lines += ["[[media]]", 'kind = "link"', f'name = "{name}"', f'between = ["hub", "{name}"]']
        lines += [f"{key} = {json.dumps(value)}" for key, value in values.items() if key != "ends"]
        for pair, more in values.get("ends", {}).items():
            lines += [f'[media.ends."{pair}"]', *(f"{key} = {json.dumps(value)}" for key, value in more.items())]
    return "\n".join(lines)


async def measured(credentials: bool) -> dict[str, Any]:
    """What 'zmav mesh graph --json' says at the hub, by the host at the other end."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "probe.toml"
        file.write_text(scenario(credentials))
        async with Lab(file) as lab:
            await lab.ready()
            await asyncio.sleep(SETTLE_S)
            done = await lab.run_in("hub", "zmav", "mesh", "graph", "--json")
    if done.returncode:
        raise LabError(done.stderr)
    links = json.loads(done.stdout)["links"]
    return {next(end for end in link["ends"] if end != "hub"): link for link in links}


def table(protocol: str, found: dict[str, Any]) -> Table:
    made = Table(
        "link",
        "RTT set",
        "measured",
        "loss set",
        "to hub",
        "from hub",
        title=f"{protocol}, {SETTLE_S:.0f} s after its start; RTT in ms",
    )
    for name, values in {**LINKS, "uneven": UNEVEN}.items():
        link = found.get(name)
        delay = float(str(values.get("delay", "0 ms")).split()[0])
        loss = "30% to hub" if name == "uneven" else percent(values.get("loss", 0.0))
        row = [name, f"{2 * delay:.0f}", "-", loss, "-", "-"]
        if link:
            losses = link["loss"]
            row[2] = milliseconds(link["rtt"])
            row[4:6] = percent(losses[name]), percent(losses["hub"])
        made.add_row(*row)
    return made


async def cost() -> Table:
    """Bytes a second of a link between two routers that nobody uses, with the probes and without."""
    made = Table(
        "two routers, udp?rel=1, lease 1 s", "B/s there", "B/s back", "datagrams/s", title="What probing costs"
    )
    seen: dict[str, list[float]] = {}
    for probing in (False, True):
        async with contextlib.AsyncExitStack() as stack:
            sessions = []
            connect: list[str] = []
            for name in ("quad1", "quad2"):
                listen = ["udp/127.0.0.1:0?rel=1;mixed_rel=1"]
                settings = SessionSettings(mode="router", listen=listen, connect=connect)
                session = await asyncio.to_thread(open_session, settings)
                stack.push_async_callback(asyncio.to_thread, session.close)
                sessions.append((name, session))
                (reply,) = session.get(f"@/{session.info.zid()}/router")
                assert reply.ok is not None
                locator = json.loads(reply.ok.payload.to_bytes())["locators"][0]
                relay = stack.enter_context(Relay(int(locator.partition("?")[0].rpartition(":")[2])))
                connect = [relay.endpoint]
                if name == "quad1":
                    between = relay
            if probing:
                for name, session in sessions:
                    await stack.enter_async_context(LinkQualities(session, "demo", name))
            await asyncio.sleep(5.0)
            for way in between.datagrams:
                way.clear()
            began = time.monotonic()
            await asyncio.sleep(COUNT_S)
            span = time.monotonic() - began
            counts = [(sum(way) + HEADERS * len(way)) / span for way in between.datagrams]
            row = [*counts, sum(map(len, between.datagrams)) / span]
            seen["with" if probing else "without"] = row
            made.add_row("with probes" if probing else "without", *(f"{value:.0f}" for value in row))
    made.add_row("the probes", *(f"{w - o:.0f}" for w, o in zip(seen["with"], seen["without"], strict=True)))
    return made


async def main() -> None:
    console = Console(width=120)
    try:
        for credentials, protocol in ((False, "udp/?rel=1;mixed_rel=1"), (True, "quic/?mixed_rel=1")):
            console.print(table(protocol, await measured(credentials)))
    except LabError as e:
        console.print(f"no lab: {e}")
    console.print(await cost())


if __name__ == "__main__":
    asyncio.run(main())
