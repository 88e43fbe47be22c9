"""Prometheus' text format 0.0.4: a family a measurement, with its help, its type and its samples.

https://prometheus.io/docs/instrumenting/exposition_formats/
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
Kind = Literal["gauge", "counter"]


class Exposition:
    """Families in the order in which they were first added, each sample of one beside its others."""

    def __init__(self) -> None:
        self._heads: dict[str, str] = {}
        self._lines: dict[str, list[str]] = {}

    def add(self, name: str, kind: Kind, doc: str, value: float | None, /, **labels: str | None) -> None:
        """One sample; None is no sample. A label that is None is left empty."""
        if name not in self._heads:
            self._heads[name] = f"# HELP {name} {_escape(doc)}\n# TYPE {name} {kind}\n"
            self._lines[name] = []
        if value is None:
            return
        inside = ",".join(f'{label}="{_quoted(text or "")}"' for label, text in labels.items())
        self._lines[name].append(f"{name}{{{inside}}} {_number(value)}\n" if inside else f"{name} {_number(value)}\n")

    def text(self) -> str:
        return "".join(self._parts())

    def _parts(self) -> Iterator[str]:
        for name, head in self._heads.items():
            yield head
            yield from self._lines[name]


def _number(value: float) -> str:
    if math.isfinite(value):
        return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(float(value))
    return "NaN" if math.isnan(value) else ("+Inf" if value > 0 else "-Inf")


def _escape(text: str) -> str:
    return text.replace("\\", "\\\\").replace("\n", "\\n")


def _quoted(text: str) -> str:
    return _escape(text).replace('"', '\\"')
