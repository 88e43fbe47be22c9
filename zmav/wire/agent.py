"""What is asked of an agent (``agent/{agent}/do/{verb}``) whatever it does."""

from __future__ import annotations

from zmav.wire.base import Told
from zmav.wire.orders import Order


class SetTunable(Order, kw_only=True):
    """Change one of an agent's parameters while it runs."""

    name: str
    value: float


class Signals(Told, kw_only=True):
    """What an agent streams on ``agent/{agent}/out/{topic}``: numbers of one moment by their names."""

    t: float
    """UTC seconds"""
    values: dict[str, float]


class TunableInfo(Told, kw_only=True):
    """One parameter of an agent: its value now, and what it may be."""

    value: float
    default: float
    low: float
    high: float
    unit: str = ""
    doc: str = ""
