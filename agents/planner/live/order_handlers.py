"""``{host}/swarm/{verb}``: what the planner is asked, judged and handed on."""

from __future__ import annotations

import math
import time
from typing import Any

import msgspec

from agents.planner.goals.steps import FleetView
from agents.planner.live.accuracy import tight_of
from agents.planner.live.checks import FARTHEST, MOST_BYTES, check_goal, check_obstacle
from agents.planner.live.context import Context
from agents.planner.live.energy import warning_of
from agents.planner.live.field import check_field
from agents.planner.live.ledger import ENDED, kind_of
from agents.planner.live.margins import PlanMargins
from agents.planner.live.plan import Margins, Planner
from agents.planner.live.preview import positions, preview
from agents.planner.live.solver import Solver
from agents.planner.live.tally import Tally
from agents.planner.model.errors import PlanError
from zmav import keys, wire
from zmav.errors import BadInput, Refused
from zmav.services.orders.orders import Guarded, Orders, Report, proof_is_enough
from zmav.services.queries.proven import Answers
from zmav.trust.credentials import Credentials
from zmav.trust.gate import Origin, ProofRefused, anybody
from zmav.verbs import SWARM_VERBS, Access
from zmav.wire import Vector, swarm

MOST_PREVIEWS = 3
"""at a time: they are everybody's, and goals are planned by the same process while nobody flies"""


class OrderHandlers:
    """The handlers. Without credentials anybody may ask for anything; with them as :mod:`zmav.trust.rights` says."""

    def __init__(self, context: Context, credentials: Credentials | None) -> None:
        self._context = context
        self._previews = 0
        self._previewer: Solver | None = None
        """a second process: a preview must not keep a vehicle in flight waiting for its plan"""
        settings = context.settings
        member = context.z.member
        self.gate = member.make_gate() if member else None
        self.orders = Orders(
            context.z.session,
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
                ProofRefused, lambda told: context.say_seldom("refused", "warning", f"refused: {told.error}")
            )
        handlers: dict[str, Guarded] = {
            "submit": self._submit,
            "preview": self._preview,
            "pause": self._pause,
            "resume": self._resume,
            "abort": self._cancel,
            "cancel": self._cancel_one,
            "obstacle": self._obstacle,
            "status": self._status,
        }
        for verb, handler in handlers.items():
            self.orders.add(verb, self._guarded(verb, handler))

    def _guarded(self, verb: str, handler: Guarded) -> Guarded:
        """Only who is in charge changes anything."""

        async def guarded(args: Any, report: Report, origin: Origin | None) -> dict[str, Any]:
            charge = self._context.charge
            if SWARM_VERBS[verb].access is not Access.READ and not charge.in_charge:
                name, of = self._context.settings.name, charge.of
                other = f"{of} is in charge: ask it" if of else "it takes charge within seconds if nobody else does"
                raise Refused(f"{name} stands by; {other}", planner=of)
            try:
                return await handler(args, report, origin)
            except PlanError as e:
                raise Refused(e.message, kind=e.kind, ids=e.ids) from e

        return guarded

    async def close(self) -> None:
        await self.orders.close()
        if self._previewer is not None:
            await self._previewer.__aexit__(None, None, None)

    # Goals.

    async def _preview_solver(self) -> Solver:
        """The solver itself while nobody flies, else one beside it."""
        if not self._context.runs:
            return self._context.solver
        if self._previewer is None:
            self._previewer = Solver(lambda text: self._context.say("solver", "info", text), "solver for previews")
            await self._previewer.__aenter__()
        return self._previewer

    async def _submit(self, args: swarm.Submit, report: Report, origin: Origin | None) -> dict[str, Any]:
        context = self._context
        check_goal(args.goal)
        check_known(self._context, args.goal)
        by = origin.name if origin else ""
        entry = context.ledger.add(args.goal, args.when, time.time(), context.charge.term, by)
        context.say("goal", "info", f"{entry.id}: {_words(args.goal)}" + (f", by {by}" if by else ""), goal=entry.id)
        context.wake()
        return {"goal": entry.id, "planner": context.settings.name, "term": context.charge.term}

    async def _preview(self, args: swarm.Preview, report: Report, origin: Origin | None) -> dict[str, Any]:
        check_goal(args.goal)
        check_known(self._context, args.goal)
        if self._previews >= MOST_PREVIEWS:
            raise Refused(f"{MOST_PREVIEWS} previews are being made: ask again a little later")
        self._previews += 1
        try:
            planner = Planner(self._context, "preview", await self._preview_solver())
            await self._context.clocks.learn(args.goal.vehicles)
            view = check_known(self._context, args.goal)  # as they are now: that took up to two seconds
            fleet, tally = self._context.fleet, Tally(args.goal.vehicles, view)
            told = await preview(planner, args.goal, view, tally, self._margins(args.goal))
            told["positions"] = positions(view.pick(args.goal.vehicles), fleet.accuracies)
            needs = fleet.needs(tally, view)
            told["batteries"] = {name: need.figures() for name, need in needs.items()}
            told["refused"] = warning_of(args.goal, needs, self._context.settings.unknown_batteries)
            for figures in (step.get("figures", {}) for step in told["steps"]):
                for name, numbers in figures.items():
                    numbers["battery_left"] = fleet.battery_of(name)
            return told
        finally:
            self._previews -= 1

    def _margins(self, goal: swarm.Goal) -> Margins:
        """As it would be flown with; the settings' own where clocks are known badly, for which a flight waits."""
        margins = PlanMargins(self._context, goal.vehicles, self._context.clocks.of(goal.vehicles))
        try:
            return margins.best_first()
        except Refused:
            if margins.too_wide:
                raise
            return ()

    async def _pause(self, args: swarm.GoalId, report: Report, origin: Origin | None) -> dict[str, Any]:
        entries = self._context.ledger.find(args.goal)
        for entry in entries:
            if entry.state not in (*ENDED, "paused"):
                entry.state, entry.text = "paused", f"paused{_by(origin)}"
                if run := self._context.runs.get(entry.id):
                    run.pause()
                self._context.say("goal", "notice", f"{entry.id}: paused{_by(origin)}", goal=entry.id)
        return {"goals": [entry.id for entry in entries]}

    async def _resume(self, args: swarm.GoalId, report: Report, origin: Origin | None) -> dict[str, Any]:
        entries = [entry for entry in self._context.ledger.find(args.goal) if entry.state == "paused"]
        for entry in entries:
            run = self._context.runs.get(entry.id)
            entry.state, entry.text = ("flying" if run else "queued"), "goes on"
            if run:
                run.resume()
            self._context.say("goal", "notice", f"{entry.id}: goes on", goal=entry.id)
            self._context.wake()
        return {"goals": [entry.id for entry in entries]}

    async def _cancel(self, args: swarm.GoalId, report: Report, origin: Origin | None) -> dict[str, Any]:
        context = self._context
        entries = context.ledger.find(args.goal)
        for entry in entries:
            context.ledger.end(entry, "cancelled", f"cancelled{_by(origin)}")
        if entries:
            context.say("goal", "notice", f"cancelled{_by(origin)}: {', '.join(entry.id for entry in entries)}")
        context.wake()
        return {"goals": [entry.id for entry in entries]}

    async def _cancel_one(self, args: swarm.GoalId, report: Report, origin: Origin | None) -> dict[str, Any]:
        if not args.goal:
            raise Refused("cancel needs a goal's id; 'abort' drops them all", field="goal")
        return await self._cancel(args, report, origin)

    # The world.

    async def _obstacle(self, args: swarm.GiveObstacle, report: Report, origin: Origin | None) -> dict[str, Any]:
        check_obstacle(args.obstacle)
        text = self._context.take_obstacle(args.obstacle, _by(origin))
        known = self._context.world.find(args.obstacle.name)
        if (None if known is None else known.what) != args.obstacle.what:
            what = f"what is known of {args.obstacle.name}, or another geofence,"
            why = "is newer by the clock of the one who gave it: look at both clocks, and give it again"
            raise Refused(f"overtaken: {what} {why}", field="obstacle", reason="overtaken")
        if text:
            self._context.say("world", "info", text)
        return {"news": bool(text), "obstacles": len(self._context.world.obstacles)}

    # Looking.

    async def _status(self, args: wire.Order, report: Report, origin: Origin | None) -> dict[str, Any]:
        context = self._context
        hearing = context.fleet.hearing()
        return {
            "planner": context.settings.name,
            "instance": context.instance,
            "state": context.state,
            "in_charge": context.charge.in_charge,
            "of": context.charge.of,
            "term": context.charge.term or context.charge.highest,
            "ready": context.solver.ready,
            "book": msgspec.to_builtins(context.book()),
            "vehicles": sorted(context.fleet.view().vehicles),
            "unheard": sorted(hearing.unheard),
            "silent": context.fleet.silent(),
            "obstacles": len(context.world.obstacles),
            "events": [msgspec.to_builtins(event, enc_hook=str) for event in context.events],
        }


def check_known(context: Context, goal: swarm.Goal) -> FleetView:
    """Raises :class:`BadInput` for vehicles that are not heard, and for places that are not in the field."""
    context.fleet.watch()
    view = context.fleet.view(context.settings.margin, tight=tight_of(goal))
    silent = [name for name in goal.vehicles if name not in view.vehicles and name in context.fleet.silent()]
    if silent:
        text = f"{', '.join(silent)}: heard, but with no place in the fleet's frame: start 'zmav up' with --origin"
        raise BadInput(text, field="vehicles", value=silent, expected="vehicles with a local position")
    for seen in view.pick(goal.vehicles):
        if not max(map(abs, seen.pos_ned)) <= FARTHEST:
            away = math.hypot(*seen.pos_ned) / 1e3
            text = f"{seen.name} is {away:.0f} km from the fleet's origin: is the --origin of its 'zmav up' right?"
            raise BadInput(text, field="vehicles", value=seen.name, expected=f"within {FARTHEST / 1e3:.0f} km")

    def ball(name: str) -> Vector | None:
        found = context.world.ball(name, time.time())
        return found[0] if found else None

    settings = context.settings
    check_field(goal, view, settings.field, settings.ground, settings.downwash, ball)
    return view


def _by(origin: Origin | None) -> str:
    return f", by {origin.name}" if origin else ""


def _words(goal: swarm.Goal) -> str:
    names = goal.vehicles
    return f"{kind_of(goal)} of {', '.join(names[:6])}" + (f" and {len(names) - 6} more" if len(names) > 6 else "")
