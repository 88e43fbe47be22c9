"""``{host}/swarm/{verb}``: what the planner is asked, judged and handed on."""

from __future__ import annotations

import time
from typing import Any

import msgspec

from agents.planner.live.checks import MOST_BYTES, check_goal, check_obstacle
from agents.planner.live.context import Orderable
from agents.planner.live.preview import preview
from agents.planner.model.errors import PlanError
from zmav import keys, wire
from zmav.errors import Refused, ZmavError
from zmav.services.orders.orders import Guarded, Orders, Report, proof_is_enough
from zmav.services.queries.proven import Answers
from zmav.trust.credentials import Credentials
from zmav.trust.gate import Origin, ProofRefused, anybody
from zmav.verbs import SWARM_VERBS, Access
from zmav.wire import swarm

MOST_PREVIEWS = 3
"""at a time: they are everybody's, and goals are planned by the same process while nobody flies"""


class OrderHandlers:
    """The handlers. Without credentials anybody may ask for anything; with them as :mod:`zmav.trust.rights` says."""

    def __init__(self, agent: Orderable, credentials: Credentials | None) -> None:
        self._agent = agent
        self._previews = 0
        settings = agent.settings
        member = agent.z.member
        self.gate = member.make_gate() if member else None
        self.orders = Orders(
            agent.z.session,
            settings.fleet,
            settings.name,
            self.gate.check if self.gate else anybody,
            Answers(member.signer if member else None, self.gate),
            proof_is_enough,
            keys.SWARM,
            SWARM_VERBS,
            most=MOST_BYTES,
        )
        if self.gate is not None:
            self.gate.bus.on(
                ProofRefused, lambda told: agent.say_seldom("refused", "warning", f"refused: {told.error}")
            )
        handlers: dict[str, Guarded] = {
            "submit": self._submit,
            "preview": self._preview,
            "pause": self._pause,
            "resume": self._resume,
            "abort": self._cancel,
            "cancel": self._cancel_one,
            "obstacle": self._obstacle,
            "clear": self._clear,
            "status": self._status,
        }
        for verb, handler in handlers.items():
            self.orders.add(verb, self._guarded(verb, handler))

    def _guarded(self, verb: str, handler: Guarded) -> Guarded:
        """Only who is in charge changes anything."""

        async def guarded(args: Any, report: Report, origin: Origin | None) -> dict[str, Any]:
            charge = self._agent.charge
            if SWARM_VERBS[verb].access is not Access.READ and not charge.in_charge:
                name, of = self._agent.settings.name, charge.of
                other = f"{of} is in charge: ask it" if of else "it takes charge within seconds if nobody else does"
                raise Refused(f"{name} stands by; {other}", planner=of)
            try:
                return await handler(args, report, origin)
            except PlanError as e:
                raise Refused(e.message, kind=e.kind, ids=e.ids) from e

        return guarded

    # Goals.

    async def _submit(self, args: swarm.Submit, report: Report, origin: Origin | None) -> dict[str, Any]:
        agent = self._agent
        check_goal(args.goal)
        agent.check_known(args.goal)
        by = origin.name if origin else ""
        entry = agent.ledger.add(args.goal, args.when, time.time(), agent.charge.term, by)
        agent.say("goal", "info", f"{entry.id}: {_words(args.goal)}" + (f", by {by}" if by else ""), goal=entry.id)
        agent.wake()
        return {"goal": entry.id, "planner": agent.settings.name, "term": agent.charge.term}

    async def _preview(self, args: swarm.Preview, report: Report, origin: Origin | None) -> dict[str, Any]:
        check_goal(args.goal)
        self._agent.check_known(args.goal)
        if self._previews >= MOST_PREVIEWS:
            raise Refused(f"{MOST_PREVIEWS} previews are being made: ask again a little later")
        self._previews += 1
        try:
            return await preview(self._agent, args.goal, report)
        finally:
            self._previews -= 1

    async def _pause(self, args: swarm.GoalId, report: Report, origin: Origin | None) -> dict[str, Any]:
        entries = self._agent.ledger.find(args.goal)
        for entry in entries:
            self._agent.pause(entry, _by(origin))
        return {"goals": [entry.id for entry in entries]}

    async def _resume(self, args: swarm.GoalId, report: Report, origin: Origin | None) -> dict[str, Any]:
        entries = [entry for entry in self._agent.ledger.find(args.goal) if entry.state == "paused"]
        for entry in entries:
            self._agent.resume(entry)
        return {"goals": [entry.id for entry in entries]}

    async def _cancel(self, args: swarm.GoalId, report: Report, origin: Origin | None) -> dict[str, Any]:
        agent = self._agent
        entries = agent.ledger.find(args.goal)
        for entry in entries:
            agent.ledger.end(entry, "cancelled", f"cancelled{_by(origin)}")
        if entries:
            agent.say("goal", "notice", f"cancelled{_by(origin)}: {', '.join(entry.id for entry in entries)}")
        agent.wake()
        return {"goals": [entry.id for entry in entries]}

    async def _cancel_one(self, args: swarm.GoalId, report: Report, origin: Origin | None) -> dict[str, Any]:
        if not args.goal:
            raise Refused("cancel needs a goal's id; 'abort' drops them all", field="goal")
        return await self._cancel(args, report, origin)

    # The world.

    async def _obstacle(self, args: swarm.GiveObstacle, report: Report, origin: Origin | None) -> dict[str, Any]:
        check_obstacle(args.obstacle)
        text = self._agent.take_obstacle(args.obstacle, _by(origin))
        if text:
            self._agent.say("world", "info", text)
        return {"news": bool(text), "obstacles": len(self._agent.world.obstacles)}

    async def _clear(self, args: swarm.GoalId, report: Report, origin: Origin | None) -> dict[str, Any]:
        count = self._agent.clear()
        self._agent.ledger.clear()
        self._agent.say("world", "notice", f"{count} obstacles forgotten{_by(origin)}")
        return {"obstacles": count}

    # Looking.

    async def _status(self, args: wire.Order, report: Report, origin: Origin | None) -> dict[str, Any]:
        return self._agent.status()


def _by(origin: Origin | None) -> str:
    return f", by {origin.name}" if origin else ""


def _words(goal: swarm.Goal) -> str:
    kind = str(type(goal).__struct_config__.tag)
    names = goal.vehicles
    return f"{kind} of {', '.join(names[:6])}" + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def refusal(error: ZmavError) -> dict[str, Any]:
    """An error as it stands in a result."""
    return {"code": error.code, "message": error.message, "detail": msgspec.to_builtins(error.detail, enc_hook=str)}
