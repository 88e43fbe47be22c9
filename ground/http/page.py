"""The gateway's pages: ``/`` shows the fleet, ``/docs`` the HTTP interface, ``/tiles`` what the map stands on.

What they are made of is in ``static`` and served as it is: HTML, CSS and JavaScript modules, and nothing from
elsewhere. Their policy (Content-Security-Policy) lets run what comes from there, and nothing that stands in a page.
"""

from __future__ import annotations

import gzip
import hashlib
import html
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Route

from ground.http.gateway import Gateway
from ground.http.reply import Failure
from ground.http.tiles import PICTURES

KINDS = {".css": "text/css", ".html": "text/html", ".js": "text/javascript", ".json": "application/json"}
POLICY = (
    "default-src 'none'",
    "connect-src 'self'",
    "script-src 'self'",
    "style-src 'self'",
    "img-src data: blob: 'self'",
    "base-uri 'none'",
    "form-action 'none'",
    "frame-ancestors 'none'",
)
FIELD = re.compile(r"\{([a-z_]+)\}")


class Asset:
    """One file as it is served; a browser asks each time whether it still has the newest."""

    def __init__(self, kind: str, text: str) -> None:
        self._kind, self._body = kind, text.encode()
        self._packed = gzip.compress(self._body, mtime=0)
        self._tag = f'"{hashlib.sha256(self._body).hexdigest()[:32]}"'

    def response(self, request: Request) -> Response:
        headers = {
            "ETag": self._tag,
            "Cache-Control": "no-cache",
            "Content-Security-Policy": "; ".join(POLICY),
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",  # the address may hold the token
            "Vary": "Accept-Encoding",
        }
        if request.headers.get("if-none-match") == self._tag:
            return Response(status_code=304, headers=headers)
        if "gzip" in request.headers.get("accept-encoding", ""):
            return Response(self._packed, media_type=self._kind, headers={**headers, "Content-Encoding": "gzip"})
        return Response(self._body, media_type=self._kind, headers=headers)


def routes(gateway: Gateway) -> list[BaseRoute]:
    fields = {"fleet": gateway.client.fleet_name, "read_only": "yes" if gateway.read_only else "no"}
    tiles = gateway.tiles
    fields["tiles"] = "" if tiles is None else f"{tiles.kind} {tiles.closest or ''}"
    over = gateway.picture
    fields["replay"] = "yes" if gateway.player is not None else "no"
    fields["picture"] = "" if over is None else " ".join(map(str, over.corners))
    texts = dict(_files())
    texts["index.html"] = FIELD.sub(lambda found: html.escape(fields[found[1]]), texts["index.html"])
    assets = {name: Asset(KINDS[PurePosixPath(name).suffix], text) for name, text in texts.items()}

    async def fleet(request: Request) -> Response:
        """The fleet, live, in a browser."""
        return assets["index.html"].response(request)

    async def docs(request: Request) -> Response:
        """This interface, to read and to try."""
        return assets["docs.html"].response(request)

    async def static(request: Request) -> Response:
        """What the pages are made of; it needs no token, as it is the same everywhere."""
        name = request.path_params["file"]
        if name not in assets or name.endswith(".html"):
            raise Failure(404, "not_found", "the pages have no such file")
        return assets[name].response(request)

    async def file(request: Request) -> Response:
        """The file of tiles that the gateway was started with, or the part that a Range header asks for."""
        if tiles is None or tiles.kind != "pmtiles":
            raise Failure(404, "not_found", "no PMTiles here: zmav http --tiles FILE.pmtiles")
        return FileResponse(tiles.path, media_type="application/vnd.pmtiles")

    async def tile(request: Request) -> Response:
        """One tile of the MBTiles, or of the tile server, that the gateway was started with."""
        z, x, y = (request.path_params[name] for name in "zxy")
        inside = tiles is not None and tiles.kind == "mbtiles" and z <= 30 and x < 1 << z and y < 1 << z
        data = await tiles.fetch(z, x, y) if tiles is not None and inside else None
        if data is None:
            raise Failure(404, "not_found", "there is no such tile")
        kind = next((kind for magic, kind in PICTURES.items() if data.startswith(magic)), "application/octet-stream")
        return Response(data, media_type=kind, headers={"X-Content-Type-Options": "nosniff"})

    async def picture(request: Request) -> Response:
        """The picture that is laid over the map."""
        if over is None:
            raise Failure(404, "not_found", "no picture here: zmav http --picture FILE --corners S,W,N,E")
        headers = {"X-Content-Type-Options": "nosniff"}
        if over.data is not None:
            return Response(over.data, media_type=over.kind, headers=headers)
        return FileResponse(over.path, media_type=over.kind, headers=headers)

    return [
        Route("/", fleet, methods=["GET"]),
        Route("/docs", docs, methods=["GET"]),
        Route("/static/{file:path}", static, methods=["GET"]),
        Route("/picture", picture, methods=["GET"]),
        Route("/tiles", file, methods=["GET"]),
        Route("/tiles/{z:int}/{x:int}/{y:int}", tile, methods=["GET"]),
    ]


def _files() -> Iterator[tuple[str, str]]:
    """What is in ``static``: names as in addresses, and texts."""
    folder = Path(__file__).with_name("static")
    for path in folder.rglob("*"):
        if path.suffix in KINDS:
            yield path.relative_to(folder).as_posix(), path.read_text(encoding="utf-8")
