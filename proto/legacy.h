/* The legacy dialect of the star camera: the packed structs of protocol version 3, as a flight program of old sends and reads them.
 *
 * Little-endian, 4-byte packing. A connection has no frames: one struct after the other, whole. The camera writes the first answer
 * 250 ms after it took the connection and then one every 500 ms; a flight computer sends a block every 0.5 s. What the dialect
 * can't express, and what the camera does with it, is in ICD.md. Needs C11. */
#ifndef STARS_LEGACY_H
#define STARS_LEGACY_H

#include <stddef.h>
#include <stdint.h>

#define LEGACY_VERSION 3
#define LEGACY_COMMANDS 34
#define LEGACY_CHANNELS 44
#define LEGACY_BLOBS 20
#define LEGACY_TIMESTEPS 156
#define LEGACY_ASSERT(holds, what) _Static_assert(holds, what)

/* Places of the commands in `command_admins`. */
enum {
    LEGACY_QUIT = 0,
    LEGACY_SHUTDOWN = 1,
    LEGACY_NETWORK_RESET = 2,
    LEGACY_MAIN_SETTINGS = 3,
    LEGACY_DISPLAY_ZOOM = 4,
    LEGACY_IMAGE_CLIENT = 5,
    LEGACY_MULTI_TRIGGERING = 6,
    LEGACY_MOTION_PSF = 7,
    LEGACY_FLUSH_BIRGER = 8,
    LEGACY_INIT_FOCUS = 9,
    LEGACY_GET_FOCUS = 10,
    LEGACY_SET_FOCUS = 11,
    LEGACY_SET_FOCUS_INCREMENTAL = 12,
    LEGACY_RUN_AUTOFOCUS = 13,
    LEGACY_SET_AUTOFOCUS_RANGE = 14,
    LEGACY_ABORT_AUTOFOCUS = 15,
    LEGACY_AUTOFOCUS_DISPLAY_MODE = 16,
    LEGACY_INIT_APERTURE = 17,
    LEGACY_GET_APERTURE = 18,
    LEGACY_SET_APERTURE = 19,
    LEGACY_GET_GAIN = 20,
    LEGACY_SET_GAIN = 21,
    LEGACY_BRIGHTNESS = 22,
    LEGACY_SOLVER_GENERAL = 23,
    LEGACY_SOLVER_ABORT = 24,
    LEGACY_SOLVER_MASK = 25,
    LEGACY_SOLVER_BLOB_FINDER = 26,
    LEGACY_SOLVER_BLOB_CELLS = 27,
    LEGACY_SOLVER_PATTERN_MATCHER = 28,
    LEGACY_SOLVER_FILTER_HOR_LOCATION = 29,
    LEGACY_SOLVER_FILTER_HOR_ROLL = 30,
    LEGACY_SOLVER_FILTER_HOR_EL = 31,
    LEGACY_SOLVER_FILTER_EQ_LOCATION = 32,
    LEGACY_SOLVER_FILTER_MATCHING = 33,
};

/* Places of the variables in `channels`, with the member of the union that each is. */
enum {
    LEGACY_CTR_STARS = 0, /* i */
    LEGACY_STARS_RUN_TIME = 1, /* i */
    LEGACY_HK_TEMP_LENS = 2, /* d */
    LEGACY_HK_TEMP_COMP = 3, /* d */
    LEGACY_HK_TEMP_VESSEL = 4, /* d */
    LEGACY_HK_TEMP_PLATE = 5, /* d */
    LEGACY_HK_TEMP_DCDC = 6, /* d */
    LEGACY_HK_TEMP_FLANGE = 7, /* d */
    LEGACY_HK_PRESSURE = 8, /* d */
    LEGACY_HK_DISK = 9, /* d */
    LEGACY_CAM_GAIN_VALID = 10, /* b */
    LEGACY_CAM_GAIN_DB = 11, /* d */
    LEGACY_LENS_FOCUS = 12, /* i */
    LEGACY_LENS_APERTURE = 13, /* i */
    LEGACY_IMAGE_CTR_STARS = 14, /* i */
    LEGACY_IMAGE_CTR_FCP = 15, /* i */
    LEGACY_IMAGE_NUM_EXPOSURES = 16, /* i */
    LEGACY_IMAGE_STATS_MEAN = 17, /* d */
    LEGACY_IMAGE_STATS_NOISE = 18, /* d */
    LEGACY_IMAGE_STATS_GAINDB = 19, /* d */
    LEGACY_IMAGE_STATS_NUM_PX_SAT = 20, /* i */
    LEGACY_IMAGE_STATS_FRAC_PX_SAT = 21, /* d */
    LEGACY_IMAGE_AFOCUS_METRIC_VALID = 22, /* b */
    LEGACY_IMAGE_AFOCUS_METRIC = 23, /* d */
    LEGACY_IMAGE_EQ_VALID = 24, /* b */
    LEGACY_IMAGE_EQ_RA = 25, /* d */
    LEGACY_IMAGE_EQ_DEC = 26, /* d */
    LEGACY_IMAGE_EQ_ROLL = 27, /* d */
    LEGACY_IMAGE_EQ_SIGMA_RA = 28, /* d */
    LEGACY_IMAGE_EQ_SIGMA_DEC = 29, /* d */
    LEGACY_IMAGE_EQ_SIGMA_ROLL = 30, /* d */
    LEGACY_IMAGE_EQ_SIGMA_POINTING = 31, /* d */
    LEGACY_IMAGE_EQ_IPLATE = 32, /* d */
    LEGACY_IMAGE_HOR_VALID = 33, /* b */
    LEGACY_IMAGE_HOR_AZ = 34, /* d */
    LEGACY_IMAGE_HOR_EL = 35, /* d */
    LEGACY_IMAGE_HOR_ROLL = 36, /* d */
    LEGACY_IMAGE_HOR_SIGMA_AZ = 37, /* d */
    LEGACY_IMAGE_HOR_SIGMA_EL = 38, /* d */
    LEGACY_IMAGE_HOR_SIGMA_ROLL = 39, /* d */
    LEGACY_IMAGE_HOR_SIGMA_POINTING = 40, /* d */
    LEGACY_IMAGE_HOR_IPLATE = 41, /* d */
    LEGACY_IMAGE_NUM_BLOBS_FOUND = 42, /* i */
    LEGACY_IMAGE_NUM_BLOBS_MATCHED = 43, /* i */
};

#pragma pack(push, 4)

typedef struct {
    int32_t exposure_num; /* -1: not exposing */
    float gy_az;          /* rad/s */
    float gy_el;          /* rad/s */
} legacy_timestep_t;

typedef struct {
    uint32_t is_new_countdown; /* hundredths of a second, falling to 0 */
    int32_t counter;
} legacy_admin_t;

/* Flight computer to camera. */
typedef struct {
    uint8_t in_charge; /* The sender claims to be in charge. */
    int32_t counter_fcp; /* Series of triggers; -1 before the first. */
    int32_t quit_counter; /* Not used. */
    int32_t shutdown_counter; /* Not used. */
    uint8_t shutdown_now;
    uint8_t shutdown_include_restart;
    uint8_t padding_18[2];
    uint8_t network_reset_now;
    uint8_t network_reset_on_lull_enabled;
    double network_reset_on_lull_delay; /* s */
    int32_t main_counter; /* Not used. */
    double main_display_frequency; /* Hz */
    uint8_t main_display_fullscreen;
    uint8_t main_display_image_only;
    uint8_t main_display_solving_filters;
    double main_display_image_brightness;
    int32_t display_zoom_x; /* px */
    int32_t display_zoom_y; /* px */
    double display_zoom_magnitude;
    uint8_t image_client_enabled;
    double multi_triggering_readout_delay; /* s */
    int32_t set_focus_value; /* counts */
    int32_t set_focus_incremental_value; /* counts */
    int32_t autofocus_search_min; /* counts */
    int32_t autofocus_search_max; /* counts */
    int32_t autofocus_search_step; /* counts */
    uint8_t abort_autofocus_still_use_solution;
    int32_t autofocus_display_mode; /* 0 auto, 1 on, 2 off */
    int32_t set_aperture_value; /* counts */
    double set_gain_value; /* dB */
    int32_t brightness_counter; /* Not used. */
    uint8_t brightness_enabled;
    double brightness_level_kepsa; /* 1000 e-/s/px */
    double brightness_gain_db; /* dB */
    double brightness_actual_exposure; /* s */
    double brightness_simulated_exposure; /* s */
    uint8_t solver_enabled;
    double solver_timeout; /* s */
    uint8_t mask_enabled;
    uint32_t mask_field0;
    uint32_t mask_field1;
    uint32_t mask_field2;
    double snr_threshold;
    int32_t max_num_blobs;
    uint8_t robust_mode_enabled;
    int32_t fitting_method; /* Not used here: sources are always fitted. */
    uint32_t cell_size; /* px */
    uint32_t max_num_blobs_per_cell;
    uint8_t pattern_matcher_enabled;
    uint8_t display_star_names; /* Not used here. */
    double match_tolerance_px; /* px */
    double iplatescale_min; /* rad/px */
    double iplatescale_max; /* rad/px */
    uint8_t platescale_always_fixed; /* Refused here: the plate scale is always fitted. */
    double iplatescale_fixed; /* rad/px */
    uint8_t hor_location_limit_enabled; /* The estimate below is used where this is 1. */
    double hor_location_limit_radius; /* rad */
    double hor_location_limit_az; /* rad, estimate */
    double hor_location_limit_el; /* rad, estimate */
    uint8_t hor_roll_limit_enabled;
    double hor_roll_limit_min; /* rad */
    double hor_roll_limit_max; /* rad */
    uint8_t hor_el_limit_enabled;
    double hor_el_limit_min; /* rad */
    double hor_el_limit_max; /* rad */
    uint8_t eq_location_limit_enabled; /* The estimate below is used where this is 1. */
    double eq_location_limit_radius; /* rad */
    double eq_location_limit_ra; /* rad, estimate */
    double eq_location_limit_dec; /* rad, estimate */
    double matching_pointing_error_threshold; /* rad */
    double matching_fit_error_threshold_px; /* px */
    uint32_t matching_num_matched;
    uint8_t motion_psf_enabled;
    int32_t motion_psf_counter_fcp; /* Not used yet, nor are the rates below. */
    int32_t motion_psf_counter_stars;
    double motion_psf_hroll; /* rad */
    double motion_psf_el; /* rad */
    double motion_psf_iplatescale; /* rad/px */
    legacy_timestep_t timesteps[LEGACY_TIMESTEPS]; /* 100.16 Hz */
    uint8_t horizontal_valid; /* Latitude and sidereal time are valid. */
    double horizontal_lat; /* rad */
    double horizontal_lst; /* rad */
    legacy_admin_t command_admins[LEGACY_COMMANDS]; /* By the place of the command below. */
    uint32_t xsc_protocol_version; /* 3 */
} legacy_block_t;

typedef union {
    int32_t i;
    uint8_t b;
    double d;
} legacy_channel_t;

typedef struct {
    double x;            /* px, right of the picture's centre */
    double y;            /* px, up from it */
    double flux;         /* ADU */
    double peak_to_flux;
} legacy_blob_t;

/* Camera to flight computer. */
typedef struct {
    legacy_channel_t channels[LEGACY_CHANNELS];
    int32_t blobs_counter_stars; /* the image that the sources are of */
    int32_t num_blobs;
    legacy_blob_t blobs[LEGACY_BLOBS];
    uint32_t xsc_protocol_version; /* 3 */
} legacy_answer_t;

#pragma pack(pop)

LEGACY_ASSERT(sizeof(legacy_block_t) == 2580, "legacy_block_t");
LEGACY_ASSERT(sizeof(legacy_answer_t) == 1004, "legacy_answer_t");
LEGACY_ASSERT(sizeof(legacy_channel_t) == 8, "legacy_channel_t");
LEGACY_ASSERT(offsetof(legacy_block_t, in_charge) == 0, "in_charge");
LEGACY_ASSERT(offsetof(legacy_block_t, counter_fcp) == 4, "counter_fcp");
LEGACY_ASSERT(offsetof(legacy_block_t, quit_counter) == 8, "quit_counter");
LEGACY_ASSERT(offsetof(legacy_block_t, shutdown_counter) == 12, "shutdown_counter");
LEGACY_ASSERT(offsetof(legacy_block_t, shutdown_now) == 16, "shutdown_now");
LEGACY_ASSERT(offsetof(legacy_block_t, shutdown_include_restart) == 17, "shutdown_include_restart");
LEGACY_ASSERT(offsetof(legacy_block_t, network_reset_now) == 20, "network_reset_now");
LEGACY_ASSERT(offsetof(legacy_block_t, network_reset_on_lull_enabled) == 21, "network_reset_on_lull_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, network_reset_on_lull_delay) == 24, "network_reset_on_lull_delay");
LEGACY_ASSERT(offsetof(legacy_block_t, main_counter) == 32, "main_counter");
LEGACY_ASSERT(offsetof(legacy_block_t, main_display_frequency) == 36, "main_display_frequency");
LEGACY_ASSERT(offsetof(legacy_block_t, main_display_fullscreen) == 44, "main_display_fullscreen");
LEGACY_ASSERT(offsetof(legacy_block_t, main_display_image_only) == 45, "main_display_image_only");
LEGACY_ASSERT(offsetof(legacy_block_t, main_display_solving_filters) == 46, "main_display_solving_filters");
LEGACY_ASSERT(offsetof(legacy_block_t, main_display_image_brightness) == 48, "main_display_image_brightness");
LEGACY_ASSERT(offsetof(legacy_block_t, display_zoom_x) == 56, "display_zoom_x");
LEGACY_ASSERT(offsetof(legacy_block_t, display_zoom_y) == 60, "display_zoom_y");
LEGACY_ASSERT(offsetof(legacy_block_t, display_zoom_magnitude) == 64, "display_zoom_magnitude");
LEGACY_ASSERT(offsetof(legacy_block_t, image_client_enabled) == 72, "image_client_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, multi_triggering_readout_delay) == 76, "multi_triggering_readout_delay");
LEGACY_ASSERT(offsetof(legacy_block_t, set_focus_value) == 84, "set_focus_value");
LEGACY_ASSERT(offsetof(legacy_block_t, set_focus_incremental_value) == 88, "set_focus_incremental_value");
LEGACY_ASSERT(offsetof(legacy_block_t, autofocus_search_min) == 92, "autofocus_search_min");
LEGACY_ASSERT(offsetof(legacy_block_t, autofocus_search_max) == 96, "autofocus_search_max");
LEGACY_ASSERT(offsetof(legacy_block_t, autofocus_search_step) == 100, "autofocus_search_step");
LEGACY_ASSERT(offsetof(legacy_block_t, abort_autofocus_still_use_solution) == 104, "abort_autofocus_still_use_solution");
LEGACY_ASSERT(offsetof(legacy_block_t, autofocus_display_mode) == 108, "autofocus_display_mode");
LEGACY_ASSERT(offsetof(legacy_block_t, set_aperture_value) == 112, "set_aperture_value");
LEGACY_ASSERT(offsetof(legacy_block_t, set_gain_value) == 116, "set_gain_value");
LEGACY_ASSERT(offsetof(legacy_block_t, brightness_counter) == 124, "brightness_counter");
LEGACY_ASSERT(offsetof(legacy_block_t, brightness_enabled) == 128, "brightness_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, brightness_level_kepsa) == 132, "brightness_level_kepsa");
LEGACY_ASSERT(offsetof(legacy_block_t, brightness_gain_db) == 140, "brightness_gain_db");
LEGACY_ASSERT(offsetof(legacy_block_t, brightness_actual_exposure) == 148, "brightness_actual_exposure");
LEGACY_ASSERT(offsetof(legacy_block_t, brightness_simulated_exposure) == 156, "brightness_simulated_exposure");
LEGACY_ASSERT(offsetof(legacy_block_t, solver_enabled) == 164, "solver_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, solver_timeout) == 168, "solver_timeout");
LEGACY_ASSERT(offsetof(legacy_block_t, mask_enabled) == 176, "mask_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, mask_field0) == 180, "mask_field0");
LEGACY_ASSERT(offsetof(legacy_block_t, mask_field1) == 184, "mask_field1");
LEGACY_ASSERT(offsetof(legacy_block_t, mask_field2) == 188, "mask_field2");
LEGACY_ASSERT(offsetof(legacy_block_t, snr_threshold) == 192, "snr_threshold");
LEGACY_ASSERT(offsetof(legacy_block_t, max_num_blobs) == 200, "max_num_blobs");
LEGACY_ASSERT(offsetof(legacy_block_t, robust_mode_enabled) == 204, "robust_mode_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, fitting_method) == 208, "fitting_method");
LEGACY_ASSERT(offsetof(legacy_block_t, cell_size) == 212, "cell_size");
LEGACY_ASSERT(offsetof(legacy_block_t, max_num_blobs_per_cell) == 216, "max_num_blobs_per_cell");
LEGACY_ASSERT(offsetof(legacy_block_t, pattern_matcher_enabled) == 220, "pattern_matcher_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, display_star_names) == 221, "display_star_names");
LEGACY_ASSERT(offsetof(legacy_block_t, match_tolerance_px) == 224, "match_tolerance_px");
LEGACY_ASSERT(offsetof(legacy_block_t, iplatescale_min) == 232, "iplatescale_min");
LEGACY_ASSERT(offsetof(legacy_block_t, iplatescale_max) == 240, "iplatescale_max");
LEGACY_ASSERT(offsetof(legacy_block_t, platescale_always_fixed) == 248, "platescale_always_fixed");
LEGACY_ASSERT(offsetof(legacy_block_t, iplatescale_fixed) == 252, "iplatescale_fixed");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_location_limit_enabled) == 260, "hor_location_limit_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_location_limit_radius) == 264, "hor_location_limit_radius");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_location_limit_az) == 272, "hor_location_limit_az");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_location_limit_el) == 280, "hor_location_limit_el");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_roll_limit_enabled) == 288, "hor_roll_limit_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_roll_limit_min) == 292, "hor_roll_limit_min");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_roll_limit_max) == 300, "hor_roll_limit_max");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_el_limit_enabled) == 308, "hor_el_limit_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_el_limit_min) == 312, "hor_el_limit_min");
LEGACY_ASSERT(offsetof(legacy_block_t, hor_el_limit_max) == 320, "hor_el_limit_max");
LEGACY_ASSERT(offsetof(legacy_block_t, eq_location_limit_enabled) == 328, "eq_location_limit_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, eq_location_limit_radius) == 332, "eq_location_limit_radius");
LEGACY_ASSERT(offsetof(legacy_block_t, eq_location_limit_ra) == 340, "eq_location_limit_ra");
LEGACY_ASSERT(offsetof(legacy_block_t, eq_location_limit_dec) == 348, "eq_location_limit_dec");
LEGACY_ASSERT(offsetof(legacy_block_t, matching_pointing_error_threshold) == 356, "matching_pointing_error_threshold");
LEGACY_ASSERT(offsetof(legacy_block_t, matching_fit_error_threshold_px) == 364, "matching_fit_error_threshold_px");
LEGACY_ASSERT(offsetof(legacy_block_t, matching_num_matched) == 372, "matching_num_matched");
LEGACY_ASSERT(offsetof(legacy_block_t, motion_psf_enabled) == 376, "motion_psf_enabled");
LEGACY_ASSERT(offsetof(legacy_block_t, motion_psf_counter_fcp) == 380, "motion_psf_counter_fcp");
LEGACY_ASSERT(offsetof(legacy_block_t, motion_psf_counter_stars) == 384, "motion_psf_counter_stars");
LEGACY_ASSERT(offsetof(legacy_block_t, motion_psf_hroll) == 388, "motion_psf_hroll");
LEGACY_ASSERT(offsetof(legacy_block_t, motion_psf_el) == 396, "motion_psf_el");
LEGACY_ASSERT(offsetof(legacy_block_t, motion_psf_iplatescale) == 404, "motion_psf_iplatescale");
LEGACY_ASSERT(offsetof(legacy_block_t, timesteps) == 412, "timesteps");
LEGACY_ASSERT(offsetof(legacy_block_t, horizontal_valid) == 2284, "horizontal_valid");
LEGACY_ASSERT(offsetof(legacy_block_t, horizontal_lat) == 2288, "horizontal_lat");
LEGACY_ASSERT(offsetof(legacy_block_t, horizontal_lst) == 2296, "horizontal_lst");
LEGACY_ASSERT(offsetof(legacy_block_t, command_admins) == 2304, "command_admins");
LEGACY_ASSERT(offsetof(legacy_block_t, xsc_protocol_version) == 2576, "xsc_protocol_version");
LEGACY_ASSERT(offsetof(legacy_answer_t, blobs_counter_stars) == 352, "blobs_counter_stars");
LEGACY_ASSERT(offsetof(legacy_answer_t, num_blobs) == 356, "num_blobs");
LEGACY_ASSERT(offsetof(legacy_answer_t, blobs) == 360, "blobs");
LEGACY_ASSERT(offsetof(legacy_answer_t, xsc_protocol_version) == 1000, "xsc_protocol_version");

#endif
