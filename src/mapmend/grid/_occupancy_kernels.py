"""The kernel that counts beams for the occupancy map. Its plain twin is in tests/reference."""

from __future__ import annotations

from mapmend.kernel_cache import kernel


@kernel
def count_beams(scans, directions, lasers, frame, first_row, counts):
    """Counts the returns and passes of every beam in the rows of a map from ``first_row`` on.

    ``scans`` = (ranges float32 (total,), offsets int64 (n + 1,), laser number int32 (n,)). ``directions``: (lasers,
    beams, 2), unit vectors in the laser's frame. ``lasers``: (n, 4), x, y, cos, sin of the laser in the map.
    ``frame``: a `MapFrame`. ``counts``: int32, (2, rows, columns), returns and passes, for cells ``first_row`` to
    ``first_row + rows - 1``.

    A beam passes the cells of the straight line from the laser's cell up to its return's: step k of n along the longer
    axis is ``round(k * shorter / n)`` along the other. So any step can be computed without the steps before it, and a
    beam takes no time in other rows. A reading beyond the longest range passes up to it and does not return; one that
    is not finite (no return, unusable) is not counted.
    """
    ranges, offsets, laser_number = scans
    size, shortest, longest = frame.cell_size_m, frame.shortest_m, frame.longest_m
    last_row = first_row + counts.shape[1] - 1
    reach = int(longest / size) + 2
    for k in range(lasers.shape[0]):
        x, y, cos, sin = lasers[k, 0], lasers[k, 1], lasers[k, 2], lasers[k, 3]
        column, row = int((x - frame.left_m) / size), int((y - frame.bottom_m) / size)
        if row + reach < first_row or row - reach > last_row:
            continue
        for beam in range(offsets[k + 1] - offsets[k]):
            reading = float(ranges[offsets[k] + beam])
            # Infinity (no return) fails the second comparison, nan (unusable) the first.
            if not (shortest <= reading < 1e30):
                continue
            length = min(reading, longest)
            dx, dy = directions[laser_number[k], beam, 0], directions[laser_number[k], beam, 1]
            end_column = int((x + length * (cos * dx - sin * dy) - frame.left_m) / size)
            end_row = int((y + length * (sin * dx + cos * dy) - frame.bottom_m) / size)
            across, up = abs(end_column - column), abs(end_row - row)
            to_right, to_top = (1 if end_column > column else -1), (1 if end_row > row else -1)
            steps = max(across, up)
            # The steps within this band of rows: rows go from ``row`` to ``end_row`` in one direction.
            lowest = (first_row - row) if to_top > 0 else (row - last_row)
            highest = (last_row - row) if to_top > 0 else (row - first_row)
            if highest < 0 or lowest > up:
                continue
            first = 0 if lowest <= 0 else (steps * (2 * lowest - 1) + 2 * up - 1) // (2 * up)
            end = steps if highest >= up else (steps * (2 * highest + 1) + 2 * up - 1) // (2 * up)
            across_rest, up_rest = 2 * first * across + steps, 2 * first * up + steps
            c = column + to_right * (across_rest // (2 * steps)) if steps else column
            r = row + to_top * (up_rest // (2 * steps)) if steps else row
            across_rest, up_rest = (across_rest % (2 * steps), up_rest % (2 * steps)) if steps else (0, 0)
            for _ in range(first, end):
                counts[1, r - first_row, c] += 1
                across_rest += 2 * across
                up_rest += 2 * up
                if across_rest >= 2 * steps:
                    across_rest -= 2 * steps
                    c += to_right
                if up_rest >= 2 * steps:
                    up_rest -= 2 * steps
                    r += to_top
            if reading <= longest and first_row <= end_row <= last_row:
                counts[0, end_row - first_row, end_column] += 1
