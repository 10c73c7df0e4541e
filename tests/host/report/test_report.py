"""The picture and the page."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.report.demo_data import Series, Swim
from tailbeat.report.demo_page import write_html
from tailbeat.report.demo_picture import render_png


def swim(i: int, beats: int = 40) -> Swim:
    speed = np.full(beats, 0.08 - 0.05 / i, dtype=np.float32)
    return Swim(i, i + 10, speed, speed * 5, 0.05 / i, 0.03 / i, 2, 2.2, "complete")


def series(swims: int = 6) -> Series:
    return Series(
        title="A <fish>",
        subtitle="tank",
        simulated=True,
        reference_name="thesis",
        reference_m_s=np.full(40, 0.0791, dtype=np.float32),
        beat_s=1.0,
        amplitude_max_rad=0.785,
        start_error_m_s=0.0791,
        floor_m_s=0.0104,
        floor_lsq_m_s=0.0113,
        swims=[swim(i) for i in range(1, swims + 1)],
        settings={"ILC_GAIN": "4"},
        versions={"firmware": "abc"},
    )


def size(png: bytes) -> tuple[int, int]:
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")


@pytest.mark.parametrize("swims", [0, 1, 2, 6, 40])
def test_any_number_of_trials_gives_a_picture(tmp_path: Path, swims: int) -> None:
    png = render_png(series(swims), tmp_path / "report.png")
    assert size(png) == (1600, 1000)
    assert (tmp_path / "report.png").read_bytes() == png


def test_unmeasured_beats_and_trials_are_survived() -> None:
    hole = replace(swim(2), max_abs_error_m_s=float("nan"), rms_error_m_s=float("nan"))
    blind = replace(hole, speed_m_s=np.full(40, np.nan, dtype=np.float32))
    one = replace(series(), swims=[swim(1), blind], floor_m_s=None, floor_lsq_m_s=None)
    assert size(render_png(one)) == (1600, 1000)


def test_page_stands_alone(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_html(series(), b"png", path)
    page = path.read_text()
    assert not re.search(r"(src|href)=[\"'](?!data:)", page)
    assert "http" not in page
    assert "A &lt;fish&gt;" in page
    assert "(simulated)" in page
    assert "10.40 mm/s" in page
    assert page.count("<tr") >= 1 + 1 + 6 + 2
    assert page.count('class="best"') == 1


def test_a_real_fish_is_not_called_simulated(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_html(replace(series(), simulated=False), b"png", path)
    assert "(simulated)" not in path.read_text()
