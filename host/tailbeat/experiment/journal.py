"""What happened in an experiment, in order: ``journal.jsonl``, one JSON object per line.

Every line has ``time`` (ISO 8601 with zone, local) and ``what``:

``made``, ``opened``; ``set`` {params}: parameters that are new; ``swum`` {trial, iteration, end,
file, rested_s, pose, drift, travel, battery_start_v, battery_end_v}; ``decided`` {trial, decision,
reason}; ``learned`` {trial, ..., rolled_back}; ``note`` {text}; ``resumed`` {...}; ``trimmed``
{...}; ``identified`` {file}; ``restored`` {trial}
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Journal:
    """The file; made by the first entry."""

    path: Path

    def add(self, what: str, now: datetime | None = None, **values: Any) -> dict[str, Any]:
        """Appends one line, lasting when it returns; what was written. NaN becomes null. A line that
        an earlier end of power has torn is ended first. Raises InputError (disk full)."""
        raise NotImplementedError

    def entries(self, what: str | None = None) -> list[dict[str, Any]]:
        """All lines, or those of one kind, in order. A torn last line is left out; any other that
        cannot be read raises InputError."""
        raise NotImplementedError

    def decisions(self) -> dict[int, dict[str, Any]]:
        """The last decision on every trial, by number."""
        raise NotImplementedError
