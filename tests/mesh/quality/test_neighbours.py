"""Routers measuring each other over links whose loss, delay and rate are known."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from pathlib import Path

import zenoh

from mesh.credentials.ca import Authority
from mesh.quality.meter import WINDOW, Stamp
from mesh.quality.probe import STAMP_BYTES
from tests.mesh.quality.conftest import QUICK, Routers, known
from tests.mesh.quality.relay import HEADERS, nothing
from tests.waiting import until
from zmav import keys, wire
from zmav.trust.certificate import Role

STAMP = 0x53


def every(nth: int, source: bytes) -> Callable[[bytes], bool]:
    """Loses each nth of the stamps that the router of that id sends, and nothing else."""
    count = 0

    def drop(data: bytes) -> bool:
        nonlocal count
        at = data.find(source)
        if at < 3 or data[at - 3] != STAMP:
            return False
        count += 1
        return count % nth == 0

    return drop


def source(session: zenoh.Session) -> bytes:
    return bytes.fromhex(str(session.info.zid()).zfill(32))[-8:]


async def test_each_end_knows_loss_and_round_trip_of_both_directions(routers: Routers) -> None:
    relay = routers.relay(await routers.open("quad1"))
    await routers.open("quad2", relay.endpoint)
    relay.drop[0] = every(4, source(routers.sessions["quad2"]))  # quad2 -> quad1
    relay.delay = [0.02, 0.03]
    one, two = await routers.measure("quad1"), await routers.measure("quad2")

    def told() -> bool:
        said = (one.latest.get("quad2"), two.latest.get("quad1"))
        return all(q and None not in (q.rtt, q.loss_in, q.loss_out) for q in said)

    await until(told, "every figure")

    def a_quarter_one_way() -> bool:
        seen, seen_back = known(one, "quad2"), known(two, "quad1")
        losses = [abs((loss or 0.0) - 0.25) <= 2 / WINDOW for loss in (seen.loss_in, seen_back.loss_out)]
        return all(losses) and seen.loss_out == seen_back.loss_in == 0.0

    await until(a_quarter_one_way, "a loss of a quarter one way, and none the other")
    seen, seen_back = known(one, "quad2"), known(two, "quad1")
    for quality in (seen, seen_back):
        assert quality.state == "up"
        assert quality.rtt_min is not None and quality.rtt is not None
        assert 0.05 <= quality.rtt_min <= quality.rtt  # no shorter than the way is
        assert quality.interface == "lo"
        assert quality.cost is not None and quality.cost > 2_500  # half the round trip alone


async def test_what_it_tells_is_published_and_answered_and_no_wildcard_hears_the_probes(routers: Routers) -> None:
    await routers.open("quad2", f"udp/127.0.0.1:{await routers.open('quad1')}?rel=1;mixed_rel=1")
    heard: list[str] = []
    published: dict[str, wire.NeighbourQuality] = {}

    def on_link(sample: zenoh.Sample) -> None:
        quality = wire.decode_link(sample.payload.to_bytes())
        assert isinstance(quality, wire.NeighbourQuality)
        published[str(sample.key_expr)] = quality

    session = routers.sessions["quad1"]
    session.declare_subscriber("zmav/**", lambda sample: heard.append(str(sample.key_expr)))
    session.declare_subscriber(keys.LINK.key("*", "*", link="*"), on_link)
    await routers.measure("quad1")
    await routers.measure("quad2")
    links = {keys.LINK.key("demo", a, link=b) for a, b in (("quad1", "quad2"), ("quad2", "quad1"))}
    await until(lambda: published.keys() == links, "both ends")
    answered = {str(r.ok.key_expr): r.ok.payload.to_bytes() for r in session.get("zmav/*/*/link/*") if r.ok}
    assert answered.keys() == links
    for key, data in answered.items():
        quality = wire.decode_link(data)
        assert key.endswith(f"/link/{quality.name}")
    (only,) = [r for r in session.get(keys.LINK.key("demo", "quad2", link="quad1")) if r.ok]
    assert only.ok is not None and str(only.ok.key_expr) == keys.LINK.key("demo", "quad2", link="quad1")
    assert list(session.get(keys.LINK.key("demo", "quad2", link="quad7"))) == []
    assert not [key for key in heard if "/@" in key]


async def test_a_neighbour_out_of_range_or_gone_is_told_of_and_measured_again_when_it_is_back(routers: Routers) -> None:
    quick = ("transport/link/tx/lease:400",)
    relay = routers.relay(await routers.open("quad1", cfg=quick))
    await routers.open("quad2", relay.endpoint, cfg=quick)
    one = await routers.measure("quad1")
    await routers.measure("quad2")
    await until(lambda: "quad2" in one.latest and known(one, "quad2").loss_in == 0.0, "it is up")
    for _ in range(20):  # a link that was bad before it broke
        one.prober.neighbours[known(one, "quad2").peer].meter.take(Stamp(b"", 0.02, 9_000, 1), 0.0)
    relay.cut()
    await until(lambda: known(one, "quad2").state == "down", "it is down")
    down = known(one, "quad2")
    assert down.cost == 65_535
    await until(lambda: (known(one, "quad2").age or 0.0) > (down.age or 0.0), "its age goes on")
    relay.drop = [nothing, nothing]
    await until(lambda: known(one, "quad2").state == "up" and known(one, "quad2").loss_in is not None, "it is back")
    assert known(one, "quad2").loss_in == 0.0
    await asyncio.to_thread(routers.sessions["quad2"].close)
    await until(lambda: known(one, "quad2").state == "down", "it is gone")


async def test_nonsense_and_strangers_are_refused_and_measuring_goes_on(routers: Routers) -> None:
    port = await routers.open("quad1")
    endpoint = f"udp/127.0.0.1:{port}?rel=1;mixed_rel=1"
    await routers.open("quad2", endpoint)
    await routers.open("plain", endpoint)  # a router that has never heard of zmav
    one = await routers.measure("quad1")
    await routers.measure("quad2")
    plain = str(routers.sessions["plain"].info.zid())
    chance = random.Random(7)
    await until(lambda: "quad2" in one.latest and plain in one.prober.neighbours, "both")
    probe = keys.PROBE.key("demo", "quad2", to=one.prober.zid)
    before = one.prober.refused
    for size in (0, 1, 33, 34, 1000, 1100):
        for _ in range(20):
            routers.sessions["plain"].put(probe, chance.randbytes(size))
    stranger = bytes.fromhex("5102580000000000000000") + bytes(23)
    routers.sessions["plain"].put(probe, stranger)
    await until(lambda: one.prober.refused >= before + 50, "refusals")
    seen = known(one, "quad2").t
    await until(lambda: known(one, "quad2").t > seen + 0.2 and known(one, "quad2").state == "up", "it goes on")
    one.prober.neighbours[plain].since -= 10.0  # it had time enough to say its name
    await until(lambda: plain in one.latest, "the router without a name")
    await until(lambda: known(one, plain).state == "silent", "it is silent")


async def test_with_credentials_a_neighbour_is_who_its_certificate_says(routers: Routers, tmp_path: Path) -> None:
    authority = Authority.create(tmp_path / "ca", "demo")
    folders = {n: authority.issue(n, Role.VEHICLE, out=tmp_path / n) for n in ("quad1", "quad2")}
    port = await routers.open("quad1", credentials=folders["quad1"])
    await routers.open("quad2", f"quic/127.0.0.1:{port}?mixed_rel=1", credentials=folders["quad2"])
    one, two = await routers.measure("quad1"), await routers.measure("quad2")
    await until(lambda: "quad2" in one.latest and known(one, "quad2").loss_in is not None, "quad2 over quic")
    before = one.prober.refused
    forged = Stamp(source(routers.sessions["quad2"]), 0.1, 1, 1).pack()
    routers.sessions["quad2"].put(keys.PROBE.key("demo", "quad7", to=one.prober.zid), forged)
    await until(lambda: one.prober.refused > before, "the refusal")
    assert one.latest.keys() == {"quad2"}
    assert two.latest.keys() == {"quad1"}


async def test_what_probing_costs(routers: Routers) -> None:
    """A stamp is as large on the wire as the pace reckons with."""
    relay = routers.relay(await routers.open("quad1"))
    await routers.open("quad2", relay.endpoint)
    one = await routers.measure("quad1", QUICK)
    two = await routers.measure("quad2", QUICK)
    await until(lambda: "quad2" in one.latest and "quad1" in two.latest, "both ends")
    sizes: list[int] = []
    mine = source(routers.sessions["quad2"])

    def look(data: bytes) -> bool:
        if mine in data and data[data.find(mine) - 3] == STAMP:
            sizes.append(len(data) + HEADERS)
        return False

    relay.drop[0] = look
    await until(lambda: len(sizes) >= 20, "stamps")
    assert sorted(sizes)[len(sizes) // 2] <= STAMP_BYTES
