"""Says ahead that our own certificate ends: every day of its last month, every hour of its last two days."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from zmav.trust.certificate import Certificate, utc

HOUR, DAY = 3600.0, 86_400.0
SOON = 30 * DAY
"""s before its end that a certificate is to be renewed"""


async def warn_of_end(certificate: Certificate, say: Callable[[str], None]) -> None:
    """Runs until it is cancelled."""
    while True:
        left = certificate.not_after - time.time()
        if left <= SOON:
            say(_words(certificate, left))
        await asyncio.sleep(DAY if left > 2 * DAY or left <= 0 else min(left + 1.0, HOUR))


def _words(certificate: Certificate, left: float) -> str:
    if left <= 0:
        text = "no new link opens, a link that is lost does not come back, and members believe us for a day at most"
        return f"the certificate of {certificate.name} ended {utc(certificate.not_after)}: {text}; renew it"
    span = f"{left / DAY:.0f} days" if left > 2 * DAY else f"{left / HOUR:.1f} hours"
    text = "renew it where the authority is (zmav mesh ca renew) and start again with it"
    return f"the certificate of {certificate.name} ends {utc(certificate.not_after)}, in {span}: {text}"
