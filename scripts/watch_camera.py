#!/usr/bin/env python3
"""Takes a camera away from `stars run` and gives it back, again and again, and compares what it sent with what was kept. Standard
library only.

    watch_camera.py STARS SECONDS TIMES SCRATCH

STARS is the program, built with `--features aravis`; the camera is Aravis's fake one for GigE Vision on the loopback
(`arv-fake-gv-camera-0.8`), killed and started again, every second time with packets lost. At times the service is stopped for longer than
frames can wait, so that some must be missed. The camera writes a line for each frame that it sends
and for each packet that it drops. Prints a line `wanted: … got: … PASS|FAIL` for each thing wanted; exits 1 if any failed.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from score import Verdict
from watch_service import free_address, settings, stop

PROGRAM = "arv-fake-gv-camera-0.8"
# Frames a second, and their size, px: many, and small enough for the disk.
RATE, WIDTH, HEIGHT = 20, 128, 96
# Packets lost of a thousand, every second time: a frame has 11.
LOST_PER_THOUSAND = 5
# The camera stays away for so long, s.
AWAY_S = 2.0
# So long the service is stopped, s: longer than 16 frames take, and not as long as a camera waits to be asked for its health.
STOPPED_S = 1.5
# After this number the camera begins again with 1.
LAST_NUMBER = 65535
FITS_BLOCK = 2880


class Life:
    """The camera from one plugging in to the next pulling out; its serial number tells its frames from those of others."""

    def __init__(self, number, scratch):
        self.serial, self.lossy, self.stopped = f"LIFE{number:03}", number % 2 == 1, number % 4 == 2
        self.log = scratch / f"{self.serial}.log"
        loss = ["-r", str(LOST_PER_THOUSAND)] if self.lossy else []
        command = [PROGRAM, "-i", "127.0.0.1", "-s", self.serial, *loss, "-d", "stream-thread:3"]
        self.process = subprocess.Popen(command, stdout=open(self.log, "w"), stderr=subprocess.STDOUT)

    def end(self):
        self.process.kill()
        self.process.wait()

    def sent(self):
        """The numbers of its frames in their order, and of those that a packet was dropped of. It may be killed in the middle of a line."""
        lines = self.log.read_text(errors="replace").splitlines(keepends=True)
        lines = [line for line in lines if line.endswith("\n")]
        frames = [int(found[1]) for line in lines if (found := re.search(r"Send frame (\d+)", line))]
        dropped = {int(found[1]) for line in lines if (found := re.search(r"Drop GVSP .*frame: ?(\d+)", line))}
        return frames, dropped


def cards(path):
    """Keywords of a FITS file, as texts."""
    with open(path, "rb") as file:
        block = file.read(FITS_BLOCK)
        text = block.decode("ascii")
        while not any(text[at : at + 8] == "END     " for at in range(0, len(text), 80)):
            text += file.read(FITS_BLOCK).decode("ascii")
    found = {}
    for at in range(0, len(text), 80):
        card = text[at : at + 80]
        if card[8:10] == "= ":
            value = card[10:].strip()
            found[card[:8].strip()] = value[1 : value.index("'", 1)].strip() if value.startswith("'") else value.split("/")[0].strip()
    return found


def number(name):
    """The camera's number in the name of an image; `N+2`: the second after N, whose own number was in a packet that was lost."""
    number = sum(int(part) for part in name.rsplit(" ", 1)[1].split("+"))
    return number if number <= LAST_NUMBER else number - LAST_NUMBER


def outcomes(directory):
    """Every outcome that the service wrote."""
    return [json.loads(line) for path in sorted(directory.glob("outcomes-*.jsonl")) for line in path.read_text().splitlines()]


def fly(stars, seconds, times, scratch):
    """Runs the service while the camera comes and goes; gives what the camera was, and how the service ended."""
    service = subprocess.Popen(
        [stars, "run"]
        + settings(
            camera__kind="aravis",
            camera__device="127.0.0.1",
            camera__trigger="free",
            camera__features=f"AcquisitionFrameRate={RATE}",
            camera__pixel_format="mono8",
            camera__exposure_s=0.01,
            camera__width_px=WIDTH,
            camera__height_px=HEIGHT,
            camera__period_s=0.2 / RATE,
            lens__kind="none",
            network__listen=free_address(),
            record__directory=scratch / "records",
            record__reserve_gib=0.1,
            commands__ledger_directory="",
        ),
        stderr=open(scratch / "run.log", "w", encoding="utf-8"),
        cwd=scratch,
    )
    lives = []
    for life in range(times + 1):
        lives.append(Life(life, scratch))
        time.sleep(max(3.0, seconds / (times + 1) - AWAY_S))
        if lives[-1].stopped:
            service.send_signal(signal.SIGSTOP)
            time.sleep(STOPPED_S)
            service.send_signal(signal.SIGCONT)
            time.sleep(STOPPED_S)
        if life == times:
            # The service first: the last frames are not cut off.
            status = stop(service)
        lives[-1].end()
        time.sleep(AWAY_S)
    return lives, status


def judge(verdict, lives, records):
    """Compares what was sent with what has an outcome and with what is on disk."""
    told = outcomes(records)
    files = [cards(path) for path in sorted((records / "images").rglob("*.fits"))]
    kept = {file["FRAMEID"]: file for file in files}
    sent_all, invented, unseen, miscounted, mismarked = 0, [], [], [], []
    for life in lives:
        sent, dropped = life.sent()
        sent_all += len(sent)
        mine = [outcome for outcome in told if f" {life.serial} " in outcome["image"]]
        got = [number(outcome["image"]) for outcome in mine]
        if not got:
            unseen.append((life.serial, "all of it"))
            continue
        invented += [(life.serial, n) for n in got if n not in set(sent)] + [(life.serial, "twice")] * (len(got) - len(set(got)))
        # Of the last frame nobody knows whether it was on its way when the camera was taken away.
        between = sent[sent.index(got[0]) : sent.index(got[-1]) + 1] if got[0] in sent and got[-1] in sent else []
        missed = len(set(between) - set(got))
        if sum(outcome["missed_frames"] for outcome in mine) != missed:
            miscounted.append((life.serial, sum(outcome["missed_frames"] for outcome in mine), missed))
        unseen += [(life.serial, n) for n in sent[:-1] if n not in set(got)]
        marked = {number(outcome["image"]) for outcome in mine if outcome["missing_packets"] > 0}
        # What comes while nobody takes it may lose packets too.
        unlike = dropped - marked if life.stopped else marked ^ dropped
        mismarked += [(life.serial, n) for n in unlike & set(got[:-1])]
    names = [outcome["image"] for outcome in told]
    marks = sum(outcome["missing_packets"] > 0 for outcome in told)
    without = [serial for serial, what in unseen if what == "all of it"]
    verdict(f"the camera used again after each of {len(lives) - 1} times away", f"{len(lives)} times there, without a frame: {without}",
            not without)
    verdict("no frame invented, none twice", f"{len(told)} of {sent_all} sent; invented: {invented[:5]}", bool(told) and not invented)
    gone, counted = len([n for _, n in unseen if n != "all of it"]), sum(outcome["missed_frames"] for outcome in told)
    verdict("every frame that was sent is there or counted as missed, some missed while the service was stopped",
            f"{gone} not there, {counted} counted; miscounted {miscounted[:5]}", not miscounted and gone == counted > 0)
    verdict("every frame with an outcome is on disk, and no other", f"{len(files)} files, {len(set(names) ^ set(kept))} differ",
            len(files) == len(told) and set(names) == set(kept))
    wrong = [outcome["image"] for outcome in told
             if int(kept.get(outcome["image"], {}).get("PKTLOST", 0)) != outcome["missing_packets"]]
    verdict("frames with lost packets are marked, in the outcome and in the file, and no others",
            f"{marks} marked; wrongly: {mismarked[:5]} {wrong[:3]}", marks > 0 and not mismarked and not wrong)


def main(arguments):
    """Runs the row; the exit status says whether all passed."""
    stars, seconds, times, scratch = os.path.abspath(arguments[0]), float(arguments[1]), int(arguments[2]), Path(arguments[3]).resolve()
    if shutil.which(PROGRAM) is None:
        sys.exit(f"watch_camera.py: {PROGRAM} is missing (Debian: aravis-tools)")
    verdict = Verdict()
    lives, status = fly(stars, seconds, times, scratch)
    log = (scratch / "run.log").read_text(errors="replace")
    verdict("stars run ends cleanly, and nothing in it panicked", f"exit {status}, {log.count('panicked')} panics",
            status == 0 and "panicked" not in log)
    judge(verdict, lives, scratch / "records")
    if verdict.failed:
        print(log[-2000:])
    return 1 if verdict.failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
