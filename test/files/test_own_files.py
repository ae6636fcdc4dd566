# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files that the program writes: their permissions are those that their owner chose, and nothing else is replaced."""

import os
import stat

import pytest

from trackres_ros.files import own_files


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture(params=[0o000, 0o022, 0o027, 0o077])
def umask(request):
    result_before = os.umask(request.param)
    yield request.param
    os.umask(result_before)


def test_a_new_file_follows_the_umask_an_old_one_keeps_its_mode(tmp_path, umask):
    path = tmp_path / "file"
    own_files.write(path, b"new")
    assert mode(path) == 0o666 & ~umask
    for kept in (0o600, 0o644, 0o664, 0o755):
        path.chmod(kept)
        own_files.write(path, b"%o" % kept)
        assert (mode(path), path.read_bytes()) == (kept, b"%o" % kept)
    own_files.write(path, b"secret", is_private=True)
    assert mode(path) == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_and_the_file_it_leads_to_is_replaced(tmp_path):
    file, link = tmp_path / "folder" / "file", tmp_path / "link"
    file.parent.mkdir()
    link.symlink_to(file)
    for content in (b"first", b"second"):  # the first time it leads nowhere
        own_files.write(link, content)
        assert link.is_symlink()
        assert file.read_bytes() == content


def test_a_write_protected_file_is_not_replaced(tmp_path, monkeypatch):
    path = tmp_path / "file"
    path.write_bytes(b"old")
    monkeypatch.setattr("os.access", lambda *_: False)  # nothing is protected against root
    with pytest.raises(PermissionError, match=str(path)):
        own_files.write(path, b"new")
    assert path.read_bytes() == b"old"
