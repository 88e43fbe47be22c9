"""What it costs to send over a link: one number by which ways are compared, less is better."""

from __future__ import annotations

from zmav.wire import NeighbourQuality

TEST_BYTES = 1024
"""the frame that IEEE 802.11s reckons with: 8192 bits"""
GUESSED_RATE = 1e6
"""bytes/s taken where nothing was measured"""
UNUSABLE = 65_535
"""of a link that is down or lets nothing through; the most that Zenoh's weights can say, too"""
UNIT = 1e-5


def cost(quality: NeighbourQuality) -> int:
    """Expected time to bring a kilobyte over the link, repeats included, in units of 10 µs: 1 to ``UNUSABLE``.

    It is the airtime metric of IEEE 802.11-2016, 14.9, ``(overhead + bits / rate) / (1 - error rate)``, with half the
    least round trip for the overhead, the slower direction's throughput for the rate, and delivery there and back for
    the error rate, as ETX and ETT have it (De Couto et al. 2003; Draves, Padhye and Zill 2004). What is not known is
    taken for good. A fast clean Ethernet costs about 30, Wi-Fi 100 to 500, LTE 3000, 1 kB/s of serial radio the most.
    """
    if quality.state in ("down", "silent"):
        return UNUSABLE
    delivered = (1.0 - (quality.loss_in or 0.0)) * (1.0 - (quality.loss_out or 0.0))
    if delivered <= 0.0:
        return UNUSABLE
    rates = [rate for rate in (quality.throughput_in, quality.throughput_out) if rate]
    seconds = (quality.rtt_min or 0.0) / 2 + TEST_BYTES / min(rates, default=GUESSED_RATE)
    return max(1, min(round(seconds / delivered / UNIT), UNUSABLE))
