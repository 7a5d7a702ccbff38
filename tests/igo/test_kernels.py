"""The information that scan and grid have in common, against the plain twin and against noise."""

import numpy as np
import pytest

from mapmend.igo import _kernels
from tests.grid.contents import Contents
from tests.matching.scenes import scene
from tests.reference import igo as reference

SIZE_M, REACH_M, HALF_WEIGHT_M = 0.05, 0.2, 0.1


@pytest.mark.parametrize("seed", range(4))
def test_shared_normals_are_those_of_the_plain_twin(seed):
    s = scene(seed)
    points, axis = s.scan_at(s.here, 7), np.array([0.6, 0.8])
    pose = s.here + np.array([0.03, -0.02, 0.01])
    result = _kernels.shared_normals(s.grid.tiles, points, pose, axis, REACH_M, HALF_WEIGHT_M)
    terms = reference.shared_normals(Contents(s.grid), points, pose, axis, SIZE_M, REACH_M, HALF_WEIGHT_M)
    assert len(terms) > 100
    np.testing.assert_allclose(result, (terms.sum(), (terms**2).sum()), rtol=1e-6)
