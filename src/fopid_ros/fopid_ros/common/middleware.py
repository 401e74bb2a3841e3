"""What is settled before ROS 2 begins: a domain that has ports, messages out of shared memory, no leftovers there."""

from __future__ import annotations

import os

from fopid_core.errors import InputError
from fopid_ros.common.shared_memory import remove_abandoned_segments

LAST_DOMAIN = 232  # its UDP ports are the last below 65536
TRANSPORTS, NOT_SHARED = "FASTDDS_BUILTIN_TRANSPORTS", "UDPv4"
"""What Fast DDS reads, and all that it has by itself but shared memory.

There a process that is killed while it holds a lock stops whoever sends to it, for a second at a time: of 98 nodes
that were killed on a busy machine, three held up the controller, for 1.3 to 3.0 s. With
ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST rmw_fastrtps chooses shared memory itself, whatever this says.
"""


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
