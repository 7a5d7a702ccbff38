"""Every setting of mapmend: a frozen block for each module, defaults in code, units in names, TOML in and out."""

from __future__ import annotations

import sys
import tomllib
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from mapmend.errors import InputError, MapmendError


@dataclass(frozen=True)
class ScanConfig:
    """Which readings are used, and which neighbours lie on one surface."""

    min_range_m: float = 0.05
    max_range_m: float = 30.0  # beyond it, the points of a 1 degree laser lie half a metre apart
    surface_gap: float = 0.1  # neighbouring readings that differ by more than this share of the range are two surfaces
    wall_std_m: float = 0.03  # unless they lie on one line within this: a wall seen at a grazing angle


@dataclass(frozen=True)
class GridConfig:
    """The grids that scans are matched on, and the map that is written."""

    cell_size_m: float = 0.05
    insert_every_m: float = 0.05
    insert_every_rad: float = 0.05
    align: bool = False  # turn the map so that most of its walls run along its axes


@dataclass(frozen=True)
class MatchConfig:
    """Gauss-Newton on surfaces, and the score."""

    reach_m: float = 0.2
    half_weight_m: float = 0.1
    distance_std_m: float = 0.03
    iterations: int = 12
    convergence_m: float = 1e-4
    widening: float = 2.0
    min_score: float = 0.85  # IGO (2): the share of matched beams of a good estimate


@dataclass(frozen=True)
class MotionConfig:
    """The odometry model, IGO (1): standard deviations that grow with the reported motion, above a floor."""

    use_odometry: bool = True
    translation_std_per_m: float = 0.2
    translation_std_per_rad: float = 0.05
    rotation_std_per_rad: float = 0.4
    rotation_std_per_m: float = 0.2
    min_translation_std_m: float = 0.02
    min_rotation_std_rad: float = 0.03
    hypotheses: int = 30
    doubt_spread: float = 3.0  # how much wider than the model hypotheses are drawn: in doubt, the model may be wrong
    # By how much the score of a hypothesis three standard deviations or more away must exceed the prediction's. There
    # the log prior has fallen by 4.5, and of the beams, which are not independent, some 30 count: 4.5 / 30.
    prior_weight: float = 0.15


@dataclass(frozen=True)
class KeyNodeConfig:
    """Nodes and key-nodes (IGO III-B)."""

    node_every_m: float = 0.25
    node_every_rad: float = 0.25
    trajectory_length_m: float = 5.0  # T_l
    member_length_m: float = (
        25.0  # how far along graph and trajectory a key-node may be to take part in the global grid
    )
    near_m: float = 20.0  # nearer key-nodes are in the global grid, or are removed from it


@dataclass(frozen=True)
class LoopConfig:
    """Loop search and its verification (IGO III-C)."""

    enabled: bool = True
    min_separation_m: float = 10.0  # trajectory between two places that may form a loop
    gate_quantile: float = 0.99  # of the chi-square distribution with 3 degrees of freedom, IGO (5)
    view_std_m: float = 2.5  # how far apart two poses may be and still see the same walls
    guess_every_m: float = 0.05
    drift_per_m: float = 0.02  # guards the ellipse against over-confident edges
    farthest_m: float = 60.0  # the greatest distance at which relocation looks for the robot after drift
    certain_std_m: float = 0.1  # below it (and the next), the prior is good enough for Gauss-Newton alone
    certain_std_rad: float = 0.05
    min_likelihood: float = 0.45
    min_score: float = 0.55
    min_agreement: float = 0.9
    min_overlap: float = 0.35
    min_observability: float = 0.05
    retry_every_m: float = 1.0
    confirm_after_m: float = 1.5
    confirm_m: float = 0.2
    confirm_rad: float = 0.05
    tie_weight: float = 0.03
    tune: bool = False  # let the scans decide which loops count (MC section V): --robust auto


@dataclass(frozen=True)
class IgoConfig:
    """Iterative graph optimization (IGO IV)."""

    rounds: int = 5  # the paper's iter
    settled_share: float = 0.01  # of chi2, which for a sound graph is about the number of nodes: epsilon of Algorithm 1


@dataclass(frozen=True)
class ConsistencyConfig:
    """The consistency measure and its test (MC III and IV)."""

    min_range_m: float = 0.05
    max_range_m: float = 8.0  # points beyond it are too sparse; the free space up to there still counts
    min_points: int = 10  # inconsistent points that a pair must keep to be tested
    drop_points: int = 10  # a pair's largest depths, left out of its test: people, glass, bad readings
    drop_share: float = 0.1
    neighbours: int = 20  # scans before and after along the odometry that a scale is estimated from
    neighbours_m: float = 6.0  # and no farther than this: key scans are metres apart, with drift between them
    most_scale_m: float = 0.2  # scans of one pass that contradict each other by more show two walls, not noise
    scale_level: float = 0.05  # (10): a scan's pairs along the odometry all pass at this level
    prior_std_m: float = 0.03  # the error of an optimized pose, added to every scale
    least_inflation: float = 0.4  # limits of the factor by which the pairs of one pass narrow or widen the scales
    most_inflation: float = 2.0
    pair_level: float = 0.01
    scan_level: float = 0.01
    scan_dependence: float = 0.07  # correlation between the tests of one scan's pairs
    map_level: float = 0.01
    map_dependence: float = 0.04  # and between the scans of one map


@dataclass(frozen=True)
class GMappingConfig:
    """The particle filter, with the names that GMapping's users know; ``r`` is translation, ``t`` rotation."""

    particles: int = 30
    linear_update_m: float = 1.0
    angular_update_rad: float = 0.5
    srr: float = 0.1  # standard deviation of the odometry's translation, m per metre
    srt: float = 0.2  # of its translation, m per radian
    str: float = 0.1  # of its rotation, rad per metre
    stt: float = 0.2  # of its rotation, rad per radian
    minimum_score: float = 0.3  # the share of the beams below which only the odometry is used
    resample_threshold: float = 0.5  # of the particles: the effective sample size below which they are resampled
    lsigma_m: float = 0.075  # standard deviation of a beam
    ogain: float = 3.0  # the divisor of log-likelihoods in the weights: neighbouring beams are not independent


@dataclass(frozen=True)
class Config:
    """All blocks; ``seed`` feeds the hypotheses."""

    scan: ScanConfig = field(default_factory=ScanConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    match: MatchConfig = field(default_factory=MatchConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    key_nodes: KeyNodeConfig = field(default_factory=KeyNodeConfig)
    loops: LoopConfig = field(default_factory=LoopConfig)
    igo: IgoConfig = field(default_factory=IgoConfig)
    consistency: ConsistencyConfig = field(default_factory=ConsistencyConfig)
    gmapping: GMappingConfig = field(default_factory=GMappingConfig)
    seed: int = 0


# Settings that must not be zero: they are divisors, or with zero nothing would ever be done.
ABOVE_ZERO = {
    "grid.cell_size_m",
    "match.reach_m",
    "match.half_weight_m",
    "match.distance_std_m",
    "match.iterations",
    "match.widening",
    "motion.min_translation_std_m",
    "motion.min_rotation_std_rad",
    "key_nodes.node_every_m",
    "key_nodes.node_every_rad",
    "key_nodes.trajectory_length_m",
    "loops.gate_quantile",
    "loops.guess_every_m",
    "loops.certain_std_m",
    "loops.certain_std_rad",
    "consistency.max_range_m",
    "consistency.min_points",
    "consistency.neighbours",
    "consistency.most_scale_m",
    "consistency.scale_level",
    "consistency.prior_std_m",
    "consistency.least_inflation",
    "consistency.pair_level",
    "consistency.scan_level",
    "consistency.map_level",
    "gmapping.particles",
    "gmapping.lsigma_m",
    "gmapping.ogain",
}
SHARES = {
    "scan.surface_gap",
    "match.min_score",
    "loops.min_likelihood",
    "loops.min_score",
    "loops.min_agreement",
    "loops.min_overlap",
    "loops.min_observability",
    "consistency.drop_share",
    "gmapping.minimum_score",
    "gmapping.resample_threshold",
}
BELOW_ONE = {
    "loops.gate_quantile",
    "consistency.scale_level",
    "consistency.pair_level",
    "consistency.scan_level",
    "consistency.scan_dependence",
    "consistency.map_level",
    "consistency.map_dependence",
}


def to_dict(config: Config) -> dict[str, Any]:
    """Plain tables, as in TOML and JSON."""
    return asdict(config)


def from_dict(tables: dict[str, Any], source: str | None = None) -> Config:
    """A configuration from plain tables; unknown keys and values of the wrong type or size raise ``InputError``."""
    config = Config()
    blocks = {f.name: f for f in fields(Config)}
    for name, value in tables.items():
        if name not in blocks:
            raise InputError(source, f"unknown key '{name}'", f"known are {', '.join(blocks)}")
        current = getattr(config, name)
        if name == "seed":
            config = replace(config, seed=_checked(source, name, current, value))
            continue
        if not isinstance(value, dict):
            raise InputError(source, f"'{name}' must be a table", f"write [{name}]")
        known = {f.name for f in fields(current)}
        for key in value:
            if key not in known:
                raise InputError(source, f"unknown key '{name}.{key}'", f"known are {', '.join(sorted(known))}")
        checked = {k: _checked(source, f"{name}.{k}", getattr(current, k), v) for k, v in value.items()}
        config = replace(config, **{name: replace(current, **checked)})
    nearest, farthest = config.scan.min_range_m, config.scan.max_range_m
    if nearest >= farthest:
        raise InputError(source, f"'scan.max_range_m' is {farthest:g}", f"give more than min_range_m, {nearest:g}")
    low, high = config.consistency.least_inflation, config.consistency.most_inflation
    if low > high:
        raise InputError(source, f"'consistency.most_inflation' is {high:g}", f"give {low:g} (least_inflation) or more")
    return config


def _checked(source: str | None, name: str, default: Any, value: Any) -> Any:
    if isinstance(default, bool):
        fits, wanted = isinstance(value, bool), "true or false"
    else:
        kind = int if isinstance(default, int) else int | float
        above, below = name in ABOVE_ZERO, name in BELOW_ONE
        most = 1.0 if below or name in SHARES else sys.float_info.max
        fits = isinstance(value, kind) and not isinstance(value, bool) and 0 <= value <= most
        fits = fits and not (above and value == 0) and not (below and value == 1)
        wanted = f"a{' whole' if kind is int else ''} number {'above 0' if above else 'not below 0'}"
        if most == 1.0:
            wanted += " and below 1" if below else " and not above 1"
    if not fits:
        raise InputError(source, f"'{name}' is {value!r}", f"give {wanted}")
    return float(value) if isinstance(default, float) else value


def read_toml(path: str | Path) -> Config:
    """A configuration file; keys that are not there keep their defaults."""
    try:
        with open(path, "rb") as stream:
            return from_dict(tomllib.load(stream), str(path))
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})", "check the path") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(path, f"is not TOML ({error})", "correct that line") from error
    except UnicodeDecodeError as error:
        raise InputError(path, "is not text", "give a TOML file") from error


def to_toml(config: Config) -> str:
    """The configuration as text that `read_toml` can read."""
    lines = [f"seed = {config.seed}"]
    for name, table in to_dict(config).items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]"]
            lines += [
                f"{key} = {str(value).lower() if isinstance(value, bool) else value}" for key, value in table.items()
            ]
    return "\n".join(lines) + "\n"


__all__ = [
    "Config",
    "ConsistencyConfig",
    "GMappingConfig",
    "GridConfig",
    "IgoConfig",
    "KeyNodeConfig",
    "LoopConfig",
    "MapmendError",
    "MatchConfig",
    "MotionConfig",
    "ScanConfig",
    "from_dict",
    "read_toml",
    "to_dict",
    "to_toml",
]
