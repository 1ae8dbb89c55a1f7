"""Tables of the documentation that grow row by row.

Their numbers are in docs/tables/NAME.json, from which docs/tables/NAME.md is written.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

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
    numbers = json.loads(path.read_text()) if path.exists() else {}
    rows = numbers
    for key in keys[:-1]:
        rows = rows.setdefault(key, {})
    rows[keys[-1]] = row
    path.write_text(json.dumps(numbers, indent=1) + "\n")
    path.with_suffix(".md").write_text(page(numbers))
