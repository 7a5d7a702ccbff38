"""Whether time and memory grow in proportion to the log: a log once, and twice over.

The second pass repeats the first, with its stamps shifted behind the first's. Between the two the robot is carried from
the end of the drive to its start. The odometry of that jump is

    told   the real motion, from the map of one pass (the default)
    raw    the difference of the recording's odometry, which has drifted far by then

The errors over the relations of both passes show the result of the front end. The row "nothing" is a process that only
imports what `map` does.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import tempfile
from pathlib import Path

from _measure import MAPMEND, Run, data_parser, log_path, markdown, medians, relations_path, run

SEAMS = ("told", "raw")
PAUSE_S = 10.0
HEAD = ("log", "scans", "wall [s]", "CPU [s]", "matching [s]", "peak memory [MB]", "nodes", "loops")


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument("--log", default="intel", metavar="NAME", help="which log of DATA (default: intel)")
    parser.add_argument("--runs", type=int, default=3, metavar="N", help="runs after a warm-up (default: 3)")
    parser.add_argument("--seam", choices=SEAMS, default=SEAMS[0], help="the odometry of the jump (default: told)")
    options = parser.parse_args()
    path, relations = log_path(options.data, options.log), relations_path(options.data, options.log)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        in_child(write_once, path, place)
        once = mapped(place / "once", options.runs)
        in_child(write_twice, place, options.seam)
        twice = mapped(place / "twice", options.runs)
        rows = [imports(), row("once", once), row(f"twice, jump {options.seam}", twice), ratios(once, twice)]
        print(markdown(HEAD, rows), flush=True)
        in_child(print_errors, place, relations)


def in_child(work: object, *arguments: object) -> None:
    """Calls it in a process of its own: this one must stay small, or its children's peak memory would be its own."""
    child = multiprocessing.get_context("spawn").Process(target=work, args=arguments)  # type: ignore[arg-type]
    child.start()
    child.join()
    if child.exitcode:
        raise SystemExit(child.exitcode)


def write_once(path: Path, place: Path) -> None:
    """The log as plain text, as `write_twice` writes its own."""
    from mapmend.io.carmen import write_carmen
    from mapmend.io.read_log import read_log

    write_carmen(place / "once.clf", read_log(path))


def write_twice(place: Path, seam: str) -> None:
    """The log behind itself; of the map of one pass, ``once``, the jump is taken."""
    import numpy as np

    from mapmend.geometry import se2
    from mapmend.io.carmen import write_carmen
    from mapmend.io.read_log import read_log
    from mapmend.io.reader import read_run
    from mapmend.scan import ScanLog

    log = read_log(place / "once.clf")
    rows = np.tile(np.arange(len(log), dtype=np.int64), 2)
    poses = read_run(place / "once")[0].poses
    jump, said = se2.between(poses[-1], poses[0]), se2.between(log.odometry[-1], log.odometry[0])
    off = se2.between(jump, said)
    print(f"the jump is {np.hypot(jump[0], jump[1]):.1f} m and {np.degrees(abs(jump[2])):.0f} deg; the raw odometry's")
    print(f"is {np.hypot(off[0], off[1]):.1f} m and {np.degrees(abs(off[2])):.0f} deg off\n", flush=True)
    again = log.odometry
    if seam == "told":
        first = se2.compose(log.odometry[-1], jump)
        again = se2.compose(first, se2.between(log.odometry[0], log.odometry))
    stamps = np.concatenate((log.stamps_s, log.stamps_s + shift_s(log.stamps_s[0], log.stamps_s[-1])))
    write_carmen(place / "twice.clf", ScanLog(log.scans.select(rows), stamps, np.concatenate((log.odometry, again))))


def shift_s(first: float, last: float) -> float:
    """How much later the second pass is, in whole seconds, which leave the stamps' fractions as they are."""
    return float(int(last - first + PAUSE_S))


def mapped(run_folder: Path, runs: int) -> list[Run]:
    """The runs after one that is not counted; the log lies beside the run folder."""
    command = [MAPMEND, "map", f"{run_folder}.clf", "-o", str(run_folder), "--json"]
    run(command)
    return [run(command) for _ in range(runs)]


def imports() -> tuple[str, ...]:
    """What a process costs before it has read anything."""
    modules = "mapmend.slam, mapmend.run_folder, mapmend.front_end.builder, mapmend.view.map_picture"
    one = run([sys.executable, "-c", f"import {modules}"])
    return ("nothing", "0", f"{one.wall_s:.2f}", f"{one.cpu_s:.2f}", "", f"{one.peak_mb:.0f}", "", "")


def row(name: str, runs: list[Run]) -> tuple[str, ...]:
    pages = [json.loads(one.output) for one in runs]
    middle, counts = medians(runs), pages[-1]["counts"]
    matching = sorted(page["seconds"]["match"] for page in pages)[len(pages) // 2]
    seconds = (f"{middle.wall_s:.2f}", f"{middle.cpu_s:.2f}", f"{matching:.2f}")
    return (
        name,
        str(counts["scans"]),
        *seconds,
        f"{middle.peak_mb:.0f}",
        *(str(counts[k]) for k in ("nodes", "loop_edges")),
    )


def ratios(once: list[Run], twice: list[Run]) -> tuple[str, ...]:
    pairs = zip(row("", twice)[1:], row("", once)[1:], strict=True)
    return ("ratio", *(f"{float(second) / max(float(first), 1e-9):.2f}" for second, first in pairs))


def print_errors(place: Path, relations_file: Path) -> None:
    """The errors over the relations of the first pass, and over the same relations in the second."""
    from mapmend.evaluation.relations import relation_errors
    from mapmend.io.reader import read_run
    from mapmend.io.relations import read_relations

    true = read_relations(relations_file)
    print()
    for name, folder in (("once", "once"), ("first of two", "twice"), ("second of two", "twice")):
        trajectory = read_run(place / folder)[0]
        stamps = trajectory.stamps_s
        later_s = shift_s(stamps[0], stamps[len(stamps) // 2 - 1]) if name.startswith("second") else 0.0
        errors = relation_errors(
            stamps, trajectory.poses, true.t1_s + later_s, true.t2_s + later_s, true.relative_poses
        )
        print(f"{name}: {errors.translation_mean_m:.4f} m, {errors.rotation_mean_deg:.3f} deg, {errors.used} relations")


if __name__ == "__main__":
    main()
