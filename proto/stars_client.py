#!/usr/bin/env python3
"""A flight computer's end of the wire to a star camera, from the standard library alone.

Written by hand from ICD.md, not made from the camera's program, so that the two check each other. Use it as a program:

    python3 stars_client.py --connect 192.168.1.6:2017 --id 1 --in-charge
    python3 stars_client.py --connect 192.168.1.6:2017 --id 1 --fetch newest --out newest.fits
    python3 stars_client.py --decode golden/v1/update_solved.hex

or as a module: Stream turns received bytes into messages, encode() makes a frame to send.
"""

import argparse
import hashlib
import hmac
import json
import os
import socket
import struct
import sys
import time
import zlib

SYNC = bytes([0x1A, 0xCF, 0xFC, 0x1D])
MAX_FRAME = 64 * 1024
VERSION_MIN = VERSION_CURRENT = 3
PORT = 2017
STATUS_PERIOD_S = 0.5
SILENCE_S = 5.0
RETRY_S = 9.0

CODES = {
    "role": ["camera", "flight_computer"],
    "refusal": [
        "no_common_version", "not_a_hello", "wrong_role", "address_not_allowed", "too_many_connections", "replaced",
        "bad_message", "silent", "shutting_down",
    ],
    "clock": ["unset", "free_running", "synchronised", "flight_computer", "chrony", "ptp"],
    "exposed_by": ["asked", "trigger", "itself"],
    "command_refusal": [
        "not_in_charge", "stale", "replayed", "out_of_range", "busy", "not_armed", "unknown_command", "unsafe_state",
        "not_authentic", "half_changed", "early", "wrong_boot", "not_available", "not_kept", "stopped", "device",
        "program", "dialect", "no_result", "restarted",
    ],
    "doubt": [
        "no_lens", "never_read", "requested", "not_read_back", "timed_out", "unexpected_reply", "refused", "port_lost",
        "not_learned", "power_cycled", "counts_lost", "missed",
    ],
    "autofocus_mode": ["not_running", "running", "grace"],
    "focus_ending": [
        "found", "edge_low", "edge_high", "no_peak", "too_few", "not_confirmed", "timed_out", "aborted", "stopped",
        "lens_failed", "better", "worse",
    ],
    "stage": ["accepted", "started", "completed", "rejected", "failed"],
    "reason": [
        "solved", "saturated", "too_bright", "no_contrast", "too_few_sources", "no_match", "undecided", "requirement",
        "timed_out", "aborted", "disabled", "skipped", "unreadable", "failed",
    ],
    "cause": [
        "overexposed", "saturated", "no_contrast", "out_of_focus", "trailed", "clouds", "too_few_stars",
        "too_many_artefacts", "wrong_platescale", "mirrored", "wrong_prior", "lens_covered",
    ],
    "mode": ["normal", "robust", "motion"],
    "last_end": ["clean", "commanded", "crashed", "computer_restarted"],
    "found": ["nothing", "whole", "one_copy", "damaged"],
    "actor": ["camera", "lens", "solver", "hub", "recorder", "ledger", "listener", "session", "housekeeping", "legacy_listener",
              "archive"],
    "shed": ["nothing", "display", "images", "solving"],
    "wanted": ["image", "newest", "next"],
    "form": ["raw", "view"],
    "no_image": ["never_was", "not_kept", "changed", "offset", "rate", "no_number", "disk", "form", "busy"],
}

# One field a line: its name and what it is, as a letter of `struct` (`96s` is text, `3x3d` an array, `B=list` a code of
# CODES). `?` in front: there is a flag before it, called <name>_known. `{` opens a group of fields, `?{` one behind a
# flag, `20{` a list of 20 rows, of which <name>_count mean something.
LAYOUTS = {
    1: ("hello", """
        magic 8s
        version_min B
        version_current B
        schema_hash ?I
        role B=role
        id B
        name 16s
        boot_id I
        build 32s
        settings_hash ?I
    """),
    2: ("refuse", """
        refusal B=refusal
        version_min B
        version_current B
        detail 96s
    """),
    3: ("status", """
        sequence I
        boot_id I
        uptime_s d
        claims_charge ?
        clock_unix_s ?d
        clock_quality B=clock
        observer ?{
            latitude_deg d
            sidereal_time_h d
        }
        horizontal_estimate ?{
            az_deg d
            el_deg d
        }
        equatorial_estimate ?{
            ra_deg d
            dec_deg d
        }
        trigger_counter ?I
        trigger_image_counter ?I
        trigger_age_s ?d
        trigger_pulses I
        updates_received I
        last_update_sequence ?I
    """),
    4: ("update", """
        sequence I
        boot_id I
        uptime_s d
        clock_unix_s ?d
        clock_quality B=clock
        settings_hash I
        simulated_camera ?
        simulated_lens ?
        statuses_received I
        last_status_sequence ?I
        last_status_age_s ?d
        status_values_withheld I
        in_charge_id ?B
        in_charge_since_s ?d
        you_are_in_charge ?
        claims B
        commands_accepted I
        commands_refused I
        last_refusal ?B=command_refusal
        frames_taken I
        frames_solved I
        frames_skipped I
        frames_lost I
        restarts_camera I
        restarts_solver I
        restarts_hub I
        restarts_recorder I
        restarts_server I
        links_refused I
        solving ?
        temperature_lens_c ?d
        temperature_computer_c ?d
        temperature_vessel_c ?d
        temperature_plate_c ?d
        temperature_dcdc_c ?d
        temperature_flange_c ?d
        pressure_atm ?d
        disk_free_gib ?d
        next_image_counter I
        gain_db ?d
        focus_counts ?i
        aperture_counts ?i
        image ?{
            image_counter I
            image_trigger_counter ?I
            exposures B
            exposure_s ?d
            captured_unix_s ?d
            captured_quality ?B=clock
            image_age_s ?d
            reason B=reason
            cause ?B=cause
            detail 120s
            mode B=mode
            statistics ?{
                mean_adu d
                noise_adu d
                measured_gain_adu_per_e ?d
                measured_gain_db ?d
                saturated_px I
                saturated_fraction d
                fwhm_px ?d
            }
            focus_metric_adu ?d
            sources_found H
            sources_tried H
            sources_matched H
            candidates_tried I
            solve_time_ms ?d
            equatorial ?{
                ra_deg d
                dec_deg d
                roll_deg d
                sigma_east_arcsec d
                sigma_north_arcsec d
                sigma_roll_arcsec d
                sigma_pointing_arcsec d
                covariance_arcsec2 3x3d
                platescale_arcsec_px d
                sigma_platescale_arcsec_px ?d
                distortion_k1 ?d
                rms_px d
                chi2_per_dof ?d
                false_probability_log10 ?d
                epoch_yr ?d
            }
            horizontal ?{
                az_deg d
                el_deg d
                horizontal_roll_deg d
                sigma_az_arcsec d
                sigma_el_arcsec d
                sigma_horizontal_roll_arcsec d
                sigma_horizontal_pointing_arcsec d
                latitude_deg d
                sidereal_time_h d
                equinox_yr ?d
            }
            prior_disagreement_deg ?d
            corrected_proper_motion ?
            corrected_aberration ?
            corrected_precession ?
            corrected_refraction ?
            corrected_distortion ?
            sources_count B
            sources 20{
                x_px f
                y_px f
                sigma_px f
                flux_adu f
                peak_adu f
                snr f
                saturated ?
                star_id ?I
            }
        }
        lease_epoch ?I
        armed_command ?B
        armed_for_s d
        commands_under_way B
        authentication_required ?
        authentication_key ?
        counters_kept ?
        refused 20I
        settings_commanded H
        replies_count B
        replies 32{
            serial I
            flight_computer B
            command B
            counter I
            stage B=stage
            why ?B=command_refusal
            reply_age_s d
            words 64s
        }
        lens_connected ?
        lens_moving ?
        lens_stopped ?
        focus_doubt ?B=doubt
        aperture_doubt ?B=doubt
        focus_range ?{
            focus_nearest_counts i
            focus_furthest_counts i
        }
        lens_requests B
        lens_errors I
        lens_last_error 64s
        autofocus_mode B=autofocus_mode
        autofocus_requested_counts ?i
        autofocus_run_age_s ?d
        autofocus_time_left_s ?d
        autofocus_images H
        autofocus_best ?{
            best_focus_counts d
            sigma_best_focus_counts d
            best_focus_drift_counts_min d
        }
        autofocus_ending ?B=focus_ending
        focus_estimate ?{
            star_width_px d
            focus_distance_counts d
            sigma_focus_distance_counts d
            focus_distance_calibrated ?
            star_width_px_per_hour ?d
            star_width_px_per_kelvin ?d
        }
        simulated_housekeeping ?
        temperature_lens_age_s ?d
        temperature_computer_age_s ?d
        temperature_vessel_age_s ?d
        temperature_plate_age_s ?d
        temperature_dcdc_age_s ?d
        temperature_flange_age_s ?d
        pressure_age_s ?d
        disk_free_age_s ?d
        temperature_lens_alarm ?
        temperature_computer_alarm ?
        temperature_vessel_alarm ?
        temperature_plate_alarm ?
        temperature_dcdc_alarm ?
        temperature_flange_alarm ?
        pressure_alarm ?
        disk_free_alarm ?
        disk_days_left ?d
        run_number ?I
        last_end ?B=last_end
        kept_at_start B=found
        restarts_lens I
        restarts_ledger I
        restarts_housekeeping I
        restarts_archive I
        shed B=shed
        images_kept I
        images_lost I
        images_thinned I
        images_disk_errors I
        copies_kept I
        copies_lost I
        copies_thinned I
        copies_disk_errors I
        last_restart ?B=actor
        last_restart_reason 64s
        last_restart_age_s ?d
        series ?{
            missing_packets I
            missed_images I
            start ?{
                start_ra_deg d
                start_dec_deg d
                start_roll_deg d
                start_sigma_east_arcsec d
                start_sigma_north_arcsec d
                start_before_middle_s d
            }
        }
        clocks_count B
        clocks 2{
            flight_computer B
            offset_s d
            sigma_s d
            age_s d
        }
        exposing B=exposed_by
        last_triggered_age_s ?d
        triggers_stayed_away I
        image_exposed_by ?B=exposed_by
        clock_sigma_s ?d
        captured_sigma_s ?d
        captured_uptime_s ?d
    """),
    5: ("gyro", """
        trigger_counter I
        image_counter I
        start_uptime_s d
        sample_rate_hz d
        elevation_deg ?d
        exposures_count B
        exposures 16{
            start_s f
            duration_s f
        }
        samples_count H
        samples 2048{
            az_rate_deg_s f
            el_rate_deg_s f
        }
    """),
    6: ("commands", """
        sequence I
        boot_id I
        camera_boot_id I
        lease_epoch I
        last_update_sequence ?I
        acknowledged I
        slots_count B
        slots 8{
            command B
            act B
            counter I
            age_s d
            values 8d
            seal I
        }
        tag ?32B
    """),
    7: ("image_request", """
        request I
        wanted B=wanted
        camera_boot_id ?I
        image_counter ?I
        exposure B
        form B=form
        offset I
        begun_crc32 ?I
        rate_bytes_s I
    """),
    8: ("image_chunk", """
        request I
        camera_boot_id I
        image_counter I
        exposure B
        exposures B
        form B=form
        total_bytes I
        file_crc32 I
        offset I
        bytes_count H
        bytes 2048B
    """),
    9: ("image_refusal", """
        request I
        no_image B=no_image
        words 96s
    """),
}


class WireError(Exception):
    """What came is no message: close the connection and connect again."""


class Scalar:
    """A number, an array of numbers, a text or a code, by its letter of `struct`."""

    def __init__(self, name, what):
        what, _, self.codes = what.partition("=")
        self.name = name
        self.text = what.endswith("s")
        counts, letter = ("", what) if self.text else (what[:-1], what[-1])
        self.dims = [int(count) for count in counts.split("x")] if counts else []
        total = 1
        for count in self.dims:
            total *= count
        self.format = struct.Struct("<" + (f"{total}{letter}" if self.dims else letter))
        self.size = self.format.size
        self.flag = letter == "?"

    def decode(self, body, at, known, out):
        if self.flag and body[at] > 1:
            raise WireError(f"{self.name}: {body[at]} is no flag")
        values = self.format.unpack_from(body, at)
        if any(isinstance(value, float) and not abs(value) <= 1.8e308 for value in values):
            raise WireError(f"{self.name}: not finite")
        value = values[0]
        if not known:
            value = None
        elif self.codes:
            if not 1 <= value <= len(CODES[self.codes]):
                raise WireError(f"{self.name}: {value} is no code")
            value = CODES[self.codes][value - 1]
        elif self.text:
            value = value.split(b"\0")[0].decode("ascii")
        elif self.dims:
            value = list(values)
            for count in self.dims[:0:-1]:
                value = [value[i:i + count] for i in range(0, len(value), count)]
            value = value[:out.get(self.name + "_count", len(value))]
        out[self.name] = value
        return at + self.size

    def encode(self, values):
        value = values.get(self.name)
        if value is None:
            if self.codes:
                return b"\0" if values.get(self.name + "_known") is False else b"\1"
            return bytes(self.size)
        if self.codes:
            value = CODES[self.codes].index(value) + 1
        elif self.text:
            value = value.encode("ascii")
        elif self.dims:
            for _ in self.dims[1:]:
                value = [inner for row in value for inner in row]
            value = value + [0] * (self.dims[0] - len(value)) if len(self.dims) == 1 else value
            return self.format.pack(*value)
        return self.format.pack(value)


class Group:
    """Fields one after the other, perhaps behind a flag."""

    def __init__(self, name, members, flagged):
        self.name, self.members, self.flagged = name, members, flagged
        self.size = flagged + sum(member.size for member in members)

    def decode(self, body, at, known, out):
        if self.flagged:
            if body[at] > 1:
                raise WireError(f"{self.name}_known: {body[at]} is no flag")
            known = known and body[at] == 1
            out[self.name + "_known"] = known
            at += 1
        for member in self.members:
            at = member.decode(body, at, known, out)
        return at

    def encode(self, values):
        if self.flagged and not self.is_known(values):
            return bytes(self.size)
        return b"\1" * self.flagged + b"".join(member.encode(values) for member in self.members)

    def is_known(self, values):
        """As its flag says; without one, if a value of it is given."""
        flag = values.get(self.name + "_known")
        if flag is None and len(self.members) == 1:
            return values.get(self.members[0].name) is not None
        return bool(flag)


class Rows:
    """A list of structs."""

    def __init__(self, name, members, count):
        self.name, self.row, self.count = name, Group(name, members, False), count
        self.size = self.row.size * count

    def decode(self, body, at, known, out):
        rows = []
        for _ in range(self.count):
            row = {}
            at = self.row.decode(body, at, known, row)
            rows.append(row)
        out[self.name] = rows[:out.get(self.name + "_count") or 0] if known else None
        return at

    def encode(self, values):
        rows = values.get(self.name) or []
        return b"".join(self.row.encode(row) for row in rows + [{}] * (self.count - len(rows)))


def layout(text):
    """The fields that some lines describe."""
    lines = iter(text.split("\n"))

    def members():
        found = []
        for line in lines:
            words = line.split()
            if words == ["}"]:
                break
            if not words:
                continue
            name, what = words
            if what == "?{":
                found.append(Group(name, members(), True))
            elif what.endswith("{"):
                found.append(Rows(name, members(), int(what[:-1])))
            elif what.startswith("?") and what != "?":
                found.append(Group(name, [Scalar(name, what[1:])], True))
            else:
                found.append(Scalar(name, what))
        return found

    return Group("body", members(), False)


BODIES = {kind: layout(text) for kind, (_, text) in LAYOUTS.items()}
KINDS = {name: kind for kind, (name, _) in LAYOUTS.items()}


def encode(message, values):
    """A frame: the name of a message and its fields. What is left out is not known, or zero."""
    kind = KINDS[message]
    covered = bytes([kind, VERSION_CURRENT]) + BODIES[kind].encode(values)
    return SYNC + struct.pack("<I", len(covered) + 4) + covered + struct.pack("<I", zlib.crc32(covered))


def decode(kind, version, body):
    """The name of a message and its fields, None for what is not known."""
    if kind not in LAYOUTS:
        raise WireError(f"unknown kind {kind}")
    name, size = LAYOUTS[kind][0], BODIES[kind].size
    if version < VERSION_MIN or len(body) < size or (version <= VERSION_CURRENT and len(body) != size):
        raise WireError(f"{name} of version {version} with {len(body)} bytes, expected {size}")
    values = {}
    BODIES[kind].decode(body, 0, True, values)
    return name, values


class Stream:
    """Turns received bytes into messages, from wherever the reading begins."""

    def __init__(self):
        self.buffer = bytearray()

    def feed(self, received):
        """Gives each message that is complete: its name and its fields."""
        self.buffer += received
        while True:
            start = self.buffer.find(SYNC)
            if start < 0:
                if len(self.buffer) > MAX_FRAME:
                    raise WireError("no sync word")
                return
            del self.buffer[:start]
            if len(self.buffer) < 8:
                return
            (length,) = struct.unpack_from("<I", self.buffer, 4)
            if not 6 <= length <= MAX_FRAME - 8:
                raise WireError(f"frame length {length}")
            if len(self.buffer) < 8 + length:
                return
            covered, frame_end = bytes(self.buffer[8:4 + length]), 8 + length
            (said,) = struct.unpack_from("<I", self.buffer, 4 + length)
            if zlib.crc32(covered) != said:
                raise WireError("wrong checksum")
            del self.buffer[:frame_end]
            yield decode(covered[0], covered[1], covered[2:])


ACTS = {"run": 1, "arm": 2, "fire": 3}
COMMAND_LASTS_S = 15.0


def parse_command(text):
    """A command as people write it, `arm` or `fire` before a hazardous one: what to do, its code and its values."""
    with open(os.path.join(os.path.dirname(os.path.abspath(__file__)), "schema.json"), encoding="utf-8") as file:
        known = {command["name"]: command for command in json.load(file)["commands"]}
    words = text.split()
    act = words.pop(0) if words and words[0] in ("arm", "fire") else "run"
    if not words or words[0] not in known:
        raise ValueError(f"no command is called {' '.join(words[:1])!r}")
    command = known[words.pop(0)]
    if len(words) != len(command["values"]):
        raise ValueError(f"{command['name']} takes {', '.join(v['name'] for v in command['values']) or 'no values'}")
    values = []
    for word, value in zip(words, command["values"]):
        number = float(value["words"].index(word)) if value["words"] else float(word)
        low, high = value["range"]
        if not low <= number <= high or value["whole"] and number != int(number):
            raise ValueError(f"{command['name']}: {value['name']} = {word}, expected {low} to {high}")
        values.append(number)
    return act, command["code"], values + [0.0] * (8 - len(values))


class Relay:
    """Commands from the ground, given one after the other, each when the one before has had its last reply."""

    def __init__(self, texts, key):
        self.waiting, self.key = [parse_command(text) for text in texts], key
        self.given, self.counters, self.blocks = None, {}, 0
        self.acknowledged, self.refused = 0, 0

    def block(self, boot_id, camera_boot_id, lease, last, now):
        """The next block; `lease`: the epoch of the lease that we hold, or None."""
        if self.given and now - self.given["at"] > COMMAND_LASTS_S and not self.given["accepted"]:
            self.given, self.refused = None, self.refused + 1
        if self.waiting and not self.given and lease is not None and self.blocks > 0:
            act, code, values = self.waiting.pop(0)
            counter = self.counters[code] = self.counters.get(code, 0) + 1
            sealed = struct.pack("<BBI8d", code, ACTS[act], counter, *values)
            self.given = {"code": code, "act": ACTS[act], "counter": counter, "values": values, "seal": zlib.crc32(sealed),
                          "at": now, "accepted": False}
        slots = []
        if self.given and not self.given["accepted"]:
            slots.append({"command": self.given["code"], "act": self.given["act"], "counter": self.given["counter"],
                          "age_s": now - self.given["at"], "values": self.given["values"], "seal": self.given["seal"]})
        values = {"sequence": self.blocks, "boot_id": boot_id, "camera_boot_id": camera_boot_id, "lease_epoch": lease or 0,
                  "last_update_sequence": last, "acknowledged": self.acknowledged, "slots_count": len(slots), "slots": slots}
        if self.key:
            tag = hmac.new(self.key, BODIES[KINDS["commands"]].encode(values)[:-33], hashlib.sha256).digest()
            values["tag"] = list(tag)
        self.blocks += 1
        return encode("commands", values)

    def take(self, update, us):
        """The replies in an update that are new."""
        new = [reply for reply in update["replies"] if reply["serial"] > self.acknowledged]
        for reply in new:
            self.acknowledged = max(self.acknowledged, reply["serial"])
            # A block that is refused as a whole is answered with no command's number; so is a slot of zeros, for another reason.
            whole = reply["command"] == 0 and reply["why"] in ("not_authentic", "wrong_boot")
            ours = self.given and reply["flight_computer"] == us and (
                whole or (reply["command"], reply["counter"]) == (self.given["code"], self.given["counter"]))
            if ours:
                self.given["accepted"] = True
                if reply["stage"] in ("completed", "rejected", "failed"):
                    self.refused += reply["stage"] != "completed"
                    self.given = None
        return new

    def idle(self):
        return not self.waiting and not self.given


class Fetch:
    """An image for a file, piece by piece. What came before a break lies in FILE.part, and beside it a note which image that is."""

    def __init__(self, options):
        self.options, self.number, self.end = options, 0, None
        self.part, self.note = options.out + ".part", options.out + ".part.json"
        self.begun, self.offset, self.not_before = None, 0, 0.0
        if os.path.exists(self.part) and os.path.exists(self.note):
            with open(self.note, encoding="utf-8") as file:
                begun = json.load(file)
            if begun["form"] == self.form() and begun["asked"] == options.fetch:
                self.begun, self.offset = begun, os.path.getsize(self.part)

    def form(self):
        return "view" if self.options.view else "raw"

    def request(self):
        """The next request."""
        options = self.options
        self.number += 1
        values = {"request": self.number, "wanted": "image", "form": self.form(), "exposure": options.exposure,
                  "offset": self.offset, "rate_bytes_s": options.rate}
        if self.begun:
            for name in ("camera_boot_id", "image_counter", "exposure"):
                values[name] = self.begun[name]
            values["begun_crc32"] = self.begun["file_crc32"]
        elif options.fetch in ("newest", "next"):
            values["wanted"] = options.fetch
        else:
            values["image_counter"] = int(options.fetch)
        return encode("image_request", values)

    def take(self, name, values, now):
        """An answer; `end` says how it ended, once it has."""
        if values["request"] != self.number:
            return
        if name == "image_refusal":
            if values["no_image"] == "busy":
                self.not_before = now + 1.0
            elif values["no_image"] == "changed":
                self.begun, self.offset = None, 0
            else:
                self.end = f"refused: {values['no_image']}: {values['words']}"
            return
        if not self.begun:
            self.begun = {name: values[name] for name in ("camera_boot_id", "image_counter", "exposure", "exposures", "form",
                                                          "total_bytes", "file_crc32")}
            self.begun["asked"] = self.options.fetch
            open(self.part, "wb").close()
            with open(self.note, "w", encoding="utf-8") as file:
                json.dump(self.begun, file)
        with open(self.part, "r+b") as file:
            file.seek(values["offset"])
            file.write(bytes(values["bytes"]))
        self.offset = values["offset"] + values["bytes_count"]
        if self.offset >= values["total_bytes"]:
            with open(self.part, "rb") as file:
                whole = zlib.crc32(file.read()) == values["file_crc32"]
            if whole:
                os.replace(self.part, self.options.out)
            os.remove(self.note)
            self.end = "whole" if whole else "its checksum is wrong"


class Client:
    """A flight computer that shakes hands, sends its status on a steady schedule and hands on what it gets."""

    def __init__(self, options, show):
        self.options, self.show = options, show
        key = bytes.fromhex(open(options.key_file, encoding="ascii").read()) if options.key_file else None
        self.relay = Relay(options.send, key)
        self.fetch = Fetch(options) if options.fetch else None
        self.started = time.monotonic()
        self.boot_id = struct.unpack("<I", os.urandom(4))[0]
        self.updates = 0

    def hello(self):
        return encode("hello", {
            "magic": "STARSCAM", "version_min": VERSION_MIN, "version_current": VERSION_CURRENT,
            "role": "flight_computer", "id": self.options.id, "name": f"python{self.options.id}",
            "boot_id": self.boot_id, "build": "stars_client.py",
        })

    def status(self, sequence, received, last):
        options = self.options
        observer = options.latitude_deg is not None and options.sidereal_time_h is not None
        return encode("status", {
            "sequence": sequence, "boot_id": self.boot_id, "uptime_s": time.monotonic() - self.started,
            "claims_charge": options.in_charge, "clock_unix_s": time.time(), "clock_quality": "free_running",
            "observer_known": observer, "latitude_deg": options.latitude_deg, "sidereal_time_h": options.sidereal_time_h,
            "updates_received": received, "last_update_sequence": last,
        })

    def done(self):
        if self.fetch:
            return self.fetch.end is not None
        if self.options.send and self.options.updates is None:
            return self.relay.idle()
        return self.options.updates is not None and self.updates >= self.options.updates

    def serve(self, link):
        """One connection, until it ends or enough updates came. Gives the reason for its end."""
        link.sendall(self.hello())
        stream, heard = Stream(), time.monotonic()
        sequence, received, last = 0, 0, None
        camera_boot, lease = 0, None
        self.relay.blocks, self.relay.acknowledged = 0, 0
        due = None  # no status before the camera's hello
        asked = False  # a request for an image has no answer yet
        while not self.done():
            now = time.monotonic()
            if due is not None and now >= due:
                link.sendall(self.status(sequence, received, last))
                link.sendall(self.relay.block(self.boot_id, camera_boot, lease, last, now))
                sequence += 1
                # The schedule stays where it was, however late this one is.
                due += STATUS_PERIOD_S * (1 + int((now - due) / STATUS_PERIOD_S))
            if self.fetch and due is not None and not asked and now >= self.fetch.not_before:
                link.sendall(self.fetch.request())
                asked = True
            if now - heard > SILENCE_S:
                return "the camera is silent"
            wait = SILENCE_S if due is None else due - time.monotonic()
            link.settimeout(max(wait, 0.001))
            try:
                data = link.recv(65536)
            except socket.timeout:
                continue
            if not data:
                return "the camera closed the connection"
            for name, values in stream.feed(data):
                heard = time.monotonic()
                if name == "hello":
                    low = max(VERSION_MIN, values["version_min"])
                    if low > min(VERSION_CURRENT, values["version_current"]):
                        return "no version in common"
                    due = time.monotonic()
                    camera_boot = values["boot_id"]
                    self.show("connected", values)
                elif name in ("image_chunk", "image_refusal") and self.fetch:
                    asked = False
                    self.fetch.take(name, values, heard)
                    if self.fetch.end:
                        self.show("image", {**(self.fetch.begun or {}), "end": self.fetch.end})
                elif name == "refuse":
                    return f"refused: {values['refusal']}: {values['detail']}"
                elif name == "update" and not self.done():
                    if values["boot_id"] != camera_boot:
                        # It was started again on the same connection, and counts its replies from 1.
                        camera_boot, self.relay.acknowledged = values["boot_id"], 0
                    received, last = received + 1, values["sequence"]
                    self.updates += 1
                    lease = values["lease_epoch"] if values["you_are_in_charge"] else None
                    self.show("update", values)
                    for reply in self.relay.take(values, self.options.id):
                        self.show("command", reply)
        return None

    def run(self):
        host, _, port = self.options.connect.rpartition(":")
        while True:
            try:
                with socket.create_connection((host, int(port or PORT)), timeout=SILENCE_S) as link:
                    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    reason = self.serve(link)
            except (OSError, WireError) as error:
                reason = str(error)
            if reason is None and self.fetch:
                return 0 if self.fetch.end == "whole" else 1
            if reason is None:
                return 1 if self.relay.refused else 0
            self.show("closed", {"reason": reason})
            if self.options.once:
                return 1
            time.sleep(self.options.retry)


def printer(as_json, started):
    """Prints what comes, as JSON lines or for people."""
    def show(kind, values):
        if as_json:
            line = json.dumps({"t_s": round(time.monotonic() - started, 3), "kind": kind, **values})
        elif kind == "update":
            line = f"#{values['sequence']} "
            line += f"image {values['image_counter']} {values['reason']}" if values["image_known"] else "no image yet"
            if values["equatorial_known"]:
                line += f" ra {values['ra_deg']:.5f} dec {values['dec_deg']:.5f} roll {values['roll_deg']:.4f} deg"
        else:
            line = f"{kind}: " + ", ".join(f"{name} {value}" for name, value in values.items())
        print(line, flush=True)
    return show


def read_hex(path):
    with open(path, encoding="ascii") as file:
        return bytes.fromhex("".join(file.read().split()))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--connect", metavar="HOST:PORT", help="camera to connect to")
    parser.add_argument("--id", type=int, default=1, help="which flight computer this is (1)")
    parser.add_argument("--in-charge", action="store_true", help="claim to be in charge")
    parser.add_argument("--latitude-deg", type=float, help="observer's latitude to send")
    parser.add_argument("--sidereal-time-h", type=float, help="observer's sidereal time to send")
    parser.add_argument("--updates", type=int, help="end after so many updates")
    parser.add_argument("--send", metavar="COMMAND", action="append", default=[],
                        help="command to send, such as 'lens.set_focus 3030'; repeatable; exit 1 if one is refused or fails")
    parser.add_argument("--key-file", metavar="FILE", help="key that this computer shares with the camera, 64 hex digits")
    parser.add_argument("--fetch", metavar="N", help="image to fetch into --out: its number, `newest`, or `next` for the next one")
    parser.add_argument("--out", metavar="FILE", help="file for it; goes on with FILE.part after a break")
    parser.add_argument("--view", action="store_true", help="fetch its view over a thin link, for scripts/view.py")
    parser.add_argument("--exposure", type=int, default=0, help="place of the exposure in its series (0)")
    parser.add_argument("--rate", type=int, default=1000000, help="bytes/s at most (the camera's own limit)")
    parser.add_argument("--retry", type=float, default=RETRY_S, help="seconds before connecting again (9)")
    parser.add_argument("--once", action="store_true", help="do not connect again: exit 1 when the connection ends")
    parser.add_argument("--json", action="store_true", help="print JSON lines")
    parser.add_argument("--decode", metavar="FILE.hex", help="print the message in a golden file as JSON")
    parser.add_argument("--encode-again", metavar="FILE.hex", help="read a golden file and print the same bytes made anew")
    options = parser.parse_args()
    if options.decode:
        ((_, values),) = Stream().feed(read_hex(options.decode))
        print(json.dumps(values))
    elif options.encode_again:
        ((name, values),) = Stream().feed(read_hex(options.encode_again))
        frame = encode(name, values)
        print("\n".join(frame[i:i + 32].hex() for i in range(0, len(frame), 32)))
    elif options.connect:
        if bool(options.fetch) != bool(options.out):
            parser.error("--fetch and --out go together")
        if options.fetch and options.fetch not in ("newest", "next") and not options.fetch.isdecimal():
            parser.error(f"--fetch {options.fetch}: expected a number, newest or next")
        try:
            [parse_command(text) for text in options.send]
        except ValueError as error:
            parser.error(str(error))
        try:
            return Client(options, printer(options.json, time.monotonic())).run()
        except KeyboardInterrupt:
            return 0
    else:
        parser.error("one of --connect, --decode, --encode-again is needed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
