#!/usr/bin/env python3
"""Looks at the page in a real browser: Debian's Chromium, driven from the standard library.

    page.py test STARS SCRATCH [AXE]     every panel, the overlay, both tools, commands, a restart; AXE: axe.min.js, to judge access
    page.py shot STARS SCRATCH FILE      a screenshot for the README
    page.py latency STARS SCRATCH        new frame to picture
    page.py long STARS SCRATCH FRAMES    so many frames at 5 a second in one open page: memory, and each frame's number

STARS is the program. Prints a line `wanted: … got: … PASS|FAIL` for each thing wanted; exits 1 if any failed.
"""

import json
import math
import re
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

from browser import Browser, free_port, missing
from score import Verdict
from watch_service import settings, stop

ROOT = Path(__file__).resolve().parent.parent
# A star's square is drawn this near to where the truth has the star, px of the picture.
NEAR_PX = 2.0
# Half a side of a source's square, px of the screen, as the page has it.
SQUARE_PX = 9
# What is asked of a screen, px: the camera's own, a large one, a phone.
SCREENS = ((1024, 768), (1920, 1080), (390, 844))
# New frame to picture, ms.
PICTURE_MS = 300
# A page that is open for long answers within this, s.
ANSWERS_S = 600
# Memory that a page may gain while it is open, of what it had after its first frames.
GAIN = 0.10


class Service:
    """`stars run` or `stars demo` with a page on a port of its own."""

    def __init__(self, stars, scratch, what="run", port=None, **values):
        self.stars, self.port, self.what = stars, port or free_port(), what
        self.network = f"127.0.0.1:{free_port()}"
        self.scratch = Path(scratch)
        wanted = {
            "display__listen": f"127.0.0.1:{self.port}",
            "network__listen": self.network,
            "camera__startup_delay_s": 0,
            "camera__period_s": 1.0,
            "record__enabled": "false",
            "commands__ledger_directory": "",
            **values,
        }
        self.out = open(self.scratch / f"{what}-{self.port}.out", "a+", encoding="utf-8")
        self.process = subprocess.Popen([stars, what] + settings(**wanted), stdout=self.out, stderr=subprocess.STDOUT)

    def url(self, path=""):
        """The address of a route."""
        return f"http://127.0.0.1:{self.port}/{path}"

    def get(self, path):
        """What a route answers."""
        with urllib.request.urlopen(self.url(path), timeout=30) as answer:
            return answer.read()

    def json(self, path):
        """The same, read."""
        return json.loads(self.get(path))

    def state(self, holds=lambda state: True, patience_s=90):
        """The state, once something holds of it."""
        deadline = time.monotonic() + patience_s
        while True:
            try:
                state = self.json("state")
                if holds(state):
                    return state
            except (urllib.error.URLError, OSError):
                pass
            if time.monotonic() > deadline or self.process.poll() is not None:
                raise RuntimeError("the service never came to that; see " + self.out.name)
            time.sleep(0.1)

    def command(self, *orders):
        """Gives commands as a flight computer in charge; whether all were done."""
        call = [self.stars, "fcp", "--connect", self.network, "--id", "1", "--in-charge", "--json"]
        given = subprocess.run(
            call + [part for order in orders for part in ("--send", order)], stdout=subprocess.PIPE, timeout=90, check=False, text=True
        )
        return given.returncode == 0

    def close(self):
        """Ends it."""
        stop(self.process)
        self.out.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def rows(browser):
    """What all panels show, with the state and the frame that they show it of, taken in one go."""
    return browser.run(
        """
        const panels = {};
        for (const row of document.querySelectorAll("main table tr")) {
          const panel = row.closest("section").id;
          (panels[panel] = panels[panel] || {})[row.cells[0].textContent] = row.cells[1].textContent;
        }
        return { panels, state: stars.state, view: stars.view, verdict: document.getElementById("verdict").textContent };
        """
    )


def show(value, digits, unit=""):
    """A number as the page shows it."""
    if value is None:
        return "unknown"
    # As JavaScript rounds, not as Python does: both are right to within the last digit.
    return f"{value:.{digits}f}" + ("" if not unit else unit if unit[0] in "°″′" else " " + unit)


def same(shown, wanted):
    """Whether the page shows what is wanted, the last digit of a number aside."""
    if shown == wanted:
        return True
    number = re.compile(r"-?\d+(?:\.(\d+))?")
    if number.sub("#", shown) != number.sub("#", wanted):
        return False
    pairs = zip(number.finditer(shown), number.finditer(wanted))
    return all(abs(float(a[0]) - float(b[0])) <= 1.01 * 10.0 ** -len(a[1] or "") for a, b in pairs)


def check_panels(verdict, browser, frame_of):
    """Every panel is filled, and with what the service says."""
    got = rows(browser)
    state, view, panels = got["state"], got["view"], got["panels"]
    report = view["report"]
    image = report["image_counter"]
    served = frame_of(image)
    verdict("the frame shown is the one that is served", f"image {image}", served["report"] == report)
    empty = [f"{panel}: {name}" for panel, cells in panels.items() for name, value in cells.items() if not value.strip()]
    wanted_panels = {"facts", "statistics", "solution", "requirements", "camera", "housekeeping", "lens", "links", "commands", "service"}
    verdict("ten panels filled", f"{len(panels)} panels, empty: {empty or 'none'}", wanted_panels <= set(panels) and not empty)
    stats, lens = report["stats"], state["lens"]
    wanted = {
        ("statistics", "mean"): show(stats["mean"], 1, "ADU"),
        ("statistics", "noise"): show(stats["noise"], 2, "ADU"),
        ("statistics", "star width"): show(stats["fwhm_px"], 2, "px"),
        ("statistics", "sources"): f"{report['sources_found']} found, {report['sources_tried']} tried",
        ("facts", "image"): str(image),
        ("facts", "file"): report["image"],
        ("facts", "exposed"): f"{show(report['exposure_s'], 3, 's')}, {show(report['gain_db'], 1, 'dB')}",
        ("solution", "RA"): show(report["ra_deg"], 5, "°"),
        ("solution", "Dec"): show(report["dec_deg"], 5, "°"),
        ("solution", "plate scale"): show(report["platescale_arcsec_px"], 4, "″/px"),
        ("solution", "azimuth"): show(report["az_deg"], 4, "°"),
        ("camera", "solver"): state["solver"],
        ("camera", "clock"): state["time"]["quality"].replace("_", " "),
        ("lens", "focus"): str(lens["focus_counts"]) if lens["focus_counts"] is not None else "unknown: " + lens["focus"].replace("_", " "),
        ("commands", "accepted"): f"{state['commands']['accepted']}, {state['commands']['under_way']} under way",
        ("service", "left undone"): state["shed"].replace("_", " "),
    }
    for gauge in state["housekeeping"]:
        if gauge["value"] is not None:
            wanted["housekeeping", gauge["name"].replace("_", " ")] = show(gauge["value"], 1, gauge["unit"])
    if report["solved"]:
        wanted["solution", "matched"] = f"{report['matched']} of {report['sources_found']}, {show(report['rms_px'], 3, 'px')} rms"
        wanted["solution", "roll"] = f"{show(report['roll_deg'], 4, '°')} ± {show(report['sigma_roll_arcsec'], 1, '″')}"
    wrong = [f"{panel}: {name} {panels[panel].get(name)!r} for {value!r}" for (panel, name), value in wanted.items() if not same(panels[panel].get(name, ""), value)]
    verdict(f"{len(wanted)} values as the service has them", "; ".join(wrong) or "all", not wrong)
    lamps = {lamp["name"].replace("_", " ") for lamp in view["lamps"]}
    verdict("a lamp for each requirement", f"{len(panels['requirements'])}", lamps == set(panels["requirements"]))
    return got


def truth_of(lines, image):
    """The true attitude of an image, deg, as the demonstration printed it."""
    found = re.search(rf"^image {image} .* truth ([\d.]+)° ([+-][\d.]+)° ([+-][\d.]+)°", lines, re.M)
    return tuple(float(part) for part in found.groups()) if found else None


def project(truth, star, report, geometry):
    """Where the truth has a star in the picture: x right, y down, px. Gnomonic, as the README's conventions have it."""
    ra0, dec0, roll = (math.radians(angle) for angle in truth)
    ra, dec = math.radians(star["ra_deg"]), math.radians(star["dec_deg"])
    cos_c = math.sin(dec0) * math.sin(dec) + math.cos(dec0) * math.cos(dec) * math.cos(ra - ra0)
    east = math.cos(dec) * math.sin(ra - ra0) / cos_c
    north = (math.cos(dec0) * math.sin(dec) - math.sin(dec0) * math.cos(dec) * math.cos(ra - ra0)) / cos_c
    scale = math.radians(report["platescale_arcsec_px"] / 3600)
    right = (-east * math.cos(roll) + north * math.sin(roll)) / scale
    up = (east * math.sin(roll) + north * math.cos(roll)) / scale
    # The fitted distortion moves a star by a little; that of the simulated sky is small.
    return (geometry["width"] - 1) / 2 + right, (geometry["height"] - 1) / 2 - up


def lit(browser, places):
    """The colours of the overlay within some px of where the left side of a square about each place of the picture would be."""
    return browser.run(
        """
        const [places, near, half] = arguments;
        const canvas = document.getElementById("overlay");
        const context = canvas.getContext("2d");
        return places.map(([x, y]) => {
          const [left, top] = stars.picture.toCanvas(x, y);
          const data = context.getImageData(Math.round(left - half) - near, Math.round(top) - near, 2 * near + 1, 2 * near + 1).data;
          const found = [];
          for (let i = 0; i < data.length; i += 4) if (data[i + 3] > 100) found.push([...data.slice(i, i + 3)]);
          return found;
        });
        """,
        places,
        3,
        SQUARE_PX,
    )


def check_overlay(verdict, browser, service):
    """Red squares where the truth has the stars, a yellow one at the brightest, and none where there is nothing."""
    browser.open(service.url("?still"))
    browser.wait("return stars.view && stars.view.report.solved && stars.view.report.matched > 5", "a solved frame is shown")
    # Held, so that the next frame does not take its place.
    image = browser.run("return stars.shown")
    browser.run("document.querySelector(`#strip button[data-image='${arguments[0]}']`).click()", image)
    browser.wait(f"return stars.shown === {image} && document.querySelector('#live').ariaPressed === 'false'", "a frame is looked back at")
    time.sleep(1.5)
    view = browser.run("return stars.view")
    service.out.flush()
    truth = truth_of(Path(service.out.name).read_text(encoding="utf-8"), image)
    report, geometry = view["report"], view["geometry"]
    matched = [(source, entry["star"]) for source, entry in zip(view["sources"], report["sources"]) if entry["star"]]
    expected = [project(truth, star, report, geometry) for _, star in matched]
    off = [math.dist((source["x"], source["y"]), place) for (source, _), place in zip(matched, expected)]
    verdict(f"{len(matched)} stars within {NEAR_PX} px of the truth", f"the furthest {max(off):.2f} px", max(off) <= NEAR_PX)
    colours = lit(browser, expected)
    red = [source["fate"] == "matched" and any(r > 200 and b < 130 and g < 130 for r, g, b in found) for (source, _), found in zip(matched, colours)]
    yellow = [source["fate"] == "brightest" and any(min(r, g) > 180 and b < 130 for r, g, b in found) for (source, _), found in zip(matched, colours)]
    verdict("red squares there, one of them yellow", f"{sum(red)} red, {sum(yellow)} yellow", sum(red) + sum(yellow) == len(matched) and sum(yellow) == 1)
    width, height = geometry["width"], geometry["height"]
    shown = [(source["x"], source["y"]) for source in view["sources"]]
    corners = [id_ for triangle in report["triangles"] for id_ in triangle]
    free = [
        (x, y)
        for x in range(60, width - 60, 90)
        for y in range(60, height - 60, 90)
        if all(math.dist((x, y), place) > 120 for place in shown) and abs(x - width / 2) + abs(y - height / 2) > 200
    ]
    browser.run("stars.picture.set({ triangles: false })")
    blank = lit(browser, free[:40])
    verdict("nothing drawn where nothing is", f"{sum(map(bool, blank))} of {len(blank)}", bool(blank) and not any(blank))
    verdict("the matcher's triangles", f"{len(report['triangles'])} of {len(set(corners))} sources", bool(report["triangles"]))
    browser.click("#live")


def fields_of(blocks, columns, count):
    """The words of a mask: block n = row × columns + column, rows from the bottom, is bit n mod 32 of word n / 32."""
    words = [0] * count
    for column, row in blocks:
        number = row * columns + column
        words[number // 32] |= 1 << (number % 32)
    return words


def check_mask_tool(verdict, browser, address, name):
    """Blocks clicked and drawn over give the right command, for any size of image; fields that are pasted are decoded."""
    browser.open(address)
    # Beside a service it begins with the latest image, and that image's size.
    browser.wait("return tool && document.getElementById('blocks').width > 0", "the tool is there")
    time.sleep(1.0)
    browser.run("setSize(1536, 1024, 128); document.getElementById('none').click()")
    box = browser.run("const box = document.getElementById('blocks').getBoundingClientRect(); return [box.width, box.height]")

    def way(column, row, columns=12, rows_=8):
        return (column + 0.5) / columns * box[0] - box[0] / 2, box[1] / 2 - (row + 0.5) / rows_ * box[1]

    browser.drag("#blocks", way(0, 0))
    browser.drag("#blocks", *(way(0, row) for row in range(1, 8)))
    browser.drag("#blocks", way(5, 3))
    words = fields_of([(0, row) for row in range(8)] + [(5, 3)], 12, 3)
    wanted = f"solver.mask 1 {' '.join(map(str, words))}"
    got = browser.run("return document.getElementById('command').textContent")
    verdict(f"{name}: the left column and one block: {wanted}", got, got == wanted)
    browser.drag("#blocks", way(5, 3))
    got = browser.run("return document.getElementById('legacy').textContent")
    words = fields_of([(0, row) for row in range(8)], 12, 3)
    wanted = f"xsc_selective_mask 2 1 {' '.join(str(word - (1 << 32) if word >> 31 else word) for word in words)}"
    verdict(f"{name}: the block taken back, for a program of old: {wanted}", got, got == wanted)

    def paste(text):
        browser.run(
            "const fields = document.getElementById('fields'); fields.value = arguments[0]; fields.dispatchEvent(new Event('input'))", text
        )
        return browser.run("return [[...tool.masked].sort((a, b) => a - b), document.getElementById('complaint').textContent]")

    for text, blocks in (
        ("solver.mask 1 8192 0 2147483648", [13, 95]),
        ("xsc_selective_mask 2 1 8192 0 -2147483648", [13, 95]),
        ("fields = [8192, 0, 2147483648]", [13, 95]),
        ("0x2000, 0, 0", [13]),
    ):
        got, complaint = paste(text)
        verdict(f"{name}: {text!r} decoded", f"{got} {complaint}", got == blocks and not complaint)
    for text, word in (("1 2 three", "three"), ("0 0 0 4", "block 98"), ("4294967296", "32 bits")):
        got, complaint = paste(text)
        verdict(f"{name}: {text!r} refused, naming {word!r}", complaint, word in complaint)
    browser.run("setSize(1280, 1024, 128); document.getElementById('none').click(); adopt(decode(arguments[0])); show()", "1025 0 0")
    got = browser.run("return document.getElementById('count').textContent")
    verdict(f"{name}: another camera: 2 of 80 blocks", got, got.startswith("2 of 80 blocks"))
    browser.run("setSize(4096, 4096, 128); tool.masked = new Set([1023]); show()")
    got = browser.run("return [document.getElementById('command').textContent, document.getElementById('settings').textContent]")
    verdict(f"{name}: 1024 blocks: settings, and no command", got[0], "use the settings" in got[0] and "2147483648]" in got[1])


def check_commands(verdict, browser, service):
    """The ground's display commands take effect on the page."""
    browser.open(service.url("?kiosk"))
    browser.wait("return stars.view !== null", "a frame is shown")
    done = service.command("display.configure 5 0 1 0 2", "display.set_zoom 160 120 2.5")
    browser.wait("return document.body.classList.contains('image-only')", "the image alone is shown", 20)
    browser.wait("return Math.abs(stars.picture.zoom.by - 2.5) < 1e-6", "the picture is magnified", 20)
    got = browser.run(
        "return [getComputedStyle(document.getElementById('side')).display, stars.picture.zoom.at, stars.picture.options.brightness]"
    )
    verdict("image alone, zoomed about a quarter and three quarters, twice as bright", f"{got}, done: {done}", done and got == ["none", [0.25, 0.75], 2])
    done = service.command("focus.set_display on", "display.configure 5 0 0 0 1")
    browser.wait("return !document.getElementById('focus').hidden && !document.body.classList.contains('image-only')", "the autofocus is shown", 20)
    hidden = browser.run("return document.getElementById('requirements').hidden && document.getElementById('below').hidden")
    verdict("the autofocus in place of the figures, no requirements", f"hidden: {hidden}, done: {done}", done and hidden)
    done = service.command("service.known_good")
    browser.wait("return document.getElementById('focus').hidden && stars.picture.zoom.by === 1", "all is taken back", 20)
    verdict("service.known_good takes all back", f"done: {done}", done)


def check_replay(verdict, browser, stars, scratch):
    """The dialog says what other settings would have given, what is wrong with a wish, and what became of the last frames."""
    kept = {"record__enabled": "true", "record__directory": Path(scratch) / "replayed", "record__reserve_gib": 0}
    with Service(stars, scratch, camera__period_s=3, **kept) as service:
        service.state(lambda state: state["counters"]["frames_solved"] > 2)
        browser.open(service.url())
        # The newest reaches the disk a second after it is shown.
        browser.wait("return document.querySelectorAll('#strip button').length > 2", "some frames are in the strip")
        browser.click("#strip li:nth-child(2) button")
        browser.wait("return stars.view && stars.view.report.solved && stars.shown < stars.newest", "a frame is looked back at")
        browser.click("#whatif")
        image = browser.run("return document.getElementById('replay-image').textContent")

        def ask(button, settings):
            browser.run("document.getElementById('replay-settings').value = ''")
            if settings:
                browser.keys("#replay-settings", settings)
            browser.click(button)
            answer = "const text = document.getElementById('replay-answer').textContent; return text.startsWith('solving') ? '' : text"
            return browser.wait(answer, "the replay answers")

        got = ask("#replay-one", "")
        verdict(f"image {image} with its own settings: the same to the last bit", got, f"image {image} " in got and "no difference" in got)
        got = ask("#replay-one", "solver.sources.snr_threshold=3")
        wanted = ("with solver.sources.snr_threshold=3", "solved", "now", "in boresight", "differs")
        verdict("with another threshold: how it ends now, and how far apart", got, all(words in got for words in wanted))
        got = ask("#replay-one", "solver.sources.snr_treshold=15")
        verdict("a misspelt setting is named", got, "snr_treshold" in got and "snr_threshold" in got)
        got = ask("#replay-all", "solver.sources.snr_threshold=100")
        verdict("all of the last frames, a line each", got, "0 now" in got and got.count("image ") >= 3)
        browser.click("#replay .close")


def check_focus(verdict, browser, stars, scratch):
    """A search for the best focus shows itself: both kinds of curves, the fit, and where it ends."""
    best = 2950
    values = {"camera__period_s": 0.25, "simulate__best_focus_counts": best, "lens__simulated__speedup": 20}
    with Service(stars, scratch, **values) as service:
        service.state(lambda state: state["counters"]["frames_solved"] > 2 and state["lens"]["focus_counts"] is not None)
        browser.open(service.url("?kiosk"))
        browser.wait("return stars.view !== null", "a frame is shown")
        call = [stars, "fcp", "--connect", service.network, "--id", "1", "--in-charge"]
        given = subprocess.Popen(call + ["--send", "arm focus.run", "--send", "fire focus.run"], stdout=subprocess.DEVNULL)
        browser.wait("return !document.getElementById('focus').hidden && stars.state.focus.points.length > 20", "curves are shown", 180)
        done = given.wait(timeout=300) == 0
        browser.wait("return stars.state.focus.mode === 'grace' && stars.state.focus.best_counts !== null", "the search has ended", 30)
        time.sleep(1.0)
        got = browser.run(
            """
            const canvas = document.getElementById("curves");
            const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
            const near = (r, g, b) => { let n = 0; for (let i = 0; i < data.length; i += 4) if (Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) < 60) n += 1; return n; };
            return { focus: stars.state.focus, stars: near(255, 138, 128), brightest: near(110, 180, 255), fit: near(111, 220, 140), arrow: near(255, 123, 229) };
            """
        )
        focus = got.pop("focus")
        kinds = {point["star"] is None for point in focus["points"]}
        verdict("curves of stars and of the brightest source, the fit and the best focus drawn", f"{got}, kinds: {len(kinds)}", min(got.values()) > 20 and kinds == {True, False})
        verdict(f"best focus within 10 counts of {best}", f"{focus['best_counts']:.1f} ± {focus['sigma_best_counts']:.1f}, done: {done}", done and abs(focus["best_counts"] - best) < 10)


def check_restart(verdict, browser, service, **values):
    """A page stays open over a restart of the service, says meanwhile that it is old, and goes on."""
    browser.open(service.url())
    browser.wait("return stars.shown !== null", "a frame is shown")
    boot = browser.run("return stars.state.boot_id")
    stop(service.process)
    browser.wait("return document.getElementById('connection').textContent.startsWith('no connection')", "the page says that it is old", 20)
    with Service(service.stars, service.scratch, port=service.port, **values):
        browser.wait(f"return stars.state.boot_id !== {boot} && stars.drawn > 0 && stars.shown === stars.state.frame.image", "the page goes on")
        verdict("the page goes on after a restart of the service", browser.run("return document.getElementById('connection').textContent"), True)


def check_unsolved(verdict, browser, stars, scratch, axe):
    """A frame that was not solved says why, and so does each of its sources."""
    frames = Path(scratch) / "nostars"
    subprocess.run([stars, "render", "--kind", "nostars", "--count", "2", "--out", frames], check=True, stdout=subprocess.DEVNULL)
    sky = {"camera__kind": "directory", "camera__directory": frames, "camera__repeat": "true"}
    with Service(stars, scratch, camera__period_s=2, **sky) as service:
        service.state(lambda state: state["frame"] is not None and state["solver"] == "ready")
        browser.open(service.url())
        browser.wait("return stars.view && !stars.view.report.solved && stars.view.sources.length > 0", "an unsolved frame is shown")
        got = rows(browser)
        listed = browser.run("return [...document.querySelectorAll('#rejected li')].map((item) => item.textContent)")
        report = got["view"]["report"]
        wanted = [f"source {i} at" for i in range(min(32, len(got["view"]["sources"])))]
        verdict("the reason in words under the image", got["verdict"], report["detail"] in got["verdict"] and not report["solved"])
        verdict("each source with its reason", f"{len(listed)}, the first: {listed[:1]}", [text[: len(w)] for text, w in zip(listed, wanted)] == wanted and len(listed) == len(wanted))
        if axe:
            check_access(verdict, browser, axe, "unsolved")
    narrow = {"solver__requirements__equatorial_roll__" + key: value for key, value in (("enabled", "true"), ("min_deg", 0.0), ("max_deg", 0.001))}
    with Service(stars, scratch, camera__period_s=2, **narrow) as service:
        service.state(lambda state: state["frame"] is not None and state["frame"]["reason"] == "requirement")
        browser.open(service.url())
        browser.wait("return stars.view && stars.view.report.reason === 'requirement'", "a refused frame is shown")
        got = rows(browser)
        fates = [source["fate"] for source in got["view"]["sources"]]
        lamp = browser.run("return [...document.querySelectorAll('#requirements tr')].filter((row) => row.cells[1].className === 'red').map((row) => row.cells[0].textContent)")
        verdict("the requirement that refuses, by its name, in words and as a lamp", f"{got['verdict'][:160]}; red: {lamp}", "equatorial_roll" in got["verdict"] and lamp == ["equatorial roll"])
        verdict("the best candidate and its stars", f"{fates.count('candidate')} of {len(fates)}", "Best candidate, refused: RA" in got["verdict"] and fates.count("candidate") > 3)


def check_screens(verdict, browser, service):
    """The page fits the screens that it is meant for."""
    for width, height in SCREENS:
        browser.size(width, height)
        browser.open(service.url())
        browser.wait("return stars.view !== null", "a frame is shown")
        got = browser.run(
            "const box = document.getElementById('stage').getBoundingClientRect();"
            "return [document.documentElement.scrollWidth, document.documentElement.scrollHeight, Math.round(box.width), Math.round(box.height)]"
        )
        fits = got[0] <= width and (width < 600 or got[1] <= height) and got[2] > 0.5 * width and got[3] > 0.25 * min(width, height)
        verdict(f"{width} × {height}: nothing runs over its side, the image is large", f"{got[0]} × {got[1]}, image {got[2]} × {got[3]}", fits)
    browser.size(*SCREENS[0])


def check_access(verdict, browser, axe, what):
    """axe-core finds nothing serious."""
    browser.run(Path(axe).read_text(encoding="utf-8") + "; window.axe = axe;")
    found = browser.run_async("const done = arguments[arguments.length - 1]; axe.run().then((result) => done(result.violations.map((one) => [one.impact, one.id, one.nodes.length, one.nodes[0].html.slice(0, 120)])))")
    serious = [one for one in found if one[0] in ("serious", "critical")]
    verdict(f"{what}: axe-core finds nothing serious", serious or f"nothing ({len(found)} lesser)", not serious)


def check_quiet(verdict, browser, told, requests, allowed):
    """No error in the console, and no request that leaves the machine."""
    # What a service that was stopped leaves of a connection, in whatever words; what it answers is no such thing. And a wish that was refused.
    expected = ("Failed to load resource: net::ERR_", "/replay?")
    loud = [entry["message"] for entry in told if entry["level"] == "SEVERE" and not any(words in entry["message"] for words in expected)]
    errors = browser.run("return window.stars ? stars.errors : []")
    verdict("no error in the console", loud + errors or "none", not loud and not errors)
    outside = [url for url in requests if not url.startswith(allowed)]
    verdict(f"{len(requests)} requests, none that leaves the machine", outside or "none", bool(requests) and not outside)


def test(stars, scratch, axe=None):
    """All of it."""
    verdict = Verdict()
    told, requests = [], []
    with Browser(requests=True) as browser:

        def note():
            told.extend(browser.console())
            requests.extend(browser.requests())

        browser.size(*SCREENS[0])
        with Service(stars, scratch, "demo", camera__period_s=2) as demo:
            demo.state(lambda state: state["counters"]["frames_solved"] > 0)
            browser.open(demo.url())
            browser.wait("return stars.view && stars.view.report.solved && stars.state.focus", "a solution is shown")
            time.sleep(1.0)
            check_panels(verdict, browser, lambda image: demo.json(f"frame.json?image={image}"))
            check_overlay(verdict, browser, demo)
            if axe:
                check_access(verdict, browser, axe, "page")
            check_screens(verdict, browser, demo)
            check_mask_tool(verdict, browser, demo.url("mask.html"), "beside the service")
            if axe:
                check_access(verdict, browser, axe, "mask tool")
            note()
        check_mask_tool(verdict, browser, (ROOT / "config" / "mask.html").as_uri(), "from a file")
        note()
        with Service(stars, scratch) as service:
            service.state(lambda state: state["frame"] is not None and state["solver"] == "ready")
            check_commands(verdict, browser, service)
            check_restart(verdict, browser, service)
            note()
        check_unsolved(verdict, browser, stars, scratch, axe)
        check_replay(verdict, browser, stars, scratch)
        check_focus(verdict, browser, stars, scratch)
        note()
        check_quiet(verdict, browser, told, requests, ("http://127.0.0.1:", "data:", "blob:", "file:"))
    return verdict.failed


def shot(stars, scratch, file):
    """A screenshot of a solved frame."""
    with Browser() as browser, Service(stars, scratch, "demo", simulate__kind="float", camera__period_s=4) as demo:
        browser.size(1280, 800)
        demo.state(lambda state: state["counters"]["frames_solved"] > 1 and state["lens"]["focus_counts"] is not None)
        browser.open(demo.url())
        browser.wait("return stars.view && stars.view.report.solved && stars.drawn > 1", "a solution is shown")
        time.sleep(2.0)
        Path(file).write_bytes(browser.shot())


def latency(stars, scratch):
    """New frame to picture in the browser."""
    verdict = Verdict()
    with Browser() as browser, Service(stars, scratch, camera__period_s=0.5) as service:
        browser.size(*SCREENS[0])
        service.state(lambda state: state["counters"]["frames_solved"] > 0)
        browser.open(service.url())
        browser.wait("return stars.latenciesMs.length >= 60", "60 frames are shown", 180)
        times = sorted(browser.run("return stars.latenciesMs.slice(5)"))
        median, worst = times[len(times) // 2], times[-1]
        verdict(f"capture to picture within {PICTURE_MS} ms", f"{median:.0f} ms in the median, at most {worst:.0f} ms of {len(times)}", worst < PICTURE_MS)
    return verdict.failed


def long(stars, scratch, frames):
    """So many frames at 5 a second in one open page."""
    frames = int(frames)
    verdict = Verdict()
    with Browser() as browser, Service(stars, scratch, camera__period_s=0.2) as service:
        browser.size(*SCREENS[0])
        service.state(lambda state: state["counters"]["frames_solved"] > 0)
        browser.open(service.url())
        browser.wait("return stars.shown !== null", "a frame is shown")
        heaps, last = [], 0

        def used():
            browser.devtools("HeapProfiler.collectGarbage")
            return sum(resident(browser)) / 2**20, browser.run("return performance.memory.usedJSHeapSize") / 2**20

        # A machine that is busy with other things lets a page wait: nothing is proved by its answering at once.
        while True:
            seen = browser.wait("return [stars.seen + stars.passedOver, stars.seen, stars.passedOver, stars.drawn]", "the page answers", ANSWERS_S)
            if seen[0] >= last:
                heaps.append((seen[0], *browser.wait_until(used, "its memory is known", ANSWERS_S)))
                last = seen[0] + max(1, frames // 20)
            if seen[0] >= frames:
                break
            time.sleep(1.0)
        told = browser.wait("return [stars.newest - stars.begun, stars.seen, stars.passedOver, stars.errors.length]", "the page answers", ANSWERS_S)
        broken = len(browser.broken)
    for count, resident_mib, heap_mib in heaps:
        print(f"  {count:5d} frames: {resident_mib:.0f} MiB resident, {heap_mib:.1f} MiB of it the page's own objects")
    settled = heaps[len(heaps) // 5 :]
    half = len(settled) // 2
    early, late = (sorted(one[1] for one in part)[len(part) // 2] for part in (settled[:half], settled[half:]))
    verdict(f"memory flat to {GAIN:.0%}", f"{early:.0f} MiB, then {late:.0f} MiB", late <= early * (1 + GAIN))
    if broken:
        print(f"  the browser's driver broke {broken} times; page and browser went on")
    each = told[1] + told[2] == told[0] and told[0] >= frames and told[3] == 0
    verdict(f"{told[0]} numbers, each in the strip or passed over", f"{told[1]} in the strip, {told[2]} passed over, {seen[3]} drawn", each)
    return verdict.failed


def resident(browser):
    """Bytes that each process of the browser holds; its driver, which holds what nobody read of its logs, is none of them."""
    pids, todo = [], [browser.process]
    while todo:
        pid = todo.pop()
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            try:
                todo.extend(int(child) for child in children.read_text().split())
            except OSError:
                pass
        pids.append(pid)
    sizes = []
    for pid in pids:
        try:
            found = re.search(r"^Pss:\s+(\d+) kB", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.M)
        except OSError:
            continue
        sizes.append(int(found[1]) * 1024 if found else 0)
    return sizes


def main():
    """The call."""
    jobs = {"test": test, "shot": shot, "latency": latency, "long": long}
    if len(sys.argv) < 4 or sys.argv[1] not in jobs:
        sys.exit(__doc__)
    lacks = missing()
    if lacks:
        sys.exit(f"page.py: Debian's {', '.join(lacks)} are missing")
    sys.exit(1 if jobs[sys.argv[1]](*sys.argv[2:]) else 0)


if __name__ == "__main__":
    main()
