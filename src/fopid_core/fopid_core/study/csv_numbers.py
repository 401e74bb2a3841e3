"""Numbers in the cells of csv files: with a decimal point or comma, with thousands apart, or with none."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

from fopid_core.errors import InputError

MISSING = (
    "", "nan", "null", "none", "n/a", "na", "#n/a", "-", "--", "bad", "bad input", "bad data", "no data", "no result",
    "i/o timeout", "questionable", "pt created", "calc failed", "shutdown", "scan off", "comm fail", "not connect",
)  # fmt: skip
"""What stands in a cell without a value, as spreadsheets and historians write."""
_ALIKE = 0.1
"""With its thousands apart a column spreads by less than that share of what it does with decimals."""
_NUMBER = re.compile(r"[+-]?(\d*[.,]?\d+|\d+[.,]|[1-9]\d{0,2}([.,' ]\d{3})+([.,]\d*)?)(e[+-]?\d+)?", re.IGNORECASE)


class Notation:
    """How a file writes its numbers.

    Parameters
    ----------
    cells : iterable of str
        All of it; what is no number does not count.

    Raises
    ------
    InputError
        If points and commas both are decimal.

    Examples
    --------
    >>> Notation(["50.04", "97,565"]).number("97,565"), Notation(["1,5"]).number("97,565")
    (97565.0, 97.565)
    >>> Notation(["1.025,5", "3"]).number("1.025,5"), Notation(["50,04 %"]).number("50,04 %")
    (1025.5, 50.04)
    >>> Notation(["50.0", "97,5"])
    Traceback (most recent call last):
    ...
    fopid_core.errors.InputError: numbers '97,5' and '50.0' in one file; allowed: decimals with a comma or with a point
    """

    def __init__(self, cells: Iterable[str]) -> None:
        numbers = [cell for cell in map(_bare, cells) if _NUMBER.fullmatch(cell) and ("," in cell or "." in cell)]
        with_mark = {mark: [cell for cell in numbers if mark in cell] for mark in ",."}
        both = [cell for cell in with_mark[","] if "." in cell]
        self._decimal = "," if with_mark[","] else "."
        if both:
            self._decimal = max(",.", key=both[0].rfind)
        elif with_mark[","] and with_mark["."]:
            grouped = {mark: all(_is_grouped(cell, mark) for cell in with_mark[mark]) for mark in ",."}
            if grouped[","] == grouped["."]:
                given = f"numbers {with_mark[','][0]!r} and {with_mark['.'][0]!r} in one file"
                raise InputError(f"{given}; allowed: decimals with a comma or with a point")
            self._decimal = "." if grouped[","] else ","
        self._apart = "," if self._decimal == "." else "."

    def number(self, cell: str) -> float:
        """The number in a cell; NaN where there is none."""
        bare = _bare(cell).replace("'", "")
        if self._apart in bare and not _is_grouped(bare.partition(self._decimal)[0], self._apart):
            return math.nan
        try:
            return float(bare.replace(self._apart, "").replace(self._decimal, "."))
        except ValueError:
            return math.nan

    def of_column(self, cells: Sequence[str]) -> Notation:
        """The same, or with thousands apart where a column tells that: 988 beside 1,025."""
        bare = [cell for cell in map(_bare, cells) if _NUMBER.fullmatch(cell)]
        marked = [cell for cell in bare if self._decimal in cell]
        if len(marked) in (0, len(bare)) or not all(_is_grouped(cell, self._decimal) for cell in marked):
            return self
        other = Notation([])
        other._decimal, other._apart = self._apart, self._decimal
        spread, wide = (max(read) - min(read) for read in
                        ([notation.number(cell) for cell in bare] for notation in (other, self)))  # fmt: skip
        return other if spread < _ALIKE * wide else self


def is_missing(cell: str) -> bool:
    """Whether a cell says that it has no value."""
    return cell.strip().lower() in MISSING


def _bare(cell: str) -> str:
    return cell.strip().removesuffix("%").rstrip()


def _is_grouped(number: str, mark: str) -> bool:
    """Whether a mark can only part thousands in a number."""
    return bool(re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}({re.escape(mark)}\d{{3}})+", number))
