"""Files of plain number columns: trajectories and relations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapmend.errors import InputError
from mapmend.io._decimals import Float, Int, parse, tokenize


def read_columns(data: bytes, names: tuple[str, ...], path: str | Path) -> tuple[Float, Int]:
    """The numbers, shape (n, len(names)), and their line numbers, shape (n,); `#` lines and blank ones are skipped.

    Raises InputError for an empty file, another number of fields, and fields that are not finite numbers.
    """
    texts, lines = [], []
    for number, line in enumerate(data.replace(b"\r", b"\n" if b"\n" not in data else b"").split(b"\n"), 1):
        if line and not line.isspace() and not line.lstrip().startswith(b"#"):
            texts.append(line)
            lines.append(number)
    if not texts:
        raise InputError(path, "holds no numbers", f"expected lines of {' '.join(names)}")
    tokens = tokenize(texts)
    counts = tokens.counts()
    wrong = counts != len(names)
    if wrong.any():
        k = int(np.argmax(wrong))
        what = f"{counts[k]} fields instead of {len(names)} ({' '.join(names)})"
        raise InputError(path, what, "repair the line", lines[k])
    values, valid = parse(tokens)
    wrong = ~valid | ~(np.abs(values) <= 1e15)
    if wrong.any():
        k = int(np.argmax(wrong))
        what = f"{names[k % len(names)]} is {tokens.text(k)[:24].decode('latin-1')!a}, not a usable number"
        raise InputError(path, what, "repair the line", lines[k // len(names)])
    return values.reshape(-1, len(names)), np.array(lines, np.int64)
