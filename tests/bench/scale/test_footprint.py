"""What a simulated vehicle declares is what ``zmav up`` declares."""

from __future__ import annotations

import json
import re
from collections import Counter

import zenoh

from tests.bench.scale.footprint import SAID_SELDOM, STREAMED, Copter
from tests.conftest import Net, StartOnboard
from zmav import keys, wire


def declared(session: zenoh.Session) -> set[str]:
    """What a router's own admin space lists of its declarations, without its id."""
    start = f"@/{session.info.zid()}/router/"
    found = set()
    for kind in ("publisher", "subscriber", "queryable", "token"):
        for reply in session.get(f"{start}{kind}/**", zenoh.handlers.FifoChannel(10_000)):
            assert reply.ok is not None
            found.add(str(reply.ok.key_expr).removeprefix(start))
    return {re.sub(r"/alive/.*", "/alive", key) for key in found}


async def test_it_declares_what_an_agent_does(net: Net, onboard: StartOnboard) -> None:
    real, _ = net.router()
    real.declare_subscriber(keys.EVENT.key("demo", "quad1"), lambda sample: None)  # 'zmav up' logs them
    await onboard(real, "udpin:127.0.0.1:0")
    model, _ = net.router()
    copter = Copter(model, "demo", "quad1", 7)
    messages = {f"publisher/zmav/demo/quad1/mav/rx/1/1/{name}" for name in (*STREAMED, *SAID_SELDOM)}
    found = declared(model)
    assert messages <= found
    assert found - messages == declared(real)
    assert copter.heard == []


async def test_it_says_what_it_should(net: Net) -> None:
    session, endpoint = net.router()
    copter = Copter(session, "demo", "quad1", 7)
    ground = net.ground(endpoint)
    said = ground.samples("zmav/demo/quad1/**")
    await net.linked(session, keys.STATE.key("demo", "quad1"))
    for beat in range(20):
        copter.tick(beat)
    due = Counter(
        {"state": 10, "link/autopilot": 2, **{f"mav/rx/1/1/{m}": round(2 * hz) for m, (hz, _) in STREAMED.items()}}
    )
    await said.until(lambda: len(said.items) >= sum(due.values()), "sample")
    assert Counter(key.removeprefix("zmav/demo/quad1/") for key, _ in said.items) == due
    state = next(payload for key, payload in said.items if key.endswith("/state"))
    assert wire.decode(state, wire.VehicleState, "state").name == "quad1"
    assert (await ground.do("ping")).status == "done"
    (reply,) = await ground.ask(keys.STATE.key("demo", "*"))
    assert reply.ok is not None
    assert json.loads(reply.ok.payload.to_bytes())["name"] == "quad1"
