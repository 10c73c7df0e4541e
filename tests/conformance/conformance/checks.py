"""All checks, in order. What the board cannot judge by itself is judged here."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace

from conformance.boards import Board, Pulse
from conformance.console import About, Console, NoAnswer, parse_about
from conformance.results import ABSENT, FAILED, UNMEASURED, Result, from_answer, holds, judged

CRASH_READ = "crash_record"
WIDTHS_TICKS = (3600, 4501, 5400)  # 1.2, 1.50033 and 1.8 ms
FRAME_S = 0.02
SETTLE_S, WATCH_S = 0.1, 0.5
RATE_SPAN_S, RATE_PPM = 10.0, 2000.0
TRIPS = 5
FED_S, STARVED_S = 3.0, 7.0
RESTART_S = 0.05  # from the command to the restart: the line, and one frame of the main loop
BATTERY_SCALE = 65536
BATTERY_SLACK = 0.02
LED_CHANGES = 20
BOOT_SLACK_S = 0.5

Check = Callable[["Suite"], Iterator[Result]]


class Suite:
    """The checks on one board."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.console = Console(board)
        self.about = self.console.greet()

    def scenario(self, name: str) -> Iterator[Result]:
        """Runs one on the board and does what it asks for."""
        for words in self.console.answers(f"run {name}"):
            if words[0] == "check":
                yield from_answer(words[1:])
            elif words[0] == "echo":
                self.console.raw(self.console.bytes(int(words[1])))
            elif words[0] == "flood":
                self.console.raw(bytes(i % 251 for i in range(int(words[1]))))

    def restart(self) -> About:
        """By software."""
        self.console.send("restart")
        return self.console.started()

    def set_servo(self, servo: int, width_ticks: int) -> None:
        """Pulses of this width; 0 = none."""
        for _ in self.console.answers(f"servo {servo} {width_ticks}"):
            pass


# Clock and tick.


def _clock(suite: Suite) -> Iterator[Result]:
    yield from suite.scenario("clock")
    yield from suite.scenario("tick")
    yield from suite.scenario("lock")
    yield _clock_rate(suite)


def _best_reading(suite: Suite) -> tuple[float, float]:
    """(host s, board s) of the quickest of some round trips."""
    trips = []
    for _ in range(TRIPS):
        sent_s = suite.board.now_s()
        words = suite.console.ask("time")
        heard_s = suite.board.now_s()
        if words[0] != "time":
            raise NoAnswer(f"the board answered {' '.join(words)!r} when asked for the time")
        trips.append((heard_s - sent_s, (sent_s + heard_s) / 2, int(words[1]) * 1e-6))
    _, host_s, board_s = min(trips)
    return host_s, board_s


def _clock_rate(suite: Suite) -> Result:
    """A trip takes some ms, which the span makes small."""
    host_begin, board_begin = _best_reading(suite)
    suite.console.pause(RATE_SPAN_S)
    host_end, board_end = _best_reading(suite)
    off_ppm = abs((board_end - board_begin) / (host_end - host_begin) - 1) * 1e6
    if not suite.about.exact:
        return Result("clock_rate", ABSENT, off_ppm, "ppm", reason="the board runs on no crystal")
    return judged("clock_rate", round(off_ppm), "ppm", 0, RATE_PPM, "against the host's clock")


# Flash and serial ports.


def _flash(suite: Suite) -> Iterator[Result]:
    yield from suite.scenario("flash_bounds")
    yield from suite.scenario("flash_write")


def _serial(suite: Suite) -> Iterator[Result]:
    yield from suite.scenario("serial_write")
    yield judged(
        "serial_refused_sends_nothing", suite.console.stray, "bytes", 0, 0,
        "bytes of a refused write came out of the port",
    )  # fmt: skip
    yield from suite.scenario("serial_baud")
    yield from suite.scenario("loopback")
    yield from suite.scenario("overrun")


# Battery and LED.


def _board(suite: Suite) -> Iterator[Result]:
    reading = None
    for result in suite.scenario("battery"):
        yield result
        reading = result.value if result.name == "battery_reading" else reading
    yield _battery_volts(suite, reading)
    yield from _led(suite)


def _battery_volts(suite: Suite, reading: float | None) -> Result:
    battery = suite.board.battery
    if battery is None or reading is None:
        return Result("battery_volts", UNMEASURED, reason="the expected voltage was not given")
    volts = reading / BATTERY_SCALE * battery.full_scale_v
    slack = BATTERY_SLACK * battery.full_scale_v
    return judged(
        "battery_volts", round(volts, 3), "V", battery.volts - slack, battery.volts + slack,
        "not the expected voltage",
    )  # fmt: skip


def _led(suite: Suite) -> Iterator[Result]:
    before = suite.board.light_changes()
    yield from suite.scenario("led")
    after = suite.board.light_changes()
    if before is None or after is None:
        yield Result("led_lights", UNMEASURED, reason="look at the LED: ten flashes in 0.4 s")
        return
    yield judged("led_lights", after - before, "changes", LED_CHANGES - 1, LED_CHANGES, "LED")


# Servo.


def _watch(suite: Suite, servo: int) -> list[Pulse] | None:
    """Pulses of WATCH_S, after what went before has settled."""
    suite.console.pause(SETTLE_S)
    suite.board.pulses(servo)
    suite.console.pause(WATCH_S)
    return suite.board.pulses(servo)


def _servo(suite: Suite) -> Iterator[Result]:
    for servo in range(suite.about.servos):
        yield from _one_servo(suite, servo)


def _one_servo(suite: Suite, servo: int) -> Iterator[Result]:
    names = [f"servo{servo}_{what}" for what in ("width", "frames", "stops")]
    if suite.board.pulses(servo) is None:
        for name in names:
            yield Result(name, UNMEASURED, reason="nothing measures the pulses on this board")
        return
    off_ticks, counts = 0.0, []
    for width in WIDTHS_TICKS:
        suite.set_servo(servo, width)
        pulses = _watch(suite, servo) or []
        counts.append(len(pulses))
        off_ticks = max([off_ticks, *(abs(pulse.ticks - width) for pulse in pulses)])
    suite.set_servo(servo, 0)
    after = _watch(suite, servo) or []
    frames = WATCH_S / FRAME_S
    yield judged(names[0], off_ticks, "ticks", 0, 0.5, "a pulse is not as wide as commanded")
    yield judged(names[1], min(counts), "pulses", frames - 1, frames + 1, "not one in each frame")
    yield judged(names[2], len(after), "pulses", 0, 0, "pulses go on after width 0")


def _pulses_beyond(suite: Suite, since_s: float) -> list[Result]:
    """None after the restart, commanded at ``since_s`` or later, and none longer than before."""
    suite.console.pause(WATCH_S)
    pulses = suite.board.pulses(0)
    if pulses is None:
        return [Result("servo_quiet_at_restart", UNMEASURED, reason="nothing measures the pulses")]
    wrong = [p for p in pulses if p.time_s > since_s + RESTART_S or p.ticks > WIDTHS_TICKS[0] + 0.5]
    why = "the servo got pulses while the board restarted"
    return [judged("servo_quiet_at_restart", len(wrong), "pulses", 0, 0, why)]


# Restarts.


def _restart(suite: Suite) -> Iterator[Result]:
    yield from suite.scenario("flash_keep")
    suite.set_servo(0, WIDTHS_TICKS[0])
    suite.console.pause(SETTLE_S)
    suite.board.pulses(0)
    commanded_s = suite.board.now_s()
    about = suite.restart()
    began_s = suite.board.now_s()
    yield holds("reset_cause_software", about.reset == "software", f"it was {about.reset}")
    yield from _pulses_beyond(suite, commanded_s)
    yield _clock_from_boot(suite, began_s)
    yield from suite.scenario("flash_kept")
    yield _same_id(suite, about)


def _clock_from_boot(suite: Suite, began_s: float) -> Result:
    host_s, board_s = _best_reading(suite)
    off_s = round(board_s - (host_s - began_s), 3)
    return judged("clock_from_boot", off_s, "s", -BOOT_SLACK_S, BOOT_SLACK_S, "not from boot on")


def _same_id(suite: Suite, about: About) -> Result:
    empty = about.unique_id in ("00" * 16, "ff" * 16)
    same = about.unique_id == suite.about.unique_id
    why = "the unique id is empty" if empty else "the unique id differs after a restart"
    return holds("unique_id", same and not empty, why)


def _power(suite: Suite) -> Iterator[Result]:
    if not suite.board.power_cycle():
        why = "nothing can cut the board's power"
        yield from (Result(name, UNMEASURED, reason=why) for name in GROUPS["power"][1])
        return
    about = suite.console.started()
    yield holds("reset_cause_power", about.reset == "power", f"it was {about.reset}")
    for _ in suite.scenario("flash_keep"):
        pass
    suite.board.power_cycle()
    suite.console.started()
    for result in suite.scenario("flash_kept"):
        yield replace(result, name="flash_survives_power_cut")


# Watchdog and crash record.


def _watchdog(suite: Suite) -> Iterator[Result]:
    suite.console.pause(FED_S)
    alive = suite.console.ask("time")[0] == "time"
    yield holds("watchdog_spares_the_fed", alive, "the board restarted though it was fed")
    suite.console.send("run watchdog")
    starved_s = suite.board.now_s()
    while (line := suite.console.line(STARVED_S)) is not None:
        about = parse_about(line)
        if about is not None:
            break
        if line.startswith("check "):
            yield from_answer(line.split()[1:])
            suite.console.line()
            return
    else:
        raise NoAnswer("the board did not restart, nor answer, when its watchdog was not fed")
    took_s = suite.board.now_s() - starved_s
    yield judged("watchdog_bites", round(took_s, 3), "s", 0.05, 5.0, "too early or too late")
    yield holds("reset_cause_watchdog", about.reset == "watchdog", f"it was {about.reset}")


def _record_there(suite: Suite) -> bool:
    found = {result.name: result.value for result in suite.scenario(CRASH_READ)}
    return bool(found["crash_record_there"])


def _crash(suite: Suite) -> Iterator[Result]:
    for _ in suite.scenario("crash_forget"):
        pass  # an old one
    suite.console.send("run crash")
    about = suite.console.started()
    yield holds("reset_cause_assertion", about.reset == "software", f"it was {about.reset}")
    yield from suite.scenario(CRASH_READ)
    yield from suite.scenario("crash_forget")
    suite.restart()
    why = "the crash record is back after a restart"
    yield holds("crash_record_stays_forgotten", not _record_there(suite), why)


GROUPS: dict[str, tuple[Check, tuple[str, ...]]] = {
    "clock": (
        _clock,
        ("clock_monotonic", "tick_period", "tick_jitter", "lock_keeps_tick_out",
         "lock_delays_tick", "lock_loses_no_tick", "clock_rate"),
    ),
    "flash": (
        _flash,
        ("flash_reads_inside", "flash_reads_outside", "flash_writes_outside", "flash_reads_back"),
    ),
    "serial": (
        _serial,
        ("serial_write_whole_or_none", "serial_refused_sends_nothing", "serial_baud_impossible",
         "serial_baud_at_boot", "serial_loopback", "serial_overrun_counted"),
    ),
    "board": (
        _board,
        ("battery_reading", "battery_steady", "battery_volts", "led_called", "led_lights"),
    ),
    "servo": (_servo, ("servo0_width", "servo0_frames", "servo0_stops")),
    "restart": (
        _restart,
        ("flash_marked", "reset_cause_software", "servo_quiet_at_restart", "clock_from_boot",
         "flash_survives_restart", "unique_id"),
    ),
    "watchdog": (_watchdog, ("watchdog_spares_the_fed", "watchdog_bites")),
    "crash": (
        _crash,
        ("reset_cause_assertion", "crash_record_there", "crash_record_place",
         "crash_record_forgotten", "crash_record_stays_forgotten"),
    ),
    "power": (_power, ("reset_cause_power", "flash_survives_power_cut")),
}  # fmt: skip
"""Each group's checks, and the names of those that every board must answer."""


def run_group(suite: Suite, name: str) -> Iterator[Result]:
    """Results of one group; a check without an answer has failed."""
    check, required = GROUPS[name]
    reason = suite.board.absent.get(name)
    if reason is not None:
        yield from (Result(check_name, ABSENT, reason=reason) for check_name in required)
        return
    seen, why = set(), "the board gave no result"
    try:
        for result in check(suite):
            seen.add(result.name)
            yield result
    except (NoAnswer, ValueError, KeyError, OSError) as error:
        why = str(error)
    yield from (Result(r, FAILED, reason=why) for r in required if r not in seen)


def run(board: Board, groups: Collection[str] = tuple(GROUPS)) -> Iterator[Result]:
    """All results in order. Raises NoAnswer when the suite is not on the board."""
    suite = Suite(board)
    for name in GROUPS:
        if name in groups:
            yield from run_group(suite, name)
