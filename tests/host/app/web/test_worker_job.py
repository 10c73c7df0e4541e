"""The guided job on the page: unknown fish to report, what may be set, what is written down."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tailbeat.app.web.state import PageState
from tailbeat.app.web.worker import Worker, simulated_camera
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.reference import from_text
from tailbeat.experiment.library import FOLDER_VARIABLE
from tailbeat.learning import fit
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.sim.board import SimBoard, SimTransport

from ...guided_page import start_on_page

PATIENCE_S = 600.0  # wall time; a bound on what hangs


@pytest.fixture(autouse=True)
def quickly(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without a bootstrap, which takes seconds and is tested elsewhere."""
    monkeypatch.setattr(fit, "bootstrap", lambda *_, **__: [])
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "fish"))


@pytest.fixture
def worker(tmp_path: Path) -> Iterator[Worker]:
    board = SimBoard("tank", seed=5, tail_centre_rad=0.03)
    made = Worker(
        lambda: Fish(SimTransport(board)),
        tmp_path / "experiments",
        simulated_camera,
        PreflightLimits(rest_s=1.0),
        look_s=0.005,
        retry_s=0.0,
    )
    made.start()
    made.screen.wait(lambda now: now.phase == "idle", PATIENCE_S)
    yield made
    made.close()


def test_from_an_unknown_fish_to_a_report(worker: Worker) -> None:
    now, asked = start_on_page(worker, "1", "new")
    assert now.problem == "" and [one.name for one in now.guide] == [
        "health", "commission", "tank", "trim", "measure", "limit", "law", "reference", "trials",
    ]  # fmt: skip
    assert all(one.done for one in now.guide)
    assert sum("To allow it, type" in question for question in asked) == 1
    assert now.amplitude_max_rad is not None and now.amplitude_max_rad > 0.5
    assert len(now.rows) == len(now.curves) == 1 and len(now.reference_m_s) == 40
    assert None not in now.curves[0].speed_m_s and "model-based" in now.law
    assert now.reported and worker.trials.report_page() is not None
    assert now.track and now.room_m == pytest.approx(2.64, abs=0.01)
    assert now.end_walls_m == pytest.approx((-0.16, 2.84), abs=0.01)
    assert now.start_pose[:2] == pytest.approx((0.0, 0.0), abs=0.05)
    assert now.made_by[0].startswith("model-based (")
    trials = worker.trials.experiment
    again, asked = start_on_page(worker, "1", "new")
    assert len(again.rows) == 2 and worker.trials.experiment is trials
    assert "skipped" in next(one.words for one in again.guide if one.name == "commission")
    _limits(worker)


def _limits(worker: Worker) -> None:
    """Of a fish that is known: as far as a run went, and no farther."""
    was = worker.now.amplitude_max_rad
    assert was is not None
    now = done(worker, "set", name="AMP_MAX_RAD", value="0,45")
    assert now.amplitude_max_rad == pytest.approx(0.45) and not now.problem
    assert done(worker, "set", name="AMP_MAX_RAD", value=f"{was}").problem == ""
    now = done(worker, "set", name="AMP_MAX_RAD", value="1.0")
    assert "may not become 1.00" in now.problem
    assert now.amplitude_max_rad == pytest.approx(was)


def done(worker: Worker, what: str, **values: object) -> PageState:
    before = worker.now.done
    worker.ask(what, **values)
    return worker.screen.wait(lambda now: now.done > before and now.phase == "idle", PATIENCE_S)


def test_parameters_are_read_when_somebody_looks(worker: Worker) -> None:
    assert worker.now.params == ()
    now = done(worker, "params")
    gain = next(one for one in now.params if one.name == "ILC_GAIN")
    assert gain.text and len(now.params) > 50
    now = done(worker, "set", name="ILC_GAIN", value="2.5")
    assert next(one for one in now.params if one.name == "ILC_GAIN").value == pytest.approx(2.5)
    now = done(worker, "set", name="ILC_GAIN", value="-3")
    assert "ILC_GAIN" in now.problem and now.failed == "ILC_GAIN"  # shown beside it
    with pytest.raises(InputError, match="is no number"):
        worker.ask("set", name="ILC_GAIN", value="much")
    now = done(worker, "set", name="AMP_MAX_RAD", value="0.7")
    assert "was not measured" in now.problem
    assert now.problem.endswith("Measure the fish: START with 'Commissioning: again'")


def test_health_is_a_step_of_its_own(worker: Worker) -> None:
    now = done(worker, "health")
    assert [(one.name, one.done) for one in now.guide] == [("health", True)]
    assert re.search("battery.*well", now.guide[0].words)


def test_nothing_is_reported_before_a_trial(worker: Worker) -> None:
    now = done(worker, "report")
    assert "nothing to report" in now.problem and now.failed == "report"
    assert done(worker, "upload", reference=from_text("trapezoid:0.06,2,4")).failed == ""
    now, asked = start_on_page(worker, "1", "never")
    assert asked == [] and now.guide == () and len(now.rows) == 1
    assert done(worker, "report").reported
    now = done(worker, "upload", reference=from_text("trapezoid:0.05,2,4"))
    assert now.experiment == "" and not now.reported, "the link would lead to nothing"
