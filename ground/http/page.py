"""The gateway's pages: ``/`` shows the fleet, ``/docs`` the HTTP interface, ``/tiles`` what the map stands on.

The files are in ``static``: plain HTML, CSS and JavaScript, and nothing from elsewhere. What a page links to is put
into it when the gateway starts: one request brings it all, also where a token would have to go along with each, and
its policy (Content-Security-Policy) lets run exactly what we wrote, by its hash.
"""

from __future__ import annotations

import asyncio
import base64
import gzip
import hashlib
import html
import re
from collections.abc import Mapping
from importlib import resources

from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Route

from ground.http.gateway import Gateway
from ground.http.reply import Failure
from ground.http.tiles import PICTURES

LINKED = re.compile(
    r'<link rel="stylesheet" href="([a-z/]+\.css)">|<script src="([a-z/]+\.js)"></script>'
    r'|(<script type="application/json" id="[a-z]+") src="([a-z0-9/-]+\.json)"></script>'
)
POLICY = (
    "default-src 'none'",
    "connect-src 'self'",
    "img-src data: blob: 'self'",
    "base-uri 'none'",
    "form-action 'none'",
    "frame-ancestors 'none'",
)
FIELD = re.compile(r"\{([a-z_]+)\}")


class Page:
    """One HTML file with what it links to put in, and the policy for it."""

    def __init__(self, name: str, fields: Mapping[str, str] | None = None) -> None:
        self._styles: list[str] = []
        self._scripts: list[str] = []
        filled = FIELD.sub(lambda found: html.escape((fields or {})[found[1]]), _read(name))
        text = LINKED.sub(self._put_in, filled)
        self._body = text.encode()
        self._packed = gzip.compress(self._body, mtime=0)

    def _put_in(self, found: re.Match[str]) -> str:
        if found[3]:  # data, which no policy need let run
            return f"{found[3]}>{_read(found[4])}</script>"
        text = _read(found[1] or found[2])
        if found[1]:
            self._styles.append(_hash(text))
            return f"<style>{text}</style>"
        self._scripts.append(_hash(text))
        return f"<script>{text}</script>"

    def response(self, request: Request) -> Response:
        packs = "gzip" in request.headers.get("accept-encoding", "")
        headers = {
            "Content-Security-Policy": self._policy(),
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",  # the address may hold the token
            "Cache-Control": "no-store",
            "Vary": "Accept-Encoding",
            **({"Content-Encoding": "gzip"} if packs else {}),
        }
        return Response(self._packed if packs else self._body, media_type="text/html", headers=headers)

    def _policy(self) -> str:
        ours = [f"script-src {' '.join(self._scripts)}", f"style-src {' '.join(self._styles)}"]
        return "; ".join([*POLICY, *ours])


def routes(gateway: Gateway) -> list[BaseRoute]:
    fields = {"fleet": gateway.client.fleet_name, "read_only": "yes" if gateway.read_only else "no"}
    tiles = gateway.tiles
    fields["tiles"] = "" if tiles is None else f"{tiles.kind} {tiles.closest or ''}"
    pages = {"fleet": Page("index.html", fields), "docs": Page("docs.html")}

    async def fleet(request: Request) -> Response:
        """The fleet, live, in a browser."""
        return pages["fleet"].response(request)

    async def docs(request: Request) -> Response:
        """This interface, to read and to try."""
        return pages["docs"].response(request)

    async def file(request: Request) -> Response:
        """The file of tiles that the gateway was started with, or the part that a Range header asks for."""
        if tiles is None or tiles.kind != "pmtiles":
            raise Failure(404, "not_found", "no PMTiles here: zmav http --tiles FILE.pmtiles")
        return FileResponse(tiles.path, media_type="application/vnd.pmtiles")

    async def tile(request: Request) -> Response:
        """One tile of the MBTiles that the gateway was started with."""
        z, x, y = (request.path_params[name] for name in "zxy")
        inside = tiles is not None and tiles.kind == "mbtiles" and z <= 30 and x < 1 << z and y < 1 << z
        data = await asyncio.to_thread(tiles.tile, z, x, y) if tiles is not None and inside else None
        if data is None:
            raise Failure(404, "not_found", "there is no such tile")
        kind = next((kind for magic, kind in PICTURES.items() if data.startswith(magic)), "application/octet-stream")
        return Response(data, media_type=kind, headers={"X-Content-Type-Options": "nosniff"})

    return [
        Route("/", fleet, methods=["GET"]),
        Route("/docs", docs, methods=["GET"]),
        Route("/tiles", file, methods=["GET"]),
        Route("/tiles/{z:int}/{x:int}/{y:int}", tile, methods=["GET"]),
    ]


def _read(name: str) -> str:
    return resources.files("ground.http").joinpath("static", name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
