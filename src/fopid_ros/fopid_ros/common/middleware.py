"""What is settled before ROS 2 begins: a domain that has ports, messages out of shared memory, no leftovers there."""

from __future__ import annotations

import os
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

from fopid_core.errors import InputError
from fopid_ros.common.shared_memory import remove_abandoned_segments

LAST_DOMAIN = 232  # its UDP ports are the last below 65536
TRANSPORTS, NOT_SHARED = "FASTDDS_BUILTIN_TRANSPORTS", "UDPv4"
"""What Fast DDS reads, and all that it has by itself but shared memory.

There a process that is killed while it holds a lock stops whoever sends to it: of 98 plants that were killed on a busy
machine three held up their controller, for 1.3 to 3.0 s; another process waited for more than five minutes, in
``SharedMemManager::Port::regenerate_port``, until it was killed itself.
"""
PROMPT, LOOPBACK = (Path(__file__).with_name(name) for name in ("prompt.xml", "loopback.xml"))
"""Profiles of Fast DDS; the second keeps to this machine, too."""
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""What ROS 2 reads; for LOCALHOST rmw_fastrtps chooses the transports itself, shared memory among them."""

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""The same, of older and of newer releases: where a user's own profile stands."""


def use_profile() -> None:
    """Before ROS starts: have Fast DDS ask promptly for what was missed, and with LOCALHOST keep out of shared memory.

    That is the same range, seen by nodes that have the usual one. A user's own profile file stands. Not for a process
    that starts others, which would inherit it.
    """
    if any(name in os.environ for name in PROFILES):
        return
    file = PROMPT
    if _insists_on_shared_memory():
        file, os.environ[RANGE] = LOOPBACK, "SYSTEM_DEFAULT"  # which leaves profiles alone
    os.environ.update(dict.fromkeys(PROFILES, str(file)))


def _insists_on_shared_memory() -> bool:
    """Whether it would be used although nobody has asked for it."""
    asked = os.environ.get(TRANSPORTS, NOT_SHARED) != NOT_SHARED
    local = os.environ.get(RANGE) == "LOCALHOST" and not os.environ.get("ROS_STATIC_PEERS")
    return local and not asked and get_rmw_implementation_identifier().startswith("rmw_fastrtps")


def prepare_middleware() -> None:
    """Settle all of it, for this process and those that it starts; who has set the transports keeps them.

    Raises
    ------
    InputError
        For a domain that the transport has no ports for: it would end the process outright.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "0").strip()
    if text.isdecimal() and int(text) > LAST_DOMAIN:
        raise InputError(f"ROS_DOMAIN_ID = {text}; allowed: 0 to {LAST_DOMAIN}")
    os.environ.setdefault(TRANSPORTS, NOT_SHARED)
    remove_abandoned_segments()
