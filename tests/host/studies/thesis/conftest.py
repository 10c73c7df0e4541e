"""The examples have their figures once the registry is imported."""

from __future__ import annotations

from tailbeat.studies.thesis import registry

__all__ = ["registry"]
