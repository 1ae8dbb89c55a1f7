"""Files that appear whole or not at all."""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


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
    """Raise unless it is a file. Who reads a pipe or a device may wait for ever.

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
    """Return what is in a file.

    Raises:
      Exception: as `check_regular` does.
      OSError: if it cannot be read.
    """
    check_regular(path)
    return Path(path).read_bytes()


def check_writable(path: str | Path) -> None:
    """Raise if no file can be written there. Its folder is made if it is missing.

    Raises:
      OSError: says why not; a file that was there before is untouched.
    """
    with _beside(Path(path)):
        pass


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it, if they are missing.

    Raises:
      OSError: if it cannot be made; says so if it is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, f"{folder} is a file, not a folder")
    folder.mkdir(parents=True, exist_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """Yield a folder, beside a file that is to be written, while the context lasts.

    If nothing can be written, this fails before the work. It is a folder rather than a
    file so that a process that still writes, as an encoder does, cannot bring the file
    back after an interruption.
    """
    with ExitStack() as stack:
        with naming(path):
            if path.exists() and not path.is_file():
                raise IsADirectoryError(errno.EISDIR, "it is a folder or a device")
            make_folder(path.parent)
            folder = stack.enter_context(
                TemporaryDirectory(
                    prefix=f".{path.stem}.",
                    suffix=".partial",
                    dir=path.parent,
                    ignore_cleanup_errors=True,
                )
            )
        yield Path(folder)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let errors name the file that the caller asked for.

    Raises:
      OSError: says that the file cannot be written, and why; its class stays the same.
    """
    try:
        yield
    except OSError as error:
        if error.errno is None:  # It has its message already.
            raise
        raise type(error)(f"cannot write {path}: {error.strerror}") from error
