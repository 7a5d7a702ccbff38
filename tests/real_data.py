"""Where the public recordings lie that some tests read."""

import os
from pathlib import Path

import pytest


def data_path(name: str) -> Path:
    """A file under the folder that MAPMEND_DATA names; skips the test where there is none."""
    folder = os.environ.get("MAPMEND_DATA")
    if not folder:
        pytest.skip("MAPMEND_DATA does not name the folder with the public recordings")
    path = Path(folder) / name
    if not path.exists():
        pytest.skip(f"{name} is not in the folder that MAPMEND_DATA names")
    return path
