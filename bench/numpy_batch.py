"""The trial of a Monte Carlo study as one would write it in numpy: the yardstick for the batch.

A thousand fish of one kind at a time; the same substeps, servo, delay, ripple, disturbances,
camera and line fits as the simulator's. Whatever does not hang on the substep before is done for a
whole frame at once, in place. Noise comes from numpy's generator. Run alone, it shows how closely
it agrees with the simulator when there is no noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.studies.montecarlo.batch import BatchTrials, FishBatch

Array = NDArray[np.float64]

FRAMES = 50  # per beat of 1 s
SUBSTEPS = 4
FRAME_S = 0.02
DT_S = FRAME_S / SUBSTEPS
FPS = 25
FRAMES_PER_PICTURE = 2
STILL_RAD = 1e-6
SIGMA_MIN_M_S = 1e-5
DISAGREEMENT_MAX_M_S = 1e-12


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    fish: int
    beats: int


FULL, TINY = Load(fish=50, beats=40), Load(fish=2, beats=4)


@dataclass
class Disturbances:
    """What one swim draws, shape (fish,); ``noise_m`` (pictures, fish)."""

    gain: Array
    flow_m_s: Array
    start_m_s: Array
    noise_m: Array


class Servo:
    """The tail of all fish: a lag and a rate limit behind a sine."""

    def __init__(self, config: Any, fish: int) -> None:
        lag_s, rate = config.servo_lag_s, config.servo_rate_rad_s
        self.settle = 1 - np.exp(-DT_S / lag_s) if lag_s > 0 else 1.0
        self.most = rate * DT_S if rate > 0 else np.inf
        self.to_amplitude = 1 / (DT_S * 2 * np.pi)
        self.at = (np.arange(SUBSTEPS) / SUBSTEPS - lag_s / FRAME_S)[:, None]
        self.angle = np.zeros((SUBSTEPS + 1, fish))
        self.behind, self.moved, self.middle = (np.empty((SUBSTEPS, fish)) for _ in range(3))

    def frame(self, begin: Array, rise: Array) -> tuple[Array, Array]:
        """(amplitude, ripple) in the middle of each substep of the frame in which the command goes
        from ``begin`` up by ``rise``; both are overwritten next time."""
        behind, moved, middle, angle = self.behind, self.moved, self.middle, self.angle
        np.multiply(rise, self.at, out=behind)
        behind += begin
        move = rise * (1 / SUBSTEPS)
        angle[0] = angle[-1]
        for i in range(SUBSTEPS):
            step = moved[i]
            np.subtract(behind[i], angle[i], out=step)
            step *= self.settle
            step += move
            np.minimum(step, self.most, out=step)
            np.maximum(step, -self.most, out=step)
            np.add(angle[i], step, out=angle[i + 1])
        np.multiply(moved, 0.5, out=middle)
        middle += angle[:-1]
        middle *= middle
        moved *= self.to_amplitude
        moved *= moved
        middle += moved
        small = middle <= STILL_RAD**2
        moved *= 2
        moved /= middle
        moved[small] = 1
        return np.sqrt(middle, out=middle), moved


class Water:
    """The speed of all fish over water, from the thrust some time before."""

    def __init__(self, config: Any, gain: Array, start_m_s: Array) -> None:
        fish = len(gain)
        steps = config.delay_s / DT_S
        self.delay = int(steps + 1e-6)
        self.fraction = steps - self.delay if steps - self.delay > 1e-6 else 0.0
        self.kt = config.kappa_per_m * DT_S
        self.slope = gain * config.slope_m_s_rad
        self.dead_zone_rad = config.dead_zone_rad
        self.past = self.delay + 1  # rows of thrust kept from the beat before
        self.thrust = np.zeros((self.past + FRAMES * SUBSTEPS, fish))
        self.now = self.past
        self.v, self.way = (np.zeros((SUBSTEPS + 1, fish)) for _ in range(2))
        self.v[-1] = start_m_s
        self.h, self.tau, self.a, self.b = (np.empty((SUBSTEPS, fish)) for _ in range(4))
        self.row = np.empty(fish)

    def _late_thrust(self, amplitude: Array) -> Array:
        """Stores this frame's thrust and returns that of ``delay`` before."""
        if self.now == len(self.thrust):
            self.thrust[: self.past] = self.thrust[-self.past :].copy()
            self.now = self.past
        amplitude -= self.dead_zone_rad
        np.maximum(amplitude, 0, out=amplitude)
        amplitude *= self.slope
        np.multiply(amplitude, amplitude, out=self.thrust[self.now : self.now + SUBSTEPS])
        begin = self.now - self.delay
        self.now += SUBSTEPS
        late = self.thrust[begin : begin + SUBSTEPS]
        if self.fraction == 0:
            return late
        later = self.thrust[begin - 1 : begin + SUBSTEPS - 1]
        mixed: Array = late + self.fraction * (later - late)
        return mixed

    def frame(self, amplitude: Array, ripple: Array) -> None:
        """Fills ``v`` and adds to ``way``: rows are the ends of substeps, the first the begin."""
        h, tau, a, b, kt = self.h, self.tau, self.a, self.b, self.kt
        np.multiply(self._late_thrust(amplitude), ripple, out=h)
        np.multiply(h, kt * kt, out=a)
        np.multiply(a, -2 / 15, out=tau)
        tau += 1 / 3
        tau *= a
        np.subtract(1, tau, out=tau)
        tau *= kt
        h *= tau
        self.v[0] = self.v[-1]
        for i in range(SUBSTEPS):
            v, following = self.v[i], self.v[i + 1]
            np.multiply(v, tau[i], out=self.row)
            self.row += 1
            np.add(v, h[i], out=following)
            following /= self.row
        before, after = self.v[:-1], self.v[1:]
        np.subtract(after, before, out=a)
        np.add(after, before, out=b)
        a *= kt / 6
        a += 1
        b *= a
        b *= DT_S / 2
        self.way[0] = self.way[-1]
        for i in range(SUBSTEPS):
            np.add(self.way[i], b[i], out=self.way[i + 1])


def draw(config: Any, fish: int, beats: int, rng: np.random.Generator) -> Disturbances:
    """One swim's; what has sigma 0 is not drawn."""

    def normal(sigma: float, shape: tuple[int, ...]) -> Array:
        return rng.normal(0, sigma, shape) if sigma > 0 else np.zeros(shape)

    return Disturbances(
        gain=np.maximum(0, 1 + normal(config.gain_sigma, (fish,))),
        flow_m_s=normal(config.flow_sigma_m_s, (fish,)),
        start_m_s=np.abs(normal(config.start_sigma_m_s, (fish,))),
        noise_m=normal(config.camera_noise_m, (beats * FPS + 1, fish)),
    )


def exposures_s(pictures: int) -> Array:
    """When they are taken; the simulator's camera counts in whole microseconds."""
    return np.floor((np.arange(pictures) + 0.33) * 1e6 / FPS) * 1e-6


def position(water: Water, in_frame_s: float) -> Array:
    """At the exposure, by a cubic through speed and place at both ends of its substep."""
    steps = in_frame_s / DT_S
    i = int(steps)
    u = steps - i
    w = 1 - u
    place: Array = water.way[i] * (w * w * (1 + 2 * u))
    place += water.way[i + 1] * (u * u * (3 - 2 * u))
    place += water.v[i] * (u * w * w * DT_S)
    place -= water.v[i + 1] * (u * u * w * DT_S)
    return place


def fit(pictures_m: Array, beats: int) -> tuple[Array, Array]:
    """(speed, sigma) per beat from a line through its 26 pictures, shape (fish, beats)."""
    time_s = exposures_s(len(pictures_m))
    speed, sigma = (np.empty((pictures_m.shape[1], beats)) for _ in range(2))
    for k in range(beats):
        window = slice(k * FPS, (k + 1) * FPS + 1)
        t = time_s[window] - time_s[window].mean()
        vtt = t @ t
        x = pictures_m[window]
        x = x - x.mean(axis=0)
        speed[:, k] = t @ x / vtt
        scatter = np.einsum("ij,ij->j", x, x) - speed[:, k] ** 2 * vtt
        sigma[:, k] = np.sqrt(np.maximum(scatter, 0) / (FPS - 1) / vtt)
    return speed, np.maximum(sigma, SIGMA_MIN_M_S)


@np.errstate(invalid="ignore", divide="ignore")
def swim(config: Any, amplitude_rad: Array, drawn: Disturbances) -> BatchTrials:
    """One swim of fish that all have ``config`` (a ``sim_config_t *`` of a tank plant with servo,
    25 pictures per second, none lost, no bend of the map); ``amplitude_rad`` (fish, beats)."""
    fish, beats = amplitude_rad.shape
    servo = Servo(config, fish)
    water = Water(config, drawn.gain, drawn.start_m_s)
    sine = np.sin(2 * np.pi * np.arange(FRAMES + 1) / FRAMES)
    rises = np.diff(sine)
    pictures = drawn.noise_m
    in_frame_s = exposures_s(len(pictures)) % FRAME_S
    true = np.empty((fish, beats))
    for k in range(beats):
        amplitude = np.ascontiguousarray(np.abs(amplitude_rad[:, k]))
        begin_m = water.way[-1].copy()
        for frame in range(FRAMES):
            water.frame(*servo.frame(amplitude * sine[frame], amplitude * rises[frame]))
            if frame % FRAMES_PER_PICTURE == 0:
                picture = k * FPS + frame // FRAMES_PER_PICTURE
                pictures[picture] += position(water, in_frame_s[picture])
        true[:, k] = water.way[-1] - begin_m
    true += drawn.flow_m_s[:, None]
    straight = np.zeros(fish)
    water.frame(*servo.frame(straight, straight))
    pictures[-1] += position(water, in_frame_s[-1])
    speed, sigma = fit(pictures, beats)
    speed += drawn.flow_m_s[:, None]
    return BatchTrials(speed_m_s=speed, sigma_m_s=sigma, true_m_s=true)


def disagreement(fish: int, beats: int) -> float:
    """Largest difference to the simulator's batch in any result without noise, m/s."""
    quiet = dict.fromkeys(
        ("gain_sigma", "flow_sigma_m_s", "start_sigma_m_s", "camera_noise_m", "place_sigma_rad"),
        0.0,
    )
    batch = FishBatch("tank", [quiet] * fish)
    rng = np.random.default_rng(1)
    amplitude = rng.uniform(0, 0.75, (fish, beats))
    one, other = (
        batch.run(amplitude, 1),
        swim(batch.config(0), amplitude, draw(batch.config(0), fish, beats, rng)),
    )
    return max(
        float(np.abs(one.true_m_s - other.true_m_s).max()),
        float(np.abs(one.speed_m_s - other.speed_m_s).max()),
        float(np.abs(one.sigma_m_s - other.sigma_m_s).max()),
    )


def main(load: Load = FULL) -> int:
    """Compares and prints. Exit status 1 when the two disagree."""
    found_m_s = disagreement(load.fish, load.beats)
    print(f"numpy batch and simulator, without noise: within {found_m_s:.1e} m/s")
    return 0 if found_m_s <= DISAGREEMENT_MAX_M_S else 1


if __name__ == "__main__":
    raise SystemExit(main())
