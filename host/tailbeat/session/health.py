"""What is looked at before a fish swims at all: board, sensors, battery, camera."""

from __future__ import annotations

from tailbeat.board.diagnostics import look_at
from tailbeat.board.diagnostics.evidence import PROBLEM
from tailbeat.board.fish import Fish
from tailbeat.board.preserve import require_idle, restore_interrupted
from tailbeat.core.speed_source import Camera, SpeedSource, speed_source
from tailbeat.experiment.library import library_of, preserve_folder
from tailbeat.session.events import Operator, StepEnded, notice_to
from tailbeat.session.trial_camera import camera_of

HEALTH = "health"
_CAMERA_LOOK_S = 1.5  # of board time
_WORDS = {"imu": "IMU (motion sensor)"}


def check_health(
    fish: Fish, camera: Camera | None, operator: Operator, command: str, swims: bool = True
) -> StepEnded:
    """Whether a trial can run. ``command``: that is to be repeated once it is put right. ``swims``:
    for runs that need their speeds at once. An interrupted trim or identification is put right.
    Raises InputError for a board that is not idle."""
    restore_interrupted(fish, preserve_folder(library_of(fish)), notice_to(operator))
    require_idle(fish, command)
    params = fish.params.values()
    findings = look_at(fish)
    problems = [f"{one.name}: {one.line}" for one in findings if one.status == PROBLEM]
    well = [_WORDS.get(one.name, one.name) for one in findings if one.status != PROBLEM]
    source = speed_source(params)
    with camera_of(fish, camera) as used:
        seen, why = _seen(fish, used, source, swims)
    if why:
        problems.append(why)
    words = f"{', '.join(well)}: well; {seen}"
    if not source.sampled:
        words += f"; speeds by {source.name}"
    return StepEnded(HEALTH, not problems, "; ".join(problems) or words)


def _seen(fish: Fish, camera: Camera | None, source: SpeedSource, swims: bool) -> tuple[str, str]:
    """(what the camera sees, what is wrong)."""
    if source.uploaded:
        words = (
            "speeds: SPD_SOURCE is upload, and commissioning needs them while it swims; set"
            " another, or do it by hand: tailbeat session identify, tailbeat session design"
        )
        return ("speeds are uploaded", "") if not swims else ("", words)
    if camera is None:
        text = "camera: there is none, and SPD_SOURCE is vision. Give --camera"
        return ("no camera", "") if not source.sampled else ("", text)
    fish.link.run(_CAMERA_LOOK_S / max(fish.clock.rate, 1.0))
    frames = camera.frames()
    if not frames:
        return "", "camera: it does not see the fish. Look at light and marker: camera track"
    return "the camera sees the fish", ""
