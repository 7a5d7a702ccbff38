"""Occupancy maps as nav2 reads them: a PGM picture, row 0 at the top, and a YAML file with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapmend.errors import InputError
from mapmend.io._decimals import Float
from mapmend.io.files import decode, read_bytes
from mapmend.io.output import write_whole
from mapmend.maps import FREE_THRESHOLD, OCCUPIED_THRESHOLD, Image, OccupancyMap

_MOST_CELLS = 1 << 30


def write_map(folder: str | Path, grid: OccupancyMap, name: str = "map") -> None:
    """Write ``name.pgm`` and ``name.yaml`` into a folder; raises OutputError."""
    write_pgm(Path(folder) / f"{name}.pgm", grid.image[::-1])
    x, y, yaw = (float(value) for value in grid.origin)
    text = (
        f"image: {name}.pgm\nmode: trinary\nresolution: {float(grid.resolution_m)!r}\norigin: [{x!r}, {y!r}, {yaw!r}]\n"
        f"negate: 0\noccupied_thresh: {grid.occupied_threshold!r}\nfree_thresh: {grid.free_threshold!r}\n"
    )
    write_whole(Path(folder) / f"{name}.yaml", text)


def write_pgm(path: str | Path, picture: Image) -> None:
    """Write a grey picture, uint8, row 0 at the top, as binary PGM (P5); raises OutputError."""
    rows, columns = picture.shape
    write_whole(path, b"P5\n%d %d\n255\n" % (columns, rows) + np.ascontiguousarray(picture).tobytes())


def read_map(path: str | Path) -> OccupancyMap:
    """Read a map by its YAML file, with the picture beside it; raises InputError."""
    return parse_map(read_bytes(path), path)


def parse_map(data: bytes, path: str | Path) -> OccupancyMap:
    """The same for the bytes of the YAML file, already read."""
    page = _read_page(decode(data, path))
    if "image" not in page:
        raise InputError(path, "names no image", "add a line such as image: map.pgm")
    resolution = _number(page, "resolution", path)
    if not 0.0 < resolution < 1e6:
        raise InputError(path, f"resolution {resolution:g} is not a cell's size in metres", "give it as 0.05")
    origin = _origin(page.get("origin", "[0, 0, 0]"), path)
    picture = read_pgm(Path(path).parent / page["image"])
    if _number(page, "negate", path, 0.0) != 0.0:
        picture = (255 - picture).astype(np.uint8)
    image = np.ascontiguousarray(picture[::-1])
    occupied = _number(page, "occupied_thresh", path, OCCUPIED_THRESHOLD)
    return OccupancyMap(image, resolution, origin, occupied, _number(page, "free_thresh", path, FREE_THRESHOLD))


def read_pgm(path: str | Path) -> Image:
    """A grey picture, uint8, shape (rows, columns), row 0 at the top, from a PGM of kind P5 or P2."""
    return parse_pgm(read_bytes(path), path)


def parse_pgm(data: bytes, path: str | Path) -> Image:
    """The same for bytes already read; ``path`` is for messages."""
    kind = data[:2]
    if kind not in (b"P5", b"P2"):
        raise InputError(path, "is not a PGM picture", "save the map as PGM (P5 or P2)")
    (columns, rows, most), begin = _pgm_header(data, path)
    if not (0 < columns * rows <= _MOST_CELLS and 0 < most <= 255):
        raise InputError(path, f"{columns} x {rows} cells of 0..{most}", "save the map with 8 bits for each cell")
    if kind == b"P5":
        cells = np.frombuffer(data, np.uint8, offset=min(begin, len(data)))[: rows * columns]
    else:
        cells = _plain_cells(data[begin:], path)[: rows * columns]
    if len(cells) < rows * columns:
        raise InputError(path, f"ends after {len(cells)} of {rows * columns} cells", "save the map again")
    if most != 255:
        cells = np.rint(np.minimum(cells, most) * (255.0 / most)).astype(np.uint8)
    return cells.reshape(rows, columns).copy()


def _pgm_header(data: bytes, path: str | Path) -> tuple[tuple[int, int, int], int]:
    """Columns, rows, greatest value, and the start of the cells; there may be comments between any two."""
    numbers: list[int] = []
    at = 2
    while len(numbers) < 3:
        while data[at : at + 1].isspace() or data[at : at + 1] == b"#":
            line_end = data.find(b"\n", at) if data[at : at + 1] == b"#" else at
            at = (line_end if line_end >= 0 else len(data)) + 1
        end = at
        while data[end : end + 1].isdigit() and end - at < 10:
            end += 1
        if end == at:
            raise InputError(path, "the picture's header is damaged", "save the map again")
        numbers.append(int(data[at:end]))
        at = end
    return (numbers[0], numbers[1], numbers[2]), at + 1


def _plain_cells(text: bytes, path: str | Path) -> Image:
    words = b" ".join(line.split(b"#")[0] for line in text.split(b"\n")).split()
    if not all(word.isdigit() and len(word) <= 3 and int(word) <= 255 for word in words):
        raise InputError(path, "a cell is not a number from 0 to 255", "save the map again")
    return np.array([int(word) for word in words], np.uint8)


def _read_page(text: str) -> dict[str, str]:
    """The ``key: value`` lines of the YAML file; nav2 needs only these, and an origin in brackets or dashes."""
    page: dict[str, str] = {}
    last = ""
    for line in text.split("\n"):
        line = line.split(" #")[0].rstrip()  # noqa: PLW2901
        if not line or line.startswith("#"):
            continue
        if line.lstrip().startswith("- ") and last:
            page[last] = f"{page[last]} {line.lstrip()[2:]}".strip()
            continue
        key, colon, value = line.partition(":")
        if colon:
            last = key.strip()
            page[last] = value.strip().strip("\"'")
    return page


def _number(page: dict[str, str], key: str, path: str | Path, default: float | None = None) -> float:
    if key not in page and default is not None:
        return default
    try:
        value = float(page[key])
    except (KeyError, ValueError):
        raise InputError(path, f"{key} is missing or not a number", f"add a line {key}: VALUE") from None
    if not abs(value) < 1e12:
        raise InputError(path, f"{key} is {value:g}", "give a usable number")
    return value


def _origin(text: str, path: str | Path) -> tuple[float, float, float]:
    try:
        numbers: Float = np.array([float(word) for word in text.strip("[]").replace(",", " ").split()])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) not in (2, 3) or not np.all(np.abs(numbers) < 1e12):
        raise InputError(path, f"origin {text[:40]!r} is not [x, y, yaw]", "give it as [0.0, 0.0, 0.0]")
    return float(numbers[0]), float(numbers[1]), float(numbers[2]) if len(numbers) == 3 else 0.0
