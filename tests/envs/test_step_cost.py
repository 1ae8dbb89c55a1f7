"""Files, depth and calls of a control step stay within budgets."""

import sys
from pathlib import Path

import pytest

import collaborative_gym as cg

OURS = str(Path(cg.__file__).parent)


def profile(env):
    """Return the files, the depth and the number of our calls in a control step."""
    actions, files, calls, depths = env.expert(), set(), [0], []
    depth = 0

    def look(frame, event, _):
        nonlocal depth
        if not frame.f_code.co_filename.startswith(OURS):
            return
        if event == "call":
            # Comprehensions and generators belong to their functions.
            is_own = not frame.f_code.co_name.startswith("<")
            depth += is_own
            calls[0] += is_own
            depths.append(depth)
            files.add(Path(frame.f_code.co_filename).name)
        elif event == "return":
            depth -= not frame.f_code.co_name.startswith("<")

    sys.setprofile(look)
    try:
        env.step(actions)
    finally:
        sys.setprofile(None)
    return files, max(depths), calls[0]


@pytest.mark.parametrize("env_id", ["PokeTaskSawyers-v0", "LiftTaskSawyers-v0"])
def test_a_control_step_runs_few_files_at_little_depth(env_id):
    found = {}
    for num_envs in (2, 16):
        env = cg.make_vec(env_id, num_envs, num_threads=1)
        env.reset(seed=0)
        for _ in range(3):
            env.step(env.expert())
        found[num_envs] = profile(env)
    files, depth, calls = found[16]
    assert calls == found[2][2]
    assert len(files) <= 18 and depth <= 6 and calls <= 106, (files, depth, calls)
