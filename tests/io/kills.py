"""Kill a process with SIGKILL at each of its writes, renames and other changes to a folder, one after the other."""

import os
import shutil
import signal
import sys
from pathlib import Path

from mapmend.io import swap
from mapmend.io.staging import HIDDEN

CHANGES = {"os.rename", "os.remove", "os.link", "os.symlink", "os.mkdir", "os.rmdir", "os.chmod", "os.truncate"}
MOST_CHANGES = 2_000


class Changes:
    """Counts what a process does below ``root``, and kills it just before, and within a write, number ``last``."""

    def __init__(self, root, last, only_renames=False):
        self.root, self.last, self.count = str(root), last, 0
        self.kinds = {"os.rename"} if only_renames else CHANGES | {"open", "write", "fsync"}

    def watch(self):
        """Begin; what is watched can't be freed again, so this is for a process that ends soon."""
        sys.addaudithook(self._audit)
        write, exchange = os.write, swap.exchange

        def half_written(descriptor, data):
            if self.count + 1 == self.last and "write" in self.kinds:
                write(descriptor, data[: len(data) // 2])
            self.happens("write")
            return write(descriptor, data)

        def synced(_):
            self.happens("fsync")  # what SIGKILL leaves is in the system's memory: no disk has to be waited for

        def exchanged(one, other):
            self.happens("os.rename")
            exchange(one, other)
            self.happens("os.rename")

        os.write, os.fsync, swap.exchange = half_written, synced, exchanged

    def happens(self, kind):
        if kind not in self.kinds:
            return
        self.count += 1
        if self.count == self.last:
            os.kill(os.getpid(), signal.SIGKILL)

    def _audit(self, event, arguments):
        if event == "open" and arguments[2] is not None:
            opens_to_write = isinstance(arguments[0], str) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
            if opens_to_write and arguments[0].startswith(self.root):
                self.happens(event)
        elif event in CHANGES:
            path = os.fspath(arguments[0]) if not isinstance(arguments[0], int) else self.root
            # A name that is relative is one below a folder that rmtree holds open.
            if path.startswith(self.root) or not os.path.isabs(path):
                self.happens(event)


def run_killed(work, root, last, only_renames=False):
    """Run ``work`` in a process that is killed at its change number ``last``; whether it ended before that."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            changes = Changes(root, last, only_renames)
            changes.watch()
            work()
            code = 0
        finally:
            os._exit(code)
    status = os.waitpid(child, 0)[1]
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return False
    assert os.WEXITSTATUS(status) == 0, f"the work failed before change {last}"
    return True


def seen(root):
    """All below a folder but what is hidden: contents of files, where links lead, None for folders."""
    found = {}
    for path in sorted(Path(root).rglob("*")):
        name = path.relative_to(root)
        if any(HIDDEN.fullmatch(part) for part in name.parts):
            continue
        content = str(path.readlink()) if path.is_symlink() else None if path.is_dir() else path.read_bytes()
        found[name.as_posix()] = content
    return found


def kill_everywhere(work, root, scratch, *, plain=seen, recover=lambda: None, only_renames=False):
    """Kill ``work``, which changes ``root``, at every change: the older or the new must be there, and work again.

    ``plain``: what counts of ``root`` in comparing. ``recover``: what a reader does first. Returns how many changes
    there were; with ``only_renames``, how many renames.
    """
    older = plain(root)
    shutil.copytree(root, scratch / "older", symlinks=True)
    assert run_killed(work, root, 0)
    new = plain(root)
    assert new != older
    for last in range(1, MOST_CHANGES):
        shutil.rmtree(root)
        shutil.copytree(scratch / "older", root, symlinks=True)
        ended = run_killed(work, root, last, only_renames)
        recover()
        there = plain(root)
        assert there in (older, new), f"neither the older nor the new is there after a kill at change {last}"
        if ended:
            assert there == new
            return last - 1
        assert run_killed(work, root, 0)
        assert plain(root) == new
        assert not [path for path in Path(root).rglob(".*") if HIDDEN.fullmatch(path.name)], f"left at change {last}"
    raise AssertionError("the work does not end")
