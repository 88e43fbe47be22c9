"""``zmav signing``: make a key, and give it to an autopilot."""

from __future__ import annotations

import threading
from collections.abc import Callable

import click

from zmav.errors import LinkDown, Refused
from zmav.links import Link, LinkState, open_link
from zmav.mavlink import Frame, Packer, Splitter, load_dialect
from zmav.mavlink.signing import Signing, SigningClock, new_key, read_key, write_key

HEARTBEAT = 0
PATIENCE = 10.0
"""s for the link to open, for an autopilot to be heard, and for signed frames to come back"""


@click.group("signing")
def command() -> None:
    """MAVLink 2 signing: 'zmav signing new quad1.key', 'zmav signing setup --link /dev/ttyACM0 --key quad1.key'."""


@command.command("new")
@click.argument("file")
def new(file: str) -> None:
    """Write a new random key that only you may read."""
    write_key(file, new_key())
    click.echo(f"{file}: a new key; 'zmav signing setup' gives it to an autopilot, 'zmav up --signing-key' uses it")


@command.command("setup")
@click.option("--link", required=True, metavar="URL", help="The autopilot, on a link that nobody can listen to (USB).")
@click.option("--key", "key_file", metavar="FILE", required=True, help="As 'zmav signing new FILE' makes one.")
@click.option("--off", is_flag=True, help="End signing instead; --key is then the key in force.")
def setup(link: str, key_file: str, off: bool) -> None:
    """Give the key to the autopilot on this link, and see that it signs. Nothing else may hold the link meanwhile."""
    key = read_key(key_file)
    with open_link(link) as opened:
        Setup(opened, key).run(off=off)
    click.echo("the autopilot signs no more" if off else "the autopilot has the key, and signs")


class Setup:
    """The exchange on an open link: https://mavlink.io/en/messages/common.html#SETUP_SIGNING."""

    def __init__(self, link: Link, key: bytes) -> None:
        self._link, self._key = link, key
        self._dialect = load_dialect()
        self._splitter = Splitter(self._dialect)
        self._packer = Packer(self._dialect, 255, 190)
        self._clock = SigningClock()
        self._signing = Signing(key, self._dialect, clock=self._clock, unsigned="accept")
        self._news = threading.Condition()
        self._target: tuple[int, int] | None = None
        self._signed = self._plain = 0

    def run(self, *, off: bool) -> None:
        """Raises :class:`LinkDown` where nobody is heard, :class:`Refused` where the key is not taken."""
        self._link.start(self._on_data, lambda state, detail: None)
        if not self._link.wait(LinkState.UP, PATIENCE):
            raise LinkDown(f"{self._link.url}: {self._link.detail}", url=self._link.url)
        if not self._until(lambda: self._target is not None):
            raise LinkDown(f"no autopilot is heard on {self._link.url}", url=self._link.url)
        assert self._target is not None
        system, component = self._target
        key = bytes(len(self._key)) if off else self._key
        fields = {"secret_key": list(key), "initial_timestamp": 0 if off else self._clock.next()}
        data = self._packer.pack("SETUP_SIGNING", target_system=system, target_component=component, **fields)
        data = self._signing.sign(data) if off else data
        for _ in range(2):  # it has no acknowledgement
            self._link.send(data)
        self._signed = self._plain = 0
        if not self._until(lambda: (self._plain if off else self._signed) > 1):
            raise Refused(
                f"what comes from system {system} is {'still' if off else 'not'} signed with this key: "
                "an autopilot takes it only while disarmed, and over USB or a link it trusts",
                vehicle=str(system),
            )

    def _until(self, true: Callable[[], bool]) -> bool:
        with self._news:
            return self._news.wait_for(true, PATIENCE)

    def _on_data(self, data: bytes) -> None:
        with self._news:
            for frame in self._splitter.feed(data):
                self._look_at(frame)
            self._news.notify_all()

    def _look_at(self, frame: Frame) -> None:
        if frame.msgid == HEARTBEAT and frame.compid == 1 and self._target is None:
            self._target = (frame.sysid, frame.compid)
        if self._target == (frame.sysid, frame.compid):
            if frame.signed:
                self._signed += self._signing.accepts(frame)
            else:
                self._plain += 1
