"""The battery against closed forms, and what it does to the vehicles."""

from __future__ import annotations

import numpy as np
import pytest

from tests.sim.conftest import MakeGcs
from zmav.sim import VehicleSpec
from zmav.sim.dynamics.battery import Battery, Pack, open_circuit_share

LIPO = Pack(cells=4, capacity_mah=5000.0, resistance_ohm=0.02, full_v=16.8)


def use(battery: Battery, amps: float, seconds: float, dt: float = 0.1) -> None:
    for _ in range(round(seconds / dt)):
        battery.step(np.full(len(battery.volts), amps), dt)


def test_charge_goes_as_the_integral_of_the_current() -> None:
    battery = Battery(LIPO, 2)
    use(battery, 25.0, 120.0)
    assert battery.consumed == pytest.approx([25.0 * 120.0 / 3.6] * 2)
    assert battery.charge == pytest.approx([1.0 - 25.0 * 120.0 / 3.6 / 5000.0] * 2)


def test_voltage_sags_with_the_current_and_comes_back() -> None:
    battery = Battery(LIPO, 1)
    use(battery, 30.0, 0.1)
    rest = float(open_circuit_share(battery.charge)[0]) * 16.8
    assert battery.volts[0] == pytest.approx(rest - 30.0 * 0.02)
    use(battery, 0.0, 0.1)
    assert battery.volts[0] == pytest.approx(rest)


def test_the_curve_falls_all_the_way_and_steeply_at_the_end() -> None:
    curve = open_circuit_share(np.linspace(0.0, 1.0, 201))
    assert (np.diff(curve) > 0.0).all()
    assert curve[-1] == pytest.approx(1.0)
    # Chen and Rincon-Mora's cell: 4.103 V full, 3.803 V half empty.
    assert curve[100] == pytest.approx(3.8034 / 4.1029, abs=1e-3)
    assert curve[0] < 0.67


def test_an_empty_pack_gives_nothing_and_is_not_less_than_empty() -> None:
    battery = Battery(LIPO, 1)
    battery.drain(0, 0.001)
    use(battery, 30.0, 5.0)
    assert battery.charge[0] == 0.0
    assert battery.volts[0] == 0.0


def test_energy_given_is_less_than_what_was_stored() -> None:
    battery = Battery(LIPO, 1)
    given = stored = 0.0
    while battery.charge[0] > 0.0:
        stored += float(open_circuit_share(battery.charge)[0]) * 16.8 * 40.0
        battery.step(np.array([40.0]), 1.0)
        given += battery.volts[0] * 40.0
    assert given == pytest.approx(stored - 40.0**2 * 0.02 * 450.0, rel=0.01)


def test_an_ideal_source_keeps_its_voltage_until_it_is_drained() -> None:
    battery = Battery(Pack(full_v=12.6), 2)
    use(battery, 30.0, 600.0)
    assert battery.volts == pytest.approx([12.6, 12.6])
    battery.drain(0, 0.1)
    use(battery, 30.0, 0.1)
    assert battery.volts[0] == pytest.approx(12.6 * float(open_circuit_share(np.array([0.1]))[0]))
    assert battery.volts[1] == pytest.approx(12.6)


def test_a_voltage_says_how_full_another_pack_is() -> None:
    battery = Battery(LIPO, 1)
    for charge in (1.0, 0.5, 0.12):
        volts = float(open_circuit_share(np.array([charge]))[0]) * 16.8
        battery.fit(0, volts=volts, capacity_mah=2000.0)
        assert battery.charge[0] == pytest.approx(charge, abs=1e-3)


class TestVehicles:
    def test_arducopters_own_simulation_has_an_ideal_source_unless_told_otherwise(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(), VehicleSpec(params={"SIM_BATT_CAP_AH": 3.3, "SIM_BATT_VOLTAGE": 12.0})])
        gcs.world.step(1.0)
        first, second = (v.copter for v in gcs.world.vehicles)
        assert first.voltage == pytest.approx(12.6)
        assert second.voltage == pytest.approx(12.0, abs=0.01)
        second.params.set("SIM_BATT_VOLTAGE", 11.0)
        assert second.voltage == pytest.approx(11.0, abs=0.01)

    def test_a_hexarotors_voltage_sags_in_flight_and_its_charge_falls(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(airframe="hexa")])
        gcs.take_off(5.0)
        copter = gcs.vehicle.copter
        gcs.world.step(20.0)
        assert 15.0 < copter.voltage < 16.5
        assert gcs.last("BATTERY_STATUS")["battery_remaining"] < 98
        assert copter.params["BATT_CAPACITY"] == 5000.0
        before = copter.sense.throttle
        gcs.vehicle.node.seat.fleet.battery.drain(0, 0.3)
        gcs.world.step(5.0)
        assert copter.sense.throttle > 1.05 * before  # a weak battery turns the rotors slower
        assert gcs.near(0.0, 0.0, -5.0, 0.5)

    def test_without_a_battery_it_falls(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs()
        gcs.take_off(10.0)
        gcs.vehicle.node.seat.fleet.battery.drain(0, 0.0)
        gcs.world.step(1.5)
        assert gcs.ned[2] > -4.0
