"""What the shell offers after TAB."""

from __future__ import annotations

from pathlib import Path

_KINDS = ("thesis", "thesis:", "trapezoid:", "cosine:")


def reference_names(incomplete: str) -> list[str]:
    """References that begin so: their names, CSV files, and folders that may hold some."""
    folder = Path(incomplete if incomplete.endswith("/") else Path(incomplete).parent)
    try:
        files = sorted(folder.iterdir())
    except OSError:
        files = []
    found = [str(path) for path in files if path.suffix.lower() == ".csv"]
    found += [f"{path}/" for path in files if path.is_dir() and not path.name.startswith(".")]
    return [name for name in (*_KINDS, *found) if name.startswith(incomplete)]
