"""Seeded damage to short valid files: whatever comes, it is read or refused, never anything else."""

import numpy as np
import pytest

from mapmend.errors import InputError
from mapmend.io.info import describe_content
from mapmend.io.reader import read
from tests.io.samples import short_graph, short_log

SCRAPS = b"nan|inf|-1|1e400|1e12|999999999999| |\n|\x00|\xff\xfe|#|-|.|0||1_0|\r\n".split(b"|")
SCRAPS += [b"FLASER ", b"\nROBOTLASER1 ", b"VERTEX_SE2 0", b"EDGE_SE2 1 1"]
TUM = "".join(f"{k}.5 {k} 0 0 0 0 0.6 0.8\n" for k in range(4))
RELATIONS = "".join(f"{k}.5 {k + 1}.5 0.1 0.2 0 0 0 0.3\n" for k in range(4))
SAMPLES = {"log": short_log(), "graph": short_graph(), "trajectory": TUM, "relations": RELATIONS}


def _damaged(data: bytes, random: np.random.Generator) -> bytes:
    for _ in range(int(random.integers(1, 4))):
        a, b = sorted(random.integers(0, len(data) + 1, 2).tolist())
        kind = int(random.integers(0, 4))
        if kind == 0:
            data = data[:a]
        elif kind == 1:
            data = data[:a] + SCRAPS[int(random.integers(len(SCRAPS)))] + data[min(a + int(random.integers(0, 6)), b) :]
        elif kind == 2:
            data = data[:a] + data[b : b + 40] + data[a:]
        else:
            data = data[:a] + bytes(random.integers(0, 256, 3, np.uint8)) + data[a + 3 :]
    return data


@pytest.mark.parametrize("kind", SAMPLES)
@pytest.mark.parametrize("lenient", [False, True])
def test_damaged_files_are_read_or_refused(tmp_path, kind, lenient):
    random = np.random.default_rng(20260101)
    path = tmp_path / "damaged"
    messages = []
    for _ in range(400):
        path.write_bytes(_damaged(SAMPLES[kind].encode(), random))
        try:
            describe_content(read(path, lenient), path).lines()
        except InputError as error:
            messages.append(str(error))
    assert 40 < len(messages) < 400
    assert not any("\n" in message for message in messages)
