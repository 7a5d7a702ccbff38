"""The user's choices for a bag."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BagOptions:
    """Topics and frame by name, None if the bag has only one of the kind; ``deskew``: whether sweeps are de-skewed."""

    scan_topic: str | None = None
    odom_topic: str | None = None
    base_frame: str | None = None
    deskew: bool = False

    @property
    def any_given(self) -> bool:
        return self != BagOptions()
