import os

import pytest

from collaborative_gym.files import (
    SealedRows,
    check_writable,
    read_bytes,
    read_sealed,
    replacing,
    sealed,
)
from collaborative_gym.learning.folder import claimed

CONTENT = {"name": "\u00e4", "rows": [{"done": 3, "share": 0.1}], "none": None}
ROWS = [{"steps": str(i), "return": f"-{i}.5"} | {"late": "nan"} for i in (1, 2, 3, 4)]


def test_a_full_disk_is_told_with_the_file(tmp_path):
    path = tmp_path / "notes.md"
    path.write_text("before")
    full = pytest.raises(OSError, match=f"cannot write {path}: No space left on device")
    with full, replacing(path) as partial:
        partial.write_text("half")
        with open("/dev/full", "w") as file:
            file.write("no more")
    assert path.read_text() == "before"
    assert [each.name for each in tmp_path.iterdir()] == ["notes.md"]


def test_a_file_where_a_folder_should_be_is_told(tmp_path):
    file = tmp_path / "notes.md"
    file.write_text("before")
    told = f"{file} is a file, not a folder"
    with pytest.raises(NotADirectoryError, match=told):
        check_writable(file / "table.json")
    with pytest.raises(NotADirectoryError, match=told), claimed(file):
        pass
    assert file.read_text() == "before"


def damaged(whole):
    """Yield a file's bytes with each of its bits flipped in turn."""
    for i in range(len(whole)):
        for bit in range(8):
            yield whole[:i] + bytes([whole[i] ^ 1 << bit]) + whole[i + 1 :]


def written(rows):
    lines = SealedRows(["steps", "return", "late"])
    return [lines.header.encode(), *(lines.line(row).encode() for row in rows)]


@pytest.mark.parametrize(
    ("whole", "read", "content"),
    [
        (sealed(CONTENT).encode(), read_sealed, CONTENT),
        (b"".join(written(ROWS)), SealedRows.read, ROWS),
    ],
)
def test_no_flipped_bit_changes_what_is_read(tmp_path, whole, read, content):
    path = tmp_path / "kept"
    path.write_bytes(whole)
    assert read(path, "") == content
    noticed = 0
    for spoilt in damaged(whole):
        path.write_bytes(spoilt)
        try:
            assert read(path, "write it again") == content
        except ValueError as error:
            noticed += 1
            assert "kept is damaged" in str(error) and "write it again" in str(error)
    assert noticed > 0.8 * 8 * len(whole)


def test_lines_that_are_lost_doubled_or_moved_are_noticed(tmp_path):
    path, (first, one, two, three, four) = tmp_path / "rows.csv", written(ROWS)
    for lines in (
        (first, two, three, four),
        (first, one, three, four),
        (first, one, one, two, three, four),
        (first, one, two, three, four, four),
        (first, four, three, two, one),
        (one, two, three, four),
        (first, one, two[:-3]),
        (),
    ):
        path.write_bytes(b"".join(lines))
        with pytest.raises(ValueError, match=r"rows.csv is damaged.*line \d"):
            SealedRows.read(path, "")
    path.write_bytes(first + one + two)
    assert SealedRows.read(path, "") == ROWS[:2]


def test_a_pipe_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match=r"pipe is a pipe or a device; give a file"):
        read_bytes(tmp_path / "pipe")
