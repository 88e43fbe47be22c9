"""PX4's time stamps: since its own boot."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zmav.sim.protocol.px4.node import Px4Node


def boot_ms(node: Px4Node) -> int:
    return int(node.copter.uptime * 1000.0)


def boot_us(node: Px4Node) -> int:
    return int(node.copter.uptime * 1e6)
