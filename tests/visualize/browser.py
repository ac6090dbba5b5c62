"""A page in headless Chromium, controlled by the DevTools protocol: content, requests and errors."""

import base64
import contextlib
import itertools
import json
import os
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    # Blocks background requests of Chromium itself; requests of the page are recorded.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--remote-debugging-port=0",
)
DESKTOP = (1280, 800)
PHONE = (390, 844)


def executable():
    """Path of a Chromium; ``WARPCONTACT_CHROMIUM`` sets it. The test is skipped if there is none."""
    found = os.environ.get("WARPCONTACT_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    if not found:
        pytest.skip("there is no Chromium to look at pages with")
    return found


@contextlib.contextmanager
def browser(folder):
    """Starts Chromium with its profile in ``folder``; yields a function that opens pages.

    ``page(url, size, dark, still, script)``: ``still``: reduced motion; ``script``: whether scripts are enabled.
    """
    profile = Path(folder) / "profile"
    port_file = profile / "DevToolsActivePort"
    port_file.unlink(missing_ok=True)  # from an earlier browser with this folder
    command = [executable(), *FLAGS, f"--user-data-dir={profile}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        ended = lambda: process.poll() is not None  # noqa: E731
        started = lambda: port_file.is_file() and "\n" in port_file.read_text()  # noqa: E731
        _wait(lambda: started() or ended(), 120.0, "Chromium to start")
        if ended():
            # On some systems the program only prints how to install it.
            pytest.skip(f"{command[0]} does not start: exit code {process.returncode}")
        port = int(port_file.read_text().split("\n")[0])

        @contextlib.contextmanager
        def page(url, size=DESKTOP, dark=False, still=False, script=True):
            with contextlib.closing(Page(port, size, dark, still, script)) as opened:
                opened.go(url)
                yield opened

        yield page
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Page:
    """A tab.

    Attributes:
        requests: URLs requested by the page and its workers, including sockets, except data and blob URLs.
        errors: Logged errors and uncaught exceptions.
    """

    def __init__(self, port, size, dark, still, script):
        from websockets.sync.client import connect

        request = urllib.request.Request(f"http://127.0.0.1:{port}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(request) as answer:
            address = json.load(answer)["webSocketDebuggerUrl"]
        self._socket = connect(address, max_size=None, compression=None, proxy=None)
        self._numbers = itertools.count(1)
        self._answers = {}
        self.requests, self.errors = [], []
        self._listen(None)
        self.call("Page.enable")
        width, height = size
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < height,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        motion = {"name": "prefers-reduced-motion", "value": "reduce" if still else "no-preference"}
        self.call("Emulation.setEmulatedMedia", features=[scheme, motion])
        self.call("Emulation.setTouchEmulationEnabled", enabled=width < height)
        if not script:
            self.call("Emulation.setScriptExecutionDisabled", value=True)

    def _listen(self, session):
        # Workers pause until their requests are recorded as well.
        follow = {"autoAttach": True, "waitForDebuggerOnStart": True, "flatten": True}
        for method, options in (
            ("Runtime.enable", {}),
            ("Log.enable", {}),
            ("Network.enable", {}),
            ("Target.setAutoAttach", follow),
        ):
            # Workers do not have all of these methods.
            with contextlib.suppress(RuntimeError) if session else contextlib.nullcontext():
                self.call(method, session, **options)

    def call(self, method, session=None, **options):
        """Calls a method of the DevTools protocol and returns its result."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": options}
        self._socket.send(json.dumps(message | ({"sessionId": session} if session else {})))
        while number not in self._answers:
            self._take(json.loads(self._socket.recv(timeout=120)))
        answer = self._answers.pop(number)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']['message']}")
        return answer["result"]

    def _take(self, event):
        if "id" in event:
            # The answer to this call, or to an earlier one that processed events while it waited.
            self._answers[event["id"]] = event
            return
        method, options = event["method"], event.get("params", {})
        if method == "Target.attachedToTarget":
            session = options["sessionId"]
            self._listen(session)
            self.call("Runtime.runIfWaitingForDebugger", session)
        elif method == "Network.requestWillBeSent":
            if not options["request"]["url"].startswith(("data:", "blob:")):
                self.requests.append(options["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requests.append(options["url"])
        elif method == "Runtime.exceptionThrown":
            details = options["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled" and options["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(one.get("value", one.get("description"))) for one in options["args"]))
        elif method == "Log.entryAdded" and options["entry"]["level"] == "error":
            entry = options["entry"]
            self.errors.append(f"{entry['text']} {entry.get('url', '')}".strip())

    def listen(self, seconds):
        """Processes events for some seconds."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            try:
                self._take(json.loads(self._socket.recv(timeout=left)))
            except TimeoutError:
                return

    def go(self, url):
        """Opens ``url`` and waits until it is loaded."""
        self.call("Page.navigate", url=url)
        self.wait_for("location.href !== 'about:blank' && document.readyState === 'complete'")

    def evaluate(self, expression):
        """Returns the value of a JavaScript expression, awaiting a promise."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise AssertionError(details.get("exception", {}).get("description") or details["text"])
        return answer["result"].get("value")

    def wait_for(self, expression, timeout=60.0):
        """Waits until an expression is true; returns its value."""
        found = []

        def holds():
            found[:] = [self.evaluate(expression)]
            return found[0]

        _wait(holds, timeout, expression, self.listen)
        return found[0]

    def text(self):
        """Visible text of the page."""
        return self.evaluate("document.body.innerText")

    def place(self, expression):
        """Center [px] of the element given by an expression, after it exists and was scrolled into view."""
        self.wait_for(f"Boolean({expression})")
        box = (
            "(e => { e.scrollIntoView({block: 'center', behavior: 'instant'}); "
            "const r = e.getBoundingClientRect(); "
            f"return [r.x + r.width / 2, r.y + r.height / 2]; }})({expression})"
        )
        return self.evaluate(box)

    def mouse(self, kind, x, y, **options):
        """Sends a mouse event, such as ``mousePressed``."""
        down = {} if kind == "mouseMoved" and not options.get("buttons") else {"button": "left"}
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **{"clickCount": 1} | down | options)

    def click(self, expression):
        """Clicks on the element given by an expression."""
        x, y = self.place(expression)
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)

    def drag(self, start, end):
        """Drags the mouse from ``start`` to ``end`` [px]."""
        self.mouse("mouseMoved", *start)
        self.mouse("mousePressed", *start)
        for part in (0.25, 0.5, 0.75, 1.0):
            x, y = (a + part * (b - a) for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", x, y, buttons=1)
        self.mouse("mouseReleased", *end)

    def key(self, key, code=None, number=0, text=""):
        """Presses and releases a key."""
        same = {"key": key, "code": code or key, "windowsVirtualKeyCode": number}
        self.call("Input.dispatchKeyEvent", type="keyDown", text=text, **same)
        self.call("Input.dispatchKeyEvent", type="keyUp", **same)

    def write(self, text):
        """Types text at the cursor."""
        self.call("Input.insertText", text=text)

    def screenshot(self, path=None):
        """Takes a screenshot; returns the bytes of the PNG, and writes them to ``path``."""
        content = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            Path(path).write_bytes(content)
        return content

    def close(self):
        """Closes the tab."""
        with contextlib.suppress(Exception):
            self.call("Page.close")
        self._socket.close()


def _wait(holds, timeout, what, pause=time.sleep):
    end = time.monotonic() + timeout
    while not holds():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {timeout:g} s for {what}")
        pause(0.05)
