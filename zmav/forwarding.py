"""Keys -> link: others' frames, as they were put on ``mav/tx/...``.

Each is checked (one whole frame, true to its key, meant for a system on this link), asked about, and sent; what is not
fit is counted and said in ``event``.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import zenoh

from zmav import keys
from zmav.adapter import Adapter
from zmav.errors import BadKey, BadMessage, Forbidden, ZmavError
from zmav.mavlink import Frame, parse_frame, targets
from zmav.mavlink.signing import SETUP_SIGNING
from zmav.services.authority.may_move import MayMove
from zmav.services.link.port import FrameForwarded, FrameRefused
from zmav.services.queries.intake import Intake
from zmav.services.queries.proven import attached
from zmav.trust.gate import Prove

MOST_WAITING = 512
"""Others' frames that are looked at in 5 ms, the newest: a burst of a ground station's fits."""
ADDRESS = re.compile(r"0|[1-9]\d{0,2}", re.ASCII)


class FrameForwarder:
    """Sends others' frames on the adapter's link; none on a recording.

    ``prove`` raises :class:`~zmav.errors.Forbidden` for what does not come from who may put it, and says so;
    ``may_send`` a :class:`~zmav.errors.ZmavError` for a frame that may not be sent now (a clash of ids, a lease).
    The adapter's bus is told of each :class:`FrameForwarded` and :class:`FrameRefused`. ``sign_forwarded``: frames that
    are not signed are signed as our own, where the link signs. ``take``: whether a frame for a system and a
    component is one that this program speaks for: it has taken it then, and it goes to no link.
    """

    def __init__(
        self,
        adapter: Adapter,
        *,
        prove: Prove,
        may_send: MayMove[[Frame]],
        sign_forwarded: bool = False,
        take: Callable[[Frame, int, int], bool] = lambda frame, system, component: False,
    ) -> None:
        self._take = take
        self._adapter, self._prove, self._may_send = adapter, prove, may_send
        self._sign_forwarded = sign_forwarded
        self._intake: Intake | None = None

    def start(self) -> None:
        adapter = self._adapter
        if not adapter.link.recorded:
            tx = keys.TX.key(adapter.fleet, adapter.name, sys="*", comp="*", msg="*")
            self._intake = Intake(adapter.session.declare_subscriber, tx, self._on_tx, MOST_WAITING)

    def close(self) -> None:
        if self._intake is not None:
            self._intake.close()
            self._intake = None

    # In the intake's thread.

    def _on_tx(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        payload, adapter = sample.payload.to_bytes(), self._adapter
        try:
            self._prove(key, payload, attached(sample))
            frame = self._checked(key, payload)
            self._may_send(frame)
            _, parts = keys.match(key)
            if self._take(frame, int(parts["sys"]), int(parts["comp"])):
                return
            data = self._signed(frame)
        except Forbidden:
            adapter.tx.refused += 1
            return
        except ZmavError as e:
            adapter.tx.refused += 1
            adapter.bus.tell(FrameRefused(f"frame on {key} refused: {e}"))
            return
        adapter.send_raw(data)
        adapter.bus.tell(FrameForwarded(frame))

    def _signed(self, frame: Frame) -> bytes:
        """A stranger's frame as it may go out: anyone who signs it vouches for it, so we do so only where told to."""
        if frame.msgid == SETUP_SIGNING:
            raise BadMessage("SETUP_SIGNING holds a key, which does not travel: use 'zmav signing setup' on the link")
        signing = self._adapter.signing
        if signing is None or frame.signed:
            return frame.data
        if not self._sign_forwarded:
            raise BadMessage("it is not signed, and this link signs: sign it, or set sign_forwarded for this vehicle")
        return signing.sign(frame.data)

    def _checked(self, key: str, data: bytes) -> Frame:
        _, parts = keys.match(key)
        dialect = self._adapter.dialect
        frame = parse_frame(data, dialect)
        name = dialect.name_of(frame.msgid)
        if parts["msg"] != name:
            raise BadKey(f"it holds {name}", field="key", value=parts["msg"], expected=name)
        if not (ADDRESS.fullmatch(parts["sys"]) and ADDRESS.fullmatch(parts["comp"])):
            raise BadKey("its system and component must be numbers", field="key", value=key, expected="0-255")
        system, component = int(parts["sys"]), int(parts["comp"])
        message, inside = dialect.by_id.get(frame.msgid), targets(frame, dialect)
        if message is not None:  # only what the message says can contradict the key: SET_MODE names no component
            for part, field, said, offset in (
                (system, "target_system", inside[0], message.target_system),
                (component, "target_component", inside[1], message.target_component),
            ):
                if offset is not None and said != part:
                    raise BadMessage(f"its {field} is {said}", fields={field: f"{said}, but {part} in the key"})
        if system != 0 and not any(heard == system for heard, _ in list(self._adapter.splitter.sources)):
            raise BadKey(f"no system {system} is on this link", field="sys", value=system)
        return frame
