#!/usr/bin/env python3
"""Runs the flight service with two flight computers that fetch images as fast as they may, and watches when updates come. Standard library
only.

    watch_images.py STARS SECONDS SCRATCH

First neither fetches, then one fetches raw images and the other views, then the first reads slowly, SECONDS each. Every whole raw image
is compared with the file on disk. Prints a line `wanted: … got: … PASS|FAIL` for each thing wanted; exits 1 if any failed.
"""

import multiprocessing
import os
import socket
import subprocess
import sys
import time
import zlib
from pathlib import Path

from score import Verdict, percentile
from watch_service import LATE_S, PERIOD_S, free_address, settings, stop

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "proto"))
from stars_client import Stream, encode  # noqa: E402

# Most bytes/s that the settings allow.
RATE = 1_000_000
# How long a slow reader takes over each piece, s.
SLOW_S = 0.3


class Computer:
    """A flight computer that fetches the newest image again and again, and notes when updates come."""

    def __init__(self, address, number, form, pause):
        host, port = address.split(":")
        self.link = socket.create_connection((host, int(port)))
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.form, self.pause = form, pause
        self.stream, self.begun, self.bytes = Stream(), None, bytearray()
        self.result = {"updates": [], "bytes": 0, "whole": [], "broken": 0, "refused": []}
        self.send("hello", magic="STARSCAM", version_min=3, version_current=3, role="flight_computer", id=number,
                  name=f"watch{number}", boot_id=os.getpid(), build="watch_images.py")

    def send(self, message, **values):
        self.link.sendall(encode(message, values))

    def ask(self):
        """The next piece of the image that was begun, or the first of the newest."""
        if self.begun:
            self.send("image_request", wanted="image", form=self.form, image_counter=self.begun["image_counter"],
                      offset=len(self.bytes), begun_crc32=self.begun["file_crc32"], rate_bytes_s=RATE)
        else:
            self.send("image_request", wanted="newest", form=self.form, rate_bytes_s=RATE)

    def take(self, chunk):
        self.begun = self.begun or chunk
        self.bytes += bytes(chunk["bytes"])
        self.result["bytes"] += chunk["bytes_count"]
        if len(self.bytes) == chunk["total_bytes"]:
            right = zlib.crc32(self.bytes) == chunk["file_crc32"]
            self.result["broken"] += not right
            self.result["whole"].append((chunk["image_counter"], bytes(self.bytes) if self.form == "raw" else None))
            # Of the many the last few are compared.
            self.result["whole"] = [(n, data if place > -4 else None)
                                    for place, (n, data) in zip(range(-len(self.result["whole"]), 0), self.result["whole"])]
            self.begun, self.bytes = None, bytearray()

    def run(self, seconds):
        """Runs for so long; None for `form` fetches nothing."""
        sequence, due, end = 0, time.monotonic(), time.monotonic() + seconds
        self.link.settimeout(0.05)
        asked = False
        while time.monotonic() < end:
            if time.monotonic() >= due:
                self.send("status", sequence=sequence, uptime_s=float(sequence), clock_quality="unset")
                sequence, due = sequence + 1, due + PERIOD_S
            try:
                data = self.link.recv(65536)
            except socket.timeout:
                continue
            if not data:
                raise EOFError("the camera closed the connection")
            now = time.monotonic()
            for name, values in self.stream.feed(data):
                if name == "update":
                    self.result["updates"].append((now, values["sequence"]))
                elif name == "image_chunk":
                    asked = False
                    self.take(values)
                    time.sleep(self.pause)
                elif name == "image_refusal":
                    asked = False
                    self.result["refused"].append(values["words"])
                    self.begun, self.bytes = None, bytearray()
                if self.form and not asked and self.result["updates"]:
                    asked = True
                    self.ask()
        return self.result


def fly(results, *arguments):
    """One computer, in a process of its own."""
    *computer, seconds = arguments
    try:
        results.put((computer[1], Computer(*computer).run(seconds)))
    except (OSError, EOFError) as error:
        results.put((computer[1], str(error)))


def lateness_s(updates):
    """How late each update came against the steady schedule that fits the earliest, s."""
    start = min(at - PERIOD_S * sequence for at, sequence in updates)
    return [at - PERIOD_S * sequence - start for at, sequence in updates]


def phase(verdict, what, address, forms, pauses, seconds, images):
    """Both computers for a while; pauses are how long each takes over a piece, s."""
    results = multiprocessing.Queue()
    computers = [
        multiprocessing.Process(target=fly, args=(results, address, number, form, pause, seconds))
        for number, form, pause in zip((1, 2), forms, pauses)
    ]
    for computer in computers:
        computer.start()
    found = dict(results.get(timeout=seconds + 60) for _ in computers)
    for computer in computers:
        computer.join()
    for number, form, pause in zip((1, 2), forms, pauses):
        name, result = f"{what}: computer {number}", found[number]
        if isinstance(result, str):
            verdict(f"{name}: a connection", result, False)
            continue
        late = lateness_s(result["updates"])
        missing = result["updates"][-1][1] + 1 - len(late)
        print(f"{name}: {len(late)} updates, late by ms median {1e3 * percentile(late, 50):.1f} p99 {1e3 * percentile(late, 99):.1f} "
              f"worst {1e3 * max(late):.1f}; {form or 'nothing'}: {len(result['whole'])} images, {result['bytes'] / 1e6:.1f} MB, "
              f"{len(result['refused'])} refused {result['refused'][:1]}")
        # A slow reader sees an update as late as it looks: none may be missing, and none lie behind more than one piece.
        limit = LATE_S + 2 * pause
        verdict(f"{name}: none missing, none late by more than {1e3 * limit:.0f} ms", f"{missing}, {1e3 * max(late):.1f} ms",
                missing == 0 and max(late) <= limit)
        if form and not pause:
            same = [next(images.glob(f"*/*-{image:08d}.fits")).read_bytes() == data for image, data in result["whole"] if data]
            verdict(f"{name}: images whole, and those compared with the disk the same", f"{len(result['whole'])}, {result['broken']} broken, "
                    f"{len(same) - sum(same)} of {len(same)} differ", len(result["whole"]) > 0 and not result["broken"] and all(same))


def main(arguments):
    """Runs the row; the exit status says whether all passed."""
    if len(arguments) != 3:
        sys.exit(__doc__)
    stars, seconds, scratch = os.path.abspath(arguments[0]), float(arguments[1]), Path(arguments[2])
    verdict, address = Verdict(), free_address()
    with open(scratch / "run.log", "w", encoding="utf-8") as log:
        service = subprocess.Popen(
            [stars, "run"]
            + settings(network__listen=address, record__directory=scratch / "record", record__reserve_gib=0, images__rate_bytes_s=f"{RATE}.0",
                       commands__ledger_directory=scratch / "state"),
            stderr=log,
        )  # fmt: skip
        try:
            images = scratch / "record" / "images"
            deadline = time.monotonic() + 30
            while not list(images.glob("*/*.fits")) and time.monotonic() < deadline:
                time.sleep(0.1)
            for what, forms, pauses in [
                ("without", (None, None), (0.0, 0.0)),
                ("with", ("raw", "view"), (0.0, 0.0)),
                ("slow reader", ("raw", "raw"), (SLOW_S, 0.0)),
            ]:
                phase(verdict, what, address, forms, pauses, seconds, images)
        finally:
            status = stop(service)
    verdict("the service ends cleanly", f"exit {status}", status == 0)
    return 1 if verdict.failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
