"""Evaluation of policies over many episodes."""

from collaborative_gym.evaluation.play import evaluate
from collaborative_gym.evaluation.report import Report, Score, Statistic
from collaborative_gym.evaluation.table11 import Table11, reproduce_table11

__all__ = ["Report", "Score", "Statistic", "Table11", "evaluate", "reproduce_table11"]
