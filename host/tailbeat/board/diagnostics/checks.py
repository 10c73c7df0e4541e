"""The checks of what the board said, in the order they are reported."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from tailbeat.core.native import c_text, lib
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
_BY_WIRE = "over USB serial: tailbeat board key set"
_VERSION_REMEDY = (
    "Flash the firmware that came with this tool: 'tailbeat board flash'."
    " Or install the tool that came with the firmware."
)

_UNKNOWN = WARNING, "not known: the board did not say", "See what 'firmware' and 'link' above say."
# The board has a key, and this computer has not.
_UNAUTHENTICATED = WARNING, "only for authenticated hosts", "See what 'key' says."

Assessment = tuple[str, str, str]
"""Status, what was found in words, and the remedy."""


def _firmware(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Whether board and tool are of one version."""
    ours, build = tool_version(), c_text(lib.link_build_id())
    measured |= {"tool": ours, "tool_build": build, "board_build": evidence.build_id}
    if "AUTOPILOT_VERSION" in evidence.untold:
        return _UNAUTHENTICATED
    if evidence.unanswered:
        what = ", ".join(evidence.unanswered)
        return (
            PROBLEM,
            f"the board does not give {what} in this tool's form: they differ in version",
            _VERSION_REMEDY,
        )
    packed = 0 if evidence.version is None else evidence.version.flight_sw_version
    theirs = f"{packed >> 24 & 255}.{packed >> 16 & 255}.{packed >> 8 & 255}"
    measured["board"] = theirs
    if theirs != ours:
        return PROBLEM, f"the board has version {theirs}, this tool is {ours}", _VERSION_REMEDY
    if evidence.build_id and not _same_build(build, evidence.build_id):
        return (
            WARNING,
            f"both are version {ours}, but the board's build is {evidence.build_id}, ours {build}",
            _VERSION_REMEDY,
        )
    return OK, f"{evidence.kind} board, {build}, as this tool", ""


def _link(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Round trip, losses, damage and speed."""
    pings, burst = evidence.pings, evidence.burst
    measured |= {
        "asked": pings.asked,
        "lost": pings.lost,
        "damaged_from_board": evidence.damaged_here,
        "damaged_to_board": evidence.damaged_there,
        "bytes_per_s": None if burst is None else burst.bytes_per_s,
        "burst_frames": None if burst is None else burst.frames,
        "burst_missing": None if burst is None else burst.missing,
    }
    if not pings.samples:
        return PROBLEM, f"none of {pings.asked} requests was answered", _RADIO_REMEDY
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
    return status, ", ".join(parts), remedy


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


def _imu(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Whether the IMU streams, and whether that matters."""
    imu = evidence.imu
    if "TAILBEAT_IMU_INFO" in evidence.untold:
        return _UNAUTHENTICATED
    if imu is None:
        return _UNKNOWN
    problem = imu.problem
    measured |= {"problem": problem.name, "state": imu.state, "rate_hz": imu.rate_hz}
    if problem.well:
        return OK, f"{imu.model}, {imu.rate_hz} Hz at {imu.baud} baud", ""
    seen = bool(evidence.health and evidence.health["imu_frames"])
    needed = speed_source(evidence.parameters).needs_imu or (
        evidence.parameters.get("IMU_TIMEOUT_S", 0) > 0
    )
    absent = problem.number == IMU_SILENT and not seen and not needed
    mild = absent or problem.number in (IMU_STARTING, IMU_NOISY, IMU_NEEDS_SAVE)
    remedy = problem.remedy
    if absent:
        remedy += " Without an IMU the speed sources vision and upload work all the same."
    return WARNING if mild else PROBLEM, problem.meaning, remedy


def _battery(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Against the limits the board holds."""
    if evidence.status is None:
        return _UNKNOWN
    volts = evidence.status.battery_v
    low, critical = (evidence.parameters.get(n, 0.0) for n in ("BATT_LOW_V", "BATT_CRIT_V"))
    measured |= {"battery_v": volts, "low_v": low, "critical_v": critical}
    measured["at_limit"] = evidence.status.battery_at_limit
    if low <= 0 and critical <= 0:
        return OK, f"{volts:.2f} V, not checked: BATT_LOW_V and BATT_CRIT_V are 0", ""
    if evidence.status.battery_at_limit:
        sense = fault_info(BATTERY_SENSE)
        refused = "arming is refused" if low > 0 else "trials are stopped"
        return PROBLEM, f"{evidence.status.battery_text}: {refused}", sense.remedy
    if volts < min(1.0, low):
        remedy = "Switch it on. Check its divider at A0 ('Wire the fish' in the documentation)."
        return PROBLEM, f"{volts:.2f} V: no battery is measured", remedy
    remedy = "Charge or change the battery."
    for name, limit_v in (("BATT_CRIT_V", critical), ("BATT_LOW_V", low)):
        if volts < limit_v:
            text = f"{volts:.2f} V is below {name} ({limit_v:.2f} V): arming is refused"
            return PROBLEM, text, remedy
    if volts < low + _LITTLE_V:
        return WARNING, f"{volts:.2f} V is little above BATT_LOW_V ({low:.2f} V)", remedy
    return OK, f"{volts:.2f} V", ""


def _storage(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Room, and writes that failed."""
    if evidence.health is None:
        return _UNKNOWN
    free, failures = (int(evidence.health[n]) for n in ("store_free_bytes", "store_failures"))
    measured |= {"free_bytes": free, "failures": failures}
    if failures:
        return PROBLEM, f"{failures} writes failed since its start", fault_info(STORAGE).remedy
    text = f"{free / 1024:.0f} KiB free"
    if free < _FREE_PROBLEM_BYTES:
        return PROBLEM, text, "Pull the trials and free their space: tailbeat trial pull"
    if free < _FREE_WARNING_BYTES:
        remedy = "The next trial takes the place of the oldest: pull them, tailbeat trial pull"
        return WARNING, text, remedy
    return OK, text, ""


def _key(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Whether unauthenticated hosts can move the tail, and whether this one can."""
    key = evidence.key
    if key is None:
        return _UNKNOWN
    measured |= {"trust": key.trust, **key.refused}
    if key.lost is not None:
        return (
            PROBLEM,
            f"the board does not sign, but this computer has its key {key.lost.fingerprint}. The"
            " key was erased, or another device imitates this board",
            f"Set it again {_BY_WIRE}",
        )
    if key.trust == MISSING:
        return (
            PROBLEM,
            "the board has a key that this computer has not, so it rejects commands",
            "Bring the key: 'tailbeat board key export' where it was set, 'tailbeat board key "
            "import' here.",
        )
    if key.trust == HELD and key.held is not None:
        foreign = key.refused.get("refused_wrong", 0)
        text = f"the board signs with {key.held.fingerprint}, which this computer has"
        if foreign:
            text += f"; it rejected {foreign} frames that others signed"
        return WARNING if foreign else OK, text, ""
    if evidence.in_process:
        return OK, "none; nobody else reaches a board in this process", ""
    return WARNING, "none: anyone in Bluetooth range can move this tail", f"Set one {_BY_WIRE}"


def _clock(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Offset and drift."""
    reading = evidence.pings.clock()
    if reading is None:
        return _UNKNOWN
    offset_s, drift = reading.board_s - reading.host_s, reading.rate - 1.0
    measured |= {
        "offset_s": offset_s,
        "sigma_s": reading.sigma_s,
        "rate": reading.rate,
        "rate_error": reading.rate_error,
    }
    sigma = f"known within {reading.sigma_s * 1e3:.0f} ms"
    if reading.sigma_s > _CLOCK_SIGMA_S:
        return PROBLEM, f"the board's clock is {sigma}, too little to start a trial", _RADIO_REMEDY
    if abs(drift) - reading.rate_error > _CLOCK_OFF:
        text = f"the board's clock runs {reading.rate:.2f} times as fast as ours, {sigma}"
        if evidence.kind != "fish":
            return OK, text, ""
        remedy = "Its crystal is dead, or this computer's clock is: compare with another one."
        return PROBLEM, text, remedy
    text = f"on for {reading.board_s:.1f} s, {sigma}, drift {drift * 100:+.2f} %"
    return OK, f"{text} (+- {reading.rate_error * 100:.2f})", ""


def _state(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Whether it is stopped, and why."""
    status = evidence.status
    if status is None:
        return _UNKNOWN
    fault = status.fault
    measured |= {"state": status.state, "fault": fault.number, "name": fault.name}
    if fault.number:
        return PROBLEM, f"{status.state}: {fault.meaning}", fault.remedy
    waiting = f", trial {status.pending_trial} waits to be learned" if status.pending_trial else ""
    return OK, status.state + waiting, ""


def _restart(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Why it last started, and how it last crashed."""
    if evidence.health is None:
        return _UNKNOWN
    cause = str(evidence.health["reset_cause"])
    crash = evidence.crash
    measured |= {"cause": cause, "crash": None if crash is None else crash.kind}
    if cause == RESET_CAUSES[2]:
        hung = fault_info(WATCHDOG)
        return PROBLEM, hung.meaning, hung.remedy
    if crash is not None:
        words = fault_info(CRASH)
        where = ", ".join(filter(None, [crash.kind, crash.where]))
        text = f"{words.meaning} once: {where} (firmware {crash.build_id})"
        fresh = evidence.status is not None and evidence.status.fault.number == CRASH
        return PROBLEM if fresh else WARNING, text, words.remedy
    return OK, f"last start: {cause}; no crash on record", ""


def _radio(evidence: BoardEvidence, measured: Figures) -> Assessment:
    """Whether something at another speed talks into the radio's port."""
    if evidence.health is None or "radio_framing" not in evidence.health:
        return _UNKNOWN
    bad = int(evidence.health["radio_framing"])
    measured |= {"framing_errors": bad}
    text = f"{bad} bytes with a bad stop bit on the Bluetooth port"
    if bad < _FRAMING_MANY:
        return OK, text, ""
    if evidence.by_radio:
        return WARNING, text, "Check ground and wires between board and module."
    text += ": the Bluetooth module there uses another baud rate"
    return PROBLEM, text, f"Raise it to 115200 baud: {BLUETOOTH_SETUP}"


# In the order they are reported.
_CHECKS: dict[str, Callable[[BoardEvidence, Figures], Assessment]] = {
    "firmware": _firmware,
    "link": _link,
    "imu": _imu,
    "battery": _battery,
    "storage": _storage,
    "key": _key,
    "clock": _clock,
    "state": _state,
    "restart": _restart,
    "radio": _radio,
}
CHECKS = tuple(_CHECKS)
BEFORE_A_TRIAL = ("link", "imu", "battery")


def assess(evidence: BoardEvidence, names: Sequence[str]) -> list[Finding]:
    """The results of the checks called ``names``."""
    findings = []
    for name in names:
        measured: Figures = {}
        assessment = _CHECKS[name](evidence, measured)
        findings.append(Finding(name, *assessment, measured))
    return findings


def tool_version() -> str:
    """Version of this package."""
    try:
        return installed_version("tailbeat")
    except PackageNotFoundError:
        return "unknown"


def _same_build(ours: str, sent: str) -> bool:
    """``sent`` is cut when it is too long for its line of text."""
    return ours == sent or (len(sent) == _SENT_CHARS and ours.startswith(sent))
