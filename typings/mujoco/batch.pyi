"""MuJoCo ships no types for its compiled modules; everything in them is Any."""

from typing import Any

def __getattr__(name: str) -> Any: ...
