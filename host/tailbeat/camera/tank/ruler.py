"""A stick of known length in the tank: are the metres of a calibration metres?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.marker.printed import RULER_IDS
from tailbeat.camera.tank.calibration import SCALE_ERROR_MAX, Calibration
from tailbeat.errors import InputError

Floats = NDArray[np.float64]

END_SIGMA_PX = 0.2
SIGMA_MAX = SCALE_ERROR_MAX / 2


@dataclass(frozen=True)
class RulerCheck:
    """``scale_error``: measured over true length, less one. ``sigma``: of that, from finding the
    ends within END_SIGMA_PX each."""

    name: str
    true_m: float
    measured_m: float
    sigma: float

    @property
    def scale_error(self) -> float:
        """Relative; positive = the calibration takes things for longer than they are."""
        return self.measured_m / self.true_m - 1


def ruler_ends(seen: dict[int, tuple[float, float]], name: str) -> Floats:
    """Pixels (2, 2) of the ruler's two among the markers ``seen`` in the picture ``name``. Raises
    InputError when they are not both there."""
    missing = [str(i) for i in RULER_IDS if i not in seen]
    if missing:
        raise InputError(
            f"{name} does not show the ruler's marker{'s' * (len(missing) - 1)} "
            f"{' and '.join(missing)}",
            "Lay the ruler flat, wholly in view, without glare; print it: tailbeat camera print "
            "ruler",
        )
    return np.array([seen[i] for i in RULER_IDS])


def check_ruler(calibration: Calibration, ends_px: Floats, true_m: float, name: str) -> RulerCheck:
    """Measures the ruler between ``ends_px`` (2, 2). Raises InputError when it is too short in the
    picture to tell half a percent. Whether the scale is right: ``refuse_scale``."""
    if not 0 < true_m < np.inf:
        raise InputError(f"a ruler of {true_m:g} m cannot be", "Its length in metres.")
    width, height = calibration.size_px
    inside = (ends_px >= -0.5) & (ends_px <= [width - 0.5, height - 0.5])
    if not inside.all():
        raise InputError(
            f"{name}: the ruler's ends are not in the picture of {width}x{height}",
            "Give them as U1,V1,U2,V2 in pixels.",
        )
    measured = _length(calibration, ends_px)
    slopes = [
        (_length(calibration, ends_px + step) - _length(calibration, ends_px - step)) / 2
        for step in np.eye(4).reshape(4, 2, 2)
    ]
    sigma = END_SIGMA_PX * float(np.linalg.norm(slopes)) / true_m
    if not sigma <= SIGMA_MAX:
        raise InputError(
            f"{name}: the ruler is too short in the picture to check by: {true_m:g} m "
            f"within {sigma * 100:.1f} %",
            "Use one as long as the tank allows, at least a quarter of the picture.",
        )
    return RulerCheck(name, true_m, measured, sigma)


def refuse_scale(check: RulerCheck, known_camera: bool) -> None:
    """Raises InputError, with what can be wrong, when the scale is off by more than
    SCALE_ERROR_MAX. ``known_camera``: the lens is from pictures of the board."""
    if abs(check.scale_error) <= SCALE_ERROR_MAX:
        return
    board = (
        "The camera was taken to be free of distortion: give pictures of the board (--board). "
        if not known_camera
        else ""
    )
    raise InputError(
        f"{check.name}: the ruler of {check.true_m:g} m measures {check.measured_m:.3f} m, "
        f"{check.scale_error * 100:+.1f} % (sigma {check.sigma * 100:.1f} %, at most "
        f"{SCALE_ERROR_MAX * 100:g} %)",
        f"{board}Is the ruler at the marker's height (if not the points, then --raise or --depth)? "
        "Are the points and the ruler's length typed right? Is it the same camera, zoom and "
        "setting?",
    )


def _length(calibration: Calibration, ends_px: Floats) -> float:
    a, b = calibration.to_tank(ends_px)
    return float(np.hypot(*(b - a)))
