"""Gains that outlive the controller's process: a small file, whole at every instant, with its provenance.

``NAME.gains.json`` holds the newest gains on the disk. ``NAME.gains.json.new``, while it is there, is newer: it has
been written, so that the process may be killed, but the disk has not confirmed it, so that a power cut may tear it;
its checksum tells.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter
from fopid_ros.common.design_parameters import DESIGN, FILTER, GAINS, LONGEST_CERTIFICATE, LOOP, PACE, PROVENANCE
from fopid_ros.common.parameter_file import sync_folder

LARGEST_FILE = 65_536  # bytes
LONGEST_ORIGIN = 300  # characters
WAIT_FOR_DISK = 0.05
"""The loop stands still no longer than this [s] until the file is written; a disk that is slower is told of."""

BASIS = ("sample_time", "band.low", "band.high", "band.poles", "horizon", "derivative_filter_time")
"""Parameters that make the same design another controller."""
WHOLE = ("band.poles", "measurement_filter_order")
"""Those of them that are whole numbers."""


@dataclass(frozen=True)
class Retained:
    """Gains and where they come from.

    Attributes
    ----------
    node : str
        Full name of the controller.
    gains : mapping
        kp, ki, kd, lam, mu, and the rest of ``DESIGN``.
    status : str
        ``set`` or ``verified``.
    origin : str
        Who set them, and why, as whoever set them said.
    certificate : str
        That they hold the loop, when there is one.
    when : str
        UTC, ISO 8601.
    basis : mapping
        Values of the parameters named in ``BASIS``.
    """

    node: str
    gains: Mapping[str, float]
    status: str
    origin: str
    certificate: str
    when: str
    basis: Mapping[str, float]

    @classmethod
    def of(cls, node: str, values: Mapping[str, Any]) -> Retained:
        """What a node with these parameters has now."""
        gains = {name: values[name] for name in DESIGN}
        when = datetime.now(UTC).isoformat(timespec="seconds")
        basis = {name: values[name] for name in BASIS}
        status, origin, certificate = (values[name] for name in PROVENANCE)
        return cls(node, gains, status, origin, certificate, when, basis)

    def no_faster_than(self, given: Retained) -> Retained:
        """The same with the lower of the limits on moves: kept gains may need theirs, a new actuator its own."""
        slower = {name: min(self.gains[name], given.gains[name]) for name in PACE}
        return replace(self, gains={**self.gains, **slower})

    @property
    def parameters(self) -> dict[str, Any]:
        """Gains and provenance as parameters."""
        return {**self.gains, **dict(zip(PROVENANCE, (self.status, self.origin, self.certificate), strict=True))}

    @property
    def text(self) -> str:
        """The gains as a formula."""
        order, time_constant = (self.gains[name] for name in FILTER)
        filtered = MeasurementFilter(int(order), time_constant)
        return f"{Fopid(*(self.gains[name] for name in GAINS))}{'' if filtered.is_idle else f' behind a {filtered}'}"

    def __str__(self) -> str:
        """As a person reads it.

        >>> from math import inf
        >>> design = dict(zip(DESIGN, (2.0, 0.5, 0.0, 1.0, 1.0, 0, 0.0, 1.0, 1.0, inf, inf, 0.0)))
        >>> print(Retained("/c", design, "verified", "fopid_tuner", "", "2026-01-31T12:00:00+00:00", {}))
        2 + 0.5 s^-1 + 0 s^1, verified, from 'fopid_tuner' at 2026-01-31T12:00:00+00:00
        """
        status = "verified" if self.status == "verified" else "not verified"
        return f"{self.text}, {status}, from {self.origin or 'somebody unnamed'!r} at {self.when}"


def with_provenance(
    changes: Mapping[str, Any], present: Mapping[str, Any], known: Retained | None
) -> dict[str, Any]:  # fmt: skip
    """Changes of parameters, with what is known of the loop with them when it is not said.

    Gains that were in force before, behind the same filter and in the same band, keep their provenance when they come
    back.

    Examples
    --------
    >>> present = dict.fromkeys((*LOOP, *BASIS), 1.0) | PROVENANCE | {"gains.status": "verified"}
    >>> with_provenance({"kp": 2.0}, present, None)
    {'gains.status': 'set', 'kp': 2.0}
    >>> with_provenance({"kp": 1.0}, present, None)
    {'kp': 1.0}
    """
    after = {name: changes.get(name, present[name]) for name in (*LOOP, *BASIS)}
    if all(value == present[name] for name, value in after.items()):
        return dict(changes)
    is_known = known is not None and after.items() <= {**known.gains, **known.basis}.items()
    told = known.parameters if known is not None and is_known else PROVENANCE
    if "gains.status" in changes:
        told = PROVENANCE
    news = {name: told[name] for name in PROVENANCE if told[name] != present[name]}
    return {**news, **changes}


def check_provenance(values: Mapping[str, Any]) -> None:
    """Raise InputError for a provenance that cannot be written into one line, or is too long."""
    origin, certificate = values["gains.origin"], values["gains.certificate"]
    if len(origin) > LONGEST_ORIGIN or not origin.isprintable():
        raise InputError(f"gains.origin has {len(origin)} characters; allowed: up to {LONGEST_ORIGIN}, all printable")
    if len(certificate) > LONGEST_CERTIFICATE:
        raise InputError(f"gains.certificate has {len(certificate)} characters; allowed: up to {LONGEST_CERTIFICATE}")


def encoded(retained: Retained) -> bytes:
    """The file's bytes: JSON with a checksum of everything else in it."""
    content = asdict(retained)
    return (json.dumps({**content, "sha256": _checksum(content)}, indent=1) + "\n").encode("ascii")


def decoded(data: bytes, node: str) -> Retained:
    """What a file says.

    Parameters
    ----------
    data : bytes
    node : str
        Whose gains they must be.

    Raises
    ------
    InputError
        For anything that ``encoded`` has not written for this node.

    Examples
    --------
    >>> basis = dict.fromkeys(BASIS, 0.0)
    >>> kept = Retained("/c", dict.fromkeys(DESIGN, 1.0), "set", "", "", "now", basis)
    >>> decoded(encoded(kept), "/c") == kept
    True
    """
    names = [field.name for field in fields(Retained)]
    try:
        content = json.loads(data)
        if not isinstance(content, dict) or set(content) != {*names, "sha256"}:
            raise InputError(f"it has not the entries {', '.join(names)}, sha256")
        if content.pop("sha256") != _checksum(content):
            raise InputError("its checksum does not fit: it was torn or changed")
    except InputError:
        raise
    except (ValueError, RecursionError):
        raise InputError("it is no JSON, or too deep") from None
    _check(content)
    if content["node"] != node:
        raise InputError(f"it is of {content['node']!r}; allowed: of {node!r}")
    return Retained(**content)


def _checksum(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode("ascii")).hexdigest()


def _check(content: Mapping[str, Any]) -> None:
    """A checksum can be made by anybody: what stands in the file is still not to be trusted."""
    longest = {"node": 1000, "status": 20, "origin": LONGEST_ORIGIN, "certificate": LONGEST_CERTIFICATE, "when": 40}
    for name, length in longest.items():
        text = content[name]
        if not isinstance(text, str) or len(text) > length or (name != "certificate" and not text.isprintable()):
            raise InputError(f"{name} in it; allowed: up to {length} printable characters")
        if any("\ud800" <= letter <= "\udfff" for letter in text):  # JSON can hold half a character, a parameter cannot
            raise InputError(f"{name} in it; allowed: whole characters")
    if content["status"] not in ("set", "verified"):
        raise InputError(f"status = {content['status']!r} in it; allowed: set, verified")
    for name, wanted in (("gains", DESIGN), ("basis", BASIS)):
        numbers = content[name]
        if not isinstance(numbers, dict) or set(numbers) != set(wanted):
            raise InputError(f"{name} in it; allowed: {', '.join(wanted)}")
        for key, value in numbers.items():
            if type(value) is not float and not (key in WHOLE and type(value) is int):
                raise InputError(f"{key} in it; allowed: a number with a decimal point")


def file_name(node: str) -> str:
    """A node's file in the directory.

    Examples
    --------
    >>> file_name("/hall/fopid_controller")
    'hall.fopid_controller.gains.json'
    """
    return node.strip("/").replace("/", ".") + ".gains.json"


class Retainer:
    """Keeps a node's gains in a directory.

    Parameters
    ----------
    directory : Path
    node : str
        Full name of the node.

    Raises
    ------
    InputError
        If the directory is none, or cannot be written to.

    Attributes
    ----------
    trouble : str
        Why the newest gains are not, or not yet, on the disk; empty when they are.
    """

    def __init__(self, directory: Path, node: str) -> None:
        if directory == Path() or not directory.is_dir() or not os.access(directory, os.W_OK | os.X_OK):
            raise InputError("directory; allowed with retain: a folder that is there and can be written to")
        self.node, self._directory = node, directory
        self._file = directory / file_name(node)
        self._new = self._file.with_name(self._file.name + ".new")
        self._renaming = threading.Lock()
        # Two threads, since a disk takes long to confirm, and what comes meanwhile must be written at once.
        self._writer, self._syncer = (ThreadPoolExecutor(1, f"retain-{name}") for name in ("write", "sync"))
        self._newest = 0  # number of the newest that is to be kept
        self.trouble = ""

    def read(self) -> Retained | None:
        """The newest gains that can be read; None when none were ever kept.

        Raises
        ------
        InputError
            If there is a file, but none that can be used.
        """
        reasons = []
        for path in (self._new, self._file):
            try:
                kept = decoded(_bytes_of(path), self.node)
            except FileNotFoundError:
                continue
            except OSError as error:
                reasons.append(f"{path.name}: {error.strerror}")
            except InputError as error:
                reasons.append(f"{path.name}: {error}")
            else:
                if path == self._new:  # the process ended before the disk had confirmed it
                    self._syncer.submit(self._sync, self._newest)
                return kept
        if reasons:
            raise InputError("; ".join(reasons))
        return None

    def keep(self, retained: Retained) -> None:
        """Write; when this returns the process may be killed, unless ``trouble`` says otherwise."""
        self._newest += 1
        self.trouble = "being written"
        wait([self._writer.submit(self._write, encoded(retained), self._newest)], WAIT_FOR_DISK)

    def _tell(self, number: int, trouble: str) -> None:
        """What became of the gains of a number, where these are the newest."""
        if number == self._newest:
            self.trouble = trouble

    def _write(self, data: bytes, number: int) -> None:
        temporary = self._file.with_name(f".{self._file.name}.{os.getpid()}")
        try:
            temporary.write_bytes(data)
            with self._renaming:
                temporary.replace(self._new)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            self._tell(number, error.strerror or str(error))
        else:
            self._syncer.submit(self._sync, number)

    def _sync(self, number: int) -> None:
        """Have the disk confirm the new file, then let it take the place of the old one."""
        try:
            with self._new.open("rb") as file:
                os.fsync(file.fileno())
                with self._renaming:
                    if not os.path.samestat(os.fstat(file.fileno()), self._new.stat()):
                        return  # a newer one has come meanwhile, and is the next in turn
                    self._new.replace(self._file)
            sync_folder(self._directory)
        except FileNotFoundError:
            pass  # what this was to confirm has been replaced by what is confirmed already
        except OSError as error:
            self._tell(number, error.strerror or str(error))
            return
        self._tell(number, "")


def _bytes_of(path: Path) -> bytes:
    """A file's content; anything but a small regular file is refused, and nothing is waited for."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise InputError("it is no regular file")
        if status.st_size > LARGEST_FILE:
            raise InputError(f"it has {status.st_size} bytes; allowed: up to {LARGEST_FILE}")
        return file.read(LARGEST_FILE + 1)
