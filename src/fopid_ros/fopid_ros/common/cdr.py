"""Messages of plain numbers as the transport carries them (CDR), read and written in one go.

rclpy makes an object each for a message, its header and its stamp, and calls a property for each of its fields: of a
controller at 200 Hz that was a third of the time. A type whose fields are numbers, behind a header or without one, is
one ``struct`` instead, handed to publishers and taken from raw subscriptions. What is sent in another encapsulation
than little-endian CDR goes through rclpy.
"""

from __future__ import annotations

import struct
from collections import namedtuple
from collections.abc import Callable, Iterable
from functools import cache, cached_property, partial
from operator import attrgetter
from types import SimpleNamespace
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

NS = 1_000_000_000
FORMATS = {
    "boolean": "?", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h", "uint32": "I", "int32": "i",
    "uint64": "Q", "int64": "q", "double": "d",
}  # fmt: skip
"""Not float32: rclpy makes infinity of what is too large for it, ``struct`` an error."""

ENCAPSULATION = b"\x00\x01"  # CDR, little-endian; two bytes of options follow, and alignment counts from behind them
ALIGNED_FROM = 4
_HEADER = struct.Struct("<iII")  # of std_msgs/Header: seconds, nanoseconds, the length of frame_id with its NUL
_STAMP = struct.Struct("<iI")
_BEHIND_HEADER = ALIGNED_FROM + _HEADER.size
LARGEST_ALIGNMENT = 8


@cache
def layout_of(message_type: Any) -> Layout | None:
    """How messages of a type are laid out; None where not all fields are plain numbers.

    Examples
    --------
    >>> from sensor_msgs.msg import JointState, Temperature
    >>> layout_of(Temperature).names, layout_of(JointState)
    (('temperature', 'variance'), None)
    """
    fields = dict(message_type.get_fields_and_field_types())
    if next(iter(fields)) == "header":
        fields.pop("header")
    return Layout(message_type) if fields and set(fields.values()) <= set(FORMATS) else None


@cache
def fault_finder(message_type: Any) -> Callable[[bytes], str]:
    """A function of bytes that says why they are no message of a type, empty for one: whoever publishes sends any.

    Examples
    --------
    >>> from std_msgs.msg import Float64
    >>> fault = fault_finder(Float64)
    >>> fault(serialize_message(Float64(data=0.5))), fault(b"short")
    ('', '5 bytes that are no Float64')
    """
    layout = layout_of(message_type)
    read = layout.numbers if layout is not None else partial(deserialize_message, message_type=message_type)

    def fault(data: bytes) -> str:
        try:
            read(data)
        except (struct.error, RuntimeError):  # the latter is rmw's
            return f"{len(data)} bytes that are no {message_type.__name__}"
        return ""

    return fault


class Layout:
    """How messages of a type of plain numbers are laid out.

    Parameters
    ----------
    message_type : type
        See ``layout_of``.

    Attributes
    ----------
    names : tuple of str
        Its fields but the header.

    Examples
    --------
    >>> from fopid_msgs.msg import ScalarStamped
    >>> layout = Layout(ScalarStamped)
    >>> layout.unpack(layout.pack(1_500_000_000, [0.25]))
    ScalarStamped(stamp_ns=1500000000, value=0.25)
    """

    def __init__(self, message_type: Any) -> None:
        self._message_type = message_type
        fields = dict(message_type.get_fields_and_field_types())
        self._stamped = fields.pop("header", None) is not None
        self.names = tuple(fields)
        formats = [FORMATS[kind] for kind in fields.values()]
        # Where the fields begin, and so the gaps between them, depends on how long frame_id is.
        begin = _HEADER.size if self._stamped else 0
        self._fields = [_aligned(formats, begin + length) for length in range(LARGEST_ALIGNMENT)]
        self._record: Any = namedtuple(message_type.__name__, ("stamp_ns", *self.names))  # type: ignore[misc]
        self._values = attrgetter("stamp_ns", *self.names)
        self._own = self._fields[1] if self._stamped else self._fields[0]  # frame_id is empty: its NUL
        self._begin = _BEHIND_HEADER + 1 if self._stamped else ALIGNED_FROM
        self._newest: tuple[bytes | None, int, tuple[Any, ...]] = (None, 0, ())

    @cached_property
    def _message(self) -> bytearray:
        """A new message; made when it is needed, since rclpy's writer takes long to load."""
        message = bytearray(serialize_message(self._message_type()))
        if message[:2] != ENCAPSULATION:
            raise RuntimeError(f"messages are sent as {bytes(message[:2])!r}; allowed: {ENCAPSULATION!r}")
        return message

    @cached_property
    def defaults(self) -> tuple[Any, ...]:
        """The values of the fields in a new message."""
        return tuple(self._own.unpack_from(self._message, self._begin))

    def stamp_ns(self, data: bytes) -> int:
        """The header's stamp [ns]; 0 without a header."""
        return self._read(data)[1]

    def numbers(self, data: bytes) -> tuple[Any, ...]:
        """The fields of a message but the header, in their order."""
        return self._read(data)[2]

    def unpack(self, data: bytes) -> Any:
        """A message as a named tuple of ``stamp_ns`` and its fields."""
        _, stamp, numbers = self._read(data)
        return self._record(stamp, *numbers)

    def _read(self, data: bytes) -> tuple[bytes | None, int, tuple[Any, ...]]:
        """A message, its stamp [ns] and its fields; of the one that was read last they are remembered.

        For a message is first looked at whether it is one, then for its stamp, and then for its numbers.
        """
        newest = self._newest
        if newest[0] is not data:
            self._newest = newest = (data, *self._parse(data))
        return newest

    def _parse(self, data: bytes) -> tuple[int, tuple[Any, ...]]:
        if data[:2] != ENCAPSULATION:
            message = deserialize_message(data, self._message_type)
            stamp = message.header.stamp.sec * NS + message.header.stamp.nanosec if self._stamped else 0
            return stamp, tuple(getattr(message, name) for name in self.names)
        if not self._stamped:
            return 0, self._own.unpack_from(data, ALIGNED_FROM)
        seconds, nanoseconds, length = _HEADER.unpack_from(data, ALIGNED_FROM)
        fields = self._fields[length % LARGEST_ALIGNMENT].unpack_from(data, _BEHIND_HEADER + length)
        return seconds * NS + nanoseconds, fields

    def pack(self, stamp_ns: int, numbers: Iterable[Any]) -> bytes:
        """A message with an empty ``frame_id``, to be published."""
        if self._stamped:
            _STAMP.pack_into(self._message, ALIGNED_FROM, *divmod(stamp_ns, NS))
        self._own.pack_into(self._message, self._begin, *numbers)
        return bytes(self._message)

    def record(self) -> SimpleNamespace:
        """Something to set ``stamp_ns`` and the fields of, for ``pack_record``."""
        return SimpleNamespace(stamp_ns=0, **dict(zip(self.names, self.defaults, strict=True)))

    def pack_record(self, record: Any) -> bytes:
        """What has ``stamp_ns`` and the fields as attributes, as a message."""
        stamp_ns, *numbers = self._values(record)
        return self.pack(stamp_ns, numbers)


def _aligned(formats: Iterable[str], begin: int) -> struct.Struct:
    """The fields that begin so many bytes behind the encapsulation, each aligned to its own size.

    Examples
    --------
    >>> _aligned("?dB", 13).format
    '<?2xdB'
    """
    text, at = "<", begin
    for one in formats:
        size = struct.calcsize(f"<{one}")
        gap = -at % size
        text += f"{gap}x{one}" if gap else one
        at += gap + size
    return struct.Struct(text)
