"""The files of a page."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

from tornado.web import HTTPError, StaticFileHandler

from fopid_core.study.page.guarded import Guarded


class FileHandler(Guarded, StaticFileHandler):
    """A file of the page."""

    async def get(self, path: str, include_body: bool = True) -> None:
        if not path.isprintable():
            raise HTTPError(400, reason="Bad Path")
        await super().get(path, include_body)


def shared_files() -> list[tuple[str, type[FileHandler], dict[str, Any]]]:
    """Routes to what both pages are made of, under ``/page/``; the look is the report's."""
    page = Path(str(resources.files("fopid_core.study.page"))) / "static"
    report = Path(str(resources.files("fopid_core.study.reports")))
    return [
        (r"/page/(report_page\.css)", FileHandler, {"path": report}),
        (r"/page/(.*)", FileHandler, {"path": page}),
    ]
