"""ROS bags beside the CARMEN log: the time of `map`, and its memory for bags of a gigabyte.

The bags are made by children (`_make_bag.py`): see `_measure.py` for why this process stays small.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from _measure import MAPMEND, Run, data_parser, log_path, markdown, medians, run

HEAD = ("what", "size [MB]", "runs", "wall [s]", "CPU [s]", "peak memory [MB]")
SPEED = {"intel, MCAP": "intel.mcap", "intel, sqlite3": "intel_sqlite3"}
MEMORY = {"intel and a camera": "camera", "one lap with long stops, scans of 1,081 beams": "stops"}


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument("--what", choices=("speed", "memory"), default="speed")
    parser.add_argument("--runs", type=int, default=3, metavar="N", help="runs of each, in turns (default: 3)")
    parser.add_argument("--gigabytes", type=float, default=1.0, metavar="N", help="size of the large bags (default: 1)")
    options = parser.parse_args()
    log = log_path(options.data, "intel")
    maker = str(Path(__file__).with_name("_make_bag.py"))
    with tempfile.TemporaryDirectory() as folder:
        files = {"intel, CARMEN": log} if options.what == "speed" else {}
        for name, bag in (SPEED if options.what == "speed" else MEMORY).items():
            files[name] = Path(folder) / bag
            run([sys.executable, maker, str(log), str(files[name]), str(options.gigabytes)])
        runs: dict[str, list[Run]] = {name: [] for name in files}
        for _ in range(options.runs):
            for name, file in files.items():
                runs[name].append(run([MAPMEND, "map", str(file), "-o", f"{folder}/run"]))
        print(markdown(HEAD, [_row(name, files[name], runs[name]) for name in files]))


def _row(name: str, file: Path, runs: list[Run]) -> tuple[str, ...]:
    size = sum(part.stat().st_size for part in (file.iterdir() if file.is_dir() else [file]))
    middle = medians(runs)
    figures = (f"{middle.wall_s:.2f}", f"{middle.cpu_s:.2f}", f"{middle.peak_mb:.0f}")
    return (name, f"{size / 1e6:.0f}", str(len(runs)), *figures)


if __name__ == "__main__":
    main()
