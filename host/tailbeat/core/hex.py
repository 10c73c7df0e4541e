"""Bytes that a document holds as hexadecimal digits."""

from __future__ import annotations


class Hex(bytes):
    """As core.decode reads them."""
