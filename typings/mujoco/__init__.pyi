"""The wheel's names come from compiled modules without type information; without this file none of them would exist."""

from typing import Any

def __getattr__(name: str) -> Any: ...
