"""Files that appear whole or not at all, and with digests that show damage."""

import csv
import errno
import json
import os
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

DIGEST = "digest"
"""Name of the digest's entry in a JSON file, and of its column in a CSV file."""


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a path to write to. Its file replaces `path` when the context ends.

    After an error or Ctrl-C nothing is left of it, and a file that was at `path` before
    is untouched. The file's folder is made if it is missing.

    Raises:
      OSError: if it cannot be written, as on a full disk; names it.
    """
    path = Path(path)
    with _beside(path) as folder:
        try:
            yield folder / path.name
        except OSError as error:
            # Errors of a write name no file; errors about another file do.
            if error.filename is None:
                with naming(path):
                    raise
            raise
        with naming(path):
            os.replace(folder / path.name, path)


def check_regular(path: str | Path) -> None:
    """Raise unless it is a file; a reader of a pipe or a device may wait for ever.

    Raises:
      FileNotFoundError: if there is nothing.
      IsADirectoryError: if it is a folder.
      ValueError: if it is neither a file nor a folder.
    """
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise ValueError(f"{path} is a pipe or a device; give a file")


def read_bytes(path: str | Path) -> bytes:
    """Return the content of a file, checked by `check_regular`."""
    check_regular(path)
    return Path(path).read_bytes()


def check_writable(path: str | Path) -> None:
    """Raise OSError if no file can be written there, and say why.

    Its folder is made if it is missing. A file that was there before is untouched.
    """
    with _beside(Path(path)):
        pass


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it, if they are missing.

    Raises:
      OSError: if it cannot be made, as where it is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, f"{folder} is a file, not a folder")
    folder.mkdir(parents=True, exist_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def sealed(content: Mapping[str, Any], indent: int | None = 2) -> str:
    """Return content as JSON with a digest of itself; `indent` None for one line."""
    whole = {**content, DIGEST: _digest(content)}
    return json.dumps(whole, indent=indent) + "\n"


def read_sealed(path: Path, remedy: str) -> dict[str, Any]:
    """Return the content of a file that `sealed` wrote.

    Raises:
      OSError: if it cannot be read.
      ValueError: if it is damaged or has no digest; names it, and the remedy.
    """
    text = read_bytes(path)
    try:
        content = json.loads(text)
        own = content.pop(DIGEST, None)
    except Exception as error:  # A file may be spoilt in any way.
        raise _damaged(path, "it is not what was written", remedy) from error
    if own is None:
        raise _damaged(path, "it has no digest", remedy)
    if own != _digest(content):
        raise _damaged(path, "its content does not match its digest", remedy)
    return content


class SealedRows:
    """Lines of a CSV file that each have a digest of themselves and those before.

    So lines can be appended one by one, and none but the last ones can be lost, doubled
    or moved unseen. The digest is a number, like the other cells.
    """

    def __init__(self, columns: Iterable[str]):
        self.columns = tuple(columns)
        self._last = 0

    @property
    def header(self) -> str:
        """The first line."""
        return _line([*self.columns, DIGEST])

    def line(self, cells: Mapping[str, str]) -> str:
        """Return the next line, of cells by column; one without a cell stays empty."""
        self._last = self._next(cells)
        own = [cells.get(name, "") for name in self.columns]
        return _line([*own, str(self._last)])

    def _next(self, cells: Mapping[str, str]) -> int:
        # A float holds 53 bits exactly, where somebody reads all columns as numbers.
        given = {name: cell for name, cell in cells.items() if cell}
        return int(_digest([self._last, given])[:13], 16)

    @classmethod
    def read(cls, path: Path, remedy: str) -> list[dict[str, str]]:
        """Return the cells of a file's lines, without the empty ones.

        Raises:
          OSError: if it cannot be read.
          ValueError: if it is damaged or has no digests; names it, line and remedy.
        """
        text, found = read_bytes(path), []
        lines = StringIO(text.decode(errors="replace"), newline="")
        reader = csv.DictReader(lines, strict=True)
        try:
            *columns, last = reader.fieldnames or [""]
            if last != DIGEST:
                raise ValueError("it has no digests")
            rows = cls(columns)
            for row in reader:
                if None in row or None in row.values():
                    raise ValueError("it has more or fewer cells than the first line")
                own = row.pop(DIGEST)
                cells = {name: cell for name, cell in row.items() if cell}
                rows._last = rows._next(cells)
                if str(rows._last) != own:
                    raise ValueError("its content does not match its digest")
                found.append(cells)
            if not text.endswith(b"\n"):
                raise ValueError("it does not end")
        except (csv.Error, ValueError) as error:
            what = f"line {max(reader.line_num, 1)}: {error}"
            raise _damaged(path, what, remedy) from error
        return found


def _digest(content: Any) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return sha256(text.encode()).hexdigest()


def _line(cells: Iterable[str]) -> str:
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def _damaged(path: Path, what: str, remedy: str) -> ValueError:
    return ValueError(f"{path} is damaged, or of an earlier version ({what}); {remedy}")


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """Yield a folder, beside a file that is to be written, while the context lasts.

    If nothing can be written, this fails before the work. In a folder, a process that
    still writes, as an encoder does, cannot bring the file back after an interruption.
    """
    with naming(path):
        if path.exists() and not path.is_file():
            raise IsADirectoryError(errno.EISDIR, "it is a folder or a device")
        make_folder(path.parent)
        name = f".{path.stem}."
        made = TemporaryDirectory(
            ".partial", name, path.parent, ignore_cleanup_errors=True
        )
    with made as folder:
        yield Path(folder)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let errors say that a file cannot be written, and why; their class stays."""
    try:
        yield
    except OSError as error:
        if error.errno is None:  # It has its message already.
            raise
        raise type(error)(f"cannot write {path}: {error.strerror}") from error
