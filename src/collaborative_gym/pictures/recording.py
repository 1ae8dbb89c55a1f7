"""Videos and pictures of policies at work."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from itertools import count, repeat
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from collaborative_gym.envs.arguments import check_episodes
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import (
    check_callback,
    check_count,
    check_flag,
    check_kind,
    check_number,
    shown,
)
from collaborative_gym.evaluation.play import OnProgress
from collaborative_gym.files import replacing
from collaborative_gym.pictures.rendering import Camera
from collaborative_gym.pictures.video import FORMATS, Frames, import_extra, save
from collaborative_gym.policies import AnyPolicy, Policy, as_played, as_policy
from collaborative_gym.policies.match import name_players, standing
from collaborative_gym.scene.surroundings import LARGEST
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Task
from collaborative_gym.timing import CONTROL_DT, SUBSTEPS

_SAME_SPREAD = 0.01  # m, difference of the robots' nearness that a picture hides
_HOLD = 1.5  # s, for which a film shows the end of an episode
_FADE = 0.4  # s, in which that gives way to the next start
_LONGEST = 36_000.0  # s, greatest length of a film
_SLOWEST, _FASTEST = 0.1, 2.0  # bounds of a film's speed, in simulated s per second

_LONG = 2.5
"""Width over height of a picture below which, not beside which, a close-up stands."""

_SHOTS = [n for n in range(1, SUBSTEPS + 1) if SUBSTEPS % n == 0]
"""How many pictures of a control step a film may have."""

_SLOWER, _AROUND = 2.5, (-5, 2)
"""How many times as many it has in slow motion at least, if it may, and from which step
to before which one, counted from a decisive one."""

_GREY, _GREEN = "#b0b8c0", "#5ee07f"  # of what captions add, and of what is reached
_ZOOMS = 20  # pictures over which a close-up goes nearer in slow motion
_VISIBLE = 3e-4  # rad or m, least motion that shows: a tenth of a pixel and less


def record(
    env: str | Task,
    output: str | Path,
    *,
    policy: AnyPolicy | Sequence[AnyPolicy] = "expert",
    any_env: bool = False,
    seconds: float | None = None,
    seed: int = 0,
    only_episodes: Sequence[int] | None = None,
    size: tuple[int, int] | None = None,
    speed: float = 1.0,
    slow_motion: bool = False,
    close_up: str | Sequence[str] = (),
    on_progress: OnProgress = None,
) -> Path:
    """Write a video of a seed's episodes and return its path.

    The episodes are those that `evaluate` plays. 1.5 seconds after a success, or after
    the end of the episode, the film fades into the next start. After an error or Ctrl-C
    there is no half-written file.

    Args:
      env: an environment id, a task's name, or a task.
      output: the file: `.mp4` (H.264, 20 frames/s at speed 1) or `.gif` (10 frames/s).
      policy: as `evaluate` takes it. Several are shown side by side, in the same
        episodes; the first one decides when the next start comes. A caption gives the
        goal, the environment's id, the time, who plays, the team's progress, and
        whether the goal is met or what the score is.
      any_env: whether a trained policy may play another environment than its own.
      seconds: least length of the film of the first episodes, up to 36,000; None for
        10. An episode that has begun by then is shown to its end.
      seed: the episodes' seed.
      only_episodes: indices of the seed's episodes to show instead of the first ones,
        such as the worst ones that a report names.
      size: width and height in pixels, of each policy's picture and what stands above
        it; None for 1280 x 720, of a GIF 416 x 234.
      speed: simulated seconds per second of the film, 0.1 to 2: 1 for real time, less
        for slow motion, which draws more pictures of each second of the world.
      slow_motion: whether 0.7 s about the first policy's large steps of progress are
        shown at 0.4 of the speed or less, with the close-up nearer. Progress is the
        first measure in the task's `coordination` that is kept at its greatest, or else
        where success begins; of opponents it is every score.
      close_up: a body of the world, such as `pot/pot`, that a picture on the right, or
        below a long one, shows from nearby; of several, the one that hands are nearest
        to, until they leave it.
      on_progress: called after each step with the share that is done, 0 to 1.

    Raises:
      ImportError: if the extra `video` is not installed.
      KeyError: if a name is unknown.
      OSError: if the file cannot be written; says why, before the work.
      RuntimeError: if no off-screen renderer can start; says what to install.
      TypeError: if the policy or a number is of another kind.
      ValueError: if a number is out of range, if seconds and episodes are both given,
        or if the file has another suffix.
    """
    if only_episodes is not None:
        if seconds is not None:
            raise ValueError("give seconds or only_episodes, not both")
        check_kind("only_episodes", only_episodes, Sequence, "indices of episodes")
        only_episodes = check_episodes(only_episodes, len(only_episodes)).tolist()
        if not only_episodes:
            raise ValueError("only_episodes must name at least one")
    seconds = 10.0 if seconds is None else seconds
    seconds = check_number("seconds", seconds, above=0.0, at_most=_LONGEST)
    check_kind("output", output, (str, Path), "a path")
    output = Path(output)
    if "\0" in str(output):
        raise ValueError(f"output must be a path, got {str(output)!r}")
    suffix = output.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(
            f"cannot record to {output.name!r}; end its name with .gif or .mp4"
        )
    write, shots, usual = FORMATS[suffix]
    speed = check_number("speed", speed, at_least=_SLOWEST, at_most=_FASTEST)
    # So many pictures a second as in real time, or a few more.
    shots = _at_least(shots / speed)
    width, height = _sides(usual if size is None else size)
    if width % 2 or height % 2:
        raise ValueError(f"width and height must be even, got {width} x {height}")
    slow_motion = check_flag("slow_motion", slow_motion)
    check_callback("on_progress", on_progress)
    policies: Sequence[Any] = policy if isinstance(policy, list | tuple) else [policy]
    if not policies:
        raise ValueError("name at least one policy")
    task, bodies = as_task(env), [close_up] if isinstance(close_up, str) else close_up
    is_long = width > _LONG * height
    beside = 0 if is_long or not bodies else height
    tall = height - _caption(width + beside)[1]
    views: list[tuple[Any, ...]] = [(width, tall)]
    views += [(width if is_long else height, tall, bodies)] * bool(bodies)
    with ExitStack() as stack:
        cast = []
        for each in policies:
            own = as_played(task, each)
            world = VectorEnv(own, 1, seed=seed, num_threads=1, auto_reset=False)
            stack.callback(world.close)
            act = as_policy(each, world, any_env=any_env)
            players = name_players(each, world.sides, own.colours)
            model = world.world.drawn_model
            eyes = [stack.enter_context(closing(Camera(model, *v))) for v in views]
            screen = _Screen(world, act, players, shots, eyes, is_long, speed)
            cast.append(screen)
        frames = _film(cast, seconds, seed, only_episodes, slow_motion, on_progress)
        write(output, frames, cast[0].rate)
    return output


def check_ready() -> None:
    """Raise ImportError or RuntimeError if no videos and pictures can be made here."""
    for module in ("imageio_ffmpeg", "PIL"):
        import_extra(module)
    Camera(mujoco.MjSpec().compile(), 64, 64).close()


def picture(
    env: str | Task,
    policy: AnyPolicy = "expert",
    *,
    seed: int = 0,
    size: tuple[int, int] = (640, 360),
) -> np.ndarray:
    """Return a picture of the robots together, in a seed's first episode.

    It shows the moment, up to the first success, at which their tool centre points are
    nearest to one another. The arguments are those of `evaluate`.

    Returns:
      (height, width, 3) uint8, of `size` (width, height) in pixels.

    Raises:
      KeyError: if a name is unknown.
      RuntimeError: if no off-screen renderer can start; says what to install.
    """
    width, height = _sides(size)
    task = as_played(as_task(env), policy)
    with closing(VectorEnv(task, 1, seed=seed, num_threads=1)) as world:
        act = as_policy(policy, world)
        observations, infos = world.reset()
        best, least = world.get_state(), _spread(world)
        while not infos["success"][0]:
            observations, _, _, _, infos = world.step(act(observations))
            if infos["ended"][0]:
                break
            spread = _spread(world)
            if spread < least + _SAME_SPREAD:
                best, least = world.get_state(), min(spread, least)
        world.set_state(best)
        return world.render(width=width, height=height)


def contact_sheet(
    pictures: Sequence[np.ndarray],
    labels: Sequence[str],
    output: str | Path,
    columns: int = 4,
) -> Path:
    """Write labelled pictures of one size side by side into a PNG, and return its path.

    Pictures are (height, width, 3) uint8 each, `columns` of them in a row.

    Raises:
      ImportError: if the extra `video` is not installed.
    """
    image = import_extra("PIL.Image")
    height, width = pictures[0].shape[:2]
    font = import_extra("PIL.ImageFont").load_default(size=height / 18)
    band, gap = height // 11, width // 80
    right, down = width + gap, height + band + gap
    rows = -(-len(pictures) // columns)
    sheet = image.new("RGB", (columns * right + gap, rows * down + gap), "white")
    pen = import_extra("PIL.ImageDraw").Draw(sheet)
    for i, (pixels, label) in enumerate(zip(pictures, labels, strict=True)):
        x, y = gap + i % columns * right, gap + i // columns * down
        pen.text((x + width // 2, y + band // 2), label, "black", font, anchor="mm")
        sheet.paste(image.fromarray(pixels), (x, y + band))
    output = Path(output)
    with replacing(output) as partial:
        save(sheet, partial, output, format="PNG")
    return output


def _sides(size: Any) -> tuple[int, int]:
    if not isinstance(size, Sequence) or isinstance(size, str) or len(size) != 2:
        raise TypeError(f"size must be a width and a height, got {shown(size)}")
    width, height = size
    return (
        check_count("size's width", width, 32, LARGEST[0]),
        check_count("size's height", height, 32, LARGEST[1]),
    )


def _spread(env: VectorEnv) -> float:
    points = np.stack([env.sim.pose(f"{agent}/tcp")[0][0] for agent in env.agents])
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())


class _Step(NamedTuple):
    """A control step that was played."""

    infos: dict[str, Any]
    states: list[tuple[np.ndarray, np.ndarray]]  # qpos and mocap_pos, evenly spread
    met_for: int = 0  # control steps for which the goal has been met


def _is_success(step: _Step) -> bool:
    success = step.infos["success"]
    sides = success.values() if isinstance(success, Mapping) else [success]
    return any(bool(met[0]) for met in sides)


class _Screen:
    """A policy that plays one world, and its cameras.

    They draw only when something has moved far enough to be seen: experts hold still at
    the goal, and without a graphics card drawing takes most of the time.
    """

    def __init__(
        self,
        env: VectorEnv,
        policy: Policy,
        players: Mapping[str, str],
        shots: int,
        cameras: Sequence[Camera],
        is_long: bool,
        speed: float,
    ):
        self.speed, self.rate = speed, shots * speed / CONTROL_DT
        self._env, self._policy, self._players = env, policy, players
        self._cameras, self._is_long = cameras, is_long
        self._shots, self._slow = shots, _at_least(_SLOWER * shots)
        self._frame, self._drawn = np.zeros(0), np.array(np.inf)
        self._states: list[tuple[np.ndarray, np.ndarray]] = []
        self._score: dict[str, float] = {}
        self._scored = np.inf, ""
        self._stage, self._zoom = env.task.progress_name, 0.0
        env.watch(self._keep, SUBSTEPS)

    def is_done(self, step: _Step) -> bool:
        """Return whether the goal was met, or the episode has ended."""
        if step.infos["ended"][0] or len(self._players) > 1:
            return bool(step.infos["ended"][0])
        return not np.isnan(step.infos["metrics"]["time_to_success"][0])

    def play(self, seed: int, episode: int) -> Iterator[_Step]:
        """Yield the steps of an episode for ever; after its end all stands still."""
        observations, infos = self._env.reset(seed, [episode])
        self._score.clear()
        self._keep()
        yield _Step(infos, self._states[-1:])
        while not infos["ended"][0]:
            self._states = []
            actions = self._policy(observations)
            observations, *_, infos = self._env.step(actions)
            counts = self._env.get_state().progress
            met_for = int(counts.get("side_1: met_steps", np.zeros(1))[0])
            yield _Step(infos, self._states, met_for)
        yield from repeat(_Step(infos, self._states[-1:] * SUBSTEPS))

    def draw(self, step: _Step, start: int, is_slow: bool) -> Iterator[np.ndarray]:
        """Yield pictures of a step after a film's start, more in slow motion."""
        shots = self._slow if is_slow else self._shots
        every, pace = -(-len(step.states) // shots), self.speed * self._shots / shots
        said = f", speed {pace:g}x" if pace != 1 else ""
        seconds, task = step.infos["step"][0] * CONTROL_DT, self._env.task
        who, _, mark = standing(self._players, step.infos).partition("\n")
        score = step.infos["metrics"].get("score", {})
        mark = mark or self._cheer(seconds, score)
        is_way = mark in ("", "draw")
        if not mark:
            mark = " : ".join(f"{points[0]:g}" for points in score.values())
        if not mark and task.units.get(self._stage or "") == "":
            mark = f"{100 * self._progress(step):.0f} % done"
        if not mark and task.success_for > 1 and step.met_for:
            held, asked = (n * CONTROL_DT for n in (step.met_for, task.success_for))
            mark = f"held {held:.1f} of {asked:.1f} s"
        again = f"start {start + 1}, " * (start > 0)
        grasp = f" (grasp: {task.config.grasp})" * task.gripping
        about = f"{task.name}{grasp}, {again}{seconds:.1f} s{said}, {who}"
        for state in step.states[every - 1 :: every]:
            self._zoom += (is_slow - self._zoom) / _ZOOMS
            yield _labelled(self._draw(*state), task.summary, about, mark, is_way)

    def _cheer(self, seconds: float, score: Mapping[str, np.ndarray]) -> str:
        """Return who has scored just now, or nothing."""
        for side, points in score.items():
            if points[0] > self._score.get(side, np.inf):
                self._scored = seconds, f"{self._players[side]} scores"
            self._score[side] = points[0]
        since, who = self._scored
        return who if 0 <= seconds - since < _HOLD * min(1, self.speed) else ""

    def decisive(self, steps: Sequence[_Step]) -> set[int]:
        """Return the steps around large progress, first success, or scores."""
        late = 0
        if "score" in steps[0].infos["metrics"]:
            scores = [each.infos["metrics"]["score"].values() for each in steps]
            rows = [np.sum(list(points)) for points in scores]
        elif self._stage is not None:
            rows = [self._progress(each) for each in steps]
        else:
            late = self._env.task.success_for - 1  # Success began so long before.
            rows = np.maximum.accumulate([_is_success(each) for each in steps])
        rises = np.diff(rows, prepend=0)
        large = np.flatnonzero((rises > 0) & (rises > rises.max() / 2)) - late
        # Of progress that creeps, the last large piece.
        ends = large[np.diff(large, append=np.inf) > -_AROUND[0]]
        return {int(i) + j for i in ends for j in range(*_AROUND)}

    def _progress(self, step: _Step) -> float:
        return float(step.infos["metrics"]["coordination"][self._stage][0])

    def _keep(self) -> None:
        sim = self._env.sim
        self._states.append((sim.qpos[0].copy(), sim.mocap_pos[0].copy()))

    def _draw(self, qpos: np.ndarray, mocap_pos: np.ndarray) -> np.ndarray:
        places = np.concatenate([qpos, mocap_pos.ravel(), [self._zoom]])
        if np.abs(places - self._drawn).max() > _VISIBLE:
            views = [eye.picture(qpos, mocap_pos, self._zoom) for eye in self._cameras]
            for near in views[1:]:
                near[np.s_[:2] if self._is_long else np.s_[:, :2]] = 255
            self._frame = np.concatenate(views, axis=0 if self._is_long else 1)
            self._drawn = places
        return self._frame


def _film(
    cast: Sequence[_Screen],
    seconds: float,
    seed: int,
    episodes: Sequence[int] | None,
    slow_motion: bool,
    on_progress: OnProgress,
) -> Frames:
    """Yield the players' pictures side by side, one start after the other.

    The film shows all `episodes`, or the first ones for at least so many seconds.
    """
    shown, first, last = 0.0, cast[0], np.zeros(0)
    for i, episode in enumerate(count() if episodes is None else episodes):
        if episodes is None and shown >= seconds:
            break
        rows: list[tuple[_Step, ...]] = []
        left = max(1, round(_HOLD * first.speed / CONTROL_DT))
        for row in zip(*(player.play(seed, episode) for player in cast), strict=True):
            rows.append(row)
            left -= first.is_done(row[0])
            if left < 0:
                break
        slow = first.decisive([own for own, *_ in rows]) if slow_motion else ()
        before, begun = last, shown if i > 0 else -np.inf
        for j, row in enumerate(rows):
            drawn = zip(cast, row, strict=True)
            for views in zip(*(s.draw(x, i, j in slow) for s, x in drawn), strict=True):
                last, left = np.concatenate(views, axis=1), 1 - (shown - begun) / _FADE
                now = last
                if left > 0:  # Captions do not fade: two at once cannot be read.
                    now, part = last.copy(), np.s_[_caption(views[0].shape[1])[1] :]
                    now[part] = np.rint(left * before[part] + (1 - left) * last[part])
                yield now
                shown += 1 / first.rate
            if on_progress is not None:
                # The last start is shown to its end, whenever that comes.
                done = shown / seconds if episodes is None else i / len(episodes)
                on_progress(min(0.99, done))
    if on_progress is not None:
        on_progress(1.0)


def _at_least(shots: float) -> int:
    return next(n for n in _SHOTS if n >= min(shots, SUBSTEPS))


def _caption(wide: int) -> tuple[int, int]:
    """Return sizes in pixels: of the letters above such a picture, and of two lines."""
    letters = max(9, wide // 38)  # Pages make wide films small.
    return letters, 2 * round(1.4 * letters)


def _labelled(
    frame: np.ndarray, above: str, below: str, mark: str, is_way: bool
) -> np.ndarray:
    """Return a frame below two lines, and a mark to the right of the first."""
    image, font = import_extra("PIL.Image"), import_extra("PIL.ImageFont").load_default
    height, wide = frame.shape[:2]
    size, strip = _caption(wide)
    picture = image.new("RGB", (wide, strip + height), "#202428")
    picture.paste(image.fromarray(frame), (0, strip))
    pen = import_extra("PIL.ImageDraw").Draw(picture)
    edge, high, low = size // 2, 0.75 * size, 2.0 * size
    long, marked = (pen.textlength(each, font(size=size)) for each in (above, mark))
    given = min(marked, max(wide // 4, wide - 3 * size - long))
    for line, x, y, anchor, letters, room, colour in (
        (mark, wide - edge, high, "rm", size, given, _GREY if is_way else _GREEN),
        (above, edge, high, "lm", size, wide - 3 * size - given, "#ffffff"),
        (below, edge, low, "lm", 0.85 * size, wide - size, _GREY),
    ):
        share = min(1.0, room / max(1, pen.textlength(line, font(size=letters))))
        letters = max(4.0, share * letters)  # Smaller ones cannot be drawn.
        pen.text((x, y), line, colour, font(size=letters), anchor=anchor)
    return np.asarray(picture)
