"""Robot arms that cooperate or compete, as learning environments on MuJoCo."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from collaborative_gym.pictures import choose_backend

choose_backend()  # MuJoCo decides how to draw when it is imported.

from collaborative_gym.control import Motion  # noqa: E402
from collaborative_gym.plugins import load_entry_points, load_module  # noqa: E402
from collaborative_gym.robots import (  # noqa: E402
    Gripper,
    Robot,
    get_robot,
    list_robots,
    register_robot,
)
from collaborative_gym.scene import Placement, Scene  # noqa: E402
from collaborative_gym.tasks.registry import (  # noqa: E402
    EnvSpec,
    list_envs,
    list_tasks,
    register_env,
    register_task,
)
from collaborative_gym.tasks.registry import make_task as task  # noqa: E402
from collaborative_gym.tasks.task import (  # noqa: E402
    LEVEL,
    Randomization,
    Task,
    TaskConfig,
)

if TYPE_CHECKING:
    from collaborative_gym.cards import ReportCard, report_card
    from collaborative_gym.certificate.budget import Budget
    from collaborative_gym.certificate.certify import certify
    from collaborative_gym.comparisons.result import Comparison, compare
    from collaborative_gym.envs.make import make, make_vec
    from collaborative_gym.envs.vector_env import VectorEnv
    from collaborative_gym.evaluation import Report, evaluate
    from collaborative_gym.learning.config import Hyperparameters
    from collaborative_gym.learning.many import Outcome, train_all
    from collaborative_gym.learning.train import train
    from collaborative_gym.policies import load_policy
    from collaborative_gym.tournaments.play import tournament
    from collaborative_gym.tournaments.result import Tournament

__all__ = [
    "LEVEL",
    "Budget",
    "Comparison",
    "EnvSpec",
    "Gripper",
    "Hyperparameters",
    "Motion",
    "Outcome",
    "Placement",
    "Randomization",
    "Report",
    "ReportCard",
    "Robot",
    "Scene",
    "Task",
    "TaskConfig",
    "Tournament",
    "VectorEnv",
    "certify",
    "compare",
    "evaluate",
    "get_robot",
    "list_envs",
    "list_robots",
    "list_tasks",
    "load_module",
    "load_policy",
    "make",
    "make_vec",
    "register_env",
    "register_robot",
    "register_task",
    "report_card",
    "task",
    "tournament",
    "train",
    "train_all",
]

# Imported on first use, so that `import collaborative_gym` stays quick.
_LATER = {
    "Budget": "collaborative_gym.certificate.budget",
    "Comparison": "collaborative_gym.comparisons.result",
    "Hyperparameters": "collaborative_gym.learning.config",
    "Outcome": "collaborative_gym.learning.many",
    "Report": "collaborative_gym.evaluation",
    "ReportCard": "collaborative_gym.cards",
    "Tournament": "collaborative_gym.tournaments.result",
    "VectorEnv": "collaborative_gym.envs.vector_env",
    "certify": "collaborative_gym.certificate.certify",
    "compare": "collaborative_gym.comparisons.result",
    "evaluate": "collaborative_gym.evaluation",
    "load_policy": "collaborative_gym.policies",
    "make": "collaborative_gym.envs.make",
    "make_vec": "collaborative_gym.envs.make",
    "report_card": "collaborative_gym.cards",
    "tournament": "collaborative_gym.tournaments.play",
    "train": "collaborative_gym.learning.train",
    "train_all": "collaborative_gym.learning.many",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_LATER[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)


load_entry_points()  # At last, when what their modules import is here.
