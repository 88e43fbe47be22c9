"""Payload types: what travels as JSON under the keys.

Rules of the wire: of orders, setpoints, goals and obstacles unknown fields are refused, so that a misspelt one, or one
of a newer version, is an error and not a silence; of what only says how something is (:class:`Told`) they are left out.
SI units; radians, and degrees only where a name ends in ``_deg``; latitude and longitude are WGS84; ``alt_amsl`` is
metres above mean sea level and ``alt_rel`` metres above home; local vectors are north, east, down (NED) about the
fleet's declared origin. ``t`` is UTC in seconds at the source.
"""

# ruff: noqa: F403 (what its files define, and no list of it beside them)

from __future__ import annotations

from zmav.wire import swarm as swarm
from zmav.wire.agent import *
from zmav.wire.base import *
from zmav.wire.bench import *
from zmav.wire.files import *
from zmav.wire.history import *
from zmav.wire.host import *
from zmav.wire.link import *
from zmav.wire.mission import *
from zmav.wire.orders import *
from zmav.wire.param import *
from zmav.wire.rates import *
from zmav.wire.setpoint import *
from zmav.wire.state import *
from zmav.wire.terrain import *
from zmav.wire.traffic import *
from zmav.wire.vision import *
