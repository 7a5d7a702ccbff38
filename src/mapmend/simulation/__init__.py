"""Buildings, robots and their ground truth."""

from mapmend.simulation.drive import SlipEvent
from mapmend.simulation.robot import LaserModel, OdometryModel, Simulation, first_scans, simulate
from mapmend.simulation.world import WORLDS, World, corridor_loop, office_floor, random_building, world_named

__all__ = [
    "WORLDS",
    "LaserModel",
    "OdometryModel",
    "Simulation",
    "SlipEvent",
    "World",
    "corridor_loop",
    "first_scans",
    "office_floor",
    "random_building",
    "simulate",
    "world_named",
]
