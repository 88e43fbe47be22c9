"""What a state tells of battery and GPS: what the autopilot says, and nothing where it says nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zmav.mavlink import Packer

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench


async def told(b: Bench, seconds: int, **battery: int) -> None:
    b.peer.send("BATTERY_STATUS", time_remaining=seconds, **battery)


async def test_time_left_is_the_autopilot_s_own_estimate(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.send("SYS_STATUS", voltage_battery=12600, battery_remaining=80)
    assert (await b.state(lambda s: s["battery"], "a charge"))["battery"]["time_left"] is None
    await told(b, 840)
    await b.state(lambda s: s["battery"]["time_left"] == 840.0, "its estimate")
    await told(b, 600, id=1)
    await b.state(lambda s: s["battery"]["time_left"] == 600.0, "the battery that is empty first")
    other = Packer(b.peer.dialect, 1, 180)
    b.peer.raw(other.pack("BATTERY_STATUS", time_remaining=5))  # a gimbal's own
    await told(b, 0, id=1)
    await b.state(lambda s: s["battery"]["time_left"] == 840.0, "one that gives none any more")
    b.vehicle.state.battery_fresh = 0.2
    await b.state(lambda s: s["battery"]["time_left"] is None, "an estimate of long ago")


async def test_accuracy_is_the_receiver_s_own_estimate(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.send("GPS_RAW_INT", fix_type=3, satellites_visible=11, eph=65535)
    assert (await b.state(lambda s: s["gps"], "a fix"))["gps"]["h_acc"] is None, "it has none in its frame"
    b.peer.send("GPS_RAW_INT", fix_type=6, satellites_visible=21, h_acc=14)
    await b.state(lambda s: s["gps"]["h_acc"] == 0.014, "millimetres")
    b.peer.send("GPS_RAW_INT", fix_type=1, h_acc=0xFFFFFFFF)
    await b.state(lambda s: s["gps"]["fix"] == "NO_FIX" and s["gps"]["h_acc"] is None, "all ones are no estimate")


async def test_the_filter_s_own_estimate_is_told(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.send("EKF_STATUS_REPORT", flags=831, pos_horiz_variance=0.25)
    told = await b.state(lambda s: s["estimate"], "ArduPilot's ratio, which it calls a variance")
    assert told["estimate"] == {"accuracy": None, "ratio": 0.25}
    b.peer.send("ESTIMATOR_STATUS", flags=895, pos_horiz_ratio=0.06, pos_horiz_accuracy=0.29)
    told = await b.state(lambda s: s["estimate"]["accuracy"], "PX4's metres")
    assert told["estimate"] == {"accuracy": 0.29, "ratio": 0.06}
    b.peer.send("ESTIMATOR_STATUS", flags=0, pos_horiz_ratio=float("nan"), pos_horiz_accuracy=float("nan"))
    await b.state(lambda s: s["estimate"] == {"accuracy": None, "ratio": None}, "what is no number")
