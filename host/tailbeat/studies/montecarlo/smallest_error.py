"""The smallest error that one fish allows, whatever the plant: in amplitudes, by the plant's own
differences, so that nothing is taken for granted of how thrust depends on them. The lowest of
several starts counts, as the search ends in the nearest optimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.montecarlo.batch import QUIET_TRIAL, batch_of, is_foreign
from tailbeat.studies.montecarlo.populations import still

_DIFFERENCE_RAD = 0.004
_STEPS_MAX = 25
_RADIUS_RAD, _RADIUS_MIN_RAD = 0.08, 5e-4
_GAINED_M_S = 2e-5  # less is not worth another step


def smallest_error(
    plant: str,
    fish: dict[str, float],
    reference_m_s: F64,
    beat_s: float,
    amplitude_max_rad: float,
    starts: Sequence[F64],
    number: int = 1,
) -> tuple[float, F64]:
    """(max|e| of the best input found, the input): linear programs in a trust region, from each of
    ``starts``, on the noise-free fish as it has drifted at trial ``number``. Costs about a second
    per start."""
    if is_foreign(plant):
        number = QUIET_TRIAL
    search = _Search(plant, still(fish), number, reference_m_s, beat_s, amplitude_max_rad)
    return min((search.descend(start) for start in starts), key=lambda found: found[0])


@dataclass(frozen=True)
class _Search:
    plant: str
    fish: dict[str, float]
    number: int
    reference_m_s: F64
    beat_s: float
    most_rad: float

    def speeds(self, rows: F64) -> F64:
        batch = batch_of(self.plant, [self.fish] * len(rows))
        return batch.run(rows, self.number, self.beat_s).true_m_s

    def descend(self, start: F64) -> tuple[float, F64]:
        amplitude = np.clip(start, 0.0, self.most_rad)
        speed = self.speeds(amplitude[None])[0]
        error, radius = self._error(speed), _RADIUS_RAD
        for _ in range(_STEPS_MAX):
            jacobian = self._jacobian(amplitude, speed)
            step = None
            while radius > _RADIUS_MIN_RAD and step is None:
                step = self._step(amplitude, speed, jacobian, error, radius)
                radius = radius / 2 if step is None else radius
            if step is None:
                break
            amplitude, speed, radius = step[0], step[1], radius * step[2]
            gained, error = error - self._error(speed), self._error(speed)
            if gained < _GAINED_M_S:
                break
        return error, amplitude

    def _error(self, speed: F64) -> float:
        return float(np.abs(self.reference_m_s - speed).max())

    def _jacobian(self, amplitude: F64, speed: F64) -> F64:
        step = np.where(amplitude + _DIFFERENCE_RAD <= self.most_rad, 1, -1) * _DIFFERENCE_RAD
        moved = self.speeds(amplitude + np.diag(step))
        slopes: F64 = ((moved - speed) / step[:, None]).T
        return slopes

    def _step(
        self, amplitude: F64, speed: F64, jacobian: F64, error: float, radius: float
    ) -> tuple[F64, F64, float] | None:
        """(amplitudes, their speeds, by how much the radius may grow), None when no better."""
        from scipy.optimize import linprog

        count, off = len(amplitude), self.reference_m_s - speed
        ones = np.ones((count, 1))
        low, high = np.maximum(-radius, -amplitude), np.minimum(radius, self.most_rad - amplitude)
        found = linprog(
            np.append(np.zeros(count), 1.0),
            A_ub=np.vstack([np.hstack([-jacobian, -ones]), np.hstack([jacobian, -ones])]),
            b_ub=np.concatenate([-off, off]),
            bounds=[*zip(low, high, strict=True), (0, None)],
            method="highs",
        )
        if found.x is None:
            return None
        moved = np.clip(amplitude + found.x[:count], 0.0, self.most_rad)
        speeds = self.speeds(moved[None])[0]
        gained, promised = error - self._error(speeds), error - float(found.x[-1])
        if gained < 1e-7:
            return None
        share = gained / max(promised, 1e-12)
        return moved, speeds, 2.0 if share > 0.7 else 1.0 if share > 0.3 else 0.5
