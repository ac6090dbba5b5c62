"""A page in headless Chromium, driven by the DevTools protocol: what it shows, does, complains of and asks for."""

import base64
import functools
import itertools
import json
import os
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# Software GL on a busy machine of few cores takes its time.
PATIENCE = 120.0
_FLAGS = (
    "--headless=new",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--remote-debugging-port=0",
)
_ENDPOINT = re.compile(rb"DevTools listening on (ws://\S+)")


@functools.cache
def chromium():
    """Returns the path of a Chromium, or None; ``WARPCONTACT_CHROMIUM`` names one."""
    named = os.environ.get("WARPCONTACT_CHROMIUM")
    return named or next(filter(None, map(shutil.which, NAMES)), None)


def why_not():
    """Returns why no page can be looked at here, or nothing."""
    try:
        import websockets.sync.client  # noqa: F401
    except ImportError:
        return "websockets is not installed"
    if chromium() is None:
        return f"there is no {' or '.join(NAMES)}; WARPCONTACT_CHROMIUM may name one"
    return ""


class Browser:
    """A running Chromium; use it with ``with``."""

    def __enter__(self):
        from websockets.sync.client import connect

        self._profile = tempfile.mkdtemp(prefix="chromium-")
        sandbox = ("--no-sandbox",) if hasattr(os, "geteuid") and os.geteuid() == 0 else ()
        command = [chromium(), *_FLAGS, *sandbox, f"--user-data-dir={self._profile}", "about:blank"]
        self._log = tempfile.TemporaryFile()
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=self._log)
        try:
            self._socket = connect(self._endpoint(), max_size=None, proxy=None, open_timeout=PATIENCE)
        except BaseException:
            self._end()
            raise
        self._numbers = itertools.count(1)
        self.events = []
        return self

    def __exit__(self, *_):
        self._socket.close()
        self._end()

    def _end(self):
        self._process.kill()
        self._process.wait()
        self._log.close()
        shutil.rmtree(self._profile, ignore_errors=True)

    def _endpoint(self):
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline and self._process.poll() is None:
            self._log.seek(0)
            found = _ENDPOINT.search(self._log.read())
            if found:
                return found[1].decode()
            time.sleep(0.05)
        self._log.seek(0)
        raise RuntimeError(f"Chromium did not start: {self._log.read()[-2000:].decode(errors='replace')}")

    def send(self, method, session=None, **parameters):
        """Sends a command and returns its result; events that come before it are kept."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def open(self, path, width=1280, height=800, scale=1.0, *, dark=False, phone=False, script=True, features=()):
        """Opens a file as a page of this size [px]; returns it when it is loaded."""
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = Page(self, target, session)
        for domain in ("Page", "Runtime", "Network", "Log"):
            page.send(f"{domain}.enable")
        if not script:
            page.send("Emulation.setScriptExecutionDisabled", value=True)
        page.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=phone
        )
        page.send("Emulation.setTouchEmulationEnabled", enabled=phone)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        page.send("Emulation.setEmulatedMedia", features=[scheme, *features])
        page.send("Page.navigate", url=Path(path).resolve().as_uri())
        if script:
            page.wait("document.readyState === 'complete'")
        else:
            page.wait_for_event("Page.loadEventFired")
        return page


class Page:
    """An open page."""

    def __init__(self, browser, target, session):
        self.browser = browser
        self.target = target
        self.session = session

    def send(self, method, **parameters):
        return self.browser.send(method, self.session, **parameters)

    def run(self, expression):
        """Returns the value of an expression in the page; waits for promises."""
        answer = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, expression, timeout=PATIENCE):
        """Waits until an expression holds."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            if self.run(expression):
                return
            time.sleep(0.03)
        raise TimeoutError(expression)

    def wait_for_event(self, method, timeout=PATIENCE):
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            if any(event.get("method") == method for event in self._events()):
                return
            self.send("Page.getFrameTree")  # receives what has come
            time.sleep(0.03)
        raise TimeoutError(method)

    def state(self):
        """Returns what the replay shows, once it is drawn."""
        self.wait("window.warpcontact.ready")
        return self.run("window.warpcontact.state()")

    def press(self, key, **more):
        """Presses a key."""
        text = {"text": key} if len(key) == 1 else {}
        self.send("Input.dispatchKeyEvent", type="keyDown", key=key, **text, **more)
        self.send("Input.dispatchKeyEvent", type="keyUp", key=key, **more)

    def click(self, selector):
        """Clicks in the middle of an element, as a reader does."""
        box = self.run(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)}); "
            "e.scrollIntoView({block: 'center', behavior: 'instant'}); const b = e.getBoundingClientRect(); "
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        where = {"x": box[0], "y": box[1], "button": "left", "clickCount": 1}
        self.send("Input.dispatchMouseEvent", type="mousePressed", **where)
        self.send("Input.dispatchMouseEvent", type="mouseReleased", **where)

    def drawn(self):
        """Waits until what was changed is drawn."""
        self.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def screenshot(self, path=None, *, whole=False):
        """Returns the picture of the page as PNG, and writes it if ``path`` is given."""
        self.drawn()
        answer = self.send("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        content = base64.b64decode(answer["data"])
        if path is not None:
            Path(path).write_bytes(content)
        return content

    def close(self):
        self.browser.send("Target.closeTarget", targetId=self.target)

    def complaints(self):
        """Returns messages of the console, exceptions, and what the browser itself logged, such as violations."""
        found = []
        for event in self._events():
            what, about = event.get("method"), event.get("params", {})
            if what == "Runtime.consoleAPICalled":
                words = " ".join(str(arg.get("value", arg.get("description"))) for arg in about["args"])
                found.append(f"console.{about['type']}: {words}")
            elif what == "Runtime.exceptionThrown":
                details = about["exceptionDetails"]
                found.append(f"exception: {details.get('exception', {}).get('description', details['text'])}")
            elif what == "Log.entryAdded":
                found.append(f"{about['entry']['source']} {about['entry']['level']}: {about['entry']['text']}")
        return found

    def requests(self):
        """Returns the addresses of all requests but that of the page itself and of data in it."""
        urls = [
            event["params"]["request"]["url"]
            for event in self._events()
            if event.get("method") == "Network.requestWillBeSent"
        ]
        return [url for url in urls[1:] if not url.startswith(("data:", "blob:"))]

    def _events(self):
        return [event for event in self.browser.events if event.get("sessionId") == self.session]
