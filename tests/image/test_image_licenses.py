"""`make firmware` puts the licenses of what is in the image beside it."""

from __future__ import annotations

import re
from pathlib import Path


def test_licenses_lie_beside_the_image(image: Path) -> None:
    notice = (image.parent / "NOTICE").read_text(encoding="utf-8")
    named = re.findall(r"licenses/\w+\.txt", notice)
    assert len(named) == 4
    for name in named:
        assert (image.parent / name).stat().st_size > 500, name
