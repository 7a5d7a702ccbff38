"""What a person chooses about a bag."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BagOptions:
    """Topics and frame by name, None where the bag leaves one choice; ``deskew`` straightens sweeps."""

    scan_topic: str | None = None
    odom_topic: str | None = None
    base_frame: str | None = None
    deskew: bool = False

    @property
    def any_given(self) -> bool:
        return self != BagOptions()
