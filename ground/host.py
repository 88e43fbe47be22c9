"""The name of the host that a ground program runs on."""

from __future__ import annotations

from zmav import keys
from zmav.client import Client
from zmav.errors import BadConfig


def host_name(z: Client, asked: str, otherwise: str = "ground") -> str:
    """As asked for, else the credentials', else ``otherwise``. Raises :class:`~zmav.errors.BadKey`, and
    :class:`~zmav.errors.BadConfig` for another name than the credentials': everybody would refuse what we say.
    """
    own = z.member.credentials.name if z.member is not None else ""
    if own and asked not in ("", own):
        raise BadConfig(f"by your credentials this host is {own}", field="name", value=asked, expected=own)
    return keys.check_name(asked or own or otherwise)
