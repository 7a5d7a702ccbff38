"""Arrays and pictures as text in a page: base64, and JSON whose strings cannot become markup."""

from __future__ import annotations

import json
from base64 import b64encode
from hashlib import sha256
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from mapmend.maps import FREE, OCCUPIED, OccupancyMap
from mapmend.view.map_picture import FREE_COLOUR, OCCUPIED_COLOUR, UNKNOWN_COLOUR, shrunk

MOST_PIXELS = 16_000_000
"""Larger maps are shrunk: a browser holds four bytes for each pixel of a picture."""

_UNSAFE = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"}


def packed(values: ArrayLike, kind: str) -> dict[str, str]:
    """An array as the page's ``unpack`` takes it; ``kind``: a NumPy type, little endian in the page.

    Raises ``OverflowError`` for values that an integer type cannot hold.
    """
    given = np.asarray(values).ravel()
    array = np.ascontiguousarray(given, dtype=np.dtype(kind).newbyteorder("<"))
    if array.dtype.kind in "iu" and not np.array_equal(array, given):
        raise OverflowError(f"some of the values do not fit into {kind}")
    return {"kind": kind, "base64": b64encode(array.tobytes()).decode("ascii")}


def safe_json(values: dict[str, Any]) -> str:
    """JSON that is safe between script tags: no tag, comment or line can begin in it, whatever a name contains."""
    text = json.dumps(values, allow_nan=False, separators=(",", ":"))
    for mark, escaped in _UNSAFE.items():
        text = text.replace(mark, escaped)
    return text


def source_hash(text: str) -> str:
    """The source that a content security policy names for an inline script or style of this ``text``."""
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode('ascii')}'"


def packed_map(grid: OccupancyMap) -> dict[str, Any]:
    """The map as a PNG, the highest row first, and its place: lower left corner and size in metres."""
    rows, columns = grid.image.shape
    factor = int(np.ceil(np.sqrt(rows * columns / MOST_PIXELS)))
    cells = shrunk(grid.image, max(factor, 1))
    size_m = grid.resolution_m * max(factor, 1)
    return {
        "png": b64encode(_png(cells[::-1])).decode("ascii"),
        "x_m": float(grid.origin[0]),
        "y_m": float(grid.origin[1]),
        "width_m": cells.shape[1] * size_m,
        "height_m": cells.shape[0] * size_m,
        "cell_m": size_m,
    }


def _png(cells: NDArray[np.uint8]) -> bytes:
    """Three colours as a palette picture of few bits."""
    index = np.full(cells.shape, 1, np.uint8)
    index[cells == FREE] = 0
    index[cells == OCCUPIED] = 2
    picture = Image.fromarray(index, mode="P")
    picture.putpalette([*FREE_COLOUR, *UNKNOWN_COLOUR, *OCCUPIED_COLOUR])
    stream = BytesIO()
    picture.save(stream, format="PNG", bits=2, optimize=True)
    return stream.getvalue()
