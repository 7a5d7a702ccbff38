"""How a setting is declared: its default and its bounds beside it; without bounds, any number from 0 on."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from typing import Any, ClassVar

from mapmend.errors import InputError

BOUNDS = "bounds"


@dataclass(frozen=True)
class Bounds:
    """An interval of numbers, each end open or closed."""

    low: float = 0.0
    high: float = sys.float_info.max
    low_is_open: bool = False
    high_is_open: bool = False

    def hold(self, value: float) -> bool:
        """Whether the value is within the bounds; NaN never is."""
        above = self.low < value if self.low_is_open else self.low <= value
        return above and (value < self.high if self.high_is_open else value <= self.high)

    def text(self) -> str:
        """The bounds in words."""
        words = f"{'above' if self.low_is_open else 'not below'} {self.low:g}"
        if self.high == sys.float_info.max:
            return words
        return f"{words} and {'below' if self.high_is_open else 'not above'} {self.high:g}"


def setting(
    default: Any, *, above: float | None = None, below: float | None = None, at_most: float = sys.float_info.max
) -> Any:
    """A field with this default that takes numbers within the bounds; without ``above``, numbers from 0 on."""
    low, high = (0.0 if above is None else above), (at_most if below is None else below)
    return field(default=default, metadata={BOUNDS: Bounds(low, high, above is not None, below is not None)})


@dataclass(frozen=True)
class Block:
    """A frozen dataclass of settings, checked when it is made; ``NAME`` is its table in TOML.

    A setting is a bool, an int or a float, as its default is. Raises InputError for any other value, for NaN and
    infinities, and for values out of bounds. Whole numbers for a float become floats.
    """

    NAME: ClassVar[str]

    def __post_init__(self) -> None:
        for one in fields(self):
            bounds = one.metadata.get(BOUNDS, Bounds())
            value = checked(f"{self.NAME}.{one.name}", one.default, bounds, getattr(self, one.name))
            object.__setattr__(self, one.name, value)


def checked(name: str, default: Any, bounds: Bounds, value: Any) -> Any:
    """The value in the type of the default; raises InputError naming the setting, the value and what is allowed."""
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise wrong(name, value, "true or false")
        return value
    kind, whole = (Integral, " whole") if isinstance(default, int) else (Real, "")
    if not isinstance(value, kind) or isinstance(value, bool):
        raise wrong(name, value, f"a{whole} number {bounds.text()}")
    number = int(value) if isinstance(value, Integral) else float(value)  # NumPy's numbers too
    if not bounds.hold(number):
        raise wrong(name, value, f"a{whole} number {bounds.text()}")
    return type(default)(number)


def wrong(name: str, value: Any, allowed: str) -> InputError:
    """The error about a setting's value, in one line."""
    return InputError(None, f"'{name}' is {value!r}", f"give {allowed}")
