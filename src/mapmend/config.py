"""Every setting of mapmend: one frozen block for each part, defaults and bounds in the code, units in the names, TOML.

A setting takes numbers from 0 on, or those within the bounds beside it. Settings are checked whenever a block or a
`Config` is made, in Python as from TOML.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from mapmend.errors import InputError, MapmendError
from mapmend.settings import Block, Bounds, checked, setting, wrong

REACH_CELLS = 4
"""How far off, in cells, a grid's cell knows its nearest surface: `REACH` in grid/_kernels.py."""

GRID_LENGTHS = 1.5
"""How much of the trajectory after a key-node's first node its local grid may hold, in lengths T_l: the key-node's own
nodes and half a length on (`local_grid` in scan_graph/key_nodes.py). A node nearer than this may be in the grid."""


@dataclass(frozen=True)
class ScanConfig(Block):
    """Which readings are used, and which neighbours lie on one surface."""

    NAME = "scan"

    min_range_m: float = 0.05
    max_range_m: float = 30.0  # beyond it, the points of a 1 degree laser lie half a metre apart
    surface_gap: float = setting(
        0.1, at_most=1
    )  # neighbouring readings farther apart, as a share of the range, are two surfaces
    wall_std_m: float = 0.03  # unless they lie on one line within this: a wall seen at a grazing angle


@dataclass(frozen=True)
class GridConfig(Block):
    """The grids that scans are matched on, and the map that is written."""

    NAME = "grid"

    cell_size_m: float = setting(0.05, above=0)
    insert_every_m: float = 0.05
    insert_every_rad: float = 0.05
    spot_m: float = setting(1.0, above=0)  # of the scans from one spot, one goes into a grid that is built of many
    spot_rad: float = setting(0.7, above=0)
    # A cell of the map is occupied if at least this share of its beams returned from it. With a half, walls would
    # disappear: a wall fills only a part of its cells, range noise puts half of its returns into the next cell, and a
    # beam that grazes it passes three cells of its surface or more before it returns. A person who walked through is
    # seen in a cell a few times, the floor there a hundred times: that share is well below a quarter.
    occupied_share: float = setting(0.25, above=0, at_most=1)
    align: bool = False  # turn the map so that most of its walls run along its axes


@dataclass(frozen=True)
class MatchConfig(Block):
    """Gauss-Newton on surfaces, and the score."""

    NAME = "match"

    reach_m: float = setting(0.2, above=0)
    half_weight_m: float = setting(0.1, above=0)
    distance_std_m: float = setting(0.03, above=0)
    iterations: int = setting(12, above=0)
    convergence_m: float = 1e-4
    widening: float = setting(2.0, above=0)
    min_score: float = setting(0.85, at_most=1)  # IGO (2): the share of matched beams of a good estimate
    min_points: int = 20  # a scan with fewer points is too little evidence against the odometry


@dataclass(frozen=True)
class MotionConfig(Block):
    """The odometry model, IGO (1): standard deviations that grow with the reported motion, above a floor."""

    NAME = "motion"

    use_odometry: bool = True
    translation_std_per_m: float = 0.2
    translation_std_per_rad: float = 0.05
    rotation_std_per_rad: float = 0.4
    rotation_std_per_m: float = 0.2
    min_translation_std_m: float = setting(0.02, above=0)
    min_rotation_std_rad: float = setting(0.03, above=0)
    hypotheses: int = 30
    doubt_spread: float = 3.0  # how much wider than the model hypotheses are drawn: in doubt, the model may be wrong
    # By how much the score of a hypothesis three standard deviations or more away must exceed the prediction's. There
    # the log prior has fallen by 4.5, and of the beams, which are not independent, some 30 count: 4.5 / 30.
    prior_weight: float = 0.15


@dataclass(frozen=True)
class KeyNodeConfig(Block):
    """Nodes and key-nodes (IGO III-B)."""

    NAME = "key_nodes"

    node_every_m: float = setting(0.25, above=0)
    node_every_rad: float = setting(0.25, above=0)
    trajectory_length_m: float = setting(5.0, above=0)  # T_l
    member_length_m: float = (
        25.0  # how far along graph and trajectory a key-node may be to take part in the global grid
    )
    near_m: float = 20.0  # nearer key-nodes are in the global grid, or are removed from it


@dataclass(frozen=True)
class LoopConfig(Block):
    """Loop search and its verification (IGO III-C)."""

    NAME = "loops"

    enabled: bool = True
    min_separation_m: float = 10.0  # trajectory between two places that may form a loop
    gate_quantile: float = setting(0.99, above=0, below=1)  # of chi-square with 3 degrees of freedom, IGO (5)
    view_std_m: float = 2.5  # how far apart two poses may be and still see the same walls
    guess_every_m: float = setting(0.05, above=0)
    drift_per_m: float = 0.02  # guards the ellipse against over-confident edges
    most_turn_rad: float = setting(0.6, above=0)  # no search for a loop turns the robot by more
    strain_m: float = 0.06  # a loop edge to a known key-node that disagrees by more calls for an optimization
    strain_rad: float = 0.02
    farthest_m: float = 60.0  # the greatest distance at which relocation looks for the robot after drift
    certain_std_m: float = setting(0.1, above=0)  # below these two, Gauss-Newton alone finds the match
    certain_std_rad: float = setting(0.05, above=0)
    min_likelihood: float = setting(0.45, at_most=1)
    min_score: float = setting(0.55, at_most=1)
    min_agreement: float = setting(0.9, at_most=1)
    min_overlap: float = setting(0.35, at_most=1)
    min_observability: float = setting(0.05, at_most=1)
    retry_every_m: float = 1.0
    confirm_after_m: float = 1.5
    confirm_m: float = 0.2
    confirm_rad: float = 0.05
    tie_weight: float = 0.03
    tune: bool = False  # let the scans decide which loops count (MC section V): --robust auto


@dataclass(frozen=True)
class IgoConfig(Block):
    """Iterative graph optimization (IGO IV)."""

    NAME = "igo"

    rounds: int = 5  # the paper's iter
    same_m: float = 0.02  # an edge whose match returns within these two is unchanged
    same_rad: float = 0.007
    clear_gain: float = setting(0.05, at_most=1)  # a match that fits better by this needs no other reason to be taken
    after_open_m: float = 3.0  # by laser alone, edges this far behind an open one may be biased too
    speed_from_m: float = 12.0  # by laser alone, the speed of an open edge is estimated from this much before it
    long_open_m: float = 3.0  # by laser alone, a shorter open stretch is open only if its length clearly changed
    settled_share: float = 0.01  # of chi2, which for a sound graph is about the number of nodes: epsilon of Algorithm 1


@dataclass(frozen=True)
class ConsistencyConfig(Block):
    """The consistency measure and its test (MC III and IV)."""

    NAME = "consistency"

    min_range_m: float = 0.05
    max_range_m: float = setting(8.0, above=0)  # beyond it, points are too sparse; free space up to it still counts
    min_points: int = setting(10, above=0)  # inconsistent points that a pair must keep to be tested
    drop_points: int = 10  # a pair's largest depths, left out of its test: people, glass, bad readings
    drop_share: float = setting(0.1, at_most=1)
    neighbours: int = setting(20, above=0)  # scans before and after along the odometry that a scale is estimated from
    neighbours_m: float = 6.0  # and no farther than this: key scans are metres apart, with drift between them
    most_scale_m: float = setting(0.2, above=0)  # scans of one pass that differ by more show two walls, not noise
    range_std_m: float = setting(0.01, above=0)  # the laser's noise, where no odometry edges show the scans' noise
    same_pass_m: float = 15.0  # scans no farther apart along the odometry belong to one pass
    scale_level: float = setting(0.05, above=0, below=1)  # (10): pairs along the odometry all pass at this level
    prior_std_m: float = setting(0.03, above=0)  # the error of an optimized pose, added to every scale
    least_inflation: float = setting(0.4, above=0)  # how far the pairs of one pass may narrow or widen the scales
    most_inflation: float = 2.0
    pair_level: float = setting(0.01, above=0, below=1)
    scan_level: float = setting(0.01, above=0, below=1)
    scan_dependence: float = setting(0.07, below=1)  # correlation between the tests of one scan's pairs
    map_level: float = setting(0.01, above=0, below=1)
    map_dependence: float = setting(0.04, below=1)  # and between the scans of one map


@dataclass(frozen=True)
class GMappingConfig(Block):
    """The particle filter, with the names that GMapping's users know; ``r`` is translation, ``t`` rotation."""

    NAME = "gmapping"

    particles: int = setting(30, above=0)
    linear_update_m: float = 1.0
    angular_update_rad: float = 0.5
    srr: float = 0.1  # standard deviation of the odometry's translation, m per metre
    srt: float = 0.2  # of its translation, m per radian
    str: float = 0.1  # of its rotation, rad per metre
    stt: float = 0.2  # of its rotation, rad per radian
    minimum_score: float = setting(0.3, at_most=1)  # the share of the beams below which only the odometry is used
    resample_threshold: float = setting(0.5, at_most=1)  # resampled where the effective sample size is below this share
    lsigma_m: float = setting(0.075, above=0)  # standard deviation of a beam
    ogain: float = setting(3.0, above=0)  # log-likelihoods are divided by it: neighbouring beams are not independent


@dataclass(frozen=True)
class Config:
    """All settings, by blocks; ``seed`` feeds the hypotheses and the particles.

    Raises InputError for blocks that do not go together. Other settings than the defaults: `with_settings`.
    """

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

    def __post_init__(self) -> None:
        for name, kind in _BLOCKS.items():
            if not isinstance(getattr(self, name), kind):
                raise wrong(name, getattr(self, name), f"a {kind.__name__}")
        object.__setattr__(self, "seed", checked("seed", 0, Bounds(), self.seed))
        _check_together(self)

    def with_settings(self, values: Mapping[str, Any]) -> Config:
        """The same with other values, by dotted names: ``config.with_settings({"loops.tune": True})``.

        All values are put in together, then checked. Raises InputError for a name that there is not, naming the nearest
        that there is, and for values that are not allowed.
        """
        tables: dict[str, dict[str, Any]] = {}
        known = _names()
        for name, value in values.items():
            if name not in known:
                raise InputError(None, f"unknown key '{name}'", _nearest(name, known))
            block, _, key = name.rpartition(".")
            tables.setdefault(block, {})[key] = value
        own = tables.pop("", {})
        return replace(self, **own, **{name: replace(getattr(self, name), **new) for name, new in tables.items()})


_BLOCKS: dict[str, type[Block]] = {
    kind.NAME: kind
    for kind in (
        ScanConfig,
        GridConfig,
        MatchConfig,
        MotionConfig,
        KeyNodeConfig,
        LoopConfig,
        IgoConfig,
        ConsistencyConfig,
        GMappingConfig,
    )
}


def _names() -> list[str]:
    """All settings by their dotted names."""
    return ["seed", *(f"{name}.{one.name}" for name, kind in _BLOCKS.items() for one in fields(kind))]


def _nearest(name: str, known: Sequence[str]) -> str:
    """What to write instead of a name that there is not."""
    from difflib import get_close_matches

    block = name.partition(".")[0]
    near = get_close_matches(name, known, 1, 0.7)
    if near:
        return f"the nearest is '{near[0]}'"
    if block in _BLOCKS:
        return f"known are {', '.join(sorted(one.name for one in fields(_BLOCKS[block])))}"
    return f"known are {', '.join([*_BLOCKS, 'seed'])}"


def _check_together(config: Config) -> None:
    """Raises InputError for settings that do not go together."""
    scan, check, grid = config.scan, config.consistency, config.grid
    for name, nearest, farthest in (
        ("scan", scan.min_range_m, scan.max_range_m),
        ("consistency", check.min_range_m, check.max_range_m),
    ):
        if nearest >= farthest:
            raise wrong(f"{name}.max_range_m", farthest, f"more than {name}.min_range_m, {nearest:g}")
    if scan.min_range_m >= check.max_range_m:
        raise wrong("consistency.max_range_m", check.max_range_m, f"more than scan.min_range_m, {scan.min_range_m:g}")
    known_m = REACH_CELLS * grid.cell_size_m
    if config.match.reach_m > known_m * (1.0 + 1e-9):
        most = f"at most {known_m:g}: a cell knows its nearest surface within {REACH_CELLS} cells of grid.cell_size_m"
        raise wrong("match.reach_m", config.match.reach_m, f"{most}, {grid.cell_size_m:g}")
    if check.least_inflation > check.most_inflation:
        least = f"{check.least_inflation:g} (consistency.least_inflation) or more"
        raise wrong("consistency.most_inflation", check.most_inflation, least)
    length = config.key_nodes.trajectory_length_m
    separation = config.loops.min_separation_m
    if separation < GRID_LENGTHS * length:
        least = f"at least {GRID_LENGTHS * length:g}, {GRID_LENGTHS:g} times key_nodes.trajectory_length_m, {length:g}"
        raise wrong("loops.min_separation_m", separation, f"{least}: a nearer scan may be in the grid it is matched on")


def require_config(config: object) -> None:
    """Raises MapmendError for anything but a `Config`, such as one of its blocks."""
    if not isinstance(config, Config):
        raise MapmendError(f"the settings must be a Config, got {type(config).__name__}")


def to_dict(config: Config) -> dict[str, Any]:
    """Plain tables, as in TOML and JSON."""
    return asdict(config)


def from_dict(tables: Mapping[str, Any], source: str | None = None) -> Config:
    """A configuration from plain tables; unknown keys and values of the wrong type or size raise InputError."""
    values: dict[str, Any] = {}
    for name, value in tables.items():
        if name not in _BLOCKS:
            values[name] = value
        elif isinstance(value, Mapping):
            values |= {f"{name}.{key}": one for key, one in value.items()}
        else:
            raise InputError(source, f"'{name}' must be a table", f"write [{name}]")
    try:
        return Config().with_settings(values)
    except InputError as error:
        raise InputError(source, error.what, error.mend) from None


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
    "MatchConfig",
    "MotionConfig",
    "ScanConfig",
    "from_dict",
    "read_toml",
    "require_config",
    "to_dict",
    "to_toml",
]
