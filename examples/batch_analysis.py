"""A table of all trials of all experiments: batch_analysis.py [ROOT [TABLE.csv]]."""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

from tailbeat import TailbeatError
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.folder import list_experiments

COLUMNS = (
    "trial", "iteration", "input", "end", "decision", "measured_beats", "max_abs_error_m_s",
    "rms_error_m_s",
)  # fmt: skip


def rows_of(root: Path) -> list[dict[str, Any]]:
    """One row per trial; an experiment without readable trials gives none."""
    rows = []
    for experiment in list_experiments(root):
        try:
            found = analyse(experiment)
        except TailbeatError as error:
            print(f"{experiment.name}: {error}", file=sys.stderr)
            continue
        about = {"experiment": found.name, "fish": found.fish, "law": found.law}
        about |= {"reference": found.reference_name, "error_bound_m_s": found.floor_m_s}
        rows += [about | {name: getattr(row, name) for name in COLUMNS} for row in found.rows]
    return rows


def main(root: str = "experiments", table: str = "trials.csv") -> None:
    """Write the table; print the best trial of each experiment."""
    rows = rows_of(Path(root))
    if not rows:
        sys.exit(f"there are no trials in {root}")
    with Path(table).open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, rows[0])
        out.writeheader()
        out.writerows(rows)
    for name in dict.fromkeys(row["experiment"] for row in rows):
        mine = [row for row in rows if row["experiment"] == name and row["decision"] != "discard"]
        errors_m_s = [row["max_abs_error_m_s"] for row in mine if row["measured_beats"]]
        best = f"{min(errors_m_s) * 1e3:.1f} mm/s" if errors_m_s else "unknown"
        print(f"{name}: {len(mine)} trials, smallest max|e| {best}")


if __name__ == "__main__":
    main(*sys.argv[1:])
