"""One file for each command, with its name: ``add_arguments(parser)`` and ``run(args)``, which returns the exit code.

A command's file imports what its work needs inside its functions, so that its ``--help`` is as fast as that of mapmend.
``common/`` holds the code that commands share.
"""

SUMMARIES = {
    "demo": "simulate a building with a slippery corridor, map it by each method, and compare with the truth",
    "info": "say what a log, graph, trajectory or map holds, and what is odd about it",
    "map": "map a log: trajectory, pose graph with scans, and occupancy map in a RUN folder",
    "optimize": "move the nodes of a pose graph to where they agree best with its edges",
    "compare": "map a log by several methods: error, seconds, memory and verdict of each, and a picture of all maps",
    "check": "say whether a map is consistent, and where it is not: exit code 0 for yes, 1 for no",
    "tune": "find the kernel parameter that gives the most consistent map: exit code 1 where no map is consistent",
    "eval": "measure the errors of a trajectory against true relations or a reference trajectory",
    "convert": "write a log, graph or trajectory in another format",
    "datasets": "list public logs, or fetch them by name",
    "simulate": "drive a robot through a building and write its log, the truth and a picture",
    "report": "write one HTML page of a RUN: its map, its graph, and what the check says about it",
    "view": "replay a RUN over time in rerun: the robot, its scans, the graph as it grows, the map",
}
"""The commands in the order of ``mapmend --help``, and what each does, in one line."""
