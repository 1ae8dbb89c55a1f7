"""How well a policy does, over many episodes."""

from collaborative_gym.evaluation.play import evaluate
from collaborative_gym.evaluation.report import Report, Statistic

__all__ = ["Report", "Statistic", "evaluate"]
