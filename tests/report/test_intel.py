"""The report of a real log: its size, and the time until it is shown."""

import statistics

import pytest

from mapmend.cli import main
from tests.real_data import data_path

MOST_BYTES, MOST_MS = 8_000_000, 2_000


@pytest.mark.slow
def test_intels_report_is_small_and_opens_soon(browser, tmp_path):
    log = data_path("logs/intel.clf.bz2")
    assert main(["map", str(log), "-o", str(tmp_path / "intel")]) == 0
    assert main(["report", str(tmp_path / "intel")]) == 0
    path = tmp_path / "intel" / "report.html"
    assert path.stat().st_size < MOST_BYTES
    opened = [float(browser.open(path).js("return document.documentElement.dataset.ready")) for _ in range(5)]
    assert statistics.median(opened) < MOST_MS
    assert browser.complaints() == []
