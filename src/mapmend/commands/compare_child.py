"""One method's part of ``mapmend compare``, in a process of its own: its time and its peak memory are the method's.

``python -m mapmend.commands.compare_child`` takes one JSON object as its argument and prints JSON lines: progress, then
the result or an error. It is not for users; ``mapmend compare`` calls it.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from typing import Any

from mapmend.compiling import watch_compiling
from mapmend.config import from_dict
from mapmend.errors import MapmendError
from mapmend.io.bags.options import BagOptions
from mapmend.io.read_log import read_log
from mapmend.run_folder import write_run
from mapmend.slam import MapResult, build_map

MB_PER_RSS_UNIT = 1.0 / 1024.0 if sys.platform != "darwin" else 1.0 / 1024.0**2
TELL_EVERY_S = 0.2


def main() -> int:
    """Maps, measures, checks; the exit code is 0 if a result was printed."""
    try:
        _tell({"result": measured(json.loads(sys.argv[1]))})
    except KeyboardInterrupt:
        return 130
    except MapmendError as error:
        _tell({"error": str(error)})
        return 2
    except MemoryError:
        _tell({"error": "not enough memory"})
        return 2
    return 0


def measured(request: dict[str, Any]) -> dict[str, Any]:
    """The results of one method: errors, seconds without compiling, peak memory up to the written RUN, verdict."""
    config, progress = from_dict(request["config"]), _Progress()
    began, began_cpu = time.perf_counter(), time.process_time()
    log = read_log(request["log"], request["lenient"], BagOptions(**request["bag"]))
    with watch_compiling(lambda: None) as compiling:
        result = build_map(log, request["method"], config, threads=request["threads"], progress=progress)
        run_json = write_run(result, request["run"], source=request["name"])
    values = {
        "method": request["method"],
        "seconds": round(time.perf_counter() - began - compiling.seconds, 3),
        "cpu_seconds": round(time.process_time() - began_cpu, 3),
        "compile_seconds": round(compiling.seconds, 3),
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MB_PER_RSS_UNIT, 1),
        "nodes": run_json["counts"]["nodes"],
        "loop_edges": run_json["counts"]["loop_edges"],
        "notes": [str(note) for note in log.notes],
    }
    if request["relations"]:
        values |= _errors(result, request["relations"])
    return values | _verdict(result, request["threads"], progress)


def _errors(result: MapResult, path: str) -> dict[str, Any]:
    from mapmend.evaluation.relations import relation_errors
    from mapmend.io.relations import read_relations

    true, estimate = read_relations(path), result.trajectory
    errors = relation_errors(estimate.stamps_s, estimate.poses, true.t1_s, true.t2_s, true.relative_poses)
    names = ("translation_mean_m", "translation_std_m", "rotation_mean_deg", "rotation_std_deg", "used", "total")
    return {name: getattr(errors, name) for name in names}


def _verdict(result: MapResult, threads: int, progress: _Progress) -> dict[str, Any]:
    """The result of ``mapmend check`` for the graph; ``consistent`` is None if there is no verdict."""
    from mapmend.consistency.check import check

    try:
        checked = check(result.graph, result.config, threads=threads, progress=progress)
    except MapmendError as error:
        return {"consistent": None, "check": str(error)}
    return {"consistent": checked.consistent, "p_value": checked.p_value}


class _Progress:
    """Reports progress to the parent process, not too often."""

    def __init__(self) -> None:
        self._told = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if done == total or now - self._told >= TELL_EVERY_S:
            self._told = now
            _tell({"progress": [stage, done, total]})


def _tell(line: dict[str, Any]) -> None:
    print(json.dumps(line, allow_nan=False), flush=True)


if __name__ == "__main__":
    sys.exit(main())
