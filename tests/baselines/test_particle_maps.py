"""Maps shared by particles: each must have the same content as without sharing."""

import numpy as np
import pytest

from mapmend.baselines.particle_maps import ParticleMaps
from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.grid._kernels import cell_at
from mapmend.grid.likelihood import likelihood_field
from mapmend.grid.surface import SurfaceGrid
from tests.baselines.maps import contents_of
from tests.grid.contents import Contents
from tests.matching.scenes import Scene

LASER = np.array([0.1, 0.0, 0.0])
SIZE_M = 0.05


@pytest.fixture(scope="module")
def scene():
    return Scene(3)


def insert(maps, points, poses):
    maps.claim(points, LASER, poses)
    for p, pose in enumerate(poses):
        maps.insert(p, points, LASER, pose)


def test_a_particle_alone_has_the_surface_grid_with_all_beams_clearing(scene):
    maps, grid = ParticleMaps(1, SIZE_M), SurfaceGrid(SIZE_M, clearing_stride=1)
    for k, pose in enumerate(scene.poses[::3]):
        points = scene.scan_at(pose, k)
        insert(maps, points, pose[None])
        grid.insert(points, LASER, pose)
    mine, theirs = contents_of(maps, 0), Contents(grid)
    # Where a beam cuts the corner of a tile on its way, that tile is not claimed for it.
    differing = [cell for cell, value in theirs.evidence.items() if mine.evidence.get(cell) != value]
    assert len(differing) < 0.002 * len(theirs.evidence)
    same = [cell for cell in theirs.mean if cell not in differing and mine.mean.get(cell) == theirs.mean[cell]]
    assert len(same) > 0.998 * len(theirs.mean)
    assert sum(mine.nearest.get(cell) == there for cell, there in theirs.nearest.items()) > 0.998 * len(theirs.nearest)


def test_shared_tiles_change_for_nobody_else(scene):
    random = np.random.default_rng(5)
    count, rounds = 5, 6
    maps = ParticleMaps(count, SIZE_M)
    history = [[] for _ in range(count)]
    for turn in range(rounds):
        pose = scene.poses[4 * turn]
        points = scene.scan_at(pose, turn)
        poses = pose + random.normal(0.0, 0.1, (count, 3))
        insert(maps, points, poses)
        for p in range(count):
            history[p] = [*history[p], (points, poses[p])]
        parents = np.sort(random.integers(0, count, count))
        maps.resample(parents)
        history = [history[parent] for parent in parents]
    for p in range(count):
        alone = ParticleMaps(1, SIZE_M)
        for points, pose in history[p]:
            insert(alone, points, pose[None])
        assert contents_of(maps, p) == contents_of(alone, 0)


def test_a_robot_that_jumps_off_the_earth_is_refused(scene):
    maps = ParticleMaps(30, SIZE_M)
    with pytest.raises(MapmendError, match="correct the jumps"):
        maps.claim(scene.scan_at(scene.here, 1), LASER, np.tile([1e5, 1e5, 0.0], (30, 1)))


def test_particles_of_one_parent_share_all_tiles_until_they_write(scene):
    maps = ParticleMaps(20, SIZE_M)
    points = scene.scan_at(scene.here, 1)
    insert(maps, points, np.tile(scene.here, (20, 1)))
    apart = maps.tiles_in_use
    maps.resample(np.zeros(20, dtype=np.int64))
    assert maps.tiles_in_use == apart // 20
    # What is near touches some tiles only: those alone are copied.
    near = points[np.hypot(points[:, 0], points[:, 1]) < np.quantile(np.hypot(points[:, 0], points[:, 1]), 0.2)]
    insert(maps, near, np.tile(scene.here, (20, 1)))
    written = [len(np.unique(maps.shared.tables[:, r, c])) for r, c in np.argwhere(maps.shared.tables[0] >= 0)]
    assert set(written) == {1, 20}
    assert maps.tiles_in_use == sum(written)


def test_the_likelihood_field_of_a_particle_is_that_of_its_surfaces(scene):
    """By names of neighbours across tiles as by numbers of cells; a shared tile and a copied one alike."""
    maps = ParticleMaps(2, SIZE_M)
    for k, pose in enumerate(scene.poses[:12:3]):
        insert(maps, scene.scan_at(pose, k), np.stack((pose, se2.compose(pose, [0.03, 0.0, 0.0]))))
    for p in range(2):
        content, tiles = contents_of(maps, p), maps.of(p)
        numbers = np.full(len(tiles.nearest), -1, dtype=np.int32)
        for (row, column), (there_row, there_column) in content.nearest.items():
            cell, there = (
                cell_at(tiles.table, tiles.frame, r, c) for r, c in ((row, column), (there_row, there_column))
            )
            numbers[cell] = there
        by_number = tiles._replace(nearest=numbers, references=None)
        expected, found = likelihood_field(by_number, 0.1), likelihood_field(maps.of(p), 0.1)
        assert found.origin == expected.origin
        for level, other in zip(found.levels, expected.levels, strict=True):
            np.testing.assert_array_equal(level, other)
        assert found.levels[0].max() > 200
