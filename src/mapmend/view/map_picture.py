"""map.png: the map with trajectory, key-nodes and loop edges over it, to look at. Pillow alone, because it is fast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mapmend.maps import FREE, OCCUPIED, OccupancyMap

if TYPE_CHECKING:
    from mapmend.slam import MapResult

Float = NDArray[np.float64]
Colour = tuple[int, int, int]
Place = tuple[float, float]

MOST_PIXELS = 4000
"""No side of a picture is longer."""

WANTED_PIXELS = 1600
"""Small maps are drawn with several pixels for each cell, up to this size, so that lines over them stay thin."""

FREE_COLOUR: Colour = (255, 255, 255)
UNKNOWN_COLOUR: Colour = (222, 226, 230)
OCCUPIED_COLOUR: Colour = (33, 37, 41)
TRAJECTORY: Colour = (21, 101, 192)
KEY_NODE: Colour = (230, 119, 0)
LOOP: Colour = (201, 42, 42)
LOOP_OPACITY = 60
START: Colour = (43, 138, 62)

SMOOTHING = 2  # lines are drawn this much larger and averaged down
STRIP_PIXELS = 44
FEWEST_PIXELS = 560


@dataclass(frozen=True)
class Overlay:
    """What is drawn over a map, metres: ``trajectory`` (n, 2), ``key_nodes`` (k, 2), ``loops`` (m, 2, 2)."""

    trajectory: Float
    key_nodes: Float
    loops: Float


def draw_run(result: MapResult) -> Image.Image:
    """The picture of a result."""
    nodes = result.graph.poses[:, :2]
    loops = nodes[result.graph.edges[result.graph.is_loop]]
    overlay = Overlay(result.trajectory.poses[:, :2], nodes[result.key_nodes], loops)
    title = f"{result.method}: {len(result.trajectory)} scans, {len(nodes)} nodes"
    return draw_map(result.occupancy, overlay, title)


def draw_map(grid: OccupancyMap, overlay: Overlay, title: str = "") -> Image.Image:
    """The map with ``overlay`` over it, a scale bar and a legend below; north (the map's y) is up."""
    longest = max(grid.image.shape)
    shrink = -(-longest // (MOST_PIXELS - STRIP_PIXELS))
    grow = max(1, WANTED_PIXELS // longest) if shrink == 1 else 1
    smoothing = SMOOTHING if longest * grow <= WANTED_PIXELS else 1
    cells = shrunk(grid.image, shrink)[::-1]
    enlarge = grow * smoothing
    picture = _coloured(cells)
    picture = picture.resize((picture.width * enlarge, picture.height * enlarge), Image.Resampling.NEAREST)
    pixels_per_m = enlarge / (shrink * grid.resolution_m)
    _draw_overlay(picture, overlay, _Frame(grid.origin[0], grid.origin[1], pixels_per_m, picture.height), smoothing)
    if smoothing > 1:
        picture = picture.reduce(smoothing)
    return _with_strip(picture, pixels_per_m / smoothing, overlay, title)


@dataclass(frozen=True)
class _Frame:
    """The transformation from metres of the map to pixels."""

    x_m: float
    y_m: float
    pixels_per_m: float
    height: int

    def places(self, points: Float) -> list[Place]:
        """Points (n, 2) as Pillow takes them."""
        x = (points[:, 0] - self.x_m) * self.pixels_per_m
        y = self.height - (points[:, 1] - self.y_m) * self.pixels_per_m
        return list(zip(x.tolist(), y.tolist(), strict=True))


def shrunk(image: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """Blocks of factor x factor cells as their darkest cell, so that a wall of one cell remains."""
    if factor == 1:
        return image
    rows, columns = (-(-n // factor) * factor for n in image.shape)
    padded = np.full((rows, columns), FREE, dtype=np.uint8)
    padded[: image.shape[0], : image.shape[1]] = image
    blocks = padded.reshape(rows // factor, factor, columns // factor, factor)
    return np.asarray(blocks.min(axis=(1, 3)))


def _coloured(cells: NDArray[np.uint8]) -> Image.Image:
    palette = np.tile(np.array(UNKNOWN_COLOUR, dtype=np.uint8), (256, 1))
    palette[FREE] = FREE_COLOUR
    palette[OCCUPIED] = OCCUPIED_COLOUR
    return Image.fromarray(palette[cells])


def _draw_overlay(picture: Image.Image, overlay: Overlay, frame: _Frame, scale: int) -> None:
    # Drawn with transparency: a thousand loop edges must not hide the map.
    draw = ImageDraw.Draw(picture, "RGBA")
    for edge in overlay.loops:
        draw.line(frame.places(edge), fill=(*LOOP, LOOP_OPACITY), width=scale)
    if len(overlay.trajectory) > 1:
        draw.line(_thinned(frame.places(overlay.trajectory)), fill=TRAJECTORY, width=2 * scale, joint="curve")
    for place in frame.places(overlay.key_nodes):
        _dot(draw, place, 3.0 * scale, KEY_NODE)
    if len(overlay.trajectory):
        _dot(draw, frame.places(overlay.trajectory[:1])[0], 5.0 * scale, START)


def _thinned(places: list[Place]) -> list[Place]:
    """Without the points less than a pixel from the one before: a robot that stands still has thousands."""
    kept = places[:1]
    for x, y in places[1:-1]:
        if abs(x - kept[-1][0]) + abs(y - kept[-1][1]) >= 1.0:
            kept.append((x, y))
    return kept + places[-1:]


def _dot(draw: ImageDraw.ImageDraw, place: Place, radius: float, colour: Colour) -> None:
    x, y = place
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)


def _with_strip(picture: Image.Image, pixels_per_m: float, overlay: Overlay, title: str) -> Image.Image:
    """The picture with a strip below it: scale bar, legend, and the title if there is room."""
    width = max(picture.width, FEWEST_PIXELS)
    whole = Image.new("RGB", (width, picture.height + STRIP_PIXELS), UNKNOWN_COLOUR)
    whole.paste(picture, ((width - picture.width) // 2, 0))
    draw = ImageDraw.Draw(whole)
    top = picture.height
    draw.rectangle((0, top, width, top + STRIP_PIXELS), fill=(248, 249, 250))
    middle = top + STRIP_PIXELS // 2
    font = ImageFont.load_default(15)
    x = _scale_bar(draw, (16.0, middle), pixels_per_m, width * 0.2, font)
    for name, colour, is_dot, shown in (
        ("start", START, True, overlay.trajectory),
        ("trajectory", TRAJECTORY, False, overlay.trajectory),
        ("key-node", KEY_NODE, True, overlay.key_nodes),
        ("loop edge", LOOP, False, overlay.loops),
    ):
        if not len(shown):
            continue
        if is_dot:
            _dot(draw, (x + 7, middle), 5.0, colour)
        else:
            draw.line((x - 5, middle, x + 14, middle), fill=colour, width=3)
        draw.text((x + 20, middle), name, fill=OCCUPIED_COLOUR, font=font, anchor="lm")
        x += 20 + draw.textlength(name, font=font) + 22
    if x + draw.textlength(title, font=font) + 16 < width:
        draw.text((width - 16, middle), title, fill=OCCUPIED_COLOUR, font=font, anchor="rm")
    return whole


def _scale_bar(
    draw: ImageDraw.ImageDraw,
    place: Place,
    pixels_per_m: float,
    room: float,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
) -> float:
    """A bar of a round length that fits; returns the position of the next item."""
    lengths = [digit * 10.0**power for power in range(-2, 6) for digit in (1, 2, 5)]
    length_m = max((m for m in lengths if m * pixels_per_m <= room), default=lengths[0])
    x, y = place
    end = x + length_m * pixels_per_m
    draw.line((x, y, end, y), fill=OCCUPIED_COLOUR, width=3)
    for tick in (x, end):
        draw.line((tick, y - 6, tick, y + 6), fill=OCCUPIED_COLOUR, width=2)
    text = f"{length_m:g} m"
    draw.text((end + 10, y), text, fill=OCCUPIED_COLOUR, font=font, anchor="lm")
    return end + 10 + draw.textlength(text, font=font) + 28
