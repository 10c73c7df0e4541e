"""A series of trials as a table that grows row by row while it runs."""

from __future__ import annotations

from dataclasses import dataclass

from tailbeat.core.printable import mm
from tailbeat.link.messages import LearnReport
from tailbeat.session.events import Event, TrialDecided, TrialRecorded

_ROW = "{:>5}  {:<5}  {:>12}  {:>6}  {:>6}  {:>8}  {:>7}  {}"
HEADER = (
    _ROW.format("trial", "law", "predicted", "max|e|", "RMS", "at limit", "battery", "decision"),
    _ROW.format("", "", "mm/s", "mm/s", "mm/s", "beats", "", "").rstrip(),
)


@dataclass
class TrialTable:
    """What the rows need of the events. A trial's row is there once it is decided on, and learned
    from if it is kept. The law and what it predicts are those the input was chosen with."""

    _began: bool = False
    _last: TrialRecorded | None = None

    def lines(self, event: Event) -> list[str]:
        """The lines that an event adds, the header before the first row."""
        match event:
            case TrialRecorded():
                self._last = event
            case TrialDecided(trial, decision) if decision.kind != "keep":
                return self._rows(trial, decision.kind, None)
            case LearnReport():
                word = "kept, the best" if event.improved else "kept"
                return self._rows(event.trial, word, event.saturated_beats)
        return []

    def _rows(self, trial: int, decision: str, saturated: int | None) -> list[str]:
        if (last := self._last) is None or last.record.outcome.number != trial:
            return []
        made, record = last.made, last.record
        expected = made.expected_m_s if made is not None else None
        row = _ROW.format(
            trial,
            made.law if made is not None else "",
            "" if expected is None else f"{mm(expected[0])} to {mm(expected[2])}",
            mm(record.max_abs_error_m_s),
            mm(record.rms_error_m_s),
            "" if saturated is None else saturated,
            "" if record.battery_end_v is None else f"{record.battery_end_v:.2f} V",
            decision,
        )
        began, self._began = self._began, True
        return [row] if began else [*HEADER, row]
