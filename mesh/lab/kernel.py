"""What the lab asks of the Linux kernel: namespaces, TAP interfaces and a timer, by system calls and ioctls.

There is no word of it in Python's library, and the programs ``ip`` and ``tc`` are not everywhere. Numbers are those of
``linux/sched.h``, ``linux/if_tun.h``, ``linux/sockios.h`` and ``linux/prctl.h``. All raise :class:`OSError`.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import socket
import struct
from pathlib import Path

CLONE_NEWPID = 0x2000_0000
CLONE_NEWNET = 0x4000_0000
TUN = "/dev/net/tun"
RIGHTS = {"CAP_NET_ADMIN": 12, "CAP_SYS_ADMIN": 21}
"""what all of this needs of ``linux/capability.h``: in a container root may lack them"""
LONGEST_NAME = 15

_TUNSETIFF, _IFF_TAP, _IFF_NO_PI = 0x4004_54CA, 0x0002, 0x1000
_SIOCGIFFLAGS, _SIOCSIFFLAGS = 0x8913, 0x8914
_SIOCSIFADDR, _SIOCSIFNETMASK, _SIOCSIFMTU, _SIOCSIFHWADDR = 0x8916, 0x891C, 0x8922, 0x8924
_SIOCSIFTXQLEN = 0x8943
_IFF_UP, _ARPHRD_ETHER = 0x1, 1
_PR_SET_PDEATHSIG = 1
_TFD_FLAGS, _TFD_TIMER_ABSTIME = os.O_NONBLOCK | os.O_CLOEXEC, 1
_CLOCK_MONOTONIC = 1
_ETHERNET_HEADER = 14
_QUEUE = 4096
"""frames that may wait for the reader of a TAP: what the kernel drops there, nobody counts"""


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result


def unshare(flags: int) -> None:
    """Give this thread new namespaces; with :data:`CLONE_NEWPID` its children, and the process must have one thread."""
    _checked(_libc().unshare(flags))


def setns(fd: int, kind: int) -> None:
    """Have this thread enter the namespace ``fd`` (for a PID namespace: its children)."""
    _checked(_libc().setns(fd, kind))


def die_with_parent(signal_number: int) -> None:
    """Get that signal when the thread that made this process ends."""
    _checked(_libc().prctl(_PR_SET_PDEATHSIG, signal_number, 0, 0, 0))


def lacking() -> list[str]:
    """Those of :data:`RIGHTS` that this process has not."""
    (line,) = (each for each in Path("/proc/self/status").read_text().splitlines() if each.startswith("CapEff:"))
    return [name for name, bit in RIGHTS.items() if not int(line.split()[1], 16) >> bit & 1]


def network_of_this_thread() -> int:
    """A descriptor of the thread's network namespace."""
    return os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)


class Timer:
    """A descriptor that is readable from a moment of :func:`time.monotonic` on: ``epoll`` alone waits in whole ms."""

    def __init__(self) -> None:
        libc = _libc()
        self.fd = _checked(libc.timerfd_create(_CLOCK_MONOTONIC, _TFD_FLAGS))
        self._settime = libc.timerfd_settime
        self._value = (ctypes.c_long * 4)()

    def arm(self, at: float) -> None:
        """Be unreadable until ``at``, and readable from then on."""
        self._value[2] = seconds = int(at)
        self._value[3] = max(1, int((at - seconds) * 1e9))  # all zero would disarm it
        _checked(self._settime(self.fd, _TFD_TIMER_ABSTIME, self._value, None))

    def disarm(self) -> None:
        """Be unreadable."""
        self._value[2] = self._value[3] = 0
        _checked(self._settime(self.fd, _TFD_TIMER_ABSTIME, self._value, None))

    def close(self) -> None:
        os.close(self.fd)


def open_tap(name: str, *, mac: bytes, address: str, prefix: int, mtu: int) -> int:
    """Make a TAP interface in this thread's namespace and bring it up; it is there as long as the descriptor is open.

    Each read of the non-blocking descriptor gives one Ethernet frame that the namespace sends, each write is one that
    it receives.
    """
    fd = os.open(TUN, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.ioctl(fd, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TAP | _IFF_NO_PI))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            _configure(s, name, _SIOCSIFHWADDR, struct.pack("H14s", _ARPHRD_ETHER, mac))
            _configure(s, name, _SIOCSIFMTU, struct.pack("i", mtu))
            _configure(s, name, _SIOCSIFTXQLEN, struct.pack("i", _QUEUE))
            _configure(s, name, _SIOCSIFADDR, _address(address))
            _configure(s, name, _SIOCSIFNETMASK, _address(_mask(prefix)))
        bring_up(name)
    except OSError:
        os.close(fd)
        raise
    return fd


def largest_frame(mtu: int) -> int:
    """Bytes of the largest frame of an interface with that MTU, a VLAN tag included."""
    return mtu + _ETHERNET_HEADER + 4


def bring_up(name: str) -> None:
    """Set an interface of this thread's namespace up."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        found = fcntl.ioctl(s, _SIOCGIFFLAGS, struct.pack("16sH22x", name.encode(), 0))
        (flags,) = struct.unpack_from("H", found, 16)
        _configure(s, name, _SIOCSIFFLAGS, struct.pack("H", flags | _IFF_UP))


def without_ipv6() -> None:
    """No IPv6 in this thread's namespace: nobody asked for its announcements on every interface."""
    with contextlib.suppress(OSError):  # a kernel without IPv6, or a /proc that is read-only
        Path("/proc/sys/net/ipv6/conf/all/disable_ipv6").write_text("1", encoding="ascii")


def _configure(s: socket.socket, name: str, request: int, value: bytes) -> None:
    fcntl.ioctl(s, request, struct.pack("16s24s", name.encode(), value))


def _address(text: str) -> bytes:
    return struct.pack("HH4s", socket.AF_INET, 0, socket.inet_aton(text))


def _mask(prefix: int) -> str:
    return socket.inet_ntoa(struct.pack("!I", (0xFFFF_FFFF << (32 - prefix)) & 0xFFFF_FFFF))
