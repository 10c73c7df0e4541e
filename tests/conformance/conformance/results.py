"""What a check found."""

from __future__ import annotations

from dataclasses import asdict, dataclass

OK, FAILED, ABSENT, UNMEASURED = "ok", "failed", "not there", "not measured"
_VERDICTS = {"ok": OK, "failed": FAILED, "absent": ABSENT}
_ANSWER_WORDS = 7


@dataclass(frozen=True)
class Result:
    """One check; a value is right from ``least`` to ``most``."""

    name: str
    verdict: str
    value: float | None = None
    unit: str = ""
    least: float | None = None
    most: float | None = None
    reason: str = ""

    def to_json(self) -> dict[str, object]:
        """For --json."""
        return asdict(self)

    def row(self) -> str:
        """A line of the table."""
        limit = "" if self.least is None else f"{self.least:g} to {self.most:g}"
        value = "" if self.value is None else f"{self.value:g}"
        cells = f"{self.name:30} {value:>10} {self.unit:9} {limit:18} {self.verdict:12}"
        return f"{cells} {self.reason}".rstrip()


def from_answer(words: list[str]) -> Result:
    """Of a "check" line, without its first word. Raises ValueError."""
    if len(words) < _ANSWER_WORDS - 1:
        raise ValueError(f"not a result: {' '.join(words)}")
    name, value, unit, least, most, verdict, *reason = words
    why = " ".join(reason)
    if value == "-":
        return Result(name, _VERDICTS[verdict], reason=why)
    return Result(name, _VERDICTS[verdict], int(value), unit, int(least), int(most), why)


def judged(name: str, value: float, unit: str, least: float, most: float, why: str) -> Result:
    """Failed, for the reason ``why``, when the value is out of range."""
    fine = least <= value <= most
    return Result(name, OK if fine else FAILED, value, unit, least, most, "" if fine else why)


def holds(name: str, fact: bool, why: str) -> Result:
    """A single yes or no."""
    return judged(name, float(fact), "cases", 1, 1, why)
