"""Policies, which turn observations into actions."""

from collaborative_gym.policies.policy import (
    AnyPolicy,
    Policy,
    as_played,
    as_policy,
    load_policy,
    name_policy,
)

__all__ = [
    "AnyPolicy",
    "Policy",
    "as_played",
    "as_policy",
    "load_policy",
    "name_policy",
]
