"""The waits of a trial: with a simulated board of this process, C speaks between the events.

Any other line (a serial port, a signed or a bad one, a camera with pictures) is waited for by
``Link.idle`` and served by ``TrialCamera``, which send the same bytes at the same times.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.core.native import ffi
from tailbeat.link.mavlink import message_id
from tailbeat.sensors.camera.render.source import frame_of
from tailbeat.session.trial_camera import TrialCamera
from tailbeat.sim.board import SimBoard, SimTransport

SILENCE_S = 3.0  # of board time, after which the link counts as lost
_BLIND_S = 0.1  # of board time without a picture, from which on TrialCamera watches


class TrialWire:
    """Waits once, or, with a simulated board, over and over, sending the speed of every picture
    (host/native/trial_wire.h), until a message comes that somebody listens to.

    ``guarded``: a guard looks at every picture; ``abort_wanted``: a stop is to be sent.
    """

    def __init__(
        self,
        fish: Fish,
        camera: TrialCamera | None,
        guarded: bool,
        abort_wanted: Callable[[], bool],
    ) -> None:
        self._fish, self._link, self._abort_wanted = fish, fish.link, abort_wanted
        self._speaker: _Speaker | None = None
        line = simulated_line(fish)
        if camera is not None and line is not None and camera.sees(line[0]):
            self._speaker = _Speaker(fish, *line, camera, guarded)

    def idle(self, wait_s: float, until_s: float) -> None:
        """Waits ``wait_s``, or over and over until the first wake from ``until_s`` on."""
        speaker = self._speaker
        if speaker is None or not speaker.can_speak:
            self._link.idle(wait_s)
            return
        speaker.enter(wait_s, min(until_s, self._fish.clock.next_s))
        try:
            while speaker.shows() and not self._abort_wanted():
                pass
        finally:
            speaker.leave()


def simulated_line(fish: Fish) -> tuple[SimBoard, int] | None:
    """The board, and its port, behind a line that nothing stands in front of; None for others."""
    transport = fish.transport
    if type(transport) is SimTransport and type(transport.board) is SimBoard:
        return transport.board, transport.port
    return None


class _Speaker:
    """A trial_wire_t between ``enter`` and ``leave``, which carry over what C keeps meanwhile."""

    def __init__(
        self, fish: Fish, board: SimBoard, port: int, camera: TrialCamera, guarded: bool
    ) -> None:
        link = fish.link
        self._fish, self._link, self._board, self._camera = fish, link, board, camera
        self._kinds: frozenset[str] | None = frozenset()
        wire = self._wire = ffi.new("trial_wire_t *")
        wire.port = port
        wire.system, wire.component = link.mav.srcSystem, link.mav.srcComponent
        wire.fit = camera.fit.native
        wire.along_x, wire.along_y = camera.along
        wire.shows_pictures = guarded

    @property
    def can_speak(self) -> bool:
        """Nothing is signed or to be said of the camera."""
        return not self._link.signing.signs and self._camera.plain

    def shows(self) -> bool:
        """Lets time pass; whether the guard was shown a picture, and may be shown the next."""
        picture = self._board.converse(self._wire)
        if picture is None:
            return False
        self._camera.look(frame_of(picture))
        return self._camera.plain

    def enter(self, wait_s: float, until_s: float) -> None:
        """C speaks from now on."""
        wire, link, clock = self._wire, self._link, self._fish.clock
        if link.wanted != self._kinds:
            self._want(link.wanted)
        at = clock.reading
        wire.host_s, wire.board_s, wire.rate = at.host_s, at.board_s, clock.rate
        wire.wait_s, wire.leave_s = wait_s, until_s
        wire.silence_s, wire.blind_s = SILENCE_S / clock.rate, _BLIND_S / clock.rate
        wire.heartbeat_period_s = link.heartbeat_period_s
        wire.last_heartbeat_s, wire.last_heard_s = link.last_heartbeat_s, link.last_heard_s
        wire.last_picture_s = self._camera.seen_at_s
        wire.sequence = link.mav.seq
        if begun := link.framer.pull():
            ffi.memmove(wire.bytes, begun, len(begun))
            wire.received = len(begun)

    def leave(self) -> None:
        """What has come is taken in, but for the pictures, which are the camera's now."""
        wire, link = self._wire, self._link
        link.mav.seq, link.last_heartbeat_s = wire.sequence, wire.last_heartbeat_s
        link.last_heard_s, self._camera.seen_at_s = wire.last_heard_s, wire.last_picture_s
        self._board.take_pictures_of(wire)
        if wire.received:
            data = bytes(ffi.buffer(wire.bytes, wire.received))
            wire.received = 0
            link.take(data, self._board.time_s)

    def _want(self, kinds: frozenset[str] | None) -> None:
        self._kinds = kinds
        numbers = [message_id(kind) for kind in kinds or ()]
        self._numbers: Any = ffi.new("uint32_t[]", numbers or 1)
        wire = self._wire
        wire.wanted, wire.wanted_count, wire.wants_all = self._numbers, len(numbers), kinds is None
