"""The documentation builds, and every block of code in it runs."""

import ast
import importlib.util
import os
import re
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

import collaborative_gym as cg

ROOT = Path(__file__).parents[1]

SHELL = r"""
# What a reader does once, or what another test does, is only looked at.
pip() { :; }
ssh() { :; }
sudo() { :; }
source() { :; }
python3() { [ "$*" = "-m venv .venv" ]; }
ray() { [ "$1" = start ] || [ "$1" = get-auth-token ]; }
make() { command make --dry-run --directory "$ROOT" "$@" > /dev/null; }
.venv/bin/pytest() { [ -d "$ROOT/$1" ]; }
python() {
    case "$1" in
    examples/* | benchmarks/*) [ -f "$1" ] ;;
    -m) collaborative-gym "${@:3}" ;;
    esac
}
# All else runs as it stands, but for less long.
collaborative-gym() {
    case "$1" in
    certify | reproduce) later "$@"; return ;;
    train)
        local folder=$(sed -n "s/.*--output \([^ ]*\).*/\1/p" <<< "$*")
        local named=$(grep -o "${folder:-^$}" <<< "$PAGE" | wc -l)
        if [[ "$*" = *" ray"* || $named -lt 2 ]]; then later "$@"; return; fi
        set -- "${@/#0-[0-9]/0-1}" --total-steps 8 --num-envs 2 --rollout-steps 4 \
        --minibatch-size 8 --validation-episodes 1 --validation-interval 0 ;;
    evaluate | tournament) set -- "$@" --episodes 2 ;;
    record) [[ "$*" = *--only-episodes* ]] || set -- "$@" --seconds 0.1 ;;
    report) set -- "$@" --episodes 2 --disturbed 1 --paired 1 ;;
    benchmark) set -- "$@" --num-envs 2; [ $# -gt 3 ] || set -- "$@" Poke ;;
    view | --env) view "$@"; return ;;
    esac
    "$PYTHON" -c "$QUICK" "$@"
}
# What takes long and is tested elsewhere is only parsed, all of a page at once, such as
# a training whose folder is not read again on its page.
later() { printf '%s\n' "$@" "" >> later; }
.venv/bin/collaborative-gym() { collaborative-gym "$@"; }
view() {
    : > page  # What an earlier view wrote there is no answer.
    "$PYTHON" -c "$QUICK" "$@" --port 0 >> page &
    for _ in $(seq 600); do grep -q "in a browser" page && break; sleep 0.1; done
    grep "in a browser" page
    kill -INT %1
    wait %1 || [ $? = 130 ]
}
set -m  # So that what runs beside it heeds Ctrl-C.
trap 'kill $(jobs -p) 2> /dev/null || true' EXIT  # And does not outlive a failure.
"""
"""Functions that stand in for commands while a page is run; an unknown one fails."""

QUICK = """
import sys
from collaborative_gym.__main__ import main
from collaborative_gym.tasks import registry

configure = registry._configure
registry._configure = lambda task, settings: configure(
    task, {"max_episode_steps": 4, **settings}
)
arguments = sys.argv[1:]
if arguments[0] == "--env":
    arguments[0] = "view"
if arguments[0] == "record":
    arguments += ["--size", "160", "90"]
    arguments += ["--seconds", "1"] * ("--only-episodes" not in arguments)
sys.exit(main(arguments))
"""
"""The command line, with short episodes and small, short films."""

LATER = """
from pathlib import Path
from collaborative_gym.__main__ import main
from collaborative_gym.cli.commands import Certify, Reproduce
from collaborative_gym.cli.train import Train

Train.run = Reproduce.run = Certify.run = lambda self: None
for command in Path("later").read_text().split("\\n\\n")[:-1]:
    try:
        status = main(command.split("\\n"))
    except SystemExit as end:
        status = end.code
    assert not status, command
"""
"""What only parses the commands that a page has left for later."""

IN_PYTHON = """
import os as _os
import subprocess as _subprocess
import sys as _sys
import collaborative_gym as _cg

def _shell(block):
    _subprocess.run(["bash", "-euo", "pipefail", "-c", block], check=True)

def _parse():
    if _os.path.exists("later"):
        _subprocess.run([_sys.executable, "-c", _os.environ["LATER"]], check=True)

def _few(function, number):
    def call(*given, **named):
        if number in named:
            named[number] = min(named[number], 8)
        return function(*given, **named)
    return call

_cg.make_vec = _few(_cg.make_vec, "num_envs")
_cg.evaluate = _few(_cg.evaluate, "episodes")
"""
"""What a page's script begins with; batches and evaluations are small."""


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


made_pages = load(ROOT / "docs" / "made_pages.py")
PAGES = sorted((ROOT / "docs").rglob("*.md"))
ROOT_PAGES = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG")]
MADE = [ROOT / "docs" / path for path in made_pages.pages_to_make()]
RUNNING = [
    page
    for page in (*ROOT_PAGES, *PAGES)
    if page not in MADE and "tables" not in page.parts
]


def unmade(text):
    """Return a page with blank lines in place of what is made."""
    return re.sub(
        r"<!-- made: .+? -->.*?<!-- end -->",
        lambda made: "\n" * made[0].count("\n"),
        text,
        flags=re.S,
    )


def blocks(text):
    """Return the language, first line and content of each block of code."""
    return [
        (token.info, token.map[0] + 1, token.content)
        for token in MarkdownIt().parse(text)
        if token.type == "fence"
    ]


def name(path):
    return str(path.relative_to(ROOT))


def as_script(text):
    """Return a page's blocks as one script whose lines have the page's numbers."""
    lines = [""] * (text.count("\n") + 1)
    for language, first, content in blocks(unmade(text)):
        if language == "python":
            code = content.splitlines()
            lines[first : first + len(code)] = code
        elif language == "sh":
            lines[first] = f"_shell({SHELL + content!r})"
    lines[0] = f"exec({IN_PYTHON!r})"
    return "\n".join([*lines, "_parse()"])


@pytest.fixture
def reader(tmp_path):
    """Return a function that does what a page says, in a folder of its own."""
    for folder in ("examples", "benchmarks", "constraints.txt"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    variables = {
        **os.environ,
        "PATH": "/usr/bin:/bin",
        "PYTHON": sys.executable,
        "QUICK": QUICK,
        "LATER": LATER,
        "ROOT": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "COLUMNS": "100",
    }
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        variables.pop(variable, None)

    def read(text):
        (tmp_path / "page.py").write_text(as_script(text))
        finished = subprocess.run(
            [sys.executable, "page.py"],
            cwd=tmp_path,
            env=variables | {"PAGE": text},
            capture_output=True,
            text=True,
            timeout=600,
        )
        assert finished.returncode == 0, finished.stdout + finished.stderr
        return finished.stdout

    read.folder = tmp_path
    return read


@pytest.mark.parametrize(
    "path", [p for p in RUNNING if blocks(unmade(p.read_text()))], ids=name
)
def test_every_block_of_a_page_runs(path, reader):
    if path.name == "own_task.md":
        (reader.folder / "simple_pick.py").write_text(tutorial())
    reader(path.read_text())


def test_a_block_that_fails_is_found(reader):
    page = "A page.\n\n```python\nx = 1\n```\n\n```sh\n{}\n```\n\n```python\n{}\n```\n"
    reader(page.format("collaborative-gym --version", "assert x == 1"))
    with pytest.raises(AssertionError, match=r"line 12, in <module>\n +assert x == 2"):
        reader(page.format("true", "assert x == 2"))
    for command in (
        "collaborative-gym lift",
        "collaborative-gym train --no-such-option",
        "false | true",
        "no-such-command",
    ):
        with pytest.raises(AssertionError, match="CalledProcessError"):
            reader(page.format(command, ""))


@pytest.mark.parametrize("path", RUNNING, ids=name)
def test_no_block_escapes(path):
    text = path.read_text()
    found = blocks(text)
    assert 2 * len(found) == len(re.findall(r"^ *```", text, re.M))
    for language, _, content in found:
        assert language in ("python", "sh", "text", "toml", "xml")
        if language == "toml":
            tomllib.loads(content)


def pieces(page):
    """Return what a page shows of Python files, such as `examples/it.py:1:11`."""
    return re.findall(r"^<!-- made: (\S+\.py:\d+:\d+) -->$", page.read_text(), re.M)


def tutorial():
    """Return the file that a reader of the tutorial has written."""
    shown = pieces(ROOT / "docs" / "own_task.md")
    return "\n\n".join(made_pages.python_lines(piece) for piece in shown) + "\n"


def test_the_tutorial_has_the_example_piece_by_piece():
    whole = (ROOT / "examples" / "simple_pick.py").read_text().splitlines()
    assert len(whole) <= 80
    assert [line for line in tutorial().splitlines() if line] == [
        line for line in whole if line
    ]


@pytest.mark.parametrize("piece", [p for page in PAGES for p in pieces(page)])
def test_a_piece_of_a_file_is_whole(piece):
    name, first, last = piece.split(":")
    lines = ["", *(ROOT / name).read_text().splitlines(), ""]
    assert not lines[int(first) - 1]
    assert not lines[int(last) + 1]
    shown = made_pages.python_lines(piece)
    assert re.match(r'"""|\w|    def ', shown), shown
    ast.parse(textwrap.dedent(shown))


def test_the_site_builds_and_loads_nothing_from_elsewhere(tmp_path):
    finished = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert finished.returncode == 0, finished.stderr
    pages = {path: path.read_text() for path in tmp_path.rglob("*.html")}
    assert len(pages) > 20
    for path, html in pages.items():
        loaded = re.findall(
            r'<(?:script|img|link|iframe)[^>]*(?:src|href)="(\w+:)', html
        )
        assert not loaded, f"{path.name} loads {loaded}"
    assert (tmp_path / "search" / "search_index.js").stat().st_size > 100_000
    home = pages[tmp_path / "index.html"]
    assert "javascripts/iframe-worker.js" in home
    films = re.findall(
        r'<video src="([^"]+)".* poster="([^"]+)"', pages[tmp_path / "gallery.html"]
    )
    assert len(films) == len(list(ROOT.glob("docs/media/*/*.mp4")))
    assert all((tmp_path / file).exists() for film in films for file in film)


def test_what_is_made_is_up_to_date():
    stale = [str(path) for path in made_pages.stale()]
    assert not stale, "python docs/made_pages.py writes these anew"


def test_made_pages_say_what_the_code_is():
    pages = {path: path.read_text() for path in PAGES}
    for env_id in cg.list_envs():
        listed = [text for text in pages.values() if f"\n## {env_id}\n" in text]
        assert len(listed) == 1
        env = cg.make_vec(env_id, 1, num_threads=1)
        for agent, blocks in env.observation_blocks.items():
            size = sum(block.size for block in blocks.values())
            assert f"observes {size} numbers" in listed[0]
            for block in blocks.values():
                shape = " x ".join(map(str, block.shape))
                unit = "see above" if len(block.shape) > 1 else block.unit
                assert f"| {block.name} | {shape} | {unit} |" in listed[0]
            for term in env.reward_terms[agent]:
                assert f"`{term}`" in listed[0], f"{env_id}: {term}"
    docs = ROOT / "docs"
    lift = pages[docs / "tasks" / "lift.md"]
    assert "**Success:** the pot's middle is within 0.15 m" in lift
    assert "| `picking_threshold` | greatest distance at which a grip" in lift
    assert "collaborative-gym train LiftTaskSawyers-v0 --seed" in lift
    assert "| 1 | -3.05 to 3.05 | 0 | 1.74 | 80 |" in pages[docs / "robots.md"]
    for command in made_pages.COMMANDS:
        usage = f"usage: collaborative-gym {command} "
        assert usage in pages[docs / "reference" / "command_line.md"]


def test_what_is_put_into_a_page():
    filled = made_pages.filled
    hole = "<!-- made: {} -->\nstale\n<!-- end -->"
    page = filled("a\n" + hole.format("README.md, Licence") + "\nb", "docs/page.md")
    assert page.startswith("a\n<!-- made: README.md, Licence -->\n\nApache-2.0")
    assert page.endswith("\n\n<!-- end -->\nb") and "stale" not in page
    assert filled(page, "docs/page.md") == page
    results = hole.format("README.md, Results")
    assert "](gallery.md)" in filled(results, "docs/page.md")
    assert "](../gallery.md)" in filled(results, "docs/tasks/page.md")
    with pytest.raises(KeyError):
        filled(hole.format("README.md, Nothing"), "docs/page.md")
    with pytest.raises(FileNotFoundError):
        filled(hole.format("NOTHING.md"), "docs/page.md")


def anchors(page):
    """Return the places in a page that a link can lead to."""
    titles = re.findall(
        r"^#+ (.+)$", re.sub(r"^```.*?^```", "", page, flags=re.S | re.M), re.M
    )
    plain = (re.sub(r"\]\([^)]*\)|[^\w\- ]", "", title) for title in titles)
    return {title.strip().lower().replace(" ", "-") for title in plain}


def broken_links(path):
    """Return the links and pictures of a page that lead to nothing among the files."""
    text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.S | re.M)
    links = re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'src="([^"]+)"', text)
    broken = []
    for link in links:
        file, _, anchor = link.partition("#")
        if "://" in link or link.startswith("mailto:"):
            continue
        target = (path.parent / file).resolve() if file else path
        # The site alone has a place for each name of Python.
        known = not anchor or anchor.startswith("collaborative_gym.")
        if not target.exists() or not (known or anchor in anchors(target.read_text())):
            broken.append(link)
    return broken


@pytest.mark.parametrize(
    "path", [*ROOT_PAGES, *PAGES, ROOT / "examples" / "README.md"], ids=name
)
def test_every_link_and_picture_resolves_among_the_files(path):
    assert not broken_links(path)
    assert "{ width" not in path.read_text()


def test_a_broken_link_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# A title: *it*\n[a](page.md#a-title-it) [b](no.md) [c](#none)\n")
    assert broken_links(page) == ["no.md", "#none"]


def test_the_pages_can_be_read_in_an_afternoon():
    def words(text):
        code = r"^```.*?^```"
        return len(re.findall(r"\w\S*", re.sub(code, "", text, flags=re.S | re.M)))

    written = [ROOT / "README.md", *(page for page in RUNNING if page in PAGES)]
    assert sum(words(unmade(page.read_text())) for page in written) <= 25_000
    for guide in ("training", "strangers"):
        assert words((ROOT / "docs" / f"{guide}.md").read_text()) <= 1500


def test_the_readme_can_be_read_in_minutes():
    readme = (ROOT / "README.md").read_text()
    assert len(readme.split()) <= 1500


def test_the_reference_has_every_public_name():
    text = (ROOT / "docs" / "reference" / "python.md").read_text()
    listed = re.findall(r'^- <a id="collaborative_gym\.(\w+)">', text, re.M)
    assert sorted(listed) == sorted(cg.__all__)
