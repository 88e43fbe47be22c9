"""What each role may put and ask, derived from the registry: ``writers`` of channels, verbs and the fleet's topics.

The vehicle's gate judges proofs of origin by it, and the routers' access rules are made from it, so both say the same.
A vehicle's certificate speaks under the vehicle's own name, and its own programs fly that vehicle and no other.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from zmav import keys, wire
from zmav.errors import BadInput, Forbidden
from zmav.trust.certificate import Role
from zmav.verbs import GIVEN, SWARM_VERBS, VERBS

SPEAKERS = {keys.VEHICLE: (Role.VEHICLE,), keys.PLANNER: (Role.PLANNER, Role.OPERATOR), keys.OPERATOR: (Role.OPERATOR,)}
"""who may have a token that says so; others are anybody's"""


def writers(channel: keys.Channel, parts: Mapping[str, str], given: Collection[str] = ()) -> tuple[str, ...]:
    """Who may put on, or ask, a key of ``channel`` with these parts (as :func:`zmav.keys.match` gives them).

    An order that does not exist is everybody's: anyone who gives it is told which ones there are. ``given``: verbs that
    the fleet file gives to planners.
    """
    if channel in (keys.DO, keys.SWARM):
        verb = (VERBS if channel is keys.DO else SWARM_VERBS).get(parts["verb"])
        if verb is None:
            return (keys.ANYONE,)
        return (*verb.writers, *GIVEN) if verb.grantable and verb.name in given else verb.writers
    if channel is keys.FLEET:
        return keys.TOPICS.get(parts["topic"], channel.writers)
    return channel.writers


def acts_as(role: Role, name: str, vehicle: str | None) -> frozenset[str]:
    """As which writers a member may act on keys of ``vehicle`` (None: keys of the whole fleet)."""
    if role is not Role.VEHICLE:
        return frozenset({role.value, keys.ANYONE})
    own = {keys.VEHICLE, keys.AGENT} if vehicle == name else {keys.VEHICLE} if vehicle is None else set()
    return frozenset({*own, keys.ANYONE})


def may(role: Role, name: str, channel: keys.Channel, parts: Mapping[str, str], given: Collection[str] = ()) -> None:
    """Raise :class:`Forbidden` unless the member ``name`` may put on, or ask, that key of ``channel``."""
    vehicle, allowed = parts.get("vehicle"), writers(channel, parts, given)
    if not acts_as(role, name, vehicle) & set(allowed):
        raise _forbidden(role, name, channel, parts, allowed)
    if channel is keys.ALIVE and (vehicle != name or role not in SPEAKERS.get(parts["role"], tuple(Role))):
        raise _forbidden(role, name, channel, parts, (f"{parts['role']} {vehicle}",))


def check_source(role: Role, name: str, channel: keys.Channel, payload: bytes) -> None:
    """Raise :class:`Forbidden` where a vehicle tells of aircraft for another than its own receiver: in another's name,
    or for the feeds of a ground process, whose charge it would take.
    """
    if channel is not keys.TRAFFIC or role is not Role.VEHICLE:
        return
    try:
        report = wire.decode(payload, wire.Traffic, "traffic")
    except BadInput:
        return  # who reads it says so
    if report.serves or report.source != name:
        text = f"{name} (vehicle) tells of aircraft as {report.serves or report.source}, and not for its own receiver"
        raise Forbidden(text[:200], reason="name", origin=name, role=role.value)


def _forbidden(
    role: Role, name: str, channel: keys.Channel, parts: Mapping[str, str], allowed: tuple[str, ...]
) -> Forbidden:
    what = parts.get("topic" if channel is keys.FLEET else "verb")
    named = f"{channel.name} {what}" if what else channel.name
    vehicle = parts.get("vehicle")
    of = f" of {vehicle}" if vehicle else ""
    who = ", ".join({keys.AGENT: "its own programs", keys.VEHICLE: "itself"}.get(w, w) for w in allowed)
    text = f"{name} ({role.value}) may not use {named}{of}; allowed: {who}"
    return Forbidden(text, reason="role", origin=name, role=role.value, allowed=list(allowed))
