"""Tests that files are written completely or not at all, even if writing fails half way."""

from pathlib import Path

import pytest

from goalward import Error
from goalward.replacing import new_file


@pytest.mark.parametrize("failure", [OSError("no room on the disk"), Error("the source is damaged")])
def test_nothing_is_left_of_a_file_that_fails_half_way(tmp_path: Path, failure: Exception) -> None:
    with pytest.raises(Error, match=str(failure)), new_file(tmp_path / "file", overwrite=False) as file:
        file.write(b"half")
        raise failure
    assert list(tmp_path.iterdir()) == []


def test_the_file_before_stays_when_its_successor_fails(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("before")
    with pytest.raises(Error, match="no room"), new_file(path, overwrite=True) as file:
        file.write(b"half")
        raise OSError("no room")
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]
