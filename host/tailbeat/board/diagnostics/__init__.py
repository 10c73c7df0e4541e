"""Looks a fish over, from the port to the battery, and says what to do. Changes nothing on it."""

from __future__ import annotations

import contextlib

from tailbeat.board.diagnostics import checks, evidence
from tailbeat.board.diagnostics.evidence import (
    OK,
    PROBLEM,
    WARNING,
    Finding,
    gather,
    of_connected,
    worst,
)
from tailbeat.board.fish import Fish
from tailbeat.core.errors import TailbeatError

__all__ = ["OK", "PROBLEM", "WARNING", "Finding", "examine", "look_at", "worst"]

MEASURE_S = 3.0


def examine(url: str | None = None, measure_s: float = MEASURE_S) -> list[Finding]:
    """Run every check in turn; end early when no board is heard.

    Parameters
    ----------
    url : str, optional
        Address as for ``--connect``; default: find the fish.
    measure_s : float
        How long the link is watched, s.

    Returns
    -------
    list of Finding
        The results, in the order of the checks.

    Raises
    ------
    InputError
        The address makes no sense.
    """
    findings, transport = evidence.reach(url)
    if transport is None:
        return findings
    with contextlib.closing(transport):
        try:
            found = gather(transport, measure_s)
        except TailbeatError as error:
            return [*findings, Finding("link", PROBLEM, error.message, error.remedy)]
        return findings + checks.assess(found, checks.CHECKS)


def look_at(fish: Fish, measure_s: float = 1.0) -> list[Finding]:
    """Check link, IMU and battery of a connected fish: what matters before a trial.

    Parameters
    ----------
    fish : Fish
        The connected board; nothing changes on it.
    measure_s : float
        How long the link is watched, s.

    Returns
    -------
    list of Finding
        The results.
    """
    return checks.assess(of_connected(fish, measure_s), checks.BEFORE_A_TRIAL)
