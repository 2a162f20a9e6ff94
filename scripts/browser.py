"""A browser driven by WebDriver over HTTP: Debian's Chromium and its driver, from the standard library alone."""

import base64
import json
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request

# The element key of the W3C's WebDriver.
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
# The driver is there, and a page has loaded, within this time, s: a busy machine is slow.
PATIENCE_S = 60


def free_port():
    """A port of the loopback on which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def missing():
    """Names of Debian's packages that are needed and not there."""
    wanted = {"chromium": "chromium", "chromium-driver": "chromedriver"}
    return [package for package, program in wanted.items() if shutil.which(program) is None]


class Browser:
    """One window of a browser without a screen."""

    def __init__(self, width=1024, height=768, log=subprocess.DEVNULL):
        self.port = free_port()
        self.driver = subprocess.Popen(
            [shutil.which("chromedriver"), f"--port={self.port}"], stdout=log, stderr=log, stdin=subprocess.DEVNULL
        )
        self.wait_until(lambda: self.call("GET", "/status")["ready"], "the driver is ready")
        arguments = [
            "--headless=new",
            "--no-sandbox",  # CI runs as root
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--enable-precise-memory-info",
            f"--window-size={width},{height}",
        ]
        wanted = {
            "browserName": "chrome",
            "goog:chromeOptions": {"args": arguments, "binary": shutil.which("chromium")},
            "goog:loggingPrefs": {"browser": "ALL", "performance": "ALL"},
        }
        session = self.call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self.session = f"/session/{session['sessionId']}"
        self.process = session["capabilities"].get("goog:processID")
        self.post("/timeouts", {"script": PATIENCE_S * 1000, "pageLoad": PATIENCE_S * 1000})

    def call(self, method, path, body=None):
        """One command of the protocol."""
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", data=data, method=method)
        request.add_header("Content-Type", "application/json")
        try:
            with urllib.request.urlopen(request, timeout=2 * PATIENCE_S) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            value = json.load(error)["value"]
            raise RuntimeError(f"{path}: {value['error']}: {value['message'].splitlines()[0]}") from None

    def post(self, path, body):
        """A command to this window."""
        return self.call("POST", self.session + path, body)

    def open(self, url):
        """Goes to a page."""
        self.post("/url", {"url": url})

    def size(self, width, height):
        """Makes the page so large, px: the window has a border that differs from build to build."""
        self.devtools("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)

    def devtools(self, command, **values):
        """A command of Chromium's own."""
        return self.post("/goog/cdp/execute", {"cmd": command, "params": values})

    def run(self, script, *values):
        """Runs a function's body in the page, and gives what it returns."""
        return self.post("/execute/sync", {"script": script, "args": list(values)})

    def run_async(self, script, *values):
        """The same, of a function that gives its result to its last argument."""
        return self.post("/execute/async", {"script": script, "args": list(values)})

    def find(self, selector):
        """An element."""
        return self.post("/element", {"using": "css selector", "value": selector})[ELEMENT]

    def click(self, selector):
        """Clicks an element, as a mouse does."""
        self.post(f"/element/{self.find(selector)}/click", {})

    def drag(self, selector, *ways):
        """Presses the mouse at the first of some places of an element, px from its middle, and lets go at the last."""
        origin = {ELEMENT: self.find(selector)}
        moves = [{"type": "pointerMove", "duration": 50, "origin": origin, "x": round(x), "y": round(y)} for x, y in ways]
        actions = [moves[0], {"type": "pointerDown", "button": 0}, *moves[1:], {"type": "pointerUp", "button": 0}]
        self.post("/actions", {"actions": [{"type": "pointer", "id": "mouse", "actions": actions}]})

    def keys(self, selector, text):
        """Types into an element."""
        self.post(f"/element/{self.find(selector)}/value", {"text": text})

    def shot(self):
        """The page as it is seen: the bytes of a PNG file."""
        return base64.b64decode(self.call("GET", self.session + "/screenshot"))

    def console(self):
        """What the console had to say since the last time."""
        return self.post("/se/log", {"type": "browser"})

    def requests(self):
        """Addresses that were asked for since the last time."""
        entries = [json.loads(entry["message"])["message"] for entry in self.post("/se/log", {"type": "performance"})]
        return [entry["params"]["request"]["url"] for entry in entries if entry["method"] == "Network.requestWillBeSent"]

    def wait_until(self, holds, what, patience_s=PATIENCE_S):
        """Waits until something holds; gives it."""
        deadline = time.monotonic() + patience_s
        while True:
            try:
                got = holds()
                if got:
                    return got
            except (OSError, RuntimeError, KeyError, TypeError):
                pass
            if time.monotonic() > deadline:
                raise RuntimeError(f"never within {patience_s} s: {what}")
            time.sleep(0.1)

    def wait(self, script, what, patience_s=PATIENCE_S):
        """Waits until the page says that something holds."""
        return self.wait_until(lambda: self.run(script), what, patience_s)

    def close(self):
        """Ends the browser and its driver."""
        try:
            self.call("DELETE", self.session)
        except (OSError, RuntimeError):
            pass
        self.driver.terminate()
        try:
            self.driver.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self.driver.kill()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
