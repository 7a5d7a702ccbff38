"""All readings of a long log: in memory while they are few, then in a file without a name, from which a scan is read
when it is needed. So a bag of gigabytes needs no more memory than one of megabytes."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from threading import Lock
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mapmend.scan import LaserGeometry, Scans

MOST_IN_MEMORY = 1 << 25  # readings, 128 MB
_BLOCK = 1 << 20
_BYTES = 4

Single = NDArray[np.float32]


class Readings:
    """float32 values that are appended, and read and replaced by position."""

    def __init__(self, expected: int = 0) -> None:
        self._memory = np.empty(min(expected, MOST_IN_MEMORY), np.float32)
        self._file: IO[bytes] | None = None
        self._lock = Lock()
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def on_disk(self) -> bool:
        return self._file is not None

    def append(self, values: Single) -> None:
        """Appends values, before any are replaced; when there are too many, all go to the file."""
        if self._file is None and self._count + len(values) > MOST_IN_MEMORY:
            self._file = tempfile.TemporaryFile(prefix="mapmend.", buffering=_BLOCK * _BYTES)  # noqa: SIM115
            self._file.write(self._memory[: self._count].tobytes())
            self._memory = np.empty(0, np.float32)
        if self._file is not None:
            self._file.write(values.tobytes())
        else:
            self._make_room(len(values))
            self._memory[self._count : self._count + len(values)] = values
        self._count += len(values)

    def _make_room(self, more: int) -> None:
        if self._count + more > len(self._memory):
            grown = np.empty(self._count + max(more, self._count // 2, _BLOCK), np.float32)
            grown[: self._count] = self._memory[: self._count]
            self._memory = grown

    def read(self, begin: int, end: int) -> Single:
        """The values from ``begin`` to before ``end``: a view into memory, or a copy from the file."""
        if self._file is None:
            return self._memory[begin : min(end, self._count)]
        values = np.empty(end - begin, np.float32)
        with self._lock:
            self._file.seek(begin * _BYTES)
            values.view(np.uint8)[:] = np.frombuffer(self._file.read((end - begin) * _BYTES), np.uint8)
        return values

    def write(self, begin: int, values: Single) -> None:
        """Replaces values from ``begin`` on."""
        if self._file is None:
            self._memory[begin : begin + len(values)] = values
            return
        with self._lock:
            self._file.seek(begin * _BYTES)
            self._file.write(values.tobytes())

    def blocks(self) -> Iterator[tuple[int, Single]]:
        """Positions and values, some megabytes at a time."""
        for begin in range(0, self._count, _BLOCK):
            yield begin, self.read(begin, min(begin + _BLOCK, self._count))

    def whole(self) -> Single:
        """All values as one array; from a file, only the parts that are used come into memory."""
        if self._file is None:
            return self._memory[: self._count]
        self._file.flush()
        return np.memmap(self._file, np.float32, "r", shape=(self._count,))


@dataclass(frozen=True)
class StoredScans(Scans):
    """Scans whose readings are in a file: ``ranges_m`` is a view of it, and a scan is read when it is needed."""

    readings: Readings = field(default_factory=Readings)

    def __post_init__(self) -> None:
        """Nothing to check: every scan was checked when it was added."""

    def ranges_of(self, k: int) -> Single:
        """The readings of scan k, shape (beams,), a copy."""
        return self.readings.read(int(self.offsets[k]), int(self.offsets[k + 1]))

    def replace_ranges_of(self, k: int, ranges_m: Single) -> None:
        """Replaces the readings of scan k by the same number of others."""
        self.readings.write(int(self.offsets[k]), ranges_m)

    def blocks(self) -> Iterator[Single]:
        """All readings, some megabytes at a time."""
        for _, values in self.readings.blocks():
            yield values


def as_scans(
    readings: Readings, offsets: NDArray[np.int64], index: NDArray[np.int32], geometries: tuple[LaserGeometry, ...]
) -> Scans:
    """Scans of these readings, checked where they are in memory."""
    if readings.on_disk:
        return StoredScans(readings.whole(), offsets, index, geometries, readings)
    return Scans(readings.whole(), offsets, index, geometries)
