"""Compiled kernels are used again only while no kernel's source has changed."""

import ast
import os
import shutil
import subprocess
import sys
import time

import numba
import numpy as np
import pytest

from mapmend import kernel_cache

# The table of tiles is empty, so `cell_at` finds no cell, and the point counts as never seen. Cell 0 is free space.
JUDGE = """
import numpy as np
from mapmend.config import MatchConfig
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching.gauss_newton import SurfaceMatcher
from numba.core import event

grid = SurfaceGrid()
grid.tiles.evidence[0] = -1
compiled = []
class Listener(event.Listener):
    def on_start(self, event):
        compiled.append(event)
    def on_end(self, event):
        pass
with event.install_listener("numba:compile", Listener()):
    print(SurfaceMatcher(MatchConfig()).judge(grid, np.zeros((1, 5)), np.zeros(3)), len(compiled) > 0)
"""


@pytest.fixture
def fresh(monkeypatch):
    """Forgets the place that this process uses, before and after."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    kernel_cache.cache_folder.cache_clear()
    yield
    kernel_cache.cache_folder.cache_clear()


def judge(source):
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", JUDGE],
        env=environment | {"PYTHONPATH": str(source), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_a_changed_kernel_is_seen_by_the_kernels_of_other_files_that_call_it(tmp_path):
    shutil.copytree(kernel_cache.PACKAGE, tmp_path / "mapmend", ignore=shutil.ignore_patterns("__pycache__"))
    assert judge(tmp_path) == "(0, 0, 1) True"
    assert judge(tmp_path) == "(0, 0, 1) False"
    path = tmp_path / "mapmend/grid/_kernels.py"
    source = path.read_text()
    head = source.index('"""', source.index("def cell_at"))
    path.write_text(source[:head] + "return 0\n    " + source[head:])
    assert judge(tmp_path) == "(0, 1, 0) True"


def test_kernels_call_and_read_nothing_that_the_fingerprint_leaves_out():
    files = kernel_cache.kernel_files()
    names = {".".join(("mapmend", *path.relative_to(kernel_cache.PACKAGE).with_suffix("").parts)) for path in files}
    assert {"mapmend.grid._kernels", "mapmend.igo._kernels", "mapmend.graph._factor_kernels"} <= names
    for path in files:
        for statement in ast.walk(ast.parse(path.read_text())):
            if isinstance(statement, ast.ImportFrom) and statement.module.startswith("mapmend"):
                assert statement.module in names | {"mapmend.kernel_cache"}, f"{path} line {statement.lineno}"


def test_the_users_own_cache_folder_is_used(fresh, monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert kernel_cache.cache_folder().parent == tmp_path / "mapmend"


def test_a_package_that_cannot_be_written_keeps_its_kernels_in_the_users_cache(fresh, monkeypatch, tmp_path):
    (tmp_path / "__pycache__").touch()
    monkeypatch.setattr(kernel_cache, "PACKAGE", tmp_path)
    monkeypatch.setattr(kernel_cache, "user_folder", lambda: tmp_path / "cache")
    assert kernel_cache.cache_folder().parent == tmp_path / "cache"


def test_without_a_place_to_write_kernels_are_compiled_and_not_kept(fresh, monkeypatch, tmp_path):
    def no_home():
        raise RuntimeError

    (tmp_path / "__pycache__").touch()
    monkeypatch.setattr(kernel_cache, "PACKAGE", tmp_path)
    monkeypatch.setattr(kernel_cache, "user_folder", no_home)
    assert kernel_cache.cache_folder() is None
    doubled = kernel_cache.kernel(lambda x: x + x)
    assert doubled(2.0) == 4.0
    assert not doubled.stats.cache_path


def test_a_new_folder_removes_old_ones_but_for_the_latest_and_those_in_use(fresh, monkeypatch, tmp_path):
    now = time.time()
    ages_s = np.array([60.0, 120.0, 180.0, 240.0, 7200.0, 7300.0])
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    for k, age_s in enumerate(ages_s):
        folder = tmp_path / "mapmend" / f"{kernel_cache.PREFIX}{k}"
        folder.mkdir(parents=True)
        (folder / "used").touch()
        os.utime(folder / "used", (now - age_s, now - age_s))
    (tmp_path / "mapmend" / "notes").mkdir()
    new = kernel_cache.cache_folder()
    left = {folder.name for folder in new.parent.iterdir()}
    assert left == {new.name, "notes", *(f"{kernel_cache.PREFIX}{k}" for k in range(4))}
