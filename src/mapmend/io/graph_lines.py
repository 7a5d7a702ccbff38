"""Pose graphs from text: g2o's lines, TORO's, or both in one file. docs/formats.md lists fields and rules."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mapmend.errors import InputError
from mapmend.graph.checks import positive_definite
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.spanning_tree import poses_along_edges
from mapmend.io._decimals import Bool, Float, Int, Tokens, parse, tokenize, tokenize_text
from mapmend.io.laser_lines import FARTHEST_M, ROBOTLASER, LaserRows, concatenate, explain, parse_laser_lines
from mapmend.io.laser_scans import EXACT_MARK, Channel, build_scans, constant_mounting, exact_angles
from mapmend.scan import LaserGeometry, Note, Scans

MEND = "repair the line"
MOST_NAMED = 3  # nodes in a note
SEQUENTIAL_MARK, LOOP_MARK = b"#SEQUENTIAL EDGES", b"#LOOP EDGES"
# Which edges, counted from 0, are loops although their ids mean odometry, or the other way round.
OTHERWISE_MARK = b"# mapmend: edges that are loops or odometry against their ids: "
VERTEX_TAGS = (b"VERTEX_SE2", b"VERTEX2")
EDGE_TAGS = (b"EDGE_SE2", b"EDGE2")

_LASERS = {b"ROBOTLASER%d" % k: k for k in range(1, 10)}
_TAGS = {*VERTEX_TAGS, *EDGE_TAGS, *_LASERS}
_VERTEX_FIELDS = ("id", "x", "y", "theta")
_EDGE_FIELDS = ("id i", "id j", "x", "y", "theta", *(f"information entry {k}" for k in range(1, 7)))
_LASER_LINES_AT_A_TIME = 4000
# The positions of a line's six numbers in I11 I12 I13 I22 I23 I33.
_G2O_ORDER, _TORO_ORDER = (0, 1, 2, 3, 4, 5), (0, 1, 4, 2, 5, 3)


@dataclass
class _Lines:
    """Lines of one kind: the text after the keyword, and the line number; or the numbers of all lines together."""

    texts: list[bytes] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    values: Float | None = None

    def add(self, text: bytes, number: int) -> None:
        self.texts.append(text)
        self.numbers.append(number)


@dataclass
class _Content:
    vertices: _Lines = field(default_factory=_Lines)
    edges: _Lines = field(default_factory=_Lines)
    is_toro: list[bool] = field(default_factory=list)  # of the edges
    in_loop_section: list[bool] = field(default_factory=list)  # of the edges
    fixes: _Lines = field(default_factory=_Lines)
    lasers: _Lines = field(default_factory=_Lines)
    laser_channel: list[int] = field(default_factory=list)
    laser_vertex: list[int] = field(default_factory=list)  # which vertex line it follows
    otherwise: _Lines = field(default_factory=_Lines)
    exact: bool = False
    sections: bool = False


def parse_graph(data: bytes, path: str | Path) -> PoseGraph:
    """The pose graph in a g2o or TORO file already read; ``path`` is for messages. Raises InputError."""
    if not data or data.isspace():
        raise InputError(path, "the file is empty", "name a pose graph")
    content = _vertices_and_edges(data) or _sort_lines(data, path)
    if not content.vertices.numbers and not content.edges.numbers:
        what = "no 2D vertices or edges (VERTEX_SE2 or VERTEX2, EDGE_SE2 or EDGE2 lines)"
        raise InputError(path, what, "name a 2D pose graph")
    vertices = np.zeros((0, len(_VERTEX_FIELDS)))
    if content.vertices.numbers:
        vertices = _fields(content.vertices, _VERTEX_FIELDS, path)
    given = _whole(vertices[:, 0], content.vertices, path)
    _refuse_twice(given, content.vertices, path)
    named, measurements, information = _edges(content, path)
    ids, row_of_vertex, edges = _nodes(given, named)
    is_loop = loops_by_ids(ids, edges)
    if content.exact and content.sections:
        is_loop = np.array(content.in_loop_section, np.bool_)
    otherwise = _otherwise(content, len(edges), path)
    is_loop[otherwise] = ~is_loop[otherwise]
    scans, stamps = _scans(content, row_of_vertex, len(ids), path)
    fixed: tuple[int, ...] = (0,)
    if content.fixes.texts:
        fixed = tuple(sorted(set(_fixed(content, ids, path))))
    graph = PoseGraph(np.zeros((len(ids), 3)), ids, edges, measurements, information, is_loop, scans, stamps, fixed)
    graph.poses[row_of_vertex] = vertices[:, 1:]
    return graph if len(given) == len(ids) else _laid(graph, row_of_vertex)


def _laid(graph: PoseGraph, given: Int) -> PoseGraph:
    """The graph with the nodes laid along its edges that have no pose; ``given``: the rows of those that have one."""
    laid = np.ones(len(graph), np.bool_)
    laid[given] = False
    poses = poses_along_edges(graph, ~laid)
    some = ", ".join(str(name) for name in graph.ids[laid][:MOST_NAMED])
    more = " ..." if np.count_nonzero(laid) > MOST_NAMED else ""
    which = f"{np.count_nonzero(laid)} of {len(graph)} nodes ({some}{more})" if len(given) else "the nodes"
    note = Note(f"the file gives no poses of {which}: they were laid along the edges")
    return replace(graph, poses=poses, notes=(note,))


def _vertices_and_edges(data: bytes) -> _Content | None:
    """A file with only vertices and edges, as most public graphs are, read all at once; None if anything is odd.

    Errors must name the line, so odd files are left to the functions that read line by line.
    """
    tokens = tokenize_text(data if data.endswith(b"\n") else data + b"\n")
    counts = tokens.counts()
    is_vertex, is_edge = counts == 1 + len(_VERTEX_FIELDS), counts == 1 + len(_EDGE_FIELDS)
    if not (is_vertex | is_edge).all():
        return None
    for toro, tags in enumerate(zip(VERTEX_TAGS, EDGE_TAGS, strict=True)):
        if all(_have_keyword(tokens, which, tag) for which, tag in zip((is_vertex, is_edge), tags, strict=True)):
            lines = [_Lines(numbers=(1 + np.flatnonzero(which)).tolist()) for which in (is_vertex, is_edge)]
            for kind, which, names in zip(lines, (is_vertex, is_edge), (_VERTEX_FIELDS, _EDGE_FIELDS), strict=True):
                is_number = np.repeat(which, counts)
                is_number[tokens.first[:-1]] = False
                values, valid = parse(tokens, np.flatnonzero(is_number))
                if not (valid.all() and np.isfinite(values).all()):
                    return None
                kind.values = values.reshape(-1, len(names))
            edges = len(lines[1].numbers)
            return _Content(lines[0], lines[1], [bool(toro)] * edges, [False] * edges)
    return None


def _have_keyword(tokens: Tokens, which: Bool, word: bytes) -> bool:
    """Whether the lines, bool of shape (rows,), begin with that word."""
    begin = tokens.first[:-1][which]
    starts = tokens.starts[begin]
    if (tokens.ends[begin] - starts != len(word)).any():
        return False
    return all((tokens.buffer[starts + k] == character).all() for k, character in enumerate(word))


def _sort_lines(data: bytes, path: str | Path) -> _Content:
    content = _Content()
    in_loops = False
    for number, line in enumerate(data.split(b"\n"), 1):
        keyword, _, text = line.partition(b" ")
        if keyword not in _TAGS:
            # Blanks before the keyword, a tab after it, or no keyword of ours.
            words = line[:24].split(None, 1)
            if not words:
                continue
            keyword = words[0]
            text = line[line.index(keyword) + len(keyword) :]
        if keyword in VERTEX_TAGS:
            content.vertices.add(text, number)
        elif keyword in EDGE_TAGS:
            content.edges.add(text, number)
            content.is_toro.append(keyword == b"EDGE2")
            content.in_loop_section.append(in_loops)
        elif keyword in _LASERS:
            if not content.vertices.texts:
                raise InputError(path, "a scan before the first vertex", "put it after its vertex", number)
            content.lasers.add(text, number)
            content.laser_channel.append(_LASERS[keyword])
            content.laser_vertex.append(len(content.vertices.texts) - 1)
        elif keyword == b"FIX":
            content.fixes.add(text, number)
        elif line.startswith(EXACT_MARK):
            content.exact = True
        elif line.startswith(OTHERWISE_MARK):
            content.otherwise.add(line[len(OTHERWISE_MARK) :], number)
        elif line.startswith((SEQUENTIAL_MARK, LOOP_MARK)):
            in_loops, content.sections = line.startswith(LOOP_MARK), True
    return content


def _fields(lines: _Lines, names: tuple[str, ...], path: str | Path) -> Float:
    """The numbers of lines that all have the same fields, shape (k, fields)."""
    rows = _parsed(lines, names, path) if lines.values is None else lines.values
    far = (np.abs(rows[:, :5]) > FARTHEST_M).any(axis=1) if len(names) > 1 else np.zeros(len(rows), np.bool_)
    if far.any():
        what = f"a number beyond {FARTHEST_M:g} is no id, position or angle"
        raise InputError(path, what, MEND, lines.numbers[int(np.argmax(far))])
    return rows


def _parsed(lines: _Lines, names: tuple[str, ...], path: str | Path) -> Float:
    """The same from their texts."""
    tokens = tokenize(lines.texts)
    counts = tokens.counts()
    wrong = counts != len(names)
    if wrong.any():
        k = int(np.argmax(wrong))
        what = f"{counts[k]} fields after the keyword instead of {len(names)} ({' '.join(names[:3])} ...)"
        raise InputError(path, what, MEND, lines.numbers[k])
    values, valid = parse(tokens)
    wrong = ~valid | ~(np.abs(values) < np.inf)
    if wrong.any():
        k = int(np.argmax(wrong))
        word = ascii(tokens.text(k)[:24].decode("latin-1"))
        what = f"{names[k % len(names)]} is {word}, not a finite number"
        raise InputError(path, what, MEND, lines.numbers[k // len(names)])
    return values.reshape(-1, len(names))


def _whole(values: Float, lines: _Lines, path: str | Path) -> Int:
    wrong = (values != np.floor(values)) | (np.abs(values) > 2.0**53)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(path, f"the vertex id {values[k]:g} is not a whole number", MEND, lines.numbers[k])
    return values.astype(np.int64)


def _refuse_twice(ids: Int, lines: _Lines, path: str | Path) -> None:
    """Raises InputError if two vertices have the same id."""
    order = np.argsort(ids, kind="stable")
    again = np.flatnonzero(np.diff(ids[order]) == 0)
    if len(again):
        row = int(order[again + 1].min())
        first = lines.numbers[int(np.argmax(ids == ids[row]))]
        raise InputError(path, f"vertex {ids[row]} is already in line {first}", MEND, lines.numbers[row])


def _rows_of(ids: Int, wanted: Int) -> Int:
    """The rows of the wanted ids in ``ids``, with the shape of ``wanted``; -1 for an id that is not there."""
    if not len(ids):
        return np.full(wanted.shape, -1, np.int64)
    order = np.argsort(ids, kind="stable")
    place = np.minimum(np.searchsorted(ids[order], wanted), len(ids) - 1)
    rows = order[place]
    return np.where(ids[rows] == wanted, rows, -1)


def _nodes(given: Int, named: Int) -> tuple[Int, Int, Int]:
    """The ids of all nodes, the row of each vertex of the file among them, and the edges by rows.

    A node without a vertex is one that only edges name. If the vertices are sorted by their ids, such a node is
    inserted among them by its id; otherwise such nodes follow the vertices.
    """
    edges = _rows_of(given, named)
    if (edges >= 0).all():
        return given, np.arange(len(given)), edges
    others = np.unique(named[edges < 0])
    ids = np.concatenate((given, others))
    if (np.diff(given) > 0).all():
        ids = np.sort(ids)
    return ids, _rows_of(ids, given), _rows_of(ids, named)


def _edges(content: _Content, path: str | Path) -> tuple[Int, Float, Float]:
    """The ids joined, shape (m, 2), measurements and information matrices."""
    lines = content.edges
    if not lines.numbers:
        return np.zeros((0, 2), np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3))
    values = _fields(lines, _EDGE_FIELDS, path)
    named = np.column_stack([_whole(values[:, k], lines, path) for k in (0, 1)])
    itself = named[:, 0] == named[:, 1]
    if itself.any():
        k = int(np.argmax(itself))
        raise InputError(path, f"an edge from vertex {named[k, 0]} to itself", "remove the line", lines.numbers[k])
    toro = np.array(content.is_toro)
    six = np.where(toro[:, None], values[:, 5:][:, _TORO_ORDER], values[:, 5:][:, _G2O_ORDER])
    information = six[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    bad = ~positive_definite(information)
    if bad.any():
        what = "the information matrix is not positive definite"
        raise InputError(path, what, "check its order and its entries", lines.numbers[int(np.argmax(bad))])
    return named, values[:, 2:5].copy(), information


def loops_by_ids(ids: Int, edges: Int) -> Bool:
    """Which edges are loops unless a file says otherwise: neither of consecutive ids nor of neighbours in the file."""
    return (np.abs(ids[edges[:, 0]] - ids[edges[:, 1]]) != 1) & (np.abs(edges[:, 0] - edges[:, 1]) != 1)


def _otherwise(content: _Content, edges: int, path: str | Path) -> Int:
    """The edges that our own comment lists, which also holds their number."""
    named = _Lines()
    for text, number in zip(content.otherwise.texts, content.otherwise.numbers, strict=True):
        words, _, count = text.partition(b" of ")
        if count.strip() != b"%d" % edges:
            what = f"this comment counts other edges than the file's {edges}: edges were added or taken out"
            raise InputError(path, what, "remove it; then the ids decide which edges are loops", number)
        for word in words.split():
            named.add(word, number)
    if not named.texts:
        return np.zeros(0, np.int64)
    rows = _fields(named, ("edge",), path)[:, 0]
    wrong = (rows != np.floor(rows)) | (rows < 0) | (rows >= edges)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(path, f"there is no edge {rows[k]:g} among {edges}, counted from 0", MEND, named.numbers[k])
    return rows.astype(np.int64)


def _fixed(content: _Content, ids: Int, path: str | Path) -> list[int]:
    """Rows of the vertices that FIX lines name; a line may name several."""
    named = _Lines()
    for text, number in zip(content.fixes.texts, content.fixes.numbers, strict=True):
        for word in text.split():
            named.add(word, number)
    if not named.texts:
        raise InputError(path, "FIX names no vertex", MEND, content.fixes.numbers[0])
    values = _fields(named, ("id",), path)
    wanted = _whole(values[:, 0], named, path)
    rows = _rows_of(ids, wanted)
    if (rows < 0).any():
        k = int(np.argmax(rows < 0))
        what = f"FIX names vertex {wanted[k]}, which is not in the file"
        raise InputError(path, what, "add the vertex or remove the line", named.numbers[k])
    return [int(row) for row in rows]


def _scans(content: _Content, row_of_vertex: Int, nodes: int, path: str | Path) -> tuple[Scans | None, Float | None]:
    """A scan and a stamp for each node: empty and nan for nodes without one, None if the file has none at all."""
    if not content.lasers.texts:
        return None, None
    owner = row_of_vertex[np.array(content.laser_vertex)]
    twice = np.flatnonzero(np.diff(owner) == 0)
    if len(twice):
        line = content.lasers.numbers[int(twice[0]) + 1]
        raise InputError(path, "a second scan for one vertex", "leave one scan for each vertex", line)
    rows = _laser_rows(content, path)
    stamps = np.full(nodes, np.nan)
    stamps[owner] = rows.stamps_s
    known = None if np.isnan(stamps).all() else stamps
    channels = {}
    for k in np.unique(rows.channel):
        mine = rows.channel == k
        channels[int(k)] = Channel(constant_mounting(rows.robot[mine], rows.laser[mine]) or (0.0, 0.0, 0.0))
    with_readings = np.flatnonzero(rows.counts > 0)
    if not len(with_readings):
        return None, known
    if len(with_readings) < len(rows):
        rows, owner = rows.select(with_readings), owner[with_readings]
    scans = build_scans(rows, exact_angles(rows.header[:, [0, 2]]), channels, content.exact)
    return _spread(scans, owner, nodes), known


def _spread(scans: Scans, owner: Int, nodes: int) -> Scans:
    """The scans assigned to their nodes, in the order of the nodes; the other nodes have an empty scan."""
    counts = np.zeros(nodes, np.int64)
    counts[owner] = np.diff(scans.offsets)
    index = np.zeros(nodes, np.int32)
    index[owner] = scans.geometry_index
    offsets = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
    geometries: tuple[LaserGeometry, ...] = scans.geometries
    return Scans(scans.ranges_m, offsets, index, geometries)


def _laser_rows(content: _Content, path: str | Path) -> LaserRows:
    lasers, parts = content.lasers, []
    for begin in range(0, len(lasers.texts), _LASER_LINES_AT_A_TIME):
        part = slice(begin, begin + _LASER_LINES_AT_A_TIME)
        texts, numbers = lasers.texts[part], lasers.numbers[part]
        rows, odd = parse_laser_lines(ROBOTLASER, texts, numbers, content.laser_channel[part])
        if odd.bad:
            k = odd.bad[0]
            raise InputError(path, explain(ROBOTLASER, texts[k]), MEND, numbers[k])
        parts.append(rows)
    return concatenate(parts)
