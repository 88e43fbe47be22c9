"""Write docs/keys.md, docs/cli.md, docs/asyncapi.json and the orders in docs/credentials.md again, from the registry
and from the commands: ``make docs``.

Nothing of these is typed by hand: channels are :data:`zmav.keys.CHANNELS`, orders :data:`zmav.verbs.VERBS`,
payloads the Structs of :mod:`zmav.wire` with what stands beside each field, and the command line is click's own tree,
entry points included. A test compares the pages with what this gives.
"""

from __future__ import annotations

import ast
import contextlib
import copy
import inspect
import json
import re
import sys
from collections.abc import Iterable, Iterator, Sequence, Set
from pathlib import Path

import click
import msgspec

from docs.compatible import breaks
from zmav import errors, keys, schemas, verbs, wire
from zmav.cli import zmav
from zmav.cli.common import zenoh_options
from zmav.trust.certificate import Role
from zmav.trust.rights import may

DOCS = Path(__file__).resolve().parent
ORDERS, END = "<!-- orders by role: 'make docs' writes them again -->", "<!-- end of the orders -->"
NOTE = "<!-- written by docs/generate.py: 'make docs' writes it again -->"


def plain(text: str | None) -> str:
    """A docstring as Markdown in one paragraph a blank line: roles and double backquotes are a forge's backquotes."""
    text = re.sub(r":\w+:`~?\.?([^`]*)`", r"`\1`", inspect.cleandoc(text or ""))
    return re.sub(r"``([^`]*)``", r"`\1`", text).replace("<", "&lt;")


def line(text: str | None) -> str:
    """The same in one line, for a table's cell."""
    return " ".join(plain(text).split()).replace("|", "\\|")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield "| " + " | ".join(row) + " |"
    yield ""


def code(text: str) -> str:
    return "`" + text.replace("|", "\\|") + "`" if text else ""


# docs/keys.md


def payloads() -> dict[str, type[msgspec.Struct]]:
    """Every payload by its name, in the order of the files."""
    found: dict[str, type[msgspec.Struct]] = {}
    folder = Path(inspect.getfile(wire)).parent
    for path in sorted(folder.glob("*.py")):
        module = sys.modules[f"zmav.wire.{path.stem}"] if path.stem != "__init__" else wire
        for each in vars(module).values():
            if inspect.isclass(each) and issubclass(each, msgspec.Struct) and each.__module__ == module.__name__:
                found[each.__name__] = each
    return {name: each for name, each in found.items() if each is not wire.Wire}


def linked(payload: type | None) -> str:
    return f"[{payload.__name__}](#{payload.__name__.lower()})" if payload else "bytes"


def fields(payload: type[msgspec.Struct]) -> list[tuple[str, str, str, str]]:
    """Of each field that a payload has itself: its name, type, default and what the file says of it."""
    (body,) = ast.parse(inspect.getsource(payload)).body
    assert isinstance(body, ast.ClassDef)
    found: list[tuple[str, str, str, str]] = []
    for node in body.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            default = ast.unparse(node.value) if node.value else "required"
            found.append((node.target.id, ast.unparse(node.annotation), default, ""))
        elif found and isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            found[-1] = (*found[-1][:3], str(node.value.value))
    return found


def base_of(payload: type[msgspec.Struct]) -> type[msgspec.Struct] | None:
    """The payload whose fields it has too."""
    base = payload.__mro__[1]
    return base if base.__name__ in payloads() else None


def about(payload: type[msgspec.Struct]) -> Iterator[str]:
    yield f"### {payload.__name__}\n"
    if payload.__doc__:
        yield plain(payload.__doc__) + "\n"
    base, own = base_of(payload), fields(payload)
    if base:
        yield f"The fields of {linked(base)}{', and:' if own else '.'}\n"
    if own:
        rows = ((code(name), code(kind), code(default), line(doc)) for name, kind, default, doc in own)
        yield from table(("field", "type", "default", "meaning"), rows)


def number(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:g} {unit}"


def orders(table_of: dict[str, verbs.Verb]) -> Iterator[str]:
    rows = (
        (code(verb.name), linked(verb.args), verb.access.value, ", ".join(verb.writers), line(verb.doc))
        for verb in table_of.values()
    )
    yield from table(("verb", "arguments", "kind", "who may", "what it does"), rows)


def access_docs() -> Iterator[tuple[str, str]]:
    """What each kind of order needs: what stands below its name in the file."""
    (body,) = ast.parse(inspect.getsource(verbs.Access)).body
    assert isinstance(body, ast.ClassDef)
    for name, doc in zip(body.body[1::2], body.body[2::2], strict=True):
        assert isinstance(name, ast.Assign) and isinstance(doc, ast.Expr) and isinstance(doc.value, ast.Constant)
        assert isinstance(name.value, ast.Constant)
        yield str(name.value.value), str(doc.value.value)


def error_codes() -> Iterator[tuple[str, str]]:
    for each in vars(errors).values():
        if inspect.isclass(each) and issubclass(each, errors.ZmavError) and each.__module__ == errors.__name__:
            yield each.code, (each.__doc__ or "").partition("\n\n")[0]


def writers(channel: keys.Channel) -> str:
    if channel is keys.DO:
        return "[verb by verb](#orders-doverb)"
    if channel is keys.FLEET:
        return "[topic by topic](#the-fleets-topics)"
    return ", ".join(channel.writers)


def channel_tables() -> Iterator[str]:
    channels, docs = keys.CHANNELS.values(), schemas.channel_docs()
    yield "## Channels\n"
    yield "`pub`: the vehicle publishes. `put`: others write. `query`: others ask. `token`: liveliness.\n"
    rows = (
        (code(f"{keys.ROOT}/{c.template}"), c.kind, linked(c.payload) if c.kind != "token" else "", line(docs[c.name]))
        for c in channels
    )
    yield from table(("key", "kind", "payload", "meaning"), rows)
    yield "## How each channel travels\n"
    yield (
        "The payload's version, the class of service, the nominal rate, when a value is stale, whether the recorder "
        "keeps it, whether a link "
        "repeats what it lost, whether the vehicle asks for a proof of origin where it has credentials, and who may "
        "put or ask.\n"
    )
    rows2 = (
        (
            f"`{c.name}`",
            str(c.version),
            c.qos.value,
            number(c.rate_hz, "Hz"),
            number(c.stale_after, "s"),
            "yes" if c.recorded else "",
            "yes" if c.repeated else "",
            "yes" if c.proven else "",
            writers(c),
        )
        for c in channels
    )
    head = ("channel", "version", "class", "rate", "stale after", "recorded", "repeated", "proof", "who may put or ask")
    yield from table(head, rows2)
    yield "## Classes of service\n"
    yield "There are four. Nothing is ever sent with a blocking put, and nothing express.\n"
    rows3 = (
        (
            qos.value,
            code(str(qos.priority).rpartition(".")[2]),
            code(str(qos.options()["congestion_control"]).rpartition(".")[2]),
            ", ".join(f"`{c.name}`" for c in channels if c.qos is qos),
        )
        for qos in keys.Qos
    )
    yield from table(("class", "Zenoh's priority", "on congestion", "channels"), rows3)


def keys_page() -> str:
    """The whole of docs/keys.md."""
    lines = ["# The keys", "", NOTE, "", plain(keys.__doc__), ""]
    lines += [plain(wire.__doc__), ""]
    lines += [
        "[Channels](#channels) · [how each travels](#how-each-channel-travels) · "
        "[classes of service](#classes-of-service) · [orders](#orders-doverb) · "
        "[swarm orders](#orders-for-several-vehicles-swarmverb) · [topics](#the-fleets-topics) · "
        "[errors](#errors) · [payloads](#payloads)",
        "",
        *channel_tables(),
    ]
    lines += ["## Orders: do/{verb}\n", *orders(verbs.VERBS)]
    lines += [
        "The kinds of order:\n",
        *table(("kind", "what it needs and does"), ((a, line(b)) for a, b in access_docs())),
    ]
    lines += ["## Orders for several vehicles: swarm/{verb}\n", *orders(verbs.SWARM_VERBS)]
    lines += ["## The fleet's topics\n"]
    lines += table(("topic", "who may put"), ((code(topic), ", ".join(who)) for topic, who in keys.TOPICS.items()))
    lines += ["## Errors\n", "An error reply is an [ErrorBody](#errorbody); its `code` is one of:\n"]
    lines += table(("code", "meaning"), ((code(name), line(doc)) for name, doc in error_codes()))
    lines += ["## Payloads\n"]
    for payload in sorted(payloads().values(), key=lambda each: each.__name__):
        lines += about(payload)
    return "\n".join(lines).rstrip() + "\n"


# docs/cli.md


@zenoh_options
def _connecting(settings: object) -> None:
    """A command with nothing but the options of every verb that connects."""


CONNECTING: list[click.Option] = list(reversed(_connecting.__click_params__))  # type: ignore[attr-defined]


def option_row(option: click.Option) -> tuple[str, str, str]:
    names = ", ".join(code(name) for name in (*option.opts, *option.secondary_opts))
    takes = ""
    if not option.is_flag and not option.count:
        takes = " " + code(option.metavar or choices(option.type) or option.type.name.upper())
    shown = option.show_default if isinstance(option.show_default, str) else ""
    value = option.to_info_dict()["default"]
    if not shown and not option.required and not option.is_flag and isinstance(value, (str, int, float)):
        shown = str(value)
    said = line(option.help)
    if option.show_envvar and option.envvar:
        said += f" Else ${option.envvar}."
    return names + takes, "required" if option.required else code(shown), said


def choices(kind: object) -> str:
    return "|".join(map(str, kind.choices)) if isinstance(kind, click.Choice) else ""


def command_lines(path: str, command: click.Command, parent: click.Context) -> Iterator[str]:
    context = command.context_class(command, info_name=path.rpartition(" ")[2], parent=parent)
    yield f"{'##' if path.count(' ') == 1 else '###'} {path}\n"
    if not isinstance(command, click.Group) or not command.no_args_is_help:
        yield f"    {path} {' '.join(command.collect_usage_pieces(context))}\n"
    yield plain((command.help or "").replace("\b\n", "")) + "\n"
    known = {option.name for option in CONNECTING}
    options = [each for each in command.params if isinstance(each, click.Option) and not each.hidden]
    own = [each for each in options if each.name not in known]
    if own:
        yield from table(("option", "default", "meaning"), map(option_row, own))
    if len(own) < len(options):
        yield "And the [options of every verb that connects](#options-of-every-verb-that-connects).\n"
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            each = command.get_command(context, name)
            assert each is not None
            if not each.hidden:
                yield from command_lines(f"{path} {name}", each, context)


def cli_page() -> str:
    """The whole of docs/cli.md."""
    top = click.Context(zmav, info_name="zmav")
    names = zmav.list_commands(top)
    lines = ["# The command line", "", NOTE, "", plain(zmav.help), ""]
    lines += [
        "`zmav VERB --help` says the same. Exit codes: 0 done, 1 an error that is said, 2 wrong usage, 130 "
        "interrupted.\n"
    ]
    lines += [" · ".join(f"[{name}](#zmav-{name})" for name in names), ""]
    lines += [
        "## Options of every verb that connects\n",
        *table(("option", "default", "meaning"), map(option_row, CONNECTING)),
    ]
    for name in names:
        command = zmav.get_command(top, name)
        assert command is not None
        lines += command_lines(f"zmav {name}", command, top)
    return "\n".join(lines).rstrip() + "\n"


# docs/credentials.md: one table of it


def may_order(table_of: dict[str, verbs.Verb], channel: keys.Channel) -> Iterator[str]:
    """Every order by role, as the vehicle's gate judges it: of any vehicle, and of a vehicle's own programs."""

    def word(verb: verbs.Verb, role: Role, name: str) -> str:
        parts = {"vehicle": "quad1", "verb": verb.name}
        for given, yes in (((), "yes"), (verbs.GRANTABLE, "if given")):
            with contextlib.suppress(errors.Forbidden):
                may(role, name, channel, parts, given)
                return yes
        return ""

    who = ((Role.VIEWER, "lab"), (Role.PLANNER, "plan"), (Role.VEHICLE, "quad1"), (Role.OPERATOR, "alice"))
    rows = ((code(verb.name), *(word(verb, *one) for one in who)) for verb in table_of.values())
    yield from table(("order", "viewer", "planner", "quad1's own programs", "operator"), rows)


def credentials_page() -> str:
    """docs/credentials.md as it is, with the table of orders between its two marks made again."""
    page = (DOCS / "credentials.md").read_text(encoding="utf-8")
    before, rest = page.split(f"{ORDERS}\n")
    orders_of = "Of quad1, `do/{verb}`:\n", *may_order(verbs.VERBS, keys.DO)
    swarm_of = "Of the planner on quad1, `swarm/{verb}`:\n", *may_order(verbs.SWARM_VERBS, keys.SWARM)
    return "\n".join((before + ORDERS, "", *orders_of, *swarm_of, END + rest.split(END)[1]))


def asyncapi_page() -> str:
    """The whole of docs/asyncapi.json, which is also what a later version is held against."""
    document = copy.deepcopy(schemas.asyncapi())
    del document["info"]["x-zmav"]  # a release changes nothing that is said
    parts = {"channels", "operations", "messages", "schemas"}
    return "".join(_lines(document, parts)) + "\n"


def _lines(value: object, parts: Set[str], name: str = "", indent: str = "") -> Iterator[str]:
    """JSON whose ``parts``, and what holds them, have a line for each of theirs; anything else is one line."""
    if not isinstance(value, dict) or not (name in parts or parts & value.keys()):
        yield json.dumps(value, ensure_ascii=False)
        return
    yield "{"
    for number, (key, inner) in enumerate(value.items()):
        yield ("," if number else "") + f"\n{indent} {json.dumps(key)}: "
        yield from _lines(inner, parts if name not in parts else frozenset(), key, indent + " ")
    yield f"\n{indent}}}"


def check_asyncapi() -> None:
    """End where what an older program would misread has the same version as before."""
    path = DOCS / "asyncapi.json"
    found = list(breaks(json.loads(path.read_bytes()), schemas.asyncapi())) if path.exists() else []
    if found:
        sys.exit("\n".join([*found, "move the version of these channels (zmav/keys.py) or orders (zmav/verbs.py)"]))


PAGES = {
    "keys.md": keys_page,
    "cli.md": cli_page,
    "credentials.md": credentials_page,
    "asyncapi.json": asyncapi_page,
}


def main() -> None:
    check_asyncapi()
    for name, page in PAGES.items():
        (DOCS / name).write_text(page(), encoding="utf-8")
        print(f"wrote {DOCS / name}")


if __name__ == "__main__":
    main()
