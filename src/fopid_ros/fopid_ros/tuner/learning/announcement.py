"""How long an autotuning takes, as it is told before it begins."""

from __future__ import annotations

TOTAL, UNTIL_KNOWN, UNTIL_PROVED = 2.0, 0.7, 1.9
"""How long it usually takes, in lengths of an experiment: rest and one that is made whole; rest and one that ends when
enough is known; that with gains tried out, a second round and a proof."""
LONGEST, LONGEST_PROVED = 3.0, 4.5
"""How long at most, in the same lengths; with what follows."""
WORKED_OUT = 20.0
"""How long it usually takes to work gains out [s]; that depends on the computer."""


def usual_time(length: float, until_known: bool, proved: bool) -> float:
    """How long all of it usually takes [s].

    Parameters
    ----------
    length : float
        Of a whole experiment [s].
    until_known : bool
        Whether it ends once enough is known.
    proved : bool
        Whether gains are tried out after it, watched and proved.

    Examples
    --------
    >>> usual_time(100.0, until_known=True, proved=True)
    210.0
    """
    lengths = TOTAL if not until_known else UNTIL_PROVED if proved else UNTIL_KNOWN
    return lengths * length + WORKED_OUT


def announcement(length: float, until_known: bool, proved: bool) -> str:
    """The same in words, and how long at most.

    Examples
    --------
    >>> announcement(100.0, until_known=True, proved=False)
    'about 90 s in all (rest, experiments, gains worked out), up to 320 s where they say too little'
    """
    most = (LONGEST_PROVED if proved else LONGEST) * length + WORKED_OUT
    parts = "rest, experiments, gains worked out" + (", watched and proved" if proved else "")
    usual = usual_time(length, until_known, proved)
    return f"about {usual:.3g} s in all ({parts}), up to {most:.3g} s where they say too little"
