import pytest

from collaborative_gym.files import replacing


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
