"""A film and a trial are put together: by the LED's code, by the yaw, and refused when wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from numpy.typing import ArrayLike

from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.errors import InputError
from tailbeat.core.speed_source import Frame
from tailbeat.core.trial_file import NO_MOTION, Trial, read_trial
from tailbeat.sensors.camera.led import Waveform, read_led
from tailbeat.sensors.camera.sync import WrongPair, read_yaw, sync, sync_by_led, sync_by_yaw
from tailbeat.sensors.camera.tracking.track import LOST, SEEN, Track
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import default_camera

from ...led_films import LedFilm

LED_MAX_S, YAW_MAX_S = 0.010, 0.040
YAW_BIAS_MAX_S = 0.012  # the simulated IMU is 20 ms late, sync.py subtracts half of it
IN_TWO_SIGMA = 0.9


@dataclass(frozen=True)
class Swim:
    """A trial's file, the film of it as a track, and when it truly began."""

    trial: Trial
    track: Track
    start_s: float


class Watching:
    """The simulated camera, with what it gave."""

    def __init__(self, fish: Fish) -> None:
        camera = default_camera(fish)
        assert camera is not None
        self._camera = camera
        self.clock, self.fps = camera.clock, camera.fps
        self.seen: list[Frame] = []

    def frames(self) -> list[Frame]:
        found = self._camera.frames()
        self.seen += found
        return found

    def close(self) -> None:
        self._camera.close()


def track_of(frames: list[Frame], fps: float) -> Track:
    begin_s = frames[0].t_s
    row = np.array([round((frame.t_s - begin_s) * fps) for frame in frames])
    columns = np.full((4, row[-1] + 1), np.nan)
    columns[:, row] = np.array([[f.t_s - begin_s, f.x_m, f.y_m, f.heading_rad] for f in frames]).T
    t_s = np.where(np.isnan(columns[0]), np.arange(columns.shape[1]) / fps, columns[0])
    seen = np.isfinite(columns[1])
    state = np.where(seen, SEEN, LOST).astype(np.uint8)
    return Track(t_s, *columns[1:], seen * 1.0, state, fps, "film.mp4")


def trials(
    seed: int,
    count: int = 1,
    fps: float = 25.0,
    amplitudes: list[ArrayLike] | None = None,
    wanted: reference.Reference | None = None,
) -> list[Swim]:
    """Trials one after another: of ``amplitudes``, or as the fish learns."""
    found = []
    with (
        Fish.connect("sim:tank", seed=seed, camera_fps=fps, camera_lost=0.1) as fish,
        TemporaryDirectory() as folder,
    ):
        assert fish.sim is not None
        for name, value in {"DU_MAX_RAD": 0, "AMP_MAX_RAD": 0.785, "ILC_LEAD": 1}.items():
            fish.params.set(name, value)
        fish.upload_reference(wanted or reference.thesis())
        fish.link.run(5.0)
        for i in range(count):
            if amplitudes is not None:
                fish.upload_amplitudes(amplitudes[i])
            camera = Watching(fish)
            fish.link.run(1.0)
            booted_s = fish.sim.time_s - fish.sim.board_time_s
            outcome = run_trial(fish, camera)
            trial = read_trial(fish.pull_trial(outcome.number, Path(folder)))
            start_s = trial.start_us * 1e-6 + booted_s - camera.seen[0].t_s
            found.append(Swim(trial, track_of(camera.seen, fps), start_s))
            if amplitudes is None:
                fish.learn(outcome.number)
            else:
                fish.discard(outcome.number)
    return found


@pytest.fixture(scope="module")
def learned() -> list[Swim]:
    """Three trials of a learning fish."""
    return trials(3, 3)


def assert_honest(errors_s: list[float], sigmas_s: list[float], most_s: float, name: str) -> None:
    error, sigma = np.array(errors_s), np.array(sigmas_s)
    part = float(np.mean(np.abs(error) <= 2 * sigma))
    print(
        f"{name}: {len(error)} films, |error| <= {np.abs(error).max() * 1e3:.1f} ms, "
        f"RMS {np.sqrt(np.mean(error**2)) * 1e3:.1f}, mean {error.mean() * 1e3:+.1f}, "
        f"sigma {np.median(sigma) * 1e3:.1f} (median), in 2 sigma {part:.0%}"
    )
    assert np.abs(error).max() <= most_s
    assert part >= IN_TWO_SIGMA
    assert np.median(sigma) <= most_s / 2


def led_study(film: LedFilm, seeds: range, name: str, length: bool = True) -> None:
    errors, sigmas = [], []
    for seed in seeds:
        number = 37 * seed % 256
        track, start_s = replace(film, number=number).make(seed)
        found = read_led(track, film.swim_s if length else None)
        assert found.number == number, seed
        errors.append(found.begin_s - start_s)
        sigmas.append(found.sigma_s)
    assert_honest(errors, sigmas, LED_MAX_S, name)


def test_the_waveform_is_the_firmware_s() -> None:
    wave = Waveform.of(165, 20.0)
    track = LedFilm(number=165, swim_s=20.0)
    moments = np.random.default_rng(1).uniform(0.1, 19.9, 500)
    for exposure_s in (0.004, 0.03):
        np.testing.assert_allclose(
            wave.lit(moments, exposure_s), track._lit(moments, exposure_s), atol=0.03
        )


@pytest.mark.parametrize("fps", [25.0, 60.0])
def test_led_tells_begin_and_number(fps: float) -> None:
    led_study(LedFilm(fps=fps, swim_s=12.0, hidden=0.1), range(2), f"LED, {fps:g}/s")


def test_led_without_knowing_the_trial() -> None:
    led_study(
        LedFilm(swim_s=12.0, after_s=6.0, hidden=0.1),
        range(1, 2),
        "LED, length not known",
        length=False,
    )


def test_led_of_a_film_of_the_middle_of_a_swim() -> None:
    film = LedFilm(swim_s=26.0, before_s=-7.0, after_s=-6.0, hidden=0.1)
    led_study(film, range(1), "LED, from the middle")


def test_led_with_uneven_time_stamps() -> None:
    led_study(LedFilm(swim_s=12.0, jitter_s=0.02, hidden=0.1), range(1), "LED, uneven stamps")


@pytest.mark.soak
def test_led_of_films_that_make_it_hard() -> None:
    film = LedFilm(swim_s=20.0, hidden=0.25)
    late = replace(film, after_s=12.0)
    led_study(late, range(5), "LED, length not known", length=False)
    led_study(replace(film, jitter_s=0.02), range(5), "LED, uneven stamps")
    middle = LedFilm(swim_s=40.0, before_s=-12.0, after_s=-8.0, hidden=0.2)
    led_study(middle, range(5), "LED, from the middle")


@pytest.mark.soak
@pytest.mark.parametrize("fps", [25.0, 60.0])
@pytest.mark.parametrize("hidden_s", [0.0, 1.0])
def test_led_over_twenty_seeds(fps: float, hidden_s: float) -> None:
    film = LedFilm(fps=fps, hidden_s=hidden_s, hidden=0.4 if hidden_s else 0.5)
    led_study(film, range(20), f"LED, {fps:g}/s, hidden for {hidden_s:g} s")


@pytest.mark.soak
def test_films_without_led_are_never_read() -> None:
    for seed in range(20):
        for fps in (25.0, 60.0):
            track, _ = LedFilm(fps=fps, led=False).make(seed)
            with pytest.raises(InputError, match="LED blinks"):
                read_led(track, 40.0)


def test_a_film_without_led_says_so() -> None:
    track, _ = LedFilm(led=False, swim_s=12.0).make(5)
    with pytest.raises(InputError, match="no LED blinks") as error:
        read_led(track)
    assert not isinstance(error.value, WrongPair)
    with pytest.raises(InputError, match="nobody looked for the LED"):
        read_led(replace(track, patch=None))


def test_another_number_is_refused(learned: list[Swim]) -> None:
    trial = learned[0].trial
    trial = replace(trial, executed_beats=11)
    track, start_s = LedFilm(number=trial.number, swim_s=11.0, hidden=0.0).make(1)
    found = sync_by_led(track, replace(trial, number=trial.number + 256))
    assert found.trial == trial.number
    assert abs(found.start_s - start_s) <= LED_MAX_S
    with pytest.raises(WrongPair, match=r"shows trial 1 \(or one 256 away\), the file is trial 8"):
        sync_by_led(track, replace(trial, number=8))


def yaw_study(found: list[Swim], name: str) -> None:
    errors, sigmas = [], []
    for trial in found:
        result = sync_by_yaw(trial.track, trial.trial)
        assert result.how == "yaw"
        assert result.score > 0.9
        errors.append(result.start_s - trial.start_s)
        sigmas.append(result.sigma_s)
    assert_honest(errors, sigmas, YAW_MAX_S, name)
    assert abs(np.mean(errors)) <= YAW_BIAS_MAX_S


def test_yaw_tells_the_begin(learned: list[Swim]) -> None:
    yaw_study(learned + trials(4, fps=60.0), "yaw")


def test_yaw_of_part_of_a_film(learned: list[Swim]) -> None:
    trial = learned[2]
    for first, last in ((10.0, 60.0), (0.0, 30.0), (12.0, 32.0)):
        inside = (trial.track.t_s >= first) & (trial.track.t_s < last)
        columns = ("t_s", "x_m", "y_m", "heading_rad", "quality", "state")
        part = replace(
            trial.track, **{name: getattr(trial.track, name)[inside] for name in columns}
        )
        assert abs(sync_by_yaw(part, trial.trial).start_s - trial.start_s) <= YAW_MAX_S


def test_yaw_bears_drift_and_a_few_wrong_headings(learned: list[Swim]) -> None:
    trial = learned[1]
    drift = 0.3 * np.sin(trial.track.t_s / 9) + 0.02 * trial.track.t_s
    drift += np.where(np.arange(len(drift)) % 40 == 7, 0.8, 0.0)
    track = replace(trial.track, heading_rad=trial.track.heading_rad + drift)
    assert abs(sync_by_yaw(track, trial.trial).start_s - trial.start_s) <= YAW_MAX_S


def test_yaw_of_another_trial_is_refused(learned: list[Swim]) -> None:
    for i, film in enumerate(learned):
        for k, file in enumerate(learned):
            if i != k:
                with pytest.raises(WrongPair, match="do not go together"):
                    sync_by_yaw(film.track, file.trial)


def test_equal_beats_tell_no_beat() -> None:
    """A cruise, of which the film shows the middle."""
    wanted = reference.Reference(1.0, np.full(20, 0.05, dtype=np.float32), "cruise")
    trial = trials(5, amplitudes=[np.full(20, 0.5)], wanted=wanted)[0]
    whole = sync_by_yaw(trial.track, trial.trial)
    assert abs(whole.start_s - trial.start_s) <= YAW_MAX_S
    middle = (trial.track.t_s > trial.start_s + 5) & (trial.track.t_s < trial.start_s + 14)
    columns = ("t_s", "x_m", "y_m", "heading_rad", "quality", "state")
    part = replace(trial.track, **{name: getattr(trial.track, name)[middle] for name in columns})
    with pytest.raises(WrongPair, match="another beat"):
        sync_by_yaw(part, trial.trial)


def test_a_file_without_turns_or_a_film_without_yaw(learned: list[Swim]) -> None:
    trial = learned[0]
    none = np.full_like(trial.trial.slots.turn_100urad, NO_MOTION)
    blind = replace(trial.trial, slots=replace(trial.trial.slots, turn_100urad=none))
    with pytest.raises(InputError, match="does not say how the fish turned") as error:
        sync_by_yaw(trial.track, blind)
    assert not isinstance(error.value, WrongPair)
    noise = np.random.default_rng(1).normal(0, 0.01, len(trial.track.t_s))
    still = replace(trial.track, heading_rad=np.where(trial.track.seen(), noise, np.nan))
    with pytest.raises(InputError, match="no yaw oscillation") as error:
        sync_by_yaw(still, trial.trial)
    assert not isinstance(error.value, WrongPair)
    with pytest.raises(InputError, match=r"nobody looked for the LED.* does not say how"):
        sync(trial.track, blind)


def test_headings_that_are_all_equal(learned: list[Swim]) -> None:
    """Frozen pictures, a fish that is held, a drawn film."""
    trial = learned[0]
    for heading_rad in (0.0, 0.3):
        heading = np.where(trial.track.seen(), heading_rad, np.nan)
        with pytest.raises(InputError, match="shows no yaw oscillation") as error:
            sync_by_yaw(replace(trial.track, heading_rad=heading), trial.trial)
        assert not isinstance(error.value, WrongPair)
        heading[:75] += 0.02 * np.sin(np.arange(75))
        with pytest.raises(InputError):
            sync_by_yaw(replace(trial.track, heading_rad=heading), trial.trial)


def test_a_trial_that_was_aborted_early(learned: list[Swim]) -> None:
    short = replace(learned[0].trial, number=7, executed_beats=3)
    track, _ = LedFilm(swim_s=3.0, hidden=0.0).make(1)
    says = "trial 7 has only 3 executed beats: too short to be put in time with a film"
    for way in (sync, sync_by_yaw):
        with pytest.raises(InputError) as error:
            way(replace(track, heading_rad=np.zeros(len(track.t_s))), short)
        assert error.value.message == says
        assert "--start" in error.value.remedy
        assert not isinstance(error.value, WrongPair)
    with pytest.raises(InputError, match="trial 7 has only 1 executed beat: too short"):
        sync(track, replace(short, executed_beats=1))


def with_led(trial: Swim, late_s: float = 0.0, number: int | None = None) -> Track:
    """The same film with an LED in it."""
    number = trial.trial.number if number is None else number
    film = LedFilm(number=number, lost=0.0, hidden=0.2, before_s=0.0)
    track, start_s = replace(film, swim_s=trial.trial.executed_beats * 1.0).make(1)
    row = np.round((trial.track.t_s - trial.start_s - late_s + start_s) * film.fps).astype(int)
    inside = (row >= 0) & (row < len(track.t_s))
    assert track.patch is not None
    patch = np.zeros((len(trial.track.t_s), *track.patch.shape[1:]), np.uint8)
    around = np.s_[2:11, 17:38]  # the rest takes time only
    patch[inside, *around] = track.patch[row[inside], *around]
    return replace(trial.track, patch=patch)


def test_both_ways_must_agree(learned: list[Swim]) -> None:
    trial = learned[1]
    found = sync(with_led(trial), trial.trial)
    assert found.how == "led"
    assert abs(found.start_s - trial.start_s) <= 0.03  # its pictures are up to half a period off
    assert sync(trial.track, trial.trial).how == "yaw"
    with pytest.raises(WrongPair, match="the LED says"):
        sync(with_led(trial, late_s=0.4), trial.trial)
    other = replace(learned[2].trial, number=trial.trial.number)
    with pytest.raises(WrongPair, match="is of another trial"):
        sync(with_led(trial), other)


def by_amplitude(film: Swim, file: Swim) -> float:
    """How different the amplitudes of two trials are."""
    a, b = film.trial.beats.applied_rad, file.trial.beats.applied_rad
    return float(np.sqrt(np.mean((a - b) ** 2) / np.mean(a**2)))


@pytest.mark.soak
@pytest.mark.parametrize("fps", [25.0, 60.0])
def test_right_and_wrong_pairs_by_the_hundred(fps: float) -> None:
    """Every film of a learning fish with every file of it."""
    right: list[Swim] = []
    accepted: dict[bool, list[tuple[float, bool]]] = {True: [], False: []}
    for seed in range(1, 21):
        found = trials(seed, 5, fps)
        right += found
        for film in found:
            for file in found:
                taken = takes(lambda film=film, file=file: read_yaw(film.track, file.trial))
                accepted[film is file].append((by_amplitude(film, file), taken))
    yaw_study(right, f"yaw, {fps:g}/s")
    assert all(taken for _, taken in accepted[True])
    edges = (0.0, 0.03, 0.05, 0.1, 10.0)
    for low, high in pairwise(edges):
        taken = [t for differs, t in accepted[False] if low <= differs < high]
        print(f"amplitudes {low:.0%} to {high:.0%} apart: {sum(taken)} of {len(taken)} taken")
    far = [taken for differs, taken in accepted[False] if differs > 0.1]
    assert sum(far) <= 0.01 * len(far)


def takes(what: Callable[[], object]) -> bool:
    try:
        what()
    except Exception as error:
        assert type(error).__name__ == "Misfit", error
        return False
    return True
