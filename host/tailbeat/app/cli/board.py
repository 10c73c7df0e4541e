"""info, arm, disarm, clear, watch, crash."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.app.cli._terminal import Connect, Json, connected, json_line, mm, say
from tailbeat.core.files import plain

if TYPE_CHECKING:
    from tailbeat.board.crash import CrashReport
    from tailbeat.board.fish import Fish
    from tailbeat.link.messages import BoardStatus, ImuInfo


def info(connect: Connect = None, json: Json = False) -> None:
    """Who is connected and where it stands.

    Example: tailbeat info --connect tcp:127.0.0.1:5760
    """
    from tailbeat.board.provision import MISSING, trust_of

    with connected(connect) as fish:
        if trust_of(fish) == MISSING:
            document, text = _info_of_a_stranger(fish)
        else:
            document, text = _info(fish)
    say(json, document, text)


def _info(fish: Fish) -> tuple[dict[str, Any], str]:
    from tailbeat.core.trial_checks import never_corrected

    found, imu, health, visits = fish.info(), fish.imu_info(), fish.health(), fish.visits()
    who = f"{found.board} board on {found.connection}, firmware {found.build_id}"
    document = plain(found) | {"imu": imu, "health": health, "visits": visits}
    text = _info_text(who, found.status, imu_line(imu), health)
    missing = never_corrected(visits)
    return document, text + (f"\nlearned    {missing}" if missing else "")


def _info_of_a_stranger(fish: Fish) -> tuple[dict[str, Any], str]:
    """A board whose key we have not tells no more than it tells by itself."""
    from tailbeat.link.messages import BoardInfo

    status, health, name = fish.status(), fish.health(), fish.transport.name
    document: dict[str, Any] = dict.fromkeys(field.name for field in fields(BoardInfo))
    document |= {"connection": name, "status": status, "imu": None, "health": health}
    document["visits"] = None
    who = f"board on {name}; what it is, and its firmware: not told to strangers"
    return document, _info_text(who, status, "not told to strangers", health)


def imu_line(imu: ImuInfo) -> str:
    """The IMU in one line: what it is when all is well, otherwise what is wrong."""
    if not imu.problem.well:
        return f"{imu.problem.meaning}. {imu.problem.remedy}"
    where = f"{imu.baud} baud, port {imu.port or '?'}"
    return f"{imu.model}, firmware {imu.firmware}, {imu.rate_hz} Hz at {where}"


def _info_text(who: str, status: BoardStatus, imu: str, health: dict[str, int | str]) -> str:
    lines = [
        who,
        f"state      {status.state}, battery {status.battery_text}",
        f"reference  {_reference(status)}",
        f"iteration  {status.iteration} swims next, as trial {status.next_trial}",
        f"imu        {imu}",
    ]
    if status.fault.number:
        lines.insert(2, f"stopped    {status.fault.meaning}. {status.fault.remedy}")
    if status.best_max_abs_error_m_s is not None:
        best = mm(status.best_max_abs_error_m_s)
        lines.append(f"best       {best} mm/s at iteration {status.best_iteration}")
    if status.pending_trial is not None:
        lines.append(f"pending    trial {status.pending_trial}: learn from it or discard it")
    if health.get("reset_cause") != "power":
        lines.append(f"last start {health['reset_cause']}")
    counted = ("imu_crc_failed", "link_bad_frames", "late_ticks", "store_failures")
    bad = [f"{name} {health[name]}" for name in counted if health.get(name)]
    if bad:
        lines.append(f"counters   {', '.join(bad)}")
    return "\n".join(lines)


def _reference(status: BoardStatus) -> str:
    from tailbeat.board.fish import REST

    if status.reference_crc in (None, REST.crc):
        return "none; upload one: tailbeat reference upload thesis"
    return f"{status.beats} beats, {status.reference_crc:08x}"


def arm(connect: Connect = None, json: Json = False) -> None:
    """Make ready to swim. The tail stays off until the trial starts.

    Example: tailbeat arm
    """
    with connected(connect) as fish:
        fish.arm()
        status = fish.status()
    say(json, status, f"armed: iteration {status.iteration} swims next")


def disarm(connect: Connect = None, json: Json = False) -> None:
    """Back to idle; a running trial is aborted.

    Example: tailbeat disarm
    """
    with connected(connect) as fish:
        fish.disarm()
        status = fish.status()
    say(json, status, f"disarmed: {status.state}")


def clear(connect: Connect = None, json: Json = False) -> None:
    """Leave a stop: after an abort or a fault has been looked at.

    Example: tailbeat clear
    """
    with connected(connect) as fish:
        fish.clear()
        status = fish.status()
    say(json, status, f"cleared: {status.state}")


def watch(
    connect: Connect = None,
    count: Annotated[
        int | None, typer.Option("--count", min=1, help="Stop after this many lines.")
    ] = None,
    json: Json = False,
) -> None:
    """Print what the board tells as JSON lines, until Ctrl-C.

    Example: tailbeat watch | jq -c 'select(.event == "beat")'
    """
    del json  # the stream is JSON lines anyway
    with connected(connect) as fish:
        for number, event in enumerate(fish.watch(), start=1):
            json_line(event)
            if number == count:
                return


def crash(
    connect: Connect = None,
    elf: Annotated[
        Path | None,
        typer.Option("--elf", help="The .elf that crashed: names the places in the source."),
    ] = None,
    json: Json = False,
) -> None:
    """How the firmware last crashed, from the board's /crash.bin.

    Example: tailbeat crash --elf build/firmware/tailbeat.elf
    """
    from tailbeat.board.crash import places

    with connected(connect) as fish:
        report = fish.crash_report()
    found = places(report, elf) if report is not None and elf is not None else []
    document = {"crash": None if report is None else report.as_dict() | {"places": found}}
    say(json, document, lambda: _crash_text(report, found))


def _crash_text(report: CrashReport | None, found: list[str]) -> str:
    if report is None:
        return "no crash on record"
    what = ", ".join([report.kind, *report.reasons, *filter(None, [report.where])])
    registers = [f"{name:<10} {value:08x}" for name, value in report.registers.items()]
    columns = ["  ".join(registers[i : i + 3]) for i in range(0, len(registers), 3)]
    words = [f"{word:08x}" for word in report.stack]
    stack = ["stack  " + " ".join(words[i : i + 8]) for i in range(0, len(words), 8)]
    return "\n".join(
        [
            f"{what}, {report.time_s:.3f} s after its start, firmware {report.build_id}",
            *found,
            *columns,
            *stack,
        ]
    )
