"""What every answer of a page's server has in common: who is let in, and the headers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from tornado.web import HTTPError, RequestHandler

from fopid_core.errors import InputError
from fopid_core.study.page.access import Access

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}


class Guarded(RequestHandler):
    """Lets in only requests to this server by one of its own names, and from no other page than its own."""

    @property
    def access(self) -> Access:
        """The rules."""
        rules: Access = self.settings["access"]
        return rules

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        host = self.request.headers.get("Host", "")
        if not self.access.knows_host(host):
            raise HTTPError(403, reason="Unknown Host")
        try:
            known = self.access.knows_origin(self.request.headers.get("Origin"), host)
        except InputError:
            raise HTTPError(400, reason="Bad Origin") from None
        if not known:
            raise HTTPError(403, reason="Foreign Origin")

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        self.finish({"message": self._reason})


def json_object(body: bytes) -> Mapping[str, Any]:
    """The JSON object that a request's body holds, ``{}`` for an empty one.

    Raises
    ------
    InputError
        For anything else.

    Examples
    --------
    >>> json_object(b'{"kp": 1}')
    {'kp': 1}
    """
    try:
        value = json.loads(body or b"{}")
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise InputError("the request's body; allowed: a JSON object")
    return value
