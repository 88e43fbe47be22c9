"""EV1's loops, each by itself: the same numbers as PX4's cascade, no jump at a hand-over, no windup."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from agents.controllers import Array, Controller, Level, Reference, State, Trim
from agents.controllers.ev1 import Ev1
from agents.controllers.loops import AltitudeLoop, AttitudeLoop, PositionLoop, RatesLoop, VelocityLoop
from agents.controllers.loops.parts import attitude_of
from agents.controllers.stack import Stack
from tests.agents.controllers.flying import CYCLE, Cycles, Flight, Hexarotor, Log
from zmav.sim.control.gains import px4_gains
from zmav.sim.control.px4 import Px4Cascade
from zmav.sim.control.setpoints import Axis, Setpoints, Spool
from zmav.sim.dynamics.airframe import airframe

FRAME = airframe("hexa")
HOVER = FRAME.hover_thrust_n / FRAME.thrust_max_n
GRAVITY = 9.80665
STILL = State(t=0.0, dt=CYCLE, motors=np.full(6, 0.5))


class Known:
    """What a loop of the simulator's reads."""

    def __init__(self, state: State) -> None:
        self.pos, self.vel = state.pos[:, None], state.vel[:, None]
        self.q, self.rate = state.q[:, None], state.rates[:, None]


def tossed(rng: np.random.Generator, cycles: int, sway: float = 1.0) -> list[State]:
    """A vehicle thrown about smoothly: states of so many cycles."""
    times = np.arange(cycles) * CYCLE
    waves = rng.uniform(0.5, 4.0, (9, 1)), rng.uniform(0.0, 6.3, (9, 1))
    rows = np.sin(times * waves[0] + waves[1]) * sway
    euler = rows[6:9] * [[0.5], [0.5], [2.0]]
    states = []
    for k, t in enumerate(times):
        r, p, y = euler[:, k] / 2
        turn = np.array(
            [
                math.cos(r) * math.cos(p) * math.cos(y) + math.sin(r) * math.sin(p) * math.sin(y),
                math.sin(r) * math.cos(p) * math.cos(y) - math.cos(r) * math.sin(p) * math.sin(y),
                math.cos(r) * math.sin(p) * math.cos(y) + math.sin(r) * math.cos(p) * math.sin(y),
                math.cos(r) * math.cos(p) * math.sin(y) - math.sin(r) * math.sin(p) * math.cos(y),
            ]
        )
        states.append(State(float(t), CYCLE, 3.0 * rows[:3, k], 3.0 * rows[3:6, k], turn, 2.0 * rows[3:6, k]))
    return states


def cascade() -> tuple[Px4Cascade, Setpoints]:
    setpoints = Setpoints(1, px4_gains(1))
    loops = Px4Cascade(FRAME, setpoints, np.zeros((3, 1)), np.zeros(1))
    setpoints.spool[:] = Spool.FLY
    setpoints.raw[:] = True
    for name, value in (("speed", 12.0), ("speed_up", 3.0), ("speed_down", 1.5), ("lean", math.radians(45.0))):
        setpoints.limits[name][:] = value
    return loops, setpoints


def begun(loop: VelocityLoop | AltitudeLoop) -> None:
    """With PX4's own hover thrust, as if it had been learned, and nothing else."""
    loop.hover.learn(HOVER, 0.0, 0.0, 1.0)


class TestLikePx4:
    def test_position_and_velocity_give_the_same_attitude_and_thrust(self) -> None:
        """Over seconds of violent motion, limits of lean and thrust and the integrators' rules included."""
        rng = np.random.default_rng(4)
        theirs, setpoints = cascade()
        # The same hover thrust throughout: theirs is not learned.
        position, velocity = PositionLoop(), VelocityLoop({"hover_tau": 100.0})
        begun(velocity)
        velocity.hover.learn = lambda *_: 1.0  # type: ignore[method-assign]
        lean, least, most = 0.0, 1.0, 0.0
        full = FRAME.thrust_max_n * len(FRAME.rotors)
        for k, state in enumerate(tossed(rng, 3000, 1.5)):
            t = k * CYCLE
            wanted = Reference(
                pos=np.array([4.0 * math.sin(t), 3.0 * math.cos(1.7 * t), 3.0 * math.sin(0.9 * t)]),
                vel=np.array([4.0 * math.cos(t), -5.1 * math.sin(1.7 * t), 2.7 * math.cos(0.9 * t)]),
                acc=np.array([-4.0 * math.sin(t), 0.0, 0.5]),
                yaw=math.sin(0.5 * t),
            )
            setpoints.pos[:, 0], setpoints.vel[:, 0], setpoints.acc[:, 0] = wanted.pos, wanted.vel, wanted.acc
            setpoints.yaw[:] = wanted.yaw
            theirs.outer(Known(state), CYCLE)
            below = Reference("velocity", vel=position.update(state, wanted).vel, acc=wanted.acc, yaw=wanted.yaw)
            ours = velocity.update(state, below)
            if k == 0:
                continue  # it takes the first velocity for a slope from nothing
            if k == 1:
                for axis, slope in zip(velocity.axes, theirs.vel_dot[:, 0], strict=True):
                    axis.slope = float(slope)
                for axis, integral in zip(velocity.axes, theirs.vel_i[:, 0], strict=True):
                    axis.integral = float(integral)
                continue
            assert ours.thrust == pytest.approx(float(theirs.thrust[0]) / full, abs=1e-9)
            assert np.allclose(ours.attitude, theirs.attitude[:, 0], atol=1e-9)
            lean = max(lean, 2.0 * math.acos(min(math.hypot(ours.attitude[0], ours.attitude[3]), 1.0)))
            least, most = min(least, ours.thrust), max(most, ours.thrust)
        assert lean > math.radians(44.9) and least < 0.121 and most > 0.999, "it has been at each limit"

    def test_attitude_gives_the_same_rates(self) -> None:
        rng = np.random.default_rng(5)
        theirs, _ = cascade()
        theirs.gains.rate_max[:, 0] = np.radians([220.0, 220.0, 200.0])
        ours = AttitudeLoop()
        for _ in range(300):
            actual, wanted = (q / np.linalg.norm(q) for q in rng.normal(size=(2, 4)))
            state = State(q=actual)
            theirs.attitude = wanted[:, None]
            theirs.level(Known(state))
            mine = ours.update(state, Reference("attitude", attitude=wanted, thrust=0.4))
            assert np.allclose(mine.rates, theirs.want_rate[:, 0], atol=1e-9) and mine.thrust == 0.4

    def test_rates_give_the_same_motors(self) -> None:
        rng = np.random.default_rng(6)
        theirs, setpoints = cascade()
        ours = RatesLoop()
        setpoints.horizontal[:], setpoints.vertical[:] = Axis.RATES, Axis.DIRECT
        setpoints.thrust[:] = 0.5
        mixer = theirs.allocator
        for k, state in enumerate(tossed(rng, 1500, 0.2)):
            wanted = 0.4 * np.sin(np.array([1.0, 1.3, 0.6]) * k * CYCLE)
            setpoints.body[:, 0] = wanted
            theirs.outer(Known(state), CYCLE)
            theirs.level(Known(state))
            throttle = theirs.inner(Known(state), CYCLE)
            mine = ours.update(state, Reference("rates", rates=wanted, thrust=0.5))
            if k == 0:
                theirs.rate_dot[:] = 0.0
                continue
            shares, _ = mixer.allocate(mine.torque[:, None], np.array([mine.thrust]))
            assert np.allclose(throttle, shares, atol=1e-9)

    def test_a_turn_is_fed_forward_about_the_worlds_axis(self) -> None:
        lean = 0.5
        q = np.array([math.cos(lean / 2), math.sin(lean / 2), 0.0, 0.0])
        rates = AttitudeLoop().update(State(q=q), Reference("attitude", attitude=q, yaw_rate=1.0)).rates
        assert np.allclose(rates, [0.0, math.sin(lean), math.cos(lean)])


class TestBumpless:
    @pytest.mark.parametrize("kind", [VelocityLoop, AltitudeLoop])
    def test_the_first_thrust_and_attitude_are_the_autopilots(self, kind: type[VelocityLoop | AltitudeLoop]) -> None:
        """In the midst of violent motion, with a reference that lies elsewhere."""
        loop = kind()
        rng = np.random.default_rng(7)
        for k, state in enumerate(tossed(rng, 500)):
            lean = 0.3 * math.sin(k * CYCLE)
            trim = Trim(0.5 + 0.2 * math.cos(k * CYCLE), np.array([math.cos(lean), math.sin(lean), 0.0, 0.0]))
            reference = Reference("altitude", pos=np.array([9.0, 9.0, -9.0]), attitude=trim.attitude)
            loop.reset(state, reference, trim)
            if k % 50 == 0:
                first = copy.deepcopy(loop).update(state, reference)
                assert first.thrust == pytest.approx(trim.thrust, abs=1e-4)
                assert np.allclose(first.attitude, trim.attitude, atol=1e-4)

    def test_the_first_rates_are_the_autopilots_and_then_our_own(self) -> None:
        loop, trim = AttitudeLoop(), Trim(rates=np.array([0.5, -0.4, 0.3]))
        reference = Reference("attitude", attitude=np.array([math.cos(0.1), math.sin(0.1), 0.0, 0.0]))
        loop.reset(STILL, reference, trim)
        assert np.allclose(loop.update(STILL, reference).rates, trim.rates)
        own = AttitudeLoop().update(STILL, reference).rates
        for _ in range(500):
            last = loop.update(STILL, reference).rates
        assert np.allclose(last, own, atol=0.01) and not np.allclose(own, trim.rates, atol=0.1)

    @pytest.mark.parametrize("streams", [False, True])
    def test_the_integrator_takes_what_lasts(self, streams: bool) -> None:
        """The autopilot holds against a wind; the reference lies 20 m away until this takes over. ``streams``: it gives
        outputs already, though nobody flies by them.
        """
        wind, lean = 1.2, math.atan(1.2 / GRAVITY)
        trim = Trim(HOVER / math.cos(lean), np.array([math.cos(lean / 2), 0.0, -math.sin(lean / 2), 0.0]))
        for far in (0.0, 20.0):
            loop = VelocityLoop()
            reference = Reference("velocity", vel=np.array([-far, 0.5 * far, 0.0]))
            for k in range(2000):
                state = State(t=k * CYCLE, dt=CYCLE, q=trim.attitude)
                loop.reset(state, reference, trim)
                if streams:
                    loop.update(state, reference)
            integral = [axis.integral for axis in loop.axes]
            assert integral == pytest.approx([wind, 0.0, 0.0], abs=0.02)

    def test_a_turn_does_not_bias_it(self) -> None:
        """The autopilot flies a circle in the wind, and the reference is the same: what it asks for is mostly fed
        forward.
        """
        loop, wind = VelocityLoop(), 1.0
        for k in range(2200):
            angle = 1.25 * k * CYCLE
            acc = 3.0 * np.array([math.cos(angle), math.sin(angle), 0.0])
            lean = np.array([acc[0] - wind, acc[1], 0.0]) / GRAVITY
            down = np.array([-lean[0], -lean[1], 1.0])
            thrust = HOVER * float(np.linalg.norm(down))
            attitude = np.array(attitude_of(tuple(down / np.linalg.norm(down)), 0.0))
            state = State(t=k * CYCLE, dt=CYCLE, q=attitude)
            loop.reset(state, Reference("velocity", acc=acc), Trim(thrust, attitude))
        assert [axis.integral for axis in loop.axes[:2]] == pytest.approx([-wind, 0.0], abs=0.02)

    @pytest.mark.parametrize("lean", [1.4, math.pi / 2, 2.0, math.pi])
    def test_from_a_tumble_it_comes_back_within_two_seconds(self, lean: float) -> None:
        """As with a lean beyond the limit, and of a vehicle on its back, with motors that stand still."""
        q = np.array([math.cos(lean / 2), math.sin(lean / 2), 0.0, 0.0])
        for thrust in (0.0, 1.0):
            for loop in (VelocityLoop(), AltitudeLoop()):
                reference = Reference("altitude")
                loop.reset(State(dt=CYCLE, q=q), reference, Trim(thrust, q, np.array([6.0, 0.0, 0.0])))
                for k in range(1, 500):
                    output = loop.update(State(t=k * CYCLE, dt=CYCLE), reference)
                    assert np.isfinite(output.attitude).all() and 0.0 <= output.thrust <= 1.0
                if isinstance(loop, VelocityLoop):  # the other leans as it is told
                    assert State(q=output.attitude).rotation[2, 2] > math.cos(math.radians(20.0))

    def test_what_is_learned_on_the_ground_is_forgotten(self) -> None:
        loop, reference = VelocityLoop(), Reference("velocity")
        for k in range(5000):
            grounded = k < 2500
            loop.reset(State(t=k * CYCLE, dt=CYCLE), reference, Trim(0.05 if grounded else HOVER))
        assert loop.hover.share == pytest.approx(HOVER, rel=0.01)
        rates = RatesLoop()
        for k in range(25000):
            rates.reset(State(t=k * CYCLE, dt=CYCLE), reference, Trim(0.05, rates=np.array([0.2, 0.0, 0.0])))
        assert abs(rates.axes[0].integral) < 0.05


class TestWindup:
    def test_a_speed_that_cannot_be_had_winds_nothing_up(self) -> None:
        loop, fast = VelocityLoop(), Reference("velocity", vel=np.array([30.0, 0.0, 0.0]))
        begun(loop)
        for k in range(5000):
            state = State(t=k * CYCLE, dt=CYCLE, vel=np.array([12.0, 0.0, 0.0]))
            loop.update(state, fast)
        # As soon as the error turns round, so does the lean.
        state = State(t=20.0, dt=CYCLE, vel=np.array([36.0, 0.0, 0.0]))
        down = State(q=loop.update(state, fast).attitude).rotation[:, 2]
        assert down[0] > 0.0, "it leans back"

    def test_nor_does_a_climb(self) -> None:
        loops: list[VelocityLoop | AltitudeLoop] = [VelocityLoop(), AltitudeLoop()]
        for loop in loops:
            begun(loop)
            loop.hover.learn = lambda *_: 1.0  # type: ignore[method-assign]
            up = Reference("altitude", pos=np.array([0.0, 0.0, -100.0]), vel=np.array([0.0, 0.0, -6.0]))
            for k in range(2500):
                thrust = loop.update(State(t=k * CYCLE, dt=CYCLE), up).thrust
            assert thrust == 1.0
            there = Reference("altitude", vel=np.array([0.0, 0.0, 0.1]))
            assert loop.update(State(t=10.0, dt=CYCLE), there).thrust < HOVER

    def test_motors_at_their_end_stop_the_rates_integrators_one_way(self) -> None:
        full, free = np.array([1.0, 0.6, 0.6, 0.6, 0.6, 0.6]), np.full(6, 0.6)
        more, less = (Reference("rates", rates=np.array([r, 0.0, 0.0])) for r in (1.0, -1.0))
        loop = RatesLoop()

        def last(motors: Array | None, reference: Reference, cycles: int = 250) -> float:
            for _ in range(cycles):
                loop.update(State(dt=CYCLE, motors=motors), reference)
            return loop.axes[0].integral

        assert last(full, more) == 0.0
        assert (grown := last(free, more)) > 0.1
        assert last(full, more) == grown
        assert last(None, more, 25) > grown, "where nobody tells of motors it integrates"
        before = loop.axes[0].integral
        assert last(full, less) < before

    def test_a_torque_beyond_its_range_is_cut_and_not_integrated(self) -> None:
        loop = RatesLoop({"kp_roll": 0.6})
        hard = Reference("rates", rates=np.array([3.0, 0.0, 0.0]), thrust=0.4)
        output = [loop.update(State(dt=CYCLE), hard) for _ in range(100)][-1]
        assert output.torque.tolist() == [1.0, 0.0, 0.0] and output.thrust == 0.4
        assert loop.axes[0].integral == 0.0

    def test_far_away_it_overshoots_no_more_than_the_autopilot(self) -> None:
        """25 m at once: the speed's limit and the lean's."""

        def far(t: float) -> Reference:
            return Reference(pos=np.array([0.0 if t < 1.0 else 25.0, 0.0, -5.0]))

        def beyond(craft: Hexarotor, stack: Stack | None) -> Cycles[tuple[float, float]]:
            yield from craft.fly_autopilot(far, 0.9, stack)
            log = yield from craft.fly_autopilot(far, 7.0) if stack is None else craft.fly(stack, far, 7.0)
            return float(log.pos[:, 0].max()) - 25.0, float(log.lean().max())

        with Flight(wind=(4.0, 0.0, 0.0), noise="typical", seed=2, ways=2) as flight:
            theirs, ours = flight.together([beyond(flight[0], None), beyond(flight[1], Stack(Ev1()))])
        assert ours[1] > math.radians(43.0), "the lean has been at its limit"
        assert 0.0 < ours[0] < 1.1 * theirs[0]


def test_the_hover_thrust_is_learned_and_the_thrust_does_not_jump_by_it() -> None:
    """A vehicle that moves only up and down, 30 % heavier than it is taken for."""
    true, loop = 1.3 * HOVER, AltitudeLoop()
    begun(loop)
    height, climb, thrusts = 0.0, 0.0, []
    for k in range(15000):
        wanted = Reference("altitude", pos=np.array([0.0, 0.0, 0.5 * math.sin(k * CYCLE)]))
        state = State(t=k * CYCLE, dt=CYCLE, pos=np.array([0.0, 0.0, height]), vel=np.array([0.0, 0.0, climb]))
        thrusts.append(loop.update(state, wanted).thrust)
        climb += (1.0 - thrusts[-1] / true) * GRAVITY * CYCLE
        height += climb * CYCLE
    assert loop.hover.share == pytest.approx(true, rel=0.02)
    assert abs(loop.down.integral) < 0.2, "what the integrator had carried is given back"
    assert np.abs(np.diff(thrusts[100:])).max() < 0.01


# ---- each at its own level, in flight


def doublet(level: Level, size: float) -> Callable[[float], Reference]:
    """About the roll axis and back, held 0.4 s each; the thrust hovers."""

    def at(t: float) -> Reference:
        sign = (0.0, 1.0, -1.0, 0.0)[min(int(t / 0.4), 3)]
        half = 0.5 * sign * size
        attitude = np.array([math.cos(half), math.sin(half), 0.0, 0.0])
        return Reference(level, rates=np.array([sign * size, 0.0, 0.0]), attitude=attitude, thrust=0.53)

    return at


def leaning(t: float) -> Reference:
    half = 0.5 * math.radians(25.0) * math.sin(2.0 * t)
    climb = 0.0 if t < 1.0 else min(t - 1.0, 2.0) * 0.75
    return Reference(
        "altitude",
        pos=np.array([0.0, 0.0, -5.0 - climb]),
        vel=np.array([0.0, 0.0, -0.75 if 1.0 <= t < 3.0 else 0.0]),
        attitude=np.array([math.cos(half), math.sin(half), 0.0, 0.0]),
    )


def quick(t: float) -> Reference:
    speed = 0.0 if t < 0.5 else 3.0 if t < 2.5 else -1.0
    return Reference("velocity", vel=np.array([speed, 0.5 * speed, -0.3]))


WAYS: list[tuple[type[Controller] | None, Callable[[float], Reference], float]] = [
    (RatesLoop, doublet("rates", 1.0), 1.6),
    (None, doublet("rates", 1.0), 1.6),
    (AttitudeLoop, doublet("attitude", math.radians(25.0)), 1.6),
    (None, doublet("attitude", math.radians(25.0)), 1.6),
    (AltitudeLoop, leaning, 6.0),
    (VelocityLoop, quick, 5.0),
    (None, quick, 5.0),
]
"""what flies (None: the autopilot), what it follows, and for how many seconds"""


@pytest.fixture(scope="module")
def flown() -> list[Log]:
    """Of each of them, at once in the same weather."""
    with Flight(wind=(3.0, 0.0, 0.0), gusts="light", noise="typical", seed=8, ways=len(WAYS)) as flight:
        start = flight.t

        def way(craft: Hexarotor, kind: type[Controller] | None, at: Callable[[float], Reference], s: float) -> Any:
            reference: Callable[[float], Reference] = lambda t: at(t - start)  # noqa: E731
            return craft.fly_autopilot(reference, s) if kind is None else craft.fly(kind(), reference, s)

        return flight.together([way(flight[number], *each) for number, each in enumerate(WAYS)])


def test_rates_follow_a_doublet_as_the_autopilots_do(flown: list[Log]) -> None:
    def miss(log: Log) -> float:
        wanted = np.array([each.rates[0] for each in log.reference])
        return math.sqrt(float(((log.rates[:, 0] - wanted) ** 2).mean()))

    ours, theirs = flown[0:2]
    assert miss(ours) < 1.1 * miss(theirs)


def test_the_attitude_follows_a_doublet_as_the_autopilots_does(flown: list[Log]) -> None:
    def miss(log: Log) -> float:
        roll = np.array([State(q=q).euler[0] for q in log.q])
        wanted = np.array([State(q=each.attitude).euler[0] for each in log.reference])
        return math.sqrt(float(((roll - wanted) ** 2).mean()))

    ours, theirs = flown[2:4]
    assert miss(ours) < 1.1 * miss(theirs)


def test_the_altitude_is_held_while_somebody_leans(flown: list[Log]) -> None:
    log = flown[4]
    miss = log.pos[:, 2] - log.ref_pos[:, 2]
    assert math.sqrt(float((miss**2).mean())) < 0.15 and abs(miss[-1]) < 0.2
    assert log.lean().max() > math.radians(20.0)


def test_a_velocity_is_followed_as_the_autopilot_does(flown: list[Log]) -> None:
    ours, theirs = flown[5:7]
    assert ours.rms_velocity() < 1.1 * theirs.rms_velocity()
