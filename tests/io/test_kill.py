"""A kill at any write or rename leaves the older output or the new one, whole, and other people's files."""

import errno
import os
from functools import partial

import pytest

from mapmend.io import swap
from mapmend.io.output import finish_interrupted, write_whole
from tests.io.kills import kill_everywhere
from tests.io.test_output import put, unsupported


@pytest.fixture
def root(tmp_path):
    (tmp_path / "root").mkdir()
    return tmp_path / "root"


def add_foreign(run):
    """What other people keep in an output folder."""
    (run / "map" / "deep").mkdir(parents=True)
    (run / "notes.txt").write_text("mine")
    (run / "map" / "deep" / "mine.png").write_text("mine")
    (run / "link").symlink_to("notes.txt")


def check_folder(root, tmp_path, way, before, only_renames=False):
    run = root / "run"
    if before == "empty":
        run.mkdir()
    if before in ("older", "both"):
        put(run, "old")
    if before in ("foreign", "both"):
        add_foreign(run)
    with pytest.MonkeyPatch.context() as patch:
        if way == "rename":
            patch.setattr(swap, "exchange", unsupported)
        finish = partial(finish_interrupted, run)  # as whoever reads the folder does
        options = {"recover": finish, "only_renames": only_renames}
        assert kill_everywhere(lambda: put(run), root, tmp_path, **options) >= (4 if only_renames else 15)


@pytest.mark.parametrize("way", ["exchange", "rename"])
def test_a_folder_is_the_older_or_the_new_at_every_rename(root, tmp_path, way):
    check_folder(root, tmp_path, way, "both", only_renames=True)


@pytest.mark.slow
@pytest.mark.parametrize("before", ["nothing", "empty", "older", "foreign", "both"])
@pytest.mark.parametrize("way", ["exchange", "rename"])
def test_a_folder_is_the_older_or_the_new_at_every_change(root, tmp_path, way, before):
    check_folder(root, tmp_path, way, before)


@pytest.mark.slow
def test_a_folder_on_another_file_system_is_the_older_or_the_new(root, tmp_path, monkeypatch):
    run, rename = root / "run", os.rename

    def across(one, other):
        if str(one).startswith(f"{root}/.run.mapmend-") and str(other).startswith(f"{run}/"):
            raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))
        rename(one, other)

    monkeypatch.setattr(swap, "exchange", unsupported)
    monkeypatch.setattr(os, "rename", across)
    put(run, "old")
    add_foreign(run)
    assert kill_everywhere(lambda: put(run), root, tmp_path, recover=lambda: finish_interrupted(run)) > 15


@pytest.mark.parametrize("before", ["nothing", "older", "link"])
def test_a_file_is_the_older_or_the_new(root, tmp_path, before):
    if before == "older":
        (root / "graph.g2o").write_text("old")
    if before == "link":
        (root / "disk").mkdir()
        (root / "graph.g2o").symlink_to("disk/graph.g2o")
    assert kill_everywhere(lambda: write_whole(root / "graph.g2o", "new" * 1000), root, tmp_path) >= 5
