"""What turns observations into actions."""

from collaborative_gym.policies.policy import Policy, as_policy, load_policy

__all__ = ["Policy", "as_policy", "load_policy"]
