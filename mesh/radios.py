"""A host's radios as they stand: which interface, which address, which network, and whether they are there yet."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import ifaddr
import msgspec

from zmav.config import Address, Radio
from zmav.errors import BadConfig

Interfaces = Mapping[str, Sequence[Address]]
"""the addresses of each network interface, by its name"""


def interfaces() -> dict[str, list[Address]]:
    """This computer's network interfaces, those without an address included.

    IPv6 addresses that are good on one link only are left out: an endpoint cannot say which link.
    """
    found: dict[str, list[Address]] = {}
    for adapter in ifaddr.get_adapters(include_unconfigured=True):
        addresses = found.setdefault(adapter.name, [])
        for ip in adapter.ips:
            text = ip.ip if isinstance(ip.ip, str) else ip.ip[0]
            address = ipaddress.ip_interface(f"{text}/{ip.network_prefix}")
            if address.version == 4 or not address.is_link_local:
                addresses.append(address)
    return found


@dataclass(frozen=True, eq=False)
class FoundRadio:
    """One radio and what was found of it."""

    radio: Radio
    """as in the fleet file, with the interface and the plain address where they are known"""
    address: Address | None
    """None: its interface has none yet"""
    present: bool
    """the interface is there and has the address"""
    fixed: bool = False
    """the fleet file says the address"""

    @property
    def name(self) -> str:
        """What to call it: by its interface, or by its address."""
        return self.radio.interface or str(self.radio.address)


def stand(radio: Radio, there: Interfaces) -> FoundRadio:
    """What there is of a radio on a host with those interfaces.

    Raises :class:`BadConfig` where the interface that has the radio's address is another than the file says.
    """
    wanted = radio.ip()
    if wanted is None:
        assert radio.interface is not None  # the fleet file was checked
        addresses = sorted(there.get(radio.interface, ()), key=lambda a: a.version)
        return _standing(radio, addresses[0] if addresses else None, present=bool(addresses), fixed=False)
    if wanted.ip.is_loopback:  # all of 127.0.0.0/8 is there, whatever the interface is said to have
        return _standing(radio, wanted, present=True, fixed=True)
    for interface, here in there.items():
        for address in here:
            if address.ip != wanted.ip:
                continue
            if radio.interface not in (None, interface):
                text = f"{wanted.ip} is the address of {interface} here; the fleet file has it on {radio.interface}"
                raise BadConfig(text, field="interface", value=radio.interface, expected=interface)
            named = msgspec.structs.replace(radio, interface=interface)
            # Where the file does not say how large the network is, the interface knows.
            return _standing(named, wanted if "/" in (radio.address or "") else address, present=True, fixed=True)
    return _standing(radio, wanted, present=False, fixed=True)


def _standing(radio: Radio, address: Address | None, *, present: bool, fixed: bool) -> FoundRadio:
    plain = msgspec.structs.replace(radio, address=str(address.ip)) if address else radio
    return FoundRadio(plain, address, present, fixed)
