"""tailbeat report: figures as they are printed, the page, the tables."""

from __future__ import annotations

import base64
import csv
import itertools
import json
import math
import re
import shutil
import tempfile
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy.io import loadmat

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.reference import from_text
from tailbeat.experiment.analysis import Analysis, analyse
from tailbeat.experiment.folder import Experiment
from tailbeat.report import style as looks
from tailbeat.report.figures import comparison, contraction, learning, trials
from tailbeat.report.page import Material, Picture, headline, page
from tailbeat.report.paper import FIGURES, Drawing, write_report
from tailbeat.report.style import LOOKS, PAGE, PAPER, labels, written
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial

from .. import made_analyses as made

pytestmark = pytest.mark.painted

MODULES = {"learning": learning, "trials": trials, "contraction": contraction}
COLUMN_MM = 88.9
NOON = datetime(2026, 5, 4, 12, 0)
SEEDS = (1, 2)
DAY = ("keep", "keep", "discard", "keep", "abort", "keep", "repeat", "repeat", "keep")
OTHER_DAY = ("keep", "keep", "keep", "keep", "repeat", "repeat")


def swim_a_day(root: Path, seed: int, gain: float, day: Sequence[str]) -> Experiment:
    """Twelve beats, on a simulated fish whose tail soon reaches its limit."""
    wave = root / "wave.csv"
    wave.write_text("t_s,v_m_s\n0,0\n3,0.07\n9,0.07\n12,0\n")
    wanted = from_text(str(wave))
    experiment = Experiment.new(root, "carl", "wave", f"p{gain:g}", NOON)
    experiment.add_raw("reference.bin", wanted.record())
    experiment.note("water 21.5 °C <b>& still</b>", NOON)
    with Fish.connect(f"sim:tank?seed={seed}") as fish:
        settings = {"AMP_MAX_RAD": 0.5, "ILC_GAIN": gain, "ILC_LEAD": 1.0, "DU_MAX_RAD": 0.3}
        for name, value in settings.items():
            fish.params.set(name, value)
        fish.upload_reference(wanted.record())
        info = fish.info()
        experiment.write_settings(
            {
                "simulated": True,
                "board": info.board,
                "unique_id": info.unique_id,
                "firmware": info.build_id,
                "params": settings,
                "conditions": {"water_c": 21.5, "tail": "<i>soft</i>"},
            }
        )
        for minute, what in enumerate(day):
            swim_once(fish, experiment, what, NOON + timedelta(minutes=minute))
    return experiment


def swim_once(fish: Fish, experiment: Experiment, what: str, now: datetime) -> None:
    beats = 0

    def hand(seen: object) -> StopReason | None:
        nonlocal beats
        beats = max(beats, getattr(seen, "beat", 0) or 0)
        return StopReason(StopKind.CALLER, "a hand") if what == "abort" and beats >= 5 else None

    fish.arm()
    recorded = run_trial(fish, guard=hand)
    with tempfile.TemporaryDirectory() as folder:
        path = experiment.keep_trial(fish.pull_trial(recorded.number, Path(folder)))
    if what == "abort":
        fish.clear()
    decision = "discard" if what == "abort" else what
    reason = "" if decision == "keep" else f"{what}: as <planned> & said"
    told = {"trial": recorded.number, "file": path.name}
    experiment.journal.add("swum", now, iteration=recorded.iteration, end=recorded.end, **told)
    experiment.journal.add("decided", now, decision=decision, reason=reason, **told)
    if decision != "keep":
        fish.discard(recorded.number)
        return
    learned = fish.learn(recorded.number)
    experiment.journal.add("learned", now, rolled_back=learned.rolled_back, **told)


@pytest.fixture(scope="module")
def days(tmp_path_factory: pytest.TempPathFactory) -> tuple[Experiment, Experiment]:
    print(f"seeds {SEEDS}")
    root = tmp_path_factory.mktemp("experiments")
    return swim_a_day(root, SEEDS[0], 4, DAY), swim_a_day(root, SEEDS[1], 3, OTHER_DAY)


@pytest.fixture(scope="module")
def analyses(days: tuple[Experiment, Experiment]) -> list[Analysis]:
    return [analyse(one) for one in days]


@pytest.fixture(scope="module")
def reported(days: tuple[Experiment, Experiment], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole report with everything, in a folder of its own. To write a figure takes a second:
    one is, as it is printed; the others are drawn, and written in other tests."""

    def some(figure: Figure, kind: str) -> bytes:
        printed = math.isclose(figure.get_figwidth(), PAPER.width_in)
        learns = "RMS error (mm/s)" in [axes.get_ylabel() for axes in figure.axes]
        return written(figure, kind) if printed and learns else b"<svg/>"

    folder = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("tailbeat.report.style.written", some)
        write_report(days[0], paper=True, against=[days[1]], folder=folder)
    return folder


def pdf_streams(content: bytes) -> list[bytes]:
    found = []
    for match in re.finditer(rb"stream\r?\n(.*?)\r?\nendstream", content, re.S):
        try:
            found.append(zlib.decompress(match[1]))
        except zlib.error:
            continue
    return [stream for stream in found if b" Tf" in stream]


def pdf_text(content: bytes) -> str:
    shown = []
    for stream in pdf_streams(content):
        for line in re.findall(rb"BT(.*?)ET", stream, re.S):
            letters = re.findall(rb"\(\x00(\\?.)\)", line, re.S)
            shown.append(b"".join(letter[-1:] for letter in letters).decode("latin-1"))
    return "\n".join(shown)


def pdf_size_mm(content: bytes) -> tuple[float, float]:
    box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", content)
    assert box
    return float(box[1]) / 72 * 25.4, float(box[2]) / 72 * 25.4


def points(figure: Figure, gid: str) -> list[tuple[float, float]]:
    """Of all lines whose name begins so, in all axes."""
    found: list[tuple[float, float]] = []
    for axes in figure.axes:
        for line in axes.lines:
            if str(line.get_gid()).startswith(gid):
                xy = np.asarray(line.get_xydata())
                found += [(float(x), float(y)) for x, y in xy]
    return found


def bars(figure: Figure, axes: int, gid: str) -> list[tuple[float, float, float]]:
    """(middle, bottom, top)"""
    return [
        (p.get_x() + p.get_width() / 2, p.get_y(), p.get_y() + p.get_height())
        for c in figure.axes[axes].containers
        if isinstance(c, BarContainer)
        for p in c.patches
        if str(p.get_gid()).startswith(gid)
    ]


def words(figure: Figure) -> str:
    """All text in it."""
    return "\n".join(text.get_text() for text in figure.findobj(Text))


# ------------------------------------------------------------------ what the figures hold


def test_every_swim_is_a_point(analyses: list[Analysis]) -> None:
    analysis = analyses[0]
    figure = learning.draw([analysis], PAPER)
    kinds = Counter(looks.kind_of(row) for row in analysis.rows)
    assert kinds == {"kept": 5, "discarded": 2, "repeat": 2}
    for at, name in enumerate(("max_abs_error_m_s", "rms_error_m_s")):
        axes = figure.axes[at]
        drawn = sorted(
            y for line in axes.lines if str(line.get_gid()).startswith("swims")
            for y in line.get_ydata()
        )  # fmt: skip
        assert drawn == pytest.approx(sorted(1e3 * getattr(row, name) for row in analysis.rows))
    for kind, count in kinds.items():
        assert len(points(figure, f"swims {kind}")) == 2 * count
    assert all(0.5 < x < 8.5 for x, _ in points(figure, "swims"))
    iterations = [row.iteration for row in analysis.rows]
    assert [round(x) for x in looks.places(analysis.rows)] == iterations
    assert len(set(looks.places(analysis.rows))) == len(iterations)


def test_kinds_look_different(analyses: list[Analysis]) -> None:
    shapes = [
        tuple(looks.marker(kind, LOOKS[0]).get(key) for key in ("marker", "mec", "mfc"))
        for kind in looks.KINDS
    ]
    assert len(set(shapes)) == len(looks.KINDS)
    for kind in ("kept", "repeat"):
        assert {looks.marker(kind, look)["marker"] for look in LOOKS} == {x.marker for x in LOOKS}
    assert len({str(look.dash) for look in LOOKS}) == len(LOOKS)


def test_median_and_band(analyses: list[Analysis]) -> None:
    band = analyses[0].band
    figure = learning.draw(analyses[:1], PAPER)
    assert [y for _, y in points(figure, "median max")] == pytest.approx(1e3 * band.max_median_m_s)
    assert [y for _, y in points(figure, "median rms")] == pytest.approx(1e3 * band.rms_median_m_s)
    many = np.flatnonzero(band.swims >= 3)
    assert len(many) == 1  # the two repeats and the trial that was kept
    (one,) = bars(figure, 0, "band max")
    low, high = band.max_low_m_s[many[0]], band.max_high_m_s[many[0]]
    assert one == pytest.approx((band.iteration[many[0]], 1e3 * low, 1e3 * high))
    assert "5 to 95 %" in words(figure)


def test_two_swims_have_no_band() -> None:
    recorded = [made.trial(n, 1, error) for n, error in enumerate((0.02, 0.03), 1)]
    figure = learning.draw(
        [made.analysis(recorded, [made.row(trial) for trial in recorded])], PAPER
    )
    assert bars(figure, 0, "band") == [] and "5 to 95 %" not in words(figure)
    assert len(points(figure, "swims kept")) == 4


def test_levels_are_labelled() -> None:
    analysis = made.series([0.06, 0.03, 0.012])
    text = words(learning.draw([analysis], PAPER))
    for level in ("error bound 10.5", "L2-optimal 11.3", "baseline 79.1"):
        assert level in text
    unknown = replace(analysis, floor_m_s=math.nan, floor_lsq_m_s=math.nan)
    text = words(learning.draw([unknown], PAPER)) + learning.caption([unknown])
    assert "bound" not in text and "nan" not in text
    two = [analysis, replace(analysis, name="2026-05-04_carl_thesis_model_01", floor_m_s=0.02)]
    text = words(learning.draw(two, PAPER))
    assert "error bound 10.5 (p4-lead1)" in text and "error bound 20.0 (model)" in text


def test_speeds_and_amplitudes_beat_by_beat(analyses: list[Analysis]) -> None:
    analysis = analyses[0]
    figure = trials.draw([analysis], PAPER)
    picked = trials.chosen(analysis)
    speed, amplitude = figure.axes
    for axes, name, unit in ((speed, "speed_m_s", 1e3), (amplitude, "applied_rad", 180 / math.pi)):
        curves = [x for x in axes.lines if str(x.get_gid()).startswith("beats")]
        assert len(curves) == len(picked)
        for line, (_, _, trial) in zip(curves, picked, strict=True):
            wanted = getattr(trial.beats, name).astype(float) * unit
            np.testing.assert_allclose(np.asarray(line.get_ydata(), float), wanted, rtol=1e-6)
            np.testing.assert_allclose(line.get_xdata(), np.arange(len(wanted)) + 0.5)
    marked = len(points(figure, "saturated"))
    assert marked == sum(row.saturated_beats for _, row, _ in picked) > 0
    assert "limit 29°" in words(figure)


def test_first_middle_best_and_last_are_chosen() -> None:
    errors = [0.06, 0.05, 0.04, 0.03, 0.02, 0.011, 0.013]
    picked = trials.chosen(made.series(errors))
    assert [(role, row.trial) for role, row, _ in picked] == [
        ("first", 1), ("middle", 3), ("best", 6), ("last", 7),
    ]  # fmt: skip
    falling = trials.chosen(made.series(errors[:6]))
    assert [(role, row.trial) for role, row, _ in falling] == [
        ("first", 1), ("middle", 3), ("best", 6),
    ]  # fmt: skip
    assert [role for role, *_ in trials.chosen(made.series([0.05]))] == ["best"]
    assert max(len(trials.chosen(made.series([0.05] * n))) for n in (1, 2, 3, 9, 30)) <= 5


def test_a_discarded_swim_is_never_chosen() -> None:
    analysis = made.series([0.06, 0.03, 0.001, 0.02])
    rows = [replace(row, decision="discard" if row.trial == 3 else "keep") for row in analysis.rows]
    picked = trials.chosen(replace(analysis, rows=rows))
    assert 3 not in [row.trial for _, row, _ in picked]
    assert [row.trial for role, row, _ in picked if role == "best"] == [4]


def test_gaps_stay_gaps_and_aborted_trials_end() -> None:
    whole = made.trial(1, 1, 0.02, gaps=(4, 10, 12))
    cut = made.trial(2, 2, 0.01, executed=13)
    analysis = made.analysis([whole, cut], [made.row(whole), made.row(cut)])
    figure = trials.draw([analysis], PAPER)
    lines = {str(x.get_gid()): x for x in figure.axes[0].lines}
    first = np.asarray(lines["beats trial 1, first: 20.0 mm/s"].get_ydata())
    assert np.flatnonzero(np.isnan(first)).tolist() == [4, 10, 12]
    dots = [x.get_xdata().tolist() for x in figure.axes[0].lines if x.get_marker() == "."]
    assert [11.5] in dots  # between two gaps a line would not show it
    for axes in figure.axes:
        line = [x for x in axes.lines if str(x.get_gid()).startswith("beats")][1]
        assert np.flatnonzero(np.isfinite(np.asarray(line.get_ydata()))).tolist() == [*range(13)]
    assert "trial 2 was cut short" in trials.caption([analysis])
    assert len(points(learning.draw([analysis], PAPER), "swims incomplete")) == 4


def test_contraction_with_noise_and_rollback() -> None:
    """The band by Student's t: 2.776 for four degrees of freedom."""
    analysis = made.series([0.06, 0.03, 0.045, 0.02], noise_m_s=0.002, noise_freedom=4)
    rows = [replace(row, rolled_back=row.trial == 3) for row in analysis.rows]
    analysis = replace(analysis, rows=rows)
    figure = contraction.draw([analysis], PAPER)
    drawn = sorted(points(figure, "contraction"))
    np.testing.assert_allclose(drawn, [(2, 0.5), (3, 1.5), (4, 0.02 / 0.045)], rtol=1e-5)
    np.testing.assert_allclose(points(figure, "rolled"), [(3, 1.5)], rtol=1e-5)
    assert "rolled back" in words(figure)
    half = 2.776445 * math.sqrt(2) * 0.002 / np.array([0.06, 0.03, 0.045])
    found = sorted(bars(figure, 0, "noise"))
    for (x, low, high), iteration, wide in zip(found, (2, 3, 4), half, strict=True):
        assert (x, low, high) == pytest.approx((iteration, 1 - wide, 1 + wide), rel=1e-3)


def test_noise_from_one_pair_is_told_as_rough() -> None:
    """12.7 times the square root of two: hardly any ratio proves anything."""
    analysis = made.series([0.06, 0.03, 0.02], noise_m_s=0.001, noise_freedom=1)
    figure = contraction.draw([analysis], PAPER)
    half = 12.7062 * math.sqrt(2) * 0.001 / np.array([0.06, 0.03])
    found = [high for _, _, high in sorted(bars(figure, 0, "noise"))]
    assert found == pytest.approx(1 + half, rel=1e-5)
    assert "from 1 pair: rough" in words(figure)
    assert "t = 12.7 (from 1 pair: rough)" in contraction.caption([analysis])
    assert "from 1 pair: rough" in headline(analysis)
    many = made.series([0.06, 0.03, 0.02], noise_m_s=0.001, noise_freedom=9)
    assert "9 degrees of freedom" in headline(many)
    assert "9 degrees of freedom" in words(contraction.draw([many], PAPER))
    assert "1, 9 degrees of freedom" in words(contraction.draw([analysis, many], PAPER))


def test_swims_before_the_board_began_anew_are_not_in_the_figures() -> None:
    analysis = made.series([0.06, 0.03, 0.02, 0.05, 0.04])
    rows = [
        replace(row, epoch=1, iteration=row.iteration - 3) if row.trial > 3 else row
        for row in analysis.rows
    ]
    analysis = replace(analysis, rows=rows)
    assert sorted({round(x) for x, _ in points(learning.draw([analysis], PAPER), "swims")}) == [
        1,
        2,
    ]
    drawn = points(contraction.draw([analysis], PAPER), "contraction")
    assert all(y in (rows[3].contraction, rows[4].contraction) for _, y in drawn)
    assert [row.trial for _, row, _ in trials.chosen(analysis)] == [4, 5]
    for module in (learning, contraction):
        caption = module.caption([analysis])
        assert "The board began anew; trials before that, not in this figure: 3." in caption
    assert "over 2 trials" in learning.caption([analysis])
    assert headline(analysis).startswith("Largest error over the beats: from 50.0 mm/s")
    shown = page([analysis], Material(), [])
    assert "<td>1 (epoch 1)</td>" in shown and shown.count("(epoch 1)") == 2


def test_an_undecided_swim_is_shown_as_such() -> None:
    analysis = made.series([0.06, 0.03, 0.001])
    rows = [replace(r, decision="", undecided=True) if r.trial == 3 else r for r in analysis.rows]
    analysis = replace(analysis, rows=rows, band=made.band_of(rows))
    figure = learning.draw([analysis], PAPER)
    assert len(points(figure, "swims undecided")) == 2 and "not decided on" in words(figure)
    assert "of which in no statistic: 1 not decided on" in learning.caption([analysis])
    assert 3 not in [row.trial for _, row, _ in trials.chosen(analysis)]
    assert [x for x, _ in points(contraction.draw([analysis], PAPER), "contraction")] == [2]
    shown = page([analysis], Material(), [])
    assert shown.count('class="gone"') == 1 and "not decided" in shown


def test_one_swim_is_not_swims() -> None:
    assert "over 1 trial." in learning.caption([made.series([0.06])])
    assert trials.caption([made.series([0.06])]).startswith("Trial 1 (iteration 1) of 1.")


def test_without_repeats_no_noise_is_claimed() -> None:
    analysis = made.series([0.06, 0.03], noise_m_s=math.nan)
    figure = contraction.draw([analysis], PAPER)
    assert bars(figure, 0, "noise") == [] and "noise" not in words(figure)
    assert "disturbances alone cause is unknown" in contraction.caption([analysis])


def test_comparison_shows_the_swims_that_count(analyses: list[Analysis]) -> None:
    from tailbeat.experiment.compare import compare, counted

    figure = comparison.draw(analyses, PAPER)
    for at, analysis in enumerate(analyses):
        values = 1e3 * np.array(counted(analysis))
        assert [y for _, y in points(figure, f"counted {at}")] == pytest.approx(values)
        mean, half = comparison.mean_and_interval(values)
        assert mean == pytest.approx(values.mean())
        assert len(values) == 2  # Student's t is 12.706 for them
        assert half == pytest.approx(12.7062 * values.std(ddof=1) / 2**0.5)
    shown = " ".join(words(figure).split())
    told = compare(analyses[1], analyses[0])
    side = "worse" if told.difference_m_s > 0 else "better"
    assert f"{abs(told.difference_m_s) * 1e3:.1f} mm/s {side}" in shown
    for edge_m_s in (told.difference_low_m_s, told.difference_high_m_s):
        assert f"{abs(edge_m_s) * 1e3:.1f}" in shown.partition("95 %: ")[2]
    assert f"n = {len(counted(analyses[0]))}" in shown


def test_too_few_to_compare_says_what_to_do() -> None:
    lone = made.series([0.06, 0.01])
    text = " ".join(words(comparison.draw([lone, replace(lone, name="b")], PAPER)).split())
    assert "more time" in text


# --------------------------------------------------------------- as it is printed


def test_printed_size_text_and_word(reported: Path) -> None:
    content = (reported / "learning.pdf").read_bytes()
    width, height = pdf_size_mm(content)
    assert width == pytest.approx(COLUMN_MM, abs=0.05)
    assert 40 < height < 180
    sizes = [
        float(size) for s in pdf_streams(content) for size in re.findall(rb"/F\d+ ([\d.]+) Tf", s)
    ]
    assert len(sizes) > 5 and min(sizes) >= 6.0
    assert pdf_text(content).splitlines().count("simulated") == 1
    assert b"/FontFile2" in content and b"/Subtype /Type3" not in content
    assert "p4" in pdf_text(content)


def test_nothing_is_cut_off_or_covered(analyses: list[Analysis]) -> None:
    for module, style in itertools.product((*MODULES.values(), comparison), (PAPER, PAGE)):
        figure = module.draw(analyses, style)
        assert figure.get_figwidth() == style.width_in
        assert figure.get_figheight() * 25.4 < 180
        figure.draw_without_rendering()
        drawn, legends = figure.get_tightbbox(), [x.get_window_extent() for x in figure.legends]
        width, height = figure.get_size_inches()
        assert drawn.x0 > -0.01 and drawn.x1 < width + 0.01, module.__name__
        assert drawn.y0 > -0.01 and drawn.y1 < height + 0.01, module.__name__
        (mark,) = [text for text in figure.texts if text.get_text() == "simulated"]
        for box in legends:
            assert box.x1 < figure.bbox.x1 + 1 and box.y1 < figure.bbox.y1 + 1
            assert not mark.get_window_extent().overlaps(box)
            assert box.y0 >= figure.axes[0].get_window_extent().y1 - 1
        texts = [text for text in figure.findobj(Text) if text.get_text()]
        assert min(text.get_fontsize() for text in texts) >= 6.0


@pytest.mark.parametrize("kind", ["pdf", "svg", "png"])
def test_same_figure_same_bytes(kind: str) -> None:
    analysis = made.series([0.06, 0.03, 0.012])
    once, again = (written(contraction.draw([analysis], PAPER), kind) for _ in range(2))
    assert once == again
    for stamp in (b"CreationDate", b"<dc:date>", b"Matplotlib v", b"matplotlib.org"):
        assert stamp not in once


def test_settings_of_this_computer_do_not_matter() -> None:
    import matplotlib as mpl

    analysis = made.series([0.06, 0.03])
    usual = written(contraction.draw([analysis], PAPER), "svg")
    with mpl.rc_context({"font.size": 30, "axes.facecolor": "red", "svg.fonttype": "none"}):
        assert written(contraction.draw([analysis], PAPER), "svg") == usual


def test_printed_png_is_one_column_wide() -> None:
    content = written(learning.draw([made.series([0.06])], PAPER), "png")
    assert int.from_bytes(content[16:20], "big") == round(COLUMN_MM / 25.4 * 300)


def test_grey_tells_conditions_apart() -> None:
    def luminance(colour: str) -> float:
        r, g, b = (int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5))
        return 0.299 * r + 0.587 * g + 0.114 * b

    greys = [luminance(look.colour) for look in LOOKS[:3]]
    assert max(greys) < 0.62  # dark enough on white
    assert len({(look.marker, str(look.dash)) for look in LOOKS}) == len(LOOKS)


# -------------------------------------------------------------------- the word simulated


@pytest.mark.parametrize("name", [*MODULES, "comparison"])
def test_simulated_is_said_and_never_of_a_real_fish(name: str) -> None:
    module: Any = {**MODULES, "comparison": comparison}[name]
    analysis = made.series([0.06, 0.03, 0.012, 0.012, 0.013])
    real = replace(analysis, simulated=False)
    pairs = {
        "simulated": [analysis, replace(analysis, name="b")],
        "": [real, replace(real, name="b")],
        "partly simulated": [real, replace(analysis, name="b")],
    }
    for mark, both in pairs.items():
        if name == "trials":
            both, mark = both[:1], mark if both[0].simulated else ""
        shown = words(module.draw(both, PAPER))
        assert [text for text in shown.split("\n") if text == mark and mark] == [mark] * bool(mark)
        if not mark:
            assert "simulated" not in shown + module.caption(both)
    if name != "trials":
        assert "b (simulated)" in shown
    else:
        svg = written(module.draw([real], PAPER), "svg").decode()
        assert "simulated" not in svg and "<!-- speed (mm/s) -->" in svg


def test_page_and_tables_say_simulated(reported: Path, analyses: list[Analysis]) -> None:
    text = (reported / "report.html").read_text()
    assert re.search(r"<title>[^<]*\(simulated\)</title>", text)
    assert re.search(r'<h1>[^\n]*<span class="mark">simulated</span>', text)
    captions = re.findall(r"<caption>(.*?)</caption>", text)
    assert len(captions) >= 3 and all("(simulated)" in caption for caption in captions)
    assert (reported / "captions.txt").read_text().count("Simulated.") == len(FIGURES)
    for path in (reported / "tables").glob("*.csv"):
        rows = list(csv.DictReader(path.open(encoding="utf-8")))
        assert rows and {row["simulated"] for row in rows} == {"True"}
    real = [replace(analysis, simulated=False, floor_by="identified") for analysis in analyses]
    assert "simulated" not in page(real, Material(), []).replace("simulated 7369", "")


# ------------------------------------------------------------------------------- the page


class Reader(HTMLParser):
    """Tags that stay open, addresses, headings, pictures."""

    VOID = ("meta", "img", "source", "br", "wbr")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def read(text: str) -> Reader:
    reader = Reader()
    reader.feed(text)
    assert reader.open == []
    return reader


def test_page_needs_nothing_else(reported: Path) -> None:
    text = (reported / "report.html").read_text()
    reader = read(text)
    tags = {tag for tag, _ in reader.tags}
    assert not tags & {"script", "link", "iframe", "object", "embed", "i", "b"}
    for _, attributes in reader.tags:
        for key in ("src", "href", "srcset"):
            assert (attributes.get(key) or "data:").startswith("data:image/svg+xml;base64,") or (
                key not in attributes
            )
    pictures = re.findall(r"data:image/svg\+xml;base64,([A-Za-z0-9+/=]+)", text)
    assert len(pictures) == 2 * len(FIGURES)
    outside = re.sub(r"base64,[A-Za-z0-9+/=]+", "", text)
    for part in (outside, *(base64.b64decode(picture).decode() for picture in pictures)):
        bare = re.sub(r'xmlns(:\w+)?="[^"]*"|"http://www.w3.org/[^"]*"', "", part)
        bare = re.sub(r"<!DOCTYPE svg.*?>", "", bare, flags=re.S)
        bare = re.sub(r"<metadata>.*?</metadata>", "", bare, flags=re.S)
        assert "http" not in bare and "@import" not in bare and "url(h" not in bare


def test_page_can_be_heard(reported: Path) -> None:
    reader = read((reported / "report.html").read_text())
    headings = [tag for tag, _ in reader.tags if re.fullmatch(r"h\d", tag)]
    assert headings.count("h1") == 1 and headings[0] == "h1" and set(headings) == {"h1", "h2"}
    pictures = [attributes for tag, attributes in reader.tags if tag == "img"]
    assert len(pictures) == len(FIGURES)
    assert all(len(attributes.get("alt") or "") > 30 for attributes in pictures)
    assert ("html", {"lang": "en"}) in reader.tags
    headers = [a for tag, a in reader.tags if tag == "th"]
    assert headers and all(a.get("scope") in ("row", "col") for a in headers)


def test_page_tells_every_swim(reported: Path, analyses: list[Analysis]) -> None:
    text = (reported / "report.html").read_text()
    table = text.split("<h2>Trials</h2>")[1].split("<h2>")[0]
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", table, re.S)[1:]
    assert len(rows) == len(analyses[0].rows) == len(DAY)
    for cells, row in zip(rows, analyses[0].rows, strict=True):
        for shown in (f"{row.max_abs_error_m_s * 1e3:.2f}", row.decision, row.end, row.file):
            assert f">{shown}<" in cells
    assert table.count('class="gone"') == 2 and table.count('class="best"') == 1
    assert "abort: as &lt;planned&gt; &amp; said" in table
    assert "aborted:" in table


def test_names_with_tags_stay_text(reported: Path) -> None:
    text = (reported / "report.html").read_text()
    assert "&lt;i&gt;soft&lt;/i&gt;" in text and "&lt;b&gt;&amp; still&lt;/b&gt;" in text
    evil = made.series([0.06, 0.02], fish="<html>", name='a"<html>_$x^2$', law="<script>")
    shown = page(
        [evil], Material(notes="- **now** <html>", settings={"params": {"<p>": "<q>"}}), []
    )
    reader = read(shown)
    assert [tag for tag, _ in reader.tags].count("html") == 1
    assert "script" not in {tag for tag, _ in reader.tags}
    both = [evil, replace(evil, name="<html>")]
    assert "<html>" in words(comparison.draw(both, PAPER))


def test_who_what_and_how_warm_is_on_the_page() -> None:
    analysis = made.series([0.06], conditions={"water_temperature_degc": 21.5, "wall": "glass"})
    settings = {"operator": "Ada & Bo", "configuration": "fin 3, 40 g of lead"}
    table = page([analysis], Material(settings=settings), []).split("<h2>Conditions</h2>")[1]
    cells = dict(
        re.findall(r'<th scope="row">(.*?)</th><td>(.*?)</td>', table.split("</table>")[0])
    )
    assert cells["operator"] == "Ada &amp; Bo"
    assert cells["configuration"] == "fin 3, 40 g of lead"
    assert cells["water temperature"] == "21.5 °C"
    assert cells["fish"] == "carl" and cells["wall"] == "glass"
    bare = page([replace(analysis, conditions={})], Material(), [])
    assert bare.count("<td>not recorded</td>") >= 3


def test_notes_keep_their_times(reported: Path) -> None:
    text = (reported / "report.html").read_text()
    assert "<li><time>2026-05-04 12:00:00</time> water 21.5 °C" in text


def test_headline_has_the_numbers(analyses: list[Analysis]) -> None:
    analysis = made.series([0.06, 0.03, 0.02, 0.012], noise_m_s=0.0015)
    line = headline(analysis)
    assert line.startswith("Largest error over the beats: from 60.0 mm/s")
    for part in ("12.0 mm/s in one trial, 4", "never repeated", "85 % less", "79.1", "10.5",
                 "scatter by 1.5 mm/s"):  # fmt: skip
        assert part in line
    assert re.search(r"mean of \d trials of the best input", headline(analyses[0]))
    nothing = replace(analysis, rows=[replace(row, decision="discard") for row in analysis.rows])
    assert "none of 4 trials" in headline(nothing) and "4 discarded" in headline(nothing)


# ------------------------------------------------------------------------------ edge cases


def nan_row(number: int) -> tuple[Any, Any]:
    blind = made.trial(number, number, 0.02, gaps=range(made.BEATS))
    assert math.isnan(blind.max_abs_error_m_s())
    return blind, made.row(blind)


def edge(name: str) -> Analysis:
    trial = made.trial(1, 1, 0.03)
    if name == "one trial":
        return made.analysis([trial], [made.row(trial)], noise_m_s=math.nan)
    if name == "not identified":
        return made.series([0.06, 0.03], floor_m_s=math.nan, floor_lsq_m_s=math.nan, floor_by="")
    if name == "all discarded":
        recorded = [made.trial(n, 1, 0.03) for n in (1, 2, 3)]
        return made.analysis(recorded, [made.row(one, "discard") for one in recorded])
    if name == "all blind":
        both = [nan_row(n) for n in (1, 2)]
        return made.analysis([x for x, _ in both], [x for _, x in both], noise_m_s=math.nan)
    if name == "one blind":
        blind, row = nan_row(2)
        return made.analysis([trial, blind], [made.row(trial), row])
    if name == "all aborted":
        recorded = [made.trial(n, 1, 0.03, executed=5 * n) for n in (1, 2)]
        return made.analysis(recorded, [made.row(one) for one in recorded])
    if name == "aborted before the first beat":
        cut = made.trial(2, 2, 0.03, executed=0)
        return made.analysis([trial, cut], [made.row(trial), made.row(cut)])
    if name == "60 iterations":
        return made.series([0.01 + 0.05 * 0.9**n for n in range(60)])
    if name == "2 beats":
        short = [made.trial(n, n, 0.002 / n, beats=2) for n in (1, 2, 3)]
        return made.analysis(short, [made.row(one) for one in short])
    if name == "no error":
        return made.series([0.0, 0.0])
    raise AssertionError(name)


EDGES = ("one trial", "not identified", "all discarded", "all blind", "one blind", "all aborted",
         "aborted before the first beat", "60 iterations", "2 beats", "no error")  # fmt: skip


RENDERED = ("one trial", "all blind", "2 beats", "no error")  # odd axes


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", EDGES)
def test_edges(name: str) -> None:
    analysis = edge(name)
    both = [analysis, replace(analysis, name="other")]
    for module in MODULES.values():
        figure = module.draw([analysis], PAPER)
        if name in RENDERED:
            figure.set_layout_engine("none")  # half of the time, and tested elsewhere
            figure.draw_without_rendering()
        assert "nan" not in words(figure) + module.caption([analysis])
    assert "nan" not in words(comparison.draw(both, PAPER))
    assert "nan" not in comparison.caption(both)
    assert "nan" not in headline(analysis).split() and len(headline(analysis)) > 20
    measured = sum(math.isfinite(r.max_abs_error_m_s) for r in analysis.rows)
    shown = len(points(learning.draw([analysis], PAPER), "swims"))
    assert shown == (0 if name == "no error" else 2 * measured)


def test_sixty_iterations_stay_readable() -> None:
    figure = learning.draw([edge("60 iterations")], PAPER)
    figure.draw_without_rendering()
    boxes = [t.get_window_extent() for t in figure.axes[1].get_xticklabels() if t.get_text()]
    assert 3 <= len(boxes) <= 12
    assert all(a.x1 < b.x0 for a, b in itertools.pairwise(boxes))


def test_labels_are_what_differs() -> None:
    one = made.series([0.06])
    names = ["2026-05-04_carl_thesis_p4_01", "2026-05-05_carl_thesis_p4_01"]
    assert labels([replace(one, name=name) for name in names]) == ["2026-05-04", "2026-05-05"]
    assert labels([one, one]) == ["? [1]", "? [2]"] or len(set(labels([one, one]))) == 2
    assert max(len(x) for x in labels([replace(one, name="x" * 300), one])) < 60


def test_more_conditions_than_looks_are_refused() -> None:
    with pytest.raises(InputError, match="at most 6"):
        learning.draw([made.series([0.06])] * 7, PAPER)


# ---------------------------------------------------------------------- files and command


def test_all_files_are_there(reported: Path) -> None:
    names = {str(path.relative_to(reported)) for path in reported.rglob("*") if path.is_file()}
    figures = {f"{name}.{kind}" for name in FIGURES for kind in ("pdf", "svg")}
    tables = {f"tables/{name}.csv" for name in ("trials", "beats", "slots", "comparison")}
    tables |= {"tables/trials.mat"}
    tables |= {f"tables/{name}.parquet" for name in ("trials", "beats", "slots")}
    beside = {"report.html", "captions.txt", "report.json", "analysis.json"}
    assert names == figures | tables | beside
    told = json.loads((reported / "report.json").read_text())
    assert told["paper"] is True and len(told["against"]) == 1


def test_tables_read_back(reported: Path, analyses: list[Analysis]) -> None:
    tables, rows = reported / "tables", analyses[0].rows
    errors = [row.max_abs_error_m_s for row in rows]
    listed = list(csv.DictReader((tables / "trials.csv").open(encoding="utf-8")))
    assert [float(row["max_abs_error_m_s"]) for row in listed] == errors
    assert [row["decision"] for row in listed] == [row.decision for row in rows]
    mat = loadmat(tables / "trials.mat")
    assert mat["max_abs_error_m_s"].ravel() == pytest.approx(errors)
    assert mat["speed_m_s"].shape == (len(DAY), 12)
    parquet = pq.read_table(tables / "beats.parquet").to_pydict()
    speeds = np.concatenate([trial.beats.speed_m_s for trial in analyses[0].trials])
    np.testing.assert_array_equal(np.array(parquet["speed_m_s"], np.float32), speeds)
    assert set(parquet["simulated"]) == {True}
    (best, _) = csv.DictReader((tables / "comparison.csv").open(encoding="utf-8"))
    assert int(best["swims"]) >= 2 and best["what"] == "max"
    low, middle, high = (float(best[f"{x}_m_s"]) for x in ("low", "difference", "high"))
    assert low < middle < high
    assert all(float(best[name]) == float(f"{float(best[name]):.6g}") for name in ("p", "hedges_g"))
    for name in ("rms_error_m_s", "contraction", "noise_high", "noise_m_s", "distance_m"):
        known = [float(row[name]) for row in listed if row[name]]
        assert known and known == [float(f"{value:.9g}") for value in known]
        assert mat[name].ravel()[: len(rows)] == pytest.approx(
            [float(row[name] or "nan") for row in listed], nan_ok=True
        )
    assert {row["noise_freedom"] for row in listed} == {str(analyses[0].noise_freedom)}
    assert {row["epoch"] for row in listed} == {"0"} and {row["undecided"] for row in listed} == {
        "False"
    }


def test_command(
    days: tuple[Experiment, Experiment],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tailbeat.report.paper.draw_all", lambda _: [])
    root = tmp_path / "all"
    shutil.copytree(days[0].folder.parent, root)
    first, second = sorted(path for path in root.iterdir() if path.is_dir())
    later = Experiment.open(first)
    later.write_settings({"made": (NOON + timedelta(days=1)).astimezone().isoformat()})
    assert run(["report", "--root", str(root)]) == 0
    out = capsys.readouterr().out
    assert out.splitlines() == [f"the newest: {first}", str(first / "report" / "report.html")]
    assert not (first / "report" / "learning.pdf").exists()
    assert (first / "analysis.json").is_file()
    out_folder = tmp_path / "elsewhere"
    assert run(["report", str(second), "--out", str(out_folder), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["page"] == str(out_folder / "report.html")
    assert document["figures"] == document["tables"] == []
    assert not (second / "report").exists()


def test_command_says_what_is_wrong(
    tmp_path: Path, days: tuple[Experiment, Experiment], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["report", "--root", str(tmp_path)]) != 0
    err = capsys.readouterr().err
    assert "no experiment below" in err and err.count("\n") == 1
    empty = Experiment.new(tmp_path, "carl", "other", "p", NOON)
    assert run(["report", str(empty.folder)]) != 0
    assert "holds no trials" in capsys.readouterr().err
    place = tmp_path / "file"
    place.write_text("")
    assert run(["report", str(days[0].folder), "--out", str(place / "x")]) != 0
    err = capsys.readouterr().err
    assert "cannot write the report" in err and "--out" in err


def test_another_reference_is_refused(days: tuple[Experiment, Experiment], tmp_path: Path) -> None:
    other = Experiment(tmp_path / "other")
    shutil.copytree(days[1].folder, other.folder)
    shutil.rmtree(other.raw)
    other.raw.mkdir()
    for path in days[1].trial_files():
        other.add_raw(path.name, path.read_bytes())
    analysis = analyse(other)
    from tailbeat.report.paper import require_one_reference

    require_one_reference([analyse(days[0]), analysis])
    with pytest.raises(InputError, match="Compare experiments of one reference"):
        require_one_reference([analyse(days[0]), replace(analysis, reference_crc=1)])


def test_old_comparison_is_not_left_behind(
    days: tuple[Experiment, Experiment], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A report made again has no figure that is older than its page."""
    monkeypatch.setattr("tailbeat.report.paper._tables", lambda *_: [])
    drawing = Drawing(Picture("learning", b"", b"<svg/>", "caption", "text"), Figure())
    monkeypatch.setattr("tailbeat.report.paper.draw_all", lambda _: [drawing])
    for name in ("learning.pdf", "comparison.pdf", "comparison.svg"):
        (tmp_path / name).write_bytes(b"old")
    made_again = write_report(days[0], folder=tmp_path)
    assert tmp_path / "learning.pdf" in made_again.figures
    assert (tmp_path / "learning.pdf").read_bytes()[:4] == b"%PDF"
    assert not (tmp_path / "comparison.pdf").exists()
    assert not (tmp_path / "comparison.svg").exists()
