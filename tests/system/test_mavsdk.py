"""MAVSDK reads the descriptions of the parameters, where it is installed (pip install mavsdk)."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from tailbeat.link.params import known_parameters

WITHIN_S = 60.0


def described(address: str) -> dict[str, Any]:
    """The parameter metadata as MAVSDK's component_metadata gives it."""
    mavsdk = pytest.importorskip("mavsdk", minversion="4.1")
    plugin = pytest.importorskip("mavsdk.plugins.component_metadata.component_metadata")
    station = mavsdk.ComponentType.GROUND_STATION
    sdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(station))
    sdk.add_any_connection(address.replace("tcp:", "tcpout://"))
    metadata = plugin.ComponentMetadata(sdk.first_autopilot(WITHIN_S))
    metadata.request_autopilot_component()
    deadline_s = time.monotonic() + WITHIN_S
    while True:
        try:
            document = metadata.get_metadata(1, plugin.MetadataType.PARAMETER).json_metadata
            return {row["name"]: row for row in json.loads(document)["parameters"]}
        except plugin.ComponentMetadataError:
            assert time.monotonic() < deadline_s
            time.sleep(0.05)


def test_every_parameter_has_a_description(
    simulator: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, str(tmp_path))  # MAVSDK caches the files by their CRC
    pytest.importorskip("mavsdk")
    with simulator(1) as (address, _):
        rows = described(address)
    assert list(rows) == list(known_parameters())
    assert all(row["shortDesc"] for row in rows.values())
