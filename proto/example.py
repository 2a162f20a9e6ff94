#!/usr/bin/env python3
"""A flight computer in Python, as an example: example.py HOST:PORT [COMMAND]

Connects, tells the camera every 0.5 s who and where it is, prints each new solution, and claims the charge. With a command, such as
`lens.set_focus 3030`, it gives that once it has the lease, prints each stage that it reaches, and ends with 0 when it is completed, 1 when
it is not. Without one it ends with 0 after five solutions. GUIDE.md goes through it.
"""

import os
import socket
import struct
import sys
import time

from stars_client import (PORT, STATUS_PERIOD_S, VERSION_CURRENT, VERSION_MIN, Relay, Stream, encode)

SILENCE_S = 5.0
SOLUTIONS = 5
BOOT_ID = struct.unpack("<I", os.urandom(4))[0]  # another one at each start: our counters begin anew
STARTED = time.monotonic()


def hello():
    """Part 1: who we are."""
    return encode("hello", {
        "magic": "STARSCAM", "version_min": VERSION_MIN, "version_current": VERSION_CURRENT,
        "role": "flight_computer", "id": 1, "name": "example", "boot_id": BOOT_ID,
    })


def status(sequence, last):
    """Part 2: every 0.5 s, who and where we are. What is left out is not known, and its flag says so."""
    return encode("status", {
        "sequence": sequence, "boot_id": BOOT_ID, "uptime_s": time.monotonic() - STARTED, "claims_charge": True,
        "clock_quality": "unset",
        # With it there are azimuth and elevation: a flight program gives its own.
        "observer_known": True, "latitude_deg": -77.86, "sidereal_time_h": 8.25,
        "last_update_sequence": last,
    })


def show(update):
    """Part 4: a new image; whether it was solved."""
    if update["ra_deg"] is None:
        print(f"image {update['image_counter']} not solved: {update['reason']}: {update['detail']}", flush=True)
        return False
    # σ is one standard deviation on the sky: its square is the variance that a filter wants.
    east, north = update["sigma_east_arcsec"] ** 2, update["sigma_north_arcsec"] ** 2
    print(f"image {update['image_counter']} ra {update['ra_deg']:.5f} dec {update['dec_deg']:.5f} roll {update['roll_deg']:.4f} deg, "
          f"variance {east:.4f} {north:.4f} arcsec^2", flush=True)
    return True


def main():
    """Part 5: the loop."""
    host, _, port = sys.argv[1].rpartition(":")
    orders = sys.argv[2:3]
    relay = Relay(orders, None)  # part 3: what the ground commands, repeated until its last stage came
    stream, sequence, last, lease, camera_boot, image, solutions = Stream(), 0, None, None, 0, None, 0
    with socket.create_connection((host, int(port or PORT)), timeout=SILENCE_S) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.sendall(hello())
        due = None  # no status before the camera's hello
        while not relay.idle() if orders else solutions < SOLUTIONS:
            now = time.monotonic()
            if due is not None and now >= due:
                link.sendall(status(sequence, last))
                link.sendall(relay.block(BOOT_ID, camera_boot, lease, last, now))
                sequence, due = sequence + 1, due + STATUS_PERIOD_S
            link.settimeout(max(SILENCE_S if due is None else due - time.monotonic(), 0.001))
            try:
                data = link.recv(65536)
            except socket.timeout:
                continue
            if not data:
                sys.exit("the camera closed the connection")
            for name, values in stream.feed(data):
                if name == "hello":
                    due, camera_boot = time.monotonic(), values["boot_id"]
                elif name == "refuse":
                    sys.exit(f"refused: {values['refusal']}: {values['detail']}")
                elif name == "update":
                    last, lease = values["sequence"], values["lease_epoch"] if values["you_are_in_charge"] else None
                    if values["image_counter"] is not None and values["image_counter"] != image:
                        image = values["image_counter"]
                        solutions += show(values)
                    for reply in relay.take(values, 1):
                        print(f"command {reply['command']} {reply['stage']}: {reply['words']}", flush=True)
    return 1 if relay.refused else 0


if __name__ == "__main__":
    sys.exit(main())
