"""Every frame of the fleet, once, in order, by whatever expressions it was asked for."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest
import zenoh

from ground.feed import Feed, Origin, origin_of
from zmav import keys
from zmav.errors import BadKey

if TYPE_CHECKING:
    from tests.conftest import Ground, Net

PATIENCE_S = 30.0


class Heard:
    """What a feed gave."""

    def __init__(self) -> None:
        self.frames: list[tuple[Origin, bytes]] = []
        self._changed = threading.Condition()

    def __call__(self, origin: Origin, frame: bytes) -> None:
        with self._changed:
            self.frames.append((origin, frame))
            self._changed.notify_all()

    def until(self, true: Callable[[], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(true, PATIENCE_S), f"only {self.frames}"

    def until_last(self, frame: bytes) -> list[bytes]:
        """Wait for that frame; all that came."""
        self.until(lambda: any(each == frame for _, each in self.frames))
        return [each for _, each in self.frames]


def put(ground: Ground, vehicle: str, frame: bytes, message: str = "ATTITUDE", system: object = 1) -> None:
    key = keys.RX.key("demo", vehicle, sys=system, comp=1, msg=message)
    ground.session.put(key, frame, congestion_control=zenoh.CongestionControl.BLOCK)


@pytest.fixture
def ground(net: Net) -> Ground:
    _, endpoint = net.router()
    return net.ground(endpoint)


def test_frames_come_with_the_parts_of_their_keys_and_in_order(ground: Ground) -> None:
    heard = Heard()
    with Feed(ground.session, keys.anything, heard, "demo") as feed:
        for number in range(50):
            put(ground, "quad1", bytes([number]))
        put(ground, "quad2", b"last", "UNKNOWN_410", 7)
        assert heard.until_last(b"last") == [bytes([number]) for number in range(50)] + [b"last"]
        origin = heard.frames[-1][0]
        assert origin[:5] == ("demo", "quad2", 7, 1, "UNKNOWN_410")
        assert origin.key == "zmav/demo/quad2/mav/rx/7/1/UNKNOWN_410" and feed.frames == 51


def test_expressions_that_overlap_bring_a_frame_once(ground: Ground) -> None:
    heard = Heard()
    with Feed(ground.session, keys.anything, heard, "demo", ["quad*", "quad1", "*1"]):
        for vehicle in ("quad1", "quad2", "rover1", "rover2"):
            put(ground, vehicle, vehicle.encode())
        put(ground, "rover1", b"last")
        heard.until_last(b"last")
        put(ground, "quad2", b"very last")
        heard.until_last(b"very last")
        frames = sorted(frame for _, frame in heard.frames)
        assert frames == [b"last", b"quad1", b"quad2", b"rover1", b"very last"]


def test_only_what_was_asked_for_comes(ground: Ground) -> None:
    heard = Heard()
    with Feed(ground.session, keys.anything, heard, "demo", ["quad1"]):
        put(ground, "quad2", b"x")
        put(ground, "quad1", b"last", "VFR_HUD")
        assert heard.until_last(b"last") == [b"last"]


def test_keys_that_are_no_frames_are_counted(ground: Ground) -> None:
    heard = Heard()
    with Feed(ground.session, keys.anything, heard) as feed:
        for system in ("256", "x", "-1"):
            put(ground, "quad1", b"x", system=system)
        put(ground, "quad1", b"last")
        assert heard.until_last(b"last") == [b"last"]
        assert feed.foreign == 3


def test_what_is_closed_hears_nothing_more(ground: Ground) -> None:
    heard, other = Heard(), Heard()
    with Feed(ground.session, keys.anything, other, "demo"):
        Feed(ground.session, keys.anything, heard, "demo").close()
        put(ground, "quad1", b"last")
        other.until_last(b"last")
    assert not heard.frames


def test_what_cannot_be_a_name_is_refused(ground: Ground) -> None:
    with pytest.raises(BadKey):
        Feed(ground.session, keys.anything, Heard(), "demo", ["quad#1"])


def test_other_keys_have_no_origin() -> None:
    assert origin_of("zmav/demo/quad1/state") is None
    assert origin_of("zmav/demo/quad1/mav/rx/1/300/ATTITUDE") is None
