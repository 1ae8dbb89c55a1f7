"""Tables of the documentation that grow row by row.

Their numbers are in docs/tables/NAME.json, from which docs/tables/NAME.md is written.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from collaborative_gym.files import read_sealed, sealed, write_text

_TITLES = {
    "advised": "Cross-play of policies that learned with advice",
    "crossplay": "Cross-play of the shipped policies",
    "egos": "Egos and their partners",
    "populations": "What partners taught",
    "robustness": "Each disturbance alone",
    "seeds": "Many seeds",
    "strain": "Strain",
}

_TABLES = Path(__file__).parents[1] / "docs" / "tables"


def keep(
    name: str, keys: Sequence[str], row: Any, page: Callable[[dict[str, Any]], str]
) -> None:
    """Put a row into a table, in place of the one that it had, and write the page anew.

    Args:
      name: of the table.
      keys: where the row belongs, such as environment and seed.
      row: its numbers.
      page: returns the page, as Markdown, from all numbers.
    """
    path = _TABLES / f"{name}.json"
    remedy = "fetch it again from the repository"
    numbers = read_sealed(path, remedy) if path.exists() else {}
    rows = numbers
    for key in keys[:-1]:
        rows = rows.setdefault(key, {})
    rows[keys[-1]] = row
    write_text(path, sealed(numbers, indent=1))
    write_text(path.with_suffix(".md"), f"# {_TITLES[name]}\n\n{page(numbers)}")
