"""info."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from tailbeat.app.cli._fish import ConnectedFish
from tailbeat.app.cli._terminal import Output, lines_of
from tailbeat.board.fish import REST_CRC, Fish
from tailbeat.board.provision import MISSING, trust_of
from tailbeat.core.extras import lazy
from tailbeat.core.files import plain
from tailbeat.core.printable import mm
from tailbeat.link.messages import BoardInfo, BoardStatus, ImuInfo

trial_checks: Any = lazy("tailbeat.core.trial_checks")  # with numpy


def info(fish: ConnectedFish) -> Output:
    """Print what is connected and its state.

    Example: tailbeat info --connect tcp:127.0.0.1:5760
    """
    return _info_unauthenticated(fish) if trust_of(fish) == MISSING else _info(fish)


def _info(fish: Fish) -> Output:
    found, imu, health, visits = fish.info(), fish.imu_info(), fish.health(), fish.visit_counts()
    who = f"{found.board} board on {found.connection}, firmware {found.build_id}"
    document = plain(found) | {"imu": imu, "health": health, "visits": visits}
    text = _info_text(who, found.status, imu_line(imu), health)
    missing = ""
    if visits and 0 in visits and any(visits):
        missing = trial_checks.never_corrected(visits)
    return Output(document, lines_of(text, missing and f"learned    {missing}"))


def _info_unauthenticated(fish: Fish) -> Output:
    """Of a board whose key is not here: what it sends without authentication."""
    status, health, name = fish.status(), fish.health(), fish.transport.name
    unknown = dict.fromkeys([*(field.name for field in fields(BoardInfo)), "imu", "visits"])
    document = unknown | {"connection": name, "status": status, "health": health}
    who = f"board on {name}; what it is, and its firmware: only for authenticated hosts"
    return Output(document, _info_text(who, status, "only for authenticated hosts", health))


def imu_line(imu: ImuInfo) -> str:
    """The IMU in one line: what it is when all is well, otherwise what is wrong."""
    if not imu.problem.well:
        return f"{imu.problem.meaning}. {imu.problem.remedy}"
    where = f"{imu.baud} baud, port {imu.port or '?'}"
    return f"{imu.model}, firmware {imu.firmware}, {imu.rate_hz} Hz at {where}"


def _info_text(who: str, status: BoardStatus, imu: str, health: dict[str, int | str]) -> str:
    fault, best, pending = status.fault, status.best_max_abs_error_m_s, status.pending_trial
    counted = ("imu_crc_failed", "link_bad_frames", "late_ticks", "store_failures")
    bad = [f"{name} {health[name]}" for name in counted if health.get(name)]
    start = health.get("reset_cause")
    return lines_of(
        who,
        f"state      {status.state}, battery {status.battery_text}",
        fault.number and f"stopped    {fault.meaning}. {fault.remedy}",
        f"reference  {_reference(status)}",
        f"iteration  {status.iteration} is next, as trial {status.next_trial}",
        f"imu        {imu}",
        best is not None and f"best       {mm(best)} mm/s at iteration {status.best_iteration}",
        pending is not None and f"pending    trial {pending}: learn from it or discard it",
        start != "power" and f"last start {start}",
        bad and f"counters   {', '.join(bad)}",
    )


def _reference(status: BoardStatus) -> str:
    if status.reference_crc in (None, REST_CRC):
        return "none; upload one: tailbeat reference upload thesis"
    return f"{status.beats} beats, {status.reference_crc:08x}"
