"""Imports between the rooms (the folders and single files right under ``src/mapmend``) run in one direction.

Every import statement counts: those at the top of a module, those inside functions, and those for type checkers.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]

LEVELS = (
    {"errors", "version"},
    {"settings"},
    {"interrupts", "parallel", "geometry", "config", "scan", "maps"},
    {"trajectory", "datasets"},
    {"kernel_cache"},
    {"graph", "simulation", "evaluation"},
    {"io", "grid"},
    {"matching", "consistency"},
    {"scan_graph", "tuning"},
    {"front_end", "igo", "baselines"},
    {"slam"},
    {"view"},
    {"lab", "report", "run_folder"},
    {"compiling"},
    {"commands"},
    {"cli"},
    {"__main__", "mapmend"},
)
"""The house from the ground up; ``mapmend`` is ``__init__.py``, which hands out the public names. A room may import
rooms on lower levels alone, so two rooms on one level do not know each other."""

USE_FILE_FORMATS = {"run_folder", "report", "commands", "mapmend"}
"""No other room may import ``io``: what computes gets arrays, logs and graphs, and returns the same."""

FORMATS_KNOW = {"pose_graph", "checks", "spanning_tree"}
"""What ``io`` may import of ``graph``: the type, its checks, and what lays poses along a file's edges. No optimizer."""

PRIVATE_USERS = {
    "mapmend.grid._kernels": {
        "mapmend.matching._kernels",
        "mapmend.matching._surface_kernels",
        "mapmend.matching._uncertainty_kernels",
        "mapmend.igo._kernels",
        "mapmend.baselines._filter_kernels",
        "mapmend.baselines._map_kernels",
        "mapmend.baselines.particle_maps",
    },
    "mapmend.matching._kernels": {"mapmend.baselines._filter_kernels", "mapmend.baselines.follower"},
    "mapmend.grid._projection_kernels": {"mapmend.scan_graph.points"},
    "mapmend.matching._surface_kernels": {"mapmend.igo._kernels", "mapmend.baselines._filter_kernels"},
}
"""Modules whose name begins with an underscore, and who may import them from another room: kernels call the kernels
that look up a cell and match a point, which Numba inlines; points are made by the grid's own projection."""

IMPORT_BY_TEXT = {"mapmend", "mapmend.cli"}
"""The modules that may import by text (``import_module``), which this test cannot follow: the public names and the
commands, loaded when they are used."""


class Import(NamedTuple):
    """``by`` imports ``what``, both modules; ``at_once``: as soon as ``by`` is imported, and not for types alone."""

    by: str
    what: str
    at_once: bool


@pytest.fixture(scope="module")
def sources() -> dict[str, str]:
    """The text of every module, by its full name."""
    folder = ROOT / "src"
    names = {path: path.relative_to(folder).with_suffix("").as_posix() for path in (folder / "mapmend").rglob("*.py")}
    return {name.removesuffix("/__init__").replace("/", "."): path.read_text() for path, name in names.items()}


def imports_of(sources: dict[str, str]) -> list[Import]:
    return [found for name, text in sources.items() for found in _walk(name, ast.parse(text), True, set(sources))]


def _walk(name: str, node: ast.AST, at_once: bool, known: set[str]) -> Iterator[Import]:
    if isinstance(node, ast.Import | ast.ImportFrom):
        for what in _targets(node, known):
            yield Import(name, what, at_once)
    later = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
    later |= isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    for child in ast.iter_child_nodes(node):
        yield from _walk(name, child, at_once and not later, known)


def _targets(node: ast.Import | ast.ImportFrom, known: set[str]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        names = [(alias.name, alias.name) for alias in node.names]
    else:
        assert node.level == 0, "relative imports are not followed; name the module in full"
        names = [(f"{node.module}.{alias.name}", str(node.module)) for alias in node.names]
    for full, module in names:
        if module.split(".")[0] == "mapmend":
            yield full if full in known else module


def room_of(module: str) -> str:
    return module.split(".")[1] if "." in module else module


def wrong_ways(imports: list[Import]) -> list[str]:
    """Imports of a room on the same level or above."""
    level = {room: k for k, rooms in enumerate(LEVELS) for room in rooms}
    unknown = sorted({room_of(m) for one in imports for m in one[:2]} - set(level))
    assert not unknown, f"LEVELS does not say where {unknown} stands"
    pairs = [(one, room_of(one.by), room_of(one.what)) for one in imports]
    return [f"{one.by} imports {one.what}" for one, by, what in pairs if by != what and level[by] <= level[what]]


def circles(imports: list[Import]) -> list[str]:
    """The modules that import themselves over others while they are being imported."""
    next_of: dict[str, set[str]] = {}
    for one in imports:
        if one.at_once:
            next_of.setdefault(one.by, set()).add(one.what)
    found = []
    for start in sorted(next_of):
        reached, waiting = set(), [start]
        while waiting:
            new = next_of.get(waiting.pop(), set()) - reached
            reached |= new
            waiting += new
        if start in reached:
            found.append(start)
    return found


def trespasses(imports: list[Import]) -> list[str]:
    """Imports of another room's private modules by those who may not."""
    found = []
    for by, what, _ in imports:
        is_private = any(part.startswith("_") and not part.startswith("__") for part in what.split("."))
        if is_private and room_of(by) != room_of(what) and by not in PRIVATE_USERS.get(what, ()):
            found.append(f"{by} imports {what}")
    return found


def test_no_room_imports_a_room_beside_or_above_it(sources):
    assert wrong_ways(imports_of(sources)) == []


def test_no_modules_import_each_other_in_a_circle(sources):
    assert circles(imports_of(sources)) == []


def test_private_modules_are_imported_by_their_room_and_the_users_named_here(sources):
    imports = imports_of(sources)
    assert trespasses(imports) == []
    unused = {(what, by) for what, users in PRIVATE_USERS.items() for by in users} - {(i.what, i.by) for i in imports}
    assert not unused, "PRIVATE_USERS names users that there are no more"


def test_what_computes_knows_no_file_formats(sources):
    imports = imports_of(sources)
    assert [i for i in imports if room_of(i.what) == "io" and room_of(i.by) not in {"io", *USE_FILE_FORMATS}] == []
    of_graph = {i.what.split(".")[2] for i in imports if room_of(i.by) == "io" and room_of(i.what) == "graph"}
    assert of_graph == FORMATS_KNOW


def test_only_public_names_and_commands_are_imported_by_text(sources):
    assert {name for name, text in sources.items() if re.search(r"import_module|__import__", text)} <= IMPORT_BY_TEXT


def test_the_layout_in_the_docs_is_this_one():
    text = (ROOT / "docs" / "architecture.md").read_text().split("## Layout")[1].split("\n## ")[0]
    first_columns = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    rooms = [name for column in first_columns for name in re.findall(r"`(\w+)(?:\.py|/)`", column)]
    level = {room: k for k, rooms_of_one in enumerate(LEVELS) for room in rooms_of_one}
    assert [level[room] for room in rooms] == sorted(level[room] for room in rooms)
    assert set(level) - set(rooms) == {"__main__", "mapmend"}


@pytest.mark.parametrize(
    "text",
    [
        "from mapmend.igo import wheels",
        "import mapmend.igo.wheels",
        "def late():\n    from mapmend.slam import build_map",
        "if TYPE_CHECKING:\n    from mapmend.commands.map import run",
        "class Late:\n    def step(self):\n        import mapmend.front_end.builder as builder",
    ],
)
def test_an_import_beside_or_above_is_seen_wherever_it_stands(text):
    sources = {"mapmend.front_end.state": "", "mapmend.igo.wheels": "", "mapmend.baselines.gmapping": text}
    assert len(wrong_ways(imports_of(sources))) == 1
    downwards = {"mapmend.slam": text.replace("slam", "matching").replace("commands", "grid")}
    assert wrong_ways(imports_of(downwards)) == []


def test_a_circle_is_seen_and_an_import_that_waits_is_none():
    sources = {
        "mapmend.grid.a": "from mapmend.grid import b",
        "mapmend.grid.b": "from mapmend.grid.c import thing",
        "mapmend.grid.c": "try:\n    import mapmend.grid.a\nexcept ImportError:\n    pass",
        "mapmend.grid.d": "from mapmend.grid import a",
    }
    assert circles(imports_of(sources)) == ["mapmend.grid.a", "mapmend.grid.b", "mapmend.grid.c"]
    sources["mapmend.grid.c"] = "def thing():\n    import mapmend.grid.a"
    assert circles(imports_of(sources)) == []


def test_the_private_module_of_another_room_is_seen():
    sources = {"mapmend.grid._kernels": "", "mapmend.grid.surface": "from mapmend.grid import _kernels"}
    assert trespasses(imports_of(sources)) == []
    sources["mapmend.front_end.tracking"] = "from mapmend.grid._kernels import cell_at"
    assert trespasses(imports_of(sources)) == ["mapmend.front_end.tracking imports mapmend.grid._kernels"]
