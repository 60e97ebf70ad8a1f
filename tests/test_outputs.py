"""One policy for outputs: never what is read, nothing silently, whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from tiny_disk import tiny_disk

from skewmi.errors import ConfigurationError, OutputError
from skewmi.outputs import check_output, make_folder, sync, written_aside

SPELLINGS: dict[str, Callable[[Path], Path]] = {
    "same": lambda file: file,
    "dot": lambda file: file.parent / "." / file.name,
    "up and down": lambda file: file.parent / ".." / file.parent.name / file.name,
    "relative": lambda file: Path(os.path.relpath(file)),
    "link": lambda file: _link(file, Path.symlink_to),
    "link to a link": lambda file: _link(_link(file, Path.symlink_to), Path.symlink_to),
    "hard link": lambda file: _link(file, Path.hardlink_to),
    "through a linked folder": lambda file: _linked_folder(file),
}


def _link(file: Path, make: Callable[[Path, Path], None]) -> Path:
    link = file.with_name(f"{file.name}.link")
    make(link, file)
    return link


def _linked_folder(file: Path) -> Path:
    folder = file.parent.with_name("linked")
    folder.symlink_to(file.parent)
    return folder / file.name


@pytest.fixture
def file(tmp_path: Path) -> Path:
    folder = tmp_path / "folder"
    folder.mkdir()
    path = folder / "input"
    path.write_bytes(b"precious")
    return path


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_what_is_read_is_never_replaced(file: Path, spelling: str) -> None:
    output = SPELLINGS[spelling](file)
    with pytest.raises(OutputError, match="this command needs"):
        check_output(output, overwrite=True, inputs=[None, file])
    with pytest.raises(OutputError, match="this command needs"):
        check_output(file, overwrite=True, inputs=[output])


def test_two_outputs_of_one_name_are_refused_before_they_exist(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="this command needs"):
        check_output(tmp_path / "a" / ".." / "b", overwrite=True, inputs=[tmp_path / "b"])


def test_what_exists_is_replaced_only_when_asked(file: Path) -> None:
    with pytest.raises(OutputError, match="--overwrite"):
        check_output(file, overwrite=False)
    check_output(file, overwrite=True)
    assert file.read_bytes() == b"precious"


def test_folders_are_made(tmp_path: Path) -> None:
    check_output(tmp_path / "a" / "b" / "c.txt", overwrite=False)
    assert (tmp_path / "a" / "b").is_dir()
    assert not (tmp_path / "a" / "b" / "c.txt").exists()


@pytest.mark.parametrize("place", ["/dev/full", "/dev/null", "/proc/none/a", "/"])
def test_devices_and_folders_are_no_files(place: str) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        check_output(Path(place), overwrite=True)
    if place.startswith("/dev"):
        assert stat.S_ISCHR(Path(place).stat().st_mode)


def test_link_keeps_pointing_at_the_new_file(file: Path) -> None:
    link = _link(file, Path.symlink_to)
    check_output(link, overwrite=True)
    with written_aside(link) as draft:
        draft.write_bytes(b"new")
    assert link.is_symlink()
    assert file.read_bytes() == b"new"


def test_file_that_fails_leaves_the_old_one(file: Path) -> None:
    def fail() -> None:
        with written_aside(file) as draft:
            draft.write_bytes(b"half")
            raise ValueError

    with pytest.raises(ValueError):
        fail()
    assert file.read_bytes() == b"precious"
    assert [path.name for path in file.parent.iterdir()] == ["input"]


@pytest.mark.parametrize("name", ["n" * 255, "n" * 251 + ".gif", "ö" * 127, "n." + "n" * 253])
def test_the_longest_name_can_be_written(tmp_path: Path, name: str) -> None:
    with written_aside(tmp_path / name) as draft:
        draft.write_bytes(b"whole")
        assert name[-4:] != ".gif" or draft.suffix == ".gif"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_two_long_names_have_drafts_of_their_own(tmp_path: Path) -> None:
    with (
        written_aside(tmp_path / ("n" * 250 + "1.gif")) as first,
        written_aside(tmp_path / ("n" * 250 + "2.gif")) as second,
    ):
        first.write_bytes(b"1")
        second.write_bytes(b"2")
    assert sorted(path.read_bytes() for path in tmp_path.iterdir()) == [b"1", b"2"]


def test_full_disk_is_told_with_its_place(tmp_path: Path) -> None:
    with tiny_disk(tmp_path / "disk") as disk:
        target = disk / "film.gif"
        target.write_bytes(b"old")

        def fill() -> None:
            with written_aside(target) as draft:
                assert draft.suffix == ".gif"
                draft.write_bytes(bytes(200_000))

        with pytest.raises(OutputError, match="No space left") as caught:
            fill()
        assert str(target) in str(caught.value)
        assert "make room" in str(caught.value)
        assert [path.name for path in disk.iterdir()] == ["film.gif"]
        assert target.read_bytes() == b"old"


def test_folder_that_cannot_be_synced_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, answers = os.fsync, [errno.EINVAL, errno.ENOTSUP, errno.EBADF]

    def refuse(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(answers[0], os.strerror(answers[0]))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", refuse)
    while len(answers) > 1:
        sync(tmp_path)
        with written_aside(tmp_path / "a") as draft:
            draft.write_bytes(b"x")
        answers.pop(0)
    answers[0] = errno.EIO  # the disk is broken: that matters
    with pytest.raises(OSError, match="Input/output"):
        sync(tmp_path)


def test_errors_are_of_the_users_making(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="is a file"):
        make_folder(tmp_path / "file" / "below")
