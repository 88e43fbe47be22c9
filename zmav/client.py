"""The key space from asyncio: what agents, scripts and the command line stand on.

async with zmav.open() as z:
    for vehicle in z.fleet():
        print(vehicle.name, vehicle.state.mode)
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar, overload

import msgspec
import zenoh

from zmav import keys, wire
from zmav.direct import direct
from zmav.errors import BadInput, BadKey, Forbidden, NoSuchVehicle, Refused, ZmavError
from zmav.mavlink import Dialect, MavMessage, describe, load_dialect, parse_frame
from zmav.ratelimit import RateLimit
from zmav.services.queries.everybody import ask_everybody, challenge_vehicle
from zmav.services.queries.intake import Intake
from zmav.services.queries.proven import attached, proof_of_error
from zmav.session import SessionSettings, check_size, open_in_thread, reason
from zmav.subscription import Subscription
from zmav.tokens import TokenTable
from zmav.trust import VARIABLE
from zmav.trust.credentials import own_credentials
from zmav.trust.member import Member, Place
from zmav.vehicle import Vehicle
from zmav.vehicle.rates import want_key
from zmav.vehicle.vehicle import is_meant
from zmav.waiting import in_thread, on_loop, within

T = TypeVar("T")
OVER = b"Timeout"
"""Zenoh's own words when a query's time is over: nobody's answer"""
logger = logging.getLogger(__name__)
MEET_EVERY = 1.0
"""s between two times that one vehicle is asked for its certificate, or for its time"""
TIME_ANSWER = 2.0
"""s for the latter's answer: by so much the time may be wrong that it tells"""
STRANGERS = 20
"""names that are nobody's as far as we know, and are asked within that time: they are soon invented"""
ROSTERS_WAITING = 64
"""rosters that have come and were not looked at yet: the newest"""
SAID = 1000
"""vehicles and reasons that are told apart in what is said once"""
FORGET = 30.0
"""s without token or state after which a vehicle is no longer listed"""


class Answer(NamedTuple):
    """One reply to a query."""

    key: str
    payload: bytes


class Received(NamedTuple):
    """A decoded message, and the name of the vehicle it came from."""

    vehicle: str
    message: MavMessage


class LastState(NamedTuple):
    """A vehicle's last state and when it came (monotonic seconds)."""

    state: wire.VehicleState
    at: float


class Client:
    """An open session and the vehicles seen through it. Made by :func:`zmav.open`."""

    def __init__(self, settings: SessionSettings, fleet: str, dialect: str) -> None:
        self._settings, self.fleet_name, self._dialect_name = settings, fleet, dialect
        self._heard: dict[Place, LastState] = {}
        self._tokens: TokenTable[Place, None] = TokenTable(lambda place: self.is_vehicle(*place))
        self._news = asyncio.Event()
        self._session: zenoh.Session | None = None
        self.member: Member | None = None
        """who we are, where the session has credentials: it signs, and believes of vehicles what they signed"""
        self._met: RateLimit[Place] = RateLimit(MEET_EVERY, SAID)
        self._strangers: RateLimit[Place] = RateLimit(MEET_EVERY, STRANGERS)
        self._rosters: Intake | None = None
        self._asked: RateLimit[Place] = RateLimit(MEET_EVERY, SAID)
        self._newest: dict[Place, float] = {}
        self._said: set[tuple[Place, str]] = set()

    async def __aenter__(self) -> Client:
        if self._settings.credentials:
            self.member = Member(own_credentials(self._settings.credentials, self.fleet_name))
        self._session = session = await open_in_thread(self._settings)
        loop = asyncio.get_running_loop()
        if self.member is not None:
            roster = keys.FLEET.key(self.member.credentials.fleet, topic=keys.ROSTER)
            self._rosters = Intake(session.declare_subscriber, roster, self._on_roster, ROSTERS_WAITING)
        session.declare_subscriber(keys.STATE.key(self.fleet_name, "*"), on_loop(loop, self._on_state))
        role = keys.REPLAY if keys.is_replay(self.fleet_name) else keys.VEHICLE
        alive = keys.ALIVE.key(self.fleet_name, "*", role=role, sys="*", autopilot="*", uid="*", instance="*")
        session.liveliness().declare_subscriber(alive, on_loop(loop, self._on_token), history=True)
        return self

    def adopt(self, session: zenoh.Session) -> None:
        """Ask in a session that somebody else opens and closes, instead of entering; it hears nothing by itself."""
        self._session, folder = session, self._settings.credentials
        self.member = Member(own_credentials(folder, self.fleet_name)) if folder else None

    async def __aexit__(self, *_: object) -> None:
        if self._rosters is not None:
            self._rosters.close()
        if self._session is not None:
            await in_thread(self._session.close)

    @property
    def session(self) -> zenoh.Session:
        """The Zenoh session itself, for what is not here."""
        if self._session is None:
            raise RuntimeError("the client is not open: use 'async with zmav.open() as z'")
        return self._session

    async def another_session(self) -> zenoh.Session:
        """Opened as ours was, for what is not to queue before anything else; who asks for it closes it."""
        return await open_in_thread(self._settings)

    @property
    def dialect(self) -> Dialect:
        """The MAVLink dialect messages are decoded with; loaded when first needed."""
        return load_dialect(self._dialect_name)

    # Vehicles.

    def vehicle(self, name: str) -> Vehicle:
        """The vehicle of that name, present or not; raises :class:`~zmav.errors.BadKey` for what cannot be a name."""
        return Vehicle(self, keys.check_name(name, "vehicle"), self.fleet_name)

    def fleet(self) -> list[Vehicle]:
        """The vehicles present or heard within the last half minute, by name."""
        now = time.monotonic()
        recent = {place for place, heard in self._heard.items() if now - heard.at < FORGET}
        return [Vehicle(self, name, fleet) for fleet, name in sorted(recent.union(self._tokens))]

    def heard(self, name: str, fleet: str) -> LastState | None:
        """The last state of a vehicle, the newest of its namesakes' where ``fleet`` is ``*``; None: never heard."""
        found = [heard for place, heard in self._heard.items() if _is(place, name, fleet)]
        return max(found, key=lambda heard: heard.at, default=None)

    def present(self, name: str, fleet: str) -> bool:
        """Its token is there, or its state came within the staleness limit: either may be lost without the other."""
        heard = self.heard(name, fleet)
        fresh = heard is not None and time.monotonic() - heard.at < (keys.STATE.stale_after or 0.0)
        return fresh or any(_is(place, name, fleet) for place in self._tokens)

    def is_vehicle(self, fleet: str, name: str) -> bool:
        """Whether a name is a vehicle's: by the roster where we have credentials, else any is."""
        return self.member is None or self.member.verifier.is_vehicle(fleet, name)

    def disbelieved(self, name: str, fleet: str) -> list[str]:
        """Why something said in a vehicle's name was not believed, by reason; with credentials only."""
        return sorted({reason for place, reason in self._said if _is(place, name, fleet)})

    def fleets_of(self, name: str) -> list[str]:
        """The fleets in which a vehicle of that name is known."""
        return sorted({fleet for fleet, known in (*self._heard, *self._tokens) if known == name})

    async def wait_for(self, *names: str, timeout: float = 10.0) -> list[Vehicle]:
        """Wait until vehicles of these names speak; raises :class:`~zmav.errors.NoSuchVehicle` naming the missing."""
        vehicles, deadline = [self.vehicle(name) for name in names], time.monotonic() + timeout
        while missing := [v.name for v in vehicles if v.age is None or v.age > (keys.STATE.stale_after or 0.0)]:
            if not await self.news(deadline - time.monotonic()):
                present = ", ".join(v.name for v in self.fleet() if v.name not in missing) or "nobody else"
                raise NoSuchVehicle(
                    f"not heard within {timeout:.0f} s: {', '.join(missing)} (present: {present})", missing=missing
                )
        return vehicles

    async def settle(self, timeout: float = 2.0, quiet: float = 0.5) -> list[Vehicle]:
        """Wait until nobody new has spoken for ``quiet`` seconds, ``timeout`` at most; the vehicles known then."""
        deadline, known, since = time.monotonic() + timeout, 0, 0.0
        while (now := time.monotonic()) < deadline:
            count = len(self._heard) + sum(1 for _ in self._tokens)
            if count != known:
                known, since = count, now
            elif known and now - since >= quiet:
                break
            await self.news((min(deadline, since + quiet) if known else deadline) - now)
        return self.fleet()

    async def look(self, timeout: float) -> list[Vehicle]:
        """Ask all that are there for their state; the vehicles known once each has told it, or after ``timeout`` s.

        All of it is waited where nobody is known yet, for recordings, which are not asked, and by a session that may
        still be calling other routers.
        """
        deadline, told, loop = time.monotonic() + timeout, asyncio.Event(), asyncio.get_running_loop()

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and _place(reply.ok) not in self._heard:
                self._on_state(reply.ok)

        def on_end() -> None:
            told.set()
            self._news.set()

        if self._settings.mode in (None, "client") and not self._settings.file and not keys.is_replay(self.fleet_name):
            handler = direct(on_loop(loop, on_reply), on_loop(loop, on_end))
            ask_everybody(self.session, keys.STATE.qos, keys.STATE.key(self.fleet_name, "*"), handler, timeout=timeout)
        while (left := deadline - time.monotonic()) > 0:
            if told.is_set() and self._heard and all(place in self._heard for place in self._tokens):
                break
            await self.news(left)
        return self.fleet()

    async def news(self, timeout: float) -> bool:
        """Wait until any vehicle's state or presence changes; False when nothing came within ``timeout`` seconds."""
        self._news.clear()
        try:
            await within(timeout, self._news.wait())
        except asyncio.TimeoutError:
            return False
        return True

    def _on_roster(self, sample: zenoh.Sample) -> None:
        """In a thread of its own: anybody may bring them, however fast."""
        assert self.member is not None
        self.member.take_roster(sample.payload.to_bytes())

    def _on_state(self, sample: zenoh.Sample) -> None:
        place = _place(sample)
        if keys.is_replay(place[0]) != keys.is_replay(self.fleet_name):
            return  # of all fleets: recordings are heard by who names theirs, and are nobody's vehicles
        try:
            self._judge(sample, self._newest)
            state = wire.decode(sample.payload.to_bytes(), wire.VehicleState, f"state of {place[1]}")
        except (BadInput, Forbidden):
            return  # a newer or a broken peer: it is listed by its token, and 'zmav echo' shows what it says
        if self.member is not None:
            self.member.answers(place, state.gate)
        self._heard[place] = LastState(state, time.monotonic())
        self._news.set()

    def _on_token(self, sample: zenoh.Sample) -> None:
        place = _place(sample)
        if sample.kind == zenoh.SampleKind.PUT:
            if self._tokens.add(place, str(sample.key_expr), None):
                self._meet(place)
        else:
            self._tokens.remove(place, str(sample.key_expr))
        self._news.set()

    def _judge(self, sample: zenoh.Sample, newest: dict[Place, float]) -> None:
        """Raise :class:`Forbidden` for a state or an event that its vehicle did not sign, where we can tell."""
        if self.member is None:
            return
        try:
            self.member.judge(str(sample.key_expr), sample.payload.to_bytes(), attached(sample), newest)
        except Forbidden as e:
            place = _place(sample)
            if e.detail["reason"] == "clock" and self.is_vehicle(*place) and keys.NAME.match(place[1]):
                self._ask_time(self.member, place)
            self._disbelieve(place, str(sample.key_expr), e)
            raise

    def _ask_time(self, member: Member, place: Place) -> None:
        """What is now, by a challenge, which only the vehicle answers, and only now: it is judged by its time then."""

        def on_state(key: str, payload: bytes, proof: bytes | None, challenge: bytes) -> None:
            with contextlib.suppress(Forbidden):
                member.take_time(place, key, payload, proof, challenge)

        if self._asked.take(place) is not None:
            challenge_vehicle(self.session, place, on_state, timeout=TIME_ANSWER)

    def _meet(self, place: Place) -> None:
        """Ask a vehicle for its certificate, unless it was just asked; what it says from then on can be judged."""
        member, met = self.member, self._met if self.is_vehicle(*place) else self._strangers
        if member is None or self._session is None or met.take(place) is None:
            return

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                with contextlib.suppress(Forbidden):
                    member.verifier.meet(reply.ok.payload.to_bytes())

        ask_everybody(self._session, keys.CERTIFICATE.qos, keys.CERTIFICATE.key(*place), on_reply, timeout=2.0)

    # The key space.

    @overload
    def subscribe(
        self, key: str, *, depth: int = 1000, token: str = "", history: int = 0
    ) -> Subscription[zenoh.Sample]: ...

    @overload
    def subscribe(
        self, key: str, convert: Callable[[zenoh.Sample], T], depth: int = 1000, token: str = "", history: int = 0
    ) -> Subscription[T]: ...

    def subscribe(
        self,
        key: str,
        convert: Callable[[zenoh.Sample], Any] | None = None,
        depth: int = 1000,
        token: str = "",
        history: int = 0,
    ) -> Subscription[Any]:
        """Samples of a key expression (``quad*/ATTITUDE`` or ``zmav/...``), converted one by one.

        A sample for which ``convert`` raises :class:`~zmav.errors.BadInput` is counted and left out. At most ``depth``
        of them wait for the reader. ``token``: the key of a liveliness token that is there as long as it is read
        (:func:`zmav.vehicle.rates.want_key`). ``history``: how many of each vehicle's past events come first, where the
        key is that of events. With credentials, states and events that their vehicles did not sign are
        left out, too. Raises :class:`~zmav.errors.BadKey`.
        """
        newest: dict[Place, float] = {}

        def believed(sample: zenoh.Sample) -> Any:
            self._judge(sample, newest)
            return convert(sample) if convert else sample

        return Subscription(self.session, keys.expression(key, self.fleet_name), believed, depth, token, history)

    def stream(self, key: str, depth: int = 1000, hz: float | None = None) -> Subscription[Received]:
        """Every message of a key expression, decoded: ``async with z.stream("quad*/ATTITUDE") as s: async for vehicle,
        message in s: ...``.

        ``hz``, for one message by name: the autopilots are asked for that many a second as long as it is read. What is
        not a frame is counted and left out. Raises :class:`~zmav.errors.BadKey`, or :class:`BadInput` for a bad rate.
        """
        dialect = self.dialect

        def convert(sample: zenoh.Sample) -> Received:
            frame = parse_frame(sample.payload.to_bytes(), dialect)
            return Received(_place(sample)[1], describe(frame, dialect))

        key = keys.expression(key, self.fleet_name)
        return self.subscribe(key, convert, depth, token="" if hz is None else want_key(key, hz))

    def say_status(self, agent: str, state: str, text: str = "", *, vehicle: str = "ground", **detail: Any) -> None:
        """Say what a program does, in a word and in a sentence, under the vehicle (or other host) that it runs for.

        Repeat it once a second: who is silent for five is taken for dead. Raises :class:`~zmav.errors.BadKey` for what
        cannot be a name.
        """
        status = wire.AgentStatus(
            t=time.time(), agent=keys.check_name(agent, "agent"), state=state, text=text, detail=detail
        )
        fleet, host = keys.check_name(self.fleet_name, "fleet"), keys.check_name(vehicle, "vehicle")
        self.put(keys.AGENT_STATUS, keys.AGENT_STATUS.key(fleet, host, agent=agent), status)

    async def ask(
        self,
        key: str,
        payload: bytes = b"",
        timeout: float = 2.0,
        channel: keys.Channel = keys.DO,
        enough: Callable[[Answer], bool] = lambda answer: False,
    ) -> list[Answer | ZmavError]:
        """Query a key expression; every answer that comes, error replies as exceptions in the list.

        ``channel``: whose class of service it has. Of bulk nothing is held back for the end, which may be lost like
        any part of it; an answer that is ``enough`` ends the waiting. What somebody is to answer for
        (:attr:`~zmav.keys.Channel.answerers`) is asked of all who claim to, and the first answer of who is meant ends
        the waiting, too: a program that swallows the question changes nothing. With credentials, what needs a proof of
        origin is signed, and signed a second time where the vehicle asks for that; answers that are not signed by who
        may answer are left out.
        """
        answers = await self._ask(key, payload, timeout, channel, enough)
        refused = next((answer for answer in answers if isinstance(answer, Forbidden)), None)
        if refused is not None and self.member is not None and self.member.may_try_again(key, refused):
            return await self._ask(key, payload, timeout, channel, enough)
        return answers

    async def _ask(
        self, key: str, payload: bytes, timeout: float, channel: keys.Channel, enough: Callable[[Answer], bool]
    ) -> list[Answer | ZmavError]:
        check_size(key, payload)
        loop, done = asyncio.get_running_loop(), asyncio.Event()
        answers: list[Answer | ZmavError] = []
        answered = bool(keys.answerers(key))
        question = None if self.member is None else self.member.question(key, payload)

        def on_reply(reply: zenoh.Reply) -> None:
            answer: Answer | ZmavError
            if reply.ok is not None:
                answer, proof = Answer(str(reply.ok.key_expr), reply.ok.payload.to_bytes()), attached(reply.ok)
                said = answer.payload
                if not keys.hears(key, answer.key):
                    return
            elif reply.err is not None and (said := reply.err.payload.to_bytes()) != OVER:
                answer = wire.error_from(said)
                proof = proof_of_error(reply.err, answer)
            else:
                return
            if self._believes(key, said, proof, question):
                answers.append(answer)
                if is_meant(answer) if answered else isinstance(answer, Answer) and enough(answer):
                    done.set()

        handler = direct(on_loop(loop, on_reply), on_loop(loop, done.set))
        try:
            each = answered or channel.qos is keys.Qos.BULK
            self.session.get(
                key,
                handler,
                payload=payload,
                attachment=question,
                timeout=timeout,
                encoding=keys.JSON,
                target=zenoh.QueryTarget.ALL if answered else None,
                consolidation=zenoh.ConsolidationMode.NONE if each else None,
                **channel.qos.options(),
            )
        except zenoh.ZError as e:
            raise BadKey(f"cannot query {key!r}: {reason(e)}", field="key", value=key) from e
        with contextlib.suppress(asyncio.TimeoutError):
            await within(timeout + 1.0, done.wait())
        return answers

    def _believes(self, key: str, said: bytes, proof: bytes | None, question: bytes | None) -> bool:
        """An answer comes from who may answer, as far as we can tell; what does not is said once."""
        if self.member is None:
            return True
        try:
            self.member.believe(key, said, proof, question)
        except Forbidden as e:
            self._disbelieve((key.split("/")[1], key.split("/")[2]), f"the answer on {key}", e)
            return False
        return True

    def _disbelieve(self, place: Place, what: str, error: Forbidden) -> None:
        reason = str(error.detail["reason"])
        if reason == "unknown" and keys.NAME.match(place[1]):
            self._meet(place)
        elif (place, reason) not in self._said and len(self._said) < SAID:
            self._said.add((place, reason))
            logger.warning("not believed, said once: %s: %s", what, error)

    def put(
        self,
        channel: keys.Channel,
        key: str,
        payload: bytes | msgspec.Struct,
        attachment: bytes | None = None,
        publisher: zenoh.Publisher | None = None,
    ) -> None:
        """Put on a channel's key with its encoding and class of service, and with a proof of origin where it needs one.

        Raises :class:`~zmav.errors.Refused` for a frame to a recording.
        ``attachment``: what goes with it instead. ``publisher``: the key's, where links are not to repeat it.
        """
        if channel is keys.TX and keys.is_replay(key.split("/")[1]):
            raise Refused(f"{key}: a recording takes no frames", key=key)
        data = payload if isinstance(payload, bytes) else wire.encode(payload)
        check_size(key, data)
        proof = self.member.proof(key, data) if attachment is None and self.member is not None else attachment
        if publisher is not None:
            publisher.put(data, attachment=proof)
        else:
            self.session.put(key, data, encoding=channel.encoding, attachment=proof, **channel.qos.options())


def _place(sample: zenoh.Sample) -> Place:
    _, fleet, name, *_ = str(sample.key_expr).split("/")
    return fleet, name


def _is(place: Place, name: str, fleet: str) -> bool:
    return place[1] == name and fleet in ("*", place[0])


def connect(
    *,
    fleet: str = "demo",
    connect: Sequence[str] = (),
    settings: SessionSettings | None = None,
    dialect: str = "ardupilotmega",
    credentials: str | None = None,
) -> Client:
    """Open the key space: ``async with zmav.open() as z``.

    ``connect`` are Zenoh endpoints; ``$ZMAV_CONNECT``, or the host's own router on loopback, by default. ``fleet`` may
    be ``*``. ``credentials``: the folder of the member we are; ``$ZMAV_CREDENTIALS`` by default. Raises
    :class:`~zmav.errors.SessionError` on entry where no router answers.
    """
    if fleet != "*":
        keys.check_name(fleet, "fleet")
    if settings is None:
        settings = SessionSettings(connect=tuple(connect), credentials=credentials or os.environ.get(VARIABLE))
    elif credentials:
        settings = msgspec.structs.replace(settings, credentials=credentials)
    return Client(settings, fleet, dialect)
