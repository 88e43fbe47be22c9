"""A link that is too narrow: what is least wanted gets less, the floor nothing less, and nothing flutters."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.services.rates.rate_peer import SerialPeer
from zmav import keys, wire
from zmav.autopilots.ardupilot import ArduPilot
from zmav.links import open_link
from zmav.mavlink import load_dialect
from zmav.services.rates.demand import Demand
from zmav.services.rates.meter import Measured
from zmav.services.rates.plan import FULL, PATIENCE, ROOM, TRICKLE_HZ, Shedder, Target, Want, share, wanted

if TYPE_CHECKING:
    from tests.conftest import StartOnboard
    from tests.services.conftest import StartBench

WANTS = st.lists(
    st.builds(
        Want, st.uuids().map(str), st.floats(0.1, 500.0), st.floats(12.0, 280.0), st.integers(1, 9), st.booleans()
    ),
    max_size=12,
)


def cost(wants: list[Want], rates: dict[str, float]) -> float:
    return sum(rates[want.name] * want.size for want in wants)


@given(WANTS, st.floats(-1000.0, 50_000.0))
def test_what_is_shared_fits_and_nobody_is_cut_off(wants: list[Want], room: float) -> None:
    rates = share(wants, room)
    assert rates.keys() == {want.name for want in wants}
    trickles = sum(min(want.hz, TRICKLE_HZ) * want.size for want in wants)
    assert cost(wants, rates) <= max(room, trickles) * (1 + 1e-9)
    for want in wants:
        assert min(want.hz, TRICKLE_HZ) <= rates[want.name] <= want.hz + 1e-9


@given(WANTS, st.floats(0.0, 50_000.0))
def test_who_is_more_wanted_gives_up_last(wants: list[Want], room: float) -> None:
    rates = share(wants, room)
    slowed = [want for want in wants if rates[want.name] < 0.999 * want.hz]
    for less in wants:
        for more in slowed:
            if (more.explicit, more.readers) > (less.explicit, less.readers):
                assert rates[less.name] <= less.trickle + 1e-6


@given(WANTS)
def test_with_room_for_all_everybody_has_what_is_wanted(wants: list[Want]) -> None:
    rates = share(wants, sum(want.hz * want.size for want in wants) * 1.001 + 1.0)
    assert all(rates[want.name] == pytest.approx(want.hz) for want in wants)


# When it is done.

CAPACITY = 1000.0


class Table:
    """A shedder with its targets, and a clock that a test turns."""

    def __init__(self, **wishes: float) -> None:
        self.now = 0.0
        self.shedder = Shedder(load_dialect(), lambda: self.now)
        self.wishes = wishes
        self.other = 0.0

    def granted(self, seconds: float = 0.0) -> dict[str, float]:
        """What is granted ``seconds`` later, with a decision every second."""
        targets = self.decide()
        for _ in range(round(seconds)):
            self.now += 1.0
            targets = self.decide()
        return {t.name: round(t.granted, 2) for t in targets}

    def decide(self) -> list[Target]:
        demands = {name: [Demand(name, hz, "a", True)] for name, hz in self.wishes.items()}
        targets = wanted({"ATTITUDE": 2.0}, {}, demands)
        flows = {t.name: Measured(t.granted, 0.0, 1, 50.0, 0.0, 5.0) for t in targets}
        self.shedder.apply(targets, flows, self.other, set(flows), CAPACITY)
        return targets


def test_who_comes_new_is_fitted_in_at_once() -> None:
    table = Table(VFR_HUD=8.0)
    assert table.granted() == {"ATTITUDE": 2.0, "VFR_HUD": 8.0}
    table.wishes["WIND"] = 20.0
    now = table.granted()
    assert now["ATTITUDE"] == 2.0
    assert now["VFR_HUD"] == 8.0  # the cheaper of equals
    assert sum(now.values()) * 50.0 == pytest.approx(FULL * CAPACITY, rel=0.01)
    del table.wishes["WIND"]
    assert table.granted() == {"ATTITUDE": 2.0, "VFR_HUD": 8.0}


def test_traffic_of_others_counts_when_it_lasts_and_what_was_slowed_comes_back_when_there_is_room() -> None:
    table = Table(VFR_HUD=10.0)
    table.granted()
    table.other = 800.0
    assert table.granted(PATIENCE - 1)["VFR_HUD"] == 10.0
    slow = table.granted(2)["VFR_HUD"]
    assert slow == TRICKLE_HZ
    table.other = 500.0
    assert table.granted(PATIENCE - 1)["VFR_HUD"] == slow
    better = table.granted(3)["VFR_HUD"]
    assert 500.0 + (2.0 + better) * 50.0 == pytest.approx(ROOM * CAPACITY)
    table.other = 550.0
    assert table.granted(10)["VFR_HUD"] == better  # between too much and room again, nothing changes
    table.other = 0.0
    assert table.granted(PATIENCE + 1)["VFR_HUD"] == 10.0


def test_a_floor_is_never_slowed_and_a_wish_above_it_only_down_to_it() -> None:
    table = Table(ATTITUDE=100.0)
    now = table.granted()
    assert 2.0 < now["ATTITUDE"] < 18.1
    table.other = 5000.0
    assert table.granted(5)["ATTITUDE"] == pytest.approx(2.0 + TRICKLE_HZ)


def test_what_comes_by_itself_is_not_ours_to_slow() -> None:
    shedder = Shedder(load_dialect())
    targets = wanted({}, {}, {"RAW_IMU": [Demand("RAW_IMU", 50.0, "a", True)]})
    shedder.apply(targets, {"RAW_IMU": Measured(50.0, 2000.0, 1, 40.0, 0.0, 5.0)}, 2000.0, set(), CAPACITY)
    assert targets[0].granted == 50.0
    shedder.apply(targets, {}, 2000.0, set(), None)
    assert targets[0].granted == 50.0


def test_what_a_link_can_carry() -> None:
    assert open_link("serial:/dev/ttyUSB0:57600").capacity == 5760.0
    assert open_link("serial:/dev/ttyUSB0").capacity is None
    assert open_link("serial:/dev/ttyACM0:57600").capacity is None
    assert open_link("udpin:127.0.0.1:0").capacity is None


# On a line that is really too narrow.


@pytest.fixture(autouse=True)
def quick(onboard: StartOnboard) -> None:
    """Housekeeping at twice its pace."""
    onboard.pace = 2.0


async def test_a_full_line_slows_the_least_wanted_and_says_so(
    bench: StartBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ArduPilot, "floor", {"ATTITUDE": 5.0, "SYS_STATUS": 2.0})
    async with contextlib.AsyncExitStack() as stack:
        peer = SerialPeer(19200)
        await peer.open()
        stack.push_async_callback(peer.close)
        # No zeros at the end, which would be left out.
        peer.fields = {"ATTITUDE": {"yawspeed": 1.0}, "VFR_HUD": {"climb": 1.0}, "VIBRATION": {"clipping_2": 1 << 24}}
        b = await (await bench(peer)).connected()

        def token(name: str, hz: float, reader: str) -> Any:
            return b.ground.session.liveliness().declare_token(
                keys.WANT.key("demo", "quad1", msg=name, hz=hz, instance=reader)
            )

        wanted_most = [token("VFR_HUD", 20.0, "a"), token("VFR_HUD", 20.0, "b")]
        await peer.until(lambda: peer.rates.get("VFR_HUD") == 20.0, "what there is room for")
        least = token("VIBRATION", 100.0, "c")
        said = await b.event("the link is full")
        assert (said["kind"], said["severity"], said["detail"]["shed"]) == ("rate", "warning", ["VIBRATION"])
        await peer.until(lambda: 0.4 < peer.rates.get("VIBRATION", 0.0) < 30.0, "slowed")
        assert peer.rates["VFR_HUD"] == 20.0
        assert peer.rates["ATTITUDE"] == 5.0
        (reply,) = await b.ground.ask(keys.RATES.key("demo", "quad1"))
        assert reply.ok is not None
        table = wire.decode(reply.ok.payload.to_bytes(), wire.RateTable, "rates")
        rows = {m.name: m for m in table.messages if m.wanted_hz}
        assert table.capacity == 1920.0
        assert [name for name, row in rows.items() if row.shed] == ["VIBRATION"]
        assert rows["VIBRATION"].wanted_hz == 100.0
        reports = b.ground.samples(keys.LINK, link="autopilot")
        await reports.object(lambda r: 1000.0 < r["rx_bytes_rate"] <= 1920.0, "a link well used")
        for one in wanted_most:
            one.undeclare()
        await peer.until(lambda: peer.rates.get("VIBRATION", 0.0) > 20.0, "more of it")
        least.undeclare()
        await b.event("there is room on the link")
        await peer.until(lambda: "VIBRATION" not in peer.rates, "no more")
