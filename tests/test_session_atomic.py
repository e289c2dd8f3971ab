"""Files and folders appear whole or not at all."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from bssrdf.errors import InputError
from bssrdf.session.atomic import atomic_write, inside, replace_folder, sha256_of


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_file_is_replaced_only_when_complete(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text("old")
    with atomic_write(file) as part:
        part.write_text("new")
        assert file.read_text() == "old"
    assert file.read_text() == "new"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_failed_write_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    def write() -> None:
        with atomic_write(tmp_path / "a.txt") as part:
            part.write_text("half")
            raise error

    with pytest.raises(error):
        write()
    assert names(tmp_path) == []


def test_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    def write() -> None:
        with atomic_write(tmp_path / "none" / "a.txt") as part:
            part.write_text("x")

    with pytest.raises(InputError, match=r"a\.txt: cannot be written"):
        write()


def fill(target: Path, text: str, error: type[BaseException] | None = None) -> None:
    with replace_folder(target) as part:
        (part / text).write_text(text)
        if error:
            raise error


def test_folder_is_replaced_as_a_whole(tmp_path: Path) -> None:
    target = tmp_path / "measured"
    for text in ("first", "second"):
        fill(target, text)
        assert names(target) == [text]
        assert names(tmp_path) == ["measured"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_failed_folder_leaves_the_old_one(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "measured"
    fill(target, "first")
    with pytest.raises(error):
        fill(target, "second", error)
    assert names(target) == ["first"]
    assert names(tmp_path) == ["measured"]


def test_folder_swap_that_was_killed_half_way_is_mended(tmp_path: Path) -> None:
    target = tmp_path / "measured"
    fill(target, "first")
    target.rename(tmp_path / "measured.old")
    (tmp_path / "measured.part").mkdir()
    with pytest.raises(ValueError, match=r"^$"):
        fill(target, "second", ValueError)
    assert names(target) == ["first"]
    assert names(tmp_path) == ["measured"]


def test_sha256(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc" * 100_000)
    assert sha256_of(tmp_path / "a") == hashlib.sha256(b"abc" * 100_000).hexdigest()
    with pytest.raises(InputError, match="cannot be read"):
        sha256_of(tmp_path / "b")


def test_path_inside_a_session_that_is_itself_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert inside(tmp_path / "link", "frames/../a.tif") == tmp_path / "link" / "frames/../a.tif"
    with pytest.raises(InputError, match="outside"):
        inside(tmp_path / "link", "../other/a.tif")
