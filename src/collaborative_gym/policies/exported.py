"""Networks of other libraries, in files of ONNX and TorchScript."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import how_to_install
from collaborative_gym.math import Array

_CPU = ["CPUExecutionProvider"]

_Run = Callable[[np.ndarray], Any]


class ExportedNetwork:
    """A network that gets observations of some robots side by side.

    Its first input is those of all robots that it commands, (num_envs, n) float32, in
    the order of the agents, and its first output their actions, (num_envs, k), in the
    same order. Actions outside of -1 to 1 are clipped.

    Args:
      path: an `.onnx` file, or a TorchScript one, `.pt`.

    Raises:
      ImportError: if the library that runs it is not installed.
      ValueError: if it is not such a file.
    """

    def __init__(self, path: Path):
        self.path = path
        self._run = KINDS[path.suffix](path)

    def commanding(
        self, agents: Sequence[str], env: VectorEnv
    ) -> Callable[[Mapping[str, Array]], dict[str, np.ndarray]]:
        """Return the policy of these agents.

        Raises:
          ValueError: if the network does not take their observations, or gives more or
            fewer actions.
        """
        spaces = env.single_observation_spaces, env.single_action_spaces
        sees, does = (sum(own[agent].shape[0] for agent in agents) for own in spaces)
        ends = np.cumsum([spaces[1][agent].shape[0] for agent in agents])[:-1]

        def act(observations: Mapping[str, Array]) -> dict[str, np.ndarray]:
            rows = [np.asarray(observations[agent], np.float32) for agent in agents]
            actions = np.asarray(self._run(np.concatenate(rows, axis=1)))
            actions = np.clip(actions, -1.0, 1.0)
            return dict(zip(agents, np.split(actions, ends, axis=1), strict=True))

        zeros = np.zeros((env.num_envs, sees), np.float32)
        try:
            given = np.shape(self._run(zeros))
        except Exception as error:  # Each library has errors of its own.
            reason = (str(error).strip() or repr(error)).splitlines()[-1]
            raise ValueError(
                f"{self.path} does not take the {sees} numbers that"
                f" {' and '.join(agents)} observe: {reason}"
            ) from error
        if given != (env.num_envs, does):
            raise ValueError(
                f"{self.path} returns an array of shape {given} for {env.num_envs}"
                f" worlds; the actions of {' and '.join(agents)} have shape"
                f" {(env.num_envs, does)}"
            )
        return act


def _onnx(path: Path) -> _Run:
    try:
        import onnxruntime
    except ImportError as error:
        raise ImportError(
            f"{path} needs ONNX Runtime; {how_to_install('onnx')}"
        ) from error
    options = onnxruntime.SessionOptions()  # type: ignore[attr-defined]
    # Networks of this size gain nothing from more.
    options.intra_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(path, options, providers=_CPU)
    except Exception as error:
        raise ValueError(f"{path} is not an ONNX file, or is damaged") from error
    name = session.get_inputs()[0].name
    return lambda rows: session.run(None, {name: rows})[0]


def _torchscript(path: Path) -> _Run:
    try:
        import torch
    except ImportError as error:
        raise ImportError(f"{path} needs torch; {how_to_install('train')}") from error
    try:
        with warnings.catch_warnings():
            # TorchScript is deprecated; files of it are still around.
            warnings.simplefilter("ignore", DeprecationWarning)
            network = torch.jit.load(path, map_location="cpu").eval()
    except RuntimeError as error:
        raise ValueError(
            f"{path} is not a TorchScript file; for a training run, give the folder, or"
            " the policy.safetensors in it"
        ) from error

    def run(rows: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            actions = network(torch.from_numpy(rows))
        return (actions[0] if isinstance(actions, tuple) else actions).numpy()

    return run


KINDS: Mapping[str, Callable[[Path], _Run]] = {
    ".onnx": _onnx,
    ".pt": _torchscript,
    ".pth": _torchscript,
}
"""What reads a file, by its suffix."""
