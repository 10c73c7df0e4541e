"""What one check found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

OK, WARNING, PROBLEM = "ok", "warning", "problem"

Figure = float | int | str | bool | None
Figures = dict[str, Figure]


@dataclass(frozen=True)
class Finding:
    """One check's result: how it went, in words, what to do, and the figures behind it."""

    name: str
    status: str
    text: str
    remedy: str = ""
    measured: Mapping[str, Figure] = field(default_factory=dict)

    @property
    def line(self) -> str:
        """What it says and what to do, in one line."""
        return f"{self.text}. {self.remedy}" if self.remedy else self.text


def worst(findings: list[Finding]) -> str:
    """The worst status among them."""
    found = {finding.status for finding in findings}
    return next((status for status in (PROBLEM, WARNING) if status in found), OK)
