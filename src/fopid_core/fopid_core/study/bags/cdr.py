"""Numbers out of serialized ROS messages (CDR), all messages of a topic at once.

A message is laid out by its type's fields, each aligned to its own size, and by the lengths it holds of its texts and
sequences (DDSI-RTPS 2.3, 10.2). Messages with equal lengths have their numbers in the same places: one view
into all of them reads a column. Own, because rosbags makes an object of each message, which takes 8 times as long.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from fopid_core.errors import InputError

Column = NDArray[Any]
Fields = Mapping[str, tuple[Any, Any]]
"""Type name -> its constants and fields, as the rosbags library parses definitions."""

_ENCAPSULATION = 4  # bytes before the message; alignment counts from behind them
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # other encapsulations align their fields in another way
_PADDING = 3  # bytes that a middleware may append
_KINDS = {
    "bool": "u1", "byte": "u1", "octet": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip


def columns(messages: Sequence[bytes], type_name: str, fields: Fields) -> dict[str, Column]:
    """Every number of the messages.

    Parameters
    ----------
    messages : sequence of bytes
        All of one type, each with its encapsulation header.
    type_name : str
    fields : mapping
        Of this type and those within it.

    Returns
    -------
    dict
        Path such as ``header.stamp.sec`` or ``data[2]`` -> array of shape (messages,), in the type's own numbers;
        as floats, with NaN where a message is too short for the path, when lengths differ.

    Raises
    ------
    InputError
        If a type is not known, or a message is shorter or longer than it says or encapsulated in another way.

    Examples
    --------
    >>> from rosbags.typesys import Stores, get_typestore
    >>> fields = get_typestore(Stores.ROS2_JAZZY).fielddefs
    >>> columns([bytes.fromhex("00010000" "000000000000f03f")], "std_msgs/msg/Float64", fields)
    {'data': array([1.])}
    """
    sizes = np.array([len(message) for message in messages])
    left = np.arange(len(messages))
    parts: list[tuple[NDArray[np.intp], dict[str, Column]]] = []
    while left.size:
        layout = _Layout(messages[int(left[0])], type_name, fields)
        like = left[sizes[left] == sizes[left[0]]]
        block = np.frombuffer(b"".join([messages[i] for i in like.tolist()]), np.uint8).reshape(like.size, -1)
        same = layout.fits(block)
        parts.append((like[same], layout.read(block[same])))
        left = np.setdiff1d(left, like[same], assume_unique=True)
    if len(parts) == 1:
        return parts[0][1]
    found: dict[str, Column] = {}
    for at, part in parts:
        for path, column in part.items():
            found.setdefault(path, np.full(len(messages), np.nan))[at] = column
    return found


class _Layout:
    """Where the numbers of a message are, and of all others that hold the same lengths."""

    def __init__(self, message: bytes, type_name: str, fields: Fields) -> None:
        self._message, self._fields, self._type_name = message, fields, type_name
        self._at = 0
        self._take(_ENCAPSULATION)
        encapsulation = bytes(message[:2])
        if encapsulation not in _ORDERS:
            found = f"encapsulation = 0x{encapsulation.hex()} of a message of type {type_name}"
            raise InputError(f"{found}; allowed: 0x0000, 0x0001 (plain CDR)")
        self._order = _ORDERS[encapsulation]
        self._places: dict[str, tuple[int, str]] = {}
        self._lengths: list[slice] = [slice(0, 2)]
        self._walk("", type_name)
        if len(message) - self._at > _PADDING:
            raise InputError(f"a message of type {type_name} is damaged: it is longer than its definition says")

    def fits(self, block: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Which messages of the same size, one a row, hold the same lengths."""
        own = np.frombuffer(self._message, np.uint8)
        fitting = np.ones(len(block), dtype=np.bool_)
        for part in self._lengths:
            fitting &= np.all(block[:, part] == own[part], axis=1)
        return fitting

    def read(self, block: NDArray[np.uint8]) -> dict[str, Column]:
        def column(at: int, kind: str) -> Column:
            dtype = np.dtype(self._order + kind)
            return block[:, at : at + dtype.itemsize].copy().view(dtype).ravel().astype(dtype.newbyteorder("="))

        return {path: column(*place) for path, place in self._places.items()}

    def _walk(self, path: str, type_name: str) -> None:
        if type_name not in self._fields:
            raise InputError(f"message type {type_name!r} is not defined in the bag, or is wide text")
        for name, (kind, detail) in self._fields[type_name][1]:
            self._field(f"{path}.{name}" if path else name, kind, detail)

    def _field(self, path: str, kind: Nodetype, detail: Any) -> None:
        if kind == Nodetype.NAME:
            self._walk(path, detail)
        elif kind == Nodetype.BASE and detail[0] == "string":
            self._take(self._length())
        elif kind == Nodetype.BASE:
            number = _KINDS[detail[0]]
            self._align(int(number[1]))
            self._places[path] = (self._take(int(number[1])), number)
        else:
            element, count = detail[0], detail[1] if kind == Nodetype.ARRAY else self._length()
            for i in range(count):
                self._field(f"{path}[{i}]", *element)

    def _length(self) -> int:
        """Of a text or a sequence; no element is smaller than a byte."""
        self._align(4)
        start = self._take(4)
        self._lengths.append(slice(start, self._at))
        length = int(struct.unpack_from(f"{self._order}I", self._message, start)[0])
        self._check(self._at + length)
        return length

    def _align(self, size: int) -> None:
        self._at += -(self._at - _ENCAPSULATION) % size

    def _take(self, size: int) -> int:
        """Where the next so many bytes are."""
        start, self._at = self._at, self._at + size
        self._check(self._at)
        return start

    def _check(self, end: int) -> None:
        if end > len(self._message):
            raise InputError(f"a message of type {self._type_name} is damaged: it is shorter than it says")
