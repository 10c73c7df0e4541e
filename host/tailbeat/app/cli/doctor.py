"""doctor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from tailbeat.app.cli._terminal import Connect, Json, say

if TYPE_CHECKING:
    from tailbeat.board.diagnostics.evidence import Finding


def doctor(connect: Connect = None, json: Json = False) -> None:
    """Look everything over, from the port to the battery, and say what to do. Changes nothing.

    Exit status 0 when nothing has to be done, 1 when there are problems; warnings are neither.

    Example: tailbeat doctor --connect /dev/rfcomm0
    """
    from tailbeat.board.diagnostics import examine
    from tailbeat.board.diagnostics.evidence import PROBLEM, worst

    findings = examine(connect)
    well = worst(findings) != PROBLEM
    say(json, {"ok": well, "checks": findings}, lambda: _text(findings))
    if not well:
        raise typer.Exit(1)


def _text(findings: list[Finding]) -> str:
    names = max(len(finding.name) for finding in findings)
    return "\n".join(f"{f.status:<7}  {f.name:<{names}}  {f.line}" for f in findings)
