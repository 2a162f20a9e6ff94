/* The wire between a star camera and its flight computers, as C structs.
 *
 * Made from the layout tables of the program by `STARS_BLESS=1 cargo test --test proto`; not to be edited.
 * The meaning of it all is in ICD.md and README.md beside this file.
 *
 * All structs are packed and little-endian, as on the wire: overlay one on the body of a frame. A flag `x_known` is 1
 * where `x` is known and 0 where it is not; then `x` is all zero bytes. Copy a number out of a packed struct before
 * taking its address. `char` arrays end at their first zero byte and may be full, with none.
 */
#ifndef STARS_ICD_H
#define STARS_ICD_H

#include <stddef.h>
#include <stdint.h>

#if !defined(__BYTE_ORDER__) || __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "these structs are little-endian: on another machine, read the body byte by byte"
#endif

#define STARS_PACKED __attribute__((packed))
#ifdef __cplusplus
#define STARS_ASSERT(condition, message) static_assert(condition, message)
#else
#define STARS_ASSERT(condition, message) _Static_assert(condition, message)
#endif

#define STARS_PORT 2017
#define STARS_VERSION_MIN 1
#define STARS_VERSION_CURRENT 3
#define STARS_SCHEMA_HASH UINT32_C(0xff63c55a)
#define STARS_SYNC UINT32_C(0x1dfccf1a)
#define STARS_MAX_FRAME 65536

/* Kinds of message. */
enum {
    STARS_KIND_HELLO = 1,
    STARS_KIND_REFUSE = 2,
    STARS_KIND_STATUS = 3,
    STARS_KIND_UPDATE = 4,
    STARS_KIND_GYRO = 5,
    STARS_KIND_COMMANDS = 6,
    STARS_KIND_IMAGE_REQUEST = 7,
    STARS_KIND_IMAGE_CHUNK = 8,
    STARS_KIND_IMAGE_REFUSAL = 9,
};

/* Codes of `role`; 0 is never valid. */
enum {
    STARS_ROLE_CAMERA = 1,
    STARS_ROLE_FLIGHT_COMPUTER = 2,
};

/* Codes of `refusal`; 0 is never valid. */
enum {
    STARS_REFUSAL_NO_COMMON_VERSION = 1,
    STARS_REFUSAL_NOT_A_HELLO = 2,
    STARS_REFUSAL_WRONG_ROLE = 3,
    STARS_REFUSAL_ADDRESS_NOT_ALLOWED = 4,
    STARS_REFUSAL_TOO_MANY_CONNECTIONS = 5,
    STARS_REFUSAL_REPLACED = 6,
    STARS_REFUSAL_BAD_MESSAGE = 7,
    STARS_REFUSAL_SILENT = 8,
    STARS_REFUSAL_SHUTTING_DOWN = 9,
};

/* Codes of `clock_quality`; 0 is never valid. */
enum {
    STARS_CLOCK_QUALITY_UNSET = 1,
    STARS_CLOCK_QUALITY_FREE_RUNNING = 2,
    STARS_CLOCK_QUALITY_SYNCHRONISED = 3,
    STARS_CLOCK_QUALITY_FLIGHT_COMPUTER = 4,
    STARS_CLOCK_QUALITY_CHRONY = 5,
    STARS_CLOCK_QUALITY_PTP = 6,
};

/* Codes of `stage`; 0 is never valid. */
enum {
    STARS_STAGE_ACCEPTED = 1,
    STARS_STAGE_STARTED = 2,
    STARS_STAGE_COMPLETED = 3,
    STARS_STAGE_REJECTED = 4,
    STARS_STAGE_FAILED = 5,
};

/* Codes of `why`; 0 is never valid. */
enum {
    STARS_WHY_NOT_IN_CHARGE = 1,
    STARS_WHY_STALE = 2,
    STARS_WHY_REPLAYED = 3,
    STARS_WHY_OUT_OF_RANGE = 4,
    STARS_WHY_BUSY = 5,
    STARS_WHY_NOT_ARMED = 6,
    STARS_WHY_UNKNOWN_COMMAND = 7,
    STARS_WHY_UNSAFE_STATE = 8,
    STARS_WHY_NOT_AUTHENTIC = 9,
    STARS_WHY_HALF_CHANGED = 10,
    STARS_WHY_EARLY = 11,
    STARS_WHY_WRONG_BOOT = 12,
    STARS_WHY_NOT_AVAILABLE = 13,
    STARS_WHY_NOT_KEPT = 14,
    STARS_WHY_STOPPED = 15,
    STARS_WHY_DEVICE = 16,
    STARS_WHY_PROGRAM = 17,
    STARS_WHY_DIALECT = 18,
    STARS_WHY_NO_RESULT = 19,
    STARS_WHY_RESTARTED = 20,
};

/* Codes of `reason`; 0 is never valid. */
enum {
    STARS_REASON_SOLVED = 1,
    STARS_REASON_SATURATED = 2,
    STARS_REASON_TOO_BRIGHT = 3,
    STARS_REASON_NO_CONTRAST = 4,
    STARS_REASON_TOO_FEW_SOURCES = 5,
    STARS_REASON_NO_MATCH = 6,
    STARS_REASON_UNDECIDED = 7,
    STARS_REASON_REQUIREMENT = 8,
    STARS_REASON_TIMED_OUT = 9,
    STARS_REASON_ABORTED = 10,
    STARS_REASON_DISABLED = 11,
    STARS_REASON_SKIPPED = 12,
    STARS_REASON_UNREADABLE = 13,
    STARS_REASON_FAILED = 14,
};

/* Codes of `cause`; 0 is never valid. */
enum {
    STARS_CAUSE_OVEREXPOSED = 1,
    STARS_CAUSE_SATURATED = 2,
    STARS_CAUSE_NO_CONTRAST = 3,
    STARS_CAUSE_OUT_OF_FOCUS = 4,
    STARS_CAUSE_TRAILED = 5,
    STARS_CAUSE_CLOUDS = 6,
    STARS_CAUSE_TOO_FEW_STARS = 7,
    STARS_CAUSE_TOO_MANY_ARTEFACTS = 8,
    STARS_CAUSE_WRONG_PLATESCALE = 9,
    STARS_CAUSE_MIRRORED = 10,
    STARS_CAUSE_WRONG_PRIOR = 11,
    STARS_CAUSE_LENS_COVERED = 12,
};

/* Codes of `mode`; 0 is never valid. */
enum {
    STARS_MODE_NORMAL = 1,
    STARS_MODE_ROBUST = 2,
    STARS_MODE_MOTION = 3,
};

/* Codes of `focus_doubt`; 0 is never valid. */
enum {
    STARS_FOCUS_DOUBT_NO_LENS = 1,
    STARS_FOCUS_DOUBT_NEVER_READ = 2,
    STARS_FOCUS_DOUBT_REQUESTED = 3,
    STARS_FOCUS_DOUBT_NOT_READ_BACK = 4,
    STARS_FOCUS_DOUBT_TIMED_OUT = 5,
    STARS_FOCUS_DOUBT_UNEXPECTED_REPLY = 6,
    STARS_FOCUS_DOUBT_REFUSED = 7,
    STARS_FOCUS_DOUBT_PORT_LOST = 8,
    STARS_FOCUS_DOUBT_NOT_LEARNED = 9,
    STARS_FOCUS_DOUBT_POWER_CYCLED = 10,
    STARS_FOCUS_DOUBT_COUNTS_LOST = 11,
    STARS_FOCUS_DOUBT_MISSED = 12,
};

/* Codes of `autofocus_mode`; 0 is never valid. */
enum {
    STARS_AUTOFOCUS_MODE_NOT_RUNNING = 1,
    STARS_AUTOFOCUS_MODE_RUNNING = 2,
    STARS_AUTOFOCUS_MODE_GRACE = 3,
};

/* Codes of `autofocus_ending`; 0 is never valid. */
enum {
    STARS_AUTOFOCUS_ENDING_FOUND = 1,
    STARS_AUTOFOCUS_ENDING_EDGE_LOW = 2,
    STARS_AUTOFOCUS_ENDING_EDGE_HIGH = 3,
    STARS_AUTOFOCUS_ENDING_NO_PEAK = 4,
    STARS_AUTOFOCUS_ENDING_TOO_FEW = 5,
    STARS_AUTOFOCUS_ENDING_NOT_CONFIRMED = 6,
    STARS_AUTOFOCUS_ENDING_TIMED_OUT = 7,
    STARS_AUTOFOCUS_ENDING_ABORTED = 8,
    STARS_AUTOFOCUS_ENDING_STOPPED = 9,
    STARS_AUTOFOCUS_ENDING_LENS_FAILED = 10,
    STARS_AUTOFOCUS_ENDING_BETTER = 11,
    STARS_AUTOFOCUS_ENDING_WORSE = 12,
};

/* Codes of `last_end`; 0 is never valid. */
enum {
    STARS_LAST_END_CLEAN = 1,
    STARS_LAST_END_COMMANDED = 2,
    STARS_LAST_END_CRASHED = 3,
    STARS_LAST_END_COMPUTER_RESTARTED = 4,
};

/* Codes of `kept_at_start`; 0 is never valid. */
enum {
    STARS_KEPT_AT_START_NOTHING = 1,
    STARS_KEPT_AT_START_WHOLE = 2,
    STARS_KEPT_AT_START_ONE_COPY = 3,
    STARS_KEPT_AT_START_DAMAGED = 4,
};

/* Codes of `shed`; 0 is never valid. */
enum {
    STARS_SHED_NOTHING = 1,
    STARS_SHED_DISPLAY = 2,
    STARS_SHED_IMAGES = 3,
    STARS_SHED_SOLVING = 4,
};

/* Codes of `last_restart`; 0 is never valid. */
enum {
    STARS_LAST_RESTART_CAMERA = 1,
    STARS_LAST_RESTART_LENS = 2,
    STARS_LAST_RESTART_SOLVER = 3,
    STARS_LAST_RESTART_HUB = 4,
    STARS_LAST_RESTART_RECORDER = 5,
    STARS_LAST_RESTART_LEDGER = 6,
    STARS_LAST_RESTART_LISTENER = 7,
    STARS_LAST_RESTART_SESSION = 8,
    STARS_LAST_RESTART_HOUSEKEEPING = 9,
    STARS_LAST_RESTART_LEGACY_LISTENER = 10,
    STARS_LAST_RESTART_ARCHIVE = 11,
    STARS_LAST_RESTART_DISPLAY = 12,
};

/* Codes of `exposing`; 0 is never valid. */
enum {
    STARS_EXPOSING_ASKED = 1,
    STARS_EXPOSING_TRIGGER = 2,
    STARS_EXPOSING_ITSELF = 3,
};

/* Codes of `wanted`; 0 is never valid. */
enum {
    STARS_WANTED_IMAGE = 1,
    STARS_WANTED_NEWEST = 2,
    STARS_WANTED_NEXT = 3,
};

/* Codes of `form`; 0 is never valid. */
enum {
    STARS_FORM_RAW = 1,
    STARS_FORM_VIEW = 2,
};

/* Codes of `no_image`; 0 is never valid. */
enum {
    STARS_NO_IMAGE_NEVER_WAS = 1,
    STARS_NO_IMAGE_NOT_KEPT = 2,
    STARS_NO_IMAGE_CHANGED = 3,
    STARS_NO_IMAGE_OFFSET = 4,
    STARS_NO_IMAGE_RATE = 5,
    STARS_NO_IMAGE_NO_NUMBER = 6,
    STARS_NO_IMAGE_DISK = 7,
    STARS_NO_IMAGE_FORM = 8,
    STARS_NO_IMAGE_BUSY = 9,
};

/* What to do with a command. */
enum {
    STARS_ACT_RUN = 1,
    STARS_ACT_ARM = 2,
    STARS_ACT_FIRE = 3,
};

/* Commands, with their values. */
enum {
    STARS_COMMAND_SERVICE_QUIT = 1, /* */
    STARS_COMMAND_SERVICE_SHUT_DOWN = 2, /* restart */
    STARS_COMMAND_SERVICE_RESET_NETWORK = 3, /* */
    STARS_COMMAND_SERVICE_SET_NETWORK_LULL = 4, /* enabled delay_s */
    STARS_COMMAND_SERVICE_FACTORY_RESET = 5, /* */
    STARS_COMMAND_SERVICE_KNOWN_GOOD = 6, /* */
    STARS_COMMAND_DISPLAY_CONFIGURE = 7, /* rate_hz full_screen image_only show_requirements brightness */
    STARS_COMMAND_DISPLAY_SET_ZOOM = 8, /* x_px y_px magnification */
    STARS_COMMAND_IMAGES_SEND = 9, /* enabled */
    STARS_COMMAND_CAMERA_SET_SERIES = 10, /* readout_delay_s */
    STARS_COMMAND_CAMERA_GET_GAIN = 11, /* */
    STARS_COMMAND_CAMERA_SET_GAIN = 12, /* gain_db */
    STARS_COMMAND_SIMULATOR_SET_BRIGHTNESS = 13, /* enabled level_ke_s_px gain_db actual_exposure_s simulated_exposure_s */
    STARS_COMMAND_LENS_FLUSH = 20, /* */
    STARS_COMMAND_LENS_INIT_FOCUS = 21, /* */
    STARS_COMMAND_LENS_GET_FOCUS = 22, /* */
    STARS_COMMAND_LENS_SET_FOCUS = 23, /* position_counts */
    STARS_COMMAND_LENS_MOVE_FOCUS = 24, /* step_counts */
    STARS_COMMAND_LENS_INIT_APERTURE = 25, /* */
    STARS_COMMAND_LENS_GET_APERTURE = 26, /* */
    STARS_COMMAND_LENS_SET_APERTURE = 27, /* position_counts */
    STARS_COMMAND_LENS_STOP = 28, /* */
    STARS_COMMAND_FOCUS_RUN = 40, /* */
    STARS_COMMAND_FOCUS_SET_RANGE = 41, /* min_counts max_counts step_counts */
    STARS_COMMAND_FOCUS_ABORT = 42, /* use_result */
    STARS_COMMAND_FOCUS_REFOCUS = 43, /* step_counts */
    STARS_COMMAND_FOCUS_ADVISE = 45, /* */
    STARS_COMMAND_FOCUS_SET_DISPLAY = 44, /* show */
    STARS_COMMAND_SOLVER_CONFIGURE = 60, /* enabled timeout_s */
    STARS_COMMAND_SOLVER_ABORT = 61, /* */
    STARS_COMMAND_SOLVER_MASK = 62, /* enabled field_0 field_1 field_2 */
    STARS_COMMAND_SOLVER_SOURCES = 63, /* snr_threshold max_sources robust */
    STARS_COMMAND_SOLVER_CELLS = 64, /* cell_px max_per_cell */
    STARS_COMMAND_SOLVER_MOTION = 65, /* enabled */
    STARS_COMMAND_SOLVER_MATCHING = 66, /* enabled tolerance_px platescale_min_arcsec_px platescale_max_arcsec_px */
    STARS_COMMAND_REQUIREMENTS_HORIZONTAL_LOCATION = 80, /* enabled radius_deg */
    STARS_COMMAND_REQUIREMENTS_HORIZONTAL_ROLL = 81, /* enabled min_deg max_deg */
    STARS_COMMAND_REQUIREMENTS_ELEVATION = 82, /* enabled min_deg max_deg */
    STARS_COMMAND_REQUIREMENTS_EQUATORIAL_LOCATION = 83, /* enabled radius_deg */
    STARS_COMMAND_REQUIREMENTS_EQUATORIAL_ROLL = 84, /* enabled min_deg max_deg */
    STARS_COMMAND_REQUIREMENTS_MATCHING = 85, /* pointing_error_max_arcsec fit_error_max_px min_matched */
};

/* First message either way: who is there, and which versions it speaks. */
typedef struct STARS_PACKED {
    char magic[8]; /* Always `STARSCAM`. */
    uint8_t version_min; /* Lowest version of the protocol that the sender speaks. */
    uint8_t version_current; /* Highest version of the protocol that the sender speaks. */
    uint8_t schema_hash_known; /* Whether `schema_hash` is known. */
    uint32_t schema_hash; /* CRC-32 of the sender's layout tables; another number in the same version means that one end was built wrong. Unknown where the sender has no tables to compute it from. */
    uint8_t role; /* What the sender is. */
    uint8_t id; /* Which of its kind it is: flight computers are told apart by this number. */
    char name[16]; /* Its name, for logs. */
    uint32_t boot_id; /* Number drawn at random at the sender's start: another one means that it started anew. */
    char build[32]; /* Version of the sender's program. */
    uint8_t settings_hash_known; /* Whether `settings_hash` is known. */
    uint32_t settings_hash; /* CRC-32 of the sender's settings. */
} stars_hello_t;
STARS_ASSERT(sizeof(stars_hello_t) == 74, "stars_hello_t");
STARS_ASSERT(offsetof(stars_hello_t, magic) == 0, "stars_hello_t.magic");
STARS_ASSERT(offsetof(stars_hello_t, version_min) == 8, "stars_hello_t.version_min");
STARS_ASSERT(offsetof(stars_hello_t, version_current) == 9, "stars_hello_t.version_current");
STARS_ASSERT(offsetof(stars_hello_t, schema_hash_known) == 10, "stars_hello_t.schema_hash_known");
STARS_ASSERT(offsetof(stars_hello_t, schema_hash) == 11, "stars_hello_t.schema_hash");
STARS_ASSERT(offsetof(stars_hello_t, role) == 15, "stars_hello_t.role");
STARS_ASSERT(offsetof(stars_hello_t, id) == 16, "stars_hello_t.id");
STARS_ASSERT(offsetof(stars_hello_t, name) == 17, "stars_hello_t.name");
STARS_ASSERT(offsetof(stars_hello_t, boot_id) == 33, "stars_hello_t.boot_id");
STARS_ASSERT(offsetof(stars_hello_t, build) == 37, "stars_hello_t.build");
STARS_ASSERT(offsetof(stars_hello_t, settings_hash_known) == 69, "stars_hello_t.settings_hash_known");
STARS_ASSERT(offsetof(stars_hello_t, settings_hash) == 70, "stars_hello_t.settings_hash");

/* Last message before the sender closes the connection, where there is time for one. */
typedef struct STARS_PACKED {
    uint8_t refusal; /* Why. */
    uint8_t version_min; /* Lowest version of the protocol that the sender speaks. */
    uint8_t version_current; /* Highest version of the protocol that the sender speaks. */
    char detail[96]; /* The reason in words. */
} stars_refuse_t;
STARS_ASSERT(sizeof(stars_refuse_t) == 99, "stars_refuse_t");
STARS_ASSERT(offsetof(stars_refuse_t, refusal) == 0, "stars_refuse_t.refusal");
STARS_ASSERT(offsetof(stars_refuse_t, version_min) == 1, "stars_refuse_t.version_min");
STARS_ASSERT(offsetof(stars_refuse_t, version_current) == 2, "stars_refuse_t.version_current");
STARS_ASSERT(offsetof(stars_refuse_t, detail) == 3, "stars_refuse_t.detail");

/* What a flight computer knows, to the camera every 0.5 s. */
typedef struct STARS_PACKED {
    uint32_t sequence; /* Counts the sender's statuses of this connection, from 0. */
    uint32_t boot_id; /* Number drawn at random at the sender's start: another one means that it started anew. */
    double uptime_s; /* Time since the sender's start, from a clock that never jumps. [s] */
    uint8_t claims_charge; /* The sender claims to be in charge. Only what a computer in charge says is acted upon. */
    uint8_t clock_unix_s_known; /* Whether `clock_unix_s` is known. */
    double clock_unix_s; /* UTC when this message was made, seconds since 1970. [s] */
    uint8_t clock_quality; /* How far that clock can be believed. */
    uint8_t observer_known; /* Whether the fields that need it are known. Where the gondola is and how far the sky has turned. */
    double latitude_deg; /* Geodetic latitude, north positive. [deg] */
    double sidereal_time_h; /* Local apparent sidereal time. [h] */
    uint8_t horizontal_estimate_known; /* Whether the fields that need it are known. The sender's estimate of where this camera looks, against the horizon. */
    double az_deg; /* Azimuth, from north through east. [deg] */
    double el_deg; /* Elevation. [deg] */
    uint8_t equatorial_estimate_known; /* Whether the fields that need it are known. The sender's estimate of where this camera looks, on the sky. */
    double ra_deg; /* Right ascension, ICRS. [deg] */
    double dec_deg; /* Declination, ICRS. [deg] */
    uint8_t trigger_counter_known; /* Whether `trigger_counter` is known. */
    uint32_t trigger_counter; /* Number of the series of triggers that images downloaded from now on belong to. */
    uint8_t trigger_image_counter_known; /* Whether `trigger_image_counter` is known. */
    uint32_t trigger_image_counter; /* The camera's number of the image that the last series made, as the sender expects it. */
    uint8_t trigger_age_s_known; /* Whether `trigger_age_s` is known. */
    double trigger_age_s; /* Time since the last trigger pulse began. [s] */
    uint32_t trigger_pulses; /* Trigger pulses since the sender's start. */
    uint32_t updates_received; /* Updates received on this connection. */
    uint8_t last_update_sequence_known; /* Whether `last_update_sequence` is known. */
    uint32_t last_update_sequence; /* Sequence number of the last update received. */
} stars_status_t;
STARS_ASSERT(sizeof(stars_status_t) == 110, "stars_status_t");
STARS_ASSERT(offsetof(stars_status_t, sequence) == 0, "stars_status_t.sequence");
STARS_ASSERT(offsetof(stars_status_t, boot_id) == 4, "stars_status_t.boot_id");
STARS_ASSERT(offsetof(stars_status_t, uptime_s) == 8, "stars_status_t.uptime_s");
STARS_ASSERT(offsetof(stars_status_t, claims_charge) == 16, "stars_status_t.claims_charge");
STARS_ASSERT(offsetof(stars_status_t, clock_unix_s_known) == 17, "stars_status_t.clock_unix_s_known");
STARS_ASSERT(offsetof(stars_status_t, clock_unix_s) == 18, "stars_status_t.clock_unix_s");
STARS_ASSERT(offsetof(stars_status_t, clock_quality) == 26, "stars_status_t.clock_quality");
STARS_ASSERT(offsetof(stars_status_t, observer_known) == 27, "stars_status_t.observer_known");
STARS_ASSERT(offsetof(stars_status_t, latitude_deg) == 28, "stars_status_t.latitude_deg");
STARS_ASSERT(offsetof(stars_status_t, sidereal_time_h) == 36, "stars_status_t.sidereal_time_h");
STARS_ASSERT(offsetof(stars_status_t, horizontal_estimate_known) == 44, "stars_status_t.horizontal_estimate_known");
STARS_ASSERT(offsetof(stars_status_t, az_deg) == 45, "stars_status_t.az_deg");
STARS_ASSERT(offsetof(stars_status_t, el_deg) == 53, "stars_status_t.el_deg");
STARS_ASSERT(offsetof(stars_status_t, equatorial_estimate_known) == 61, "stars_status_t.equatorial_estimate_known");
STARS_ASSERT(offsetof(stars_status_t, ra_deg) == 62, "stars_status_t.ra_deg");
STARS_ASSERT(offsetof(stars_status_t, dec_deg) == 70, "stars_status_t.dec_deg");
STARS_ASSERT(offsetof(stars_status_t, trigger_counter_known) == 78, "stars_status_t.trigger_counter_known");
STARS_ASSERT(offsetof(stars_status_t, trigger_counter) == 79, "stars_status_t.trigger_counter");
STARS_ASSERT(offsetof(stars_status_t, trigger_image_counter_known) == 83, "stars_status_t.trigger_image_counter_known");
STARS_ASSERT(offsetof(stars_status_t, trigger_image_counter) == 84, "stars_status_t.trigger_image_counter");
STARS_ASSERT(offsetof(stars_status_t, trigger_age_s_known) == 88, "stars_status_t.trigger_age_s_known");
STARS_ASSERT(offsetof(stars_status_t, trigger_age_s) == 89, "stars_status_t.trigger_age_s");
STARS_ASSERT(offsetof(stars_status_t, trigger_pulses) == 97, "stars_status_t.trigger_pulses");
STARS_ASSERT(offsetof(stars_status_t, updates_received) == 101, "stars_status_t.updates_received");
STARS_ASSERT(offsetof(stars_status_t, last_update_sequence_known) == 105, "stars_status_t.last_update_sequence_known");
STARS_ASSERT(offsetof(stars_status_t, last_update_sequence) == 106, "stars_status_t.last_update_sequence");

/* A source in an image. */
typedef struct STARS_PACKED {
    float x_px; /* Column in file order, centres of pixels at integers. [px] */
    float y_px; /* Row in file order. [px] */
    float sigma_px; /* One standard deviation of the position per axis. [px] */
    float flux_adu; /* Flux above the surroundings. [ADU] */
    float peak_adu; /* Highest pixel above the surroundings. [ADU] */
    float snr; /* Signal over noise of the matched filter. */
    uint8_t saturated; /* A pixel of it is saturated. */
    uint8_t star_id_known; /* Whether `star_id` is known. */
    uint32_t star_id; /* The star that it was matched to, by its place in the camera's catalogue, brightest first. */
} stars_source_t;
STARS_ASSERT(sizeof(stars_source_t) == 30, "stars_source_t");
STARS_ASSERT(offsetof(stars_source_t, x_px) == 0, "stars_source_t.x_px");
STARS_ASSERT(offsetof(stars_source_t, y_px) == 4, "stars_source_t.y_px");
STARS_ASSERT(offsetof(stars_source_t, sigma_px) == 8, "stars_source_t.sigma_px");
STARS_ASSERT(offsetof(stars_source_t, flux_adu) == 12, "stars_source_t.flux_adu");
STARS_ASSERT(offsetof(stars_source_t, peak_adu) == 16, "stars_source_t.peak_adu");
STARS_ASSERT(offsetof(stars_source_t, snr) == 20, "stars_source_t.snr");
STARS_ASSERT(offsetof(stars_source_t, saturated) == 24, "stars_source_t.saturated");
STARS_ASSERT(offsetof(stars_source_t, star_id_known) == 25, "stars_source_t.star_id_known");
STARS_ASSERT(offsetof(stars_source_t, star_id) == 26, "stars_source_t.star_id");

/* A stage that a command reached. */
typedef struct STARS_PACKED {
    uint32_t serial; /* Counts all replies since the camera's start, from 1. */
    uint8_t flight_computer; /* The flight computer that gave the command. */
    uint8_t command; /* The command's number; 0 where a whole block was refused. */
    uint32_t counter; /* Its counter. */
    uint8_t stage; /* How far it has come. */
    uint8_t why_known; /* Whether `why` is known. */
    uint8_t why; /* Why it was rejected or failed. */
    double reply_age_s; /* Time since then. [s] */
    char words[64]; /* The reason or what came of it in words, cut where it is longer. */
} stars_command_reply_t;
STARS_ASSERT(sizeof(stars_command_reply_t) == 85, "stars_command_reply_t");
STARS_ASSERT(offsetof(stars_command_reply_t, serial) == 0, "stars_command_reply_t.serial");
STARS_ASSERT(offsetof(stars_command_reply_t, flight_computer) == 4, "stars_command_reply_t.flight_computer");
STARS_ASSERT(offsetof(stars_command_reply_t, command) == 5, "stars_command_reply_t.command");
STARS_ASSERT(offsetof(stars_command_reply_t, counter) == 6, "stars_command_reply_t.counter");
STARS_ASSERT(offsetof(stars_command_reply_t, stage) == 10, "stars_command_reply_t.stage");
STARS_ASSERT(offsetof(stars_command_reply_t, why_known) == 11, "stars_command_reply_t.why_known");
STARS_ASSERT(offsetof(stars_command_reply_t, why) == 12, "stars_command_reply_t.why");
STARS_ASSERT(offsetof(stars_command_reply_t, reply_age_s) == 13, "stars_command_reply_t.reply_age_s");
STARS_ASSERT(offsetof(stars_command_reply_t, words) == 21, "stars_command_reply_t.words");

/* One computer's clock. */
typedef struct STARS_PACKED {
    uint8_t flight_computer; /* Whose, by the `id` of its hello. */
    double offset_s; /* Its clock minus the camera's, by the soonest of its statuses of the last minute: what every status takes is in it. [s] */
    double sigma_s; /* What its statuses usually take longer than the soonest. [s] */
    double age_s; /* Age of the last of them. [s] */
} stars_peer_clock_t;
STARS_ASSERT(sizeof(stars_peer_clock_t) == 25, "stars_peer_clock_t");
STARS_ASSERT(offsetof(stars_peer_clock_t, flight_computer) == 0, "stars_peer_clock_t.flight_computer");
STARS_ASSERT(offsetof(stars_peer_clock_t, offset_s) == 1, "stars_peer_clock_t.offset_s");
STARS_ASSERT(offsetof(stars_peer_clock_t, sigma_s) == 9, "stars_peer_clock_t.sigma_s");
STARS_ASSERT(offsetof(stars_peer_clock_t, age_s) == 17, "stars_peer_clock_t.age_s");

/* Everything that the camera tells a flight computer, every 0.5 s on a steady schedule. */
typedef struct STARS_PACKED {
    uint32_t sequence; /* Counts the updates of this connection, from 0. */
    uint32_t boot_id; /* Number drawn at random at the camera's start: another one means that it started anew. */
    double uptime_s; /* Time since the camera program's start, from a clock that never jumps. [s] */
    uint8_t clock_unix_s_known; /* Whether `clock_unix_s` is known. */
    double clock_unix_s; /* UTC when this message was made, seconds since 1970. [s] */
    uint8_t clock_quality; /* How far that clock can be believed. */
    uint32_t settings_hash; /* CRC-32 of the settings in force. */
    uint8_t simulated_camera; /* Images do not come from a real camera. */
    uint8_t simulated_lens; /* The lens is not a real one. */
    uint32_t statuses_received; /* Statuses received from this flight computer on this connection. */
    uint8_t last_status_sequence_known; /* Whether `last_status_sequence` is known. */
    uint32_t last_status_sequence; /* Sequence number of the last status received on this connection. */
    uint8_t last_status_age_s_known; /* Whether `last_status_age_s` is known. */
    double last_status_age_s; /* Age of that status. [s] */
    uint32_t status_values_withheld; /* Values in this connection's statuses that were out of range and taken as not known. */
    uint8_t in_charge_id_known; /* Whether `in_charge_id` is known. */
    uint8_t in_charge_id; /* The flight computer in charge, by the `id` of its hello. */
    uint8_t in_charge_since_s_known; /* Whether `in_charge_since_s` is known. */
    double in_charge_since_s; /* Uptime of the camera at which it came to be in charge. [s] */
    uint8_t you_are_in_charge; /* Whether the receiver of this update is in charge. */
    uint8_t claims; /* How many connected flight computers claim to be in charge. */
    uint32_t commands_accepted; /* Commands accepted since the camera's start. */
    uint32_t commands_refused; /* Commands refused since the camera's start. */
    uint8_t last_refusal_known; /* Whether `last_refusal` is known. */
    uint8_t last_refusal; /* Why the last one was refused. */
    uint32_t frames_taken; /* Frames that the camera gave. */
    uint32_t frames_solved; /* Frames solved. */
    uint32_t frames_skipped; /* Frames replaced by a newer one before their turn. */
    uint32_t frames_lost; /* Frames or records that should have been kept and were not. */
    uint32_t restarts_camera; /* Times that the camera's actor was started again. */
    uint32_t restarts_solver; /* Times that the solver's actor was started again. */
    uint32_t restarts_hub; /* Times that the hub was started again. */
    uint32_t restarts_recorder; /* Times that the recorder was started again. */
    uint32_t restarts_server; /* Times that the server for flight computers, or a session in it, was started again after it broke. */
    uint32_t links_refused; /* Connections closed because of what the other end sent. */
    uint8_t solving; /* A frame is being solved. */
    uint8_t temperature_lens_c_known; /* Whether `temperature_lens_c` is known. */
    double temperature_lens_c; /* Temperature of the lens. [°C] */
    uint8_t temperature_computer_c_known; /* Whether `temperature_computer_c` is known. */
    double temperature_computer_c; /* Temperature of the computer. [°C] */
    uint8_t temperature_vessel_c_known; /* Whether `temperature_vessel_c` is known. */
    double temperature_vessel_c; /* Temperature of the vessel. [°C] */
    uint8_t temperature_plate_c_known; /* Whether `temperature_plate_c` is known. */
    double temperature_plate_c; /* Temperature of the plate. [°C] */
    uint8_t temperature_dcdc_c_known; /* Whether `temperature_dcdc_c` is known. */
    double temperature_dcdc_c; /* Temperature of the DC-DC converter. [°C] */
    uint8_t temperature_flange_c_known; /* Whether `temperature_flange_c` is known. */
    double temperature_flange_c; /* Temperature of the flange. [°C] */
    uint8_t pressure_atm_known; /* Whether `pressure_atm` is known. */
    double pressure_atm; /* Pressure in the vessel. [atm] */
    uint8_t disk_free_gib_known; /* Whether `disk_free_gib` is known. */
    double disk_free_gib; /* Free space on the disk that records go to, in units of 2^30 bytes. [GiB] */
    uint32_t next_image_counter; /* Number that the next image will receive. */
    uint8_t gain_db_known; /* Whether `gain_db` is known. */
    double gain_db; /* Gain; known only while no change of it is under way. [dB] */
    uint8_t focus_counts_known; /* Whether `focus_counts` is known. */
    int32_t focus_counts; /* Focus position, encoder counts; known only while no change of it is under way. [counts] */
    uint8_t aperture_counts_known; /* Whether `aperture_counts` is known. */
    int32_t aperture_counts; /* Aperture position, 0 is fully open; known only while no change of it is under way. [counts] */
    uint8_t image_known; /* Whether the fields that need it are known. The last image that ended in an outcome. */
    uint32_t image_counter; /* The camera's number of the image. */
    uint8_t image_trigger_counter_known; /* Whether `image_trigger_counter` is known. */
    uint32_t image_trigger_counter; /* The flight computer's number of the series of triggers that the image belongs to. */
    uint8_t exposures; /* Exposures co-added into the image. */
    uint8_t exposure_s_known; /* Whether `exposure_s` is known. */
    double exposure_s; /* Exposure time of one exposure. [s] */
    uint8_t captured_unix_s_known; /* Whether `captured_unix_s` is known. */
    double captured_unix_s; /* Middle of the exposure, UTC, seconds since 1970. [s] */
    uint8_t captured_quality_known; /* Whether `captured_quality` is known. */
    uint8_t captured_quality; /* How far the clock that stamped it could be believed. */
    uint8_t image_age_s_known; /* Whether `image_age_s` is known. */
    double image_age_s; /* Time from the capture to this update, from a clock that never jumps. [s] */
    uint8_t reason; /* How the image ended. */
    uint8_t cause_known; /* Whether `cause` is known. */
    uint8_t cause; /* What the image's own evidence says was wrong. */
    char detail[120]; /* The reason in words, cut where it is longer. */
    uint8_t mode; /* How sources were searched for. Before version 3 along a motion is told as robust. */
    uint8_t statistics_known; /* Whether the fields that need it are known. Statistics, where the image was looked at. */
    double mean_adu; /* Mean of the cells' means. [ADU] */
    double noise_adu; /* Median of the cells' standard deviations. [ADU] */
    uint8_t measured_gain_adu_per_e_known; /* Whether `measured_gain_adu_per_e` is known. */
    double measured_gain_adu_per_e; /* Gain measured from photon noise. [ADU/e-] */
    uint8_t measured_gain_db_known; /* Whether `measured_gain_db` is known. */
    double measured_gain_db; /* The same against the camera's gain at 0 dB: 20 log10(gain / ideal gain). [dB] */
    uint32_t saturated_px; /* Saturated pixels. [px] */
    double saturated_fraction; /* Saturated pixels as a fraction of the image. */
    uint8_t fwhm_px_known; /* Whether `fwhm_px` is known. */
    double fwhm_px; /* Median full width at half maximum of the better sources. [px] */
    uint8_t focus_metric_adu_known; /* Whether `focus_metric_adu` is known. */
    double focus_metric_adu; /* Peak of the brightest source, by which focus is judged. [ADU] */
    uint16_t sources_found; /* Sources found. */
    uint16_t sources_tried; /* Sources that patterns were made of. */
    uint16_t sources_matched; /* Sources matched to stars; 0 where not solved. */
    uint32_t candidates_tried; /* Candidate attitudes screened. */
    uint8_t solve_time_ms_known; /* Whether `solve_time_ms` is known. */
    double solve_time_ms; /* From pixels in memory to the outcome. [ms] */
    uint8_t equatorial_known; /* Whether the fields that need it are known. The pointing, where solved. */
    double ra_deg; /* Right ascension of the boresight, ICRS; of date where the camera's `solver.fit.precession` is switched on. [deg] */
    double dec_deg; /* Declination of the boresight, as right ascension. [deg] */
    double roll_deg; /* Position angle of the image's up direction, from North through East. [deg] */
    double sigma_east_arcsec; /* One standard deviation towards East, on the sky. [arcsec] */
    double sigma_north_arcsec; /* One standard deviation towards North. [arcsec] */
    double sigma_roll_arcsec; /* One standard deviation of the roll. [arcsec] */
    double sigma_pointing_arcsec; /* Mean of the standard deviations towards East and North. [arcsec] */
    double covariance_arcsec2[3][3]; /* Covariance, rows and columns in the order East, North, roll. [arcsec^2] */
    double platescale_arcsec_px; /* Plate scale at the centre. [arcsec/px] */
    uint8_t sigma_platescale_arcsec_px_known; /* Whether `sigma_platescale_arcsec_px` is known. */
    double sigma_platescale_arcsec_px; /* One standard deviation of the plate scale. [arcsec/px] */
    uint8_t distortion_k1_known; /* Whether `distortion_k1` is known. */
    double distortion_k1; /* Radial distortion at the half diagonal. */
    double rms_px; /* Root mean square of the residuals per axis. [px] */
    uint8_t chi2_per_dof_known; /* Whether `chi2_per_dof` is known. */
    double chi2_per_dof; /* Weighted sum of squared residuals over the degrees of freedom. */
    uint8_t false_probability_log10_known; /* Whether `false_probability_log10` is known. */
    double false_probability_log10; /* Upper bound on the probability that this pointing is false, as a power of ten. */
    uint8_t epoch_yr_known; /* Whether `epoch_yr` is known. */
    double epoch_yr; /* Julian year that the stars were moved to by proper motion. [yr] */
    uint8_t horizontal_known; /* Whether the fields that need it are known. The same pointing against the horizon, where latitude and sidereal time were known. */
    double az_deg; /* Azimuth of the boresight, from north through east. [deg] */
    double el_deg; /* Elevation of the boresight. [deg] */
    double horizontal_roll_deg; /* Angle of the image's up direction from the zenith, positive towards growing azimuth. [deg] */
    double sigma_az_arcsec; /* One standard deviation along growing azimuth, on the sky. [arcsec] */
    double sigma_el_arcsec; /* One standard deviation in elevation. [arcsec] */
    double sigma_horizontal_roll_arcsec; /* One standard deviation of the horizontal roll. [arcsec] */
    double sigma_horizontal_pointing_arcsec; /* Mean of the standard deviations along azimuth and in elevation. [arcsec] */
    double latitude_deg; /* Geodetic latitude, north positive. [deg] */
    double sidereal_time_h; /* Local apparent sidereal time. [h] */
    uint8_t equinox_yr_known; /* Whether `equinox_yr` is known. */
    double equinox_yr; /* Julian year of the equinox that sidereal time was taken to refer to; unknown where ICRS was taken as it is. [yr] */
    uint8_t prior_disagreement_deg_known; /* Whether `prior_disagreement_deg` is known. */
    double prior_disagreement_deg; /* How far the pointing lies from the prior that it disagrees with; unknown where it agrees or there was none. [deg] */
    uint8_t corrected_proper_motion; /* Stars were moved to the epoch of observation. */
    uint8_t corrected_aberration; /* The velocity of the Earth was allowed for. */
    uint8_t corrected_precession; /* Azimuth and elevation refer to the equinox of date. */
    uint8_t corrected_refraction; /* The bending of light in the air was allowed for. */
    uint8_t corrected_distortion; /* The distortion of the optics was fitted or given. */
    uint8_t sources_count; /* How many of the sources below there are. */
    stars_source_t sources[20]; /* The first sources, brightest first, solved or not. */
    uint8_t lease_epoch_known; /* Whether `lease_epoch` is known. */
    uint32_t lease_epoch; /* The lease of the flight computer in charge; it ends 3 s after the last status that renewed it. */
    uint8_t armed_command_known; /* Whether `armed_command` is known. */
    uint8_t armed_command; /* The command that may be fired now. */
    double armed_for_s; /* Time that is left for it. [s] */
    uint8_t commands_under_way; /* Commands under way. */
    uint8_t authentication_required; /* Nothing runs whose sender does not show its key. */
    uint8_t authentication_key; /* There is a key for the receiver of this update. */
    uint8_t counters_kept; /* Counters of commands are kept on disk, so that none runs again after a restart. */
    uint32_t refused[20]; /* Commands refused since the camera's start, by the codes of `last_refusal`. */
    uint16_t settings_commanded; /* Settings that commands have changed from the values of the start. */
    uint8_t replies_count; /* How many of the replies below there are. */
    stars_command_reply_t replies[32]; /* Replies that the receiver has not acknowledged, oldest first; of more than 32 the last. */
    uint8_t lens_connected; /* The controller answers. */
    uint8_t lens_moving; /* A move has begun, and its reply has not come. */
    uint8_t lens_stopped; /* Nothing moves by itself until a command moves it. */
    uint8_t focus_doubt_known; /* Whether `focus_doubt` is known. */
    uint8_t focus_doubt; /* Why the focus is not known, where it is not and does not move. */
    uint8_t aperture_doubt_known; /* Whether `aperture_doubt` is known. */
    uint8_t aperture_doubt; /* Why the aperture is not known. */
    uint8_t focus_range_known; /* Whether the fields that need it are known. Focus range that the controller has learned. */
    int32_t focus_nearest_counts; /* Nearest focus. [counts] */
    int32_t focus_furthest_counts; /* Furthest focus. [counts] */
    uint8_t lens_requests; /* Requests that are not answered to their end. */
    uint32_t lens_errors; /* What went wrong with the lens since the start. */
    char lens_last_error[64]; /* The last of it, in words. */
    uint8_t autofocus_mode; /* What it is at. */
    uint8_t autofocus_requested_counts_known; /* Whether `autofocus_requested_counts` is known. */
    int32_t autofocus_requested_counts; /* Where it sent the lens last. [counts] */
    uint8_t autofocus_run_age_s_known; /* Whether `autofocus_run_age_s` is known. */
    double autofocus_run_age_s; /* Time since its last run began. [s] */
    uint8_t autofocus_time_left_s_known; /* Whether `autofocus_time_left_s` is known. */
    double autofocus_time_left_s; /* Time for which its run may still take images. [s] */
    uint16_t autofocus_images; /* Images of this run, or of the last, that counted. */
    uint8_t autofocus_best_known; /* Whether the fields that need it are known. Best focus as this run, or the last that knew, has it. */
    double best_focus_counts; /* Position. [counts] */
    double sigma_best_focus_counts; /* One standard deviation. [counts] */
    double best_focus_drift_counts_min; /* By what it drifts. [counts/min] */
    uint8_t autofocus_ending_known; /* Whether `autofocus_ending` is known. */
    uint8_t autofocus_ending; /* How the last run ended. */
    uint8_t focus_estimate_known; /* Whether the fields that need it are known. What the stars' widths say without a move. */
    double star_width_px; /* Full width at half maximum of the stars at this position. [px] */
    double focus_distance_counts; /* Distance of the best focus. [counts] */
    double sigma_focus_distance_counts; /* One standard deviation of it. [counts] */
    uint8_t focus_distance_calibrated; /* Measured against a sweep; otherwise against the settings. */
    uint8_t star_width_px_per_hour_known; /* Whether `star_width_px_per_hour` is known. */
    double star_width_px_per_hour; /* Change of the width with time. [px/h] */
    uint8_t star_width_px_per_kelvin_known; /* Whether `star_width_px_per_kelvin` is known. */
    double star_width_px_per_kelvin; /* Change of the width with the lens's temperature. [px/K] */
    uint8_t simulated_housekeeping; /* A value of the housekeeping is made up. */
    uint8_t temperature_lens_age_s_known; /* Whether `temperature_lens_age_s` is known. */
    double temperature_lens_age_s; /* Time since the lens's temperature was read, even where the value is too old to be known. [s] */
    uint8_t temperature_computer_age_s_known; /* Whether `temperature_computer_age_s` is known. */
    double temperature_computer_age_s; /* Time since the computer's temperature was read. [s] */
    uint8_t temperature_vessel_age_s_known; /* Whether `temperature_vessel_age_s` is known. */
    double temperature_vessel_age_s; /* Time since the vessel's temperature was read. [s] */
    uint8_t temperature_plate_age_s_known; /* Whether `temperature_plate_age_s` is known. */
    double temperature_plate_age_s; /* Time since the plate's temperature was read. [s] */
    uint8_t temperature_dcdc_age_s_known; /* Whether `temperature_dcdc_age_s` is known. */
    double temperature_dcdc_age_s; /* Time since the DC-DC converter's temperature was read. [s] */
    uint8_t temperature_flange_age_s_known; /* Whether `temperature_flange_age_s` is known. */
    double temperature_flange_age_s; /* Time since the flange's temperature was read. [s] */
    uint8_t pressure_age_s_known; /* Whether `pressure_age_s` is known. */
    double pressure_age_s; /* Time since the pressure was read. [s] */
    uint8_t disk_free_age_s_known; /* Whether `disk_free_age_s` is known. */
    double disk_free_age_s; /* Time since the free space was read. [s] */
    uint8_t temperature_lens_alarm; /* The lens's temperature is known and outside its limits. */
    uint8_t temperature_computer_alarm; /* The computer's temperature is known and outside its limits. */
    uint8_t temperature_vessel_alarm; /* The vessel's temperature is known and outside its limits. */
    uint8_t temperature_plate_alarm; /* The plate's temperature is known and outside its limits. */
    uint8_t temperature_dcdc_alarm; /* The DC-DC converter's temperature is known and outside its limits. */
    uint8_t temperature_flange_alarm; /* The flange's temperature is known and outside its limits. */
    uint8_t pressure_alarm; /* The pressure is known and outside its limits. */
    uint8_t disk_free_alarm; /* The free space is known and less than its limit. */
    uint8_t disk_days_left_known; /* Whether `disk_days_left` is known. */
    double disk_days_left; /* Time until the disk is full if it goes on filling as in the last hours; unknown while it does not fill. [d] */
    uint8_t run_number_known; /* Whether `run_number` is known. */
    uint32_t run_number; /* Counts the runs of the service on this computer, from 1; unknown where nothing is kept. */
    uint8_t last_end_known; /* Whether `last_end` is known. */
    uint8_t last_end; /* How the run before this one ended. */
    uint8_t kept_at_start; /* What was found at the start of what earlier runs kept: counters of commands, commanded settings, the focus. */
    uint32_t restarts_lens; /* Times that the lens's actor was started again. */
    uint32_t restarts_ledger; /* Times that the ledger was started again. */
    uint32_t restarts_housekeeping; /* Times that the housekeeping was started again. */
    uint32_t restarts_archive; /* Times that an archive of images was started again. */
    uint8_t shed; /* What is left undone for want of time. */
    uint32_t images_kept; /* Images kept on disk since the start. */
    uint32_t images_lost; /* Images that could not be kept there. */
    uint32_t images_thinned; /* Images kept earlier that went to make room. */
    uint32_t images_disk_errors; /* Times that this disk refused an image. */
    uint32_t copies_kept; /* The same of the second disk, where there is one: images kept. */
    uint32_t copies_lost; /* Images that could not be kept there. */
    uint32_t copies_thinned; /* Images kept earlier that went to make room. */
    uint32_t copies_disk_errors; /* Times that this disk refused an image. */
    uint8_t last_restart_known; /* Whether `last_restart` is known. */
    uint8_t last_restart; /* The part of the service that was started again last. */
    char last_restart_reason[64]; /* Why it had ended, cut where it is longer; empty where nothing was started again. */
    uint8_t last_restart_age_s_known; /* Whether `last_restart_age_s` is known. */
    double last_restart_age_s; /* Time since then. [s] */
    uint8_t series_known; /* Whether the fields that need it are known. The series of exposures that the last image is made of. From version 3 on. */
    uint32_t missing_packets; /* Packets of the image that never came from the camera: where they belong its pixels are 0. */
    uint32_t missed_images; /* Images that the camera took before this one and that never came. */
    uint8_t start_known; /* Whether the fields that need it are known. The pointing at the start of the series, where the motion during it is known; that of the image is of the middle of its light. */
    double start_ra_deg; /* Right ascension of the boresight, ICRS. [deg] */
    double start_dec_deg; /* Declination of the boresight, ICRS. [deg] */
    double start_roll_deg; /* Position angle of the image's up direction, from North through East. [deg] */
    double start_sigma_east_arcsec; /* One standard deviation towards East, on the sky. [arcsec] */
    double start_sigma_north_arcsec; /* One standard deviation towards North. [arcsec] */
    double start_before_middle_s; /* From the start to the middle of the light. [s] */
    uint8_t clocks_count; /* How many of the clocks below are known. */
    stars_peer_clock_t clocks[2]; /* The clocks. */
    uint8_t exposing; /* What makes it expose now: itself, where no trigger came for so long as the camera's settings say, and until one comes. */
    uint8_t last_triggered_age_s_known; /* Whether `last_triggered_age_s` is known. */
    double last_triggered_age_s; /* Time since the last image that a trigger made; unknown where none did since the camera's start. [s] */
    uint32_t triggers_stayed_away; /* Times since the camera's start that triggers stayed away for so long. */
    uint8_t image_exposed_by_known; /* Whether `image_exposed_by` is known. */
    uint8_t image_exposed_by; /* What made the camera expose the last image. */
    uint8_t clock_sigma_s_known; /* Whether `clock_sigma_s` is known. */
    double clock_sigma_s; /* One standard deviation of the camera computer's clock. [s] */
    uint8_t captured_sigma_s_known; /* Whether `captured_sigma_s` is known. */
    double captured_sigma_s; /* One standard deviation of the middle of the last image's exposure, as UTC. [s] */
    uint8_t captured_uptime_s_known; /* Whether `captured_uptime_s` is known. */
    double captured_uptime_s; /* The same middle as uptime of the camera program, which no clock that is set changes. [s] */
} stars_update_t;
STARS_ASSERT(sizeof(stars_update_t) == 4726, "stars_update_t");
STARS_ASSERT(offsetof(stars_update_t, sequence) == 0, "stars_update_t.sequence");
STARS_ASSERT(offsetof(stars_update_t, boot_id) == 4, "stars_update_t.boot_id");
STARS_ASSERT(offsetof(stars_update_t, uptime_s) == 8, "stars_update_t.uptime_s");
STARS_ASSERT(offsetof(stars_update_t, clock_unix_s_known) == 16, "stars_update_t.clock_unix_s_known");
STARS_ASSERT(offsetof(stars_update_t, clock_unix_s) == 17, "stars_update_t.clock_unix_s");
STARS_ASSERT(offsetof(stars_update_t, clock_quality) == 25, "stars_update_t.clock_quality");
STARS_ASSERT(offsetof(stars_update_t, settings_hash) == 26, "stars_update_t.settings_hash");
STARS_ASSERT(offsetof(stars_update_t, simulated_camera) == 30, "stars_update_t.simulated_camera");
STARS_ASSERT(offsetof(stars_update_t, simulated_lens) == 31, "stars_update_t.simulated_lens");
STARS_ASSERT(offsetof(stars_update_t, statuses_received) == 32, "stars_update_t.statuses_received");
STARS_ASSERT(offsetof(stars_update_t, last_status_sequence_known) == 36, "stars_update_t.last_status_sequence_known");
STARS_ASSERT(offsetof(stars_update_t, last_status_sequence) == 37, "stars_update_t.last_status_sequence");
STARS_ASSERT(offsetof(stars_update_t, last_status_age_s_known) == 41, "stars_update_t.last_status_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, last_status_age_s) == 42, "stars_update_t.last_status_age_s");
STARS_ASSERT(offsetof(stars_update_t, status_values_withheld) == 50, "stars_update_t.status_values_withheld");
STARS_ASSERT(offsetof(stars_update_t, in_charge_id_known) == 54, "stars_update_t.in_charge_id_known");
STARS_ASSERT(offsetof(stars_update_t, in_charge_id) == 55, "stars_update_t.in_charge_id");
STARS_ASSERT(offsetof(stars_update_t, in_charge_since_s_known) == 56, "stars_update_t.in_charge_since_s_known");
STARS_ASSERT(offsetof(stars_update_t, in_charge_since_s) == 57, "stars_update_t.in_charge_since_s");
STARS_ASSERT(offsetof(stars_update_t, you_are_in_charge) == 65, "stars_update_t.you_are_in_charge");
STARS_ASSERT(offsetof(stars_update_t, claims) == 66, "stars_update_t.claims");
STARS_ASSERT(offsetof(stars_update_t, commands_accepted) == 67, "stars_update_t.commands_accepted");
STARS_ASSERT(offsetof(stars_update_t, commands_refused) == 71, "stars_update_t.commands_refused");
STARS_ASSERT(offsetof(stars_update_t, last_refusal_known) == 75, "stars_update_t.last_refusal_known");
STARS_ASSERT(offsetof(stars_update_t, last_refusal) == 76, "stars_update_t.last_refusal");
STARS_ASSERT(offsetof(stars_update_t, frames_taken) == 77, "stars_update_t.frames_taken");
STARS_ASSERT(offsetof(stars_update_t, frames_solved) == 81, "stars_update_t.frames_solved");
STARS_ASSERT(offsetof(stars_update_t, frames_skipped) == 85, "stars_update_t.frames_skipped");
STARS_ASSERT(offsetof(stars_update_t, frames_lost) == 89, "stars_update_t.frames_lost");
STARS_ASSERT(offsetof(stars_update_t, restarts_camera) == 93, "stars_update_t.restarts_camera");
STARS_ASSERT(offsetof(stars_update_t, restarts_solver) == 97, "stars_update_t.restarts_solver");
STARS_ASSERT(offsetof(stars_update_t, restarts_hub) == 101, "stars_update_t.restarts_hub");
STARS_ASSERT(offsetof(stars_update_t, restarts_recorder) == 105, "stars_update_t.restarts_recorder");
STARS_ASSERT(offsetof(stars_update_t, restarts_server) == 109, "stars_update_t.restarts_server");
STARS_ASSERT(offsetof(stars_update_t, links_refused) == 113, "stars_update_t.links_refused");
STARS_ASSERT(offsetof(stars_update_t, solving) == 117, "stars_update_t.solving");
STARS_ASSERT(offsetof(stars_update_t, temperature_lens_c_known) == 118, "stars_update_t.temperature_lens_c_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_lens_c) == 119, "stars_update_t.temperature_lens_c");
STARS_ASSERT(offsetof(stars_update_t, temperature_computer_c_known) == 127, "stars_update_t.temperature_computer_c_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_computer_c) == 128, "stars_update_t.temperature_computer_c");
STARS_ASSERT(offsetof(stars_update_t, temperature_vessel_c_known) == 136, "stars_update_t.temperature_vessel_c_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_vessel_c) == 137, "stars_update_t.temperature_vessel_c");
STARS_ASSERT(offsetof(stars_update_t, temperature_plate_c_known) == 145, "stars_update_t.temperature_plate_c_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_plate_c) == 146, "stars_update_t.temperature_plate_c");
STARS_ASSERT(offsetof(stars_update_t, temperature_dcdc_c_known) == 154, "stars_update_t.temperature_dcdc_c_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_dcdc_c) == 155, "stars_update_t.temperature_dcdc_c");
STARS_ASSERT(offsetof(stars_update_t, temperature_flange_c_known) == 163, "stars_update_t.temperature_flange_c_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_flange_c) == 164, "stars_update_t.temperature_flange_c");
STARS_ASSERT(offsetof(stars_update_t, pressure_atm_known) == 172, "stars_update_t.pressure_atm_known");
STARS_ASSERT(offsetof(stars_update_t, pressure_atm) == 173, "stars_update_t.pressure_atm");
STARS_ASSERT(offsetof(stars_update_t, disk_free_gib_known) == 181, "stars_update_t.disk_free_gib_known");
STARS_ASSERT(offsetof(stars_update_t, disk_free_gib) == 182, "stars_update_t.disk_free_gib");
STARS_ASSERT(offsetof(stars_update_t, next_image_counter) == 190, "stars_update_t.next_image_counter");
STARS_ASSERT(offsetof(stars_update_t, gain_db_known) == 194, "stars_update_t.gain_db_known");
STARS_ASSERT(offsetof(stars_update_t, gain_db) == 195, "stars_update_t.gain_db");
STARS_ASSERT(offsetof(stars_update_t, focus_counts_known) == 203, "stars_update_t.focus_counts_known");
STARS_ASSERT(offsetof(stars_update_t, focus_counts) == 204, "stars_update_t.focus_counts");
STARS_ASSERT(offsetof(stars_update_t, aperture_counts_known) == 208, "stars_update_t.aperture_counts_known");
STARS_ASSERT(offsetof(stars_update_t, aperture_counts) == 209, "stars_update_t.aperture_counts");
STARS_ASSERT(offsetof(stars_update_t, image_known) == 213, "stars_update_t.image_known");
STARS_ASSERT(offsetof(stars_update_t, image_counter) == 214, "stars_update_t.image_counter");
STARS_ASSERT(offsetof(stars_update_t, image_trigger_counter_known) == 218, "stars_update_t.image_trigger_counter_known");
STARS_ASSERT(offsetof(stars_update_t, image_trigger_counter) == 219, "stars_update_t.image_trigger_counter");
STARS_ASSERT(offsetof(stars_update_t, exposures) == 223, "stars_update_t.exposures");
STARS_ASSERT(offsetof(stars_update_t, exposure_s_known) == 224, "stars_update_t.exposure_s_known");
STARS_ASSERT(offsetof(stars_update_t, exposure_s) == 225, "stars_update_t.exposure_s");
STARS_ASSERT(offsetof(stars_update_t, captured_unix_s_known) == 233, "stars_update_t.captured_unix_s_known");
STARS_ASSERT(offsetof(stars_update_t, captured_unix_s) == 234, "stars_update_t.captured_unix_s");
STARS_ASSERT(offsetof(stars_update_t, captured_quality_known) == 242, "stars_update_t.captured_quality_known");
STARS_ASSERT(offsetof(stars_update_t, captured_quality) == 243, "stars_update_t.captured_quality");
STARS_ASSERT(offsetof(stars_update_t, image_age_s_known) == 244, "stars_update_t.image_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, image_age_s) == 245, "stars_update_t.image_age_s");
STARS_ASSERT(offsetof(stars_update_t, reason) == 253, "stars_update_t.reason");
STARS_ASSERT(offsetof(stars_update_t, cause_known) == 254, "stars_update_t.cause_known");
STARS_ASSERT(offsetof(stars_update_t, cause) == 255, "stars_update_t.cause");
STARS_ASSERT(offsetof(stars_update_t, detail) == 256, "stars_update_t.detail");
STARS_ASSERT(offsetof(stars_update_t, mode) == 376, "stars_update_t.mode");
STARS_ASSERT(offsetof(stars_update_t, statistics_known) == 377, "stars_update_t.statistics_known");
STARS_ASSERT(offsetof(stars_update_t, mean_adu) == 378, "stars_update_t.mean_adu");
STARS_ASSERT(offsetof(stars_update_t, noise_adu) == 386, "stars_update_t.noise_adu");
STARS_ASSERT(offsetof(stars_update_t, measured_gain_adu_per_e_known) == 394, "stars_update_t.measured_gain_adu_per_e_known");
STARS_ASSERT(offsetof(stars_update_t, measured_gain_adu_per_e) == 395, "stars_update_t.measured_gain_adu_per_e");
STARS_ASSERT(offsetof(stars_update_t, measured_gain_db_known) == 403, "stars_update_t.measured_gain_db_known");
STARS_ASSERT(offsetof(stars_update_t, measured_gain_db) == 404, "stars_update_t.measured_gain_db");
STARS_ASSERT(offsetof(stars_update_t, saturated_px) == 412, "stars_update_t.saturated_px");
STARS_ASSERT(offsetof(stars_update_t, saturated_fraction) == 416, "stars_update_t.saturated_fraction");
STARS_ASSERT(offsetof(stars_update_t, fwhm_px_known) == 424, "stars_update_t.fwhm_px_known");
STARS_ASSERT(offsetof(stars_update_t, fwhm_px) == 425, "stars_update_t.fwhm_px");
STARS_ASSERT(offsetof(stars_update_t, focus_metric_adu_known) == 433, "stars_update_t.focus_metric_adu_known");
STARS_ASSERT(offsetof(stars_update_t, focus_metric_adu) == 434, "stars_update_t.focus_metric_adu");
STARS_ASSERT(offsetof(stars_update_t, sources_found) == 442, "stars_update_t.sources_found");
STARS_ASSERT(offsetof(stars_update_t, sources_tried) == 444, "stars_update_t.sources_tried");
STARS_ASSERT(offsetof(stars_update_t, sources_matched) == 446, "stars_update_t.sources_matched");
STARS_ASSERT(offsetof(stars_update_t, candidates_tried) == 448, "stars_update_t.candidates_tried");
STARS_ASSERT(offsetof(stars_update_t, solve_time_ms_known) == 452, "stars_update_t.solve_time_ms_known");
STARS_ASSERT(offsetof(stars_update_t, solve_time_ms) == 453, "stars_update_t.solve_time_ms");
STARS_ASSERT(offsetof(stars_update_t, equatorial_known) == 461, "stars_update_t.equatorial_known");
STARS_ASSERT(offsetof(stars_update_t, ra_deg) == 462, "stars_update_t.ra_deg");
STARS_ASSERT(offsetof(stars_update_t, dec_deg) == 470, "stars_update_t.dec_deg");
STARS_ASSERT(offsetof(stars_update_t, roll_deg) == 478, "stars_update_t.roll_deg");
STARS_ASSERT(offsetof(stars_update_t, sigma_east_arcsec) == 486, "stars_update_t.sigma_east_arcsec");
STARS_ASSERT(offsetof(stars_update_t, sigma_north_arcsec) == 494, "stars_update_t.sigma_north_arcsec");
STARS_ASSERT(offsetof(stars_update_t, sigma_roll_arcsec) == 502, "stars_update_t.sigma_roll_arcsec");
STARS_ASSERT(offsetof(stars_update_t, sigma_pointing_arcsec) == 510, "stars_update_t.sigma_pointing_arcsec");
STARS_ASSERT(offsetof(stars_update_t, covariance_arcsec2) == 518, "stars_update_t.covariance_arcsec2");
STARS_ASSERT(offsetof(stars_update_t, platescale_arcsec_px) == 590, "stars_update_t.platescale_arcsec_px");
STARS_ASSERT(offsetof(stars_update_t, sigma_platescale_arcsec_px_known) == 598, "stars_update_t.sigma_platescale_arcsec_px_known");
STARS_ASSERT(offsetof(stars_update_t, sigma_platescale_arcsec_px) == 599, "stars_update_t.sigma_platescale_arcsec_px");
STARS_ASSERT(offsetof(stars_update_t, distortion_k1_known) == 607, "stars_update_t.distortion_k1_known");
STARS_ASSERT(offsetof(stars_update_t, distortion_k1) == 608, "stars_update_t.distortion_k1");
STARS_ASSERT(offsetof(stars_update_t, rms_px) == 616, "stars_update_t.rms_px");
STARS_ASSERT(offsetof(stars_update_t, chi2_per_dof_known) == 624, "stars_update_t.chi2_per_dof_known");
STARS_ASSERT(offsetof(stars_update_t, chi2_per_dof) == 625, "stars_update_t.chi2_per_dof");
STARS_ASSERT(offsetof(stars_update_t, false_probability_log10_known) == 633, "stars_update_t.false_probability_log10_known");
STARS_ASSERT(offsetof(stars_update_t, false_probability_log10) == 634, "stars_update_t.false_probability_log10");
STARS_ASSERT(offsetof(stars_update_t, epoch_yr_known) == 642, "stars_update_t.epoch_yr_known");
STARS_ASSERT(offsetof(stars_update_t, epoch_yr) == 643, "stars_update_t.epoch_yr");
STARS_ASSERT(offsetof(stars_update_t, horizontal_known) == 651, "stars_update_t.horizontal_known");
STARS_ASSERT(offsetof(stars_update_t, az_deg) == 652, "stars_update_t.az_deg");
STARS_ASSERT(offsetof(stars_update_t, el_deg) == 660, "stars_update_t.el_deg");
STARS_ASSERT(offsetof(stars_update_t, horizontal_roll_deg) == 668, "stars_update_t.horizontal_roll_deg");
STARS_ASSERT(offsetof(stars_update_t, sigma_az_arcsec) == 676, "stars_update_t.sigma_az_arcsec");
STARS_ASSERT(offsetof(stars_update_t, sigma_el_arcsec) == 684, "stars_update_t.sigma_el_arcsec");
STARS_ASSERT(offsetof(stars_update_t, sigma_horizontal_roll_arcsec) == 692, "stars_update_t.sigma_horizontal_roll_arcsec");
STARS_ASSERT(offsetof(stars_update_t, sigma_horizontal_pointing_arcsec) == 700, "stars_update_t.sigma_horizontal_pointing_arcsec");
STARS_ASSERT(offsetof(stars_update_t, latitude_deg) == 708, "stars_update_t.latitude_deg");
STARS_ASSERT(offsetof(stars_update_t, sidereal_time_h) == 716, "stars_update_t.sidereal_time_h");
STARS_ASSERT(offsetof(stars_update_t, equinox_yr_known) == 724, "stars_update_t.equinox_yr_known");
STARS_ASSERT(offsetof(stars_update_t, equinox_yr) == 725, "stars_update_t.equinox_yr");
STARS_ASSERT(offsetof(stars_update_t, prior_disagreement_deg_known) == 733, "stars_update_t.prior_disagreement_deg_known");
STARS_ASSERT(offsetof(stars_update_t, prior_disagreement_deg) == 734, "stars_update_t.prior_disagreement_deg");
STARS_ASSERT(offsetof(stars_update_t, corrected_proper_motion) == 742, "stars_update_t.corrected_proper_motion");
STARS_ASSERT(offsetof(stars_update_t, corrected_aberration) == 743, "stars_update_t.corrected_aberration");
STARS_ASSERT(offsetof(stars_update_t, corrected_precession) == 744, "stars_update_t.corrected_precession");
STARS_ASSERT(offsetof(stars_update_t, corrected_refraction) == 745, "stars_update_t.corrected_refraction");
STARS_ASSERT(offsetof(stars_update_t, corrected_distortion) == 746, "stars_update_t.corrected_distortion");
STARS_ASSERT(offsetof(stars_update_t, sources_count) == 747, "stars_update_t.sources_count");
STARS_ASSERT(offsetof(stars_update_t, sources) == 748, "stars_update_t.sources");
STARS_ASSERT(offsetof(stars_update_t, lease_epoch_known) == 1348, "stars_update_t.lease_epoch_known");
STARS_ASSERT(offsetof(stars_update_t, lease_epoch) == 1349, "stars_update_t.lease_epoch");
STARS_ASSERT(offsetof(stars_update_t, armed_command_known) == 1353, "stars_update_t.armed_command_known");
STARS_ASSERT(offsetof(stars_update_t, armed_command) == 1354, "stars_update_t.armed_command");
STARS_ASSERT(offsetof(stars_update_t, armed_for_s) == 1355, "stars_update_t.armed_for_s");
STARS_ASSERT(offsetof(stars_update_t, commands_under_way) == 1363, "stars_update_t.commands_under_way");
STARS_ASSERT(offsetof(stars_update_t, authentication_required) == 1364, "stars_update_t.authentication_required");
STARS_ASSERT(offsetof(stars_update_t, authentication_key) == 1365, "stars_update_t.authentication_key");
STARS_ASSERT(offsetof(stars_update_t, counters_kept) == 1366, "stars_update_t.counters_kept");
STARS_ASSERT(offsetof(stars_update_t, refused) == 1367, "stars_update_t.refused");
STARS_ASSERT(offsetof(stars_update_t, settings_commanded) == 1447, "stars_update_t.settings_commanded");
STARS_ASSERT(offsetof(stars_update_t, replies_count) == 1449, "stars_update_t.replies_count");
STARS_ASSERT(offsetof(stars_update_t, replies) == 1450, "stars_update_t.replies");
STARS_ASSERT(offsetof(stars_update_t, lens_connected) == 4170, "stars_update_t.lens_connected");
STARS_ASSERT(offsetof(stars_update_t, lens_moving) == 4171, "stars_update_t.lens_moving");
STARS_ASSERT(offsetof(stars_update_t, lens_stopped) == 4172, "stars_update_t.lens_stopped");
STARS_ASSERT(offsetof(stars_update_t, focus_doubt_known) == 4173, "stars_update_t.focus_doubt_known");
STARS_ASSERT(offsetof(stars_update_t, focus_doubt) == 4174, "stars_update_t.focus_doubt");
STARS_ASSERT(offsetof(stars_update_t, aperture_doubt_known) == 4175, "stars_update_t.aperture_doubt_known");
STARS_ASSERT(offsetof(stars_update_t, aperture_doubt) == 4176, "stars_update_t.aperture_doubt");
STARS_ASSERT(offsetof(stars_update_t, focus_range_known) == 4177, "stars_update_t.focus_range_known");
STARS_ASSERT(offsetof(stars_update_t, focus_nearest_counts) == 4178, "stars_update_t.focus_nearest_counts");
STARS_ASSERT(offsetof(stars_update_t, focus_furthest_counts) == 4182, "stars_update_t.focus_furthest_counts");
STARS_ASSERT(offsetof(stars_update_t, lens_requests) == 4186, "stars_update_t.lens_requests");
STARS_ASSERT(offsetof(stars_update_t, lens_errors) == 4187, "stars_update_t.lens_errors");
STARS_ASSERT(offsetof(stars_update_t, lens_last_error) == 4191, "stars_update_t.lens_last_error");
STARS_ASSERT(offsetof(stars_update_t, autofocus_mode) == 4255, "stars_update_t.autofocus_mode");
STARS_ASSERT(offsetof(stars_update_t, autofocus_requested_counts_known) == 4256, "stars_update_t.autofocus_requested_counts_known");
STARS_ASSERT(offsetof(stars_update_t, autofocus_requested_counts) == 4257, "stars_update_t.autofocus_requested_counts");
STARS_ASSERT(offsetof(stars_update_t, autofocus_run_age_s_known) == 4261, "stars_update_t.autofocus_run_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, autofocus_run_age_s) == 4262, "stars_update_t.autofocus_run_age_s");
STARS_ASSERT(offsetof(stars_update_t, autofocus_time_left_s_known) == 4270, "stars_update_t.autofocus_time_left_s_known");
STARS_ASSERT(offsetof(stars_update_t, autofocus_time_left_s) == 4271, "stars_update_t.autofocus_time_left_s");
STARS_ASSERT(offsetof(stars_update_t, autofocus_images) == 4279, "stars_update_t.autofocus_images");
STARS_ASSERT(offsetof(stars_update_t, autofocus_best_known) == 4281, "stars_update_t.autofocus_best_known");
STARS_ASSERT(offsetof(stars_update_t, best_focus_counts) == 4282, "stars_update_t.best_focus_counts");
STARS_ASSERT(offsetof(stars_update_t, sigma_best_focus_counts) == 4290, "stars_update_t.sigma_best_focus_counts");
STARS_ASSERT(offsetof(stars_update_t, best_focus_drift_counts_min) == 4298, "stars_update_t.best_focus_drift_counts_min");
STARS_ASSERT(offsetof(stars_update_t, autofocus_ending_known) == 4306, "stars_update_t.autofocus_ending_known");
STARS_ASSERT(offsetof(stars_update_t, autofocus_ending) == 4307, "stars_update_t.autofocus_ending");
STARS_ASSERT(offsetof(stars_update_t, focus_estimate_known) == 4308, "stars_update_t.focus_estimate_known");
STARS_ASSERT(offsetof(stars_update_t, star_width_px) == 4309, "stars_update_t.star_width_px");
STARS_ASSERT(offsetof(stars_update_t, focus_distance_counts) == 4317, "stars_update_t.focus_distance_counts");
STARS_ASSERT(offsetof(stars_update_t, sigma_focus_distance_counts) == 4325, "stars_update_t.sigma_focus_distance_counts");
STARS_ASSERT(offsetof(stars_update_t, focus_distance_calibrated) == 4333, "stars_update_t.focus_distance_calibrated");
STARS_ASSERT(offsetof(stars_update_t, star_width_px_per_hour_known) == 4334, "stars_update_t.star_width_px_per_hour_known");
STARS_ASSERT(offsetof(stars_update_t, star_width_px_per_hour) == 4335, "stars_update_t.star_width_px_per_hour");
STARS_ASSERT(offsetof(stars_update_t, star_width_px_per_kelvin_known) == 4343, "stars_update_t.star_width_px_per_kelvin_known");
STARS_ASSERT(offsetof(stars_update_t, star_width_px_per_kelvin) == 4344, "stars_update_t.star_width_px_per_kelvin");
STARS_ASSERT(offsetof(stars_update_t, simulated_housekeeping) == 4352, "stars_update_t.simulated_housekeeping");
STARS_ASSERT(offsetof(stars_update_t, temperature_lens_age_s_known) == 4353, "stars_update_t.temperature_lens_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_lens_age_s) == 4354, "stars_update_t.temperature_lens_age_s");
STARS_ASSERT(offsetof(stars_update_t, temperature_computer_age_s_known) == 4362, "stars_update_t.temperature_computer_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_computer_age_s) == 4363, "stars_update_t.temperature_computer_age_s");
STARS_ASSERT(offsetof(stars_update_t, temperature_vessel_age_s_known) == 4371, "stars_update_t.temperature_vessel_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_vessel_age_s) == 4372, "stars_update_t.temperature_vessel_age_s");
STARS_ASSERT(offsetof(stars_update_t, temperature_plate_age_s_known) == 4380, "stars_update_t.temperature_plate_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_plate_age_s) == 4381, "stars_update_t.temperature_plate_age_s");
STARS_ASSERT(offsetof(stars_update_t, temperature_dcdc_age_s_known) == 4389, "stars_update_t.temperature_dcdc_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_dcdc_age_s) == 4390, "stars_update_t.temperature_dcdc_age_s");
STARS_ASSERT(offsetof(stars_update_t, temperature_flange_age_s_known) == 4398, "stars_update_t.temperature_flange_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, temperature_flange_age_s) == 4399, "stars_update_t.temperature_flange_age_s");
STARS_ASSERT(offsetof(stars_update_t, pressure_age_s_known) == 4407, "stars_update_t.pressure_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, pressure_age_s) == 4408, "stars_update_t.pressure_age_s");
STARS_ASSERT(offsetof(stars_update_t, disk_free_age_s_known) == 4416, "stars_update_t.disk_free_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, disk_free_age_s) == 4417, "stars_update_t.disk_free_age_s");
STARS_ASSERT(offsetof(stars_update_t, temperature_lens_alarm) == 4425, "stars_update_t.temperature_lens_alarm");
STARS_ASSERT(offsetof(stars_update_t, temperature_computer_alarm) == 4426, "stars_update_t.temperature_computer_alarm");
STARS_ASSERT(offsetof(stars_update_t, temperature_vessel_alarm) == 4427, "stars_update_t.temperature_vessel_alarm");
STARS_ASSERT(offsetof(stars_update_t, temperature_plate_alarm) == 4428, "stars_update_t.temperature_plate_alarm");
STARS_ASSERT(offsetof(stars_update_t, temperature_dcdc_alarm) == 4429, "stars_update_t.temperature_dcdc_alarm");
STARS_ASSERT(offsetof(stars_update_t, temperature_flange_alarm) == 4430, "stars_update_t.temperature_flange_alarm");
STARS_ASSERT(offsetof(stars_update_t, pressure_alarm) == 4431, "stars_update_t.pressure_alarm");
STARS_ASSERT(offsetof(stars_update_t, disk_free_alarm) == 4432, "stars_update_t.disk_free_alarm");
STARS_ASSERT(offsetof(stars_update_t, disk_days_left_known) == 4433, "stars_update_t.disk_days_left_known");
STARS_ASSERT(offsetof(stars_update_t, disk_days_left) == 4434, "stars_update_t.disk_days_left");
STARS_ASSERT(offsetof(stars_update_t, run_number_known) == 4442, "stars_update_t.run_number_known");
STARS_ASSERT(offsetof(stars_update_t, run_number) == 4443, "stars_update_t.run_number");
STARS_ASSERT(offsetof(stars_update_t, last_end_known) == 4447, "stars_update_t.last_end_known");
STARS_ASSERT(offsetof(stars_update_t, last_end) == 4448, "stars_update_t.last_end");
STARS_ASSERT(offsetof(stars_update_t, kept_at_start) == 4449, "stars_update_t.kept_at_start");
STARS_ASSERT(offsetof(stars_update_t, restarts_lens) == 4450, "stars_update_t.restarts_lens");
STARS_ASSERT(offsetof(stars_update_t, restarts_ledger) == 4454, "stars_update_t.restarts_ledger");
STARS_ASSERT(offsetof(stars_update_t, restarts_housekeeping) == 4458, "stars_update_t.restarts_housekeeping");
STARS_ASSERT(offsetof(stars_update_t, restarts_archive) == 4462, "stars_update_t.restarts_archive");
STARS_ASSERT(offsetof(stars_update_t, shed) == 4466, "stars_update_t.shed");
STARS_ASSERT(offsetof(stars_update_t, images_kept) == 4467, "stars_update_t.images_kept");
STARS_ASSERT(offsetof(stars_update_t, images_lost) == 4471, "stars_update_t.images_lost");
STARS_ASSERT(offsetof(stars_update_t, images_thinned) == 4475, "stars_update_t.images_thinned");
STARS_ASSERT(offsetof(stars_update_t, images_disk_errors) == 4479, "stars_update_t.images_disk_errors");
STARS_ASSERT(offsetof(stars_update_t, copies_kept) == 4483, "stars_update_t.copies_kept");
STARS_ASSERT(offsetof(stars_update_t, copies_lost) == 4487, "stars_update_t.copies_lost");
STARS_ASSERT(offsetof(stars_update_t, copies_thinned) == 4491, "stars_update_t.copies_thinned");
STARS_ASSERT(offsetof(stars_update_t, copies_disk_errors) == 4495, "stars_update_t.copies_disk_errors");
STARS_ASSERT(offsetof(stars_update_t, last_restart_known) == 4499, "stars_update_t.last_restart_known");
STARS_ASSERT(offsetof(stars_update_t, last_restart) == 4500, "stars_update_t.last_restart");
STARS_ASSERT(offsetof(stars_update_t, last_restart_reason) == 4501, "stars_update_t.last_restart_reason");
STARS_ASSERT(offsetof(stars_update_t, last_restart_age_s_known) == 4565, "stars_update_t.last_restart_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, last_restart_age_s) == 4566, "stars_update_t.last_restart_age_s");
STARS_ASSERT(offsetof(stars_update_t, series_known) == 4574, "stars_update_t.series_known");
STARS_ASSERT(offsetof(stars_update_t, missing_packets) == 4575, "stars_update_t.missing_packets");
STARS_ASSERT(offsetof(stars_update_t, missed_images) == 4579, "stars_update_t.missed_images");
STARS_ASSERT(offsetof(stars_update_t, start_known) == 4583, "stars_update_t.start_known");
STARS_ASSERT(offsetof(stars_update_t, start_ra_deg) == 4584, "stars_update_t.start_ra_deg");
STARS_ASSERT(offsetof(stars_update_t, start_dec_deg) == 4592, "stars_update_t.start_dec_deg");
STARS_ASSERT(offsetof(stars_update_t, start_roll_deg) == 4600, "stars_update_t.start_roll_deg");
STARS_ASSERT(offsetof(stars_update_t, start_sigma_east_arcsec) == 4608, "stars_update_t.start_sigma_east_arcsec");
STARS_ASSERT(offsetof(stars_update_t, start_sigma_north_arcsec) == 4616, "stars_update_t.start_sigma_north_arcsec");
STARS_ASSERT(offsetof(stars_update_t, start_before_middle_s) == 4624, "stars_update_t.start_before_middle_s");
STARS_ASSERT(offsetof(stars_update_t, clocks_count) == 4632, "stars_update_t.clocks_count");
STARS_ASSERT(offsetof(stars_update_t, clocks) == 4633, "stars_update_t.clocks");
STARS_ASSERT(offsetof(stars_update_t, exposing) == 4683, "stars_update_t.exposing");
STARS_ASSERT(offsetof(stars_update_t, last_triggered_age_s_known) == 4684, "stars_update_t.last_triggered_age_s_known");
STARS_ASSERT(offsetof(stars_update_t, last_triggered_age_s) == 4685, "stars_update_t.last_triggered_age_s");
STARS_ASSERT(offsetof(stars_update_t, triggers_stayed_away) == 4693, "stars_update_t.triggers_stayed_away");
STARS_ASSERT(offsetof(stars_update_t, image_exposed_by_known) == 4697, "stars_update_t.image_exposed_by_known");
STARS_ASSERT(offsetof(stars_update_t, image_exposed_by) == 4698, "stars_update_t.image_exposed_by");
STARS_ASSERT(offsetof(stars_update_t, clock_sigma_s_known) == 4699, "stars_update_t.clock_sigma_s_known");
STARS_ASSERT(offsetof(stars_update_t, clock_sigma_s) == 4700, "stars_update_t.clock_sigma_s");
STARS_ASSERT(offsetof(stars_update_t, captured_sigma_s_known) == 4708, "stars_update_t.captured_sigma_s_known");
STARS_ASSERT(offsetof(stars_update_t, captured_sigma_s) == 4709, "stars_update_t.captured_sigma_s");
STARS_ASSERT(offsetof(stars_update_t, captured_uptime_s_known) == 4717, "stars_update_t.captured_uptime_s_known");
STARS_ASSERT(offsetof(stars_update_t, captured_uptime_s) == 4718, "stars_update_t.captured_uptime_s");

/* One exposure of a series. */
typedef struct STARS_PACKED {
    float start_s; /* Start after the first sample. [s] */
    float duration_s; /* Length. [s] */
} stars_exposure_t;
STARS_ASSERT(sizeof(stars_exposure_t) == 8, "stars_exposure_t");
STARS_ASSERT(offsetof(stars_exposure_t, start_s) == 0, "stars_exposure_t.start_s");
STARS_ASSERT(offsetof(stars_exposure_t, duration_s) == 4, "stars_exposure_t.duration_s");

/* One gyro sample. */
typedef struct STARS_PACKED {
    float az_rate_deg_s; /* Rate in azimuth about the vertical, growing from north through east; not the rate on the sky, which is smaller by cos(elevation). [deg/s] */
    float el_rate_deg_s; /* Rate in elevation, upwards. [deg/s] */
} stars_rates_t;
STARS_ASSERT(sizeof(stars_rates_t) == 8, "stars_rates_t");
STARS_ASSERT(offsetof(stars_rates_t, az_rate_deg_s) == 0, "stars_rates_t.az_rate_deg_s");
STARS_ASSERT(offsetof(stars_rates_t, el_rate_deg_s) == 4, "stars_rates_t.el_rate_deg_s");

/* Gyro rates over one series of exposures, flight computer to camera, once after each series. */
typedef struct STARS_PACKED {
    uint32_t trigger_counter; /* The series of triggers, as the flight computer counts them. */
    uint32_t image_counter; /* The image that the series makes, as the camera counts them. */
    double start_uptime_s; /* First sample, on the sender's own clock (`uptime_s` of its status). [s] */
    double sample_rate_hz; /* Samples per second. [Hz] */
    uint8_t elevation_deg_known; /* Whether `elevation_deg` is known. */
    double elevation_deg; /* Elevation of the boresight during the series. [deg] */
    uint8_t exposures_count; /* How many of the exposures below there were. */
    stars_exposure_t exposures[16]; /* The exposures of the series. */
    uint16_t samples_count; /* How many of the samples below there are. */
    stars_rates_t samples[2048]; /* The samples, evenly spaced from the first. */
} stars_gyro_t;
STARS_ASSERT(sizeof(stars_gyro_t) == 16548, "stars_gyro_t");
STARS_ASSERT(offsetof(stars_gyro_t, trigger_counter) == 0, "stars_gyro_t.trigger_counter");
STARS_ASSERT(offsetof(stars_gyro_t, image_counter) == 4, "stars_gyro_t.image_counter");
STARS_ASSERT(offsetof(stars_gyro_t, start_uptime_s) == 8, "stars_gyro_t.start_uptime_s");
STARS_ASSERT(offsetof(stars_gyro_t, sample_rate_hz) == 16, "stars_gyro_t.sample_rate_hz");
STARS_ASSERT(offsetof(stars_gyro_t, elevation_deg_known) == 24, "stars_gyro_t.elevation_deg_known");
STARS_ASSERT(offsetof(stars_gyro_t, elevation_deg) == 25, "stars_gyro_t.elevation_deg");
STARS_ASSERT(offsetof(stars_gyro_t, exposures_count) == 33, "stars_gyro_t.exposures_count");
STARS_ASSERT(offsetof(stars_gyro_t, exposures) == 34, "stars_gyro_t.exposures");
STARS_ASSERT(offsetof(stars_gyro_t, samples_count) == 162, "stars_gyro_t.samples_count");
STARS_ASSERT(offsetof(stars_gyro_t, samples) == 164, "stars_gyro_t.samples");

/* A command. */
typedef struct STARS_PACKED {
    uint8_t command; /* Its number in the table of commands. */
    uint8_t act; /* 1 run, 2 arm, 3 fire. */
    uint32_t counter; /* Counts the sender's commands of this number since its boot, from 1. */
    double age_s; /* Time since the ground gave it, from a clock that never jumps. [s] */
    double values[8]; /* Its values in the order of the table, zeros after them. */
    uint32_t seal; /* CRC-32 (IEEE) over command, act, counter and values as they stand here, made when the ground gave the command and kept beside it: it shows that none of them changed alone. */
} stars_command_slot_t;
STARS_ASSERT(sizeof(stars_command_slot_t) == 82, "stars_command_slot_t");
STARS_ASSERT(offsetof(stars_command_slot_t, command) == 0, "stars_command_slot_t.command");
STARS_ASSERT(offsetof(stars_command_slot_t, act) == 1, "stars_command_slot_t.act");
STARS_ASSERT(offsetof(stars_command_slot_t, counter) == 2, "stars_command_slot_t.counter");
STARS_ASSERT(offsetof(stars_command_slot_t, age_s) == 6, "stars_command_slot_t.age_s");
STARS_ASSERT(offsetof(stars_command_slot_t, values) == 14, "stars_command_slot_t.values");
STARS_ASSERT(offsetof(stars_command_slot_t, seal) == 78, "stars_command_slot_t.seal");

/* The commands that the sender was given of late, to the camera after each status for as long as one of them matters: a command stands in a block until its last reply has come, 15 s at most. */
typedef struct STARS_PACKED {
    uint32_t sequence; /* Counts the sender's blocks of this connection, from 0. */
    uint32_t boot_id; /* The sender's boot, as in its hello. */
    uint32_t camera_boot_id; /* The camera's boot, as in its hello. */
    uint32_t lease_epoch; /* The lease that the sender holds, as the last update says. */
    uint8_t last_update_sequence_known; /* Whether `last_update_sequence` is known. */
    uint32_t last_update_sequence; /* Sequence number of the last update received: it shows how long this block can have been on its way. */
    uint32_t acknowledged; /* Replies up to this serial number have been received, and need not be repeated; 0: none. */
    uint8_t slots_count; /* How many of the commands below there are, at most 8. */
    stars_command_slot_t slots[8]; /* The commands. */
    uint8_t tag_known; /* Whether `tag` is known. */
    uint8_t tag[32]; /* HMAC-SHA-256 (RFC 2104) over all bytes of the body before this field's flag, with the sender's key. */
} stars_commands_t;
STARS_ASSERT(sizeof(stars_commands_t) == 715, "stars_commands_t");
STARS_ASSERT(offsetof(stars_commands_t, sequence) == 0, "stars_commands_t.sequence");
STARS_ASSERT(offsetof(stars_commands_t, boot_id) == 4, "stars_commands_t.boot_id");
STARS_ASSERT(offsetof(stars_commands_t, camera_boot_id) == 8, "stars_commands_t.camera_boot_id");
STARS_ASSERT(offsetof(stars_commands_t, lease_epoch) == 12, "stars_commands_t.lease_epoch");
STARS_ASSERT(offsetof(stars_commands_t, last_update_sequence_known) == 16, "stars_commands_t.last_update_sequence_known");
STARS_ASSERT(offsetof(stars_commands_t, last_update_sequence) == 17, "stars_commands_t.last_update_sequence");
STARS_ASSERT(offsetof(stars_commands_t, acknowledged) == 21, "stars_commands_t.acknowledged");
STARS_ASSERT(offsetof(stars_commands_t, slots_count) == 25, "stars_commands_t.slots_count");
STARS_ASSERT(offsetof(stars_commands_t, slots) == 26, "stars_commands_t.slots");
STARS_ASSERT(offsetof(stars_commands_t, tag_known) == 682, "stars_commands_t.tag_known");
STARS_ASSERT(offsetof(stars_commands_t, tag) == 683, "stars_commands_t.tag");

/* Asks for a piece of an image, flight computer to camera. It has one answer, a chunk or a refusal; a request that comes before the answer to the one before takes its place. */
typedef struct STARS_PACKED {
    uint32_t request; /* Any number; the answer repeats it. */
    uint8_t wanted; /* Which image. */
    uint8_t camera_boot_id_known; /* Whether `camera_boot_id` is known. */
    uint32_t camera_boot_id; /* The start of the camera that numbered the image; where it is not known, the present one. */
    uint8_t image_counter_known; /* Whether `image_counter` is known. */
    uint32_t image_counter; /* The image, by the camera's number. Of `next`: the last one that the sender has; where it is not known, all that are kept by now. */
    uint8_t exposure; /* Place of the exposure in its series, 0 for an image that stands alone. Of `next`: that of the last one. */
    uint8_t form; /* In which form. */
    uint32_t offset; /* First byte that is wanted. [bytes] */
    uint8_t begun_crc32_known; /* Whether `begun_crc32` is known. */
    uint32_t begun_crc32; /* `file_crc32` of the chunks before, so that what goes on is the same file. */
    uint32_t rate_bytes_s; /* Most bytes of image in a second; the camera's own limit (`images.rate_bytes_s`) holds too. [bytes/s] */
} stars_image_request_t;
STARS_ASSERT(sizeof(stars_image_request_t) == 30, "stars_image_request_t");
STARS_ASSERT(offsetof(stars_image_request_t, request) == 0, "stars_image_request_t.request");
STARS_ASSERT(offsetof(stars_image_request_t, wanted) == 4, "stars_image_request_t.wanted");
STARS_ASSERT(offsetof(stars_image_request_t, camera_boot_id_known) == 5, "stars_image_request_t.camera_boot_id_known");
STARS_ASSERT(offsetof(stars_image_request_t, camera_boot_id) == 6, "stars_image_request_t.camera_boot_id");
STARS_ASSERT(offsetof(stars_image_request_t, image_counter_known) == 10, "stars_image_request_t.image_counter_known");
STARS_ASSERT(offsetof(stars_image_request_t, image_counter) == 11, "stars_image_request_t.image_counter");
STARS_ASSERT(offsetof(stars_image_request_t, exposure) == 15, "stars_image_request_t.exposure");
STARS_ASSERT(offsetof(stars_image_request_t, form) == 16, "stars_image_request_t.form");
STARS_ASSERT(offsetof(stars_image_request_t, offset) == 17, "stars_image_request_t.offset");
STARS_ASSERT(offsetof(stars_image_request_t, begun_crc32_known) == 21, "stars_image_request_t.begun_crc32_known");
STARS_ASSERT(offsetof(stars_image_request_t, begun_crc32) == 22, "stars_image_request_t.begun_crc32");
STARS_ASSERT(offsetof(stars_image_request_t, rate_bytes_s) == 26, "stars_image_request_t.rate_bytes_s");

/* A piece of an image, camera to flight computer. */
typedef struct STARS_PACKED {
    uint32_t request; /* Number of the request that it answers. */
    uint32_t camera_boot_id; /* The start of the camera that numbered the image. */
    uint32_t image_counter; /* The image. */
    uint8_t exposure; /* Place of the exposure in its series. */
    uint8_t exposures; /* How many exposures of the image are on disk. */
    uint8_t form; /* In which form. */
    uint32_t total_bytes; /* Bytes of the whole. [bytes] */
    uint32_t file_crc32; /* CRC-32 of the whole (IEEE, as zlib's). */
    uint32_t offset; /* Place of the first byte below in the whole. [bytes] */
    uint16_t bytes_count; /* How many of the bytes below there are. */
    uint8_t bytes[2048]; /* The bytes. */
} stars_image_chunk_t;
STARS_ASSERT(sizeof(stars_image_chunk_t) == 2077, "stars_image_chunk_t");
STARS_ASSERT(offsetof(stars_image_chunk_t, request) == 0, "stars_image_chunk_t.request");
STARS_ASSERT(offsetof(stars_image_chunk_t, camera_boot_id) == 4, "stars_image_chunk_t.camera_boot_id");
STARS_ASSERT(offsetof(stars_image_chunk_t, image_counter) == 8, "stars_image_chunk_t.image_counter");
STARS_ASSERT(offsetof(stars_image_chunk_t, exposure) == 12, "stars_image_chunk_t.exposure");
STARS_ASSERT(offsetof(stars_image_chunk_t, exposures) == 13, "stars_image_chunk_t.exposures");
STARS_ASSERT(offsetof(stars_image_chunk_t, form) == 14, "stars_image_chunk_t.form");
STARS_ASSERT(offsetof(stars_image_chunk_t, total_bytes) == 15, "stars_image_chunk_t.total_bytes");
STARS_ASSERT(offsetof(stars_image_chunk_t, file_crc32) == 19, "stars_image_chunk_t.file_crc32");
STARS_ASSERT(offsetof(stars_image_chunk_t, offset) == 23, "stars_image_chunk_t.offset");
STARS_ASSERT(offsetof(stars_image_chunk_t, bytes_count) == 27, "stars_image_chunk_t.bytes_count");
STARS_ASSERT(offsetof(stars_image_chunk_t, bytes) == 29, "stars_image_chunk_t.bytes");

/* Why a request for an image is not met, camera to flight computer. */
typedef struct STARS_PACKED {
    uint32_t request; /* Number of the request that it answers. */
    uint8_t no_image; /* Why. */
    char words[96]; /* The reason in words. */
} stars_image_refusal_t;
STARS_ASSERT(sizeof(stars_image_refusal_t) == 101, "stars_image_refusal_t");
STARS_ASSERT(offsetof(stars_image_refusal_t, request) == 0, "stars_image_refusal_t.request");
STARS_ASSERT(offsetof(stars_image_refusal_t, no_image) == 4, "stars_image_refusal_t.no_image");
STARS_ASSERT(offsetof(stars_image_refusal_t, words) == 5, "stars_image_refusal_t.words");

/* A whole frame inside a buffer. */
typedef struct {
    uint8_t kind;
    uint8_t version;
    const uint8_t *body;
    size_t body_size;
} stars_frame_t;

/* CRC-32 of IEEE 802.3, as in zlib. Begin with `crc` 0; give the result again to go on. */
static inline uint32_t stars_crc32(uint32_t crc, const uint8_t *bytes, size_t size)
{
    crc = ~crc;
    for (size_t i = 0; i < size; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (UINT32_C(0xEDB88320) & (0u - (crc & 1u)));
    }
    return ~crc;
}

static inline uint32_t stars_u32(const uint8_t *bytes)
{
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

static inline void stars_put_u32(uint8_t *bytes, uint32_t value)
{
    for (int i = 0; i < 4; i++)
        bytes[i] = (uint8_t)(value >> (8 * i));
}

/* Takes the first frame of a buffer. Gives the number of bytes that are done with (throw them away): more than 0 with
 * `frame->body` set where there was a whole frame, with `frame->body` NULL where bytes were skipped; 0 where more bytes
 * are needed; -1 where a frame is broken (close the connection and connect again). */
static inline long stars_take_frame(const uint8_t *bytes, size_t size, stars_frame_t *frame)
{
    frame->body = NULL;
    size_t start = 0;
    while (start + 4 <= size && stars_u32(bytes + start) != STARS_SYNC)
        start++;
    if (start > 0 || size < 8)
        return (long)start;
    uint32_t length = stars_u32(bytes + 4);
    if (length < 6 || length > STARS_MAX_FRAME - 8)
        return -1;
    if (size < 8 + (size_t)length)
        return 0;
    if (stars_crc32(0, bytes + 8, length - 4) != stars_u32(bytes + 4 + length))
        return -1;
    frame->kind = bytes[8];
    frame->version = bytes[9];
    frame->body = bytes + 10;
    frame->body_size = length - 6;
    return (long)length + 8;
}

/* Puts a frame around a body; gives its size, or 0 where it does not fit. */
static inline size_t stars_put_frame(uint8_t *out, size_t room, uint8_t kind, const void *body, size_t body_size)
{
    size_t size = body_size + 14;
    if (size > room || size > STARS_MAX_FRAME)
        return 0;
    stars_put_u32(out, STARS_SYNC);
    stars_put_u32(out + 4, (uint32_t)(size - 8));
    out[8] = kind;
    out[9] = STARS_VERSION_CURRENT;
    for (size_t i = 0; i < body_size; i++)
        out[10 + i] = ((const uint8_t *)body)[i];
    stars_put_u32(out + size - 4, stars_crc32(0, out + 8, body_size + 2));
    return size;
}

/* A command for a block, with its seal: make it once, when the ground gives it, and keep it; only `age_s` changes from block to
 * block. `counter` counts the commands of this code since your boot, from 1; `values` in the order of the table of commands, zeros
 * after them. */
static inline stars_command_slot_t stars_command(int code, int act, uint32_t counter, const double values[8])
{
    stars_command_slot_t slot = {0};
    slot.command = (uint8_t)code;
    slot.act = (uint8_t)act;
    slot.counter = counter;
    for (int i = 0; i < 8; i++)
        slot.values[i] = values[i];
    const uint8_t *bytes = (const uint8_t *)&slot;
    uint32_t seal = stars_crc32(0, bytes, offsetof(stars_command_slot_t, age_s));
    slot.seal = stars_crc32(seal, bytes + offsetof(stars_command_slot_t, values), sizeof slot.values);
    return slot;
}

#endif
