"""Results as tables in Markdown, as CSV and as JSON."""

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any


def markdown_table(
    heads: Sequence[str], lines: Iterable[Sequence[str]], words: int | None = None
) -> str:
    """Return a table in Markdown, without a line's end after it.

    Args:
      heads: of the columns.
      lines: the cells of each line, which are escaped.
      words: number of the first columns, which have words; the others have numbers, at
        the right. None for words in all.
    """
    left = len(heads) if words is None else words
    rules = ["---" if i < left else "---:" for i in range(len(heads))]
    rows = (map(escaped, heads), rules, *(map(escaped, cells) for cells in lines))
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


def escaped(text: str) -> str:
    """Return a text that Markdown shows as it is, in one line and one cell of a table.

    Names may come from strangers, so tags and links do nothing. Emphasis is left.
    """
    line = " ".join(text.splitlines())
    return line.replace("|", "\\|").replace("<", "&lt;").replace("[", "\\[")


def to_csv(heads: Iterable[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return rows as CSV, with an empty cell for None and NaN."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heads, *map(without_nan, rows)])
    return text.getvalue()


def to_json(content: Any, indent: int = 2) -> str:
    """Return dataclasses, dictionaries and lists as JSON, with null for NaN."""
    return json.dumps(without_nan(content), indent=indent) + "\n"


def without_nan(value: Any) -> Any:
    """Return plain dictionaries and lists, with None for NaN and infinite numbers."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, dict):
        return {name: without_nan(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
