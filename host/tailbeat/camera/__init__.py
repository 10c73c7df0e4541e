"""Cameras: where the fish is, and from that how fast it swims."""

from tailbeat.camera.base import Camera, Frame

__all__ = ["Camera", "Frame"]
