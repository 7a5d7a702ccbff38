"""mapmend: 2D laser SLAM that mends its own graph and tells whether the map can be trusted."""

__version__ = "0.1.0"
