"""Writes those parts of the documentation that are made from the code.

    python docs/made_pages.py

It writes a page for each task from its module's docstring, its spaces and its
baselines' cards; one for the command line from its own help; and in the other pages
what stands between `<!-- made: NAME -->` and `<!-- end -->`. The results are committed,
so that every page can be read as a file; a test fails where they are stale.
"""

import contextlib
import dataclasses
import inspect
import io
import os
import pkgutil
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from types import FunctionType

import griffe
import imageio_ffmpeg
import numpy as np
from PIL import Image

import collaborative_gym as cg
from collaborative_gym.blocks import POSE
from collaborative_gym.certificate.report import (
    Certificate,
    certificates_to_markdown,
)
from collaborative_gym.cli.main import main as command_line
from collaborative_gym.control import get_mode, list_modes
from collaborative_gym.errors import counted
from collaborative_gym.policies.policy import is_shipped, shipped_file
from collaborative_gym.scene import grasps
from collaborative_gym.tasks.registry import EnvSpec, get_env

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
_NOTE = "<!-- made by docs/made_pages.py: change the code, not this page -->"
COMMANDS = (
    "list",
    "view",
    "record",
    "train",
    "evaluate",
    "tournament",
    "compare",
    "report",
    "reproduce",
    "certify",
    "check",
    "benchmark",
    "demo",
)
"""The verbs of the command line, in the order of its own help."""

_TASKS = (
    "Poke",
    "Lift",
    "Balance",
    "Pass",
    "BalancePath",
    "Hockey",
    "Tug",
    "Reach",
    "Sort",
    "Assemble",
)
_MOMENT = {
    **dict.fromkeys(
        ("LiftTaskSawyers-v0", "LiftTaskJacos-v0", "LiftPandas3-v0", "LiftPandas4-v0"),
        90,
    ),
    "AssemblePandas3-v0": 85,
    "ReachPandas4-v0": 90,
    "SortPandas4-v0": 60,
    "BalanceTaskSawyers-v0": 45,
    "BalanceTaskJacoSawyer-v0": 45,
    "TugPandas-v0": 30,
    **dict.fromkeys(
        ("PassTaskSawyers-v0", "PassTaskJacoSawyer-v0", "PassPinchSawyers-v0"), 59
    ),
    "PassFrictionSawyers-v0": 64,
    "PassPandas3-v0": 41,
}
"""Moments of films, in % of their time, that show more than the half."""

_MOST = 8
"""Most parameters of a class that its line in the reference lists."""

_SAID = {"VectorEnv": " [What it returns](#what-vectorenv-returns) is below."}
"""What the reference says of a class in place of all above its sections."""

_EXPLAINED = {
    "control.list_modes": "../concepts.md#action-modes",
    "envs.wrists": "../concepts.md#force-and-torque-sensing",
    "scene.grasps": "../concepts.md#grasps",
}
"""Where pages explain what docstrings of settings name."""

_AGAINST = ("Hockey", "Tug")
"""Those in which robots play against each other."""

_LABELS = (
    "Agents",
    "Randomized",
    "Reward of each agent",
    "Success",
    "Success of a side",
)
"""Words that begin a paragraph of a task's docstring, to stand out in its page."""

_COMPLETION = """```sh
mkdir -p ~/.local/share/bash-completion/completions ~/.zfunc
collaborative-gym --tyro-write-completion bash \\
    ~/.local/share/bash-completion/completions/collaborative-gym
collaborative-gym --tyro-write-completion zsh ~/.zfunc/_collaborative-gym
```"""
"""How the shell learns what can follow; zsh's folder must be in its `fpath`."""

_WHOSE = {"the thesis": "#9aa5ad", "the baselines here": "#e64a19"}
"""Whose bars the chart has, with their colours."""

_POLICIES = {"one policy for all robots": "#e64a19", "a policy per robot": "#1565c0"}
"""How teams learned, with the colours of their curves."""

_WIDTH = 78
"""Columns of the command line's help."""


def main() -> None:
    """Write all pages, and the pictures that are made."""
    for path, content in stale().items():
        path.write_bytes(content)
        print(path.relative_to(ROOT))


def stale() -> dict[Path, bytes]:
    """Return what the files should hold that differ from what the code makes."""
    made = {DOCS / path: text.encode() for path, text in made_pages().items()}
    for page in [*DOCS.rglob("*.md"), ROOT / "README.md"]:
        if page not in made:
            text = filled(page.read_text(), page.relative_to(ROOT).as_posix())
            made[page] = text.encode()
    made[DOCS / "media" / "table11.svg"] = _chart().encode()
    made[DOCS / "media" / "team_size.svg"] = _curves().encode()
    for film in DOCS.glob("media/*s/*.mp4"):
        if not film.with_suffix(".jpg").exists():
            made[film.with_suffix(".jpg")] = _still(film)
    return {
        path: content
        for path, content in made.items()
        if not path.exists() or path.read_bytes() != content
    }


def pages_to_make() -> dict[str, Callable[[], str]]:
    """Return what makes the Markdown of each page that is made, by path in `docs/`."""
    return {
        "reference/command_line.md": _command_line_page,
        "tables/certificates.md": lambda: f"# Certificates\n\n{_certificates()}",
        **{f"tasks/{name.lower()}.md": partial(_task_page, name) for name in _TASKS},
    }


def made_pages() -> dict[str, str]:
    """Return the Markdown of each page that is made, by its path in `docs/`."""
    makers = pages_to_make().items()
    return {path: f"{_NOTE}\n\n{make()}\n" for path, make in makers}


def filled(markdown: str, path: str) -> str:
    """Return a page with what is made between its comments made anew.

    `<!-- made: NAME -->` names one of `_MADE`; a file of the repository, such as
    `docs/tables/table11.md`; a section of one, such as `README.md, Licence`; lines of
    Python, such as `examples/it.py:1:11`; names of Python, `names make task`; or what
    the docstring of one says before its arguments, `says VectorEnv`.

    Args:
      markdown: the page.
      path: where it is in the repository; links are made to be from there.

    Raises:
      FileNotFoundError: if there is no such file.
      KeyError: if the file has no such section.
    """
    links = f"]({'../' * (path.count('/') - 1)}"

    def make(hole: re.Match[str]) -> str:
        text = _make(hole[1]).replace("](docs/", links)
        return f"<!-- made: {hole[1]} -->\n\n{text}\n\n<!-- end -->"

    return re.sub(r"<!-- made: (.+?) -->.*?<!-- end -->", make, markdown, flags=re.S)


def python_lines(what: str) -> str:
    """Return lines of a Python file, both ends included, such as `it.py:1:11`."""
    name, first, last = what.split(":")
    lines = (ROOT / name).read_text().splitlines()
    return "\n".join(lines[int(first) - 1 : int(last)])


def _make(what: str) -> str:
    if what in _MADE:
        return _MADE[what]()
    if what.startswith("names "):
        return _names(what.removeprefix("names "))
    if what.startswith("says "):
        thing = pkgutil.resolve_name(f"collaborative_gym.{what.removeprefix('says ')}")
        return inspect.getdoc(thing).partition("\n\nArgs:")[0]
    if ".py:" in what:
        return f"```python\n{python_lines(what)}\n```"
    name, _, title = what.partition(", ")
    text = (ROOT / name).read_text()
    if title:
        sections = re.split(r"^## (.+)\n", text, flags=re.M)
        text = dict(zip(sections[1::2], sections[2::2], strict=True))[title]
    return text.strip()


def _modes() -> str:
    """Return a list of the action modes, by their docstrings."""
    docs = {name: str(get_mode(name).__doc__).split() for name in list_modes()}
    return "\n".join(
        textwrap.fill(f"- `{name}`: {' '.join(words)}", 100, subsequent_indent="  ")
        for name, words in docs.items()
    )


def _grasps() -> str:
    """Return what each grasp does, by the docstring of their module."""
    text = str(inspect.getdoc(grasps))
    return text[text.index("- `") :]


def _environments() -> str:
    """Return the table of all environments, with links from the page of all tasks."""
    rows = []
    for name in _TASKS:
        link = f"[{name}]({name.lower()}.md)"
        for env_id, spec in _envs(name):
            env = cg.make_vec(env_id, 1, num_threads=1)
            rows.append(
                (
                    f"[`{env_id}`]({name.lower()}.md#{env_id.lower()})",
                    link,
                    counted(spec.robots),
                    _sizes(env.single_observation_spaces),
                    _sizes(env.single_action_spaces),
                )
            )
    columns = "environment", "task", "robots", "observations", "actions"
    return _table(columns, rows)


def _task_page(name: str) -> str:
    envs = _envs(name)
    task = envs[0][1].task
    head, _, body = inspect.getdoc(inspect.getmodule(task)).partition("\n\n")
    _, _, subject = head.partition(": ")
    paragraphs = [
        f"# {name}",
        subject[0].upper() + subject[1:],
        *map(_labelled, body.split("\n\n")),
    ]
    paragraphs.insert(2, f"![{name}](../media/{name.lower()}.jpg)")
    for env_id, spec in envs:
        paragraphs += _environment(env_id, spec)
    paragraphs += ["## Settings", _settings(task.config_class)]
    paragraphs += ["## Reward and success, as the code has them"]
    for method in (task.reward, task.success):
        source = textwrap.dedent(inspect.getsource(method)).rstrip()
        paragraphs.append(f"```python\n{source}\n```")
    return "\n\n".join(paragraphs)


def _environment(env_id: str, spec: EnvSpec) -> list[str]:
    """Return the paragraphs about one environment of a task."""
    env = cg.make_vec(env_id, 1, num_threads=1)
    arms = [
        f"- `{agent}`: [{robot.title}](../robots.md#{robot.name}) at"
        f" {_place(env.task.placements[agent])}"
        for agent, robot in env.task.robots.items()
    ]
    own = {name: value for name, value in spec.settings.items() if name != "placements"}
    if own:
        listed = ", ".join(f"`{name}` {value!r}" for name, value in own.items())
        arms.append(f"- settings that differ from the defaults: {listed}")
    paragraphs = [f"## {env_id}"]
    for player, film in _film(env_id).items():
        said = f"{env_id}, played by its {player}; click for the film"
        paragraphs.append(_to_film(said, "..", film))
    paragraphs += ["\n".join(arms), _observations(env), _actions(env)]
    card = shipped_file("baseline", env_id).with_suffix(".md")
    if card.exists():
        paragraphs += ["### Baseline", card.read_text().partition("\n\n")[2].strip()]
        curve = f"media/baselines/{env_id}.png"
        if (ROOT / "docs" / curve).exists():
            last = " of the last run" * ("command 1 of" in card.read_text())
            paragraphs.append(_picture(f"Learning curve{last}", f"../{curve}", 600))
    if is_shipped("ego", env_id):
        paragraphs.append(
            "There is also [an ego](../strangers.md#an-ego-with-advice), which works"
            " with partners of many kinds: `--policy ego`."
        )
    return paragraphs


def _observations(env: cg.VectorEnv) -> str:
    """Return what the robots observe, one table where all observe the same blocks."""
    by_agent = env.observation_blocks
    alike = len({tuple(blocks.items()) for blocks in by_agent.values()}) == 1
    tables = []
    for agent, blocks in by_agent.items():
        who = "Each robot" if alike else f"`{agent}`"
        ends = np.cumsum([block.size for block in blocks.values()])
        rows = [
            (
                f"{end - block.size} to {end - 1}" if block.size > 1 else f"{end - 1}",
                block.name,
                " x ".join(map(str, block.shape)),
                "see above" if len(block.shape) > 1 else block.unit,
            )
            for block, end in zip(blocks.values(), ends, strict=True)
        ]
        tables.append(
            f"{who} observes {ends[-1]} numbers, float32:\n\n"
            + _table(("index", "what", "shape", "unit"), rows)
        )
        if alike:
            break
    is_own = all("mates" in blocks for blocks in by_agent.values())
    frame = "frame of the robot's own base" if is_own else "world's frame"
    if any(b.unit == POSE for own in by_agent.values() for b in own.values()):
        tables.append(
            f"`m; quaternion`: a position and a quaternion x, y, z, w, in the {frame}."
        )
    return "\n\n".join(tables)


def _actions(env: cg.VectorEnv) -> str:
    """Return what an action is, and what the reward is made of."""
    parts = env.action_parts.values()
    sizes = {sum(part.size for part in own.values()) for own in parts}
    listed = " or ".join(map(str, sorted(sizes)))
    grip = ""
    if all("grip" in own for own in parts):
        grip = ", then `grip`, which grips above 0"
    moves = "one for each joint"
    if (mode := env.task.config.action) != "joints":
        moves = f"as the [action mode](../concepts.md#action-modes) `{mode}` has them"
    by_terms: dict[str, list[str]] = {}
    for agent, terms in env.reward_terms.items():
        by_terms.setdefault(", ".join(f"`{t}`" for t in terms), []).append(agent)
    sums = (
        f"The reward{(len(by_terms) > 1) * (' of ' + ', '.join(who))} is the sum"
        f" of {terms}."
        for terms, who in by_terms.items()
    )
    action = f"An action is {listed} numbers in [-1, 1]: `moves`, {moves}{grip}."
    return "\n\n".join([action, *sums])


def _settings(config: type[cg.TaskConfig]) -> str:
    """Return a table of a task's settings, from its config's fields and docstring."""
    meanings: dict[str, str] = {}
    for base in reversed(config.__mro__):
        meanings |= _attributes(base)
    rows = []
    for field in dataclasses.fields(config):
        made = field.default is dataclasses.MISSING
        default = '"default"' if made else _short(field.default)
        rows.append((f"`{field.name}`", meanings[field.name], f"`{default}`"))
    return (
        "Options of `cg.make`, `cg.make_vec` and `gymnasium.make`. The randomization is"
        ' the name of a preset, `"default"`, `"paper"`, `"wide"`, `"lost"` or'
        ' `"hard"`, or a'
        " [`Randomization`](../reference/python.md#collaborative_gym.Randomization)."
        "\n\n" + _table(("setting", "meaning", "default"), rows)
    )


def _short(value: object) -> str:
    """Return a default as one would write it."""
    return f"{value:.4g}" if isinstance(value, float) else repr(value)


def _attributes(owner: object, kind: str = "attributes") -> dict[str, str]:
    """Return what a docstring says of attributes, `parameters` or `raises`, by name."""
    sections = griffe.Docstring(inspect.getdoc(owner) or "").parse(
        "google", warnings=False
    )
    return {
        getattr(each, "name", each.annotation): _linked(
            each.description.replace("\n", " ")
        )
        for section in sections
        if section.kind.value == kind
        for each in section.value
    }


def _linked(text: str) -> str:
    """Return words of a docstring with links to what pages explain."""
    for name, page in _EXPLAINED.items():
        text = text.replace(f"`{name}`", f"[{name}]({page})")
    return text


def _arms() -> str:
    """Return the sections about the arms."""
    robots = [cg.get_robot(name) for name in cg.list_robots()]
    rows = [
        (
            f"[`{robot.name}`](#{robot.name})",
            robot.title,
            len(robot.joints),
            f"{robot.payload:g} kg",
            f"{robot.reach:g} m",
            f"{robot.stand}, {robot.base_height:g} m",
            f"{len(robot.gripper.joints)}, {1000 * robot.gripper.open_gap:.0f} mm",
        )
        for robot in robots
    ]
    columns = "name", "arm", "joints", "payload", "reach", "stands on", "fingers, open"
    return "\n\n".join((_table(columns, rows), *map(_arm, robots)))


def _certificates() -> str:
    """Return the table of the certificates that are shipped."""
    paths = sorted((ROOT / "docs" / "certificates").glob("*.json"))
    return certificates_to_markdown([Certificate.load(path) for path in paths])


def _still(film: Path) -> bytes:
    """Return a film's picture at half of its time, as JPEG."""
    content = io.BytesIO()
    count, _ = imageio_ffmpeg.count_frames_and_secs(film)
    frames = imageio_ffmpeg.read_frames(film)
    size = next(frames)["size"]
    moment = count * _MOMENT.get(film.stem, 50) // 100
    pixels = next(islice(frames, moment, None))
    image = Image.frombytes("RGB", size, pixels)
    image.save(content, format="JPEG", quality=85)
    frames.close()
    return content.getvalue()


def _films(tasks: Sequence[str]) -> str:
    """Return a picture of each environment that has a film, which leads to the film.

    Before those of a task stand its goal and, from README's table, why it takes two.
    """
    paragraphs, readme = [], (ROOT / "README.md").read_text()
    for name in tasks:
        goal = cg.task(name).summary
        row = re.search(rf"^\| \[{name}\].*\| (.*) \|$", readme, re.M)
        why = ""
        if name not in _AGAINST:
            why = f" Why not one arm? {row[1][0].upper()}{row[1][1:]}."
        paragraphs += [f"### {name}", f"{goal}{why}"]
        envs = _envs(name)
        grasps_used = [spec.settings.get("grasp", "magnet") for _, spec in envs]
        for (env_id, _), grasp in zip(envs, grasps_used, strict=True):
            how = ", against the expert (blue)" * (name in _AGAINST)
            if len(set(grasps_used)) > 1:
                how += f", with the [grasp](docs/concepts.md#grasps) `{grasp}`"
            for player, film in _film(env_id).items():
                page = f"docs/tasks/{name.lower()}.md#{env_id.lower()}"
                by = ", by its expert" * (player == "expert")
                paragraphs += [
                    f"#### [{env_id}]({page}){by}{how}",
                    _to_film(f"{env_id}; click for its film", "docs", film),
                ]
    return "\n\n".join(paragraphs)


def _film(env_id: str) -> dict[str, str]:
    """Return an environment's film in `docs/` by who plays, or nothing."""
    films = {who: f"media/{who}s/{env_id}.mp4" for who in ("baseline", "expert")}
    return {who: film for who, film in films.items() if (DOCS / film).exists()}


def _to_film(said: str, docs: str, film: str) -> str:
    """Return a film's picture, which leads to the film; `docs` is where they lie."""
    return f"[![{said}]({docs}/{_poster(film)})]({docs}/{film})"


def _poster(film: str) -> str:
    """Return the picture that stands for a film, by paths in `docs/`."""
    return film.removesuffix(".mp4") + ".jpg"


def _names(names: str) -> str:
    """Return a list of names, each with what it takes and its docstring's start."""
    return "\n".join(map(_name, names.split()))


def _name(name: str) -> str:
    """Return a line on a name, and one on each attribute, method, property or function.

    After the lists the site puts the whole docstrings.
    """
    path = f"collaborative_gym.{name}"
    thing = pkgutil.resolve_name(path)
    takes, says, listed = "", f"the value {thing}", {}
    is_class = inspect.isclass(thing)
    if callable(thing) or inspect.ismodule(thing):
        says = _begin(thing, whole=not inspect.ismodule(thing) and name not in _SAID)
        says += _SAID.get(name, "")
    if callable(thing):
        listed = _attributes(thing) | _attributes(thing, "parameters")
        takes = _takes(thing)
        if is_class and (takes.count(",") >= _MOST or "*args" in takes):
            takes = ""
    is_value = is_class and dataclasses.is_dataclass(thing)
    fields = dataclasses.fields(thing) if is_value else ()
    usual = {field.name: field.default for field in fields}
    if is_value:
        source = inspect.getsource(thing)
        comments = re.findall(r"^    (\w+):.*  # (.+)$", source, re.M)
        listed |= {own: said for own, said in comments if own in usual}
    lines = [f'- <a id="{path}"></a>`{name}{takes}`: {says}']
    for own, meaning in listed.items():
        default = usual.get(own)
        is_plain = isinstance(default, bool | int | float | str) and not takes
        shown = float(f"{default:.4g}") if isinstance(default, float) else default
        lines.append(f"    - `{own}`{f' ({shown})' if is_plain else ''}: {meaning}")
    for error, why in _attributes(thing, "raises").items():
        lines.append(f"    - raises `{error}`: {why}")
    for own in vars(thing) if is_class or inspect.ismodule(thing) else ():
        member = inspect.getattr_static(thing, own)
        if getattr(member, "__module__", path) != path and not is_class:
            continue  # It is from another module.
        bare = getattr(member, "__func__", getattr(member, "func", member))
        is_open = not own.startswith("_") and inspect.getdoc(bare)
        if is_open and isinstance(bare, property | FunctionType):
            is_called = callable(member) or isinstance(member, classmethod)
            takes = _takes(bare) if is_called else ""
            lines.append(f"    - `{own}{takes}`: {_begin(bare)}")
    return "\n".join(lines)


def _begin(thing: object, *, whole: bool = False) -> str:
    """Return the first paragraph of a docstring, or all above its sections."""
    text = inspect.getdoc(thing) or ""
    text = re.split(r"\n\n(?:\w+:|\S+ = )\n?" if whole else r"\n\n", text)[0]
    return " ".join(text.split())


class _Other:
    """A default that a line does not show."""

    def __repr__(self) -> str:
        return "..."


def _takes(function: Callable[..., object]) -> str:
    """Return what a function takes, without its types, and the type of its result."""
    empty, bare = inspect.Parameter.empty, []
    try:
        signature = inspect.signature(function)
    except ValueError:  # It is a type's name, such as that of a dictionary.
        return ""
    for name, each in signature.parameters.items():
        is_plain = isinstance(each.default, (bool, int, float, str, type(None)))
        is_needed = each.default is empty
        default = each.default if is_plain or is_needed else _Other()
        if name not in ("self", "cls"):
            bare.append(each.replace(annotation=empty, default=default))
    result = inspect.formatannotation(signature.return_annotation).strip("'~")
    result = re.sub(r"\b(\w+\.)+(?=\w)", "", result)
    says_much = result not in ("_empty", "None", "Any")
    return str(inspect.Signature(bare)) + f" -> {result}" * says_much


def _drawing(
    height: int, said: str, places: Sequence[int], key: dict[str, str]
) -> list[str]:
    """Return how an SVG begins: what a screen reader says, and names with colours."""
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 760 {height}"'
        ' font-family="sans-serif" font-size="12" fill="#222" role="img"'
        f' aria-label="{said}">',
        f'<rect width="760" height="{height}" fill="white"/>',
    ]
    for x, (name, color) in zip(places, key.items(), strict=True):
        lines += [
            f'<rect x="{x}" y="8" width="11" height="11" fill="{color}"/>',
            f'<text x="{x + 17}" y="18">{name}</text>',
        ]
    return lines


def _chart() -> str:
    """Return Table 11 as bars, drawn as SVG: the thesis above, ours below."""
    rows = re.findall(
        r"^\| (\S+-v\d) \| (completion|performance) \| (\S+) % \| (\S+) %",
        (DOCS / "tables" / "table11.md").read_text(),
        re.M,
    )
    said = "Completion and performance, the thesis and ours"
    lines = _drawing(len(rows) // 2 * 34 + 50, said, (190, 480), _WHOSE)
    for column, measure in enumerate(("completion", "performance")):
        x = 190 + 290 * column
        lines.append(f'<text x="{x}" y="40" font-weight="bold">{measure}, %</text>')
        own = [row for row in rows if row[1] == measure]
        for i, (env_id, _, *values) in enumerate(own):
            y = 50 + 34 * i
            if not column:
                lines.append(f'<text x="8" y="{y + 18}">{env_id}</text>')
            for j, (color, value) in enumerate(
                zip(_WHOSE.values(), values, strict=True)
            ):
                width, top = 2.2 * float(value), y + 13 * j
                lines.append(
                    f'<rect fill="{color}" x="{x}" y="{top}" width="{width:.1f}"'
                    f' height="11"/><text x="{x + width + 5:.1f}" y="{top + 10}"'
                    f' font-size="10">{value}</text>'
                )
    return "\n".join([*lines, "</svg>", ""])


def _curves() -> str:
    """Return what teams of each size need to learn, each run a dot, drawn as SVG."""
    said = "Steps and core-seconds to 90 % against the number of arms"
    lines = _drawing(500, said, (60, 280), _POLICIES)
    tables = re.findall(
        r"^\| arms \| steps, thousands.*\n.*\n((?:\|.*\n)+)",
        (DOCS / "teams.md").read_text(),
        re.M,
    )
    for column, (task, rows) in enumerate(zip(("Lift", "Reach"), tables, strict=True)):
        cells = [[c.strip() for c in row.split("|")[1:-1]] for row in rows.splitlines()]
        for row, (unit, most) in enumerate(
            (("thousand steps", 200), ("core-seconds", 400))
        ):
            lines += _panel(
                (60 + 370 * column, 40 + 230 * row),
                f"{task}: {unit} to 90 % completion",
                most,
                {int(each[0]): (each[1 + row], each[3 + row]) for each in cells},
            )
    return "\n".join([*lines, "</svg>", ""])


def _panel(
    corner: tuple[int, int], title: str, most: int, found: dict[int, tuple[str, ...]]
) -> list[str]:
    """Return runs by the number of arms, a colour for each of `_POLICIES`, as SVG."""
    left, top = corner
    lines = [f'<text x="{left}" y="{top}" font-weight="bold">{title}</text>']
    at = {arms: left + 30 + 40 * (arms - 2) for arms in found}

    def height(value: float) -> float:
        return round(top + 170 - 155 * value / most, 1)

    for tick in range(0, most + 1, most // 4):
        lines.append(
            f'<path d="M{left} {height(tick)}h300" stroke="#ddd"/><text x="{left - 8}"'
            f' y="{height(tick) + 4}" text-anchor="end">{tick}</text>'
        )
    for i, color in enumerate(_POLICIES.values()):
        runs = {
            arms: [float(n.replace(",", "")) for n in each[i].split(", ")]
            for arms, each in found.items()
            if each[i][0].isdigit()
        }
        means = (f"{at[n]} {height(sum(r) / len(r))}" for n, r in runs.items())
        lines.append(
            f'<path d="M{" L".join(means)}" fill="none" stroke="{color}"'
            ' stroke-width="2"/>'
        )
        lines += [
            f'<circle cx="{at[arms]}" cy="{height(run)}" r="4" fill="{color}"'
            ' fill-opacity="0.5"/>'
            for arms, each in runs.items()
            for run in each
        ]
        lines += [
            f'<text x="{at[arms]}" y="{top + 32}" text-anchor="middle"'
            f' fill="{color}">{each[i]}</text>'
            for arms, each in found.items()
            if each[i].startswith("over")
        ]
    return lines + [
        f'<text x="{x}" y="{top + 188}" text-anchor="middle">{arms}'
        f"{' arms' if arms == max(found) else ''}</text>"
        for arms, x in at.items()
    ]


def _baselines() -> str:
    """Return what the cards of all cooperative baselines say, in a table."""
    table = [
        "| environment | completion | performance | late | time to success | energy |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for env_id in cg.list_envs():
        if not is_shipped("baseline", env_id):
            continue
        card = shipped_file("baseline", env_id).with_suffix(".md").read_text()
        cells = {
            row[0]: [cell.partition(" (")[0] for cell in row[1].split(" | ")]
            for row in re.findall(
                r"^\| .+\(shipped\).+\| (default.*?) \| (.+) \|$", card, re.M
            )
        }
        if cells:  # Cards of games have none.
            *_, completion, performance, time = cells["default"]
            late = cells["default, late"][-3]
            energy = re.search(r"^\| energy \| ([\d.]+) J", card, re.M)
            table.append(
                f"| {env_id} | {completion} | {performance} | {late} | {time}"
                f" | {float(energy[1]):.0f} J |"
            )
    return "\n".join(table)


def _arm(robot: cg.Robot) -> str:
    """Return the section about one arm."""
    model = robot.spec().compile()
    columns = (
        "joint",
        "range, rad",
        "home, rad",
        "speed, rad/s",
        "torque, N m",
        "rotor, kg m2",
        "servo, N m/rad",
    )
    rows = [
        (
            re.sub("^joint_?|_joint$", "", joint).replace("_", " "),
            "{:.2f} to {:.2f}".format(*model.joint(joint).range),
            f"{robot.home[i]:.4g}",
            f"{robot.velocity_limits[i]:.4g}",
            f"{robot.torque_limits[i]:g}",
            f"{robot.armature[i]:.3g}",
            f"{robot.stiffness[i]:.4g}",
        )
        for i, joint in enumerate(robot.joints)
    ]
    definition = robot.model_file.with_suffix(".py").relative_to(ROOT)
    return "\n\n".join(
        (
            f"### {robot.name}",
            _picture(robot.title, f"media/robots/{robot.name}.jpg", 360),
            _first_comment(robot.model_file),
            _table(columns, rows),
            f"`{definition.as_posix()}` names the sources of these numbers.",
        )
    )


def _first_comment(path: Path) -> str:
    """Return what a model file says of itself and of its sources."""
    comment = re.search(r"<!--(.*?)-->", path.read_text(), re.S)
    assert comment is not None, f"{path} does not say where its numbers are from"
    return "\n".join(line.strip() for line in comment[1].strip().splitlines())


def _picture(title: str, path: str, width: int) -> str:
    """Return a picture of a width in pixels."""
    return f'<img src="{path}" alt="{title}" width="{width}">'


def _command_line_page() -> str:
    paragraphs = [
        "# Command line",
        "This is the help of `collaborative-gym`. `python -m collaborative_gym`"
        " is the same command, for a shell that does not find the first one.",
        "The exit status is 0 when the work is done, 1 if the machine lacks something,"
        " 2 for wrong input, 130 after Ctrl-C, 141 if nobody reads the output any more,"
        " and 143 after SIGTERM.",
        "`--json -` writes the results to standard output, and the tables to standard"
        " error.",
        "To complete commands and options, run one of these and start a new shell:",
        _COMPLETION,
        _help(),
    ]
    for command in COMMANDS:
        paragraphs += [f"## {command}", _help(command)]
    return "\n\n".join(paragraphs)


def _help(*command: str) -> str:
    """Return a command's help as a block of text."""
    text = io.StringIO()
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(_WIDTH)
    try:
        with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
            command_line(
                [*command, "--help-all" if command == ("train",) else "--help"]
            )
    finally:
        os.environ.pop("COLUMNS")
        if before is not None:
            os.environ["COLUMNS"] = before
    lines = [line.rstrip() for line in text.getvalue().strip().splitlines()]
    return "\n".join(("```text", *lines, "```"))


def _envs(task: str) -> list[tuple[str, EnvSpec]]:
    """Return the environments of a task, by id."""
    found = [(env_id, get_env(env_id)) for env_id in cg.list_envs()]
    return [(env_id, spec) for env_id, spec in found if spec.task.__name__ == task]


def _labelled(paragraph: str) -> str:
    """Return a paragraph of a docstring with its first word standing out."""
    label, colon, rest = paragraph.partition(":")
    return f"**{label}:**{rest}" if colon and label in _LABELS else paragraph


def _place(placement: cg.Placement) -> str:
    x, y, z = (f"{value + 0.0:.3g}" for value in placement.position)  # no -0
    yaw = (np.degrees(placement.yaw) + 179.0) % 360.0 - 179.0
    return f"({x}, {y}, {z}) m, turned by {yaw:.0f} degrees"


def _sizes(spaces) -> str:
    """Return the sizes of all agents' spaces, once where all are alike."""
    sizes = [str(space.shape[0]) for space in spaces.values()]
    return f"{sizes[0]} each" if len({*sizes}) == 1 else ", ".join(sizes)


def _table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table, whose cells may have links."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)


def _cell(value: object) -> str:
    return str(value).replace("|", "\\|")


_MADE = {
    "action modes": _modes,
    "arms": _arms,
    "baselines": _baselines,
    "environments": _environments,
    "grasps": _grasps,
    "films together": partial(_films, [t for t in _TASKS if t not in _AGAINST]),
    "films against": partial(_films, _AGAINST),
}
"""What is made in a page, by the name of what makes it."""

if __name__ == "__main__":
    main()
