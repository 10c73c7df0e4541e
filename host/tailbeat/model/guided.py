"""Identifies a connected fish: the runs of ``runs`` swum one by one on its board.

Whatever the board had learned, and its reference, is put back afterwards, also after Ctrl-C or an
error; until then a copy lies on the disk. An identification that was
broken off leaves the copy behind, and the next one puts that back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tailbeat import laws
from tailbeat.boardreference import REST
from tailbeat.errors import InputError, TailbeatError
from tailbeat.flashing.backup import Backup
from tailbeat.model.fitting import Prior
from tailbeat.model.identified import Identified
from tailbeat.model.runs import Limits, Run, identify_runs
from tailbeat.model.safekeeping import forget, is_of_a_run, note_reference, put_safe
from tailbeat.model.swim import Swim, swim_of
from tailbeat.records import decode_reference, record_crc
from tailbeat.reference import Reference
from tailbeat.results import SPEED_SOURCES, BeatEvent
from tailbeat.trial_log import read_trial

if TYPE_CHECKING:
    from tailbeat.camera.base import Camera
    from tailbeat.fish import Event, Fish
    from tailbeat.results import BoardStatus

Array = NDArray[np.float64]

MODEL_PARAMS = {
    "MDL_KAPPA": "kappa_per_m",
    "MDL_SLOPE": "slope_m_s_rad",
    "MDL_DEAD_RAD": "dead_zone_rad",
    "MDL_DELAY_S": "delay_s",
}
_SPEED_SIGMA_M_S = 0.001  # of speeds that somebody uploads
_PUT_BACK_TRIES = 3
_STOP_LOOKS, _STOP_LOOK_S = 60, 0.5  # of board time; settling takes no longer


@dataclass(frozen=True)
class Person:
    """Who stands at the tank. ``before``: told of each run, returns when it may begin, raises to
    end it all. ``speeds``: (trial, beats, beat_s) to speeds measured after the swim, NaN = not
    measured, one per beat; None: nobody can give any. ``event``: what happens meanwhile. ``keep``:
    gets every trial's file. ``note``: told what else a person should know."""

    before: Callable[[Run], None] = lambda run: None
    speeds: Callable[[int, int, float], ArrayLike] | None = None
    event: Callable[[Event], None] = lambda event: None
    keep: Callable[[Path], object] = lambda path: None
    note: Callable[[str], None] = lambda text: None


def identify_fish(
    fish: Fish,
    person: Person,
    safe: Path | None = None,
    camera: Camera | None = None,
    limits: Limits | None = None,
    quick: bool = False,
) -> Identified:
    """Swims the runs and fits the fish to them. ``safe``: folder for the copy of what the board
    held; a copy that is there already is put back when a run was broken off, and never overwritten.
    Raises InputError when the board cannot begin, TailbeatError when a run goes wrong."""
    _require_ready(fish, safe)
    params = {name: p.value for name, p in fish.params.list().items()}
    source = SPEED_SOURCES[round(params["SPD_SOURCE"])]
    if source == "upload" and person.speeds is None:
        raise InputError(
            "SPD_SOURCE is upload, and nobody is asked for the speeds.",
            "Leave out --yes and --json, or swim by hand and give the files with --trials.",
        )
    held = _held(fish, params)
    if safe is not None:
        held = put_safe(safe, held, person.note)
    swimmer = _Swimmer(fish, person, params, source, camera, safe)
    try:
        return identify_runs(
            swimmer.swim,
            limits or Limits.from_params(params),
            prior_of(params),
            on_run=swimmer.begin,
            quick=quick,
            unique_id=held.unique_id,
        )
    finally:
        _put_back(fish, held, safe)


def prior_of(params: dict[str, float]) -> Prior:
    """Around the model the board has, as wide as for any fish."""
    from tailbeat.model.fishmodel import FishModel

    values = {field: params[name] for name, field in MODEL_PARAMS.items()}
    fits = values["kappa_per_m"] > 0 and values["slope_m_s_rad"] > 0
    return Prior(FishModel(**values)) if fits else Prior()


def set_params(fish: Fish, identified: Identified) -> dict[str, float]:
    """The model becomes the board's, for good; what was assumed does not. Other parameters that
    were changed but not saved stay so."""
    wanted = {
        name: getattr(identified.model, field)
        for name, field in MODEL_PARAMS.items()
        if field not in identified.assumed
    }
    now = {name: p.value for name, p in fish.params.list().items()}
    fish.params.load()
    stored = {name: p.value for name, p in fish.params.list().items()}
    for name, value in wanted.items():
        fish.params.set(name, value)
    fish.params.save()
    for name, value in now.items():
        if name not in wanted and stored[name] != value:
            fish.params.set(name, value)
    return {name: fish.params.get(name).value for name in wanted}


def _require_ready(fish: Fish, safe: Path | None) -> None:
    status = fish.status()
    if status.pending_trial is not None and is_of_a_run(safe, status.reference_crc):
        raise InputError(
            f"trial {status.pending_trial} is a run of an identification that was broken off.",
            "tailbeat trial discard, then identify again: it puts back what the board had learned.",
        )
    if status.pending_trial is not None:
        raise InputError(
            f"trial {status.pending_trial} is neither learned nor discarded.",
            "tailbeat learn, or tailbeat trial discard; then identify.",
        )
    if status.state != "IDLE":
        raise InputError(
            f"the board is {status.state}, not IDLE.",
            "tailbeat disarm or tailbeat clear; then identify.",
        )


def _held(fish: Fish, params: dict[str, float]) -> Backup:
    """What the runs would overwrite."""
    info = fish.info()
    reference = fish.reference_record()
    learned = fish.learned_record()
    if reference is not None and _is_guess(fish, info.status, reference, params):
        learned = None  # arming makes it anew, by the gain of that moment
    return Backup(
        unique_id=info.unique_id,
        build_id=info.build_id,
        params={},
        next_trial=info.status.next_trial,
        reference=reference,
        learned=learned,
    )


def _is_guess(fish: Fish, status: BoardStatus, reference: bytes, params: dict[str, float]) -> bool:
    """Whether the amplitudes are just what the law makes of the reference."""
    if status.iteration != 1 or status.best_iteration is not None:
        return False
    wanted = decode_reference(reference)
    first = laws.first(laws.Law.from_params(params, wanted.beat_s), wanted.speed_m_s)
    return np.array_equal(first, fish.amplitudes().values)


def _put_back(fish: Fish, held: Backup, safe: Path | None) -> None:
    """Ctrl-C does not stop it halfway."""
    for attempt in range(1, _PUT_BACK_TRIES + 1):
        try:
            _restore(fish, held, safe)
        except KeyboardInterrupt:
            if attempt == _PUT_BACK_TRIES:
                raise
            continue
        except TailbeatError as error:
            where = f"; a copy is in {safe}" if safe is not None else ""
            raise TailbeatError(
                f"what the board had learned could not be put back ({error.message}){where}.",
                f"Connect again, then: tailbeat flash --restore {safe}" if safe is not None else "",
            ) from error
        break
    if safe is not None:
        forget(safe)


def _restore(fish: Fish, held: Backup, safe: Path | None) -> None:
    state = _stopped(fish)
    if state == "ARMED":
        fish.disarm()
    elif state in ("ABORTED", "FAULT"):
        fish.clear()
    if (pending := fish.status().pending_trial) is not None:
        fish.discard(pending)
    if held.reference is None and safe is not None:
        note_reference(safe, record_crc(REST.record()))
    fish.upload_reference(held.reference or REST)
    if held.learned is not None:
        fish.upload_learned(held.learned)


def _stopped(fish: Fish) -> str:
    """Ends a swim that nobody waits for any more; the state it leaves."""
    state = fish.status().state
    if state == "RUNNING":
        fish.abort()
    for _ in range(_STOP_LOOKS):
        if (state := fish.status().state) not in ("RUNNING", "SETTLING", "LEARNING"):
            break
        fish.link.run(_STOP_LOOK_S / max(fish.clock.rate, 1.0))
    return state


@dataclass
class _Swimmer:
    """Swims runs on the board."""

    fish: Fish
    person: Person
    params: dict[str, float]
    source: str
    camera: Camera | None
    safe: Path | None
    run: Run | None = field(default=None)

    def begin(self, run: Run) -> None:
        self.run = run
        self.person.before(run)

    def swim(self, amplitude: Array) -> Swim:
        assert self.run is not None
        fish = self.fish
        self._upload(self.run, amplitude)
        outcome = fish.run_trial(self.camera, self.person.event, _Guard(self._way_m()))
        if outcome.interrupted:
            raise KeyboardInterrupt
        if outcome.end != "complete":
            self._judge_end(self.run, outcome.end, outcome.executed_beats)
        if self.source == "upload":
            self._upload_speeds(outcome.number)
        with TemporaryDirectory() as folder:
            path = fish.pull_trial(outcome.number, Path(folder))
            self.person.keep(path)
            swum = swim_of(read_trial(path))
        fish.discard(outcome.number)
        return swum

    def _way_m(self) -> float:
        """What the tank has for the fish's way; 0 = not checked."""
        tank_m = self.params["TANK_LEN_M"]
        return max(tank_m - self.params["FISH_LEN_M"], 0.01) if tank_m > 0 else 0.0

    def _upload(self, run: Run, amplitude: Array) -> None:
        """The reference is the prediction, so that the trial's error is the model's."""
        speed = np.clip(run.predicted_m_s, 0.0, self.params["REF_MAX_M_S"]).astype(np.float32)
        name = f"identify {run.number}"
        limit = np.float32(self.params["AMP_MAX_RAD"])
        record = Reference(1.0, speed, name).record()
        if self.safe is not None:
            note_reference(self.safe, record_crc(record))
        self.fish.upload_reference(record)
        self.fish.upload_amplitudes(np.minimum(amplitude.astype(np.float32), limit))

    def _judge_end(self, run: Run, end: str, beats: int) -> None:
        """A run that was stopped for lack of room has told enough."""
        self.fish.clear()
        if end == "aborted:ABORT_COMMAND" and beats > 2:
            return
        raise TailbeatError(
            f"run {run.number} ended with {end} after {beats} beats.",
            "Put it right, then identify again.",
        )

    def _upload_speeds(self, trial: int) -> None:
        assert self.run is not None and self.person.speeds is not None
        speeds = self.person.speeds(trial, self.run.beats, 1.0)
        self.fish.upload_speeds(trial, speeds, np.full(self.run.beats, _SPEED_SIGMA_M_S))


@dataclass
class _Guard:
    """Stops a fish that swims farther than the tank allows; speeds come a beat or two late."""

    room_m: float
    late_beats: float = 2.0
    way_m: float = 0.0
    last_beat: int = -1

    def __call__(self, seen: object) -> str | None:
        if self.room_m <= 0 or not isinstance(seen, BeatEvent) or seen.speed_m_s is None:
            return None
        if seen.beat > self.last_beat:
            self.way_m += seen.speed_m_s * (seen.beat - self.last_beat)
            self.last_beat = seen.beat
        if self.way_m + self.late_beats * seen.speed_m_s < self.room_m:
            return None
        return "the fish swims farther than the run was planned for"
