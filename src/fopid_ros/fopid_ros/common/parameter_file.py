"""Parameters of a node in a file that a start with ``--params-file`` reads."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Mapping
from pathlib import Path

import yaml

from fopid_ros.common.parameters import Value


class _Text(str):
    """A text that stands in quotes: ROS reads some as numbers, such as 1e5, that YAML's library does not."""

    __slots__ = ()


class _Dumper(yaml.SafeDumper):
    pass


_Dumper.add_representer(_Text, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style="'"))


def parameter_text(node: str, values: Mapping[str, Value]) -> str:
    """What such a file says of a node.

    Examples
    --------
    >>> print(parameter_text("/tuner", {"via": "none", "timeout": 30.0}), end="")
    /tuner:
      ros__parameters:
        via: 'none'
        timeout: 30.0
    """
    quoted = {name: _Text(value) if isinstance(value, str) else value for name, value in values.items()}
    return yaml.dump({node: {"ros__parameters": quoted}}, Dumper=_Dumper, sort_keys=False, allow_unicode=True)


def write_parameter_file(path: Path, node: str, values: Mapping[str, Value]) -> None:
    """Write a ROS parameter file so that at every instant the old file or the new one is there, whole.

    Parameters
    ----------
    path : Path
        A link is followed: what it points at is replaced.
    node : str
        Fully qualified name of the node.
    values : mapping
        Parameter name -> value.

    Raises
    ------
    OSError
        If it cannot be written; what was there before is there still.
    """
    target = _target(path)
    text = parameter_text(node, values)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.{threading.get_ident()}")
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(target.parent)


def _target(path: Path) -> Path:
    """The file that is replaced; anything else, a device or a folder, must not be."""
    target = Path(os.path.realpath(os.path.expanduser(path)))  # noqa: PTH111  (Path's own raises for an unknown user)
    if target.exists() and not target.is_file():
        raise FileExistsError(errno.EEXIST, "Is a directory or a device, not a file", str(target))
    return target


def sync_folder(folder: Path) -> None:
    """Have the disk confirm the names in a folder, so that a new one, too, survives a loss of power."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
