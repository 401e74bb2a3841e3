"""Whom a page's server lets in, and where it listens."""

from __future__ import annotations

import pytest

from fopid_core.errors import InputError
from fopid_core.study.page.access import Access, chosen_token
from fopid_core.study.page.listening import listening_sockets, page_address


@pytest.mark.parametrize(
    ("host", "known"),
    [
        ("127.0.0.1:8077", True), ("localhost:8077", True), ("[::1]:8077", True), ("192.168.1.7", True),
        ("bench7:8077", True), ("BENCH7", True), ("evil.example:8077", False), ("127.0.0.1.evil.example", False),
        ("localhost.evil.example", False), ("", False), ("[::1", False),
    ],
)  # fmt: skip
def test_only_names_of_this_server_are_known(host: str, known: bool) -> None:
    assert Access("x" * 20, frozenset({"bench7"})).knows_host(host) is known


@pytest.mark.parametrize(
    ("origin", "known"),
    [
        (None, True), ("http://127.0.0.1:8077", True), ("https://127.0.0.1:8077", True),
        ("http://127.0.0.1:8078", False), ("http://evil.example", False), ("null", False), ("", False),
        ("file://", False), ("ftp://127.0.0.1:8077", False), ("http://127.0.0.1:8077.evil.example", False),
    ],
)  # fmt: skip
def test_only_our_own_page_may_ask(origin: str | None, known: bool) -> None:
    assert Access("x" * 20).knows_origin(origin, "127.0.0.1:8077") is known


@pytest.mark.parametrize("shown", ["", "Bearer ", "Bearer wrong", "Basic the-right-token!", "Bearer the-right-token! "])
def test_only_the_token_allows_a_change(shown: str) -> None:
    access = Access("the-right-token!")
    assert not access.allows_change(shown)
    assert access.allows_change("Bearer the-right-token!")
    assert "the-right-token!" not in repr(access)


def test_tokens_are_random_or_long_enough() -> None:
    assert chosen_token(None) != chosen_token(None)
    assert chosen_token("sixteen letters!") == "sixteen letters!"
    for bad in ("", "short", "x" * 15, "ä" * 20, "new\nline in a token"):
        with pytest.raises(InputError, match="FOPID_DASHBOARD_TOKEN has"):
            chosen_token(bad)


def test_addresses_are_ones_a_browser_can_open() -> None:
    assert page_address("0.0.0.0", 80, None) == "http://127.0.0.1:80/"
    assert page_address("::1", 8077, "t") == "http://[::1]:8077/#token=t"


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 65536), ("127.0.0.1", -1), ("203.0.113.7", 0)])
def test_places_that_cannot_be_listened_at_are_named(host: str, port: int) -> None:
    with pytest.raises(InputError, match=rf"port = {port}"):
        listening_sockets(host, port)
