"""A browser driven by WebDriver over HTTP: Debian's Chromium and its driver, from the standard library alone."""

import base64
import http.client
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
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
    """One window of a browser without a screen. It outlives its driver: where that breaks, another takes its place, and the page stays."""

    def __init__(self, width=1024, height=768, log=subprocess.DEVNULL, requests=False):
        """`requests`: what is asked for is noted; the driver holds all of it until it is read."""
        self.log, self.session, self.metrics, self.broken = log, None, None, []
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
        self.logs = {"browser": "ALL", **({"performance": "ALL"} if requests else {})}
        has = self.drive({"args": arguments, "binary": shutil.which("chromium")})
        self.process, self.debugger = has.get("goog:processID"), has["goog:chromeOptions"]["debuggerAddress"]

    def drive(self, options):
        """Starts a driver, with a new browser or one that is there; gives what it can."""
        self.port = free_port()
        command = [shutil.which("chromedriver"), f"--port={self.port}"]
        self.driver = subprocess.Popen(command, stdout=self.log, stderr=self.log, stdin=subprocess.DEVNULL)
        self.wait_until(lambda: self.send("GET", "/status")["ready"], "the driver is ready")
        wanted = {"browserName": "chrome", "goog:chromeOptions": options, "goog:loggingPrefs": self.logs}
        session = self.send("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self.session = f"/session/{session['sessionId']}"
        self.send("POST", self.session + "/timeouts", {"script": PATIENCE_S * 1000, "pageLoad": PATIENCE_S * 1000})
        return session["capabilities"]

    def send(self, method, path, body=None):
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

    def call(self, method, path, body=None):
        """A command to this window; once more where the driver closes the connection without an answer."""
        try:
            return self.send(method, self.session + path, body)
        except (ConnectionError, http.client.HTTPException, urllib.error.URLError) as error:
            self.mend(f"{path}: {error!r}")
            return self.send(method, self.session + path, body)

    def mend(self, why):
        """Puts another driver in the place of one that broke: it finds the browser by its address, and the page as it was."""
        try:
            why += f"; the driver ended with {self.driver.wait(timeout=5)}"
        except subprocess.TimeoutExpired:
            why += "; the driver lives"
            self.driver.kill()
            self.driver.wait()
        self.broken.append(why)
        print(f"browser.py: {why}; another takes its place", file=sys.stderr, flush=True)
        self.drive({"debuggerAddress": self.debugger})
        # This went with the driver.
        if self.metrics:
            self.send("POST", self.session + "/goog/cdp/execute", self.metrics)

    def post(self, path, body):
        """The same, with something to tell."""
        return self.call("POST", path, body)

    def open(self, url):
        """Goes to a page."""
        self.post("/url", {"url": url})

    def size(self, width, height):
        """Makes the page so large, px: the window has a border that differs from build to build."""
        values = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.metrics = {"cmd": "Emulation.setDeviceMetricsOverride", "params": values}
        self.post("/goog/cdp/execute", self.metrics)

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
        return base64.b64decode(self.call("GET", "/screenshot"))

    def console(self):
        """What the console had to say since the last time."""
        return self.post("/se/log", {"type": "browser"})

    def requests(self):
        """Addresses that were asked for since the last time, where they are noted."""
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
            self.send("DELETE", self.session)
        except (OSError, RuntimeError, http.client.HTTPException):
            pass
        self.driver.terminate()
        try:
            self.driver.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self.driver.kill()
        # A driver ends the browser that it started, and no other.
        if self.broken:
            try:
                os.kill(self.process, signal.SIGTERM)
            except ProcessLookupError:
                pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
