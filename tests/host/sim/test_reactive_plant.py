"""The reactive plant against the same theory written down differently: Newton's equations with the
tail's acceleration, integrals along the tail as sums over 400 slices, and scipy's integrator."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tailbeat.learning.error_bound_solve import plant_beats, plant_config

F64 = NDArray[np.float64]

OMEGA = 2 * math.pi
RHO = 1000.0
STILL_SERVO = {"servo_lag": 0.0, "servo_rate": 0.0, "servo_backlash_rad": 0.0}
PLAIN = {**STILL_SERVO, "delay": 0.0, "wake_share": 0.0, "wake_s": 0.0}
QUIET = {"gain_sigma": 0.0, "flow_sigma_m_s": 0.0, "start_sigma_m_s": 0.0, "camera_noise_m": 0.0}


@dataclass(frozen=True)
class Body:
    """The default fish, by its dimensions."""

    mass: float = 1.3
    kappa: float = 10.0
    hinge: float = 0.10
    tail: float = 0.12
    fin: float = 0.06
    depth: float = 0.08
    thin: float = 0.03
    fin_drag: float = 1.2
    sway_drag: float = 20.0
    yaw_drag: float = 0.05

    @property
    def own(self) -> F64:
        return np.diag([self.mass, 1.7 * self.mass, self.mass * 0.1**2])

    def slices(self) -> tuple[F64, F64, F64, float]:
        """Middles, mass per metre, depth where it is fin, width."""
        width = self.tail / 400
        s = (np.arange(400) + 0.5) * width
        is_fin = s > self.tail - self.fin
        depth = np.where(is_fin, self.depth, self.thin)
        return s, RHO * math.pi / 4 * depth**2, np.where(is_fin, depth, 0.0), width


def acceleration(body: Body, t_s: float, q: F64, amplitude: float) -> F64:
    """Of surge, sway and yaw rate, with the tail on a sine."""
    theta = amplitude * math.sin(OMEGA * t_s)
    rate = amplitude * OMEGA * math.cos(OMEGA * t_s)
    rate2 = -amplitude * OMEGA**2 * math.sin(OMEGA * t_s)
    sine, cosine = math.sin(theta), math.cos(theta)
    s, m, depth, width = body.slices()
    surge, sway, yaw = q
    # normal and tangential speed of the tail at s, in the frame of the body; x = -hinge - s cos
    across = np.stack([np.full_like(s, -sine), np.full_like(s, cosine), -body.hinge * cosine - s])
    w = across.T @ q - s * rate
    # its rate of change at fixed speeds
    turned = np.stack(
        [np.full_like(s, -cosine), np.full_like(s, -sine), np.full_like(s, body.hinge * sine)]
    )
    w_turned = rate * (turned.T @ q) - s * rate2
    # momentum of the tail's water and its change: d/dt of sum m w (n, moment arm)
    momentum = body.own @ q + across @ (m * w) * width
    change = rate * (turned @ (m * w)) * width + across @ (m * w_turned) * width
    mass = body.own + (across * (m * width)) @ across.T
    edge_m = RHO * math.pi / 4 * body.depth**2
    edge = across[:, -1] - np.array([0, 0, 0.5 * width])
    w_edge = edge @ q - body.tail * rate
    u_edge = surge * cosine + (sway - yaw * body.hinge) * sine
    along = np.array([cosine, sine, -body.hinge * sine])
    force = 0.5 * edge_m * w_edge**2 * along - edge_m * w_edge * u_edge * edge
    force -= across @ (0.5 * RHO * body.fin_drag * depth * np.abs(w) * w) * width
    force -= np.array(
        [
            body.kappa * body.mass * abs(surge) * surge,
            body.sway_drag * abs(sway) * sway,
            body.yaw_drag * abs(yaw) * yaw,
        ]
    )
    turning = np.array(
        [yaw * momentum[1], -yaw * momentum[0], sway * momentum[0] - surge * momentum[1]]
    )
    return np.asarray(np.linalg.solve(mass, force + turning - change))


def beats_by_scipy(amplitude: float, beats: int) -> F64:
    """Mean speed of each beat along the first heading, from rest."""
    body = Body()

    def slope(t_s: float, state: F64) -> F64:
        q, heading = state[:3], state[5]
        ahead, aside = math.cos(heading), math.sin(heading)
        return np.concatenate(
            [
                acceleration(body, t_s, q, amplitude),
                [q[0] * ahead - q[1] * aside, q[0] * aside + q[1] * ahead, q[2]],
            ]
        )

    # At rest before the tail begins: its momentum is that of the tail's water at rest.
    s, m, _, width = body.slices()
    across = np.stack([np.zeros_like(s), np.ones_like(s), -body.hinge - s])
    mass = body.own + (across * (m * width)) @ across.T
    begin = np.linalg.solve(mass, across @ (m * s) * width * amplitude * OMEGA)
    found = solve_ivp(
        slope,
        (0, beats),
        np.concatenate([begin, np.zeros(3)]),
        "DOP853",
        np.arange(beats + 1.0),
        rtol=1e-7,
        atol=1e-9,
    )
    return np.asarray(np.hypot(np.diff(found.y[3]), np.diff(found.y[4])))


@pytest.mark.parametrize("amplitude", [0.2, 0.45, 0.7])
def test_the_theory_written_down_differently(amplitude: float) -> None:
    config = plant_config("reactive", PLAIN)
    ours = plant_beats(config, np.full(8, amplitude), 1.0)
    theirs = beats_by_scipy(amplitude, 8)
    print(np.round(ours * 1e3, 3), np.round(theirs * 1e3, 3))
    np.testing.assert_allclose(ours[1:], theirs[1:], rtol=0.01)
