"""Tables and texts in Markdown."""

from collections.abc import Iterable, Sequence


def markdown_table(
    heads: Sequence[str], lines: Iterable[Sequence[str]], words: int | None = None
) -> str:
    """Return a table in Markdown, without a line's end after it.

    Args:
      heads: of the columns.
      lines: the cells of each line, as people shall read them; see `escaped`.
      words: how many of the first columns have words; the others have numbers, at the
        right. None for words in all.
    """
    left = len(heads) if words is None else words
    rules = ["---" if i < left else "---:" for i in range(len(heads))]
    rows = (map(escaped, heads), rules, *(map(escaped, cells) for cells in lines))
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


def escaped(text: str) -> str:
    """Return a text that Markdown shows as it is, in one line and one cell of a table.

    Names may come from strangers, so tags and links are shown and do nothing. Emphasis
    is left as it is.
    """
    line = " ".join(text.splitlines())
    for sign, told in (("|", "\\|"), ("<", "&lt;"), ("[", "\\[")):
        line = line.replace(sign, told)
    return line
