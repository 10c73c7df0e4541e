"""How long a picture of the simulated tank takes, on one core."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, replace

import cv2

from tailbeat.sensors.camera.render.painter import DrawnPose, Painter
from tailbeat.sensors.camera.render.scene import Scene


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    pictures: int


FULL, TINY = Load(pictures=100), Load(pictures=2)
PLAIN = Scene()
SCENES = {
    "1280x720": PLAIN,
    "1280x720, glare, half hidden": replace(PLAIN, glare=0.5, hidden=0.3),
    "1280x720, two fish": replace(PLAIN, fish=2),
    "960x540": replace(PLAIN, size_px=(960, 540)),
}


def times_ms(scene: Scene, pictures: int) -> list[float]:
    """Of pictures of a fish that swims."""
    painter = Painter(scene)
    taken = []
    for index in range(pictures):
        t_s = index / 25
        truth = DrawnPose(t_s, 0.08 * t_s, 0.01, 0.1, 0.4, 1.0, 0.08, 0.5)
        begin_s = time.process_time()
        painter.paint(truth, index)
        taken.append(1000 * (time.process_time() - begin_s))
    return taken


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    cv2.setNumThreads(1)
    print("drawing the simulated tank, ms of processor time per picture:")
    for name, scene in SCENES.items():
        taken = times_ms(scene, load.pictures)
        print(f"  {name:30} median {statistics.median(taken):5.1f}, least {min(taken):5.1f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
