"""What a router's door lets in and out: Zenoh's ``access_control``, worked out from the registry, the roster and the
fleet file.

Zenoh judges the neighbour on a link by the common name of its certificate, not who said something first. So a host that
relays may bring what is anybody's, except what only our own vehicle can say; one that does not may bring what is its
own. Whether an order truly comes from who may give it is judged by the vehicle's gate. A key expression with wildcards
passes only where one rule holds all of it, so names are written out wherever a wildcard would hold our own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import Any

from mesh.credentials.exposure import GUARDED
from zmav import keys
from zmav.config import FleetConfig
from zmav.errors import Forbidden
from zmav.keys import CHANNELS, ROOT, Channel
from zmav.trust.certificate import Role
from zmav.trust.rights import may, writers
from zmav.trust.roster import Roster
from zmav.verbs import SWARM_VERBS, VERBS

Rule = dict[str, Any]
READING = ("declare_subscriber", "liveliness_query", "declare_liveliness_subscriber")
ANSWERING = ("declare_queryable", "reply")
SAYING = ("put", "liveliness_token", *ANSWERING)
BRING = ("put", "declare_subscriber", "query")
GET = ("put", "declare_subscriber", "reply", "declare_queryable")
"""of rosters: who is not on ours brings one, hears of ours and asks for it, but answers nobody who asks"""
EVERYTHING = ("put", "delete", "query", "reply", *READING, "declare_queryable", "liveliness_token")
STRANGER = "*"
"""stands for every vehicle but the member's own: no name has it, and in a key expression it holds them all"""
ROS_SPEAKERS = (Role.OPERATOR, Role.PLANNER)
"""whose nodes of ROS may publish, serve and ask; others' listen. A host that relays brings others'"""
NOT_RELAYING = (Role.PLANNER, Role.VIEWER)
SOCKET: Rule = {"id": "socket", "link_protocols": ["unixsock-stream"]}
"""programs of this computer whom the owner and the group of the router's unix socket let in"""
LOOPBACK: Rule = {"id": "loopback", "interfaces": ["lo"], "link_protocols": ["tcp"]}
"""any program of this computer: nobody else reaches a plain TCP port of loopback"""
CERTIFIED: Rule = {"id": "certified", "link_protocols": list(GUARDED)}
"""who shows any certificate of our authority: one that was issued since our roster, or that was revoked"""
ADMIN = "@/**"
"""routers' admin spaces, which 'zmav mesh graph' and 'zmav doctor' read; nothing can be written there"""
ADMIN_ASKED = ("@/*/router",)
"""what may be asked of them, and no more, by this host's own programs either: a question about link states, ways or
declarations can make a router of Zenoh 1.10.2 stand still for good (:mod:`mesh.linkstate`)"""


def access_control(file: FleetConfig, fleet: str, name: str, roster: Roster) -> dict[str, Any]:
    """Zenoh's ``access_control`` for the router of host ``name``.

    Anyone who is not on the roster gets nothing but rosters, so that a new member can bring the one that admits it.

    ``file`` says who relays; a host that is not in it relays if its role does. The same input gives the same output,
    so that two can be compared.
    """
    others = sorted({member for role in Role for member in roster.names(role.value)} - {name})
    rules: list[Rule] = [
        _rule("socket", ("ingress", "egress"), EVERYTHING, (*_wide(), *_spaces(fleet), *ADMIN_ASKED)),
        _rule("roster-in", ("ingress",), BRING, (keys.FLEET.key(fleet, topic=keys.ROSTER),)),
        _rule("roster-out", ("egress",), GET, (keys.FLEET.key(fleet, topic=keys.ROSTER),)),
        _rule("hear", ("egress",), EVERYTHING, (*_spaces(fleet), ADMIN)),
        _rule("read", ("ingress", "egress"), READING, (*_wide(), ADMIN)),
    ]
    loopback = list(_loopback(fleet, name))
    rules += loopback
    ros = list(_ros(file.ros2.domain))
    rules += ros
    speaking, looking = _ids(ros[:1]), _ids(ros[1:])
    subjects: list[Rule] = [SOCKET, LOOPBACK, CERTIFIED]
    policies: list[Rule] = [
        {"rules": ["socket", *speaking], "subjects": [SOCKET["id"]]},
        {"rules": ["hear", "read", *_ids(loopback), *speaking], "subjects": [LOOPBACK["id"]]},
        {"rules": ["roster-in", "roster-out"], "subjects": [CERTIFIED["id"]]},
    ]
    relays = []
    for role in Role:
        for member in roster.names(role.value):
            if member == name:
                continue
            if relaying(file, role, member):
                relays.append(member)
                continue
            subjects.append({"id": f"member-{member}", "cert_common_names": [member]})
            own = list(_leaf(fleet, role, member, file.rights.planner))
            rules += own
            own_ros = speaking if role in ROS_SPEAKERS else looking
            policies.append({"rules": ["hear", "read", *_ids(own), *own_ros], "subjects": [f"member-{member}"]})
    if relays:
        subjects.append({"id": "relays", "cert_common_names": sorted(relays)})
        theirs = list(_relay(fleet, name, others, file.rights.planner))
        rules += theirs
        policies.append({"rules": ["hear", "read", *_ids(theirs), *speaking], "subjects": ["relays"]})
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def relaying(file: FleetConfig, role: Role, name: str) -> bool:
    """Whether a member's host carries others' traffic."""
    host = file.vehicles.get(name) or file.stations.get(name)
    return role not in NOT_RELAYING and (host is None or host.mesh.relay)


def granted(
    role: Role, name: str, fleet: str, vehicle: str = STRANGER, given: Collection[str] = ()
) -> dict[str, list[str]]:
    """What a member may put (``put``), ask (``query``) and declare (``token``) of ``vehicle`` or of the whole fleet.

    ``given``: the verbs that the fleet file gives to planners.
    """
    found: dict[str, list[str]] = {"put": [], "query": [], "token": []}
    for channel in CHANNELS.values():
        for parts in _cases(channel):
            parts["vehicle"] = vehicle
            key = channel.key(fleet, **parts)
            if channel.kind == "pub":
                found["query"].append(key)  # its last value, or what was missed of it
            if _may(role, name, channel, parts, given):
                found["put" if channel.kind == "pub" else channel.kind].append(key)
    return found


def _cases(channel: Channel) -> Iterator[dict[str, str]]:
    """The parts of a channel's keys: each of those on which rights depend, and ``*`` for the others."""
    parts = dict.fromkeys(_names(channel.template), "*")
    if channel in (keys.DO, keys.SWARM):
        for verb in VERBS if channel is keys.DO else SWARM_VERBS:
            yield {**parts, "verb": verb}
    elif channel is keys.FLEET:
        for topic in (*keys.TOPICS, "*"):
            yield {**parts, "topic": topic}
    elif channel is keys.ALIVE:
        for role in (*(role.value for role in Role), keys.ROUTER):
            yield {**parts, "role": role}
    else:
        yield parts


def _names(template: str) -> Iterator[str]:
    return (chunk.strip("{}") for chunk in template.split("/")[1:] if chunk.startswith("{"))


def _may(role: Role, name: str, channel: Channel, parts: dict[str, str], given: Collection[str]) -> bool:
    held = parts if "{vehicle}" in channel.template else {k: v for k, v in parts.items() if k != "vehicle"}
    try:
        may(role, name, channel, held, given)
    except Forbidden:
        return False
    return True


def local(fleet: str, name: str) -> dict[str, list[str]]:
    """What any program of the host ``name`` may put (``put``), ask (``query``) and declare (``token``), by plain TCP on
    loopback: what a viewer may, and what is under the host's own name, but never what only a vehicle says.

    Under a vehicle's name that is what is proven or sealed, judged where it arrives, and what its agents say; under a
    ground host's what is proven for the planner and the agents there, and what these say. No other vehicle is spoken
    to, and nothing that plans is said to all.
    """
    acts, found = {keys.ANYONE, keys.AGENT}, granted(Role.VIEWER, name, fleet)
    for channel in CHANNELS.values():
        for parts in _cases(channel) if "{vehicle}" in channel.template else ():
            if channel is keys.ALIVE:
                allowed = parts["role"] != keys.VEHICLE
            else:
                allowed = keys.proven(channel, parts) or bool(acts & set(writers(channel, parts)))
            kind = "put" if channel.kind == "pub" else channel.kind
            if allowed:
                parts["vehicle"] = name
                found[kind].append(channel.key(fleet, **parts))
    return found


def _loopback(fleet: str, name: str) -> Iterator[Rule]:
    found, replay = local(fleet, name), f"{ROOT}/{keys.replay_of(fleet)}/**"
    detected = [f"{key}/@adv/**" for key in found["put"]]
    asked = (*found["query"], f"{ROOT}/{fleet}/**/@adv/**", *_under(fleet, name), *ADMIN_ASKED)
    yield _rule("loopback-answer", ("ingress",), ANSWERING, (*_under(fleet, name), *_answers(fleet), replay))
    yield _rule("loopback-ask", ("ingress",), ("query",), (*asked, replay))
    yield _rule("loopback-asked", ("egress",), ("query",), (*_wide(), *_spaces(fleet), *ADMIN_ASKED))
    yield _rule("loopback-put", ("ingress",), ("put", "delete"), (*found["put"], *detected, replay))
    yield _rule("loopback-token", ("ingress",), ("liveliness_token",), (*found["token"], *detected, replay))


def _leaf(fleet: str, role: Role, name: str, given: Collection[str]) -> Iterator[Rule]:
    """For a neighbour that brings only what is its own: what its role may, under its own name, too."""
    yield _rule(f"answer-{name}", ("ingress",), ANSWERING, (*_under(fleet, name), *_answers(fleet)))
    own = granted(role, name, fleet, name, given)
    detected = [f"{key}/@adv/**" for key in own["put"]]  # by which readers know that they missed something
    more = {"query": [f"{ROOT}/{fleet}/**/@adv/**", *ADMIN_ASKED], "put": detected, "liveliness_token": detected}
    for message, keys_ in _by_message(_both(granted(role, name, fleet, given=given), own)):
        yield _rule(f"{message}-{name}", ("ingress",), (message,), (*keys_, *more[message]))
    denied = [channel.key(fleet) for channel in (keys.RTCM, keys.TRAFFIC) if not _may(role, name, channel, {}, given)]
    if denied:  # among topics of which the wildcard lets any pass
        yield {**_rule(f"deny-{name}", ("ingress",), ("put",), denied), "permission": "deny"}


def _relay(fleet: str, name: str, others: Iterable[str], given: Collection[str]) -> Iterator[Rule]:
    """For neighbours that bring others' words: all but those that only ``name``, our own vehicle, can say."""
    theirs = [key for other in others for key in _under(fleet, other)]
    yield _rule("relay-say", ("ingress",), SAYING, (*theirs, *_fleetwide(fleet), *_answers(fleet)))
    yield _rule("relay-ask", ("ingress", "egress"), ("query",), (*_wide(), *ADMIN_ASKED))
    ours: dict[str, list[str]] = {"put": [], "query": [], "token": []}
    for role in Role:
        if role is not Role.VEHICLE:
            ours = _both(ours, granted(role, "", fleet, name, given))
    for message, keys_ in _by_message({**ours, "query": []}):
        yield _rule(f"relay-{message}-ours", ("ingress",), (message,), keys_)


def _ros(domain: int | None) -> Iterator[Rule]:
    """One domain of ROS 2: whatever a node does, and then what one that only listens does. The keys of topics and
    services begin with the domain, tokens with ``@ros2_lv``.
    """
    if domain is None:
        return
    tokens = f"@ros2_lv/{domain}"
    both = (f"{domain}/**", f"{domain}/**/@adv/**", f"{tokens}/**")
    yield _rule("ros2", ("ingress", "egress"), EVERYTHING, both)
    yield _rule("ros2-hear", ("egress",), EVERYTHING, both)
    yield _rule("ros2-read", ("ingress",), READING, both)
    yield _rule("ros2-missed", ("ingress",), ("query",), (f"{domain}/**/@adv/**",))
    listeners = tuple(f"{tokens}/*/*/*/{kind}/**" for kind in ("NN", "MS"))
    yield _rule("ros2-shown", ("ingress",), ("liveliness_token",), listeners)


def _both(one: dict[str, list[str]], other: dict[str, list[str]]) -> dict[str, list[str]]:
    return {kind: list(dict.fromkeys((*one[kind], *other[kind]))) for kind in one}


def _by_message(found: dict[str, list[str]]) -> Iterator[tuple[str, list[str]]]:
    for kind, message in (("put", "put"), ("query", "query"), ("token", "liveliness_token")):
        if found[kind]:
            yield message, found[kind]


def _under(fleet: str, name: str) -> tuple[str, ...]:
    """All keys of a host, and those on which what was missed of them is asked."""
    return f"{ROOT}/{fleet}/{name}/**", f"{ROOT}/{fleet}/{name}/**/@adv/**"


def _at() -> tuple[str, ...]:
    """``@fleet`` and its like: a wildcard does not hold a chunk that begins with ``@``."""
    return tuple(dict.fromkeys(c.template.split("/")[1] for c in CHANNELS.values() if "/@" in c.template))


def _fleetwide(fleet: str) -> tuple[str, ...]:
    """What is nobody's own."""
    return tuple(f"{ROOT}/{fleet}/{chunk}/**" for chunk in _at())


def _wide() -> tuple[str, ...]:
    """Whatever a reader names: ``zmav/**`` is wider than the fleet, and finds no more for that."""
    return "**", "**/@adv/**", *(f"**/{chunk}/**" for chunk in _at())


def _spaces(fleet: str) -> tuple[str, ...]:
    """Every key of the fleet."""
    return f"{ROOT}/{fleet}/**", f"{ROOT}/{fleet}/**/@adv/**", *_fleetwide(fleet)


def _answers(fleet: str) -> tuple[str, ...]:
    """What every router answers: about itself, and which roster it has."""
    return ADMIN, keys.FLEET.key(fleet, topic=keys.ROSTER)


def _rule(identifier: str, flows: Iterable[str], messages: Iterable[str], expressions: Iterable[str]) -> Rule:
    return {
        "id": identifier,
        "permission": "allow",
        "flows": list(flows),
        "messages": list(messages),
        "key_exprs": list(dict.fromkeys(expressions)),
    }


def _ids(rules: Iterable[Rule]) -> list[str]:
    return [str(rule["id"]) for rule in rules]
