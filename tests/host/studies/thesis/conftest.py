"""The examples have their figures once the registry is imported. Tests draw each in one format; the
command's own test draws all."""

from __future__ import annotations

import pytest

from tailbeat.studies.thesis import picture, registry

__all__ = ["registry"]


@pytest.fixture(autouse=True)
def one_format(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "FORMATS", ("pdf",))
