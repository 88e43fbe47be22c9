"""What it costs to send over a link: one number by which links are compared, less is better."""

from __future__ import annotations

from zmav.wire import NeighbourQuality

UNUSABLE = 65_535
"""of a link that is down or lets nothing through; the most that Zenoh's weights can say, too"""
UNIT = 1e-5
SENDING = 1e-3
"""s that a kilobyte takes beside the way: of a radio of 10 Mbit/s"""


def cost(quality: NeighbourQuality) -> int:
    """Expected time to bring a kilobyte over the link, repeats included, in units of 10 µs: 1 to ``UNUSABLE``.

    As the airtime metric of IEEE 802.11-2016, 14.9, it is a time divided by the share that arrives, there and back, as
    in ETX (De Couto et al. 2003); the time is half the least round trip, which grows as a radio slows. What is not
    known is taken for good.
    """
    if quality.state in ("down", "silent"):
        return UNUSABLE
    delivered = (1.0 - (quality.loss_in or 0.0)) * (1.0 - (quality.loss_out or 0.0))
    if delivered <= 0.0:
        return UNUSABLE
    seconds = (quality.rtt_min or 0.0) / 2 + SENDING
    return max(1, min(round(seconds / delivered / UNIT), UNUSABLE))
