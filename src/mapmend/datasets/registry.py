"""The public logs that mapmend knows by name. Addresses are pinned to commits, contents to their sha256."""

from __future__ import annotations

from dataclasses import dataclass

_RADISH = (
    "https://raw.githubusercontent.com/MOLAorg/mola_test_datasets/13a2ed141116bc654e14ffca1d88fb740b3d1253"
    "/datasets/radish/"
)
_RELATIONS = (
    "https://raw.githubusercontent.com/xiaofeng419/SLAM-2D-LIDAR-SCAN/d469252f5b33e574bd239ad2625779497ac1d4cc"
    "/DataSet/RawData/"
)
_FLIRT = "https://raw.githubusercontent.com/tipaldi/flirtlib/f608c8c486b53320a5fc701de6d70e7e803c412c/data/"

_CC_BY = "CC-BY 3.0"
_UNSTATED = "none stated for the data by the repository that they come from"
_KUEMMERLE = (
    "R. Kümmerle, B. Steder, C. Dornhege, M. Ruhnke, G. Grisetti, C. Stachniss, A. Kleiner: On measuring the accuracy "
    "of SLAM algorithms. Autonomous Robots 27(4), 2009"
)
_HOWARD = "A. Howard, N. Roy: The Robotics Data Set Repository (Radish), 2003"
_TIPALDI = "G. D. Tipaldi, K. O. Arras: FLIRT - Interest regions for 2D range data. ICRA 2010"


@dataclass(frozen=True)
class RemoteFile:
    """One file: its name in the cache, its address, its content's hash, and its size where that is known."""

    name: str
    url: str
    sha256: str
    size_bytes: int | None = None


@dataclass(frozen=True)
class Dataset:
    """A log or a graph, and its true relations if there are any. The name stands for the first file."""

    name: str
    what: str
    files: tuple[RemoteFile, ...]
    licence: str
    citation: str


def _radish(name: str, sha256: str, size_bytes: int) -> RemoteFile:
    return RemoteFile(name, _RADISH + name, sha256, size_bytes)


def _flirt(name: str, sha256: str) -> RemoteFile:
    return RemoteFile(name, _FLIRT + name, sha256)


DATASETS = (
    Dataset(
        "intel",
        "Intel Research Lab, Seattle: log of 13,631 scans, 45 minutes; true relations",
        (
            _radish("intel.clf.bz2", "d9ce4addefc9405d5e78fd883d2214766552537d262009f8e6f0137885f9f72a", 2_277_279),
            RemoteFile(
                "intel.relations",
                _RELATIONS + "intel.relations",
                "330378f153eeae652d6756c1746f335801f66c3e097d90611548e6c4f593c359",
            ),
        ),
        _CC_BY,
        f"{_HOWARD}; {_KUEMMERLE}",
    ),
    Dataset(
        "fr079",
        "Freiburg, building 079: log of 4,934 scans, 18 minutes; true relations",
        (
            _radish("fr079.clf.bz2", "9c3930e17957889c24986390dc7fe3eeddd3d7019a8172085dbed8a28a0e6b77", 1_522_745),
            RemoteFile(
                "fr079.relations",
                _RELATIONS + "fr079.relations",
                "7e7f06b4aca455cb68f1f23d04e7c7316c5e17773e872734c860ed7a274cdfc7",
            ),
        ),
        _CC_BY,
        f"{_HOWARD}; {_KUEMMERLE}",
    ),
    Dataset(
        "aces",
        "ACES building, University of Texas at Austin: log; true relations",
        (
            _radish("aces.clf.bz2", "b663e2976ed0621c2bec0cc20c4e7cc117b88db5bac6f921d3fbaa9685d2232a", 839_027),
            _radish("aces.relations", "11a15800a751b6f9413078a021d49c7cda85a768c2a465433b4fae7ef57b03d5", 99_426),
        ),
        _CC_BY,
        f"{_HOWARD}; {_KUEMMERLE}",
    ),
    Dataset(
        "mit-csail",
        "MIT CSAIL building: log",
        (_radish("mit-csail.clf.bz2", "e010703e450a20e71a97b0e8de88d9474040c8106e547ff894d885e67a309b47", 539_615),),
        _CC_BY,
        f"{_HOWARD}; {_KUEMMERLE}",
    ),
    Dataset(
        "fr-clinic",
        "Freiburg clinic, outdoors: log of 6,917 scans, 80 minutes",
        (
            _radish(
                "fr-clinic_robotlaser.clf.bz2",
                "f1123753be7308178547d487df96dfc230669a55c21253c3225c7627b124d6d8",
                1_719_679,
            ),
        ),
        _CC_BY,
        f"{_HOWARD}; {_KUEMMERLE}",
    ),
    Dataset(
        "intel-graph",
        "Intel Research Lab: pose graph of 2,672 nodes with their scans",
        (_flirt("intel-lab.log", "dedb8eb20ca4d12ceecf7e8c0560c421de3ab9e8bcc7f8eeac4e51f9c48b21de"),),
        _UNSTATED,
        _TIPALDI,
    ),
    Dataset(
        "fr079-graph",
        "Freiburg, building 079: pose graph of 1,464 nodes with their scans",
        (_flirt("fr079.log", "3e07d3994f66d7835cbf9243434922f120a5ec86ad36e74c151258206af057b6"),),
        _UNSTATED,
        _TIPALDI,
    ),
    Dataset(
        "mit-csail-graph",
        "MIT CSAIL building: pose graph with scans",
        (_flirt("mit-cscail.log", "1ef7aec635972af450716e53f05ea1ffc844ceaa6b5edec32270cc1919b4bf14"),),
        _UNSTATED,
        _TIPALDI,
    ),
)


def find(name: str) -> Dataset | None:
    """The dataset of this name; None if there is none."""
    return next((dataset for dataset in DATASETS if dataset.name == name), None)


def find_file(name: str) -> RemoteFile | None:
    """The file that a name stands for: the log or graph of a dataset, or a file of a dataset by its own name."""
    dataset = find(name)
    if dataset is not None:
        return dataset.files[0]
    return next((file for dataset in DATASETS for file in dataset.files if file.name == name), None)
