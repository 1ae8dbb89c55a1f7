"""The trained policies that are shipped with the package, by kind and environment."""

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]

SHIPPED = {"baseline": _PACKAGE / "baselines", "ego": _PACKAGE / "egos"}
"""Folders of each kind's policies: a baseline does its task with itself, and an ego
with partners of many kinds."""


def shipped_file(kind: str, env_id: str) -> Path:
    """Return where an environment's policy of a kind is, if it is shipped."""
    return SHIPPED[kind] / f"{env_id}.safetensors"


def is_shipped(kind: str, env_id: str) -> bool:
    """Return whether a policy of a kind is shipped for an environment."""
    return shipped_file(kind, env_id).exists()


def shipped_kinds(env_id: str) -> list[str]:
    """Return the kinds of policies that are shipped for an environment."""
    return [kind for kind in SHIPPED if is_shipped(kind, env_id)]
