"""The link breaks while a trial is executed: getting it back."""

from __future__ import annotations

import time
from dataclasses import astuple

from tailbeat.board.fish import Fish
from tailbeat.core.errors import ConnectError, LinkLostError, TailbeatError
from tailbeat.link.messages import BoardStatus

_RETRY_S, _RETRY_MAX_S = 0.5, 5.0
_REJECTED_MAX = 6  # in one attempt; a board sends two a second, a stray one proves nothing


def restore_link(fish: Fish, number: int, patience_s: float) -> BoardStatus:
    """Reopen the transport until the board answers; its state then.

    Parameters
    ----------
    number : int
        Of the trial, for the messages.
    patience_s : float
        How long it is tried, s of the transport's clock.

    Raises
    ------
    LinkLostError
        The board does not answer, or its messages are rejected.
    """
    link = fish.link
    deadline_s = link.transport.now_s() + patience_s
    retry_s = _RETRY_S
    while link.transport.now_s() < deadline_s:
        before = _rejected_frames(fish)
        try:
            link.reopen()
            status = BoardStatus.of(link.request("TAILBEAT_STATUS"))
            fish.clock.sync()
            return status
        except (ConnectError, LinkLostError):
            if _rejected_frames(fish) - before >= _REJECTED_MAX:
                raise LinkLostError(
                    f"trial {number} continues without this program, because the board's"
                    f" messages are rejected: {link.signing.why_silent()}",
                    "The board stops by itself; look with 'tailbeat board key status' what is"
                    " there, and connect again.",
                ) from None
            _pause(fish, min(retry_s, max(0.0, deadline_s - link.transport.now_s())))
            retry_s = min(2 * retry_s, _RETRY_MAX_S)
    why = link.signing.why_silent()
    raise LinkLostError(
        f"the link broke during trial {number} and did not come back in {patience_s:.0f} s"
        + (f": {why}" if why else ""),
        "The board stops by itself and keeps what was executed. Move closer to the fish, look"
        " with 'tailbeat info', then run the same command again.",
    )


def _rejected_frames(fish: Fish) -> int:
    """Frames since the last one of the board's that was believed."""
    return sum(astuple(fish.link.signing.refused))


def _pause(fish: Fish, duration_s: float) -> None:
    try:
        fish.link.transport.wait(duration_s)
    except TailbeatError:
        time.sleep(duration_s)
