"""Draws the diagrams of the documentation as SVG beside this file: ``draw.py [NAME ...]``.

Coordinates are in pixels of a page 720 wide. Boxes name the parts, arrows what flows; the accent
colour marks what learns or protects. The same bytes at every run.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

HERE = Path(__file__).resolve().parent
INK, SOFT, ACCENT, FILL = "#222222", "#777777", "#0b6e99", "#f4f6f8"
FONT = "font-family='Helvetica, Arial, sans-serif'"

Point = tuple[float, float]


def with_indices(words: str) -> str:
    """``u_{j+1}`` with its index below the line; what follows stands on the line again."""
    low = r"<tspan dy='3' font-size='75%'>\g<index></tspan><tspan dy='-3'>\g<after></tspan>"
    pattern = re.compile(r"_(?:\{(?P<long>[^}]*)\}|(?P<short>\w+))(?P<after>[^_]*)")

    def lowered(found: re.Match[str]) -> str:
        index = found["long"] or found["short"]
        return low.replace(r"\g<index>", index).replace(r"\g<after>", found["after"])

    return pattern.sub(lowered, escape(words))


@dataclass(frozen=True)
class Box:
    """A rectangle by its centre and size."""

    x: float
    y: float
    width: float
    height: float

    @property
    def left(self) -> Point:
        return self.x - self.width / 2, self.y

    @property
    def right(self) -> Point:
        return self.x + self.width / 2, self.y

    @property
    def top(self) -> Point:
        return self.x, self.y - self.height / 2

    @property
    def bottom(self) -> Point:
        return self.x, self.y + self.height / 2


@dataclass
class Canvas:
    """An SVG under construction."""

    height: int
    width: int = 720
    parts: list[str] = field(default_factory=list)

    def text(
        self,
        x: float,
        y: float,
        words: str,
        size: int = 13,
        colour: str = INK,
        anchor: str = "middle",
    ) -> None:
        """One line, centred vertically about ``y``."""
        self.parts.append(
            f"<text x='{x:g}' y='{y + size * 0.35:g}' font-size='{size}' fill='{colour}'"
            f" text-anchor='{anchor}' {FONT}>{with_indices(words)}</text>"
        )

    def box(
        self, x: float, y: float, width: float, height: float, *lines: str, accent: bool = False
    ) -> Box:
        """A box with its name and, smaller, what it does."""
        colour = ACCENT if accent else INK
        self.parts.append(
            f"<rect x='{x - width / 2:g}' y='{y - height / 2:g}' width='{width:g}'"
            f" height='{height:g}'"
            f" rx='5' fill='{FILL}' stroke='{colour}' stroke-width='{2 if accent else 1.3}'/>"
        )
        first = y - (len(lines) - 1) * 8
        for number, line in enumerate(lines):
            size, ink = (14, colour) if number == 0 else (12, SOFT)
            self.text(x, first + 16 * number, line, size, ink)
        return Box(x, y, width, height)

    def frame(
        self, x: float, y: float, width: float, height: float, title: str, inset: float = 10
    ) -> None:
        """A dashed frame around boxes, from its upper left corner; ``inset``: of the title."""
        self.parts.append(
            f"<rect x='{x:g}' y='{y:g}' width='{width:g}' height='{height:g}' rx='8' fill='none'"
            f" stroke='{SOFT}' stroke-dasharray='5 4'/>"
        )
        self.text(x + inset, y + 13, title, 13, SOFT, "start")

    def arrow(
        self,
        points: Sequence[Point],
        label: str = "",
        at: Point | None = None,
        accent: bool = False,
        anchor: str = "middle",
    ) -> None:
        """A line with a head at its end; ``at``: where the label stands."""
        colour, head = (ACCENT, "accent") if accent else (INK, "ink")
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        self.parts.append(
            f"<polyline points='{path}' fill='none' stroke='{colour}' stroke-width='1.6'"
            f" marker-end='url(#{head})'/>"
        )
        if label and at is not None:
            self.text(*at, label, 12, colour, anchor)

    def svg(self) -> str:
        """The file."""
        heads = "".join(
            f"<marker id='{name}' viewBox='0 0 10 10' refX='9' refY='5' markerWidth='7'"
            f" markerHeight='7' orient='auto-start-reverse'>"
            f"<path d='M0,0 L10,5 L0,10 z' fill='{colour}'/></marker>"
            for name, colour in (("ink", INK), ("accent", ACCENT))
        )
        return (
            f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {self.width} {self.height}'"
            f" width='{self.width}' height='{self.height}'>\n<defs>{heads}</defs>\n"
            f"<rect width='100%' height='100%' fill='white'/>\n"
            + "\n".join(self.parts)
            + "\n</svg>\n"
        )


def ilc_loop() -> Canvas:
    """The learning loop of one trial and the next."""
    c = Canvas(330)
    c.frame(15, 20, 690, 120, "trial j: executed, once per tail beat k")
    memory = c.box(85, 85, 110, 50, "memory", "input u_j", accent=True)
    limit = c.box(225, 85, 90, 50, "sat", "0 … θ_max")
    plant = c.box(385, 85, 120, 50, "fish", "servo, thrust, drag")
    speed = c.box(600, 85, 140, 50, "speed estimate", "mean of each beat")
    c.arrow([memory.right, limit.left])
    c.arrow([limit.right, plant.left], "amplitude", (297, 71))
    c.arrow([plant.right, speed.left], "motion", (488, 71))
    c.arrow([(385, 32), (385, 58)])
    c.text(392, 36, "disturbances d, w_j", 12, SOFT, "start")
    c.frame(15, 165, 690, 145, "between the trials: learned", inset=260)
    error = c.box(600, 250, 140, 44, "error e_j", "y_d − y_j")
    gain = c.box(410, 250, 140, 44, "γ · e_j(k + ℓ)", "gain, phase lead", accent=True)
    total = c.box(225, 250, 130, 44, "sum", "sat(u_j) + correction", accent=True)
    c.arrow([speed.bottom, error.top], "y_j", (614, 190))
    c.arrow([(690, 290), (690, 250), (671, 250)])
    c.text(690, 299, "y_d", 12)
    c.arrow([error.left, gain.right], accent=True)
    c.arrow([gain.left, total.right], accent=True)
    c.arrow([(225, 110), total.top], "sat(u_j)", (232, 190), anchor="start")
    c.arrow([total.left, (85, 250), memory.bottom], "u_{j+1}", (78, 235), accent=True, anchor="end")
    c.text(300, 292, "end of trial: e(k + ℓ) beyond the last beat is extended", 12, SOFT)
    return c


def system() -> Canvas:
    """The parts and what connects them."""
    c = Canvas(360)
    c.frame(15, 15, 210, 330, "laptop")
    c.frame(308, 15, 240, 330, "fish", inset=195)
    tool = c.box(120, 75, 180, 60, "host tool", "trials, planning, page", accent=True)
    folder = c.box(120, 180, 180, 50, "experiment folder", "logs, events, report")
    other = c.box(120, 290, 180, 50, "simulated board", "or emulator: for the board")
    board = c.box(
        418,
        178,
        150,
        146,
        "board",
        "ATSAM3X8E",
        "gait, P-type ILC",
        "supervisor",
        "storage",
        accent=True,
    )
    servo = c.box(418, 305, 150, 44, "servo and tail", "1 beat per second")
    imu = c.box(418, 55, 150, 40, "VN-100 IMU")
    camera = c.box(640, 75, 120, 50, "camera", "above the tank")
    water = c.box(640, 305, 120, 44, "water", "thrust, drag")
    c.arrow([(211, 72), (262, 72), (262, 150), (342, 150)])
    c.arrow([(342, 160), (254, 160), (254, 82), (211, 82)])
    c.text(277, 180, "MAVLink", 12)
    c.text(277, 196, "USB serial", 11, SOFT)
    c.text(277, 211, "Bluetooth", 11, SOFT)
    c.arrow([tool.bottom, folder.top])
    c.arrow([other.right, (240, 290), (240, 95), (211, 95)])
    c.arrow([imu.bottom, board.top], "100 Hz", (426, 89), anchor="start")
    c.arrow([board.bottom, servo.top], "pulse, 50 Hz", (426, 266), anchor="start")
    c.arrow([servo.right, water.left])
    c.arrow([water.top, camera.bottom], "position", (648, 200), anchor="start")
    c.arrow([(640, 50), (640, 7), (250, 7), (250, 60), (211, 60)], "pictures", (672, 28))
    return c


def data_flow() -> Canvas:
    """From sensors to the next input."""
    c = Canvas(450)
    c.frame(15, 15, 690, 160, "speed of each tail beat")
    camera = c.box(95, 65, 120, 44, "camera", "position in the tank")
    fit = c.box(260, 65, 130, 44, "line fit", "over one beat")
    imu = c.box(95, 135, 120, 44, "IMU frames", "sensor's clock")
    motion = c.box(260, 135, 130, 44, "motion", "in the level frame")
    slots = c.box(430, 100, 120, 50, "speed slots", "0.1 s, logged")
    estimate = c.box(610, 100, 160, 50, "Kalman smoother", "mean speed ± σ")
    c.arrow([camera.right, fit.left])
    c.arrow([imu.right, motion.left])
    c.arrow([fit.right, (348, 65), (348, 92), (370, 92)])
    c.arrow([motion.right, (348, 135), (348, 108), (370, 108)])
    c.arrow([slots.right, estimate.left])
    c.frame(15, 190, 690, 110, "after the trial", inset=250)
    error = c.box(610, 250, 160, 44, "error", "e = y_d − speed")
    law = c.box(390, 250, 170, 44, "learning law", "board, or model on laptop", accent=True)
    store = c.box(140, 250, 180, 44, "next input u", "stored in flash")
    c.arrow([estimate.bottom, error.top])
    c.arrow([error.left, law.right])
    c.arrow([law.left, store.right], accent=True)
    c.frame(15, 315, 690, 120, "during the trial, 50 Hz", inset=200)
    gait = c.box(140, 380, 140, 44, "gait", "tail angle")
    guard = c.box(340, 380, 140, 50, "supervisor", "stop rules", accent=True)
    pulse = c.box(510, 380, 100, 44, "servo pulse")
    log = c.box(640, 380, 100, 44, "trial log", "to the folder")
    c.arrow([store.bottom, gait.top])
    c.arrow([gait.right, guard.left])
    c.arrow([guard.right, pulse.left])
    c.arrow([pulse.right, log.left])
    return c


HOST_LAYERS = (
    ("app", "command line, web page, demo"),
    ("studies", "Monte Carlo, thesis"),
    ("report | session", "figures; trials"),
    ("experiment", "folder, library, export"),
    ("learning", "model, ILC, error bound"),
    ("sensors", "camera, VN-100"),
    ("board", "connect, flash, diagnose"),
    ("sim", "simulated board, emulator"),
    ("link", "MAVLink, FTP, signing"),
    ("core", "records, laws, native library"),
)
FIRMWARE_LAYERS = (
    ("app", "main loop, commands"),
    ("trial, learn", "a trial; what it changes"),
    ("link", "MAVLink"),
    ("store", "littlefs, records, trial log"),
    ("ilc, gait, speed, imu, …", "pure modules"),
    ("hal/include", "HAL interface"),
)


def layers() -> Canvas:
    """Who may use whom."""
    c = Canvas(505)
    c.text(170, 20, "host package (Python)", 14)
    for number, (name, what) in enumerate(HOST_LAYERS):
        c.box(170, 55 + 44 * number, 310, 36, f"{name}", what, accent=name == "core")
    c.text(550, 20, "firmware (C)", 14)
    for number, (name, what) in enumerate(FIRMWARE_LAYERS):
        c.box(550, 60 + 50 * number, 300, 40, name, what, accent=name == "hal/include")
    for x, name, what in (
        (445, "sam3x8e", "the chip"),
        (550, "host", "simulated"),
        (655, "mock", "unit tests"),
    ):
        c.box(x, 385, 95, 46, name, what)
        c.arrow([(x, 362), (x, 332)])
    c.arrow([(340, 80), (340, 430)])
    c.text(170, 490, "each layer uses only the layers below", 12, SOFT)
    c.arrow([(325, 451), (378, 451), (378, 260), (399, 260)], accent=True)
    c.text(390, 452, "core loads the same compiled C", 12, ACCENT, "start")
    return c


def supervisor() -> Canvas:
    """States and transitions of firmware/supervisor/supervisor.c."""
    c = Canvas(330)
    boot = c.box(70, 60, 90, 40, "BOOT")
    idle = c.box(240, 60, 110, 46, "IDLE", "tail off", accent=True)
    armed = c.box(430, 60, 110, 46, "ARMED", "tail off")
    running = c.box(630, 60, 120, 46, "RUNNING", "tail beats", accent=True)
    c.box(70, 170, 110, 46, "LEARNING", "next input")
    settling = c.box(430, 170, 120, 46, "SETTLING", "late speeds")
    c.box(630, 170, 120, 46, "ABORTED", "first reason kept")
    fault = c.box(430, 280, 150, 46, "FAULT", "first reason kept")
    c.arrow([boot.right, idle.left], "booted", (148, 50))
    c.arrow([(295, 52), (375, 52)], "arm", (335, 42))
    c.arrow([(375, 70), (295, 70)], "disarm, stop", (335, 82))
    c.arrow([armed.right, running.left], "start", (527, 50))
    c.arrow([(600, 83), (600, 125), (470, 125), (470, 147)], "executed", (540, 115))
    c.arrow([(650, 83), (650, 147)], "abort", (658, 115), anchor="start")
    c.arrow([settling.left, (265, 170), (265, 83)], "settled", (330, 160))
    c.arrow([(200, 83), (200, 155), (125, 155)], "learn", (193, 120), anchor="end")
    c.arrow([(125, 180), (225, 180), (225, 83)], "learned", (160, 192))
    c.arrow([(630, 193), (630, 225), (245, 225), (245, 83)], "clear", (330, 215))
    c.arrow([fault.left, (235, 280), (235, 83)], "clear", (300, 270))
    c.arrow([(560, 280), (506, 280)])
    c.text(565, 272, "a fault in any state", 12, INK, "start")
    c.text(565, 288, "but BOOT", 12, INK, "start")
    return c


PINS = (
    ("servo", "signal; own supply", "D9", "PC21  PWML4", True),
    ("VN-100 IMU", "TX → D19, RX ← D18", "D19 D18", "PA10 PA11  USART0", False),
    ("Bluetooth HC-05", "TXD → D17, RXD ← D16", "D17 D16", "PA12 PA13  USART1", False),
    ("laptop, USB", "programming port", "D0 D1", "PA8 PA9  UART", False),
    ("battery", "divider, 3.3 V at most", "A0", "PA16  AD7", False),
    ("LED on the fish", "NPN transistor", "D13", "PB27", True),
)


def wiring() -> Canvas:
    """The pins of docs/how-to/wiring.md."""
    c = Canvas(400)
    c.box(575, 195, 230, 350, "", accent=True)
    c.text(575, 38, "Arduino Due / ATSAM3X8E", 14, ACCENT)
    for number, (name, what, header, pin, out) in enumerate(PINS):
        y = 75 + 54 * number
        part = c.box(125, y, 210, 42, name, what)
        ends = [part.right, (460, y)]
        c.arrow(ends[::-1] if out else ends)
        c.text(345, y - 10, header, 13)
        c.text(475, y, pin, 13, INK, "start")
    c.arrow([(460, 137), (230, 137)])
    c.arrow([(460, 191), (230, 191)])
    c.arrow([(460, 245), (230, 245)])
    c.text(360, 388, "All grounds joined. No pin above 3.3 V. 10 kΩ from D9 to ground.", 12, SOFT)
    return c


DIAGRAMS: dict[str, Callable[[], Canvas]] = {
    "ilc-loop": ilc_loop,
    "system": system,
    "data-flow": data_flow,
    "layers": layers,
    "supervisor": supervisor,
    "wiring": wiring,
}

if __name__ == "__main__":
    for name in sys.argv[1:] or DIAGRAMS:
        (HERE / f"{name}.svg").write_text(DIAGRAMS[name]().svg(), encoding="utf-8")
