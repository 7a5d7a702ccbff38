"""Experiment I of the IGO paper: a real log whose wheels slip, mapped with a motion model widened for it.

The slips are seeded and added to a recording, mostly on straight stretches (``lab/slip.py``); its scans stay as they
are. The paper's variances, 1.6 for translation and 0.8 for rotation, are taken as those for 1 m and 1 rad of reported
motion: ``motion.translation_std_per_m`` is their root, 1.26, and ``motion.rotation_std_per_rad`` 0.89.

Errors are those over the true relations if there are any, otherwise the absolute trajectory error against go's map of
the log without slips: the paper's own log, USC SAL, may be given by its path. Every run is appended to --results as a
line of JSON, and runs that are there are not repeated.
"""

from __future__ import annotations

import argparse
import os
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from _measure import markdown, stop
from _seeds import Results, Spread, paired, spread_table
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.evaluation.relations import relation_errors
from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.geometry import se2
from mapmend.io.read_log import read_log
from mapmend.io.relations import read_relations
from mapmend.lab.slip import KINDS, LogSlip, SlipModel, slip_log
from mapmend.scan import ScanLog
from mapmend.slam import METHODS, MapResult, build_map

Float = NDArray[np.float64]

MODELS = ("wide", "default")
TRANSLATION_VARIANCE, ROTATION_VARIANCE = 1.6, 0.8

DEFAULT = SlipModel("along", count=30, share=0.9, length_m=2.0)
"""The weakest severity of the sweep at which go's median error on intel doubles, with the default motion model.

go is robust against weaker ones; with the widened model its median is 2.3 times the clean error (ten seeds).
"""

NO_SLIP = replace(DEFAULT, count=0)

SWEEP = [
    *(SlipModel("along", 30, share, 2.0) for share in (0.5, 0.7, 0.8, 0.85, 0.9)),
    *(SlipModel("along", 12, share, m) for share in (0.5, 0.8, 0.9) for m in (2.0, 6.0)),
    *(SlipModel("turn", 12, share) for share in (0.5, 0.8)),
    *(SlipModel("jump", 12, 0.0, m) for m in (2.0, 6.0)),
]

LEAD_SCANS, TAIL_SCANS = 10, 60
WRONG_M = 0.1
"""A slip is wrong if the motion over it, from this many scans before to this many after, is off by this."""


@dataclass(frozen=True)
class Measured:
    """One method on one log with slips. ``slips_wrong`` and ``worst_slip_m``: against go's map without slips."""

    log: str
    model: str
    method: str
    kind: str
    count: int
    share: float
    length_m: float
    seed: int
    error_m: float
    error_max_m: float
    rotation_deg: float
    phantom_m: float
    slips_wrong: int
    worst_slip_m: float
    loops: int
    searched: int
    seconds: float

    @property
    def slip(self) -> SlipModel:
        return SlipModel(self.kind, self.count, self.share, self.length_m)


def key_of(one: Measured) -> tuple[Any, ...]:
    return one.log, one.model, one.method, one.slip, one.seed


def main() -> None:
    options = parsed()
    results = Results(options.results, Measured, key_of)
    if not options.only_print:
        results.measure(cases(options), measure)
    rows = [one for one in results.rows if one.model in options.models]
    print(sweep_table(rows) if options.sweep else tables(rows, options.slip))
    if options.pictures:
        draw(rows, options)


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="*", metavar="LOG", help="paths, or names below MAPMEND_DATA (default: intel)")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="default: %(default)s")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="of the first (default: %(default)s)")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=["go", "igo"], metavar="M")
    parser.add_argument("--models", nargs="+", choices=MODELS, default=["wide"], help="of motion (default: wide)")
    parser.add_argument("--kind", choices=KINDS, default=DEFAULT.kind)
    parser.add_argument("--count", type=int, default=DEFAULT.count, metavar="N", help="slips (default: %(default)s)")
    parser.add_argument("--share", type=float, default=DEFAULT.share, metavar="S", help="default: %(default)s")
    parser.add_argument("--length", type=float, default=DEFAULT.length_m, metavar="M", help="default: %(default)s")
    parser.add_argument("--sweep", action="store_true", help="all severities instead of one")
    parser.add_argument("--results", type=Path, default=Path("slip.jsonl"), help="default: %(default)s")
    parser.add_argument("--only-print", action="store_true", help="the tables of what was measured before")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="draw the seed of go's median error into DIR")
    options = parser.parse_args()
    options.logs = options.logs or ["intel"]
    for log in options.logs:
        if not path_of(log, "logs", ".clf.bz2").is_file():
            stop(f"{log} is no file, and no log below MAPMEND_DATA; give a path, or a name like intel")
    options.slip = SlipModel(options.kind, options.count, options.share, options.length)
    return options


def draw(rows: Sequence[Measured], options: argparse.Namespace) -> None:
    """The first log at the seed of go's median error."""
    from _slip_pictures import Drawn, draw_all, median_seed

    log, model, slip = options.logs[0], options.models[0], options.slip
    seed = median_seed([one for one in rows if key_of(one)[:4] == (log, model, "go", slip)])
    errors = {one.method: one.error_m for one in rows if key_of(one) == (log, model, one.method, slip, seed)}

    def mapped(given: ScanLog, method: str) -> MapResult:
        return build_map(given, method, config_of(model, seed))

    reference = without_slips(log, model)
    name = Path(log).name.split(".")[0]
    draw_all(Drawn(name, slip_log(loaded(log), slip, seed).log, mapped, reference, errors), options.pictures)


def cases(options: argparse.Namespace) -> Iterator[tuple[Any, ...]]:
    """All logs without slips first, then seed by seed."""
    slips = SWEEP if options.sweep else [options.slip]
    for log in options.logs:
        for model in options.models:
            yield from ((log, model, method, NO_SLIP, 0) for method in options.methods)
    for seed in range(options.first, options.first + options.seeds):
        for log in options.logs:
            for model in options.models:
                yield from ((log, model, method, slip, seed) for slip in slips for method in options.methods)


def measure(log: str, model: str, method: str, slip: SlipModel, seed: int) -> Measured:
    """Spoils the log, maps it, compares."""
    slipped = slip_log(loaded(log), slip, seed)
    result = build_map(slipped.log, method, config_of(model, seed))
    poses = result.trajectory.poses
    off_m = [slip_error_m(one, poses, without_slips(log, model).trajectory.poses) for one in slipped.slips]
    error_m, error_max_m, rotation_deg = errors_of(log, model, poses)
    return Measured(
        log,
        model,
        method,
        **asdict(slip),
        seed=seed,
        error_m=error_m,
        error_max_m=error_max_m,
        rotation_deg=rotation_deg,
        phantom_m=sum(one.phantom_m for one in slipped.slips),
        slips_wrong=sum(off > WRONG_M for off in off_m),
        worst_slip_m=max(off_m, default=0.0),
        loops=result.counts["loop_edges"],
        searched=result.counts["scans_searched"],
        seconds=sum(result.seconds.values()),
    )


def config_of(model: str, seed: int) -> Config:
    """Defaults, with the motion model widened where asked for."""
    config = Config(seed=seed)
    if model == "default":
        return config
    per_m, per_rad = float(np.sqrt(TRANSLATION_VARIANCE)), float(np.sqrt(ROTATION_VARIANCE))
    motion = replace(config.motion, translation_std_per_m=per_m, rotation_std_per_rad=per_rad)
    return replace(config, motion=motion, gmapping=replace(config.gmapping, srr=per_m, stt=per_rad))


def path_of(log: str, folder: str, ending: str) -> Path:
    """A log of the data folder by its name, or of anywhere by its path; its relations lie in the folder beside."""
    given = Path(log)
    if given.is_file():
        return given if folder == "logs" else given.parent.parent / folder / f"{given.name.split('.')[0]}{ending}"
    return Path(os.environ.get("MAPMEND_DATA", "")) / folder / f"{log}{ending}"


@cache
def loaded(log: str) -> ScanLog:
    return read_log(path_of(log, "logs", ".clf.bz2"))


@cache
def without_slips(log: str, model: str) -> MapResult:
    """go's map of the log as it is."""
    return build_map(loaded(log), "go", config_of(model, 0))


def errors_of(log: str, model: str, poses: Float) -> tuple[float, float, float]:
    """Mean and largest translation [m], mean rotation [deg]: over relations, or against go's map without slips."""
    stamps, relations = loaded(log).stamps_s, path_of(log, "relations", ".relations")
    if relations.is_file():
        true = read_relations(relations)
        found = relation_errors(stamps, poses, true.t1_s, true.t2_s, true.relative_poses)
        return found.translation_mean_m, found.translation_max_m, found.rotation_mean_deg
    reference = without_slips(log, model).trajectory
    errors = trajectory_errors(stamps, poses, reference.stamps_s, reference.poses)
    return errors.translation_rmse_m, errors.translation_max_m, errors.rotation_mean_deg


def slip_error_m(slip: LogSlip, poses: Float, reference: Float) -> float:
    """By how much the motion from some scans before a slip to some after it is off."""
    rows = [max(slip.first - LEAD_SCANS, 0), min(slip.last + TAIL_SCANS, len(poses) - 1)]
    off = se2.between(se2.between(*reference[rows]), se2.between(*poses[rows]))
    return float(np.hypot(off[0], off[1]))


def tables(rows: Sequence[Measured], slip: SlipModel) -> str:
    """One severity: the spread of each method, and the errors of its worst seed."""
    parts, notes = [], []
    for log, model, method in sorted({(one.log, one.model, one.method) for one in rows}):
        mine = [one for one in rows if (one.log, one.model, one.method) == (log, model, method)]
        clean = [one.error_m for one in mine if one.count == 0]
        slipped = [one for one in mine if one.slip == slip]
        if not slipped:
            continue
        errors = {one.seed: one.error_m for one in slipped}
        without = f"{clean[0]:.4f}" if clean else ""
        worse = "" if method == "go" else paired(errors, go_errors(rows, log, model, slip))
        parts.append(((f"{Path(log).name}, {model}", method, without, worse), errors))
        worst = max(slipped, key=lambda one: one.error_m)
        what = (
            f"{worst.slips_wrong} of {worst.count} slips wrong by over {WRONG_M} m, one by {worst.worst_slip_m:.2f} m"
        )
        more = f"largest error {worst.error_max_m:.2f} m, {worst.rotation_deg:.2f}°, {worst.loops} loop edges"
        notes.append(f"- {Path(log).name}, {model}, {method}, seed {worst.seed}: {what}; {more}")
    table = spread_table(("log, motion model", "method", "without slips", "worse than go"), parts, digits=4)
    title = f"{slip.count} slips of kind {slip.kind}, {100 * slip.share:.0f} % over {slip.length_m:g} m: error [m]"
    return f"{title}\n\n{table}\n\nThe worst seeds:\n\n" + "\n".join(notes)


def go_errors(rows: Sequence[Measured], log: str, model: str, slip: SlipModel) -> dict[int, float]:
    """Of go, by seed, at one severity."""
    return {one.seed: one.error_m for one in rows if key_of(one)[:4] == (log, model, "go", slip)}


def severity(slip: SlipModel) -> tuple[str, str, str, str]:
    """Kind, number, share and length, as a table shows them."""
    if slip.count == 0:
        return "none", "", "", ""
    share, length = ("", "") if slip.kind == "jump" else (f"{slip.share:.1f}", "")
    return slip.kind, str(slip.count), share, length if slip.kind == "turn" else f"{slip.length_m:g}"


def sweep_table(rows: Sequence[Measured]) -> str:
    """All severities, a row each: the spread over seeds and how many slips went wrong."""
    lines = []
    for log, model, method in sorted({(one.log, one.model, one.method) for one in rows}):
        for slip in (NO_SLIP, *SWEEP):
            mine = [one for one in rows if key_of(one)[:4] == (log, model, method, slip)]
            if mine:
                spread = Spread.of({one.seed: one.error_m for one in mine})
                wrong = f"{statistics.mean(one.slips_wrong for one in mine):.1f}" if slip.count else ""
                lines.append((f"{Path(log).name}, {model}", method, *severity(slip), *spread.cells(4), wrong))
    head = ("log, motion model", "method", "kind", "slips", "share", "length [m]", "seeds", "median [m]", "quartiles")
    return markdown((*head, "worst", "its seed", "slips wrong"), lines)


if __name__ == "__main__":
    main()
