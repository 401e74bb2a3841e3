"""Who may look and who may change something.

The page is for this machine's own browsers. A page from elsewhere that such a browser shows must not reach it: not by
a name that is made to point here (the host is checked), and not by requests of its own (the origin is).
"""

from __future__ import annotations

import ipaddress
import secrets
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from fopid_core.errors import InputError

SHORTEST_TOKEN = 16
"""Characters of a token that somebody chose."""


def chosen_token(given: str | None, name: str = "FOPID_DASHBOARD_TOKEN") -> str:
    """A token given from outside by a variable of this name, a new random one without.

    Raises
    ------
    InputError
        For one that can be guessed.
    """
    if given is None:
        return secrets.token_urlsafe(24)
    if len(given) < SHORTEST_TOKEN or not given.isascii() or not given.isprintable():
        raise InputError(f"{name} has {len(given)} characters; allowed: {SHORTEST_TOKEN} or more, printable ASCII")
    return given


def _host_name(netloc: str) -> str:
    try:
        return urlsplit(f"//{netloc}").hostname or ""
    except ValueError:
        return ""


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


@dataclass(frozen=True)
class Access:
    """The rules.

    Attributes
    ----------
    token : str
        What a request for a change must show.
    names : frozenset of str
        Names this server may be called by, in small letters; addresses and localhost may always be used.

    Examples
    --------
    >>> access = Access("a secret", frozenset({"bench7"}))
    >>> access.knows_host("127.0.0.1:8077"), access.knows_host("evil.example:8077")
    (True, False)
    >>> access.knows_origin("http://evil.example", "127.0.0.1:8077")
    False
    >>> access.allows_change("Bearer a secret")
    True
    """

    token: str = field(repr=False)
    names: frozenset[str] = frozenset()

    def knows_host(self, host: str) -> bool:
        """Whether a request's Host header names this server: an address cannot be made to point elsewhere."""
        name = _host_name(host)
        return name == "localhost" or name in self.names or _is_address(name)

    def knows_origin(self, origin: str | None, host: str) -> bool:
        """Whether a request comes from our own page, or from no page at all.

        Raises
        ------
        InputError
            For what is no origin.
        """
        if origin is None:
            return True
        try:
            parts = urlsplit(origin)
        except ValueError:
            raise InputError(f"origin = {origin!r}; allowed: http://HOST:PORT") from None
        return parts.scheme in ("http", "https") and parts.netloc == host

    def allows_change(self, authorization: str) -> bool:
        """Whether a request's Authorization header shows the token."""
        shown = authorization.removeprefix("Bearer ").encode()
        return secrets.compare_digest(shown, self.token.encode())
