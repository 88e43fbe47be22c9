"""What one vehicle may be asked to fly, from where it is now: the declared geofence and limits, and a club's field.

A fleet file that says nothing does not permit everything: what it leaves open is bounded as on a club's field
(:func:`zmav.config.usual_fence`), about the fleet's origin or, without one, about where the vehicle was armed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from zmav import wire
from zmav.autopilots import Autopilot, Command, Target
from zmav.autopilots.moving import LANDINGS, SET_HOME, Speed, home_by, leads_to
from zmav.config import Geofence, Limits, usual_fence, usual_limits
from zmav.errors import BadInput
from zmav.services.authority import limits as limit
from zmav.services.authority.clearance import FORCE, Clearance, Place
from zmav.services.authority.trajectory import Segment
from zmav.services.companion import Companion
from zmav.services.link.reported import FRESH, fields_of, in_the_air
from zmav.services.missions.items import Raw
from zmav.terrain import Ground

NO_FIX = 1_000_000
"""1e-7 degrees: as near to 0, 0 an autopilot is that does not know where it is"""
WIDEN = "nobody has declared more for this vehicle: [geofence] and [limits] in its fleet file do"
HOME_STEP = 10.0
"""m by which home may be raised or lowered: heights, the bounds' too, count from it"""


class Bounds:
    """Each check raises :class:`~zmav.errors.BadInput` whose ``detail["count"]`` names the bound. From any thread.

    ``force`` leaves out what is only usual, never what is declared. The ground bounds places and straight ways, not
    velocities. Made of a fence that encloses nothing, :class:`~zmav.errors.BadConfig`.
    """

    def __init__(self, companion: Companion, fence: Geofence, limits: Limits, ground: Ground) -> None:
        self._port, self._identity, self._origin = companion.port, companion.identity, companion.origin
        self._fence = fence
        self._declared = limit.Fence(fence, companion.origin, ground=False)
        self._limits, self._usual_limits = limits, usual_limits(limits)
        self._about_home = companion.origin is None and not fence.polygon
        self._usual = None if self._about_home else limit.Fence(usual_fence(fence), companion.origin, ground=True)
        self._clearance = Clearance(ground, fence.above_ground)
        self._armed: bool | None = None
        """None: no HEARTBEAT came yet"""
        self._stood: Place | None = None
        """where it was armed, which says what the ground that is known is off, whatever becomes of its home"""

    def changed(self) -> None:
        """The HEARTBEAT shows another arming: without a declared origin, the field is about where that was."""
        armed, position = bool(self._identity.armed), self._position()
        if armed and not self._armed and self._about_home:
            self._usual = None
            self._usual_fence(position)
        if armed is not self._armed:
            source = self._identity.source
            stands = armed and self._armed is False and source and in_the_air(self._port, source) is False
            self._stood = _place_of(position) if stands and position is not None else None
        self._armed = armed

    def check(
        self, what: Target | Segment, *, force: bool | None = None, from_here: bool = True, lands: bool = False
    ) -> None:
        """A target from here (or from elsewhere), or a whole segment; ``force`` None: there is no such thing for it.
        ``lands``: it is for the ground, a segment at its end.
        """
        position = self._position()
        home = self._home(position)

        here = _here(position) if from_here else None
        flat = self._flat or (isinstance(what, Target) and what.alt_amsl is None is what.alt_rel and bool(what.lat_deg))

        def judge(fence: limit.Fence, limits: Limits) -> None:
            if isinstance(what, Segment):
                what.check(fence, limits, home, flat=flat)
            else:
                limit.check(what, fence, limits, home, here, flat=flat)

        with_place = isinstance(what, Segment) or what.lat_deg is not None
        self._permit(judge, position, force, with_place)
        if isinstance(what, Segment):
            if not self._flat and self._clearance.judges:
                present = None if position is None else _place_of(position)
                self._clearance.check_way(what.places(), present, self._stood_at(), lands=lands)
        elif with_place and not self._flat and not lands and (from_here or not flat) and self._clearance.judges:
            self._check_ground(what, position, force, from_here)

    def check_height(self, alt_rel: float, *, force: bool) -> None:
        """Straight up to so many metres above home."""
        self._permit(lambda fence, _: fence.check_height("alt_rel", alt_rel), self._position(), force, False)

    def check_speed(self, name: str, value: float, *, force: bool) -> None:
        """The limit of that name: speed, climb or descend (m/s)."""
        self._permit(lambda _, limits: limit.check_speed(name, value, limits), None, force, False)

    def check_command(self, command: Command, *, force: bool) -> None:
        """A MAV_CMD: the place, height or speed that it leads to."""
        if self._identity.autopilot is not None:
            self._check(command, self._identity.autopilot, force, in_mission=False)

    def check_mission(self, plan: Sequence[Raw], *, force: bool) -> None:
        """Every place, height and speed of a mission, before it is begun; names the item."""
        dialect, autopilot = self._port.dialect, self._identity.autopilot
        before: Place | None = None
        for index, raw in enumerate(plan):
            name, frame = dialect.enum_name("MAV_CMD", raw.command), dialect.enum_name("MAV_FRAME", raw.frame)
            if name is None or frame is None or autopilot is None:
                continue
            item = Command(name, (*raw.params, raw.x, raw.y, raw.z), frame)
            try:
                before = self._check(item, autopilot, force, in_mission=True, before=before)
            except BadInput as e:
                raise BadInput(f"item {index}: {e.message}", **e.detail) from None

    def _check(
        self, command: Command, autopilot: Autopilot, force: bool, *, in_mission: bool, before: Place | None = None
    ) -> Place | None:
        """Where it leads to, in a mission from where the item ``before`` led to."""
        if command.name == SET_HOME:
            self._check_home(home_by(command, autopilot), force, in_mission)
            return before
        lead = leads_to(command, autopilot, in_mission=in_mission)
        follows = "TERRAIN" in (command.frame or "")  # the ground on its way there, too
        if follows and isinstance(lead, Target):
            lead = self._above_sea(lead)
        self._check_lead(lead, force, from_here=not in_mission, lands=command.name in LANDINGS)
        level = None if before is None else before.alt_amsl
        place = self._place(lead, self._position(), level) if isinstance(lead, Target) else None
        if place is not None and before is not None and not follows and not self._flat:
            self._clearance.check(place, before, self._stood_at(), force=force)
        return place or before

    def _above_sea(self, lead: Target) -> Target:
        """A place at a height above the ground, which is known here or is left to the autopilot."""
        if lead.lat_deg is None or lead.lon_deg is None or lead.alt_rel is None:
            return lead
        alt = self._clearance.above_sea(lead.lat_deg, lead.lon_deg, lead.alt_rel, self._stood_at())
        return lead if alt is None else msgspec.structs.replace(lead, alt_amsl=alt, alt_rel=None)

    def _check_ground(
        self, what: Target, position: Mapping[str, Any] | None, force: bool | None, from_here: bool
    ) -> None:
        present = None if position is None else _place_of(position)
        place = self._place(what, position, None if present is None else present.alt_amsl)
        if place is not None:
            self._clearance.check(place, present if from_here else None, self._stood_at(), force=force)
        elif self._fence.above_ground is not None:
            text = "how high that is, is not known yet, and the fleet file asks for a height above the ground"
            raise BadInput(text, field="pos", value=None, expected="later", count="ground")

    def _place(self, what: Target, position: Mapping[str, Any] | None, level: float | None) -> Place | None:
        """Without a height of its own at ``level``. None: it has no place, or its height is not known."""
        alt, home = what.alt_amsl, self._home(position)
        if alt is None and what.alt_rel is None:
            alt = level
        elif alt is None and what.alt_rel is not None and home is not None:
            alt = home + what.alt_rel
        return (
            None
            if what.lat_deg is None or what.lon_deg is None or alt is None
            else Place(what.lat_deg, what.lon_deg, alt)
        )

    def _stood_at(self) -> Place | None:
        """Where it was armed on the ground; where that was not seen the first home since, and of a disarmed one that
        of now.
        """
        if self._stood is not None:
            return self._stood
        home = fields_of(self._port, "HOME_POSITION", self._identity.source)
        if home is None:
            return None
        place = Place(home["latitude"] / 1e7, home["longitude"] / 1e7, home["altitude"] / 1e3)
        if self._armed:
            self._stood = place
        return place

    def _check_descent(self, lead: Target, force: bool) -> None:
        """Down to a height where it is; up it may climb to any."""
        position = self._position()
        if position is None or not self._clearance.judges:
            return
        here = _place_of(position)
        place = self._place(Target(here.lat_deg, here.lon_deg, lead.alt_amsl, lead.alt_rel), position, here.alt_amsl)
        if place is not None and place.alt_amsl < here.alt_amsl:
            self._clearance.check(place, None, self._stood_at(), force=force)

    def _check_home(self, place: Target | None, force: bool, in_mission: bool) -> None:
        """A new home, which a return leads to and heights count from; ``place`` None: where the vehicle is then."""
        position = self._position()
        if place is not None:
            raised = 0.0 if self._flat else limit.height_of(place, self._home(position))
        else:
            raised = math.nan if in_mission or position is None else position["relative_alt"] / 1e3

        def judge(fence: limit.Fence, limits: Limits) -> None:
            if place is not None:
                limit.check(Target(place.lat_deg, place.lon_deg), fence, None, None, None, flat=True)
            if fence.limits_height and not self._flat and not abs(raised) <= HOME_STEP:
                where = "to where nobody knows yet" if math.isnan(raised) else f"by {raised:.1f} m"
                text = f"it moves home's height {where} (at most {HOME_STEP:g} m), and all heights with it"
                raise BadInput(text, field="alt", value=raised, expected=f"within {HOME_STEP:g} m", count="fence")

        self._permit(judge, position, force, place is not None)

    def _check_lead(self, lead: Target | Speed | None, force: bool, *, from_here: bool, lands: bool) -> None:
        if isinstance(lead, Speed):
            self.check_speed(lead.limit, lead.value, force=force)
        elif lead is not None and lead.lat_deg is not None:
            self.check(lead, force=force, from_here=from_here, lands=lands)
        elif lead is not None and not self._flat:
            self.check_height(limit.height_of(lead, self._home(self._position())), force=force)
            if from_here and not lands:
                self._check_descent(lead, force)

    # How it is done.

    @property
    def most_speed(self) -> float:
        """m/s over the ground: what is declared, or usual."""
        return self._usual_limits.speed or math.inf

    @property
    def placed(self) -> bool:
        """Where the usual field lies is known: about the fleet's origin, or where the vehicle is."""
        return self._usual_fence(self._position()) is not None

    @property
    def _flat(self) -> bool:
        """Its heights are nobody's choice."""
        return self._identity.autopilot is not None and self._identity.autopilot.on_surface

    def _permit(
        self,
        judge: Callable[[limit.Fence, Limits], None],
        position: Mapping[str, Any] | None,
        force: bool | None,
        with_place: bool,
    ) -> None:
        fence = self._usual_fence(position)
        try:
            if fence is None and with_place:
                text = "where the vehicle is, is not known: how far that is cannot be judged"
                raise BadInput(text, field="pos", value=None, expected="later", count="fence")
            judge(fence or self._declared, self._usual_limits)
        except BadInput as e:
            judge(self._declared, self._limits)  # whose words are the better reason
            if not force:
                hint = FORCE if force is False else ""
                raise BadInput(f"{e.message}; {WIDEN}{hint}", **e.detail) from None

    def _usual_fence(self, position: Mapping[str, Any] | None) -> limit.Fence | None:
        """Without an origin about where the vehicle is now; kept, until it is armed there."""
        centre = _origin_at(position) if self._usual is None and position else None
        if centre is not None:
            self._usual = limit.Fence(usual_fence(self._fence), centre, ground=True)
        return self._usual

    def _home(self, position: Mapping[str, Any] | None) -> float | None:
        """m above the sea; the origin's, where the vehicle has not said and nobody has declared heights above it."""
        if position is not None:
            return float(position["alt"] - position["relative_alt"]) / 1e3
        return None if self._origin is None or self._declared.limits_height else self._origin.alt_amsl

    def _position(self) -> Mapping[str, Any] | None:
        return fields_of(self._port, "GLOBAL_POSITION_INT", self._identity.source, FRESH)


def _origin_at(position: Mapping[str, Any]) -> wire.Origin | None:
    if max(abs(position["lat"]), abs(position["lon"])) < NO_FIX:
        return None
    lat, lon, alt = position["lat"] / 1e7, position["lon"] / 1e7, position["alt"] / 1e3
    return wire.Origin(lat_deg=lat, lon_deg=lon, alt_amsl=alt)


def _place_of(position: Mapping[str, Any]) -> Place:
    return Place(position["lat"] / 1e7, position["lon"] / 1e7, position["alt"] / 1e3)


def _here(position: Mapping[str, Any] | None) -> limit.Here | None:
    if position is None:
        return None
    velocity = (position["vx"] / 100.0, position["vy"] / 100.0, position["vz"] / 100.0)
    return limit.Here(position["lat"] / 1e7, position["lon"] / 1e7, position["relative_alt"] / 1e3, velocity)
