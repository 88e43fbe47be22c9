"""The tree of errors.

Everything zmav raises on purpose is a :class:`ZmavError`. Each class has a stable ``code``, which is also what crosses
the wire in an error reply, so that a refusal on a vehicle becomes the same exception in the caller's process.

    ZmavError
    ├── BadInput            what was given is wrong: the field, the value, what was expected
    │   ├── BadUrl          a link or endpoint URL
    │   ├── BadKey          a key or key expression
    │   ├── BadMessage      a MAVLink message's name or fields, or a frame that is not one
    │   └── BadConfig       a fleet file or an option
    ├── LinkError           a transport to an autopilot
    │   ├── LinkDown        nothing to send on at present; the link keeps trying by itself
    │   └── PortInUse       another program holds the port
    ├── SessionError        no Zenoh session, or no router at the other end
    └── VehicleError        a vehicle did not do what was asked
        ├── NoSuchVehicle   nobody by that name is present
        ├── Stale           it is known, but was last heard of too long ago
        ├── Refused         the autopilot (or the vehicle's own rules) said no, with its reason
        ├── TimedOut        no answer, or the answer did not come true in time
        ├── Clash           two vehicles share a name or a system id; nobody may command them
        ├── Forbidden       it did not come from who may ask for it: no proof of origin, or not with that role
        ├── NotHolder       another agent holds the vehicle's lease
        └── Unsupported     this autopilot or vehicle type cannot do it
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Iterable
from typing import Any, ClassVar, TypeVar

B = TypeVar("B", bound="BadInput")


class ZmavError(Exception):
    """Base of every error zmav raises on purpose; ``str()`` of it says what happened and what to do."""

    code: ClassVar[str] = "error"

    def __init__(self, message: str, /, **detail: Any) -> None:
        super().__init__(message)
        self.message = message
        self.detail = detail


class BadInput(ZmavError):
    """Something given to zmav is wrong; ``detail`` names ``field``, ``value`` and ``expected`` where they are known."""

    code = "bad_input"

    @classmethod
    def wrong(cls: type[B], field: str, value: object, expected: str, what: str = "") -> B:
        """The error for a field that has a value which it cannot have; ``expected`` says which it can, ``what`` what is
        wrong where that is more than the field and its value.
        """
        text = f"{what or f'{field} is {value}'}; expected {expected}"
        return cls(text, field=field, value=value, expected=expected)


class BadUrl(BadInput):
    code = "bad_url"


class BadKey(BadInput):
    code = "bad_key"


class BadMessage(BadInput):
    """A MAVLink message that cannot be built or read; ``detail["fields"]`` maps every bad field to what is wrong."""

    code = "bad_message"


class BadConfig(BadInput):
    code = "bad_config"


class LinkError(ZmavError):
    code = "link"


class LinkDown(LinkError):
    code = "link_down"


class PortInUse(LinkError):
    code = "port_in_use"


class SessionError(ZmavError):
    code = "session"


class VehicleError(ZmavError):
    code = "vehicle"


class NoSuchVehicle(VehicleError):
    code = "no_such_vehicle"


class Stale(VehicleError):
    code = "stale"


class Refused(VehicleError):
    """The autopilot or the vehicle's own rules said no; ``detail["reasons"]`` holds the autopilot's words."""

    code = "refused"


class TimedOut(VehicleError):
    code = "timed_out"


class Clash(VehicleError):
    code = "clash"


class Forbidden(VehicleError):
    """The vehicle does not believe where it came from, or that one may not do it; see :mod:`zmav.trust`."""

    code = "forbidden"


class NotHolder(VehicleError):
    code = "not_holder"


class Unsupported(VehicleError):
    code = "unsupported"


def _tree(cls: type[ZmavError]) -> dict[str, type[ZmavError]]:
    found = {cls.code: cls} if "code" in cls.__dict__ else {}  # a module's own kind of an error has its parent's code
    for sub in cls.__subclasses__():
        found.update(_tree(sub))
    return found


def from_code(code: str, message: str, detail: dict[str, Any] | None = None) -> ZmavError:
    """The error of that ``code``; an unknown code (a newer peer) gives a plain :class:`ZmavError`."""
    return _tree(ZmavError).get(code, ZmavError)(message, **(detail or {}))


def missing_extra(what: str, package: str | None, extra: str) -> BadConfig:
    """What to say where ``what`` needs a package that an extra of zmav brings."""
    made = f", or in a clone 'make {extra}'" if extra in ("planner", "vision") else ""
    text = f"{what} needs {package}: pip install 'zmav[{extra}]'{made}"
    return BadConfig(text, field="installation", value=package, expected=f"zmav[{extra}]")


def needs(what: str, extra: str, *modules: str) -> None:
    """Raise :class:`BadConfig` where one of the modules that an extra of zmav brings for ``what`` is not there."""
    for module in modules:
        try:
            importlib.import_module(module)
        except ImportError as e:
            raise missing_extra(what, e.name, extra) from e


def did_you_mean(given: str, known: Iterable[str], n: int = 3, cutoff: float = 0.6) -> str:
    """Words for the end of an error's text: those that are like what was given; empty: none is."""
    close = difflib.get_close_matches(given, known, n, cutoff)
    return f"; did you mean {', '.join(close)}?" if close else ""
