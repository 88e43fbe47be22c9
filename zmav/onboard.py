"""What runs beside one autopilot: the adapter and the services, put together.

``zmav up`` runs it in a router's session; ``zmav replay`` runs it on a recording, where nothing can be commanded.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from collections.abc import Awaitable, Callable, Coroutine
from pathlib import Path
from typing import Any, Protocol

import msgspec
import zenoh

from zmav import config, keys, wire
from zmav.adapter import Adapter, LinkChanged
from zmav.bus import Alive, Bus
from zmav.errors import BadConfig
from zmav.forwarding import FrameForwarder
from zmav.links import Link, LinkState, open_link
from zmav.mavlink import Dialect, Frame, command_type, load_dialect
from zmav.mavlink.signing import Signing, SigningClock, read_key
from zmav.services.authority.authority import Authority
from zmav.services.authority.bounds import Bounds
from zmav.services.authority.control import Control
from zmav.services.authority.may_move import SetpointCounts
from zmav.services.authority.order_permit import Judge, OrderPermit
from zmav.services.authority.pilot import NEEDS
from zmav.services.authority.preconditions import ParamPreconditions
from zmav.services.authority.separation import Separation
from zmav.services.authority.setpoints import SegmentAccepted
from zmav.services.cameras.cameras import Cameras, Tell, tell_nobody
from zmav.services.companion import Companion
from zmav.services.corrections.corrections import Corrections
from zmav.services.files.files import Files
from zmav.services.files.ftp import Ftp
from zmav.services.files.logs import Logs
from zmav.services.files.store import Store, default_directory
from zmav.services.gimbal.gimbal import Gimbal
from zmav.services.link.identity import Identity, VehicleChanged
from zmav.services.link.patience import Patience
from zmav.services.link.port import FrameRefused
from zmav.services.link.quality import Quality
from zmav.services.link.timesync import AutopilotRestarted, TimeSync
from zmav.services.missions.flight import MissionFlight
from zmav.services.missions.missions import Missions
from zmav.services.orders.camera import TriggeredCamera
from zmav.services.orders.command import Commander
from zmav.services.orders.flight import Flight
from zmav.services.orders.orders import Guarded, Handler, Orders, Report
from zmav.services.orders.payload import Payload
from zmav.services.params.params import Params
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions, QuestionsDropped
from zmav.services.rates.rates import Rates
from zmav.services.status.answers import BodyService, HostService, Messages, SchemaService
from zmav.services.status.events import Events
from zmav.services.status.presence import Presence
from zmav.services.status.px4_events import EventTexts
from zmav.services.status.state import StateService
from zmav.services.terrain.requests import TerrainRequests
from zmav.services.traffic.traffic import Traffic
from zmav.systemd import state_directory
from zmav.terrain import Terrain
from zmav.trust.certificate import Role, warn_of_end
from zmav.trust.credentials import Credentials
from zmav.trust.gate import Gate, ProofRefused, anybody
from zmav.trust.proof import Signer
from zmav.trust.roster import Roster
from zmav.waiting import in_thread, on_loop


class OnboardSettings(msgspec.Struct, kw_only=True, frozen=True):
    """One vehicle: where its autopilot is, what it is called, and where the fleet's frame begins."""

    link: str
    name: str
    fleet: str = "demo"
    dialect: str = "ardupilotmega"
    sysid: int | None = None
    """only this system is the vehicle; None: the first autopilot heard"""
    origin: wire.Origin | None = None
    failsafe: config.Failsafe = config.Failsafe()
    geofence: config.Geofence = config.Geofence()
    limits: config.Limits = config.Limits()
    body: config.BodyConfig | None = None
    separation: config.Separation = config.Separation()
    traffic: config.Traffic = config.Traffic()
    rights: config.Rights = config.Rights()
    pilot_switch: config.PilotSwitch | None = None
    signing: config.Signing | None = None
    credentials: str | None = None
    """folder of the vehicle's certificate: with it, only what is proven to come from who may give it is taken"""
    streams: dict[str, str | None] = {}
    """cameras by name, and the URI of the video of each that a ground station can open; None: of none"""
    cache: str | None = None
    """directory for files and logs fetched from the autopilot; None: the user's cache directory"""


class Service(Protocol):
    """A part of the vehicle's program. One that has a ``start()`` does nothing before that; the others work from when
    they are built.
    """

    def close(self) -> Awaitable[None] | None: ...


class Onboard:
    """Adapter and services of one vehicle: ``async with Onboard(session, settings): ...``.

    ``link``: what the frames come by, where it is none that ``settings`` can name; ``tell``: how the vehicle's agents
    are given orders. Raises
    :class:`~zmav.errors.BadInput` for bad settings, before anything runs.
    """

    def __init__(
        self, session: zenoh.Session, settings: OnboardSettings, link: Link | None = None, tell: Tell = tell_nobody
    ) -> None:
        fleet, name, instance = settings.fleet, settings.name, str(session.info.zid())
        if settings.sysid is not None and not 1 <= settings.sysid <= 255:
            raise BadConfig.wrong("sysid", settings.sysid, "1 to 255", f"no system id {settings.sysid}")
        link = link or open_link(settings.link)
        if link.recorded != keys.is_replay(fleet):
            raise _other_fleet(link, fleet)
        self.settings = settings
        own = _credentials(settings)
        self.bus = bus = Bus()
        self.gate = gate = Gate(own, given=settings.rights.planner, bus=bus) if own else None
        signer = Signer(own) if own else None
        prove, answers = gate.check if gate else anybody, Answers(signer, gate)
        self.questions = questions = Questions(session, Answers(signer, gate), gate.admit if gate else anybody, bus=bus)
        dialect = load_dialect(settings.dialect)
        signing = _signing(settings.signing, dialect) if settings.signing else None
        self.adapter = port = Adapter(session, fleet, name, link, dialect, bus, signing=signing)
        if settings.sysid is not None:
            port.speak_as(settings.sysid)  # until it is heard, too
        self.events = events = Events(session, fleet, name, signer)
        self.identity = identity = Identity(port, events, settings.sysid)
        self.companion = companion = Companion(session, questions, port, identity, events, settings.origin)
        self.presence = Presence(companion, instance, gate, signer)
        self.timesync = TimeSync(companion)
        self.messages = Messages(companion, self.timesync)
        self.body = BodyService(companion, settings.body, settings.failsafe)
        SchemaService(companion)
        self.quality = Quality(companion, self.timesync)
        self.rates = Rates(companion, NEEDS if settings.pilot_switch else {}, self.timesync.clock)
        control = Control(name)
        self.commander = commander = Commander(companion, control)
        self.params = Params(companion)
        ftp = Ftp(companion)
        cache = Path(settings.cache) if settings.cache else default_directory()
        self.files = Files(companion, ftp, Store(cache / fleet / name))
        self.event_texts = EventTexts(companion, commander)
        self.state = StateService(companion, instance, signer, self.event_texts.against_arming)
        self.host = HostService(questions, instance, fleet, name, (cache,))
        told = gate.check_told if gate else anybody
        self.corrections = Corrections(companion, told, self.state.place)
        self.logs = Logs(companion, ftp, self.files)
        self.terrain = TerrainRequests(companion, Terrain(cache / fleet / f"{name}.terrain"), self.rates.need)
        bounds = Bounds(companion, settings.geofence, settings.limits, self.terrain.terrain)
        counts = SetpointCounts()
        self.preconditions = ParamPreconditions(companion, self.params, counts)
        self.separation = Separation(
            companion,
            bounds,
            lambda: self.body.body,
            settings.separation,
            gate.is_vehicle if gate else keys.anything,
            mates=settings.traffic.mates,
        )
        self.traffic = Traffic(
            companion,
            told,
            signer,
            settings.traffic,
            self.separation.mates,
            receives=lambda: bool(self.params.value("ADSB_TYPE")),
            need=self.rates.need,
        )
        self.authority = Authority(
            companion,
            commander,
            bounds,
            counts,
            control,
            failsafe=settings.failsafe,
            pilot_switch=settings.pilot_switch,
            guard=self.presence.check,
            accept=self.preconditions.check,
            aside=self.separation.aside,
            sealed=gate is not None,
            param=self.params.value,
        )
        self.leases, self.setpoints = self.authority.leases, self.authority.setpoints
        if not link.recorded:
            link.patience = Patience(
                companion,
                control,
                self.leases,
                self.timesync,
                self.rates.demands,
                self.state,
                aside=self.separation.on,
            )
        self.cameras = Cameras(companion, settings.streams, tell)
        self.forwarder = FrameForwarder(
            port,
            prove=prove,
            may_send=self.authority.gcs_traffic.admit,
            sign_forwarded=bool(settings.signing and settings.signing.sign_forwarded),
            take=self.cameras.take,
        )
        self.payload = Payload(companion, commander, bounds)
        self.camera = TriggeredCamera(companion, commander, self.params.value)
        is_vehicle = gate.is_vehicle if gate else keys.anything
        self.gimbal = Gimbal(companion, commander, self.rates.need, is_vehicle, self.presence.check, self.params.value)
        self.missions = Missions(companion, commander, bounds, ftp)
        self.flight = Flight(
            companion,
            self.state,
            commander,
            bounds,
            self.authority.leader,
            self.timesync,
            param=self.params.value,
            rally=self.missions.rally,
        )
        self.mission_flight = MissionFlight(companion, commander, self.missions, bounds)
        judges: dict[str, Judge] = {
            "takeoff": self.flight.judge_takeoff,
            "goto": self.flight.judge_place,
            "set_mode": self.mission_flight.judge_mode,
            "command": self._judge_command,
            "mission_start": self.mission_flight.judge_start,
        }
        permit = OrderPermit(self.authority, judges)
        self.orders = Orders(session, fleet, name, prove, answers, permit, questions=questions)
        self.tick = 0.2
        """s between two rounds of the slow work"""
        self._own, self._stack = own, contextlib.AsyncExitStack()
        # Started in this order and closed in the reverse: a vehicle that follows a stream is told to hold first of all,
        # and what lets go says so while there is a link. The link alone opens last: nothing that it brings is missed,
        # and nothing is sent on it before everybody listens.
        self._services: list[Service] = [
            self.events,
            self.quality,
            self.timesync,
            self.state,
            self.presence,
            self.identity,
            self.adapter,
            self.forwarder,
            self.missions,
            self.params,
            # A recording takes no orders, gives no files, and needs no corrections.
            *(
                ()
                if link.recorded
                else (self.event_texts, self.orders, self.terrain, self.corrections, self.traffic, self.cameras)
            ),
            self.preconditions,
            self.rates,
            self.separation,
            self.questions,
            self.camera,
            self.gimbal,
            self.authority,
        ]
        self._add_orders()

    def _listen(self) -> None:
        """Who hears of what happens here, beside :class:`Authority`. Each kind of complaint is said once a second."""
        bus, emit = self.bus, self.events.emit
        changed = on_loop(asyncio.get_running_loop(), self._on_change)

        def on_link(told: LinkChanged) -> None:
            self._say_link(told)
            changed()

        def on_refusal(told: ProofRefused) -> None:
            reason = str(told.error.detail["reason"])
            emit("refused", "warning", f"refused: {told.error}", limit=f"proof {reason}", reason=reason)

        bus.on(LinkChanged, on_link)
        bus.on(VehicleChanged, lambda told: changed())
        bus.on(AutopilotRestarted, lambda told: self.rates.restarted())
        bus.on(SegmentAccepted, lambda told: self.state.publish())
        bus.on(ProofRefused, on_refusal)
        bus.on(FrameRefused, lambda told: emit("refused", "warning", told.text, limit="tx"))
        too_fast = "questions were dropped: they come faster than they can be answered"
        bus.on(QuestionsDropped, lambda told: emit("questions", "notice", too_fast, limit="questions"))

    def take_roster(self, roster: Roster) -> None:
        """The authority's newest: whom it has turned out is believed no more, and commands no more."""
        if self.gate is not None:
            self.gate.roster = roster
            self.authority.take_roster(self.gate.roster)  # the newest, whatever came

    def _add_orders(self) -> None:
        """Who does what; what each needs first is in :mod:`zmav.verbs`."""
        flight, payload, leases = self.flight, self.payload, self.leases
        handlers: dict[str, Handler] = {
            "arm": self.preconditions.explained(flight.arm),
            "disarm": flight.disarm,
            "takeoff": flight.takeoff,
            "goto": flight.goto,
            "hold": flight.hold,
            "land": flight.land,
            "rtl": flight.rtl,
            "set_mode": flight.set_mode,
            "reboot": flight.reboot,
            "command": payload.command,
            "servo": payload.servo,
            "camera_trigger": self.camera.trigger,
            "ping": _pong,
            **self.gimbal.handlers,
            **self.files.handlers,
            **self.logs.handlers,
            **self.terrain.handlers,
            "param_set": self.params.set,
            "param_load": self.params.load,
            "param_refresh": self.params.refresh,
            "mission_upload": self.missions.upload,
            "mission_download": self.missions.download,
            "mission_clear": self.missions.clear,
            "mission_start": self.mission_flight.start,
            "mission_current": self.mission_flight.set_current,
        }
        told: dict[str, Guarded] = {"lease": leases.take, "release": leases.drop, "revoke": leases.revoke}
        for name, guarded in (told | {name: _untold(handler) for name, handler in handlers.items()}).items():
            self.orders.add(name, guarded)

    async def _judge_command(self, args: wire.RunCommand, report: Report) -> None:
        """A MAV_CMD by its name is judged as its verb is."""
        await asyncio.to_thread(command_type, self.adapter.dialect, args.command)  # the first reads the dialect's XML
        command = self.payload.judge_command(args)
        if command.name == "MAV_CMD_COMPONENT_ARM_DISARM" and command.padded()[0] != 0.0:
            await self.flight.judge_arming()
        await self.mission_flight.judge_command(command, args.force, report)

    async def __aenter__(self) -> Onboard:
        loop, adapter = asyncio.get_running_loop(), self.adapter
        self._listen()
        self.state.extras.append(self._add_to_state)
        adapter.listen("STATUSTEXT", on_loop(loop, self._on_words(self.events.statustext)))
        adapter.listen("EVENT", on_loop(loop, self._on_words(self.event_texts.numbered)))
        async with contextlib.AsyncExitStack() as stack:
            for service in self._services:
                if service is not adapter and (start := getattr(service, "start", None)) is not None:
                    start()
                stack.push_async_callback(_close, service)
            adapter.start()  # last, so that nothing that it brings is missed
            self._work(stack, self._keep_house())
            if self._own is not None:
                warn = functools.partial(self.events.emit, "certificate", "warning")
                self._work(stack, warn_of_end(self._own.certificate, warn))
            self._stack = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._stack.aclose()

    def _work(self, stack: contextlib.AsyncExitStack, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        stack.callback(task.cancel)

    def _say_link(self, told: LinkChanged) -> None:
        state, text = told
        severity: wire.Severity = "warning" if state is LinkState.DOWN else "info"
        words = f"link {state.value}: {text}" if text else f"link {state.value}"
        self.events.emit("link", severity, words, limit=f"link {state.value}")  # a failure follows its attempt at once
        if state is LinkState.UP:
            self._send_heartbeat()  # at once: some autopilots answer only who has spoken

    def _on_words(self, take: Callable[[Frame], None]) -> Callable[[Frame], None]:
        """Only the vehicle's own words: they are taken for its reasons."""

        def on_frame(frame: Frame) -> None:
            source = self.identity.source
            if source is None or frame.sysid == source[0]:
                take(frame)

        return on_frame

    def _on_change(self) -> None:
        """Who the vehicle is, its mode, its arming or its link changed: say so now and not at the next tick."""
        if self.identity.source:
            self.adapter.speak_as(self.identity.source[0])
        self.authority.changed()
        self.presence.tick()
        self.state.publish()

    def _add_to_state(self, state: wire.VehicleState) -> None:
        state.link = self.adapter.link.state.value
        state.link_loss = self.quality.last.loss
        state.clock = self.timesync.info()
        self.authority.add_to_state(state)
        state.clash = self.presence.clash
        self.corrections.add_to_state(state)
        state.traffic = self.traffic.worst
        if self.gate is not None:
            state.gate, state.forbidden = self.gate.epoch.hex(), dict(self.gate.counts)

    async def _keep_house(self) -> None:
        """The slow work, each ``tick``; a fault in it is said and does not end it."""
        beat, rounds = 0, 0
        while True:
            try:
                self.identity.tick()
                self.params.tick()
                self.timesync.tick()
                self.events.tick()
                self.presence.tick()
                self.leases.tick()
                self.separation.tick(self.authority.watchdog.future())
                self.state.publish()
                if beat % 5 == 0:
                    self._send_heartbeat()  # first: whatever fails behind it
                    self.quality.tick()
                    self.corrections.tick()
                    known = self.state.latest("GLOBAL_POSITION_INT") is not None
                    self.traffic.tick(self.state.place() if known else None, self.state.velocity())
                    self.cameras.tick()
                    self.rates.tick()
            except Exception as e:
                self.events.emit("fault", "error", f"housekeeping: {e!r}", limit="fault")
            if rounds != self.authority.watchdog.rounds:
                rounds = self.authority.watchdog.rounds
                self.bus.tell(Alive())
            beat += 1
            await asyncio.sleep(self.tick)

    def _send_heartbeat(self) -> None:
        """The companion's own: MAV_TYPE_ONBOARD_CONTROLLER, no autopilot, active."""
        self.adapter.send("HEARTBEAT", type=18, autopilot=8, system_status=4, mavlink_version=3)


async def _close(service: Service) -> None:
    if isinstance(service, (Adapter, FrameForwarder)):  # these wait for threads
        await in_thread(service.close)
    elif (ending := service.close()) is not None:
        await ending


def _other_fleet(link: Link, fleet: str) -> BadConfig:
    """Recordings and vehicles are never in one fleet: none is taken for the other, nor addressed in its place."""
    if link.recorded:
        text = f"a recording is played in a fleet of its own: 'zmav replay', or --fleet {keys.replay_of(fleet)}"
        return BadConfig(text, field="fleet", value=fleet, expected=keys.replay_of(fleet))
    text = f"the fleet {fleet!r} is for recordings, whose vehicles take no orders: call it otherwise"
    return BadConfig(text, field="fleet", value=fleet, expected=f"a name that does not end with {keys.REPLAY}")


def _signing(settings: config.Signing, dialect: Dialect) -> Signing:
    """Raises :class:`BadConfig` where the key cannot be used; the last timestamp is kept beside it, or in the service's
    state directory."""
    file = Path(settings.key_file).with_suffix(".time")
    clock = SigningClock((state_directory() or file.parent) / file.name)
    key = read_key(settings.key_file)
    return Signing(key, dialect, link_id=settings.link_id, clock=clock, unsigned=settings.unsigned)


def _credentials(settings: OnboardSettings) -> Credentials | None:
    """The vehicle's own; raises :class:`BadConfig` for another member's."""
    if settings.credentials is None:
        return None
    found = Credentials.load(settings.credentials)
    for field, said, expected in (
        ("role", found.role.value, Role.VEHICLE.value),
        ("name", found.name, settings.name),
        ("fleet", found.fleet, settings.fleet),
    ):
        if said != expected:
            text = f"the credentials in {settings.credentials} are for the {field} {said!r}; expected {expected!r}"
            raise BadConfig(text, field="credentials", value=said, expected=expected)
    return found


def _untold(handler: Handler) -> Guarded:
    """For what is the same no matter who asks."""
    return lambda args, report, origin: handler(args, report)


async def _pong(args: wire.Order, report: Report) -> dict[str, Any]:
    return {"t": time.time()}
