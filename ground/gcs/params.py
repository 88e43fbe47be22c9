"""Parameters, answered in the vehicles' place: https://mavlink.io/en/services/parameter.html

A list costs the mesh one query, a line where nothing changed, however many clients ask for it; the autopilot's link
hears nothing of it. A PARAM_SET becomes the order ``param_set``, which the vehicle's agent repeats until it is done,
and is answered with what the parameter really is then; clients that know the vehicle's parameters hear of a change, by
whomever. The autopilot's own PARAM_VALUEs (its agent reads them all) are therefore nobody's business, except while its
set is not known to its agent yet: then who waits for the list gets them as they come, and the rest afterwards.

Other components' parameters (a gimbal's) are theirs and pass; a list for all components is the autopilot's. ArduPilot's
parameter file (``@PARAM/param.pck`` by MAVFTP), which QGroundControl asks for first, is denied: it then asks for the
list. So is the writing of a plan or of parameters as a file: the station then sends the messages, which become orders.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterator
from typing import Any, NamedTuple

import msgspec

import zmav
from ground.feed import Origin
from ground.gcs.answerer import Answerer, Ground
from ground.gcs.client import Client
from ground.gcs.kinds import Place
from ground.gcs.param_copy import ParamCopy, ParamValue, read_value
from ground.gcs.request_handlers import Handler, HandlersByClient, RequestHandlers
from zmav import wire
from zmav.errors import BadInput, Refused, ZmavError
from zmav.mavlink import Frame, decode, paramvalue
from zmav.mavlink.ftp import Nak, Op, Packet, check_request, pack, unpack
from zmav.mavlink.packed_params import PATH
from zmav.mavlink.paramvalue import ParamEncoding
from zmav.services.params.values import is_name
from zmav.waiting import on_loop

MOST_SETS = 64
"""orders of one client under way; it repeats what gets no answer"""
MOST_QUESTIONS = 4096
"""questions of one client that wait for a set to be read"""
DOES_NOT_EXIST = 1
FTP = "FILE_TRANSFER_PROTOCOL"


class Question(NamedTuple):
    """A PARAM_REQUEST_READ: by name, or where that is empty by place in the list."""

    frame: Frame
    name: str
    place: int


class System(ParamCopy):
    """One autopilot, as far as its parameters go. Lives on the event loop."""

    def __init__(self, sysid: int, vehicle: zmav.Vehicle, ground: Ground) -> None:
        super().__init__(sysid, vehicle, ground)
        self.listeners: set[RequestHandlers] = set()
        """who has asked for its parameters, and hears of changes"""
        self.listing: dict[RequestHandlers, dict[str, tuple[bytes, int]]] = {}
        """who waits for the list, and what it got of it meanwhile: values and types by name"""
        self.questions: dict[RequestHandlers, list[Question]] = {}
        self.setting: dict[tuple[RequestHandlers, str], bytes] = {}
        """what is being set for whom, as it came"""

    def forget(self, handlers: RequestHandlers) -> None:
        self.listeners.discard(handlers)
        self.listing.pop(handlers, None)
        self.questions.pop(handlers, None)


class Params(Answerer):
    takes = frozenset({"PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET", FTP})
    watches = frozenset({"PARAM_VALUE"})

    def __init__(self, ground: Ground, by_client: HandlersByClient) -> None:
        self._ground, self._by_client, self._dialect = ground, by_client, ground.dialect
        self._systems: dict[Place, System] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._on_value = on_loop(ground.loop, self._heard)
        by_client.forget.append(self._forget)

    # On the carrying threads.

    def offer(self, client: Client, frame: Frame) -> bool:
        name = self._dialect.name_of(frame.msgid)
        if not self._ground.is_for_autopilots(client, frame):
            return False
        handlers = {"PARAM_REQUEST_LIST": self._list, "PARAM_REQUEST_READ": self._read, "PARAM_SET": self._set}
        handler = self._denial(frame) if name == FTP else handlers[name]
        if handler is not None:
            self._by_client.of(client).ask(handler, frame)
        return handler is not None

    def _denial(self, frame: Frame) -> Handler | None:
        """What denies a request for a file; None: it is between the client and the autopilot."""
        payload, nak, why = decode(frame, self._dialect)["payload"], Nak.FILE_NOT_FOUND, ""
        asked = unpack(payload)
        try:
            check_request(payload)
        except BadInput as e:
            nak, why = Nak.FILE_PROTECTED, f"not written: {e}"
        else:
            if asked.opcode != Op.OPEN_FILE_RO or asked.data.rstrip(b"\0") != PATH.encode():
                return None
        denied = Packet(asked.seq + 1, asked.session, Op.NAK, 1, asked.opcode, data=bytes((nak,)))
        return lambda handlers, frame: self._deny_file(handlers, frame, denied, why)

    def withhold(self, origin: Origin, data: bytes) -> bool:
        if not self._ground.is_autopilot(origin.sysid, origin.compid):
            return False
        place = origin.fleet, origin.vehicle
        system = self._systems.get(place)
        if system is not None and system.sysid == origin.sysid:  # else a radio has heard another vehicle's
            self._on_value(place, data)
        return True

    def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        for system in self._systems.values():
            system.close()

    # From here on: on the event loop.

    def _forget(self, handlers: RequestHandlers) -> None:
        for system in self._systems.values():
            system.forget(handlers)

    def meant(self, handlers: RequestHandlers, frame: Frame) -> Iterator[System]:
        """The autopilots that a frame is for."""
        for sysid, vehicle in self._ground.vehicles(handlers.client, frame):
            place = vehicle.fleet, vehicle.name
            system = self._systems.get(place)
            if system is None or system.sysid != sysid:
                if system is not None:
                    system.close()
                system = self._systems[place] = System(sysid, vehicle, self._ground)
            yield system

    def in_background(self, work: Coroutine[Any, Any, None]) -> None:
        """Do it on the event loop, until the bridge ends at most."""
        task = self._ground.loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # Reading.

    def _list(self, handlers: RequestHandlers, frame: Frame) -> None:
        for system in self.meant(handlers, frame):
            system.listeners.add(handlers)
            if handlers not in system.listing and not handlers.owes(system):  # else it is impatient
                system.listing[handlers] = {}
                self.in_background(self._send_list(handlers, system))

    async def _send_list(self, handlers: RequestHandlers, system: System) -> None:
        try:
            await system.refresh()
        except ZmavError as e:
            system.listing.pop(handlers, None)
            handlers.tell(system.sysid, "warning", f"parameters not read: {e}")
            return
        got = system.listing.pop(handlers, None)
        if got is None:
            return  # it has left
        names = [name for name in system.names if name not in got or not system.is_as(name, *got[name])]
        handlers.owe(system, names, system.frame)

    def _read(self, handlers: RequestHandlers, frame: Frame) -> None:
        fields = decode(frame, self._dialect)
        by_name = fields["param_index"] < 0
        question = Question(frame, fields["param_id"] if by_name else "", fields["param_index"])
        for system in self.meant(handlers, frame):
            system.listeners.add(handlers)
            if system.fresh and self._answer(handlers, system, question):
                continue
            waiting = system.questions.setdefault(handlers, [])
            if len(waiting) < MOST_QUESTIONS:
                waiting.append(question)
            if len(waiting) == 1:
                self.in_background(self._answer_all(handlers, system))

    async def _answer_all(self, handlers: RequestHandlers, system: System) -> None:
        """What waits for the set to be looked at again."""
        try:
            await system.refresh()
        except ZmavError:
            system.questions.pop(handlers, None)  # as a vehicle that does not answer; who wants it asks again
            return
        for question in system.questions.pop(handlers, ()):
            if not self._answer(handlers, system, question):
                await self._find(handlers, system, question)

    def _answer(self, handlers: RequestHandlers, system: System, question: Question) -> bool:
        """From the copy, where it is there."""
        name = question.name
        if not name and 0 <= question.place < len(system.names):
            name = system.names[question.place]
        frame = system.frame(name)
        if frame is not None:
            handlers.answer(frame)
        return frame is not None

    async def _find(self, handlers: RequestHandlers, system: System, question: Question) -> None:
        """One that is not in the set: hidden from it, or none at all."""
        try:
            if not is_name(question.name):
                raise BadInput(f"no parameter {question.name or question.place!r}", field="param_id")
            param = await system.vehicle.params.get(question.name)
            handlers.answer(system.frame_of(param))
        except BadInput:
            self._say_there_is_none(handlers, question.frame, system, question.name, question.place)
        except ZmavError:
            pass  # as a vehicle that does not answer

    def _say_there_is_none(
        self, handlers: RequestHandlers, asker: Frame, system: System, name: str, place: int = -1
    ) -> None:
        if "PARAM_ERROR" in self._dialect.by_name:
            target = {"target_system": asker.sysid, "target_component": asker.compid}
            about = {"param_id": name[:16], "param_index": place, "error": DOES_NOT_EXIST}
            handlers.answer(system.pack("PARAM_ERROR", **target, **about))

    def _deny_file(self, handlers: RequestHandlers, frame: Frame, denied: Packet, why: str) -> None:
        target = {"target_network": 0, "target_system": frame.sysid, "target_component": frame.compid}
        for system in self.meant(handlers, frame):
            handlers.answer(system.pack(FTP, **target, payload=pack(denied)))
            if why:
                handlers.tell(system.sysid, "warning", why)

    # Setting.

    def _set(self, handlers: RequestHandlers, frame: Frame) -> None:
        fields = decode(frame, self._dialect)
        name, raw = fields["param_id"], frame.payload[:4].ljust(4, b"\0")
        for system in self.meant(handlers, frame):
            system.listeners.add(handlers)
            if system.setting.get((handlers, name)) == raw or len(system.setting) >= MOST_SETS:
                continue
            system.setting[handlers, name] = raw
            self.in_background(self._set_one(handlers, frame, system, name, raw, fields["param_type"]))

    async def _set_one(
        self, handlers: RequestHandlers, frame: Frame, system: System, name: str, raw: bytes, kind: int
    ) -> None:
        vehicle = system.vehicle
        try:
            if handlers.client.read_only:
                raise Refused("read-only")
            value = self._wanted(system, raw, kind)
            changed = await vehicle.params.set(name, value)
            self._changed(handlers, system, changed.name, changed.value, kind)
        except ZmavError as e:
            handlers.tell(system.sysid, "warning", f"{name[:16]} not set: {e}")
            await self._answer_refused(handlers, frame, system, name, e)
        finally:
            if system.setting.get((handlers, name)) == raw:
                del system.setting[handlers, name]

    async def _answer_refused(
        self, handlers: RequestHandlers, asker: Frame, system: System, name: str, error: ZmavError
    ) -> None:
        """With the value that it has all the same, where that can be had."""
        try:
            held = system.param(name) or await system.vehicle.params.get(name)
        except BadInput:
            self._say_there_is_none(handlers, asker, system, name)
        except ZmavError:
            return
        else:
            value = error.detail["value"] if isinstance(error, Refused) and "value" in error.detail else held.value
            self._changed(handlers, system, held.name, value, paramvalue.type_number(held.type))

    def _wanted(self, system: System, raw: bytes, kind: int) -> float | int:
        """What the client wants it to be; raises :class:`BadInput`."""
        named = paramvalue.type_name(kind) or "REAL32"
        if system.encoding is ParamEncoding.C_CAST:
            named = "REAL32"  # whatever it is, a float carries it; what is no integer is not made one here
        value = paramvalue.value_of(raw, named, system.encoding)
        if value is None:
            raise BadInput("the value is not a number", field="param_value", value=None, expected="a number")
        return int(value) if isinstance(value, float) and value.is_integer() else value

    def _changed(
        self, handlers: RequestHandlers, system: System, name: str, value: paramvalue.Value, kind: int
    ) -> None:
        """Answer who set it, and let the others know where it is another than before."""
        held = system.param(name)
        if held is None:
            param = wire.Param(name=name, value=value, type=paramvalue.type_name(kind) or "REAL32")
            handlers.answer(system.frame_of(param))
            return
        news = system.take(msgspec.structs.replace(held, value=value))
        self._tell(system, name, system.listeners if news else {handlers})

    # What the autopilot says.

    def _heard(self, place: Place, data: bytes) -> None:
        system = self._systems.get(place)
        if system is None:
            return
        heard = read_value(data)
        if is_name(heard.name):
            if system.hear(heard):
                setting = {handlers for handlers, name in system.setting if name == heard.name}  # they get an answer
                self._tell(system, heard.name, system.listeners - setting - set(system.listing))
            self._pass_on(system, heard, data)

    def _pass_on(self, system: System, heard: ParamValue, data: bytes) -> None:
        """To those who wait for a list that its agent does not have yet."""
        if heard.place >= heard.of:
            return
        value = heard.raw, heard.type
        for handlers, got in system.listing.items():
            if got.get(heard.name) != value and len(got) < heard.of and handlers.answer(data):
                got[heard.name] = value

    def _tell(self, system: System, name: str, receivers: set[RequestHandlers]) -> None:
        """Say a value to those who do not get it anyway: it is in a list that they are being sent."""
        frame = system.frame(name)
        for handlers in receivers:
            if frame is not None and not handlers.owes(system, name):
                handlers.answer(frame)
