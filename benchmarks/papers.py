"""All tables and figures of both papers that our data allow, in one go, and docs/results.md from them.

Runs the other benchmarks and ``mapmend`` itself, each as a process. The results of each step are kept in --output, and
an interrupted run continues where it stopped. Two steps of one core run side by side; steps that are timed run alone.

    python benchmarks/papers.py                 # all steps, then docs/results.md; at most 40 minutes on 2 cores
    python benchmarks/papers.py --only-page     # only the page, from earlier results
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from _measure import data_parser, log_path, stop

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
MAPMEND = (sys.executable, "-m", "mapmend")
EXPERIMENT_METHODS = ("gmapping", "go", "igo")
CORRIDOR_METHODS = ("scanmatch", *EXPERIMENT_METHODS)
DRIVES = ("laser alone", "wheels that slip")
SEEDS = "10"
LOGS = ("intel", "fr079")
TELL_EVERY_S = 1.0


@dataclass(frozen=True)
class Step:
    """One process: its name, arguments after the interpreter, the cores that it takes, steps that must be done first.

    A step whose exit code is in ``answers`` ended well: ``mapmend check`` says no with 1.
    """

    name: str
    arguments: tuple[str, ...]
    cores: int = 1
    after: tuple[str, ...] = ()
    answers: tuple[int, ...] = (0,)


@dataclass
class Running:
    """A step under way."""

    step: Step
    process: subprocess.Popen[str]
    printed: IO[str]
    said: IO[str]
    began: float = field(default_factory=time.monotonic)


def main() -> None:
    options = parsed()
    folder: Path = options.output
    folder.mkdir(parents=True, exist_ok=True)
    log_path(options.data, "intel")
    failed: list[str] = []
    if not options.only_page:
        os.environ["MAPMEND_DATA"] = str(Path(options.data).resolve())
        failed = Runner(chosen(all_steps(options.data, folder), options.only), folder, options.cores).run()
    from _papers_page import write_page

    write_page(folder, options.page)
    print(f"{options.page}: written from {folder}")
    if failed:
        stop(f"not done: {', '.join(failed)}; run again to try these once more")


def parsed() -> argparse.Namespace:
    parser = data_parser(__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("papers"), help="for results (default: papers)")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "results.md", help="default: docs/results.md")
    parser.add_argument("--cores", type=int, default=2, metavar="N", help="default: 2")
    parser.add_argument("--only", nargs="+", metavar="STEP", help="these steps alone, with those that they need")
    parser.add_argument("--only-page", action="store_true", help="write the page of what was measured before")
    return parser.parse_args()


def all_steps(data: str, folder: Path) -> list[Step]:
    """Long ones of one core first, so that they run beside each other; then what is timed or takes all cores."""
    place = str(folder.resolve())
    steps = [script(f"slip-{m}", slip(place, m)) for m in ("gmapping", "igo")]
    steps += [script(f"corridor-{m}", corridor(place, m)) for m in CORRIDOR_METHODS]
    steps.append(script("slip-go", slip(place, "go")))
    slips, corridors = tuple(f"slip-{m}" for m in EXPERIMENT_METHODS), tuple(f"corridor-{m}" for m in CORRIDOR_METHODS)
    drawing = ("--only-print", "--results", f"{place}/slip.jsonl", "--pictures", place)
    steps.append(script("slip", ("slip.py", "intel", "--methods", *EXPERIMENT_METHODS, *drawing), after=slips))
    drawing = ("--only-print", "--results", f"{place}/corridor.jsonl", "--pictures", place)
    steps.append(script("corridor", ("corridor.py", "--drives", *DRIVES, *drawing), after=corridors))
    steps.append(script("graphs", ("_papers_graphs.py", place)))
    steps += [check(f"check-{name}", f"{place}/{name}.g2o", place, ("graphs",)) for name in ("belgioioso-bent",)]
    steps.append(check("check-killian", f"{data}/scangraphs/killian.g2o.gz", place))
    tune = ("-m", "mapmend", "tune", f"{place}/intel-false.g2o", "-o", f"{place}/tune", "--json")
    steps.append(Step("tune", tune, cores=2, after=("graphs",), answers=(0, 1)))
    tuning = ("tuning.py", "--counts", "0", "200", "--kinds", "random", "local", "--results", f"{place}/tuning.jsonl")
    steps.append(script("tuning", tuning, cores=2))
    steps.append(script("power", ("consistency.py", "--what", "power", "--maps", "120"), cores=2))
    steps.append(script("table1", ("consistency.py", "--what", "speed"), cores=2))
    for name in LOGS:
        methods = ("--methods", "odometry", "scanmatch", *EXPERIMENT_METHODS)
        relations = ("--relations", f"{data}/relations/{name}.relations")
        log = ("-m", "mapmend", "compare", str(log_path(data, name)), "-o", f"{place}/compare-{name}", "--json")
        steps.append(Step(f"compare-{name}", (*log, *relations, *methods), cores=2))
    return steps


def chosen(steps: list[Step], names: Sequence[str] | None) -> list[Step]:
    """All steps, or those named with the ones that they need."""
    if names is None:
        return steps
    wanted = set(names)
    if wanted - {step.name for step in steps}:
        stop(f"there is no step {', '.join(wanted)}; there are {', '.join(step.name for step in steps)}")
    for step in reversed(steps):
        if step.name in wanted:
            wanted |= set(step.after)
    return [step for step in steps if step.name in wanted]


def script(name: str, arguments: Sequence[str], cores: int = 1, after: tuple[str, ...] = ()) -> Step:
    """A benchmark of this folder."""
    return Step(name, (str(HERE / arguments[0]), *arguments[1:]), cores, after)


def slip(place: str, method: str) -> tuple[str, ...]:
    return "slip.py", "intel", "--seeds", SEEDS, "--methods", method, "--results", f"{place}/slip-{method}.jsonl"


def corridor(place: str, method: str) -> tuple[str, ...]:
    results = ("--methods", method, "--results", f"{place}/corridor-{method}.jsonl")
    return "corridor.py", "--seeds", SEEDS, "--drives", *DRIVES, *results


def check(name: str, graph: str, place: str, after: tuple[str, ...] = ()) -> Step:
    arguments = ("-m", "mapmend", "check", graph, "-o", f"{place}/{name}", "--json")
    return Step(name, arguments, after=after, answers=(0, 1))


class Runner:
    """Runs steps over the cores, keeps their output, and reports progress."""

    def __init__(self, steps: list[Step], folder: Path, cores: int) -> None:
        self._folder = folder
        self._cores = cores
        self._done = [step.name for step in steps if self._is_done(step)]
        self._waiting = [step for step in steps if step.name not in self._done]
        self._total = len(steps)
        self._running: list[Running] = []
        self._failed: list[str] = []
        self._began = time.monotonic()
        self._told = ""

    def run(self) -> list[str]:
        """All steps; the names of those that failed, which others may have waited for in vain."""
        try:
            while self._running or self._start():
                self._tell()
                time.sleep(0.2)
                for one in [r for r in self._running if r.process.poll() is not None]:
                    self._end(one)
                self._start()
        finally:
            for one in self._running:
                one.process.terminate()
                one.process.wait()
        if sys.stderr.isatty():
            print(file=sys.stderr)
        return self._failed + [step.name for step in self._waiting]

    def _start(self) -> bool:
        """Starts what there are cores for, in the order given; whether anything runs."""
        while True:
            free = self._cores - sum(min(one.step.cores, self._cores) for one in self._running)
            ready = [step for step in self._waiting if set(step.after) <= set(self._done)]
            if not ready or min(ready[0].cores, self._cores) > free:
                return bool(self._running)
            step = ready[0]
            self._waiting.remove(step)
            self._merge(step)
            (self._folder / step.name).mkdir(exist_ok=True) if step.name.startswith("check-") else None
            printed = (self._folder / f"{step.name}.part").open("w+")
            said = (self._folder / f"{step.name}.err").open("w+")
            process = subprocess.Popen([sys.executable, *step.arguments], stdout=printed, stderr=said, text=True)
            self._running.append(Running(step, process, printed, said))

    def _merge(self, step: Step) -> None:
        """A step that shows what others measured finds all their lines in one file."""
        parts = [self._folder / f"{name}.jsonl" for name in step.after]
        if step.after and all(part.is_file() for part in parts):
            (self._folder / f"{step.name}.jsonl").write_text("".join(part.read_text() for part in parts))

    def _end(self, one: Running) -> None:
        self._running.remove(one)
        one.printed.close()
        one.said.close()
        step, seconds = one.step, time.monotonic() - one.began
        if one.process.returncode not in step.answers:
            self._failed.append(step.name)
            last = (self._folder / f"{step.name}.err").read_text().strip().splitlines()[-1:]
            print(f"papers: {step.name} failed: {' '.join(last)}", file=sys.stderr)
            return
        (self._folder / f"{step.name}.part").replace(self._folder / f"{step.name}.out")
        page = {"arguments": self._told_arguments(step), "seconds": round(seconds, 1)}
        (self._folder / f"{step.name}.json").write_text(json.dumps(page) + "\n")
        self._done.append(step.name)

    def _is_done(self, step: Step) -> bool:
        page = self._folder / f"{step.name}.json"
        if not page.is_file() or not (self._folder / f"{step.name}.out").is_file():
            return False
        return bool(json.loads(page.read_text())["arguments"] == self._told_arguments(step))

    def _told_arguments(self, step: Step) -> list[str]:
        """As a reader would give them: without this machine's folders."""
        data, place = os.environ["MAPMEND_DATA"], str(self._folder.resolve())
        return [
            word.replace(data, "$MAPMEND_DATA").replace(place, "papers").replace(str(HERE), "benchmarks")
            for word in step.arguments
        ]

    def _tell(self) -> None:
        now = time.monotonic()
        names = ", ".join(f"{one.step.name} {clock(now - one.began)}" for one in self._running)
        line = f"papers: {len(self._done)} of {self._total} steps done, {clock(now - self._began)}; running {names}"
        state = ", ".join(one.step.name for one in self._running)
        if sys.stderr.isatty():
            print(f"\r{line:<110}"[:111], end="", file=sys.stderr, flush=True)
        elif state != self._told:
            print(line, file=sys.stderr, flush=True)
        self._told = state


def clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


if __name__ == "__main__":
    main()
