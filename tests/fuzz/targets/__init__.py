"""What is fuzzed: everything that takes bytes from outside, by name."""

from __future__ import annotations

from tests.fuzz.engine import Target
from tests.fuzz.targets import datagrams, files, frames, live, payloads, ros2, trust

MODULES = (frames, datagrams, files, payloads, trust, ros2, live)
TARGETS: dict[str, Target] = {target.name: target for module in MODULES for target in module.TARGETS}
