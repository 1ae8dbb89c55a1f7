import re
import shutil
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image, ImageSequence

import collaborative_gym as cg
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.files import check_writable, replacing, write_text
from collaborative_gym.pictures import recording, rendering, video
from collaborative_gym.pictures.rendering import Camera
from collaborative_gym.testing import play

imageio = pytest.importorskip("imageio.v2")

SIZE = (64, 48)


@pytest.fixture(autouse=True)
def one_lamp(monkeypatch):
    """Draw each picture once; `test_rendering` has the shadows of several."""
    monkeypatch.setattr(rendering, "_LAMPS", 1)


def seconds(caption):
    return float(re.search(r", ([\d.]+) s", caption)[1])


def noting(told):
    """Return what notes captions in place of drawing them."""
    return lambda frame, *texts: told.append("\n".join(texts[:3])) or frame


@pytest.mark.parametrize("shots", [2, 5, 10])
def test_filming_changes_no_bit(make_env, shots):
    plain, filmed = make_env(2), make_env(2)
    seen = []
    filmed.watch(lambda: seen.append(filmed.sim.qpos.copy()), shots)
    for env in (plain, filmed):
        env.reset(seed=1)
    assert play(plain, 15) == play(filmed, 15)
    assert len(seen) == 15 * shots
    assert np.array_equal(plain.sim.get_state(), filmed.sim.get_state())


def test_watching_needs_a_divisor_of_the_substeps(make_env):
    with pytest.raises(ValueError, match="shots must divide 10, got 3"):
        make_env().watch(print, 3)


def test_mp4_plays_in_real_time(carry, tmp_path):
    task = carry(max_episode_steps=3)
    path = recording.record(task, tmp_path / "new" / "a.mp4", seconds=2.0, size=SIZE)
    with imageio.get_reader(path) as video:
        frames, meta = list(video.iter_data()), video.get_meta_data()
    # Two episodes, each with its start, and 1.5 seconds after its end.
    assert len(frames) == 2 * (1 + 2 * (3 + 15))
    assert meta["fps"] == 20 and meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p") and meta["size"] == SIZE
    assert frames[0].std() > 10
    assert [entry.name for entry in path.parent.iterdir()] == ["a.mp4"]


@pytest.mark.parametrize(
    ("speed", "shots", "rate"), [(0.5, 5, 25), (0.1, 10, 10), (2.0, 1, 20)]
)
def test_slow_motion_has_more_pictures_of_a_step(
    carry, tmp_path, monkeypatch, speed, shots, rate
):
    labels = []
    monkeypatch.setattr(recording, "_labelled", noting(labels))
    path = recording.record(
        carry(max_episode_steps=3),
        tmp_path / "a.mp4",
        seconds=0.1,
        size=SIZE,
        speed=speed,
    )
    with imageio.get_reader(path) as video:
        frames, meta = list(video.iter_data()), video.get_meta_data()
    assert meta["fps"] == rate
    # A start, three steps, and 1.5 seconds of the film after the end.
    assert len(frames) == 1 + shots * 3 + shots * round(15 * speed)
    assert f"0.3 s, speed {speed:g}x, expert" in labels[-1]


@pytest.mark.parametrize(("name", "pace"), [("a.gif", 0.2), ("a.mp4", 0.4)])
@pytest.mark.parametrize(
    ("kept", "bound"), [({}, 0.6), ({"highest": "greatest"}, 0.55)]
)
def test_slow_motion_is_about_progress_or_success(
    carry, tmp_path, monkeypatch, kept, bound, name, pace
):
    class Raised(type(carry())):
        coordination, success_for = kept, 4

        def measure(self, sim):
            facts = super().measure(sim)
            return replace(facts, highest=1.0 * (facts.height > 0.55))

    plain, told = carry(), []
    task = Raised(list(plain.robots.values()), plain.config)
    monkeypatch.setattr(recording, "_labelled", noting(told))
    frame = np.zeros((*SIZE[::-1], 3), np.uint8)
    monkeypatch.setattr(recording._Screen, "_draw", lambda *state: frame)
    path = tmp_path / name
    recording.record(task, path, seconds=0.1, size=SIZE, slow_motion=True)
    env = VectorEnv(task, 1, num_threads=1)
    env.reset(seed=0)
    while env.facts.height[0] < bound:
        *_, infos = env.step(env.expert())
    moment = int(infos["step"][0])
    times = [seconds(text) for text in told if f", speed {pace}x, " in text]
    # A start has one picture.
    shown = [step for step in range(moment - 5, moment + 2) if step >= 0]
    slow = [round(0.1 * step, 1) for step in shown for _ in range(5 if step else 1)]
    assert times == slow


def test_slow_motion_is_about_each_step_and_the_end_of_what_creeps():
    def ends(*shares):
        screen = SimpleNamespace(_stage="stage", _progress=lambda step: step.share)
        steps = [SimpleNamespace(share=s, infos={"metrics": {}}) for s in shares]
        slow = sorted(recording._Screen.decisive(screen, steps))
        return [step - 1 for step in slow if step + 1 not in slow]

    assert ends(*[0.0] * 9, *[0.5] * 12, *[0.6] * 3, *[1.0] * 9) == [9, 24]
    assert ends(*[0.0] * 9, 0.1, 0.2, 0.3, *[0.31] * 9, 0.5, 0.7, *[1.0] * 9) == [23]
    assert ends(*[0.0] * 9, 0.1, 0.2, 0.3, *[0.31] * 9, 0.4, *[0.5] * 9) == [11, 22]


def test_slow_motion_of_a_game_is_about_every_score(tmp_path, monkeypatch):
    told, frame = [], np.zeros((*SIZE[::-1], 3), np.uint8)
    monkeypatch.setattr(recording, "_labelled", noting(told))
    monkeypatch.setattr(recording._Screen, "_draw", lambda *state: frame)
    recording.record(
        "HockeyPandas-v0",
        tmp_path / "a.gif",
        policy={"robot_1": "expert", "robot_2": "idle"},
        only_episodes=[0],
        size=SIZE,
        slow_motion=True,
    )
    at = [round(10 * seconds(text)) for text in told]
    steps = dict(zip(at, told, strict=True))
    scores = [steps[i].split(" : ")[0].split()[-1] for i in range(len(steps))]
    goals = [i for i in range(1, len(scores)) if scores[i] != scores[i - 1]]
    assert len(goals) > 1
    around = {step for goal in goals for step in range(goal - 5, goal + 2)}
    slow = {i for i, text in zip(at, told, strict=True) if ", speed 0.2x, " in text}
    assert slow == around & set(at)


def test_close_up_follows_its_body_beside_the_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_labelled", lambda frame, *_: frame)
    size = width, side = 64, 74
    pot = {"close_up": "pot/pot", "seconds": 0.1, "size": size, "policy": "baseline"}
    path = recording.record("LiftTaskSawyers-v0", tmp_path / "a.gif", **pot)
    with Image.open(path) as video:
        frames = [np.asarray(f.convert("RGB")) for f in ImageSequence.Iterator(video)]
    height = side - 26  # The caption's, which is left out here.
    assert frames[0].shape == (height, width + side, 3)
    assert (frames[0][:, width : width + 2] > 240).all()  # the line between them
    for frame in frames[0], frames[-1]:  # On the table, and raised.
        reds = frame[..., 0].astype(float) - frame[..., 2] > 60  # Its handles.
        assert reds[:, width:].sum() > 0.013 * height**2
        column = np.flatnonzero(reds[:, width:].any(axis=0)).mean()
        assert abs(column - side / 2) < 0.15 * height


def test_close_up_is_below_a_long_picture(tmp_path):
    long = {"close_up": ["pot/pot", "robot_1/hand"], "seconds": 0.1, "size": (192, 64)}
    path = recording.record("LiftPandas3-v0", tmp_path / "a.gif", **long)
    with Image.open(path) as video:
        frame = np.asarray(video.convert("RGB"))
    assert frame.shape == (102, 192, 3)  # Two of 38 below one caption of 26.
    assert (frame[64:66] > 240).all()


def test_a_film_says_for_a_second_who_has_scored(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(recording, "_labelled", noting(told))
    game, players = cg.task("HockeyPandas-v0", max_episode_steps=40), ("expert", "idle")
    film = {"only_episodes": [8], "size": SIZE}  # With a goal in its first second.
    policy = dict(zip(game.agents, players, strict=True))
    recording.record(game, tmp_path / "a.gif", policy=policy, **film)
    goals = [text for text in told if text.endswith("\nrobot_1 (red) expert scores")]
    assert 0 < len(goals) < len(told) / 2
    before = told[told.index(goals[0]) - 1]
    assert "expert 0 : 0" in before and "expert 1 : 0" in goals[0]
    assert before.endswith("\n0 : 0") and told[-1].endswith("wins")


def test_a_film_says_for_how_long_the_goal_was_met(tmp_path, monkeypatch):
    told, task = [], cg.task("BalanceTaskSawyers-v0")
    monkeypatch.setattr(recording, "_labelled", noting(told))
    frame = np.zeros((*SIZE[::-1], 3), np.uint8)
    monkeypatch.setattr(recording._Screen, "_draw", lambda *state: frame)
    recording.record(task, tmp_path / "a.gif", seconds=0.1, size=SIZE)
    marks = dict.fromkeys(text.split("\n")[2] for text in told)
    held = [f"held {i / 10} of 2.0 s" for i in range(1, 20)]
    assert [*marks] == ["", *held, "success"]


def test_close_up_of_no_body_is_refused(carry, tmp_path):
    with pytest.raises(KeyError, match=r"no body 'pott'.* bodies: "):
        recording.record(carry(), tmp_path / "a.gif", size=SIZE, close_up="pott")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("speed", [0.0, 0.05, 3.0, float("nan"), "slow"])
def test_a_speed_out_of_bounds_is_refused(carry, tmp_path, speed):
    with pytest.raises((ValueError, TypeError), match="speed must be"):
        recording.record(carry(), tmp_path / "a.mp4", size=SIZE, speed=speed)
    assert list(tmp_path.iterdir()) == []


def test_gif_plays_in_real_time(carry, tmp_path):
    task = carry(max_episode_steps=4)
    path = recording.record(
        task, tmp_path / "a.GIF", policy="random", seconds=1.0, size=SIZE
    )
    with Image.open(path) as video:
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(video)]
        assert video.size == SIZE
    assert sum(durations) == 20 * 100


def test_what_comes_late_into_a_gif_has_its_colour(tmp_path):
    frames = np.full((20, 48, 64, 3), 200, np.uint8)
    frames += np.arange(64, dtype=np.uint8)[:, None] // 2
    frames[10:, 20:24, 20:24] = 20, 80, 220
    video._write_gif(tmp_path / "a.gif", iter(frames), 10)
    with Image.open(tmp_path / "a.gif") as film:
        film.seek(film.n_frames - 1)
        assert film.convert("RGB").getpixel((22, 22)) == (20, 80, 220)


def test_frames_are_drawn_anew_only_when_something_moves(make_env):
    env = make_env(1)
    env.reset(seed=0)
    camera = Camera(env.world.drawn_model, *SIZE)
    draw = recording._Screen(env, env.expert, {}, 1, [camera], False, 1.0)._draw
    sim = env.sim
    first, again = (draw(sim.qpos[0], sim.mocap_pos[0]) for _ in range(2))
    sim.qpos[0, 3] += 0.1
    moved = draw(sim.qpos[0], sim.mocap_pos[0])
    assert first is again
    assert not np.array_equal(first, moved)
    assert np.array_equal(moved, env.render(width=SIZE[0], height=SIZE[1]))
    camera.close()


def test_video_shows_the_episode_that_evaluate_plays(carry, tmp_path):
    played = []

    def policy(observations):
        played.append(observations["robot_1"][0])
        return {agent: np.zeros((1, 8)) for agent in observations}

    task = carry(max_episode_steps=2)
    recording.record(task, tmp_path / "a.gif", policy=policy, seed=4, size=SIZE)
    env = VectorEnv(task, 3, num_threads=1)
    observations, _ = env.reset(seed=4)
    assert np.array_equal(played[0], observations["robot_1"][0])


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize("name", ["a.mp4", "a.gif"])
def test_nothing_is_left_after_an_error(carry, tmp_path, name, error):
    steps = []

    def policy(observations):
        steps.append(None)
        if len(steps) == 3:
            raise error
        return {agent: np.zeros((1, 8)) for agent in observations}

    with pytest.raises(error):
        recording.record(carry(), tmp_path / name, policy=policy, size=SIZE)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def small_disk(tmp_path):
    """Return a folder of its own file system, on which 64 kB have room."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    if (
        not shutil.which("mount")
        or subprocess.run(mount, capture_output=True).returncode
    ):
        pytest.skip("only root may mount a small disk")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def noise(height=240, width=320, count=30):
    """Yield pictures that no encoder makes small."""
    draw = np.random.default_rng(0)
    for _ in range(count):
        yield draw.integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.mark.parametrize("name", ["a.mp4", "a.gif", "a.png"])
def test_a_full_disk_is_told_and_leaves_what_was_there(small_disk, name):
    path = small_disk / name
    path.write_text("old")
    with pytest.raises(OSError, match=f"^cannot write {path}: .*No space left on dev"):
        if name == "a.png":
            recording.contact_sheet(list(noise(count=2)), ["a", "b"], path)
        else:
            video.FORMATS[path.suffix][0](path, noise(), 20)
    assert path.read_text() == "old"
    assert list(small_disk.iterdir()) == [path]


LIMITED = """
import resource, sys
from pathlib import Path
import numpy as np
from collaborative_gym.pictures import recording, video

resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
path, draw = Path(sys.argv[1]), np.random.default_rng(0)
frames = (draw.integers(0, 256, (96, 128, 3), dtype=np.uint8) for _ in range(9))
try:
    video.FORMATS[path.suffix][0](path, frames, 20)
except OSError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="it knows no such limit")
@pytest.mark.parametrize(
    ("name", "why"), [("a.mp4", "ffmpeg failed: .+"), ("a.gif", "File too large")]
)
def test_an_encoder_that_is_killed_leaves_what_was_there(tmp_path, name, why):
    path = tmp_path / name
    path.write_text("old")
    child = subprocess.run(
        [sys.executable, "-c", LIMITED, path], capture_output=True, text=True
    )
    assert re.fullmatch(f"cannot write {path}: {why}\n", child.stdout), child.stderr
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_caption_stands_above_and_is_as_large_as_its_width_allows():
    def lines(width, *texts):
        frame = np.full((240, width, 3), 7, np.uint8)
        labelled = recording._labelled(frame, *texts, False)
        strip = len(labelled) - 240
        assert (labelled[strip:] == 7).all() and strip % 2 == 0
        grey = labelled[:strip].max(axis=2) > 100
        return [grey[: strip * 55 // 100], grey[strip * 55 // 100 :]]

    def ends(seen):
        _, right = np.nonzero(seen)
        return right.min(), right.max()

    about = "LiftPandas3-v0, 3.8 s, robot_1 baseline, robot_2 expert:nearer"
    above, below = lines(640, "Lift a pot.", about, "success")
    assert ends(above[:, :320])[1] < 100 < 240 < ends(above[:, 320:])[0]
    assert 300 < ends(below)[1] < 632
    assert len(lines(1280, "Lift a pot.", about, "")[0]) > 1.9 * len(above)
    for texts in (["Lift " * 12, about, "success"], ["Lift", "a pot", "won " * 12]):
        above, below = lines(240, *texts)
        assert ends(above)[1] < 239 and ends(below)[1] < 239
        assert not above[:, [0, 1]].any()
    goal = "Pull the bar over your own line, not the other."
    alone, beside = (lines(400, goal, "", mark)[0] for mark in ("", "it wins " * 6))
    assert ends(alone)[1] == ends(beside[:, : ends(alone)[1] + 9])[1]
    lines(64, about * 9, about * 9, "success")  # It is cut off.


def test_success_is_green():
    frame = np.zeros((48, 320, 3), np.uint8)
    for is_way in (True, False):
        labelled = recording._labelled(frame, "", "", "success", is_way)
        red, green, _ = labelled.reshape(-1, 3).T
        assert (green > 1.5 * red + 50).any() != is_way


def test_a_draw_is_no_success(tmp_path, monkeypatch):
    told = []

    def note(frame, *texts):
        told.append(texts)
        return frame

    monkeypatch.setattr(recording, "_labelled", note)
    task = cg.task("HockeyPandas-v0", max_episode_steps=2)
    still = dict.fromkeys(task.agents, "idle")
    recording.record(
        task, tmp_path / "a.gif", policy=still, only_episodes=[0], size=SIZE
    )
    assert told[-1][2:] == ("draw", True)


def test_films_beside_each_other_say_who_plays(carry, tmp_path, monkeypatch):
    named = []
    labelled = recording._labelled

    def note(frame, *texts):
        named.append(texts[1])
        return labelled(frame, *texts)

    monkeypatch.setattr(recording, "_labelled", note)
    policies = [{"robot_1": "idle", "robot_2": "random"}, "expert"]
    path = recording.record(
        carry(max_episode_steps=2),
        tmp_path / "a.gif",
        policy=policies,
        seconds=1.0,
        size=SIZE,
    )
    players = {text.partition(" s, ")[2].strip() for text in named}
    assert players == {"robot_1 idle, robot_2 random", "expert"}
    with Image.open(path) as video:
        assert video.size == (2 * SIZE[0], SIZE[1])


def test_the_next_start_comes_soon_after_the_first_policys_success(
    carry, tmp_path, monkeypatch
):
    told = []
    monkeypatch.setattr(recording, "_labelled", noting(told))
    recording.record(
        carry(), tmp_path / "a.gif", policy=["expert", "idle"], seconds=3.0, size=SIZE
    )
    experts, others = told[::2], told[1::2]
    starts = [i for i, text in enumerate(experts) if ", 0.0 s" in text]
    assert starts == [i for i, text in enumerate(others) if ", 0.0 s" in text]
    assert len(starts) > 1 and not any("success" in text for text in others)
    for start, end in zip(starts, [*starts[1:], len(experts)], strict=True):
        first = next(i for i in range(start, end) if "success" in experts[i])
        assert end - first == 16  # 1.5 seconds
        again = [", start " in text for text in experts[start:end]]
        assert all(again) if start else not any(again)
    assert ", start 2, 0.0 s" in experts[starts[1]]


def test_a_start_fades_into_the_next_one(carry, tmp_path, monkeypatch):
    def drawn(frame, goal, about, *_):
        level = 200 if ", start 2, " in about else 40
        return np.full((*SIZE[::-1], 3), level, np.uint8)

    monkeypatch.setattr(recording, "_labelled", drawn)
    task = carry(max_episode_steps=3)
    path = recording.record(task, tmp_path / "a.mp4", only_episodes=[0, 1], size=SIZE)
    with imageio.get_reader(path) as video:
        frames = list(video.iter_data())
    strip = recording._caption(SIZE[0])[1]
    seen = [frame[strip + 4 :].mean() for frame in frames]
    captions = [frame[: strip - 4].mean() for frame in frames]
    first = len(seen) // 2  # In 0.4 s from there.
    assert np.allclose(captions[:first], 40, atol=8)
    assert np.allclose(captions[first:], 200, atol=8)
    fading = [40, 60, 80, 100, 120, 140, 160, 180, 200]
    assert np.allclose(seen[first : first + 9], fading, atol=8)
    assert np.allclose(seen[:first], 40, atol=8)
    assert np.allclose(seen[first + 9 :], 200, atol=8)


def test_a_film_shows_the_episodes_that_are_named(carry, tmp_path):
    seen, shares = [], []

    def policy(observations):
        seen.append(observations["robot_1"][0])
        return {agent: np.zeros((1, 8)) for agent in observations}

    recording.record(
        carry(max_episode_steps=2),
        tmp_path / "a.gif",
        policy=policy,
        seed=4,
        only_episodes=[7, 3],
        size=SIZE,
        on_progress=shares.append,
    )
    env = VectorEnv(carry(), 2, num_threads=1)
    observations, _ = env.reset(seed=4, episodes=[7, 3])
    assert np.array_equal(seen[::2], observations["robot_1"])
    assert shares == sorted(shares) and shares.count(1.0) == 1


def test_a_film_of_opponents_ends_with_the_winner(tmp_path, monkeypatch):
    told, shares = [], []
    monkeypatch.setattr(recording, "_labelled", noting(told))
    path = recording.record(
        "TugPandas-v0",
        tmp_path / "a.gif",
        policy={"robot_1": "expert", "robot_2": "idle"},
        seconds=1.0,
        size=SIZE,
        on_progress=shares.append,
    )
    # It lasts longer than was asked for, and only its end is the whole.
    assert shares == sorted(shares) and shares.count(1.0) == 1
    [goal, first, _] = told[0].split("\n")
    assert goal == "Pull the bar over your own line, against the other arm."
    assert (
        first
        == "TugPandas-v0, 0.0 s, robot_1 (orange) expert 0 : 0 robot_2 (blue) idle"
    )
    [_, last, result] = told[-1].split("\n")
    assert last.endswith(" s, robot_1 (orange) expert 1 : 0 robot_2 (blue) idle")
    assert result == "robot_1 (orange) expert wins"
    # The end is shown for 1.5 seconds.
    with Image.open(path) as video:
        ends = [frame.info["duration"] for frame in ImageSequence.Iterator(video)]
    assert ends[-1] >= 1500


def test_picture_shows_the_robots_at_work(carry):
    first = recording.picture(carry(), size=SIZE)
    assert first.shape == (48, 64, 3) and first.dtype == np.uint8
    assert np.array_equal(first, recording.picture(carry(), size=SIZE))


def test_contact_sheet_is_a_labelled_grid(tmp_path):
    colours = [(200, 0, 0), (0, 200, 0), (0, 0, 200), (99, 99, 99), (200, 200, 0)]
    pictures = [np.full((270, 480, 3), colour, np.uint8) for colour in colours]
    path = recording.contact_sheet(
        pictures, list("abcde"), tmp_path / "sheet.png", columns=3
    )
    with Image.open(path) as sheet:
        pixels = np.asarray(sheet.convert("RGB"))
    for colour in colours:
        assert (pixels == colour).all(axis=2).sum() == 270 * 480
    is_ink = (pixels < 80).all(axis=2)
    assert is_ink.any()
    assert pixels.shape[1] > 3 * 480 and 2 * 270 < pixels.shape[0] < 3 * 270


def test_bad_input_says_what_is_allowed(carry, tmp_path):
    with pytest.raises(ValueError, match=r"end its name with .gif or .mp4"):
        recording.record(carry(), tmp_path / "a.mp3")
    with pytest.raises(ValueError, match="must be even, got 63 x 48"):
        recording.record(carry(), tmp_path / "a.mp4", size=(63, 48))
    with pytest.raises(ValueError, match="height must be at most 1080, got 1082"):
        recording.record(carry(), tmp_path / "a.mp4", size=(64, 1082))
    with pytest.raises(ValueError, match="width must be at least 32, got 4"):
        recording.record(carry(), tmp_path / "a.mp4", size=(4, 48))
    with pytest.raises(TypeError, match=r"size must be a width and a height, got 64"):
        recording.picture(carry(), size=64)
    with pytest.raises(ValueError, match="seconds must be above 0, got 0"):
        recording.record(carry(), tmp_path / "a.mp4", seconds=0)
    with pytest.raises(ValueError, match="give seconds or only_episodes, not both"):
        recording.record(carry(), tmp_path / "a.mp4", seconds=3, only_episodes=[1])
    assert list(tmp_path.iterdir()) == []


def test_missing_extra_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(ImportError, match=r"pip install .* --editable .\.\[video\]"):
        recording.check_ready()


def test_errors_name_the_file_that_was_asked_for(tmp_path):
    (tmp_path / "file").touch()
    for path in (tmp_path, tmp_path / "file" / "a.txt"):
        with pytest.raises(OSError, match=f"^cannot write {path}: [^']*$"):
            write_text(path, "new")
        with pytest.raises(OSError, match=f"^cannot write {path}: [^']*$"):
            check_writable(path)
    check_writable(tmp_path / "file")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_a_file_is_replaced_only_when_it_is_whole(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(KeyboardInterrupt), replacing(path) as partial:
        partial.write_text("ne")
        raise KeyboardInterrupt
    with pytest.raises(OSError):
        partial.write_text("an encoder that started late")
    assert path.read_text() == "old"
    write_text(path, "new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]
