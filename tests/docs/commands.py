"""The commands that the documents show, and whether each can be: a verb, options, targets and files that there are."""

from __future__ import annotations

import importlib.metadata
import re
import shlex
from collections.abc import Container, Iterator
from pathlib import Path
from typing import NamedTuple

import click

from zmav.cli import zmav

ROOT = Path(__file__).resolve().parent.parent.parent
GENERATED = ("docs/cli.md", "docs/keys.md")
"""made from the code: their usage lines are nobody's commands"""
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
PROGRAMS = re.compile(
    r"zmav|make|sudo|zenoh|curl|pip|python3?|git|cd|\.|systemctl|journalctl|docker|apt|apt-get|rerun|octave(-cli)?|openssl"
    r"|ssh|scp|deploy/install\.sh|ls|cat|mkdir|cp|ip|batctl|iw|timedatectl"
)
"""what a line of a block begins with where it is a command and no figure, file or answer"""
SHELL = ("", "sh", "shell", "bash", "console")
"""languages of fenced blocks that hold commands"""
OPERATORS = ("&&", "||", ";", "|", "&")
PREFIXES = re.compile(r"([A-Z_]+=\S*\s+|sudo\s+(-E\s+)?|\$\s+)+")
IN_TREE = re.compile(r"(?<![\w/~.-])(?:(?:agents|deploy|docs|ground|mesh|tests)/[\w./-]+|zmav/[\w/]+\.py)")


class Command(NamedTuple):
    page: str
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"


def blocks(text: str) -> Iterator[tuple[str, int, str]]:
    """Each line of code of a page: the block's language ("" where it has none), its number, the line."""
    fence: str | None = None
    above = ""
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        if re.match(r"\s*```", line):
            fence = None if fence is not None else line.strip().strip("`").strip()
            inside, above = False, ""
            continue
        if fence is not None:
            yield fence, number, line.strip()
            continue
        inside = line.startswith("    ") and (inside or not above.strip())
        if inside:
            yield "", number, line.strip()
        above = line


def commands_of(page: Path) -> list[Command]:
    """The commands in a page's blocks, without their comments; lines that end in a backslash are one with the next."""
    name = page.relative_to(ROOT).as_posix()
    if name in GENERATED:
        return []
    found: list[Command] = []
    begun, since = "", 0
    for language, number, line in blocks(page.read_text("utf-8")):
        if language not in SHELL:
            continue
        since = since if begun else number
        begun += re.sub(r"(^|\s+)#(\s.*|)$", "", line)
        if begun.endswith("\\"):
            begun = begun[:-1]
            continue
        text, begun = begun.strip().removeprefix("$ "), ""
        first = PREFIXES.sub("", text).split(" ", 1)[0]
        if PROGRAMS.fullmatch(first) and (" " in text or first == "zmav") and text != ".":
            found.append(Command(name, since, text))
    return found


def all_commands() -> list[Command]:
    return [command for page in PAGES for command in commands_of(page)]


def words_of(text: str) -> list[list[str]]:
    """The words of each simple command of a line."""
    lexer = shlex.shlex(text, posix=True, punctuation_chars="&|;")
    lexer.whitespace_split = True
    lexer.commenters = ""
    parts: list[list[str]] = [[]]
    for word in lexer:
        if word in OPERATORS:
            parts.append([])
        else:
            parts[-1].append(word)
    return [part for part in parts if part]


def parse(words: list[str]) -> None:
    """Parse a zmav command as click does, without doing anything; raises click.ClickException.

    Whether files are there is for the run to say.
    """
    command: click.Command = zmav
    context: click.Context | None = None
    name, args = words[0], words[1:]
    while True:
        context = command.make_context(name, list(args), parent=context)
        if not isinstance(command, click.Group):
            return
        rest = [*context._protected_args, *context.args]
        if not rest:
            if not command.invoke_without_command:
                raise click.UsageError(f"{name} wants a verb of its own")
            return
        _, found, args = command.resolve_command(context, rest)
        assert found is not None
        command, name = found, rest[0]


def targets() -> set[str]:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    return set(re.findall(r"^([a-z]+):.*##", makefile, re.MULTILINE))


def faults(command: Command, coming: Container[str] = ()) -> Iterator[str]:
    """What is wrong with a command as it stands in the page; ``coming``: verbs that may not be there yet."""
    for path in IN_TREE.findall(command.text):
        if not (ROOT / path).exists():
            yield f"{path} is not in the tree"
    for words in words_of(command.text):
        while words and re.fullmatch(r"sudo|-E|[A-Z_]+=.*", words[0]):
            words = words[1:]
        if words[:3] == ["zmav", "lab", "exec"]:
            words = words[4:]
        if words[:1] == ["zmav"] and (len(words) == 1 or words[1] not in coming):
            try:
                parse(words)
            except click.exceptions.Exit:
                pass
            except click.ClickException as e:
                yield e.format_message()
        if words[:2] == ["pip", "install"]:
            extras = re.findall(r"zmav\[([\w,]+)\]", " ".join(words))
            known = set(importlib.metadata.metadata("zmav").get_all("Provides-Extra") or ())
            yield from (
                f"zmav has no extra {each!r}" for each in ",".join(extras).split(",") if each not in {*known, ""}
            )
        if words[:1] == ["make"]:
            yield from (
                f"make has no target {word!r}" for word in words[1:] if "=" not in word and word not in targets()
            )


def verbs_in_prose(page: Path, coming: Container[str]) -> Iterator[str]:
    """The verbs that a page names between backquotes, as ``zmav agent run``, and that there are not."""
    if page.relative_to(ROOT).as_posix() in GENERATED:
        return
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    for span in re.findall(r"`zmav ([a-z][^`]*)`", text):
        command: click.Command = zmav
        context = click.Context(zmav, info_name="zmav")
        for word in span.split():
            if not isinstance(command, click.Group) or not re.fullmatch(r"[a-z][a-z-]*", word):
                break
            found = command.get_command(context, word)
            if found is None:
                verb = f"{context.command_path} {word}".split(" ", 1)[1]
                if verb not in coming and not command.invoke_without_command:
                    yield f"{page.relative_to(ROOT)}: `zmav {span}`: there is no verb {word!r}"
                break
            command, context = found, click.Context(found, info_name=word, parent=context)
