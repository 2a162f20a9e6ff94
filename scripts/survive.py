#!/usr/bin/env python3
"""Kills `stars run` again and again, and watches what its flight computers see of it. Standard library only.

    survive.py STARS KILLS SEED SCRATCH [untimed]

Stands in for the service manager: keeps the sockets that the program hands over, and gives them to the next one, as systemd does
with `FDSTORE`. Three flight computers watch: one in charge, which gives commands without a pause and must never lose its connection;
a second that only listens on a standing connection; and one that connects anew each time, trying every 10 ms. Prints a line
`wanted: … got: … PASS|FAIL` for each thing wanted; exits 1 if any failed. With `untimed` the times are only shown: for machines that
others are busy on.
"""

import fcntl
import os
import random
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "proto"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import stars_client as proto  # noqa: E402
from score import Verdict, percentile  # noqa: E402
from watch_service import free_address, settings  # noqa: E402

# First update and first solution after a kill, s.
UPDATE_WITHIN_S = 0.5
SOLUTION_WITHIN_S = 1.0
# Not waited for any longer, s.
GIVEN_UP_S = 5.0
RETRY_S = 0.01
# The lens of these trials is in focus here, and moves between these places, counts.
BEST_FOCUS, FOCUS = 3000, (2985, 3015)
# Frames come this often, s, so that one is being solved at nearly every kill.
BUSY_PERIOD_S = 0.02
STARTS_WITHIN_S = 30.0
# Stages after which nothing more comes.
LAST = ("completed", "rejected", "failed")
# A first block runs nothing and the lease is granted within some statuses; then a command ends within a second or so.
COMMAND_WAITS_S = 30.0


class Manager:
    """A service manager that keeps sockets: what the program tells it, and the next program with them."""

    def __init__(self, command, scratch):
        self.command, self.log = command, open(scratch / "run.log", "ab", buffering=0)
        self.path = str(scratch / "notify")
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.path)
        self.kept, self.ready, self.alive, self.lock = {}, 0, 0, threading.Lock()
        self.process = None
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self):
        while True:
            text, files, _, _ = socket.recv_fds(self.socket, 65536, 8)
            said = dict(line.split("=", 1) for line in text.decode().splitlines() if "=" in line)
            name = said.get("FDNAME")
            with self.lock:
                self.ready += said.get("READY") == "1"
                self.alive += said.get("WATCHDOG") == "1"
                if said.get("FDSTORE") == "1":
                    for file in files:
                        if name in self.kept:
                            os.close(self.kept.pop(name))
                        self.kept[name] = file
                elif said.get("FDSTOREREMOVE") == "1" and name in self.kept:
                    os.close(self.kept.pop(name))

    def start(self):
        with self.lock:
            names, files = list(self.kept), list(self.kept.values())
            # Away from the numbers that they must have in the program, so that none is overwritten.
            high = [os.dup(file) for file in files]

        def hand_over():
            far = [fcntl.fcntl(file, fcntl.F_DUPFD, 200) for file in high]
            for place, file in enumerate(far):
                os.dup2(file, 3 + place)
                os.close(file)

        environment = dict(os.environ, NOTIFY_SOCKET=self.path, LISTEN_FDS=str(len(files)), LISTEN_FDNAMES=":".join(names),
                           WATCHDOG_USEC="10000000")
        # The program must find its own number in LISTEN_PID: that of the shell whose place it takes.
        shell = ["sh", "-c", 'LISTEN_PID=$$; export LISTEN_PID; exec "$@"', "sh"]
        self.process = subprocess.Popen(shell + self.command, env=environment, preexec_fn=hand_over, close_fds=False,
                                        stderr=self.log, stdout=self.log)
        for file in high:
            os.close(file)

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        return time.monotonic()


class Watcher(threading.Thread):
    """A flight computer: what it got, and when."""

    def __init__(self, address, number, in_charge, retry_s=RETRY_S):
        super().__init__(daemon=True)
        host, port = address.split(":")
        self.address, self.number, self.in_charge, self.retry_s = (host, int(port)), number, in_charge, retry_s
        self.boot = random.getrandbits(32)
        self.connections, self.updates, self.replies, self.ends = 0, [], [], []
        self.relay = proto.Relay([], None)
        self.lock, self.stop, self.began = threading.Lock(), False, time.monotonic()

    def run(self):
        while not self.stop:
            try:
                with socket.create_connection(self.address, timeout=5) as link:
                    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self.serve(link)
            except (OSError, proto.WireError) as error:
                self.ends.append((time.monotonic(), str(error)))
            time.sleep(self.retry_s)

    def send(self, link, name, values):
        link.sendall(proto.encode(name, values))

    def serve(self, link):
        self.send(link, "hello", {"magic": "STARSCAM", "version_min": proto.VERSION_MIN, "version_current": proto.VERSION_CURRENT,
                                  "role": "flight_computer", "id": self.number, "name": f"survivor{self.number}",
                                  "boot_id": self.boot, "build": "survive.py"})
        stream, sequence, received, last, camera, lease, due = proto.Stream(), 0, 0, None, 0, None, None
        with self.lock:
            self.relay.blocks, self.relay.acknowledged = 0, 0
        while not self.stop:
            now = time.monotonic()
            if due is not None and now >= due:
                self.send(link, "status", {
                    "sequence": sequence, "boot_id": self.boot, "uptime_s": now - self.began, "claims_charge": self.in_charge,
                    "clock_unix_s": time.time(), "clock_quality": "free_running", "updates_received": received,
                    "last_update_sequence": last})
                with self.lock:
                    block = self.relay.block(self.boot, camera, lease, last, now)
                link.sendall(block)
                sequence, due = sequence + 1, due + 0.5 * (1 + int((now - due) / 0.5))
            link.settimeout(max(0.001, (due or now + 5) - time.monotonic()))
            try:
                data = link.recv(65536)
            except socket.timeout:
                continue
            if not data:
                raise OSError("the camera closed the connection")
            at = time.monotonic()
            for name, values in stream.feed(data):
                if name == "hello":
                    due, camera = at, values["boot_id"]
                    self.connections += 1
                elif name == "refuse":
                    raise OSError(f"refused: {values['refusal']}")
                elif name == "update":
                    received, last = received + 1, values["sequence"]
                    with self.lock:
                        if values["boot_id"] != camera:
                            camera, self.relay.acknowledged = values["boot_id"], 0
                        lease = values["lease_epoch"] if values["you_are_in_charge"] else None
                        for reply in self.relay.take(values, self.number):
                            if reply["flight_computer"] == self.number:
                                self.replies.append(reply)
                    self.updates.append((at, values))

    def first(self, wanted, deadline, seen=0):
        """When the first update from the one numbered `seen` on that is wanted came; None if none did."""
        while time.monotonic() < deadline:
            updates = self.updates
            for place in range(seen, len(updates)):
                if wanted(updates[place][1]):
                    return updates[place]
            seen = len(updates)
            time.sleep(0.001)
        return None


class Ground(threading.Thread):
    """Gives commands one after the other, each with a value that no other has, and notes how each ended."""

    def __init__(self, watcher, seed):
        super().__init__(daemon=True)
        self.watcher, self.random, self.stop = watcher, random.Random(seed), False
        # Text of a command as the log has it, and its last reply.
        self.ended = []

    def run(self):
        number = 0
        while not self.stop:
            number += 1
            if number % 4 == 0:
                text = f"lens.set_focus {self.random.randint(*FOCUS)}"
                unique = False
            else:
                text = f"solver.configure 1 {5 + number / 1000}"
                unique = True
            with self.watcher.lock:
                order = proto.parse_command(text)
                counter = self.watcher.relay.counters.get(order[1], 0) + 1
                self.watcher.relay.waiting.append(order)
            # What was told before a restart may be told again after it: a reply is known by its command and counter.
            ends = lambda r: (r["command"], r["counter"]) == (order[1], counter) and r["stage"] in LAST  # noqa: E731
            deadline, last = time.monotonic() + COMMAND_WAITS_S, None
            while time.monotonic() < deadline and last is None:
                last = next(filter(ends, self.watcher.replies), None)
                time.sleep(0.005)
            self.ended.append((text if unique else None, last))


def judge_commands(verdict, ground, log):
    """Each command whose text tells it from all others ran once where it was said to be done, and never twice."""
    runs = {}
    for text in re.findall(r"command=(solver\.configure \S+ \S+)", log):
        runs[text] = runs.get(text, 0) + 1
    ends, wrong = {}, []
    for text, last in ground.ended:
        stage = last["stage"] if last else "not answered"
        ends[stage] = ends.get(stage, 0) + 1
        if text is None:
            continue
        count = sum(n for seen, n in runs.items() if float(seen.split()[2]) == float(text.split()[2]))
        allowed = {"completed": (1, 1), "rejected": (0, 0), "failed": (0, 1)}.get(stage, (0, 0))
        if not allowed[0] <= count <= allowed[1]:
            wrong.append((text, stage, count))
    told = ", ".join(f"{count} {stage}" for stage, count in sorted(ends.items()))
    verdict("every command ran once where it was said to be done, and none twice or unanswered",
            f"{len(ground.ended)} given: {told}; {len(wrong)} wrong {wrong[:5]}",
            len(ground.ended) > 0 and not wrong and "not answered" not in ends)


def judge_settings(verdict, ground, log):
    """Each start has the setting that was commanded last; one that was not said to be done may have come too late for the disk."""
    done = {float(text.split()[2]) for text, last in ground.ended if text and last and last["stage"] == "completed"}
    known, starts, wrong = [], 0, []
    for line in log.splitlines():
        ran = re.search(r"command=solver\.configure \S+ (\S+)", line)
        if ran:
            known.append(float(ran.group(1)))
        elif " serving " in line or line.endswith("serving"):
            has = re.search(r"solver\.configure \S+ ([0-9.]+)", line)
            starts += 1
            allowed = {known[-1]} if known else {None}
            if known and known[-1] not in done:
                allowed.add(known[-2] if len(known) > 1 else None)
            if (float(has.group(1)) if has else None) not in allowed:
                wrong.append(line[-80:])
    verdict("the settings that were commanded in force again at each start", f"{starts} starts, {len(wrong)} wrong {wrong[:3]}",
            starts > 1 and not wrong)


def main():
    stars, kills, seed, scratch = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])
    verdict, rng, address = Verdict(), random.Random(seed), free_address()
    stars = os.path.abspath(stars)
    os.chdir(scratch)
    command = [stars, "run"] + settings(
        network__listen=address, camera__period_s=BUSY_PERIOD_S, simulate__kind="night", camera__startup_delay_s=0, lens__simulated__speedup=20,
        lens__simulated__start_counts=BEST_FOCUS, simulate__best_focus_counts=BEST_FOCUS,
        record__directory="record", commands__ledger_directory="state", catalog__cache_directory="cache",
        network__max_connections=16)
    manager = Manager(command, scratch)
    manager.start()
    steady = [Watcher(address, 1, True), Watcher(address, 2, False)]
    for watcher in steady:
        watcher.start()
    solved = lambda update: update.get("reason") == "solved"  # noqa: E731
    for watcher in steady:
        assert watcher.first(solved, time.monotonic() + STARTS_WITHIN_S), (scratch / "run.log").read_text()[-3000:]
    ground = Ground(steady[0], seed)
    ground.start()
    figures = {"on the old connection": [], "by a new connection": [], "first solution": []}
    for kill in range(kills):
        time.sleep(rng.uniform(0.05, 2.0))
        boot, seen = steady[0].updates[-1][1]["boot_id"], [len(watcher.updates) for watcher in steady]
        at = manager.kill()
        manager.start()
        fresh = Watcher(address, 3, False)
        fresh.start()
        newer = lambda update: update["boot_id"] != boot  # noqa: E731
        for watcher, place in zip(steady, seen):
            first = watcher.first(newer, at + GIVEN_UP_S, place)
            figures["on the old connection"].append(first[0] - at if first else GIVEN_UP_S)
        first = fresh.first(newer, at + GIVEN_UP_S)
        figures["by a new connection"].append(first[0] - at if first else GIVEN_UP_S)
        first = fresh.first(lambda update: newer(update) and solved(update), at + GIVEN_UP_S)
        figures["first solution"].append(first[0] - at if first else GIVEN_UP_S)
        fresh.stop = True
    ground.stop = True
    ground.join(timeout=COMMAND_WAITS_S)
    log = (scratch / "run.log").read_text(errors="replace")
    for what, within in (("on the old connection", UPDATE_WITHIN_S), ("by a new connection", UPDATE_WITHIN_S),
                         ("first solution", SOLUTION_WITHIN_S)):
        seconds = sorted(figures[what])
        name = what if what.startswith("first") else f"first update {what}"
        got = f"median {percentile(seconds, 50):.3f} s, worst {seconds[-1]:.3f} s"
        if "untimed" in sys.argv[5:]:
            verdict(f"{name} after each of {kills} kills", got, seconds[-1] < GIVEN_UP_S)
        else:
            verdict(f"{name} within {within} s of each of {kills} kills", got, seconds[-1] < within)
    lost = sum(watcher.connections - 1 for watcher in steady)
    verdict("no standing connection lost", f"{lost} lost {steady[0].ends[:3] + steady[1].ends[:3]}", lost == 0)
    judge_settings(verdict, ground, log)
    judge_commands(verdict, ground, log)
    panics = re.findall(r"panicked at [^\n]*", log)
    verdict("no panic", f"{len(panics)} {panics[:3]}", not panics)
    verdict("the watchdog was told", f"{manager.alive} times, ready {manager.ready} times", manager.alive > 0 and manager.ready > kills)
    manager.process.send_signal(signal.SIGTERM)
    began = time.monotonic()
    status = manager.process.wait(timeout=10)
    took = time.monotonic() - began
    verdict("a clean stop in under 2 s", f"{took:.2f} s, exit {status}", took < 2 and status == 0)
    return 1 if verdict.failed else 0


if __name__ == "__main__":
    sys.exit(main())
