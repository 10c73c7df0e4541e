"""The camera of a trial around START: what it raises before the fish may swim, and not after."""

from __future__ import annotations

from typing import Any, cast

import pytest

from tailbeat.core.speed_source import CameraGone
from tailbeat.session.trial import _reset_track, _Run
from tailbeat.session.trial_camera import TrialCamera


class LostCamera:
    """As a TrialCamera whose camera was unplugged; says what it was asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def begin(self) -> None:
        self.asked.append("begin")
        raise CameraGone("unplugged")

    def look_afresh(self) -> None:
        self.asked.append("look_afresh")


def test_a_camera_that_is_lost_ends_a_trial_only_before_its_first_start() -> None:
    camera = LostCamera()
    run = _Run(cast(Any, None), lambda event: None, None, 0.0, camera=cast(TrialCamera, camera))
    with pytest.raises(CameraGone):
        _reset_track(run, began=False)
    _reset_track(run, began=True)
    assert camera.asked == ["begin", "look_afresh"]
