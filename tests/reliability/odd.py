"""Values that nobody sensible sends, for any field of any message."""

from __future__ import annotations

import importlib
import random
import re
from typing import Any

TEXTS = (
    "", " ", "x" * 100_000, "(" * 50_000, "1/(" * 1_000, "1/(s+1)^" + "9" * 400, "exp(-" * 300 + "s" + ")" * 300,
    "Größe 漢字 \U0001f600", "two\nlines", "../../../etc/passwd", "/dev/stdin", "%s%n{}", "nan", "1/(s+1)", "P1",
)  # fmt: skip
NUMBERS = (
    float("nan"), float("inf"), float("-inf"), 0.0, -0.0, -1.0, 1e308, -1e308, 1e-320, 1e100, 0.5, 1.0,
)  # fmt: skip
LENGTHS = (0, 1, 3, 1_000)
IN_LISTS = 100
"""Characters of a text in a list at most: a million of 1,000 are a request of a third of a gigabyte."""
WHOLE = re.compile(r"(u?)int(8|16|32|64)")


def whole(draw: random.Random, unsigned: bool, bits: int) -> int:
    """A border of a type of whole numbers."""
    low, high = (0, 2**bits - 1) if unsigned else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return draw.choice((low, high, 0, 1, high - 1))


def odd(draw: random.Random, kind: str, most: int = 1_000_000) -> Any:
    """A value of a field, whose type is named as ROS names it."""
    if listed := re.fullmatch(r"sequence<([^,]+)(?:, \d+)?>", kind):
        count = draw.choice((*LENGTHS, most) if draw.random() < 0.1 else LENGTHS)
        few = [odd(draw, listed[1], 3) for _ in range(min(count, 3))]
        few = [value[:IN_LISTS] if isinstance(value, str) else value for value in few]
        return (few * (count // 3 + 1))[:count] if few else []
    if fixed := re.fullmatch(r"(.+)\[(\d+)\]", kind):
        return [odd(draw, fixed[1]) for _ in range(int(fixed[2]))]
    if bounded := WHOLE.fullmatch(kind):
        return whole(draw, bool(bounded[1]), int(bounded[2]))
    if "/" in kind:
        package, name = kind.split("/")
        return filled(draw, getattr(importlib.import_module(f"{package}.msg"), name)(), most)
    simple = {"boolean": (True, False), "octet": (b"\0", b"\xff"), "string": TEXTS}
    return draw.choice(simple.get(kind, NUMBERS))


def filled(draw: random.Random, message: Any, most: int = 1_000_000) -> Any:
    """A message with something odd in most of its fields."""
    for field, kind in message.get_fields_and_field_types().items():
        if draw.random() < 0.7:
            within = getattr(message, field)
            is_message = hasattr(within, "get_fields_and_field_types")
            setattr(message, field, filled(draw, within, most) if is_message else odd(draw, kind, most))
    return message
