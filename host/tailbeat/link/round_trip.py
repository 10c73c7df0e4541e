"""How long a board takes to answer."""

from __future__ import annotations

_FIRST_S, _LEAST_S, _MOST_S = 0.25, 0.08, 2.0
_BACKOFF = 1.5
_PATIENT_FROM = 3  # tries; two that are lost say little about the line


class RoundTrip:
    """How long an answer takes on this link: mean and spread, as TCP keeps them."""

    def __init__(self) -> None:
        self._mean_s = -1.0
        self._spread_s = 0.0

    def heard(self, took_s: float, tries: int = 1) -> None:
        """An answer came so long after the last of so many ``tries``; which of them it answers is
        not known, so that more than one tells something only as long as nothing is known."""
        if self._mean_s < 0:
            self._mean_s, self._spread_s = took_s, took_s / 2
        if tries > 1:
            return
        self._spread_s += (abs(took_s - self._mean_s) - self._spread_s) / 4
        self._mean_s += (took_s - self._mean_s) / 8

    def patience_s(self, tries: int) -> float:
        """How long to wait for the answer to the last of so many ``tries``."""
        wait_s = self._mean_s + 4 * self._spread_s if self._mean_s >= 0 else _FIRST_S
        wait_s = max(wait_s, _LEAST_S)
        for _ in range(_PATIENT_FROM, tries):
            wait_s = min(wait_s * _BACKOFF, max(wait_s, _MOST_S))
        return wait_s
