#!/usr/bin/env python3
"""Runs the flight service with two flight computers while its page is closed, slowly read, attacked, and read by many. Standard library only.

    watch_page.py STARS SECONDS SCRATCH

SECONDS each. Prints the worst lateness of updates in each, and what ten readers of every event and every image cost at a frame a second.
Prints a line `wanted: … got: … PASS|FAIL` for each thing wanted; exits 1 if any failed.
"""

import json
import multiprocessing
import os
import re
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

from score import Verdict, percentile
from watch_images import Computer, lateness_s
from watch_service import LATE_S, PERIOD_S, free_address, settings, stop

# Readers of every event and every image, and what they may cost, parts of a processor.
READERS = 10
COST = 0.10
# What comes from a browser that is none.
NONSENSE = (
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(500),
    b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\n\r\n",
    b"GET /state HTTP/1.1\r\n" + b"x: y\r\n" * 5000 + b"\r\n",
    b"POST /state HTTP/1.1\r\nhost: x\r\ncontent-length: 4000000000\r\n\r\n" + bytes(100_000),
    b"GET /frame.raw?step=99999999999999999999 HTTP/1.1\r\nhost: x\r\n\r\n",
    b"\r\n\r\n\r\n" * 1000,
)


def connect(address):
    host, port = address.split(":")
    return socket.create_connection((host, int(port)), timeout=10)


def fetch(address, path):
    """What a route answers."""
    with urllib.request.urlopen(f"http://{address}/{path}", timeout=30) as answer:
        return answer.read()


def read_all(address, seconds, out):
    """A browser that reads every event, and every image once."""
    end, link = time.monotonic() + seconds, connect(address)
    link.sendall(b"GET /events HTTP/1.1\r\nhost: x\r\n\r\n")
    link.settimeout(1.0)
    text, last, events, images = b"", None, 0, 0
    while time.monotonic() < end:
        try:
            data = link.recv(1 << 16)
        except socket.timeout:
            continue
        if not data:
            break
        *whole, text = (text + data).split(b"\n\n")
        for event in whole:
            events += 1
            found = re.search(rb'"frame":\{"image":(\d+)', event)
            if found and found[1] != last:
                last = found[1]
                fetch(address, f"frame.json?image={last.decode()}")
                images += len(fetch(address, f"frame.raw?image={last.decode()}")) > 0
    out.put((events, images))


def read_slowly(address, seconds, out):
    """Browsers that open everything and take next to nothing of it."""
    links = []
    for place in range(8):
        link = connect(address)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.sendall(b"GET %s HTTP/1.1\r\nhost: x\r\n\r\n" % (b"/events" if place % 2 else b"/frame.raw"))
        links.append(link)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for link in links:
            try:
                link.recv(16)
            except OSError:
                pass
        time.sleep(0.5)
    out.put((0, 0))


def attack(address, seconds, out):
    """Nonsense, requests that never end, and the dearest one again and again, as fast as they are taken."""
    end, sent = time.monotonic() + seconds, 0
    idle = []
    while time.monotonic() < end:
        for nonsense in NONSENSE:
            try:
                with connect(address) as link:
                    link.sendall(nonsense)
                    sent += 1
            except OSError:
                pass
        try:
            idle.append(connect(address))
            idle[-1].sendall(b"GET /state HTTP/1.1\r\nhost:")
            fetch(address, f"frame.png?image={sent % 7}")
        except (OSError, urllib.error.URLError):
            pass
        del idle[:-40]
    out.put((sent, 0))


def cpu_s(pid):
    """Processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def fly(results, *arguments):
    """One flight computer, in a process of its own."""
    *computer, seconds = arguments
    try:
        results.put(Computer(*computer).run(seconds)["updates"])
    except (OSError, EOFError) as error:
        results.put(str(error))


def phase(verdict, what, network, page, service, browsers, seconds, wanted_late_s):
    """Both computers for a while beside some browsers; the service's share of a processor, and what the browsers got."""
    updates, seen = multiprocessing.Queue(), multiprocessing.Queue()
    computers = [multiprocessing.Process(target=fly, args=(updates, network, number, None, 0, seconds)) for number in (1, 2)]
    readers = [multiprocessing.Process(target=browser, args=(page, seconds - 1, seen)) for browser in browsers]
    for process in computers + readers:
        process.start()
    time.sleep(2)
    began, used = time.monotonic(), cpu_s(service.pid)
    time.sleep(seconds - 4)
    share = (cpu_s(service.pid) - used) / (time.monotonic() - began)
    got, read = [updates.get(timeout=60) for _ in computers], [seen.get(timeout=60) for _ in readers]
    for process in computers + readers:
        process.join(timeout=10)
    broken = [one for one in got if isinstance(one, str)]
    late = [late for one in got if not isinstance(one, str) for late in lateness_s(one)]
    missing = sum(one[-1][1] - one[0][1] + 1 - len(one) for one in got if not isinstance(one, str))
    count = int((seconds - 2) / PERIOD_S)
    enough = all(len(one) >= count for one in got)
    verdict(
        f"page {what}: none of {2 * count} updates missing, none late by over {wanted_late_s * 1000:.0f} ms",
        f"{len(late)} updates, {missing} missing, the latest {max(late) * 1000:.1f} ms, 99 % within {percentile(late, 99) * 1000:.1f} ms {broken or ''}",
        enough and not missing and not broken and max(late) <= wanted_late_s,
    )
    return share, read


def main():
    """The call."""
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    stars, seconds, scratch = sys.argv[1], float(sys.argv[2]), Path(sys.argv[3])
    verdict = Verdict()
    network, page = free_address(), free_address()
    values = dict(network__listen=network, display__listen=page, camera__period_s=1.0, camera__startup_delay_s=0, record__enabled="false")
    with open(scratch / "run.log", "w", encoding="utf-8") as log:
        service = subprocess.Popen([stars, "run"] + settings(commands__ledger_directory="", **values), stderr=log)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            if json.loads(fetch(page, "state"))["counters"]["frames_solved"] > 0:
                break
        except (OSError, urllib.error.URLError):
            pass
        time.sleep(0.2)
    args = (network, page, service)
    alone, _ = phase(verdict, "closed", *args, [], seconds, LATE_S)
    many, read = phase(verdict, f"read by {READERS}", *args, [read_all] * READERS, seconds, LATE_S)
    phase(verdict, "read slowly", *args, [read_slowly] * 2, seconds, LATE_S)
    phase(verdict, "attacked", *args, [attack] * 2, seconds, LATE_S)
    least = int(seconds - 4)
    verdict(
        f"{READERS} readers of every event and every image cost less than {COST:.0%} of a processor",
        f"{many - alone:.1%} ({alone:.1%} without, {many:.1%} with); events {min(one[0] for one in read)} and images {min(one[1] for one in read)} each",
        many - alone < COST and min(one[1] for one in read) >= least,
    )
    answered = json.loads(fetch(page, "state"))["shed"]
    verdict("the page answers after all that", answered, True)
    stop(service)
    sys.exit(1 if verdict.failed else 0)


if __name__ == "__main__":
    main()
