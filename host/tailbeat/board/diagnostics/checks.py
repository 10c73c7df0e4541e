"""The checks of what the board said, in the order they are told."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed_version

from tailbeat.board.diagnostics.evidence import (
    OK,
    PROBLEM,
    WARNING,
    BoardEvidence,
    Figures,
    Finding,
)
from tailbeat.board.provision import HELD, MISSING
from tailbeat.core.faults import (
    BATTERY_SENSE,
    CRASH,
    IMU_NEEDS_SAVE,
    IMU_NOISY,
    IMU_SILENT,
    IMU_STARTING,
    STORAGE,
    WATCHDOG,
    fault_info,
)
from tailbeat.core.native import ffi, lib
from tailbeat.core.speed_source import speed_source
from tailbeat.link.messages import RESET_CAUSES
from tailbeat.link.transport import BLUETOOTH_SETUP

_LOST_PROBLEM, _LOST_WARNING = 0.2, 0.02
_SLOW_PROBLEM_S, _SLOW_WARNING_S = 1.0, 0.3  # an HC-05 takes 0.04 to 0.1 s
_RATE_PROBLEM, _RATE_WARNING = 1500.0, 5000.0  # bytes/s; 9600 baud carry 960
_CLOCK_OFF = 0.02  # of a board on its RC oscillator; crystals agree within 100 ppm
_CLOCK_SIGMA_S = 1.0  # start commands older than 2 s are refused
_FREE_PROBLEM_BYTES, _FREE_WARNING_BYTES = 4096, 20480  # a trial takes 16 KB
_FRAMING_MANY = 16
_SENT_CHARS = 40
_LITTLE_V = 0.2
_RADIO_REMEDY = "Bring the antenna out of the water, and closer; check the cable and its ground."
_VERSION_REMEDY = (
    "Flash the firmware that came with this tool (make firmware, then: tailbeat board flash), or "
    "install"
    " the tool that came with the firmware."
)


def _firmware(evidence: BoardEvidence) -> Finding:
    """Whether board and tool are of one version."""
    ours, build = tool_version(), _text(lib.link_build_id())
    measured: Figures = {"tool": ours, "tool_build": build, "board_build": evidence.build_id}
    if "AUTOPILOT_VERSION" in evidence.untold:
        return _untold("firmware", measured)
    if evidence.unanswered:
        what = ", ".join(evidence.unanswered)
        return Finding(
            "firmware",
            PROBLEM,
            f"the board does not give {what} in this tool's form: they differ in version",
            _VERSION_REMEDY,
            measured,
        )
    packed = 0 if evidence.version is None else evidence.version.flight_sw_version
    theirs = f"{packed >> 24 & 255}.{packed >> 16 & 255}.{packed >> 8 & 255}"
    measured["board"] = theirs
    if theirs != ours:
        text = f"the board has version {theirs}, this tool is {ours}"
        return Finding("firmware", PROBLEM, text, _VERSION_REMEDY, measured)
    if evidence.build_id and not _same_build(build, evidence.build_id):
        text = (
            f"both are version {ours}, but the board's build is {evidence.build_id}, ours {build}"
        )
        return Finding("firmware", WARNING, text, _VERSION_REMEDY, measured)
    return Finding("firmware", OK, f"{evidence.kind} board, {build}, as this tool", "", measured)


def _link(evidence: BoardEvidence) -> Finding:
    """Round trip, losses, damage and speed."""
    pings, burst = evidence.pings, evidence.burst
    measured: Figures = {
        "asked": pings.asked,
        "lost": pings.lost,
        "damaged_from_board": evidence.damaged_here,
        "damaged_to_board": evidence.damaged_there,
        "bytes_per_s": None if burst is None else burst.bytes_per_s,
        "burst_frames": None if burst is None else burst.frames,
        "burst_missing": None if burst is None else burst.missing,
    }
    if not pings.samples:
        text = f"none of {pings.asked} requests was answered"
        return Finding("link", PROBLEM, text, _RADIO_REMEDY, measured)
    measured |= {"round_trip_s": pings.median_s, "round_trip_max_s": pings.max_s}
    parts = [f"round trip {pings.median_s * 1e3:.0f} ms (at most {pings.max_s * 1e3:.0f})"]
    parts.append(f"{pings.lost} of {pings.asked} requests lost")
    if burst is not None and burst.missing:
        parts.append(f"{burst.missing} of {burst.frames + burst.missing} frames of a list lost")
    if evidence.damaged_here or evidence.damaged_there:
        parts.append(f"damaged frames: {evidence.damaged_here} in, {evidence.damaged_there} out")
    rate = None if burst is None else burst.bytes_per_s
    if rate is not None:
        parts.append(f"{rate:.0f} bytes/s")
    status, remedy = _judge_link(evidence, rate)
    return Finding("link", status, ", ".join(parts), remedy, measured)


def _judge_link(evidence: BoardEvidence, rate: float | None) -> tuple[str, str]:
    pings, burst = evidence.pings, evidence.burst
    asked, missing = pings.asked, pings.lost
    if burst is not None:
        asked, missing = asked + burst.frames + burst.missing, missing + burst.missing
    lost = missing / asked
    if rate is not None and rate < _RATE_PROBLEM:
        return PROBLEM, f"A line this slow is not at 115200 baud; a module: {BLUETOOTH_SETUP}"
    if lost > _LOST_PROBLEM or pings.median_s > _SLOW_PROBLEM_S:
        return PROBLEM, _RADIO_REMEDY
    # What another version sends looks damaged, too.
    damaged = evidence.damaged_here + evidence.damaged_there > 0 and not evidence.unanswered
    slow = pings.median_s > _SLOW_WARNING_S or (rate is not None and rate < _RATE_WARNING)
    if lost > _LOST_WARNING or slow or damaged:
        return WARNING, _RADIO_REMEDY
    return OK, ""


def _imu(evidence: BoardEvidence) -> Finding:
    """Whether the IMU streams, and whether that matters."""
    imu = evidence.imu
    if "TAILBEAT_IMU_INFO" in evidence.untold:
        return _untold("imu")
    if imu is None:
        return _unknown("imu")
    problem = imu.problem
    measured: Figures = {"problem": problem.name, "state": imu.state, "rate_hz": imu.rate_hz}
    if problem.well:
        text = f"{imu.model}, {imu.rate_hz} Hz at {imu.baud} baud"
        return Finding("imu", OK, text, "", measured)
    seen = bool(evidence.health and evidence.health["imu_frames"])
    needed = speed_source(evidence.parameters).needs_imu or (
        evidence.parameters.get("IMU_TIMEOUT_S", 0) > 0
    )
    absent = problem.number == IMU_SILENT and not seen and not needed
    mild = absent or problem.number in (IMU_STARTING, IMU_NOISY, IMU_NEEDS_SAVE)
    remedy = problem.remedy
    if absent:
        remedy += " Without an IMU the speed sources vision and upload work all the same."
    return Finding("imu", WARNING if mild else PROBLEM, problem.meaning, remedy, measured)


def _battery(evidence: BoardEvidence) -> Finding:
    """Against the limits the board holds."""
    if evidence.status is None:
        return _unknown("battery")
    volts = evidence.status.battery_v
    low, critical = (evidence.parameters.get(n, 0.0) for n in ("BATT_LOW_V", "BATT_CRIT_V"))
    measured: Figures = {"battery_v": volts, "low_v": low, "critical_v": critical}
    measured["at_limit"] = evidence.status.battery_at_limit
    if low <= 0 and critical <= 0:
        text = f"{volts:.2f} V, not checked: BATT_LOW_V and BATT_CRIT_V are 0"
        return Finding("battery", OK, text, "", measured)
    if evidence.status.battery_at_limit:
        sense = fault_info(BATTERY_SENSE)
        refused = "arming is refused" if low > 0 else "trials are stopped"
        text = f"{evidence.status.battery_text}: {refused}"
        return Finding("battery", PROBLEM, text, sense.remedy, measured)
    remedy = "Charge or change the battery."
    if volts < min(1.0, low):
        text = f"{volts:.2f} V: no battery is measured"
        remedy = "Switch it on, and check its divider at A0 (docs/wiring.md)."
        return Finding("battery", PROBLEM, text, remedy, measured)
    if volts < critical:
        text = f"{volts:.2f} V is below BATT_CRIT_V ({critical:.2f} V): arming is refused"
        return Finding("battery", PROBLEM, text, remedy, measured)
    if volts < low:
        text = f"{volts:.2f} V is below BATT_LOW_V ({low:.2f} V): arming is refused"
        return Finding("battery", PROBLEM, text, remedy, measured)
    if volts < low + _LITTLE_V:
        text = f"{volts:.2f} V is little above BATT_LOW_V ({low:.2f} V)"
        return Finding("battery", WARNING, text, remedy, measured)
    return Finding("battery", OK, f"{volts:.2f} V", "", measured)


def _storage(evidence: BoardEvidence) -> Finding:
    """Room, and writes that failed."""
    if evidence.health is None:
        return _unknown("storage")
    free, failures = (int(evidence.health[n]) for n in ("store_free_bytes", "store_failures"))
    measured: Figures = {"free_bytes": free, "failures": failures}
    if failures:
        text = f"{failures} writes failed since its start"
        return Finding("storage", PROBLEM, text, fault_info(STORAGE).remedy, measured)
    text = f"{free / 1024:.0f} KiB free"
    if free < _FREE_PROBLEM_BYTES:
        remedy = "Pull the trials and free their space: tailbeat trial pull"
        return Finding("storage", PROBLEM, text, remedy, measured)
    if free < _FREE_WARNING_BYTES:
        remedy = "The next trial takes the place of the oldest: pull them, tailbeat trial pull"
        return Finding("storage", WARNING, text, remedy, measured)
    return Finding("storage", OK, text, "", measured)


def _key(evidence: BoardEvidence) -> Finding:
    """Whether unauthenticated hosts can move the tail, and whether this one can."""
    key = evidence.key
    if key is None:
        return _unknown("key")
    measured: Figures = {"trust": key.trust, **key.refused}
    if key.lost is not None:
        return Finding(
            "key",
            PROBLEM,
            f"the board does not sign, but this computer has its key {key.lost.fingerprint}: it was"
            " erased, or somebody pretends to be this board",
            "Set it again over the wired port: tailbeat board key set",
            measured,
        )
    if key.trust == MISSING:
        return Finding(
            "key",
            PROBLEM,
            "the board has a key that this computer has not, so it does not obey",
            "Bring the key: 'tailbeat board key export' where it was set, 'tailbeat board key "
            "import' here.",
            measured,
        )
    if key.trust == HELD and key.held is not None:
        foreign = key.refused.get("refused_wrong", 0)
        text = f"the board signs with {key.held.fingerprint}, which this computer has"
        if foreign:
            text += f"; it rejected {foreign} frames that others signed"
        return Finding("key", WARNING if foreign else OK, text, "", measured)
    if evidence.in_process:
        return Finding("key", OK, "none; nobody else reaches a board in this process", "", measured)
    remedy = "Set one over the wired port: tailbeat board key set"
    text = "none: anyone in radio range can move this tail"
    return Finding("key", WARNING, text, remedy, measured)


def _clock(evidence: BoardEvidence) -> Finding:
    """Offset and drift."""
    reading = evidence.pings.clock()
    if reading is None:
        return _unknown("clock")
    offset_s, drift = reading.board_s - reading.host_s, reading.rate - 1.0
    measured: Figures = {
        "offset_s": offset_s,
        "sigma_s": reading.sigma_s,
        "rate": reading.rate,
        "rate_error": reading.rate_error,
    }
    sigma = f"known within {reading.sigma_s * 1e3:.0f} ms"
    if reading.sigma_s > _CLOCK_SIGMA_S:
        text = f"the board's clock is {sigma}, too little to start a trial"
        return Finding("clock", PROBLEM, text, _RADIO_REMEDY, measured)
    if abs(drift) - reading.rate_error > _CLOCK_OFF:
        text = f"the board's clock runs {reading.rate:.2f} times as fast as ours, {sigma}"
        if evidence.kind != "fish":
            return Finding("clock", OK, text, "", measured)
        remedy = "Its crystal is dead, or this computer's clock is: compare with another one."
        return Finding("clock", PROBLEM, text, remedy, measured)
    text = f"on for {reading.board_s:.1f} s, {sigma}, drift {drift * 100:+.2f} %"
    return Finding("clock", OK, f"{text} (+- {reading.rate_error * 100:.2f})", "", measured)


def _state(evidence: BoardEvidence) -> Finding:
    """Whether it is stopped, and why."""
    status = evidence.status
    if status is None:
        return _unknown("state")
    measured: Figures = {
        "state": status.state,
        "fault": status.fault.number,
        "name": status.fault.name,
    }
    if status.fault.number:
        text = f"{status.state}: {status.fault.meaning}"
        return Finding("state", PROBLEM, text, status.fault.remedy, measured)
    waiting = f", trial {status.pending_trial} waits to be learned" if status.pending_trial else ""
    return Finding("state", OK, status.state + waiting, "", measured)


def _restart(evidence: BoardEvidence) -> Finding:
    """Why it last started, and how it last crashed."""
    if evidence.health is None:
        return _unknown("restart")
    cause = str(evidence.health["reset_cause"])
    crash = evidence.crash
    measured: Figures = {"cause": cause, "crash": None if crash is None else crash.kind}
    if cause == RESET_CAUSES[2]:
        hung = fault_info(WATCHDOG)
        return Finding("restart", PROBLEM, hung.meaning, hung.remedy, measured)
    if crash is not None:
        words = fault_info(CRASH)
        where = ", ".join(filter(None, [crash.kind, crash.where]))
        text = f"{words.meaning} once: {where} (firmware {crash.build_id})"
        fresh = evidence.status is not None and evidence.status.fault.number == CRASH
        return Finding("restart", PROBLEM if fresh else WARNING, text, words.remedy, measured)
    return Finding("restart", OK, f"last start: {cause}; no crash on record", "", measured)


def _radio(evidence: BoardEvidence) -> Finding:
    """Whether something at another speed talks into the radio's port."""
    if evidence.health is None or "radio_framing" not in evidence.health:
        return _unknown("radio")
    bad = int(evidence.health["radio_framing"])
    measured: Figures = {"framing_errors": bad}
    text = f"{bad} bytes with a bad stop bit on the radio's port"
    if bad < _FRAMING_MANY:
        return Finding("radio", OK, text, "", measured)
    if evidence.by_radio:
        remedy = "Check ground and wires between board and module."
        return Finding("radio", WARNING, text, remedy, measured)
    text += ": the radio module there talks at another speed"
    return Finding("radio", PROBLEM, text, f"Raise it to 115200 baud: {BLUETOOTH_SETUP}", measured)


CHECKS: tuple[Callable[[BoardEvidence], Finding], ...] = (
    _firmware,
    _link,
    _imu,
    _battery,
    _storage,
    _key,
    _clock,
    _state,
    _restart,
    _radio,
)
BEFORE_A_SWIM = (_link, _imu, _battery)


def tool_version() -> str:
    """Version of this package."""
    try:
        return installed_version("tailbeat")
    except PackageNotFoundError:
        return "unknown"


def _same_build(ours: str, sent: str) -> bool:
    """``sent`` is cut when it is too long for its line of text."""
    return ours == sent or (len(sent) == _SENT_CHARS and ours.startswith(sent))


def _unknown(name: str) -> Finding:
    remedy = "See what 'firmware' and 'link' above say."
    return Finding(name, WARNING, "not known: the board did not say", remedy)


def _untold(name: str, measured: Figures | None = None) -> Finding:
    """The board has a key, and this computer has not."""
    return Finding(
        name, WARNING, "only for authenticated hosts", "See what 'key' says.", measured or {}
    )


def _text(pointer: object) -> str:
    return str(ffi.string(pointer).decode())
