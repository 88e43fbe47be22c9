"""``zmav sim pilot``: the hands of a vehicle's simulated pilot."""

from __future__ import annotations

import click

from zmav.cli.sim.talk import control_option, remote
from zmav.errors import BadInput


@click.command("pilot")
@click.argument("vehicle")
@click.argument("channels", nargs=-1, metavar="[CHANNEL=PWM]...")
@click.option("--mode", help="What the mode switch is turned to: one of the modes on it.")
@control_option
def pilot(vehicle: str, channels: tuple[str, ...], mode: str | None, control: str | None) -> None:
    """Turn the pilot's switches: 'zmav sim pilot hex1 7=1900', 'zmav sim pilot quad1 --mode LOITER'.

    Channels (1 to 8) are pulse widths in us. Where nothing is said, a PX4's radio is off: the first use turns it on.
    """
    set_to = dict(map(_channel, channels))
    if not set_to and mode is None:
        expected = "--mode MODE or CHANNEL=PWM"
        raise BadInput(f"what does the pilot do? {expected}", field="channels", value=None, expected=expected)
    with remote(control) as sim:
        sim.pilot(vehicle, mode, set_to)


def _channel(text: str) -> tuple[int, int]:
    number, _, pwm = text.partition("=")
    try:
        return int(number), int(pwm)
    except ValueError:
        expected = "CHANNEL=PWM, as in 7=1900"
        raise BadInput(f"{text!r}; expected {expected}", field="channels", value=text, expected=expected) from None
