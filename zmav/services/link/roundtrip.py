"""How long an answer takes on the local link, for who asks again when it does not come."""

from __future__ import annotations


class RoundTrip:
    """How many seconds to wait for an answer before it counts as lost, as in RFC 6298."""

    def __init__(self, first: float = 1.0, least: float = 0.25, most: float = 8.0) -> None:
        self._least, self._most = least, most
        self._mean: float | None = None
        self._deviation = 0.0
        self.timeout = first
        """seconds"""

    def sample(self, took: float) -> None:
        """An answer came after so long, to a question that was put once."""
        if self._mean is None:
            self._mean, self._deviation = took, took / 2
        else:
            self._deviation += (abs(took - self._mean) - self._deviation) / 4
            self._mean += (took - self._mean) / 8
        self.timeout = min(max(self._mean + 4 * self._deviation, 2 * self._mean, self._least), self._most)

    def late(self) -> None:
        """Nothing at all came within the timeout: it is the link that is slow."""
        self.timeout = min(2 * self.timeout, self._most)
