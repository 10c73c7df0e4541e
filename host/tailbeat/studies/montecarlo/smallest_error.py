"""The smallest error that one fish allows, whatever the plant: in amplitudes, by the plant's own
differences, so that nothing is taken for granted of how thrust depends on them. The lowest of
several starts counts, as the search ends in the nearest optimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.montecarlo.batch import QUIET_TRIAL, Batch, batch_of, is_foreign
from tailbeat.studies.montecarlo.populations import still

_DIFFERENCE_RAD = 0.004
_STEPS_MAX = 25
_RADIUS_RAD, _RADIUS_MIN_RAD = 0.08, 5e-4
_GAINED_M_S = 2e-5  # less is not worth another step
_TRUSTED = 2.0  # growth of the radius from which on the derivatives are good for another step


def smallest_errors(
    plant: str,
    fish: dict[str, float],
    reference_m_s: F64,
    beat_s: float,
    amplitude_max_rad: float,
    starts: Sequence[F64],
    trials: Sequence[int] = (1,),
) -> tuple[F64, F64]:
    """(max|e| of the best input found for each of ``trials``, the best input of the first): on the
    noise-free fish as it has drifted at that trial. Linear programs in a trust region, for the
    first from each of ``starts``, for a later one from the best of the trial before. Costs about a
    second per start, a later trial half of that."""
    most_rad = amplitude_max_rad
    search = _Search(plant, still(fish), reference_m_s, beat_s, most_rad)
    found: list[_Place] = []
    for number in trials:
        search.number = QUIET_TRIAL if is_foreign(plant) else number
        begins = found[-1:] or [_Place(np.inf, start, None) for start in starts]
        ends = [search.descend(begin) for begin in begins]
        found.append(min(ends, key=lambda end: end.error_m_s))
    return np.array([place.error_m_s for place in found]), found[0].amplitude_rad


@dataclass(frozen=True)
class _Place:
    """``jacobian``: of somewhere near; None = not known."""

    error_m_s: float
    amplitude_rad: F64
    jacobian: F64 | None


@dataclass
class _Search:
    plant: str
    fish: dict[str, float]
    reference_m_s: F64
    beat_s: float
    most_rad: float
    number: int = 1
    batches: dict[int, Batch] = field(default_factory=dict)

    def speeds(self, rows: F64) -> F64:
        if (count := len(rows)) not in self.batches:
            self.batches[count] = batch_of(self.plant, [self.fish] * count)
        return self.batches[count].run(rows, self.number, self.beat_s).true_m_s

    def descend(self, start: _Place) -> _Place:
        """Derivatives are kept as long as they promise what comes true; where it ends they were
        those of that place."""
        amplitude = np.clip(start.amplitude_rad, 0.0, self.most_rad)
        speed = self.speeds(amplitude[None])[0]
        error, radius = self._error(speed), _RADIUS_RAD
        jacobian, is_old = start.jacobian, True
        for _ in range(_STEPS_MAX):
            if jacobian is None:
                jacobian, is_old = self._jacobian(amplitude, speed), False
            step, radius = self._largest_step(amplitude, speed, jacobian, error, radius)
            gained, growth = 0.0, 0.0
            if step is not None:
                amplitude, speed, growth = step
                radius *= growth
                gained, error = error - self._error(speed), self._error(speed)
            if gained < _GAINED_M_S and not is_old:
                break
            if gained < _GAINED_M_S or growth < _TRUSTED:
                jacobian, radius = None, max(radius, _RADIUS_RAD / 8)
            is_old = True
        return _Place(error, amplitude, jacobian)

    def _largest_step(
        self, amplitude: F64, speed: F64, jacobian: F64, error: float, radius: float
    ) -> tuple[tuple[F64, F64, float] | None, float]:
        """(that of ``_step`` with the first radius, halved again and again, that gains; the
        radius)."""
        while radius > _RADIUS_MIN_RAD:
            if (step := self._step(amplitude, speed, jacobian, error, radius)) is not None:
                return step, radius
            radius /= 2
        return None, radius

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
