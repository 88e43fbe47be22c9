"""Rerun's own viewer, native or as a web page, as a process beside a painter."""

from __future__ import annotations

import contextlib
import http.client
import importlib.util
import os
import socket
import subprocess
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

from ground.view.screen import Sink
from zmav.errors import BadConfig, missing_extra
from zmav.process import free_port

HOST = "127.0.0.1"
MEMORY, SERVER_MEMORY = "2GB", "512MB"
"""that the viewer and its server keep at most; the oldest is forgotten first"""
START = 20.0
"""s for it to listen, on a busy machine"""


def check_extra() -> None:
    """Raises :class:`BadConfig` where Rerun is not installed."""
    if importlib.util.find_spec("rerun") is None:
        raise missing_extra("'zmav view'", "Rerun", "viz")


def check_display() -> None:
    """Raises :class:`BadConfig` where there is no display for a window."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        text = "there is no display to open a window on: use --web (a page for a browser) or --save FILE.rrd"
        raise BadConfig(text, field="DISPLAY", value=None, expected="a display, --web or --save")


def native_sink() -> Sink:
    port = free_port()
    return Sink("native", url=proxy(port), port=port)


def web_sink(web_port: int) -> Sink:
    """On that port and the next one, on loopback. Raises :class:`BadConfig` for a port that is taken."""
    for port in (web_port, web_port + 1):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, port))
            except (OSError, OverflowError) as e:
                text = f"port {port} on {HOST} cannot be had: {e}; say --port with another (it takes the next one, too)"
                raise BadConfig(text, field="port", value=port, expected="two free ports") from e
    return Sink("web", url=proxy(web_port + 1), port=web_port + 1, web_port=web_port)


def proxy(port: int) -> str:
    return f"rerun+http://{HOST}:{port}/proxy"


def page(sink: Sink) -> str:
    """Where a browser finds the web viewer."""
    return f"http://{HOST}:{sink.web_port}/?url={quote(sink.url, safe='')}"


def serve_page(sink: Sink, source: int) -> None:
    """Serve Rerun's page, which is at port ``source``, with a policy by which the browser lets it reach nobody but us.
    By itself it sends statistics of its use, which no setting ends. Raises :class:`BadConfig` for a port that is taken.
    """
    policy = f"connect-src 'self' http://{HOST}:{sink.port} data: blob:"

    class Handler(BaseHTTPRequestHandler):
        def handle(self) -> None:
            with contextlib.suppress(ConnectionError):  # the page was closed meanwhile
                super().handle()

        def do_GET(self) -> None:
            try:
                asked = http.client.HTTPConnection(HOST, source, timeout=START)
                asked.request("GET", self.path, headers={"Accept-Encoding": self.headers["Accept-Encoding"] or ""})
                answer = asked.getresponse()
                body = answer.read()
            except (OSError, http.client.HTTPException) as e:
                self.send_error(502, explain=f"Rerun's viewer does not answer: {e}")
                return
            told = {name: answer.getheader(name) for name in ("Content-Type", "Content-Encoding")}
            told |= {"Content-Length": str(len(body)), "Content-Security-Policy": policy}
            self.send_response(answer.status)
            for name, value in told.items():
                if value is not None:
                    self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Not in the terminal of who flies."""

    try:
        server = ThreadingHTTPServer((HOST, sink.web_port), Handler)
    except OSError as e:  # somebody has taken it since it was looked at
        text = f"port {sink.web_port} on {HOST} cannot be had: {e}"
        raise BadConfig(text, field="port", value=sink.web_port, expected="a free port") from e
    threading.Thread(target=server.serve_forever, daemon=True).start()


def start_viewer(sink: Sink) -> subprocess.Popen[bytes]:
    """Start it and wait until it listens. Raises :class:`BadConfig` where it does not."""
    command = [*program(), "--bind", HOST, "--port", str(sink.port), "--server-memory-limit", SERVER_MEMORY]
    if sink.kind == "web":
        source = free_port()
        command += ["--serve-web", "--web-viewer-port", str(source)]
        serve_page(sink, source)
    else:
        command += ["--memory-limit", MEMORY, "--hide-welcome-screen", "--expect-data-soon"]
    # With CI set, Rerun sends no usage statistics: nobody who flies was asked for them.
    quiet = {"RUST_LOG": "error", "CI": "1", **os.environ}
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=quiet)
    deadline = time.monotonic() + START
    while process.poll() is None and time.monotonic() < deadline:
        with socket.socket() as probe:
            probe.settimeout(1.0)
            if probe.connect_ex((HOST, sink.port)) == 0:
                return process
        time.sleep(0.05)
    code = process.poll()
    process.kill()
    process.wait()
    text = "it does not listen" if code is None else f"it ended with {code}"
    raise BadConfig(f"Rerun's viewer did not start: {text}", field="view", expected="a viewer that starts")


def program() -> list[str]:
    """Rerun's own program: not the script around it, which would outlive a signal's victim."""
    spec = importlib.util.find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        found = Path(folder) / "rerun"
        if found.is_file():
            return [str(found)]
    return ["rerun"]
