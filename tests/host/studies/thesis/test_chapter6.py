"""Chapter 6: goldens recomputed independently, other settings against plain numpy and scipy."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from tailbeat.core.errors import InputError
from tailbeat.core.parallel import one_thread
from tailbeat.studies.thesis import chapter6
from tailbeat.studies.thesis.example import (
    CONFIRMED,
    NOT_CONFIRMED,
    READING,
    VERDICTS,
    Claim,
    ExampleOptions,
)
from tailbeat.studies.thesis.learner import LearnerConfig, Precision
from tailbeat.studies.thesis.plants import rod
from tailbeat.studies.thesis.plants.heat import (
    CHAPTER6,
    HeatPlant,
    Scheme,
    problem,
    reference,
    slope,
    times,
    zero_phase,
)
from tailbeat.studies.thesis.study import Study

(EXAMPLE,) = chapter6.EXAMPLES
PRECISIONS = get_args(Precision)

G6 = {
    "modal": "52.469444 14.637351 4.050000 1.117498 0.309328 0.086640 0.028726 0.017485 0.018686 "
    "0.019051 0.019163",
    "crank-nicolson": "52.469447 14.637412 4.050029 1.117509 0.309331 0.086639 0.028721 0.017489 "
    "0.018689 0.019054 0.019166",
    "backward-euler": "52.519447 14.613588 4.035085 1.111400 0.307251 0.086108 0.028790 0.017518 "
    "0.018737 0.019123 0.019238",
}


@pytest.fixture(autouse=True)
def _alone() -> Iterator[None]:
    """As examples are computed: small matrices are slower on many threads."""
    with one_thread():
        yield


def numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def rounded(values: np.ndarray, text: str) -> bool:
    """Whether they are the text's, to its last digits."""
    words = text.split()
    return all(
        abs(value - float(word)) <= 0.51 * 10.0 ** -len(word.partition(".")[2]) + 1e-5 * abs(value)
        for value, word in zip(values, words, strict=False)
    )


@cache
def plant(scheme: Scheme = "backward-euler", step: float = 0.01, cells: int = 100) -> HeatPlant:
    return HeatPlant(CHAPTER6, step, scheme, cells)


def exact(iterations: int, **changes: float) -> np.ndarray:
    return rod.exact(rod.law(**changes), iterations)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("scheme", get_args(Scheme))
def test_g6(scheme: Scheme, precision: Precision) -> None:
    run = problem(plant(scheme), rod.law()).run(10, precision=precision)
    assert run.max_abs_error[0] == pytest.approx(numbers(G6[scheme]), rel=1e-5, abs=1e-5)


def test_the_default_is_backward_euler_to_iteration_7() -> None:
    run = EXAMPLE.run(ExampleOptions())
    assert run.iterations.tolist() == list(range(8))
    assert run.max_abs_error == pytest.approx(numbers(G6["backward-euler"])[:8], rel=1e-5, abs=1e-5)


def test_inputs_of_iterations_1_and_7() -> None:
    first, _ = EXAMPLE.run(ExampleOptions(iterations=1)).traces.trial()
    at = [0, 1, 10, 20, 100, 300, 500, 700, 900, 990, 1000]
    wanted = "-0.106769 -0.11106 -0.157699 -0.201413 0.521402 1.503718 -3.929479 -9.339487 "
    assert first[at] == pytest.approx(numbers(wanted + "-8.330456 -7.586109 -7.601905"), abs=2e-6)
    seventh, _ = EXAMPLE.run(ExampleOptions()).traces.trial()
    wanted = "-0.49566 1.005547 1.745744 -6.019138 -12.780361 -10.890771 -10.243768"
    at = [0, 100, 300, 500, 700, 900, 1000]
    assert seventh[at] == pytest.approx(numbers(wanted), abs=1e-5)
    on_modes, _ = problem(plant(scheme="modal"), rod.law()).run(7).trial()
    assert [on_modes.min(), on_modes.max()] == pytest.approx([-13.044, 2.543], abs=5e-4)


@pytest.mark.parametrize(
    ("step", "wanted"),
    [
        (0.02, "52.569 14.552 4.0017 1.0983 .30261 .08456 .0288 .01739"),
        (0.005, "52.494 14.644 4.0518 1.1180 .30961 .08691 .02876 .01753"),
    ],
)
def test_other_steps_keep_the_window(step: float, wanted: str) -> None:
    run = EXAMPLE.run(ExampleOptions(step=step))
    assert run.max_abs_error == pytest.approx(numbers(wanted), rel=5e-4)
    assert rod.law(step).q_len == {0.02: 10, 0.005: 40}[step]


def test_coarser_cells() -> None:
    run = problem(plant("crank-nicolson", cells=50), rod.law()).run(7)
    wanted = numbers("52.4695 14.6376 4.0501 1.1176 .30935 .08665 .02872 .01749")
    assert run.max_abs_error[0] == pytest.approx(wanted, rel=3e-4)


def test_euler_in_quarters_of_a_sample() -> None:
    run = problem(HeatPlant(CHAPTER6, substeps=4), rod.law()).run(10)
    wanted = "52.48195 14.63146 4.04629 1.11598 .30881 .08651 .02874 .01749 .0187 .01907 .01918"
    assert run.max_abs_error[0] == pytest.approx(numbers(wanted), rel=3e-4)


def test_finer_steps_come_to_the_exact_rod() -> None:
    exactly = numbers(G6["modal"])[:8]
    off = [
        np.abs(EXAMPLE.run(ExampleOptions(step=step)).max_abs_error - exactly).max()
        for step in (0.02, 0.01, 0.005)
    ]
    assert off[0] > 1.8 * off[1] > 1.8**2 * off[2] and off[2] < 0.03


def test_the_limit_and_its_rms() -> None:
    run = problem(plant(scheme="modal"), rod.law()).run(50, keep=(0, 1, 7))
    errors = run.max_abs_error[0]
    assert errors[11:] == pytest.approx(0.0193, abs=1.5e-4)
    assert errors[7:].max() < 0.025
    off = [run.problem.reference - run.trial(i)[1] for i in (0, 1, 7, 50)]
    rms = [np.sqrt(np.mean(one**2)) for one in off]
    assert rms == pytest.approx([20.781, 6.136, 0.01104, 0.01102], rel=5e-4)


@pytest.mark.parametrize(
    ("q_len", "wanted"),
    [
        (5, ".0885 .0116 .0116 .0244 .163"),
        (10, ".0871 .0072 .0074 .0057 .0057"),
        (20, ".0866 .0175 .0192 .0193 .0193"),
        (40, ".109 .0772 .0795 .0796"),
        (80, ".291 .308 .310 .310"),
    ],
)
def test_lengths_of_the_filter(q_len: int, wanted: str) -> None:
    errors = exact(40, q_len=q_len)[[5, 7, 10, 20, 40]]
    assert rounded(errors, wanted), errors


@pytest.mark.parametrize(
    ("rho", "wanted"),
    [
        (0.3, "37.2 26.4 9.41 4.73 .067"),
        (0.5, "27.06 13.94 1.898 .502 .0295"),
        (1.0, "2.104 .1066 .01449 .01383 .01396"),
        (1.2, "8.517 1.296 .0139 .0111"),
        (1.5, "23.8 10.6 .766 .0866 .0089"),
        (1.9, "44.1 36.8 19.9 11.9 .638"),
        (2.0525, "51.8 51.0 45.6 39.0 15.9"),
        (2.839, "91.8 160.2 823 2354 960094"),
    ],
)
def test_gains(rho: float, wanted: str) -> None:
    errors = exact(20, rho=rho)[[1, 2, 5, 7, 20]]
    assert rounded(errors, wanted), errors


def filter_on_the_error() -> np.ndarray:
    """u + rho * d/dt Q(e), the other way to read section 6.5."""
    return rod.exact(rod.law(q_len=1), 50, lambda error: zero_phase(error, 20))


def test_where_the_filter_acts() -> None:
    at = [5, 7, 10, 20, 30, 40, 50]
    rows = {
        rod.with_filter: ".0866 .0175 .0192 .0193 .0193 .0193 .0193",
        rod.with_filter_on_the_correction: ".0889 .0088 .0072 .0086 .0120 .0184 .0293",
        filter_on_the_error: ".186 .0932 .0721 .0479 .0371 .0308 .0403",
        rod.without_filter: ".0891 .0139 .0171 .0633 .305 1.608 8.827",
    }
    for run, wanted in rows.items():
        errors = run()[at]
        assert rounded(errors, wanted), (run, errors)
    errors = EXAMPLE.run(ExampleOptions(iterations=10)).max_abs_error
    assert errors[5] == pytest.approx(0.0861, abs=1e-4)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("step", "rho", "q_len"), [(0.04, 0.6, 3), (0.025, 1.1, 9)])
def test_other_settings_against_plain_numpy(
    step: float, rho: float, q_len: int, precision: Precision
) -> None:
    """The law and the rod once more, in the plainest words; not in any table."""
    time, cells = times(step), 37
    h = 1 / cells
    x = (np.arange(cells) + 0.5) * h
    wanted, u, errors = reference(time), np.zeros(len(time)), []
    heat = np.full(cells + 1, h)
    heat[0] = heat[-1] = h / 2
    system = np.diag(heat / step)
    for j in range(cells):
        system[j : j + 2, j : j + 2] += np.array([[1, -1], [-1, 1]]) / h
    for _ in range(6):
        w, y = np.zeros(cells + 1), np.zeros(len(time))
        for k in range(1, len(time)):
            right = heat / step * w
            source = 2 * x * time[k] + x**2
            right[:-1] += h / 2 * source
            right[1:] += h / 2 * source
            right[-1] += u[k]
            w = np.linalg.solve(system, right)
            y[k] = w[0]
        error = wanted - y
        errors.append(np.abs(error).max())
        rise = np.diff(error, append=2 * error[-1] - error[-2]) / step
        raw = u + rho * rise
        for k in range(len(u)):
            near = np.arange(max(0, k - q_len + 1), min(len(u), k + q_len))
            weights = q_len - np.abs(near - k)
            u[k] = weights @ raw[near] / weights.sum()
    config = LearnerConfig(len(time), step=step, kd=rho, q_len=q_len)
    run = problem(plant("backward-euler", step, cells), config).run(5, precision=precision)
    tolerance = 1e-9 if precision == "double" else 1e-5
    assert run.max_abs_error[0] == pytest.approx(errors, rel=tolerance, abs=tolerance)


def test_the_rod_against_a_stiff_solver() -> None:
    """An input of straight lines, LSODA on 100 cells."""
    time, cells = times(0.1), 100
    u = 3 * np.sin(time) - 2
    h = 1 / cells
    x = (np.arange(cells) + 0.5) * h

    def rate(t: float, w: np.ndarray) -> np.ndarray:
        flow = np.concatenate([[0.0], np.diff(w) / h, [np.interp(t, time, u)]])
        source = 2 * x * t + x**2
        out = np.diff(flow) / h + np.append(source, 0) / 2 + np.append(0, source) / 2
        out[0] = flow[1] / (h / 2) + source[0]
        out[-1] = (flow[-1] - flow[-2]) / (h / 2) + source[-1]
        return out

    found = solve_ivp(
        rate, (0, 10), np.zeros(cells + 1), "LSODA", time, rtol=1e-7, atol=1e-8, max_step=0.1,
        lband=1, uband=1,
    )  # fmt: skip
    assert plant(scheme="modal", step=0.1).output(u) == pytest.approx(found.y[0], abs=5e-4)


def test_the_field_ends_in_the_output() -> None:
    u = np.cos(times(0.01))
    assert plant().field(u)[:, 0] == pytest.approx(plant().output(u), abs=1e-9)
    with pytest.raises(ValueError, match="no nodes"):
        plant(scheme="modal").field(u)


def test_the_filter() -> None:
    impulse = np.eye(11)[5]
    wanted = [0, 0, 16 / 15, 2, 3, 4, 3, 2, 16 / 15, 0, 0]
    assert 16 * zero_phase(impulse, 4) == pytest.approx(wanted)
    ramp = [1, 1.538462, 2.2, 3, 4, 5, 6, 7, 7.8, 8.461538, 9]
    assert zero_phase(np.arange(11.0), 4) == pytest.approx(ramp, abs=1e-6)
    step = [0, 0, 0, 1 / 9, 1 / 3, 2 / 3, 8 / 9, 1, 1, 1, 1]
    assert zero_phase((np.arange(11) >= 5).astype(float), 3) == pytest.approx(step)


def test_frequencies() -> None:
    omega, wide = np.linspace(0, 10, 10_001), np.linspace(0, 300, 60_001)
    assert rod.cut_off(20, 0.01, 2) == pytest.approx(10.03, abs=0.005)
    assert rod.cut_off(20, 0.01, 1) == pytest.approx(13.93, abs=0.005)
    assert rod.best_rho(rod.modelled, 0.01)[0] == pytest.approx(2.84033, abs=1e-5)
    assert rod.best_rho(rod.rod, 0.01)[0] == pytest.approx(1, abs=1e-5)
    by_model = rod.best_rho(rod.modelled, omega)
    assert by_model == pytest.approx((2.05252, 0.66767), abs=1e-5)
    unrounded = rod.modelled_unrounded
    assert rod.best_rho(unrounded, 0.01)[0] == pytest.approx(2.84157, abs=1e-5)
    assert rod.best_rho(unrounded, omega) == pytest.approx((2.05317, 0.66778), abs=1e-5)
    assert rod.widest_band(0.01) == pytest.approx(11.187, abs=5e-4)
    assert rod.best_rho(rod.rod, omega) == pytest.approx((0.19406, 0.99141), rel=1e-4)
    with_q = rod.best_rho(rod.rod, wide, rod.zero_phase_frequency(wide, 20, 0.01))
    assert with_q == pytest.approx((0.5088, 0.7507), rel=1e-3)
    assert rod.left_over(rod.rod, 0.7444, omega) == pytest.approx(1.0585, abs=5e-5)
    narrow = np.linspace(0, 5.567, 4001)
    assert rod.best_rho(rod.rod, narrow)[0] == pytest.approx(0.7444, rel=1e-3)


def test_the_half_differentiator() -> None:
    at = np.array([1.0, 5.0, 10.0, 20.0, 100.0, 250.0])
    true = np.sqrt(1j * at)
    off = np.abs(rod.half_differentiator(at) / true - 1)
    assert off == pytest.approx([2.13, 0.70, 0.40, 0.22, 0.10, 0.49], abs=0.025)
    assert abs(rod.half_differentiator(0.0)[0]) == pytest.approx(5.302 / 1.925, rel=1e-6)
    assert abs(rod.modelled(0.0)[0]) == pytest.approx(0.352, abs=5e-4)
    over, under = rod.half_differentiator_coefficients()
    assert over == pytest.approx([1, -0.5, 0.1, -0.175, 0.05, -0.1])
    assert under == pytest.approx(np.abs(over))
    assert np.sqrt(200) * over == pytest.approx(rod.PRINTED_OVER, rel=2.5e-4)
    assert under == pytest.approx(rod.PRINTED_UNDER)


def test_what_acts_at_the_ends_and_inside() -> None:
    """Lemma 6.1 against closed forms, and, as printed, against the slips that it leads to."""
    s, x = 0.7 - 2.1j, 0.3
    r = np.sqrt(s)
    ends = rod.from_the_ends(x, s)
    hyperbolic = np.sinh(r)
    wanted = [
        [-np.cosh(r * (1 - x)) / (r * hyperbolic), np.cosh(r * x) / (r * hyperbolic)],
        [np.sinh(r * (1 - x)) / hyperbolic, np.sinh(r * x) / hyperbolic],
    ]
    assert ends.ravel() == pytest.approx(np.ravel(wanted), rel=1e-12)
    assert expm(np.array([[0, 1], [s, 0]]) * x).ravel() == pytest.approx(
        rod.along(x, s).ravel(), rel=1e-12
    )
    printed = rod.from_the_ends(x, s, rod.along_printed)
    assert printed[:, 0] == pytest.approx([-np.exp(-r * x) / r, 0], abs=1e-12)
    kernel = rod.from_inside(0.0, x, s)[0, 1]
    assert kernel == pytest.approx(-np.cosh(r * (1 - x)) / (r * hyperbolic), rel=1e-12)
    kernel = rod.from_inside(0.0, x, s, rod.along_printed)[0, 1]
    assert kernel == pytest.approx(-np.sinh(r * (1 - x)) / (r * hyperbolic), rel=1e-12)
    assert max(rod.off_at_the_ends(s)) < 1e-4 and rod.off_inside(s) < 1e-6
    assert min(rod.off_at_the_ends(s, rod.along_printed)) > 0.1


@cache
def claims(precision: Precision) -> dict[str, Claim]:
    return {c.id: c for c in Study(EXAMPLE, ExampleOptions(precision=precision)).judge()}


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(
    ("id", "verdict", "measured"),
    [
        ("6-cut-off", CONFIRMED, 10.03),
        ("6-follows", CONFIRMED, [2.84033, 2.84157]),
        ("6-best-there", NOT_CONFIRMED, 1.0),
        ("6-optimum", NOT_CONFIRMED, [2.05252, 2.05317, 0.1941, 0.5088]),
        ("6-theorem-6.1", NOT_CONFIRMED, 1.0585),
        ("6-theorem-6.3", CONFIRMED, 0.7690),
        ("6-first-error", NOT_CONFIRMED, [52.5194, 14.6136]),
        ("6-last-error", READING, 0.01752),
        ("6-robust", CONFIRMED, [0.0193, 8.827]),
        ("6-positive-real", NOT_CONFIRMED, -0.1667),
        ("6-kernel", NOT_CONFIRMED, [0.333311, 1.0, 0.754493, 0.845872]),
    ],
)
def test_claims(id: str, verdict: str, measured: object, precision: Precision) -> None:
    claim = claims(precision)[id]
    assert claim.verdict == verdict
    assert claim.measured == pytest.approx(measured, rel=2e-3)


def test_every_claim_has_a_source_and_a_verdict() -> None:
    for claim in claims("double").values():
        assert claim.where and claim.verdict in VERDICTS
        assert claim.verdict == CONFIRMED or claim.note


def test_a_verdict_follows_what_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    """With another gain, and the right exp(Fx), the same claims read otherwise."""
    good = rod.law
    monkeypatch.setattr(rod, "law", lambda step=0.01, rho=2.839, q_len=None: good(step, rho, q_len))
    monkeypatch.setattr(rod, "along_printed", rod.along)
    monkeypatch.setattr(rod, "PRINTED_OVER", (20.0, *rod.PRINTED_OVER[1:]))
    found = {c.id: c for c in Study(EXAMPLE).judge()}
    assert found["6-last-error"].verdict == NOT_CONFIRMED
    assert found["6-shrinks"].verdict == NOT_CONFIRMED
    assert found["6-kernel"].measured[:3] == pytest.approx([0, 0, 0], abs=1e-3)  # type: ignore[index]
    assert found["6-follows"].verdict == NOT_CONFIRMED


def test_divergence_ends_the_run() -> None:
    run = problem(plant(step=0.1), rod.law(0.1, rho=-900.0)).run(1000).example_run(cut=False)
    assert run.diverged == len(run.max_abs_error) < 1000
    assert np.all(np.isfinite(run.max_abs_error))


@pytest.mark.parametrize("options", [{"step": 0.03}, {"step": -1}, {"step": 0.0001}, {"step": 0},
                                     {"step": float("nan")}, {"iterations": -1}])  # fmt: skip
def test_options_that_make_no_sense(options: dict[str, float]) -> None:
    with pytest.raises(InputError) as caught:
        EXAMPLE.run(ExampleOptions(**options))
    assert caught.value.remedy


@pytest.mark.painted
def test_figures(tmp_path: Path) -> None:
    drawn = Study(EXAMPLE).draw(tmp_path)
    assert {f.name for f in drawn} >= {"Fig. 6.1", "Fig. 6.2", "Fig. 6.3"}
    assert all(f.path.read_bytes()[:4] == b"%PDF" for f in drawn)
    assert "13.20" in next(f for f in drawn if f.name == "Fig. 6.1").contradicts


def test_the_slope_is_the_laws() -> None:
    assert slope(np.array([0.0, 1.0, 4.0]), 0.5) == pytest.approx([2, 6, 6])
