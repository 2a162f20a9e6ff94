#!/usr/bin/env python3
"""Runs the flight service with simulated flight computers and watches what arrives. Standard library only.

    watch_service.py service STARS IMAGES SECONDS SCRATCH   `stars run` on the flight images, two flight computers
    watch_service.py start STARS SCRATCH                    from the start to first update and first solution; memory

STARS is the program, IMAGES holds `flight/` and `truth.json`. Prints a line `wanted: … got: … PASS|FAIL` for each thing wanted;
exits 1 if any failed.
"""

import json
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from score import Verdict, errors_arcsec, percentile

# Interval of updates, s, and how late one may be.
PERIOD_S = 0.5
LATE_S = 0.050
# A frame this often keeps the solver busy, s. No whole number of them fits between two updates, or a
# solver that skips none would show each update the same one of two images again.
BUSY_PERIOD_S = 0.00413
# Frames without a star between those images, which take the solver longest: with those alone it is done before the next is read.
HARD_FRAMES = 2
# Updates during which a frame must be under way, so that the solver counts as busy.
BUSY_FRACTION = 0.5


def free_address():
    """An address of the loopback on which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return "127.0.0.1:{}".format(probe.getsockname()[1])


class FlightComputer:
    """A `stars fcp` and all that it printed."""

    def __init__(self, stars, address, number, in_charge, scratch):
        command = [stars, "fcp", "--json", "--connect", address, "--id", str(number), "--retry", "20ms"]
        with open(Path(scratch) / f"fcp-{number}.log", "w", encoding="utf-8") as log:
            self.process = subprocess.Popen(command + ["--in-charge"] * in_charge, stdout=subprocess.PIPE, stderr=log, text=True)
        self.number = number
        self.lines = []
        self.reader = threading.Thread(target=self.read, daemon=True)
        self.reader.start()

    def read(self):
        """Keeps each line with the time of its arrival here."""
        for line in self.process.stdout:
            self.lines.append((time.monotonic(), json.loads(line)))

    def updates(self):
        """Arrival here and content of each update so far."""
        return [(at, line) for at, line in list(self.lines) if line["kind"] == "update"]

    def first(self, wanted, deadline):
        """When the first update that is `wanted` arrived; None if none did by the deadline."""
        seen = 0
        while time.monotonic() < deadline and self.process.poll() is None:
            lines = self.updates()
            for at, line in lines[seen:]:
                if wanted(line):
                    return at
            seen = len(lines)
            time.sleep(0.005)
        return None


def stop(process):
    """Ends a process as an operator would; returns its exit status, None if it had to be killed."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        return process.wait(timeout=10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return None


def settings(**values):
    """Arguments that override settings; `__` stands for a dot."""
    return [part for key, value in values.items() for part in ("--set", f"{key.replace('__', '.')}={value}")]


def solved(update):
    """Whether an update carries a pointing."""
    return update.get("reason") == "solved"


def lateness_s(updates):
    """How late each update was against the steady schedule that fits the earliest ones, s.

    By the times at which the flight computer says that it received them, and by their sequence numbers, so that one which
    never came makes itself known by the gap.
    """
    times = [(update["t_s"], update["sequence"]) for _, update in updates]
    start = min(t - PERIOD_S * sequence for t, sequence in times)
    return [t - PERIOD_S * sequence - start for t, sequence in times]


def watch_service(verdict, stars, images, seconds, scratch):
    """Two flight computers, ten minutes: all updates in time, solutions of both images at both."""
    images, scratch = Path(images).resolve(), Path(scratch)
    truths = [t for t in json.loads((images / "truth.json").read_text())["images"] if t["file"].startswith("flight/")]
    address, log = free_address(), scratch / "run.log"
    hard, frames = scratch / "hard", scratch / "frames"
    subprocess.run([stars, "render", "--kind", "nostars", "--count", str(HARD_FRAMES), "--out", hard], check=True)
    # To and fro: the frame that comes after the hard ones is the one that is passed over, and must not be the same each time.
    easy = sorted((images / "flight").glob("*.fits"))
    hard = sorted(hard.glob("*.fits"))
    frames.mkdir()
    for place, image in enumerate([*easy, *hard, *reversed(easy), *hard]):
        (frames / f"{place}.fits").symlink_to(image.resolve())
    service = subprocess.Popen(
        [stars, "run"]
        + settings(
            camera__kind="directory",
            camera__directory=frames,
            camera__repeat="true",
            camera__period_s=BUSY_PERIOD_S,
            solver__matching__platescale_min_arcsec_px=9.2,
            solver__matching__platescale_max_arcsec_px=9.7,
            network__listen=address,
            record__directory=scratch / "record",
        ),
        stderr=open(log, "w", encoding="utf-8"),
    )
    computers = [FlightComputer(stars, address, number, number == 1, scratch) for number in (1, 2)]
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline and service.poll() is None:
        time.sleep(min(1.0, max(0.0, deadline - time.monotonic())))
    running = service.poll() is None
    # The service is ended last, so that the end of its connections is not taken for a fault.
    for computer in computers:
        stop(computer.process)
        computer.reader.join(timeout=5)
    status = stop(service)
    verdict("stars run keeps running and ends cleanly", f"running {running}, exit {status}", running and status == 0)
    if not running:
        print(log.read_text()[-2000:])
    for computer in computers:
        judge_computer(verdict, computer, truths, seconds)


def judge_computer(verdict, computer, truths, seconds):
    """What one flight computer received."""
    updates = computer.updates()
    name = f"flight computer {computer.number}"
    if not updates:
        verdict(f"{name}: updates", "none", False)
        return
    late = lateness_s(updates)
    last = updates[-1][1]
    busy = sum(1 for _, update in updates if update.get("solving")) / len(updates)
    print(
        f"{name}: {len(updates)} updates; late by ms median {1e3 * percentile(late, 50):.1f} p99 {1e3 * percentile(late, 99):.1f}; "
        f"frames taken {last['frames_taken']} solved {last['frames_solved']} skipped {last['frames_skipped']} lost {last['frames_lost']}"
    )
    verdict(f"{name}: solver busy in {BUSY_FRACTION:.0%} of the updates or more", f"{busy:.0%}", busy >= BUSY_FRACTION)
    missing = last["sequence"] - updates[0][1]["sequence"] + 1 - len(updates)
    expected = math.floor(0.95 * seconds / PERIOD_S)
    too_late = [f"{update['sequence']} by {1e3 * by:.0f} ms" for by, (_, update) in zip(late, updates) if by > LATE_S]
    if too_late:
        print(f"{name}: {len(too_late)} too late, the first: update {', '.join(too_late[:5])}")
    verdict(f"{name}: no update late by more than {1e3 * LATE_S:.0f} ms", f"worst {1e3 * max(late):.1f} ms", max(late) <= LATE_S)
    verdict(f"{name}: all updates of {seconds:.0f} s", f"{len(updates)}, {missing} missing", missing == 0 and len(updates) >= expected)
    connections = sum(1 for _, line in computer.lines if line["kind"] == "connected")
    verdict(f"{name}: one connection", connections, connections == 1)
    for truth in truths:
        # The trailed image may be off by 4″, the other by 1.5″: 5″ tells the two apart from each other and from errors.
        of_image = [u for _, u in updates if solved(u) and math.hypot(*errors_arcsec(u, truth)[:2]) <= 5]
        verdict(f"{name}: solutions of {Path(truth['file']).name}", len(of_image), len(of_image) > 0)
    astray = [
        u for _, u in updates if solved(u) and all(math.hypot(*errors_arcsec(u, truth)[:2]) > 5 for truth in truths)
    ]
    verdict(f"{name}: no solution astray", len(astray), not astray)


def peak_memory_mb(process):
    """Peak resident memory of a running process, MB."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    kib = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM:"))
    return kib * 1024 / 1e6


def watch_start(verdict, stars, scratch):
    """From the start of the service to its first update and solution, with the shipped settings: without an index on disk, and with."""
    for index in ("built", "from disk"):
        watch_one_start(verdict, stars, scratch, index)


def watch_one_start(verdict, stars, scratch, index):
    """One start; the first leaves its index for the second."""
    address = free_address()
    # Waiting for the service already, as a flight computer in flight does.
    computer = FlightComputer(stars, address, 1, True, scratch)
    time.sleep(0.3)
    with open(Path(scratch) / "run.log", "w", encoding="utf-8") as log:
        begin = time.monotonic()
        service = subprocess.Popen(
            [stars, "run"]
            + settings(
                network__listen=address, record__directory=Path(scratch) / "record", catalog__cache_directory=Path(scratch) / "index"
            ),
            stderr=log,
        )
        update = computer.first(lambda _: True, begin + 10)
        solution = computer.first(solved, begin + 20)
        time.sleep(2)
        memory = peak_memory_mb(service) if service.poll() is None else math.inf
        stop(computer.process)
        stop(service)
    for what, at, limit in (("update", update, 0.5), ("solution", solution, 3.0)):
        got = f"{at - begin:.2f} s" if at else "none"
        verdict(f"index {index}: first {what} under {limit} s", got, at is not None and at - begin < limit)
    if not solution:
        print((Path(scratch) / "run.log").read_text()[-2000:])
    verdict(f"index {index}: peak memory under 400 MB", f"{memory:.0f} MB", memory < 400)


def main(arguments):
    """Runs one row; the exit status says whether all passed."""
    verdict = Verdict()
    match arguments:
        case ["service", stars, images, seconds, scratch]:
            watch_service(verdict, os.path.abspath(stars), images, float(seconds), scratch)
        case ["start", stars, scratch]:
            watch_start(verdict, os.path.abspath(stars), scratch)
        case _:
            sys.exit(__doc__)
    return 1 if verdict.failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
