import pytest

from collaborative_gym.files import check_writable, replacing
from collaborative_gym.learning.folder import claimed


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
