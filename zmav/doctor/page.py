"""The page that ``zmav doctor`` prints: findings by groups, red ones marked, each with what to do."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Iterator

import click

from zmav.doctor.findings import FLEET, GROUPS, HOST, VEHICLE, Finding, Level
from zmav.doctor.words import clean, few

FEW = 4
"""hosts up to which each has all of its lines on the page"""
MARKS = {
    Level.OK: click.style("ok ", fg="green"),
    Level.ADVICE: click.style("...", fg="yellow"),
    Level.RED: click.style("RED", fg="red", bold=True),
}


def page(findings: list[Finding]) -> Iterator[str]:
    """Its lines. Of more than :data:`FEW` hosts, only those in trouble have lines of their own, and what is to be
    advised of several is said once.
    """
    hosts = list(dict.fromkeys(f.who for f in findings if f.group == VEHICLE))
    short = len(hosts) > FEW
    alike = _alike(findings) if short else {}
    heading, quiet = "", set(hosts)
    for finding in sorted(findings, key=_place):
        if short and finding.group == FLEET:
            short = False
            yield from _several(alike, quiet)
        if short and finding.group == VEHICLE and (finding.level is Level.OK or _matter(finding) in alike):
            continue
        if finding.heading != heading:
            heading = finding.heading
            yield click.style(f"{heading} ({platform.node()})" if heading == HOST else clean(heading), bold=True)
        quiet.discard(finding.who)
        yield from _lines(finding)
    if short:
        yield from _several(alike, quiet)
    yield _sum(findings)


def _several(alike: dict[tuple[str, str], list[Finding]], quiet: set[str]) -> Iterator[str]:
    """What several hosts have in common, and at which of them there is nothing else."""
    yield click.style("several hosts", bold=True)
    for same in alike.values():
        yield from _lines(same[0], f"{same[0].topic} at {few([each.who for each in same])}")
    yield f"  {MARKS[Level.OK]} nothing else at {few(sorted(quiet)) or 'none of them'}  (--json has every line)"


def _place(finding: Finding) -> tuple[int, str]:
    return GROUPS.index(finding.group), finding.who if finding.group == VEHICLE else ""


def _matter(finding: Finding) -> tuple[str, str]:
    return finding.topic, finding.found


def _alike(findings: list[Finding]) -> dict[tuple[str, str], list[Finding]]:
    """Advice that is the same for several hosts."""
    found: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        if finding.group == VEHICLE and finding.level is Level.ADVICE:
            found.setdefault(_matter(finding), []).append(finding)
    return {matter: same for matter, same in found.items() if len(same) > 1}


def _lines(finding: Finding, title: str = "") -> Iterator[str]:
    title = title or clean(finding.topic if finding.group == VEHICLE else finding.subject)
    yield f"  {MARKS[finding.level]} {title}: {clean(finding.found)}"
    if finding.advice:
        yield f"        -> {clean(finding.advice)}"


def _sum(findings: list[Finding]) -> str:
    counts = Counter(finding.level for finding in findings)
    more = f"{counts[Level.OK]} ok" + (f", {counts[Level.ADVICE]} to consider" if counts[Level.ADVICE] else "")
    return f"{counts[Level.RED]} red, {more}" if counts[Level.RED] else f"all is well: {more}"
