"""MAPPO, IPPO or MASAC of BenchMARL on any environment; its others are as short.

pip install -e ".[benchmarl]"
python examples/train_benchmarl.py
"""

from typing import Literal

import tyro
from benchmarl.algorithms import IppoConfig, MappoConfig, MasacConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models import MlpConfig

from collaborative_gym.adapters.benchmarl import BenchMARLTask

ALGORITHMS = {"ippo": IppoConfig, "mappo": MappoConfig, "masac": MasacConfig}
FRAMES = 6000
"""Environment steps between two updates; in 30 worlds, whole episodes."""


def main(
    env: str = "PokeTaskSawyers-v0",
    algorithm: Literal["ippo", "mappo", "masac"] = "masac",
    total_steps: int = 300_000,
) -> None:
    """Train, and write BenchMARL's CSV files.

    Args:
      env: an environment id.
      algorithm: which of BenchMARL's.
      total_steps: environment steps to learn from.
    """
    config = ExperimentConfig.get_from_yaml()
    config.max_n_frames, config.loggers = total_steps, ["csv"]
    config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = 30
    config.on_policy_collected_frames_per_batch = FRAMES
    config.off_policy_collected_frames_per_batch = FRAMES
    config.evaluation_interval = FRAMES
    experiment = Experiment(
        task=BenchMARLTask(env),
        algorithm_config=ALGORITHMS[algorithm].get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    )
    experiment.run()
    earned = experiment.mean_return
    print(f"in the last {FRAMES:,} steps a robot's return was {earned:.1f}")


if __name__ == "__main__":
    tyro.cli(main)
