"""One trial from arming to its end: speeds go up while beats come down."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import LinkLostError, Refused, TailbeatError
from tailbeat.core.faults import ERASING, NOT_STILL, STALE_COMMAND
from tailbeat.core.speed_source import Camera, SpeedSource, TrackReset, Unseen, source_info
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import BOARD_COMPONENT, BOARD_SYSTEM, Message, text_of
from tailbeat.link.messages import BeatEvent, BoardStatus, TrialOutcome
from tailbeat.session.events import (
    BoardText,
    HoldRequest,
    InterruptRequested,
    LinkLost,
    LinkRestored,
    OnEvent,
    TrialEnded,
    TrialStarted,
    TrialStopped,
    TrialWarning,
)
from tailbeat.session.guards import Guard
from tailbeat.session.link_recovery import restore_link
from tailbeat.session.outcome import StopKind, StopReason, end_of
from tailbeat.session.trial_camera import TrialCamera, camera_of
from tailbeat.session.trial_wire import SILENCE_S, TrialWire

_HEARD = ("TAILBEAT_STATUS", "TAILBEAT_BEAT", "STATUSTEXT")
_POLL_S = 0.02  # of board time; a camera behind another socket does not end a wait
_SETTLE_MARGIN_S = 2.0
_LOOK_S = 0.5
_STALL_S = 60.0  # of board time without a new beat or state; no beat and no settling is longer
_HEARTBEAT_S = 0.3  # of board time; many of them may be lost before the board stops the tail
_REST_WAIT_S = 30.0  # of board time: the board waits so long for the fish to rest after the trial
_STILL_WAIT_S = 60.0  # of board time, for somebody to hold the fish still before the start
_ERASE_WAIT_S = 300.0  # of board time: 143 blocks of 64 KiB at the longest 2 s
_START_WAIT_S = {NOT_STILL: _STILL_WAIT_S, ERASING: _ERASE_WAIT_S}


@dataclass
class _Run:
    """State of one call of run_trial."""

    fish: Fish
    emit: OnEvent
    guard: Guard | None
    reconnect_s: float
    settle_s: float = 3.0
    source: SpeedSource = field(default_factory=lambda: source_info(0))
    camera: TrialCamera | None = None
    wire: TrialWire = field(init=False)
    told: set[str] = field(default_factory=set)
    number: int = 0
    iteration: int = 0
    beats: dict[int, BeatEvent] = field(default_factory=dict)
    status: BoardStatus | None = None
    stopped_at_s: float | None = None
    abort_reason: StopReason | None = None
    abort_wanted: bool = False
    progress: tuple[str, int] | None = None
    progress_at_s: float = 0.0
    interrupted: bool = False
    may_swim: bool = False
    restarted: bool = False
    direction_rad: float = 0.0
    name: str = ""


def run_trial(
    fish: Fish,
    camera: Camera | None = None,
    on_event: OnEvent | None = None,
    guard: Guard | None = None,
    reconnect_s: float = 60.0,
    direction_rad: float = 0.0,
    run_name: str = "",
) -> TrialOutcome:
    """Execute the next trial; return when the board has stopped and the trial is stored.

    Arms the board if needed. When the camera sees what makes no sense (two fish), the trial is
    aborted and that is raised at the end. Whatever else is raised stops the tail first. Ctrl-C
    aborts, waits for the stop and returns (``interrupted``); a second one ends the waiting.

    Parameters
    ----------
    fish : Fish
        The connected board, idle or armed, with a reference.
    camera : Camera, optional
        Gives positions; its speeds go to the board as they come. Default: that of a simulated
        board, if it is one. The caller closes it.
    on_event : callable, optional
        Gets every event (``session.events``) in this thread; must return at once.
    guard : callable, optional
        Sees every frame and beat, how time passes without a frame
        (``core.speed_source.Unseen``), the begin of a track and the end of the camera, until the
        last beat; it aborts the trial by returning a ``StopReason``; one of kind WALL leaves the
        last beats unmeasured.
    reconnect_s : float
        How long a broken link is tried again, s of the transport's clock.
    direction_rad : float
        Direction of the fish at its start in the tank's frame, rad; 0 = along x.
    run_name : str
        Of a run to trim or to measure the fish, for ``TrialStarted``.

    Returns
    -------
    TrialOutcome
        How it ended, with the beats as they were reported.

    Raises
    ------
    Refused
        The board does not arm or start: a pending trial, no reference, a low battery, ...
    LinkLostError
        The link broke and stayed so; the board stops by its own rules.
    """
    run = _Run(fish, on_event or (lambda _: None), guard, reconnect_s)
    run.direction_rad, run.name = direction_rad, run_name
    with camera_of(fish, camera) as used:
        return _execute(run, used)


def _execute(run: _Run, camera: Camera | None) -> TrialOutcome:
    fish = run.fish
    stop_listening = fish.link.subscribe(lambda message: _hear(run, message), _HEARD)
    heartbeat_period_s = fish.link.heartbeat_period_s
    fish.link.heartbeat_period_s = _HEARTBEAT_S
    try:
        _prepare(run, camera)
        _start(run)
        while not _is_over(run):
            try:
                _step(run)
            except KeyboardInterrupt:
                _interrupt(run)
        run.may_swim = False
        outcome = _outcome(run)
        if run.camera is not None and run.camera.failure is not None:
            raise run.camera.failure
        return outcome
    except (KeyboardInterrupt, LinkLostError):
        raise
    except BaseException:
        stop_listening()  # what a listener raised it would raise again
        if run.may_swim:  # a tail that beats needs its loop
            with contextlib.suppress(TailbeatError):
                _abort(run)
        raise
    finally:
        stop_listening()
        fish.link.heartbeat_period_s = heartbeat_period_s


def _abort(run: _Run) -> None:
    run.fish.abort(wall=run.abort_reason is not None and run.abort_reason.kind is StopKind.WALL)


def _prepare(run: _Run, camera: Camera | None) -> None:
    fish = run.fish
    run.settle_s = fish.params.get("SETTLE_S").value
    window_s = fish.params.get("SPD_WINDOW_S").value
    run.source = fish.speed_source()
    if camera is None and run.source.sampled:
        text = "no camera, but SPD_SOURCE is vision: this trial will have no speeds"
        run.emit(TrialWarning(text))
    if camera is not None:
        run.camera = TrialCamera(
            fish,
            camera,
            window_s=max(window_s, _beat_s(fish)) if window_s > 0 else 1.0,
            dispensable=not run.source.sampled,
            emit=run.emit,
            consult=lambda what: _consult(run, what),
            abort=lambda: setattr(run, "abort_wanted", True),
            direction_rad=run.direction_rad,
        )
        run.camera.begin()
    fish.clock.sync()
    run.wire = TrialWire(fish, run.camera, run.guard is not None, lambda: run.abort_wanted)
    if fish.status().state != "ARMED":
        fish.arm()


def _beat_s(fish: Fish) -> float:
    """Of the board's reference; a line over less than a beat would see part of the tail's swing."""
    record = fish.reference_record()
    return records.decode_reference(record).beat_s if record is not None else 1.0


def _start(run: _Run) -> None:
    fish = run.fish
    try:
        status = fish.status()
        run.number, run.iteration = status.next_trial, status.iteration
        _send_start(run)
    except (KeyboardInterrupt, LinkLostError):
        with contextlib.suppress(TailbeatError):
            fish.abort()  # the board may have got the command already
        raise
    run.progress_at_s = fish.transport.now_s()
    run.emit(TrialStarted(run.number, run.iteration, run.name))


def _send_start(run: _Run) -> None:
    """Starts; a fish that is not still yet, or still erases its storage, is waited for."""
    fish = run.fish
    begin_s = fish.transport.now_s()
    while True:
        _wait_until_still(run)
        try:
            _command_start(run)
            return
        except Refused as refused:
            waited_s = (fish.transport.now_s() - begin_s) * fish.clock.rate
            if waited_s > _START_WAIT_S.get(refused.number, 0.0):
                run.may_swim = False
                raise
            erasing = refused.number == ERASING
        if erasing and _began_meanwhile(run):
            return


def _began_meanwhile(run: _Run) -> bool:
    """Lets it erase a little. The refusal may be of a command that was said twice and then taken;
    else the board may have counted a trial that it did not start."""
    fish = run.fish
    text = "the board erases its storage; the trial starts by itself after that"
    _emit_once(run, TrialWarning(text))
    fish.link.run(_LOOK_S / max(fish.clock.rate, 1.0))
    next_trial = fish.status().next_trial
    if _swims(run):
        return True
    run.number = next_trial
    return False


def _command_start(run: _Run) -> None:
    """Until the board says yes, or is seen to swim: its yes may be lost. Speeds flow meanwhile."""
    fish = run.fish
    _reset_track(run, began=False)
    for attempt, patience_s in enumerate(fish.link.attempts()):
        if run.status is not None:  # it has spoken, does not swim: has not heard of the start
            _reset_track(run, began=True)
        # The board keeps single precision: rounding up could make the command come from the
        # future, which is harmless, rounding by more than milliseconds needs a board up for days.
        run.may_swim = True
        fish.link.send(
            mavlink.MAVLink_command_long_message(
                BOARD_SYSTEM, BOARD_COMPONENT, mavlink.TAILBEAT_CMD_TRIAL_START,
                attempt, float(run.number), fish.clock.now_s(), 0, 0, 0, 0, 0
            )
        )  # fmt: skip
        if _started(run, patience_s):
            return


def _reset_track(run: _Run, began: bool) -> None:
    """Forgets what was. ``began``: the board may swim already, nothing of the camera's raises."""
    run.status = None
    if run.camera is None:
        _consult(run, TrackReset())
    else:
        run.camera.look_afresh() if began else run.camera.begin()


def _started(run: _Run, patience_s: float) -> bool:
    """Whether the board is known to swim this trial before the patience ends. Raises Refused."""
    link = run.fish.link
    end_s = link.transport.now_s() + patience_s
    start = mavlink.TAILBEAT_CMD_TRIAL_START
    while (left_s := end_s - link.transport.now_s()) > 0:
        poll_s = min(_POLL_S / max(run.fish.clock.rate, 1.0), left_s)
        ack = link.recv("COMMAND_ACK", poll_s, lambda ack: ack.command == start)
        if _swims(run):
            return True
        if ack is not None and ack.result_param2 != STALE_COMMAND and link.accepted(ack):
            return True
        _send_speeds(run)
    return False


def _swims(run: _Run) -> bool:
    """Or has swum: whatever ended it is for later."""
    status = run.status
    begun = ("RUNNING", "SETTLING", "ABORTED", "FAULT")
    return status is not None and status.trial == run.number and status.state in begun


def _wait_until_still(run: _Run) -> None:
    """As long as the board would refuse for it; somebody may have to come and hold the fish."""
    fish = run.fish
    if not run.source.needs_rests:
        return
    rest_min_s = fish.params.get("REST_MIN_S").value
    end_s = fish.transport.now_s() + _STILL_WAIT_S / max(fish.clock.rate, 1.0)
    while fish.transport.now_s() < end_s:
        if fish.link.request("TAILBEAT_IMU_INFO").still_s >= rest_min_s:
            return
        _emit_once(run, HoldRequest("hold the fish still; the trial starts by itself once it is"))
        fish.link.run(_LOOK_S / max(fish.clock.rate, 1.0))


def _emit_once(run: _Run, event: HoldRequest | TrialWarning) -> None:
    if event.text not in run.told:
        run.told.add(event.text)
        run.emit(event)


def _hear(run: _Run, message: Message) -> None:
    kind = message.get_type()
    if kind == "TAILBEAT_STATUS":
        _take_status(run, BoardStatus.of(message))
    elif kind == "TAILBEAT_BEAT" and message.trial == run.number:
        beat = BeatEvent.of(message)
        known = run.beats.get(beat.beat)
        if known is None or (known.provisional and not beat.provisional):
            run.beats[beat.beat] = beat
            run.emit(beat)
        if known is None:
            if run.camera is not None:
                run.camera.hear(beat)
            _consult(run, beat)
    elif kind == "STATUSTEXT" and run.number:
        run.emit(BoardText(message.severity, text_of(message.text)))


def _take_status(run: _Run, status: BoardStatus) -> None:
    if run.status is not None and status.time_s < run.status.time_s:
        run.restarted = True
    run.status = status
    if run.progress != (status.state, status.beat):
        run.progress = (status.state, status.beat)
        run.progress_at_s = run.fish.link.transport.now_s()
    if run.source.needs_rests and status.state == "SETTLING":
        text = "done; catch the fish and hold it still until the result is there"
        _emit_once(run, HoldRequest(text))


def _consult(run: _Run, what: object) -> None:
    if run.guard is not None and run.abort_reason is None and not _has_ended(run):
        run.abort_reason = run.guard(what)
        if run.abort_reason is not None:
            run.abort_wanted = True
            run.emit(TrialStopped(run.abort_reason))


def _has_ended(run: _Run) -> bool:
    """All there was to swim, or it does not swim at all; not while the start is being said."""
    if (status := run.status) is None:
        return False
    whole = status.beats > 0 and status.beats - 1 in run.beats
    return whole or status.state not in ("ARMED", "RUNNING")


def _step(run: _Run) -> None:
    """One wait, and what it brought."""
    link = run.fish.link
    try:
        if run.abort_wanted and run.stopped_at_s is None:
            _abort(run)
            run.abort_wanted = False  # only now: what a broken link swallowed is said again
        rate, stall_s = run.fish.clock.rate, _STALL_S + run.settle_s
        run.wire.idle(_POLL_S * 2 / max(rate, 1.0), run.progress_at_s + stall_s / rate)
        link.forget()
        _send_speeds(run)
        run.fish.clock.keep()
    except LinkLostError:
        _reconnect(run)
        return
    now_s, last_s = link.transport.now_s(), link.last_heard_s
    if (now_s - last_s) * run.fish.clock.rate > SILENCE_S:
        _reconnect(run)
        now_s = link.transport.now_s()
    if (now_s - run.progress_at_s) * run.fish.clock.rate > _STALL_S + run.settle_s:
        state = run.status.state if run.status else "nothing"
        raise TailbeatError(
            f"trial {run.number} makes no progress; the board reports {state}; it is sent a stop",
            "Look with 'tailbeat info'; switch it off if the tail still beats.",
        )


def _send_speeds(run: _Run) -> None:
    swimming = run.status is None or run.status.state == "RUNNING"
    if run.camera is not None:
        run.camera.send_speeds(swimming)
    elif swimming:
        _consult(run, Unseen(run.fish.clock.now_s()))


def _is_over(run: _Run) -> bool:
    status = run.status
    if status is None or status.state in ("BOOT", "ARMED", "RUNNING", "SETTLING", "LEARNING"):
        return False
    if status.state == "IDLE" or status.pending_trial == run.number:
        return True
    if run.stopped_at_s is None:  # late speeds of a cut trial are still being collected
        run.stopped_at_s = status.time_s
    rest_s = _REST_WAIT_S if run.source.needs_rests and status.beat > 0 else 0.0
    return status.time_s - run.stopped_at_s > run.settle_s + rest_s + _SETTLE_MARGIN_S


def _interrupt(run: _Run) -> None:
    """Ctrl-C: the tail stops first; a second one ends the waiting."""
    if run.interrupted:
        raise KeyboardInterrupt
    run.interrupted = run.abort_wanted = True
    run.emit(InterruptRequested())


def _reconnect(run: _Run) -> None:
    run.emit(LinkLost())
    status = restore_link(run.fish, run.number, run.reconnect_s)
    if run.camera is not None:
        run.camera.fit.reset()
    run.progress_at_s = run.fish.transport.now_s()
    run.emit(LinkRestored(status.state))


def _outcome(run: _Run) -> TrialOutcome:
    status = run.status
    assert status is not None
    executed = status.beat if status.trial == run.number else 0
    beats = [run.beats[k] for k in sorted(run.beats)]
    end = end_of(status, run.number, run.restarted)
    outcome = TrialOutcome(run.number, run.iteration, end, executed, beats, run.interrupted)
    run.emit(TrialEnded(outcome.number, outcome.end))
    return outcome
