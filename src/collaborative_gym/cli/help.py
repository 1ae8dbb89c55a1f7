"""What --help prints."""

import re
import shutil
import textwrap
from functools import partial
from pathlib import Path

from collaborative_gym.cli.terminal import Watched

EXAMPLES = Path(__file__).with_name("examples.txt").read_text().splitlines()
"""Examples of the commands, with which their pages of help end."""

_HEADINGS = {
    "certify": {"episodes": "how hard it tries"},
    "train": {"total_steps": "how it learns", "device": "the machine"},
}
"""What options are about, by the first of each kind."""


def owners(kind: type) -> dict[str, type]:
    """Return where a command's options are declared, by name, its own first."""
    found: dict[str, type] = {}
    for base in kind.__mro__:
        for name in vars(base).get("__annotations__", ()):
            found.setdefault(name, base)
    return found


def finished(page: str, verb: str, kind: type, whole: bool) -> str:
    """Return the parser's page of help with filled lines, headings and examples.

    Unless it is to be `whole`, most hyperparameters of `train` are left out.
    """
    width = shutil.get_terminal_size().columns
    fill = partial(textwrap.fill, width=width, break_on_hyphens=False)
    usage, _, rest = page.partition("\n")
    unbroken = re.sub(r"(\[--\S+) ", "\\1\xa0", usage)  # an option and its value
    usage = fill(unbroken, subsequent_indent="    ").replace("\xa0", " ")
    # Sentences come in one line each, but the boxes are as wide as they should be.
    rest = re.sub("^[^╭│╰\n]+$", lambda line: fill(line[0]), rest, flags=re.M)
    values = r"\[(\w+) \[\1 \.\.\.\]\]"
    rest = re.sub(values, lambda of: f"{of[1]} ...".ljust(len(of[0])), rest)
    rest = rest.replace("{None}|STR", "HOST:PORT ").replace(
        "(default: N", "(default: n"
    )
    rest = re.sub(r"\(default: \)( {4})?", "(default: none)", rest)
    if not verb:
        return f"{usage}\n{rest}"
    shared = [n for n, base in owners(kind).items() if issubclass(Watched, base)]
    headings = dict.fromkeys(shared[:1], "environment") | _HEADINGS.get(verb, {})
    for name, heading in headings.items():
        first = rf"^(.) --{name.replace('_', '-')} "
        above = "".join(rf"\1 {line:<{width - 4}} \1\n" for line in ("", f"{heading}:"))
        rest = re.sub(first, rf"{above}\g<0>", rest, count=1, flags=re.M)
    shown = (each for each in EXAMPLES if each.split()[0] == verb)
    examples = "".join(f"  collaborative-gym {each}\n" for each in shown)
    many = re.search(r"^. --discount .*?(?=^╰|\Z)", rest, re.M | re.S)
    if many and not whole:
        names = ", ".join(re.findall("^. (--[a-z-]+)", many[0], re.M))
        rest = rest.replace(many[0], "")
        rest += f"\n{fill(f'More options, which --help-all explains: {names}.')}\n"
    return f"{usage}\n{rest}\nexamples:\n{examples}"
