"""MASAC of BenchMARL on any environment; its other algorithms take the same lines.

pip install 'collaborative-gym[benchmarl]'
python examples/train_benchmarl.py
"""

import tyro
from benchmarl.algorithms import MasacConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models import MlpConfig

from collaborative_gym.adapters.benchmarl import BenchMARLTask


def main(env: str = "PokeTaskSawyers-v0", total_steps: int = 300_000) -> None:
    """Train, and write BenchMARL's CSV files.

    Args:
      env: an environment id.
      total_steps: environment steps to learn from.
    """
    config = ExperimentConfig.get_from_yaml()
    config.max_n_frames, config.loggers = total_steps, ["csv"]
    config.off_policy_n_envs_per_worker = 60
    config.evaluation_interval = config.off_policy_collected_frames_per_batch
    Experiment(
        task=BenchMARLTask(env),
        algorithm_config=MasacConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    ).run()


if __name__ == "__main__":
    tyro.cli(main)
