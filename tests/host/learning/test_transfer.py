"""The transfer to another magnitude and duration: the exact rule, and what beats make of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tailbeat.core import reference as references
from tailbeat.core.arrays import F32, F64
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.transfer import (
    TOLERANCE,
    BeatCurve,
    Similarity,
    overlap,
    scaled_input,
    similarity,
    transfer,
)

Array = F64
Function = Callable[[Array], Array]

V = references.THESIS_PLATEAU_M_S
TANK = FishModel(10.0, 0.219, 0.197, 0.3)
LIMIT = np.float32(np.pi / 4)

factors = st.floats(0.4, 2.5)
drags = st.floats(0.5, 40.0)
seeds = st.integers(0, 2**32 - 1)
models = st.builds(
    FishModel,
    kappa_per_m=st.floats(1.0, 400.0),
    slope_m_s_rad=st.floats(0.05, 1.0),
    dead_zone_rad=st.floats(0.0, 0.4),
    delay_s=st.floats(0.0, 1.2),
)


def wave(seed: int, size: float) -> Function:
    """A smooth input of five sines, both signs."""
    dice = np.random.default_rng(seed)
    gain, rate, phase = dice.uniform(-1, 1, 5), dice.uniform(0.1, 3, 5), dice.uniform(0, 6, 5)
    return lambda t: size * (0.5 + (gain * np.sin(np.multiply.outer(t, rate) + phase)).sum(-1))


def runge_kutta(alpha: float, node: Array, middle: Array, step: float) -> Array:
    """v' = -alpha*v*|v| + u from rest; u at the ends of steps and between them."""
    v = np.zeros(len(node))

    def slope(speed: float, u: float) -> float:
        return -alpha * speed * abs(speed) + u

    for k in range(len(node) - 1):
        a = slope(v[k], node[k])
        b = slope(v[k] + step / 2 * a, middle[k])
        c = slope(v[k] + step / 2 * b, middle[k])
        d = slope(v[k] + step * c, node[k + 1])
        v[k + 1] = v[k] + step / 6 * (a + 2 * b + 2 * c + d)
    return v


def trial(alpha: float, u: Function, end: float, steps: int) -> Array:
    time = np.linspace(0, end, steps + 1)
    return runge_kutta(alpha, u(time), u(time[:-1] + end / steps / 2), end / steps)


@settings(max_examples=20, deadline=None)
@given(alpha=drags, m=factors, s=factors, seed=seeds)
def test_the_rule_is_exact(alpha: float, m: float, s: float, seed: int) -> None:
    """Below the integrator's own error, which is what doubling its step changes."""
    u1, end, steps = wave(seed, 0.02), 8.0, 400
    time = np.linspace(0, end, 2 * steps + 1)
    v1 = trial(alpha, u1, end, 2 * steps)
    assume(np.all(np.isfinite(v1)) and np.abs(v1).max() < 0.5)
    u2 = scaled_input(u1(time), u1(time) - alpha * v1 * np.abs(v1), m, s)
    v2 = runge_kutta(alpha, u2[::2], u2[1::2], end / s / steps)
    own = np.abs(runge_kutta(alpha, u2[::4], u2[2::4], 2 * end / s / steps) - v2[::2]).max()
    assert np.abs(v2 - m * v1[::2]).max() <= own + 1e-12


@settings(max_examples=60, deadline=None)
@given(
    kappa=drags,
    factor=factors,
    delay=st.floats(0.0, 2.0),
    w=arrays(np.float64, st.integers(1, 30), elements=st.floats(0.0, 0.02)),
)
def test_magnitude_tied_to_time_needs_no_reference(
    kappa: float, factor: float, delay: float, w: Array
) -> None:
    """v2(t) = kappa*v1(kappa*t), both solved exactly: the same way in 1/kappa of the time."""
    slow = FishModel(kappa, 1.0, 0.0, delay).distance(w, 1.0)[0]
    u2 = scaled_input(w, np.full(len(w), 1e9), factor, factor)
    fast = FishModel(kappa, 1.0, 0.0, delay / factor).distance(u2, 1.0 / factor)[0]
    np.testing.assert_allclose(fast, slow, rtol=1e-11, atol=1e-14)


@given(
    u=arrays(np.float64, 7, elements=st.floats(-1, 1)),
    a=arrays(np.float64, 7, elements=st.floats(-1, 1)),
    first=st.tuples(factors, factors),
    second=st.tuples(factors, factors),
)
def test_two_transfers_are_the_one_by_both_products(
    u: Array, a: Array, first: tuple[float, float], second: tuple[float, float]
) -> None:
    (m, s), (n, r) = first, second
    twice = scaled_input(scaled_input(u, a, m, s), m * s * a, n, r)
    np.testing.assert_allclose(twice, scaled_input(u, a, m * n, s * r), rtol=1e-12, atol=1e-12)


@st.composite
def cases(draw: st.DrawFn) -> tuple[F32, Reference, FishModel]:
    beats = draw(st.integers(1, 60))
    speed = draw(arrays(np.float32, beats, elements=st.floats(0, 0.25, width=32)))
    assume(speed.any())
    amplitude = draw(arrays(np.float32, beats, elements=st.floats(0, float(LIMIT), width=32)))
    return amplitude, Reference(draw(st.floats(0.4, 4.0)), speed, "any"), draw(models)


@settings(deadline=None)
@given(case=cases())
def test_the_same_reference_gives_the_same_bits(
    case: tuple[F32, Reference, FishModel],
) -> None:
    amplitude, wanted, model = case
    done = transfer(amplitude, wanted, wanted, Similarity(1, 1, 0, 1), model, float(LIMIT))
    assert done.amplitude_rad.tobytes() == amplitude.tobytes()
    assert (done.saturated_beats, done.share) == (0, 1.0)


@settings(deadline=None)
@given(model=models, m=factors, n=factors, seed=seeds)
def test_magnitudes_compose_on_beats(model: FishModel, m: float, n: float, seed: int) -> None:
    old = references.thesis()
    mid, new = references.thesis(m * V, 40), references.thesis(m * n * V, 40)
    amplitude = model.dead_zone_rad + np.random.default_rng(seed).uniform(0.2, 0.3, 40)
    here = Similarity(m, 1, 0, 1), Similarity(n, 1, 0, 1), Similarity(m * n, 1, 0, 1)
    first = transfer(amplitude, old, mid, here[0], model, 9.0)
    assume(np.all(first.amplitude_rad > model.dead_zone_rad + 1e-3))
    second = transfer(first.amplitude_rad, mid, new, here[1], model, 9.0)
    once = transfer(amplitude, old, new, here[2], model, 9.0)
    np.testing.assert_allclose(second.amplitude_rad, once.amplitude_rad, rtol=2e-3, atol=1e-4)


def ideal(speed: Function, end: float, beats: int, model: FishModel) -> Array:
    """Beat means of the thrust along a curve, commanded the delay earlier; by differences."""
    fine = 4000
    time = (np.arange(beats * fine) + 0.5) / fine + model.delay_s
    v = speed(np.minimum(time, end))
    slope = (speed(np.minimum(time + 1e-5, end)) - speed(np.minimum(time - 1e-5, end))) / 2e-5
    return (slope / model.kappa_per_m + v**2).reshape(beats, fine).mean(axis=1)


def hump(t: Array) -> Array:
    """A smooth curve of 40 s."""
    return 0.08 * np.sin(np.pi * np.clip(t, 0, 40) / 40) ** 2


@pytest.mark.parametrize("model", [TANK, FishModel(5.0, 0.3, 0.1, 0.75), FishModel(20, 0.2, 0, 0)])
@pytest.mark.parametrize(
    ("m", "s"), [(1, 0.8), (1, 1.25), (0.8, 0.8), (1.25, 1.25), (0.7, 1), (1.3, 1), (0.9, 1.6)]
)
def test_amplitudes_are_those_of_the_scaled_curve(m: float, s: float, model: FishModel) -> None:
    """Against the thrust that the new curve itself needs, where it needs any."""
    beats = round(40 / s)
    old = references.curve(t := np.linspace(0, 40, 4001), hump(t), 1.0, "old")
    t2 = np.linspace(0, 40 / s, 4001)
    new = references.curve(t2, m * hump(s * t2), 1.0, "new")
    w1 = ideal(hump, 40, 40, model)
    w2 = ideal(lambda t: m * hump(s * t), 40 / s, beats, model)
    found = similarity(old, new)
    assert (found.magnitude, found.time_factor) == pytest.approx((m, s), rel=2e-4)
    got = transfer(model.amplitude_rad(np.sqrt(np.maximum(w1, 0))), old, new, found, model, 2.0)
    want = model.dead_zone_rad + np.sqrt(np.maximum(w2, 0)) / model.slope_m_s_rad
    inner = slice(2, -1)  # the first beats: none, and then a thrust that grows by its square
    assert np.abs(got.amplitude_rad - want)[inner].max() < 0.006
    assert np.abs(got.amplitude_rad - want).max() < 0.03
    naive = overlap(model.amplitude_rad(np.sqrt(np.maximum(w1, 0))), np.arange(beats + 1) * s)
    assert np.abs(naive - want)[inner].max() > 0.009, "a transfer of amplitudes would do as well"


def test_where_the_tail_did_not_push_the_reference_says_what_was_wanted() -> None:
    """A fall that no fish can follow, stretched until it can: the tail has to push again."""
    model = FishModel(5.0, 0.2, 0.2, 0.0)
    old, new = references.trapezoid(0.08, 4, 20), references.trapezoid(0.08, 16, 80)
    w1 = np.maximum(np.concatenate([np.arange(4) + 0.5, [4] * 20, np.arange(4)[::-1] + 0.5]), 0)
    amplitude = np.where(np.arange(28) < 24, 0.2 + 0.02 * w1 / 0.2, 0.05)
    by = similarity(old, new)
    assert (by.magnitude, by.time_factor) == pytest.approx((1, 0.25), rel=1e-3)
    got = transfer(amplitude, old, new, by, model, 1.0).amplitude_rad
    for beat in (102, 103, 104):
        v, slope = 0.08 * (1 - (beat + 0.5 - 96) / 16), -0.08 / 16
        assert got[beat] == pytest.approx(0.2 + np.sqrt(v**2 + slope / 5) / 0.2, abs=0.015)
    assert got[-1] == pytest.approx(0.05)


def test_no_thrust_wanted_leaves_the_dead_zone_as_it_was() -> None:
    amplitude = np.array([0.1, 0.3, 0.3, 0.05, 0.0], np.float32)
    wanted = Reference(1.0, np.array([0.001, 0.02, 0.02, 0.01, 0.0], np.float32), "five")
    got = transfer(amplitude, wanted, wanted, Similarity(1.5, 1, 0, 1), TANK, 1.0).amplitude_rad
    assert got[3:] == pytest.approx([0.05, 0.0])
    assert got[1] > 0.3


def test_what_the_limit_takes_is_told() -> None:
    wanted = references.thesis()
    w = ideal(references.thesis_speed, 40, 40, TANK)
    amplitude = TANK.amplitude_rad(np.sqrt(np.maximum(w, 0)))
    faster = references.thesis(1.2 * V, 40)
    free = transfer(amplitude, wanted, faster, similarity(wanted, faster), TANK, 2.0)
    held = transfer(amplitude, wanted, faster, similarity(wanted, faster), TANK, 0.6)
    assert free.saturated_beats == 0
    assert held.saturated_beats == np.count_nonzero(free.amplitude_rad > np.float32(0.6)) > 10
    assert held.amplitude_rad.max() == np.float32(0.6)
    ways = [TANK.beats(x.amplitude_rad, 1.0).sum() for x in (held, free)]
    assert held.share == pytest.approx(ways[0] / ways[1])
    assert 0.85 < held.share < 1


@pytest.mark.parametrize("amplitude", [np.zeros(39), np.full(40, np.nan)])
def test_amplitudes_that_are_not_a_trials_are_refused(amplitude: Array) -> None:
    wanted = references.thesis()
    with pytest.raises(InputError, match="for 40 beats"):
        transfer(amplitude, wanted, wanted, Similarity(1, 1, 0, 1), TANK, 1.0)


means = arrays(np.float64, st.integers(1, 20), elements=st.floats(0, 1))


@settings(deadline=None)
@given(mean=means, cuts=st.lists(st.floats(0, 1), max_size=8))
def test_curves_keep_what_lies_between_two_instants(mean: Array, cuts: list[float]) -> None:
    curve = BeatCurve(mean)
    own = np.arange(len(mean) + 1.0)
    assert np.array_equal(curve.means(own), mean)
    at = np.unique([0.0, *(cut * len(mean) for cut in cuts), len(mean)])
    at = at[np.append(True, np.diff(at) > 1e-3)]
    at[-1] = len(mean)
    assert curve.means(at) @ np.diff(at) == pytest.approx(mean.sum(), abs=1e-9)
    fine = np.linspace(0, len(mean), 400 * len(mean) + 1)
    values = curve.at((fine[1:] + fine[:-1]) / 2)
    assert values.min() >= -1e-12
    np.testing.assert_allclose(values.reshape(len(mean), 400).mean(axis=1), mean, atol=1e-4)
    halves = curve.means(np.arange(2 * len(mean) + 1) / 2)
    np.testing.assert_allclose(values.reshape(-1, 200).mean(axis=1), halves, atol=1e-4)
    assert curve.means(np.array([len(mean), len(mean) + 2.0]))[0] == pytest.approx(curve.end)
    assert curve.at(np.array([-1.0, len(mean) + 1.0])).tolist() == [0.0, curve.end]


def test_stairs_go_on_beyond_their_ends() -> None:
    stairs = np.array([1.0, 3.0])
    got = overlap(stairs, np.array([-1.0, 0.0, 0.5, 1.5, 2.0, 4.0]))
    assert got.tolist() == [1.0, 1.0, 2.0, 3.0, 3.0]


@pytest.mark.parametrize(
    ("old", "new", "m", "s"),
    [
        ("thesis", f"thesis:{0.8 * V},50", 0.8, 0.8),
        ("thesis", f"thesis:{V},32", 1, 1.25),
        ("thesis", f"thesis:{0.9 * V},36.4", 0.9, 40 / 36.4),
        (f"thesis:{V},57", "thesis", 1, 57 / 40),
        ("trapezoid:0.08,8,10", "trapezoid:0.06,10,12.5", 0.75, 0.8),
        ("trapezoid:0.08,2,10", "trapezoid:0.06,2.5,12.5", 0.75, 0.8),
        ("trapezoid:0.04,2,10", "trapezoid:0.08,1,5", 2, 2),
        ("cosine:0.05,6,9", "cosine:0.07,9,13.5", 1.4, 2 / 3),
    ],
)
def test_scaled_copies_are_alike(old: str, new: str, m: float, s: float) -> None:
    found = similarity(references.from_text(old), references.from_text(new))
    assert found.alike
    assert (found.magnitude, found.time_factor) == pytest.approx((m, s), rel=2e-3)


@pytest.mark.parametrize("text", ["thesis", "thesis:0.06,41.5", "trapezoid:0.05,2,2"])
def test_a_reference_is_like_itself(text: str) -> None:
    wanted = references.from_text(text)
    found = similarity(wanted, wanted)
    assert (found.magnitude, found.time_factor, found.residual_m_s) == (1, 1, 0)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("trapezoid:0.08,8,10", "cosine:0.06,10,12.5"),
        ("trapezoid:0.08,2,16", "thesis"),
        ("trapezoid:0.08,4,20", "trapezoid:0.08,4,12"),
        ("thesis", "trapezoid:0.0791,10,20"),
    ],
)
def test_other_shapes_are_not(old: str, new: str) -> None:
    found = similarity(references.from_text(old), references.from_text(new))
    assert not found.alike
    assert found.residual_m_s > TOLERANCE * found.peak_m_s


def test_a_reference_of_rest_is_like_nothing() -> None:
    rest = Reference(1.0, np.zeros(5, np.float32), "rest")
    for pair in ((rest, references.thesis()), (references.thesis(), rest)):
        with pytest.raises(InputError, match="zero throughout"):
            similarity(*pair)


def test_the_thesis_profile_in_another_size() -> None:
    plain, other = references.thesis(), references.from_text("thesis:0.0633,50")
    assert plain.crc == 384454814
    assert (other.beats, other.name) == (50, "thesis-0.0633-50")
    assert other.speed_m_s.max() == pytest.approx(0.0633, rel=1e-4)
    assert other.travel_m == pytest.approx(plain.travel_m * 0.0633 / V * 1.25, rel=1e-6)
    with pytest.raises(InputError, match="is not a reference"):
        references.from_text("thesis:0.1")
