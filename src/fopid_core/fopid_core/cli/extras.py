"""What is installed only when asked for, and how to ask."""

from __future__ import annotations

EXTRA = {
    "yaml": "experiments",
    "matplotlib": "plots",
    "plotly": "plots",
    "apsw": "bags",
    "backports": "bags",
    "lz4": "bags",
    "mcap": "bags",
    "rosbags": "bags",
    "zstandard": "bags",
    "distributed": "campaigns",
    "pyarrow": "campaigns",
    "control": "control",
    "flint": "certify",
    "tornado": "explore",
    "cvxpy": "limit",
    "simple_pid": "benchmark",
}
"""Module -> the extra of ``fopid_core`` that brings it."""


def missing(error: ModuleNotFoundError) -> str | None:
    """One line about a module that is not installed; None for one that no extra brings.

    Examples
    --------
    >>> missing(ModuleNotFoundError(name="rosbags.rosbag2"))
    "this needs the Python package rosbags, which is not installed; allowed: pip install 'fopid_core[bags]'"
    """
    module = (error.name or "").partition(".")[0]
    if module not in EXTRA:
        return None
    hint = f"pip install 'fopid_core[{EXTRA[module]}]'"
    return f"this needs the Python package {module}, which is not installed; allowed: {hint}"
