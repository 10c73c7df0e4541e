# The module itself is generated from wire/tailbeat.xml when the package is built.
from typing import Any

def __getattr__(name: str) -> Any: ...
