"""Laws that average (ILC_KIND 1, 2): what the board learns from its earlier trials, foretold and
recomputed; and laws that are none for a fish."""

from __future__ import annotations

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.core import records, reference
from tailbeat.core.arrays import F32, F64
from tailbeat.core.errors import InputError, Refused
from tailbeat.core.faults import LAW_FEEDBACK, LAW_SIGN
from tailbeat.core.law import PAST_KINDS, Averaging, Law
from tailbeat.core.law_memory import LawMemory, Memory, PastTrial
from tailbeat.session.next_input import dry_run
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

MEAN, WINDOW = PAST_KINDS["mean"].number, PAST_KINDS["window"].number

Array = F64
Floats = F32

ZERO_INPUT_ERROR_M_S = 0.0791
UPLOAD = 1  # SPD_SOURCE


ENOUGH = StopReason(StopKind.CALLER, "enough")


def prepare(fish: Fish, kind: int, **params: float) -> None:
    for name, value in {"ILC_KIND": kind, "ROLLBACK_RATIO": 0, **params}.items():
        fish.params.set(name, value)
    fish.upload_reference(reference.cosine(0.06, 4.0, 6.0).record())


def trial(fish: Fish, cut: bool = False) -> None:
    frames = iter(range(100000))
    run_trial(fish, guard=lambda _: ENOUGH if cut and next(frames) > 200 else None)
    if cut:
        fish.clear()


def learn_as_foretold(fish: Fish, cut: bool = False) -> Floats:
    """The dry run must say the same, bit for bit; the next amplitudes."""
    trial(fish, cut)
    foretold = dry_run(fish)
    learned = fish.learn()
    held = fish.amplitudes().values
    assert foretold.amplitude_rad.tobytes() == held.tobytes()
    assert foretold.rolled_back == learned.rolled_back
    return held


def trials_kept(fish: Fish) -> int:
    """Trials in the average, by the newest record."""
    record = fish.past_record(records.past_path(fish.status().iteration - 1))
    assert record is not None
    return records.decode_past(record).trials


@pytest.mark.parametrize(
    ("kind", "params"),
    [
        (MEAN, {"ILC_LEAD": 1}),
        (MEAN, {"ILC_DECR_RATE": 0.7, "ILC_DECR_FROM": 1, "ILC_Q_LEN": 2, "ILC_EXTRAP": 2}),
        (WINDOW, {"ILC_KD": 0.3, "ILC_LEAD": 0.5}),
        (WINDOW, {"ILC_WINDOW": 8, "ILC_END_EXT": 2, "ILC_LEAD": 2}),
    ],
)
def test_every_trial_of_a_series_is_foretold(
    fish: Fish, kind: int, params: dict[str, float]
) -> None:
    prepare(fish, kind, **params)
    most = 6 if kind == MEAN else fish.params.get("ILC_WINDOW").value
    for number in range(1, 7):
        learn_as_foretold(fish, cut=number % 3 == 0)
        assert trials_kept(fish) == min(number, most)


@pytest.mark.parametrize("kind", [MEAN, WINDOW])
def test_an_average_that_begins_anew_is_foretold(fish: Fish, kind: int) -> None:
    prepare(fish, kind)
    for _ in range(3):
        learn_as_foretold(fish)
    fish.restore_best()
    learn_as_foretold(fish)
    assert trials_kept(fish) == 1
    learn_as_foretold(fish)
    assert trials_kept(fish) == 2
    fish.upload_amplitudes(fish.amplitudes().values)
    learn_as_foretold(fish)
    assert trials_kept(fish) == 1


def test_a_roll_back_of_an_average_is_foretold(fish: Fish) -> None:
    prepare(fish, WINDOW, ROLLBACK_RATIO=1.3)
    for _ in range(4):
        learn_as_foretold(fish)
    best = fish.amplitudes(best=True)
    for _ in range(2):
        fish.upload_amplitudes(np.zeros(best.beats))
        learn_as_foretold(fish)
    assert fish.amplitudes().values.tobytes() == best.values.tobytes()
    learn_as_foretold(fish)
    assert trials_kept(fish) == 1


def test_an_average_looks_at_more_than_the_last_trial(fish: Fish) -> None:
    """Else the foretelling would prove nothing: the law of the last trial gives something else."""
    prepare(fish, WINDOW)
    learn_as_foretold(fish)
    trial(fish)
    averaged = dry_run(fish).amplitude_rad
    fish.params.set("ILC_KIND", 0)
    assert not np.allclose(averaged, dry_run(fish).amplitude_rad, atol=1e-4)
    fish.params.set("ILC_KIND", 2)
    assert dry_run(fish).amplitude_rad.tobytes() == averaged.tobytes()


def series(beats: int, seed: int) -> tuple[list[Array], list[Array]]:
    """(amplitudes, errors) of trials, some beats unmeasured (NaN)."""
    rng = np.random.default_rng(seed)
    amplitudes = [rng.uniform(0.0, 0.6, beats) for _ in range(6)]
    errors = [rng.uniform(-0.05, 0.05, beats) for _ in range(6)]
    for cut, error in zip((10, 4, 10, 7, 10, 2), errors, strict=True):
        error[cut:] = np.nan
    return amplitudes, errors


def next_of(past: Averaging, earlier: list[PastTrial], u: Array, e: Array) -> Floats:
    law = Law(kp_rad_s_m=3.0, amplitude_max_rad=0.5)
    memory = Memory(5, u.astype(np.float32), 0, np.zeros(len(u), np.float32), 0.0, 0)
    measured = np.isfinite(e)
    learner = LawMemory.of(memory, past, earlier)
    learner.learn(law, np.where(measured, e, 0.0), measured, True)
    return learner.amplitude_rad


def test_a_moving_average_is_that_of_plain_numpy() -> None:
    amplitudes, errors = series(10, 1)
    kept = [
        PastTrial(np.clip(u, 0, 0.5).astype(np.float32), e.astype(np.float32))
        for u, e in zip(amplitudes, errors, strict=True)
    ]
    for window in (2, 3, 6, 8):
        found = next_of(
            Averaging(WINDOW, window), kept[-2 : -window - 1 : -1], amplitudes[-1], errors[-1]
        )
        last = slice(-min(window, 6), None)
        u = np.mean([np.clip(u, 0, 0.5) for u in amplitudes[last]], axis=0)
        e = np.mean([np.nan_to_num(e) for e in errors[last]], axis=0)
        np.testing.assert_allclose(found, u + 3.0 * e, atol=2e-6)


def test_a_mean_is_that_of_plain_numpy() -> None:
    """(2.10): with i + 2 times the gain in iteration i, here 5."""
    amplitudes, errors = series(10, 2)
    u = np.array([np.clip(u, 0, 0.5) for u in amplitudes])
    e = np.nan_to_num(np.array(errors))
    mean = PastTrial(u[:-1].mean(0).astype(np.float32), e[:-1].mean(0).astype(np.float32), 5)
    found = next_of(Averaging(MEAN), [mean], amplitudes[-1], errors[-1])
    np.testing.assert_allclose(found, u.mean(0) + 7 * 3.0 * e.mean(0), atol=3e-6)


def test_a_mean_with_kd_is_refused(fish: Fish) -> None:
    prepare(fish, MEAN, ILC_KD=0.1)
    with pytest.raises(Refused) as refused:
        fish.arm()
    assert refused.value.name == "BAD_LAW"
    assert "ILC_KIND 1" in refused.value.remedy
    with pytest.raises(InputError, match="law does not fit"):
        empty = Memory(1, np.zeros(2, np.float32), 0, np.zeros(2, np.float32), 0.0, 0)
        learner = LawMemory.of(empty, Averaging(MEAN))
        learner.learn(Law(kd_rad_s2_m=0.1), [0.1, 0.1], [True, True], True)


@pytest.mark.parametrize(("kind", "number"), [(3, LAW_FEEDBACK), (4, LAW_FEEDBACK), (5, LAW_SIGN)])
def test_laws_that_are_none_for_a_fish(fish: Fish, kind: int, number: int) -> None:
    fish.params.set("ILC_KIND", 2)
    with pytest.raises(Refused) as refused:
        fish.params.set("ILC_KIND", kind)
    assert refused.value.number == number
    assert "ILC_KIND 0, 1 or 2" in refused.value.remedy
    assert fish.params.get("ILC_KIND").value == 2


def test_params_set_prints_why(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    board = SimBoard("tank")
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(board))
    for kind, why in {"4": "needs the speed during the trial", "5": "throw the tail about"}.items():
        assert run(["params", "set", "ILC_KIND", kind, "--connect", "it"]) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert why in err and "ILC_KIND 0, 1 or 2" in err


def test_a_damaged_past_trial_is_none(fish: Fish) -> None:
    prepare(fish, WINDOW)
    trial(fish)
    fish.learn()
    record = fish.past_record(records.past_path(1))
    assert record is not None
    found = records.decode_past(record)
    learned = fish.learned_record()
    assert learned is not None
    assert found.learned_crc == records.record_crc(learned)
    assert (found.previous_crc, found.kind, found.trials) == (0, WINDOW, 1)
    for damaged in (record[:-1], record[:-1] + bytes([record[-1] ^ 1]), b"TBXX" + record[4:]):
        with pytest.raises(InputError, match="not a sound past trial"):
            records.decode_past(damaged)


@pytest.mark.parametrize(("past", "gain"), [(Averaging(MEAN), 2.0), (Averaging(WINDOW, 3), 4.0)])
def test_a_fish_learns_with_an_average(past: Averaging, gain: float) -> None:
    with Fish.connect("sim:tank", seed=1) as fish:
        settings = {
            "AMP_MAX_RAD": 0.785398,
            "DU_MAX_RAD": 0,
            "ILC_GAIN": gain,
            "ILC_LEAD": 1,
            "ILC_KIND": past.kind,
            "ILC_WINDOW": past.window,
        }
        for name, value in settings.items():
            fish.params.set(name, value)
        fish.upload_reference(reference.thesis().record())
        errors = [fish.learn(run_trial(fish).number).max_abs_error_m_s for _ in range(8)]
        amplitudes = fish.amplitudes().values
    print(f"\n{past.label()}: max|e| {', '.join(f'{e * 1e3:.1f}' for e in errors)} mm/s")
    assert min(errors[4:]) < 0.25 * ZERO_INPUT_ERROR_M_S
    assert np.all(np.isfinite(amplitudes)) and amplitudes.max() <= 2 * 0.785398
