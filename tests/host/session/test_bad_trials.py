"""Bad trials do not poison what is learned: whatever goes wrong in one trial of ten, the tenth is
as good as if nothing had. ``pytest -s -m soak -k bad_trials tests/host`` prints it."""

from __future__ import annotations

import contextlib
import math
import statistics
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from typer.testing import CliRunner

from tailbeat.app.cli.app import app
from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.arrays import F32
from tailbeat.core.errors import Refused
from tailbeat.core.speed_source import Frame
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import Message
from tailbeat.link.messages import LearnReport
from tailbeat.sensors.camera.render.source import SimulatedCamera
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard

TRIALS = 10
SEEDS = range(1, 21)
BEATS = 40
WHEN = (4, 7)  # the trials that go wrong
GAIN, PLAUSIBLE_M_S = 4.0, 0.5
REST_S = 7.0  # between trials: the fish is put back, and held for longer than REST_MIN_S
NOBODY_S = 1e9

Floats = F32


@dataclass(frozen=True)
class Limits:
    """How far the law may go: as in the thesis, or as a fish nobody knows has it."""

    name: str
    amp_max_rad: float
    params: tuple[tuple[str, float], ...]
    sim: tuple[tuple[str, float], ...] = ()


THESIS = Limits("thesis limits", 0.785398, (("AMP_MAX_RAD", 0.785398), ("DU_MAX_RAD", 0)))
SAFE = Limits("safe limits", 0.5, ())
BLIND = replace(THESIS, name="thesis limits, no IMU", sim=(("imu_firmware", 0),))


@dataclass
class Trouble:
    """What goes wrong in one trial. Times count from the start of the trial."""

    before: Callable[[SimBoard], None] = lambda board: None
    see: Callable[[float, Frame], Frame | None] = lambda t_s, frame: frame
    say: Callable[[float, Message], list[Message]] = lambda t_s, message: [message]
    at_s: float = NOBODY_S  # when this happens:
    act: Callable[[SimBoard], None] = lambda board: None
    stop_s: float = NOBODY_S  # when somebody presses stop
    after: Callable[[Fish, int], None] = lambda fish, trial: None


class SpoiltCamera(SimulatedCamera):
    """The simulated camera, and a clock for all that goes wrong."""

    computed = False  # like one that looks at pictures

    def __init__(self, board: SimBoard, trouble: Trouble) -> None:
        super().__init__(board)
        self.board, self.trouble = board, trouble
        self.start_s: float | None = None
        self.acted = False

    def t_s(self) -> float:
        """Since the start of the trial; negative before."""
        if self.start_s is None and self.board.world.truth().swimming:
            self.start_s = self.board.time_s
        return -1.0 if self.start_s is None else self.board.time_s - self.start_s

    def frames(self) -> list[Frame]:
        t_s = self.t_s()
        if t_s >= self.trouble.at_s and not self.acted:
            self.acted = True
            self.trouble.act(self.board)
        seen = super().frames()
        if self.start_s is None:
            return seen
        pictures = [self.trouble.see(f.t_s - self.start_s, f) for f in seen]
        return [picture for picture in pictures if picture is not None]

    def guard(self, what: object) -> StopReason | None:
        """For run_trial: presses stop."""
        return StopReason(StopKind.CALLER, "stop") if self.t_s() >= self.trouble.stop_s else None


class Session:
    """One fish that learns."""

    def __init__(self, seed: int, limits: Limits) -> None:
        self.fish = Fish.connect("sim:tank", seed=seed, **dict(limits.sim))
        self.limits = limits
        assert isinstance(self.fish.sim, SimBoard)
        self.board = self.fish.sim

    def begin(self) -> None:
        """The settings, kept."""
        params = self.fish.params
        for name, value in (*self.limits.params, ("ILC_GAIN", GAIN), ("ILC_LEAD", 1)):
            params.set(name, value)
        params.save()
        self.fish.upload_reference(reference.thesis().record())

    def resume(self, flash: bytes, trial: int) -> None:
        """As another session stood before ``trial``."""
        self.board.flash = flash
        self.board.world.power_cycle()
        self.fish.link.run(2.0)
        self.fish.clock.sync()
        self.board.world.set_swim(trial)

    def trial(self, trouble: Trouble | None = None) -> float:
        """One trial and what a person does after it; the true max|e|."""
        fish, spoil = self.fish, trouble or Trouble()
        fish.link.run(REST_S)
        spoil.before(self.board)
        camera = SpoiltCamera(self.board, spoil)
        old = fish.amplitudes().values if fish.status().iteration else None
        plain_send = fish.link.send

        def send(message: Message) -> None:
            vision = message.get_type() == "VISION_SPEED_ESTIMATE"
            for each in spoil.say(camera.t_s(), message) if vision else [message]:
                plain_send(each)

        fish.link.send = send  # type: ignore[method-assign]
        outcome = run_trial(fish, camera=camera, guard=camera.guard)
        fish.link.send = plain_send  # type: ignore[method-assign]
        camera.close()
        true = self.board.world.true_beats()[:BEATS]
        self.learn()
        spoil.after(fish, outcome.number)
        self.check_amplitudes(old)
        error = reference.thesis().speed_m_s[: len(true)] - true
        return float(np.max(np.abs(error))) if len(error) == BEATS else math.nan

    def learn(self) -> LearnReport | None:
        """Clears, learns if there is something to learn, otherwise drops the trial."""
        fish = self.fish
        if fish.status().state in ("ABORTED", "FAULT"):
            fish.clear()
        if fish.status().pending_trial is None:
            return None
        try:
            return fish.learn()
        except Refused as refused:
            assert refused.name == "NOTHING_MEASURED"
            fish.discard()
            return None

    def check_amplitudes(self, old: Floats | None) -> None:
        """Finite, and no further from what was executed than the law can bring them."""
        new = self.fish.amplitudes().values
        assert new.shape == (BEATS,) and np.all(np.isfinite(new))
        most = GAIN * (PLAUSIBLE_M_S + 0.0791) + 1e-6
        recorded = np.clip(old, 0, self.limits.amp_max_rad) if old is not None else 0.0
        assert np.all(np.abs(new - recorded) <= most)


@cache
def clean(seed: int, limits: Limits) -> tuple[list[float], dict[int, bytes]]:
    """Errors of undisturbed trials, and the flash as it was before the trials that may go wrong."""
    session = Session(seed, limits)
    session.begin()
    errors, images = [], {}
    for trial in range(1, TRIALS + 1):
        images[trial] = session.board.flash
        errors.append(session.trial())
    return errors, {trial: images[trial] for trial in (1, *WHEN)}


@dataclass(frozen=True)
class Harm:
    """max|e| over that of the same trial when nothing went wrong."""

    final: float  # of the last of ten trials
    following: float  # of the trial right after the first bad one


def harm(seed: int, limits: Limits, troubles: dict[int, Trouble]) -> Harm:
    """Ten trials, of which some go wrong."""
    errors, images = clean(seed, limits)
    bad = min(troubles)
    first = max(trial for trial in images if trial <= bad)
    session = Session(seed, limits)
    session.resume(images[first], first)
    ratio = {}
    for trial in range(first, TRIALS + 1):
        ratio[trial] = session.trial(troubles.get(trial)) / errors[trial - 1]
    return Harm(ratio[TRIALS], ratio[bad + 1])


# ---- What goes wrong. Each kind makes its trouble from a seed and the trial. ----

Kind = Callable[[int, int], Trouble]


def spread(seed: int, trial: int) -> int:
    """A beat; over 20 seeds and two trials each of the 40 once."""
    return (2 * (seed - 1) + WHEN.index(trial) if trial in WHEN else seed * 7 + trial) % BEATS


def within(seed: int, trial: int, length_s: float) -> float:
    """When something of that length begins, so that it ends before the trial does."""
    return spread(seed, trial) / BEATS * (BEATS - length_s) + 0.37 * seed % 1


def heard(seed: int, trial: int) -> float:
    """When the sample comes that stands for the middle of a beat, just before it is told of."""
    return min(max(spread(seed, trial), 1), BEATS - 3) + 1.05


def message(m: Message, speed_m_s: float | None = None, sigma_m_s: float | None = None) -> Message:
    covariance = list(m.covariance)
    if sigma_m_s is not None:
        covariance[0] = sigma_m_s * sigma_m_s if sigma_m_s > -1 else sigma_m_s
    speed = m.x if speed_m_s is None else speed_m_s
    return mavlink.MAVLink_vision_speed_estimate_message(m.usec, speed, m.y, m.z, covariance, 0)


def abort(seed: int, trial: int) -> Trouble:
    return Trouble(stop_s=spread(seed, trial) + 0.5)


def abort_at(beat: float) -> Kind:
    return lambda seed, trial: Trouble(stop_s=beat + 0.5)


def start_speed(m_s: float) -> Kind:
    return lambda seed, trial: Trouble(before=lambda board: board.world.set_start(m_s))


def nan_speeds(length_s: float) -> Kind:
    strange = [math.nan, math.inf, -math.inf, 1e30, -1e30]

    def make(seed: int, trial: int) -> Trouble:
        begin_s = within(seed, trial, length_s)
        count = 0

        def say(t_s: float, m: Message) -> list[Message]:
            nonlocal count
            if not begin_s <= t_s < begin_s + length_s:
                return [m]
            count += 1
            return [message(m, strange[count % len(strange)])]

        return Trouble(say=say)

    return make


def bad_sigmas(seed: int, trial: int) -> Trouble:
    strange = [math.nan, math.inf, -1.0, 0.0]
    count = 0

    def say(t_s: float, m: Message) -> list[Message]:
        nonlocal count
        count += 1
        return [message(m, sigma_m_s=strange[count % len(strange)])]

    return Trouble(say=say)


def frozen_position(length_s: float) -> Kind:
    """The tracker lost the fish and keeps telling where it was."""

    def make(seed: int, trial: int) -> Trouble:
        begin_s = within(seed, trial, length_s)
        held: list[Frame] = []

        def see(t_s: float, frame: Frame) -> Frame:
            if not begin_s <= t_s < begin_s + length_s:
                return frame
            held.append(frame)
            return replace(held[0], t_s=frame.t_s)

        return Trouble(see=see)

    return make


def frozen_speed(length_s: float) -> Kind:
    """Whoever makes speeds of pictures keeps telling the last."""

    def make(seed: int, trial: int) -> Trouble:
        begin_s = within(seed, trial, length_s)
        held: list[Message] = []

        def say(t_s: float, m: Message) -> list[Message]:
            if not begin_s <= t_s < begin_s + length_s:
                return [m]
            held.append(m)
            return [message(m, held[0].x, math.sqrt(held[0].covariance[0]))]

        return Trouble(say=say)

    return make


def bump(speed_m_s: float, samples: int) -> Kind:
    """Samples that are far off but not beyond belief."""

    def make(seed: int, trial: int) -> Trouble:
        begin_s = heard(seed, trial)
        count = 0

        def say(t_s: float, m: Message) -> list[Message]:
            nonlocal count
            if t_s < begin_s or count >= samples:
                return [m]
            count += 1
            return [message(m, speed_m_s)]

        return Trouble(say=say)

    return make


def glitch(x_m: float) -> Kind:
    """One picture in which something else was taken for the fish."""

    def make(seed: int, trial: int) -> Trouble:
        begin_s = within(seed, trial, 1.0)
        done: list[float] = []

        def see(t_s: float, frame: Frame) -> Frame:
            if t_s < begin_s or done:
                return frame
            done.append(t_s)
            return replace(frame, x_m=frame.x_m + x_m)

        return Trouble(see=see)

    return make


def collision(seed: int, trial: int) -> Trouble:
    return Trouble(at_s=within(seed, trial, 1.0), act=lambda board: board.world.hold(1.0))


def hand(by_m_s: float) -> Kind:
    return lambda seed, trial: Trouble(
        at_s=within(seed, trial, 1.0), act=lambda board: board.world.push(by_m_s)
    )


def dark(length_s: float) -> Kind:
    def make(seed: int, trial: int) -> Trouble:
        begin_s = within(seed, trial, length_s) if length_s < BEATS else -1.0
        return Trouble(
            see=lambda t_s, frame: None if begin_s <= t_s < begin_s + length_s else frame
        )

    return make


def reset(seed: int, trial: int) -> Trouble:
    return Trouble(at_s=spread(seed, trial) + 0.37, act=lambda board: board.world.power_cycle())


def repeats(seed: int, trial: int) -> Trouble:
    """A host that says everything again, and things of long ago."""

    def after(fish: Fish, number: int) -> None:
        held = fish.amplitudes()
        iteration = fish.status().iteration
        for old in (number, number - 1, 1):
            commands = [(mavlink.TAILBEAT_CMD_LEARN, float(old))]
            commands += [(mavlink.TAILBEAT_CMD_TRIAL_START, float(old), fish.clock.now_s())]
            commands += [(mavlink.TAILBEAT_CMD_DISCARD, float(old))]
            for command in commands:
                with contextlib.suppress(Refused):
                    fish.link.command(*command)
        assert fish.status().iteration == iteration and fish.status().state == "IDLE"
        assert np.array_equal(fish.amplitudes().values, held.values)

    return Trouble(after=after)


def old_samples(seed: int, trial: int) -> Trouble:
    """Each sample comes three times, and again two and six seconds late."""
    sent: deque[tuple[float, Message]] = deque()

    def say(t_s: float, m: Message) -> list[Message]:
        sent.append((t_s, m))
        late = [old for at_s, old in sent if 2.0 < t_s - at_s <= 2.04 or 6.0 < t_s - at_s <= 6.04]
        while sent and t_s - sent[0][0] > 7.0:
            sent.popleft()
        return [m, m, m, *late]

    return Trouble(say=say)


def wrong_times(seed: int, trial: int) -> Trouble:
    """Every fifth sample claims another time: long ago, to come, never."""
    strange = [0, 1, 2**63, 2**64 - 1]
    count = 0

    def say(t_s: float, m: Message) -> list[Message]:
        nonlocal count
        count += 1
        if count % 5:
            return [m]
        usec = [*strange, m.usec - 5_000_000, m.usec + 3_000_000][count // 5 % 6]
        return [
            m,
            mavlink.MAVLink_vision_speed_estimate_message(usec, 0.3, m.y, m.z, m.covariance, 0),
        ]

    return Trouble(say=say)


KINDS: dict[str, Kind] = {
    "abort at any beat": abort,
    "abort in beat 1": abort_at(0),
    "abort in the last beat": abort_at(39),
    "start at +0.05 m/s": start_speed(0.05),
    "start at -0.05 m/s": start_speed(-0.05),
    "NaN speeds, 3 s": nan_speeds(3),
    "NaN speeds, 10 s": nan_speeds(10),
    "NaN speeds, all": nan_speeds(50),
    "bad sigmas": bad_sigmas,
    "frozen position, 3 s": frozen_position(3),
    "frozen position, 10 s": frozen_position(10),
    "frozen speed, 3 s": frozen_speed(3),
    "frozen speed, 10 s": frozen_speed(10),
    "one huge sample": bump(0.45, 1),
    "one huge sample backwards": bump(-0.45, 1),
    "0.5 s of huge samples": bump(0.45, 12),
    "one wrong picture, 4 cm": glitch(0.04),
    "one wrong picture, 40 cm": glitch(0.4),
    "collision, 1 s": collision,
    "a hand pushes, +0.05 m/s": hand(0.05),
    "a hand pushes, -0.05 m/s": hand(-0.05),
    "camera lost, 1 s": dark(1),
    "camera lost, 3 s": dark(3),
    "camera lost, 10 s": dark(10),
    "camera lost, all": dark(50),
    "reset at any beat": reset,
    "repeated numbers": repeats,
    "repeated and late samples": old_samples,
    "samples of other times": wrong_times,
}


SAMPLE = [
    "abort at any beat", "abort in beat 1", "start at -0.05 m/s", "NaN speeds, all", "bad sigmas",
    "frozen position, 10 s", "0.5 s of huge samples", "one wrong picture, 40 cm", "collision, 1 s",
    "camera lost, 10 s", "reset at any beat", "repeated and late samples",
    "samples of other times",
]  # fmt: skip


def mixed(seed: int) -> dict[int, Trouble]:
    """One of each sort spread over the ten trials; the last is good."""
    sorts: list[Kind] = [
        bump(0.45, 12),
        abort,
        frozen_position(3),
        start_speed(0.05),
        nan_speeds(10),
        collision,
        dark(50),
        reset,
        repeats,
    ]
    order = np.random.default_rng(seed).permutation(len(sorts))
    return {trial + 1: sorts[kind](seed, trial + 1) for trial, kind in enumerate(order)}


# ---- What is shown. ----


def report(name: str, trial: str, harms: list[Harm]) -> None:
    """A line of the table."""
    worst = max(range(len(harms)), key=lambda i: harms[i].final)
    middle = statistics.median(harm.final for harm in harms)
    following = statistics.median(harm.following for harm in harms)
    print(
        f"{name:26s} {trial:>5s}  median {middle:.3f}  worst {harms[worst].final:.3f}"
        f" (seed {worst + 1:2d})  the trial right after: {following:.2f}"
    )


@pytest.mark.parametrize("name", SAMPLE)
def test_one_bad_trial_leaves_no_trace(name: str) -> None:
    """A sample of the table: one seed, with other limits from kind to kind."""
    index = list(KINDS).index(name)
    limits = (THESIS, SAFE)[index % 2]
    assert harm(1, limits, {7: KINDS[name](1 + index, 7)}).final <= 1.1


def test_a_lost_fish_is_not_learned_from() -> None:
    """Whatever the tracker repeats: the very next trial swims as well as if it had said nothing."""
    for name in ("frozen position, 10 s", "frozen speed, 10 s", "0.5 s of huge samples"):
        assert harm(1, THESIS, {7: KINDS[name](12, 7)}).following <= 1.15, name


@pytest.mark.soak
@pytest.mark.parametrize("limits", [THESIS, SAFE, BLIND], ids=lambda limits: limits.name)
@pytest.mark.parametrize("name", KINDS)
def test_bad_trials_of_20_fish(name: str, limits: Limits) -> None:
    for trial in WHEN:
        harms = [harm(seed, limits, {trial: KINDS[name](seed, trial)}) for seed in SEEDS]
        report(name, str(trial), harms)
        assert statistics.median(h.final for h in harms) <= 1.1


@pytest.mark.soak
@pytest.mark.parametrize("limits", [THESIS, SAFE, BLIND], ids=lambda limits: limits.name)
def test_nothing_but_bad_trials_of_20_fish(limits: Limits) -> None:
    harms = [harm(seed, limits, mixed(seed)) for seed in SEEDS]
    report("one of each", "1-9", harms)
    assert statistics.median(h.final for h in harms) <= 1.1


def bits(values: Floats) -> bytes:
    return np.asarray(values, dtype=np.float32).tobytes()


@pytest.mark.parametrize(
    "name", ["abort at any beat", "frozen position, 10 s", "reset at any beat", "camera lost, all"]
)
def test_the_best_comes_back_bit_for_bit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By ``tailbeat trial learn --restore-best``, and after a reboot."""
    _, images = clean(1, THESIS)
    session = Session(1, THESIS)
    session.resume(images[7], 7)
    best = session.fish.amplitudes(best=True)
    assert np.all((best.values >= 0) & (best.values <= np.float32(THESIS.amp_max_rad)))
    session.trial(KINDS[name](1, 7))
    now_best = session.fish.amplitudes(best=True)
    if name != "frozen position, 10 s":
        assert bits(now_best.values) == bits(best.values)
    session.board.world.power_cycle()
    session.fish.link.run(2.0)
    monkeypatch.setattr(
        "tailbeat.app.cli.learn.connected", lambda _: contextlib.nullcontext(session.fish)
    )
    assert CliRunner().invoke(app, ["learn", "--restore-best", "--json"]).exit_code == 0
    assert bits(session.fish.amplitudes().values) == bits(now_best.values)
    session.board.world.power_cycle()
    session.fish.link.run(2.0)
    assert bits(session.fish.amplitudes().values) == bits(now_best.values)
