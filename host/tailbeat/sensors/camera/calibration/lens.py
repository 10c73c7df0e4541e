"""A lens's distortion, taken out of pixels and put back."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.sensors.camera.opencv import cv2

_FAR_PX = 1e6
_ROUNDS, _CLOSE_PX = 60, 1e-7
_OUTSIDE = 1.05
_NOTHING = 1e-12


class Lens:
    """OpenCV's pinhole and Brown-Conrady model. ``camera_matrix`` (3, 3) without skew,
    ``distortion`` (5,): k1, k2, p1, p2, k3."""

    def __init__(self, camera_matrix: F64, distortion: F64) -> None:
        self.camera_matrix = np.ascontiguousarray(camera_matrix, dtype=np.float64)
        self.distortion = np.ascontiguousarray(distortion, dtype=np.float64)
        self.focal_px = self.camera_matrix[[0, 1], [0, 1]]
        self.middle_px = self.camera_matrix[:2, 2]
        self.straight = not self.distortion.any()

    def undistorted(self, points_px: F64) -> F64:
        """Pixels (n, 2) of the picture to pixels (n, 2) of the same camera without distortion."""
        points = _rows(points_px)
        if self.straight or not len(points):
            return points.reshape(-1, 2)
        matrix = self.camera_matrix
        found: F64 = cv2.undistortPoints(
            points, matrix, self.distortion, None, None, matrix, self._stop
        )
        return found.reshape(-1, 2)

    def distorted(self, points_px: F64) -> F64:
        """The way back. Points beyond where the model folds over are put outside the picture, in
        their direction, instead of somewhere in it."""
        points = np.asarray(points_px, dtype=np.float64).reshape(-1, 2)
        rays = np.ones((len(points), 3))
        rays[:, :2] = (points - self.middle_px) / self.focal_px
        return self.pixels(rays)

    def pixels(self, rays: F64) -> F64:
        """Where directions x, y, 1 in the camera's frame, (n, 3), are in the picture: (n, 2); as
        in ``distorted``."""
        if self.straight or not len(rays):
            return rays[:, :2] * self.focal_px + self.middle_px
        found: F64 = cv2.projectPoints(rays, _ZERO, _ZERO, self.camera_matrix, self.distortion)[0]
        found = found.reshape(-1, 2)
        if self.fold_radius < np.inf:
            self._put_outside(found, rays[:, :2])
        return found

    def determinant(self, points_px: F64) -> F64:
        """Of undistorted pixels (n, 2): the determinant of the distortion's derivative, 1 in the
        middle of a picture; -1 where the model folds over."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = ((_rows(points_px).reshape(-1, 2) - self.middle_px) / self.focal_px).T
        s = x * x + y * y
        radial = 1 + s * (k1 + s * (k2 + s * k3))
        slope = 2 * (k1 + s * (2 * k2 + s * 3 * k3))  # of radial, over x or y
        a = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
        d = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
        b = x * y * slope + 2 * p1 * x + 2 * p2 * y
        found: F64 = np.where((s < self.fold_radius**2) & (a > 0), a * d - b * b, -1.0)
        return found

    @cached_property
    def fold_radius(self) -> float:
        """Distance from the axis, over the focal length, up to which distortion is monotonic."""
        k1, k2, _, _, k3 = self.distortion
        terms = np.array([7 * k3, 5 * k2, 3 * k1, 1.0])
        terms[np.abs(terms) < _NOTHING] = 0.0
        roots = np.roots(terms)
        turns = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
        return float(np.sqrt(turns.min())) if len(turns) else np.inf

    @cached_property
    def _stop(self) -> tuple[int, int, float]:
        return (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _ROUNDS, _CLOSE_PX)

    def _put_outside(self, found: F64, rays: F64) -> None:
        radius = np.sqrt(np.einsum("ij,ij->i", rays, rays))
        if radius.max() <= self.fold_radius:
            return
        k1, k2, _, _, k3 = self.distortion
        s = self.fold_radius**2
        edge = self.fold_radius * (1 + s * (k1 + s * (k2 + s * k3)))
        beyond = radius > self.fold_radius
        stretch = np.maximum(1.0, _OUTSIDE * edge / radius[beyond])[:, None]
        outside = self.middle_px + rays[beyond] * stretch * self.focal_px
        found[beyond] = np.clip(outside, -_FAR_PX, _FAR_PX)


_ZERO = np.zeros(3)


def _rows(points: F64) -> F64:
    """As OpenCV takes points."""
    return np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 1, 2)
