"""The server of a page on this machine, for those who sit at it, and text on the page that is only text."""

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
#: Names under which a browser finds it.
LOCAL = (HOST, "localhost")
#: What is shown of a name or of a text at most; a page with more of it could not be read.
LONGEST = 80
LONGEST_MESSAGE = 2000

# Where the library of its connections says what goes wrong with them.
_LOGGER = logging.getLogger("websockets.server")

# Of a page that is not ours: the policy of it is violated (RFC 6455, 7.4.1).
_REFUSED = 1008


class LocalServer(viser.ViserServer):
    """Serves a page on 127.0.0.1, and to nobody else.

    Args:
        port: Number of the port, or of the first that is tried; 0: any that is free.
        title: What the page is called.

    Raises:
        ValueError: If that is no port.
    """

    def __init__(self, port: int, title: str) -> None:
        if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port < 2**16:
            raise ValueError(f"port must be a whole number from 0 to {2**16 - 1}, got {port!r}")
        with _silence():
            super().__init__(host=HOST, port=port, label=shortened(title), verbose=False)
        thread = self._websock_server._server_thread.ident

        def is_reportable(record: logging.LogRecord) -> bool:
            # Browsers open connections ahead and close them unused, which is no fault of anybody.
            error = record.exc_info[1] if record.exc_info else None
            return record.thread != thread or not isinstance(error, InvalidHandshake)

        self._is_reportable = is_reportable
        _LOGGER.addFilter(is_reportable)
        self.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")

        async def check(connection: Any) -> None:
            # Pages of others, open in the same browser, reach this machine as well.
            socket = self._websock_server._live_connections[connection.client_id]
            if not is_own(socket.request.headers.get("Host"), socket.request.headers.get("Origin")):
                await socket.close(_REFUSED, "this page may not look here")
                # What it had sent already is not to be taken for what our page says.
                with contextlib.suppress(ConnectionClosed):
                    while True:
                        await socket.recv()

        self._websock_server.on_client_connect(check)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.get_port()}"

    def request_share_url(self, verbose: bool = True) -> None:
        """Shares nothing: viser would open a tunnel to a server of others for whoever asks on the page."""

    def stop(self) -> None:
        """Ends the server and its connections."""
        with _silence():
            super().stop()
        _LOGGER.removeFilter(self._is_reportable)


def is_own(host: str | None, origin: str | None) -> bool:
    """Whether a connection comes from the page itself, or from no browser, by two headers of its request."""
    if host is None or urlsplit(f"//{host}").hostname not in LOCAL:
        return False
    return origin is None or origin == f"http://{host}"


def shortened(text: str, most: int = LONGEST) -> str:
    """Returns a text in one line of at most ``most`` characters."""
    return safe_text.truncate(safe_text.single_line(text), most)


def table(rows: Iterable[tuple[str, str]]) -> str:
    """Returns HTML of a table of two columns, whatever is in its texts."""
    cell = '<td style="padding:0 0.6em 0.1em 0;vertical-align:top;overflow-wrap:anywhere">'
    lines = [f"<tr>{''.join(f'{cell}{_escaped(text)}</td>' for text in row)}</tr>" for row in rows]
    return f'<table style="{_STYLE}">{"".join(lines)}</table>'


def message(text: str, *, bad: bool = False) -> str:
    """Returns HTML of lines of text, whatever is in it; red if ``bad``."""
    color = ";color:#d6336c" if bad else ""
    content = html.escape(text if len(text) <= LONGEST_MESSAGE else f"{text[:LONGEST_MESSAGE]}…")
    return f'<div style="{_STYLE};white-space:pre-wrap;overflow-wrap:anywhere{color}">{content}</div>'


def gap_legend(deepest: float, far: float) -> str:
    """Returns HTML of the colours of gaps, from a depth to a distance [m]."""
    colors = ", ".join(f"rgb{color}" for _, color in GAPS)
    bar = f"height:0.6em;boundary-radius:0.3em;background:linear-gradient(to right, {colors})"
    ends = f"<span>−{deepest:.3g} m</span><span>0</span><span>{far:.3g} m</span>"
    line = f'<div style="display:flex;justify-content:space-between">{ends}</div>'
    return f'<div style="{_STYLE}"><div style="{bar}"></div>{line}</div>'


_STYLE = "margin:0 0.9em 0.5em;font-size:0.8em;line-height:1.45"


def _escaped(text: str) -> str:
    return html.escape(shortened(text))


_silenced = threading.Lock()


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keeps viser from printing: the command says where the page is."""
    console = rich.get_console()
    with _silenced:
        before, console.quiet = console.quiet, True
        try:
            yield
        finally:
            console.quiet = before
