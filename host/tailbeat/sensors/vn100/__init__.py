"""The VN-100: its byte stream decoded by the firmware's own reader, from recordings and live."""

from __future__ import annotations

from tailbeat.sensors.vn100.decode import AsciiLine, Binary, Message, Reader, decode
from tailbeat.sensors.vn100.summary import StreamSummary

__all__ = ["AsciiLine", "Binary", "Message", "Reader", "StreamSummary", "decode"]
