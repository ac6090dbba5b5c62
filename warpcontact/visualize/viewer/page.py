"""Local web server of the viewer page, with connection checks, and HTML with escaped text."""

import contextlib
import html
import logging
import threading
from collections.abc import Iterable, Iterator
from typing import Any
from urllib.parse import urlsplit

import rich
import viser
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from warpcontact.drawing.colors import GAPS
from warpcontact.validation import safe_text

HOST = "127.0.0.1"
#: Host names accepted in requests of a browser.
LOCAL = (HOST, "localhost")
#: Largest number of characters shown of a name and of a message, so that the page stays readable.
LONGEST = 80
LONGEST_MESSAGE = 2000

# Logger to which the websockets library reports connection errors.
_LOGGER = logging.getLogger("websockets.server")

# WebSocket close code "policy violation" (RFC 6455, 7.4.1), for connections from foreign pages.
_REFUSED = 1008


class LocalServer(viser.ViserServer):
    """Serves a page on 127.0.0.1 and accepts connections of this page only.

    Args:
        port: Port number. If it is in use, the next free port is taken. 0: any free port.
        title: Title of the page.

    Raises:
        ValueError: If ``port`` is not an integer from 0 to 65535.
    """

    def __init__(self, port: int, title: str) -> None:
        if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port < 2**16:
            raise ValueError(f"port must be a whole number from 0 to {2**16 - 1}, got {port!r}")
        with _silence():
            super().__init__(host=HOST, port=port, label=shortened(title), verbose=False)
        thread = self._websock_server._server_thread.ident

        def is_reportable(record: logging.LogRecord) -> bool:
            # Browsers open connections in advance and close them unused, which is not an error.
            error = record.exc_info[1] if record.exc_info else None
            return record.thread != thread or not isinstance(error, InvalidHandshake)

        self._is_reportable = is_reportable
        _LOGGER.addFilter(is_reportable)
        self.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")

        async def check(connection: Any) -> None:
            # Pages from other sites, open in the same browser, can reach this machine as well.
            socket = self._websock_server._live_connections[connection.client_id]
            if not is_own(socket.request.headers.get("Host"), socket.request.headers.get("Origin")):
                await socket.close(_REFUSED, "connections from other pages are refused")
                # Discard messages that were sent before the close, so that they are not processed.
                with contextlib.suppress(ConnectionClosed):
                    while True:
                        await socket.recv()

        self._websock_server.on_client_connect(check)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.get_port()}"

    def request_share_url(self, verbose: bool = True) -> None:
        """Does nothing. viser would open a public tunnel on request of the page."""

    def stop(self) -> None:
        """Stops the server and closes its connections."""
        with _silence():
            super().stop()
        _LOGGER.removeFilter(self._is_reportable)


def is_own(host: str | None, origin: str | None) -> bool:
    """Returns whether the headers ``Host`` and ``Origin`` show a connection from this page or from no browser."""
    if host is None or urlsplit(f"//{host}").hostname not in LOCAL:
        return False
    return origin is None or origin == f"http://{host}"


def shortened(text: str, most: int = LONGEST) -> str:
    """Returns a text as one line of at most ``most`` characters."""
    return safe_text.truncate(safe_text.single_line(text), most)


def table(rows: Iterable[tuple[str, str]]) -> str:
    """Returns an HTML table of two columns with escaped, shortened texts."""
    cell = '<td style="padding:0 0.6em 0.1em 0;vertical-align:top;overflow-wrap:anywhere">'
    lines = [f"<tr>{''.join(f'{cell}{_escaped(text)}</td>' for text in row)}</tr>" for row in rows]
    return f'<table style="{_STYLE}">{"".join(lines)}</table>'


def message(text: str, *, bad: bool = False) -> str:
    """Returns an HTML element with escaped lines of text; red if ``bad``."""
    color = ";color:#d6336c" if bad else ""
    content = html.escape(text if len(text) <= LONGEST_MESSAGE else f"{text[:LONGEST_MESSAGE]}…")
    return f'<div style="{_STYLE};white-space:pre-wrap;overflow-wrap:anywhere{color}">{content}</div>'


def gap_legend(deepest: float, far: float) -> str:
    """Returns an HTML legend of the gap colors, from penetration ``deepest`` [m] to distance ``far`` [m]."""
    colors = ", ".join(f"rgb{color}" for _, color in GAPS)
    bar = f"height:0.6em;border-radius:0.3em;background:linear-gradient(to right, {colors})"
    ends = f"<span>−{deepest:.3g} m</span><span>0</span><span>{far:.3g} m</span>"
    line = f'<div style="display:flex;justify-content:space-between">{ends}</div>'
    return f'<div style="{_STYLE}"><div style="{bar}"></div>{line}</div>'


_STYLE = "margin:0 0.9em 0.5em;font-size:0.8em;line-height:1.45"


def _escaped(text: str) -> str:
    return html.escape(shortened(text))


_silenced = threading.Lock()


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Suppresses the printed output of viser; the command line prints the address of the page itself."""
    console = rich.get_console()
    with _silenced:
        before, console.quiet = console.quiet, True
        try:
            yield
        finally:
            console.quiet = before
