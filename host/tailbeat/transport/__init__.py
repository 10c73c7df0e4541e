"""Ways to reach a board: byte streams with a clock."""

from tailbeat.transport.base import Transport

__all__ = ["Transport"]
