"""Networks of other libraries, in files of ONNX."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

import numpy as np

from collaborative_gym.blocks import split_columns
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import how_to_install
from collaborative_gym.files import check_regular
from collaborative_gym.math import Array

SUFFIX = ".onnx"
"""Suffix of the files."""

MOST_SECONDS = 10.0
"""Time limit for loading a file, and for its network's actions of one control step.
Networks of robots need milliseconds; a loop in a file may never end."""

_CPU = ["CPUExecutionProvider"]

_QUIET = 4
"""Level of logging at which the runtime writes nothing; its errors are raised."""

_DTYPES = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(float16)": np.float16,
}
"""Types of an input that takes observations, by ONNX Runtime's names."""

_T = TypeVar("_T")


class OnnxNetwork:
    """A network from the observations of some robots, side by side, to their actions.

    Its first input has the observations in the order of the agents, (num_envs, n) of
    floats, and its first output the actions in the same order, (num_envs, k). Actions
    outside of -1 to 1 are clipped.

    Raises:
      ImportError: if ONNX Runtime is not installed.
      TimeoutError: if loading takes more than `MOST_SECONDS`.
      ValueError: if it is not such a file.
    """

    def __init__(self, path: Path):
        try:
            import onnxruntime
        except ImportError as error:
            raise ImportError(
                f"{path} needs ONNX Runtime; {how_to_install('onnx')}"
            ) from error
        check_regular(path)
        self.path = path
        runtime: Any = onnxruntime
        self._options = runtime.RunOptions
        options = runtime.SessionOptions()
        # Networks of this size gain nothing from more.
        options.intra_op_num_threads = 1
        options.log_severity_level = _QUIET
        try:
            self._session = self._in_time(
                lambda: runtime.InferenceSession(path, options, providers=_CPU)
            )
        except TimeoutError:
            raise
        except Exception as error:
            raise ValueError(
                f"{path} is not an ONNX file, or is damaged: {_last_line(error)}"
            ) from error

    def commanding(
        self, agents: Sequence[str], env: VectorEnv
    ) -> Callable[[Mapping[str, Array]], dict[str, np.ndarray]]:
        """Return the policy of these agents.

        Raises:
          TimeoutError: if it takes more than `MOST_SECONDS`, here or when it is called.
          ValueError: if the network does not take their observations, or gives others.
        """
        layout = env.world.definition.layout
        sizes = {agent: layout.action_sizes[agent] for agent in agents}
        sees = sum(layout.observation_sizes[agent] for agent in agents)
        shape, who = (env.num_envs, sum(sizes.values())), " and ".join(agents)
        dtype = self._check_input(env.num_envs, sees, who)

        def act(observations: Mapping[str, Array]) -> dict[str, np.ndarray]:
            rows = [np.asarray(observations[agent], dtype) for agent in agents]
            actions = self._run(np.concatenate(rows, axis=1))
            return split_columns(np.clip(actions, -1.0, 1.0), sizes)

        try:
            given = self._run(np.zeros((env.num_envs, sees), dtype)).shape
        except TimeoutError:
            raise
        except Exception as error:  # The runtime has many errors of its own.
            raise ValueError(
                f"{self.path} does not take the {sees} numbers that {who} observe:"
                f" {_last_line(error)}"
            ) from error
        if given != shape:
            raise ValueError(
                f"{self.path} returns an array of shape {given} for {env.num_envs}"
                f" worlds; the actions of {who} have shape {shape}"
            )
        return act

    def _check_input(self, num_envs: int, sees: int, who: str) -> Any:
        """Return the dtype of the first input; raise ValueError if it does not fit."""
        first = self._session.get_inputs()[0]
        if first.type not in _DTYPES:
            raise ValueError(
                f"{self.path} takes a {first.type}, and observations are floats; export"
                " it with an input of float32"
            )
        # A free dimension has a name, or none.
        sizes = [size if isinstance(size, int) else None for size in first.shape]
        if len(sizes) == 2 and sizes[1] not in (None, sees):
            raise ValueError(
                f"{self.path} takes {sizes[1]} numbers; {who} observe {sees}"
            )
        if sizes and sizes[0] not in (None, num_envs):
            raise ValueError(
                f"{self.path} was exported for {sizes[0]} rows at once, and here are"
                f" {num_envs} worlds; export it with a free first dimension, or play"
                f" it with num_envs={sizes[0]} (--num-envs {sizes[0]})"
            )
        return _DTYPES[first.type]

    def _run(self, rows: np.ndarray) -> np.ndarray:
        options = self._options()
        options.log_severity_level = _QUIET
        given = {self._session.get_inputs()[0].name: rows}

        return self._in_time(
            lambda: np.asarray(self._session.run(None, given, options)[0]),
            lambda: setattr(options, "terminate", True),
        )

    def _in_time(
        self, work: Callable[[], _T], end: Callable[[], object] = lambda: None
    ) -> _T:
        """Return the result of `work`, which may never end.

        It runs in a thread of its own, so that Ctrl-C is heard meanwhile. After
        `MOST_SECONDS`, `end` is called, and a thread that goes on is left behind.

        Raises:
          TimeoutError: if it takes that long.
        """
        answer: Future[_T] = Future()

        def run() -> None:
            try:
                answer.set_result(work())
            except Exception as error:
                answer.set_exception(error)

        Thread(target=run, daemon=True).start()
        try:
            return answer.result(MOST_SECONDS)
        except TimeoutError:
            raise TimeoutError(
                f"{self.path} gave no answer within {MOST_SECONDS:g} s, where networks"
                " of robots take milliseconds; it may have a loop that never ends"
            ) from None
        finally:
            if not answer.done():
                end()


def _last_line(error: Exception) -> str:
    return (str(error).strip() or repr(error)).splitlines()[-1]
