"""What the board reports, as ROS 2 topics: ros2_node.py [ADDRESS] (default: sim?seed=1).

Each number becomes a std_msgs/Float64 below /tailbeat, for example /tailbeat/live/speed_m_s; texts
go to /tailbeat/text/text. The node only listens; other programs run the trials. Share the link to
the board with MAVProxy, for example: mavproxy.py --master=/dev/rfcomm0,115200 --out=udp:HOST:PORT.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from typing import Any

from tailbeat import Fish

try:
    import rclpy
    from rclpy.node import Node
    from std_msgs.msg import Float64, String
except ImportError as missing:
    sys.exit(f"ros2_node.py needs ROS 2 ({missing}). Source its setup file: /opt/ros/…/setup.sh")


class TailbeatNode(Node):
    """Publishers are made when a value comes for the first time."""

    def __init__(self) -> None:
        super().__init__("tailbeat")
        self.made: dict[str, Any] = {}

    def publish(self, event: dict[str, Any]) -> None:
        """One message per value that is known."""
        kind = event.pop("event")
        for name, value in event.items():
            if isinstance(value, str):
                self.send(f"tailbeat/{kind}/{name}", String(data=value))
            elif isinstance(value, int | float) and math.isfinite(value):
                self.send(f"tailbeat/{kind}/{name}", Float64(data=float(value)))

    def send(self, topic: str, message: Any) -> None:
        """On its own topic."""
        if topic not in self.made:
            self.made[topic] = self.create_publisher(type(message), topic, 10)
        self.made[topic].publish(message)


def main(address: str = "sim?seed=1", events: Iterable[dict[str, Any]] | None = None) -> None:
    """Publish until ROS 2 shuts down."""
    rclpy.init()
    with Fish.connect(address) as fish:
        node = TailbeatNode()
        for event in events or fish.watch():
            if not rclpy.ok():
                break
            node.publish(event)


if __name__ == "__main__":
    main(*sys.argv[1:])
