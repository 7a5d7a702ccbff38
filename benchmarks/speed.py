"""How fast the command line answers: `map` of a log as a whole process, `--help`, and the cold first `demo`."""

from __future__ import annotations

import json
import tempfile

from _measure import MAPMEND, Run, data_parser, log_path, markdown, medians, run

HEAD = ("command", "runs", "wall [s]", "fastest, slowest [s]", "CPU [s]", "peak memory [MB]")


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument("--log", default="intel", metavar="NAME", help="which log of DATA (default: intel)")
    parser.add_argument("--runs", type=int, default=7, metavar="N", help="runs after a warm-up (default: 7)")
    options = parser.parse_args()
    path = log_path(options.data, options.log)
    with tempfile.TemporaryDirectory() as folder:
        mapping = warm([MAPMEND, "map", str(path), "-o", f"{folder}/run"], options.runs)
        one_thread = warm([MAPMEND, "map", str(path), "-o", f"{folder}/run", "--threads", "1"], options.runs)
        helping = warm([MAPMEND, "--help"], options.runs)
        demo = [MAPMEND, "demo", "-o", f"{folder}/demo", "--json"]
        cold = run(demo, NUMBA_CACHE_DIR=f"{folder}/kernels")
        again = run(demo, NUMBA_CACHE_DIR=f"{folder}/kernels")
    rows = [
        row(f"map {options.log}", mapping),
        row(f"map {options.log} --threads 1", one_thread),
        row("--help", helping),
        row("demo, empty kernel cache", [cold]),
        row("demo, the next time", [again]),
    ]
    print(markdown(HEAD, rows))
    print(f"\nseconds of the cold demo spent compiling: {json.loads(cold.output)['compile_seconds']:.1f}")


def warm(command: list[str], runs: int) -> list[Run]:
    """The runs after one that is not counted."""
    run(command)
    return [run(command) for _ in range(runs)]


def row(what: str, runs: list[Run]) -> tuple[str, ...]:
    middle = medians(runs)
    walls = [one.wall_s for one in runs]
    spread = f"{min(walls):.2f}, {max(walls):.2f}" if len(runs) > 1 else ""
    return (
        f"`{what}`" if "," not in what else what,
        str(len(runs)),
        f"{middle.wall_s:.2f}",
        spread,
        f"{middle.cpu_s:.2f}",
        f"{middle.peak_mb:.0f}",
    )


if __name__ == "__main__":
    main()
