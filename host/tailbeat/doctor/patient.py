"""All that the checks look at, asked from the board once. What it does not say is None."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field

from tailbeat import _dialect as mavlink
from tailbeat import results
from tailbeat.crash import CrashReport
from tailbeat.doctor.quality import Burst, Pings, burst, ping
from tailbeat.doctor.reach import by_radio
from tailbeat.errors import LinkLostError, Refused, TailbeatError
from tailbeat.fish import Fish
from tailbeat.link import BOARD_COMPONENT, BOARD_SYSTEM, Link, Message, text_of
from tailbeat.provision import MISSING, KeyStatus, key_status, trust_of
from tailbeat.results import BoardStatus, ImuInfo
from tailbeat.transport.base import Transport
from tailbeat.transport.inprocess import in_process

# The version last: a line of text with the build follows it.
ASKED = ("TAILBEAT_STATUS", "TAILBEAT_HEALTH", "TAILBEAT_IMU_INFO", "AUTOPILOT_VERSION")
PARAMETERS = ("BATT_LOW_V", "BATT_CRIT_V", "SPD_SOURCE", "IMU_TIMEOUT_S")
_TRIES, _TRIES_LOSSY = 4, 12
_REPLY_S = 0.7
_BUSY = ("RUNNING", "SETTLING", "LEARNING")
_NAME = "tailbeat "

Health = dict[str, int | str]


@dataclass
class Patient:
    """``unanswered``: messages the board did not give though it answered others. ``untold``: those
    it refused us, because it has a key and we have not."""

    by_radio: bool
    in_process: bool
    pings: Pings
    burst: Burst | None = None
    damaged_here: int = 0
    damaged_there: int = 0
    version: Message | None = None
    build_id: str | None = None
    status: BoardStatus | None = None
    health: Health | None = None
    imu: ImuInfo | None = None
    crash: CrashReport | None = None
    key: KeyStatus | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    unanswered: list[str] = field(default_factory=list)
    untold: list[str] = field(default_factory=list)

    @property
    def busy(self) -> bool:
        """A trial is under way: the link is not to be loaded."""
        return self.status is not None and self.status.state in _BUSY

    @property
    def kind(self) -> str:
        """Fish, simulated, emulated, or unknown."""
        number = None if self.version is None else self.version.board_version
        return results.BOARD_KINDS.get(number or 0, "unknown")


def gather(transport: Transport, measure_s: float) -> Patient:
    """Asks for everything. Raises LinkLostError when the board answers nothing at all."""
    fish = Fish(transport)
    fish.clock.sync()
    link = fish.link
    # A stranger would have to wait for it twice.
    before = None if link.signing.locked else _ask(link, "TAILBEAT_HEALTH")
    damaged = link.framer.bad_frames
    patient = Patient(by_radio(transport), in_process(transport) is not None, Pings(0, []))
    patient.pings = ping(link, measure_s)
    _read(patient, link)
    if not patient.busy:
        patient.burst, patient.parameters = burst(link)
    patient.damaged_here = link.framer.bad_frames - damaged
    if before is not None and patient.health is not None:
        there = int(patient.health["link_bad_frames"]) - before.link_bad_frames
        patient.damaged_there = max(0, there)
    _look_further(patient, fish)
    return patient


def of_connected(fish: Fish, measure_s: float) -> Patient:
    """What matters before a swim, of a fish that is connected: link, battery, IMU."""
    link = fish.link
    patient = Patient(
        by_radio(fish.transport), in_process(fish.transport) is not None, ping(link, measure_s)
    )
    patient.status = fish.status()
    patient.health = fish.health()
    patient.imu = fish.imu_verdict()
    patient.parameters = {name: fish.params.get(name).value for name in PARAMETERS}
    return patient


def _read(patient: Patient, link: Link) -> None:
    tries = _TRIES_LOSSY if patient.pings.lost else _TRIES
    messages: dict[str, Message | None] = dict.fromkeys(ASKED)
    for kind in ASKED:
        try:
            messages[kind] = _ask(link, kind, tries)
        except Refused:
            patient.untold.append(kind)
    silent = [kind for kind, message in messages.items() if message is None]
    patient.unanswered = [kind for kind in silent if kind not in patient.untold]
    if len(patient.unanswered) == len(ASKED):
        raise link.lost(tries, tries * _REPLY_S)
    status, health, imu, version = (messages[kind] for kind in ASKED)
    if version is not None:
        patient.version = version
        patient.build_id = _build_id(link) or text_of(bytes(version.flight_custom_version))
    if status is not None:
        patient.status = BoardStatus.of(status)
    if health is not None:
        patient.health = results.health_dict(health)
    if imu is not None:
        patient.imu = ImuInfo.of(imu)


def _look_further(patient: Patient, fish: Fish) -> None:
    for name in PARAMETERS:
        if name not in patient.parameters:
            with contextlib.suppress(TailbeatError):
                patient.parameters[name] = fish.params.get(name).value
    if patient.imu is not None:
        patient.imu = fish.imu_verdict()
    if not patient.busy:
        with contextlib.suppress(TailbeatError):
            patient.crash = fish.crash_report()
    told = patient.version is not None and patient.health is not None
    if told or trust_of(fish) == MISSING:
        patient.key = key_status(fish, patient.health or {})


def _ask(link: Link, kind: str, tries: int = _TRIES) -> Message | None:
    """A message, with less patience than link.request: it may be one that never comes. Raises
    Refused when the board does not tell it to strangers, which we are."""
    if link.signing.locked:
        return _overhear(link, kind)
    number = next(n for n, message in mavlink.mavlink_map.items() if message.msgname == kind)
    request = mavlink.MAVLink_command_long_message(
        BOARD_SYSTEM, BOARD_COMPONENT, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, number, 0, 0, 0, 0, 0, 0
    )
    link.flush()
    for _ in range(tries):
        link.send(request)
        message = link.recv(kind, link.patient(_REPLY_S))
        if message is not None:
            return message
    return None


def _overhear(link: Link, kind: str) -> Message | None:
    """What a board tells by itself; the rest it refuses."""
    with contextlib.suppress(LinkLostError):
        return link.request(kind)
    return None


def _build_id(link: Link) -> str | None:
    """The board says it in a line of text behind its version."""
    for _ in range(_TRIES):
        heard = link.recv(
            "STATUSTEXT", link.patient(0.5), lambda m: text_of(m.text).startswith(_NAME)
        )
        if heard is not None:
            return text_of(heard.text).removeprefix(_NAME)
        _ask(link, "AUTOPILOT_VERSION")
    return None
