"""Buildings, robots and their ground truth."""

from mapmend.simulation.drive import SlipEvent
from mapmend.simulation.robot import LaserModel, OdometryModel, Simulation, simulate
from mapmend.simulation.world import World, corridor_loop, office_floor, random_building

__all__ = [
    "LaserModel",
    "OdometryModel",
    "Simulation",
    "SlipEvent",
    "World",
    "corridor_loop",
    "office_floor",
    "random_building",
    "simulate",
]
