/* Prints the message in a golden file as JSON, read through the structs of stars_icd.h, and checks that the same bytes
 * come out when the body is framed again.
 *
 * Made from the layout tables of the program by `STARS_BLESS=1 cargo test --test proto`; not to be edited.
 *
 *     gcc -std=c11 -Wall -Wextra -Werror -o check proto/check.c && ./check proto/golden/v1/status.hex
 */
#include "stars_icd.h"
#include <stdio.h>
#include <string.h>

static int print_body(uint8_t kind, const uint8_t *body);

int main(int argc, char **argv)
{
    static uint8_t bytes[STARS_MAX_FRAME], again[STARS_MAX_FRAME];
    size_t size = 0;
    unsigned byte;
    stars_frame_t frame;
    FILE *file = argc == 2 ? fopen(argv[1], "r") : NULL;
    if (!file) {
        fprintf(stderr, "usage: check FILE.hex\n");
        return 2;
    }
    while (size < sizeof bytes && fscanf(file, "%2x", &byte) == 1)
        bytes[size++] = (uint8_t)byte;
    fclose(file);
    if (stars_take_frame(bytes, size, &frame) != (long)size || !frame.body) {
        fprintf(stderr, "%s: no whole frame\n", argv[1]);
        return 1;
    }
    if (stars_put_frame(again, sizeof again, frame.kind, frame.body, frame.body_size) != size || memcmp(bytes, again, size)) {
        fprintf(stderr, "%s: framed again, other bytes\n", argv[1]);
        return 1;
    }
    return print_body(frame.kind, frame.body);
}

static void print_text(const char *text, size_t size)
{
    printf("\"");
    for (size_t i = 0; i < size && text[i]; i++)
        printf(text[i] == '"' || text[i] == '\\' ? "\\%c" : "%c", text[i]);
    printf("\"");
}

static void print_code(uint8_t code, const char *const *names)
{
    printf("\"%s\"", names[code - 1]);
}

static void print_hello(const stars_hello_t *m)
{
    printf("{\"magic\": ");
    {
        print_text(m->magic, 8);
    }
    printf(", \"version_min\": ");
    {
        printf("%lu", (unsigned long)m->version_min);
    }
    printf(", \"version_current\": ");
    {
        printf("%lu", (unsigned long)m->version_current);
    }
    printf(", \"schema_hash_known\": ");
    {
        printf(m->schema_hash_known ? "true" : "false");
    }
    printf(", \"schema_hash\": ");
    if (!(m->schema_hash_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->schema_hash);
    }
    printf(", \"role\": ");
    {
        print_code(m->role, (const char *const[]){"camera", "flight_computer"});
    }
    printf(", \"id\": ");
    {
        printf("%lu", (unsigned long)m->id);
    }
    printf(", \"name\": ");
    {
        print_text(m->name, 16);
    }
    printf(", \"boot_id\": ");
    {
        printf("%lu", (unsigned long)m->boot_id);
    }
    printf(", \"build\": ");
    {
        print_text(m->build, 32);
    }
    printf(", \"settings_hash_known\": ");
    {
        printf(m->settings_hash_known ? "true" : "false");
    }
    printf(", \"settings_hash\": ");
    if (!(m->settings_hash_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->settings_hash);
    }
    printf("}");
}

static void print_refuse(const stars_refuse_t *m)
{
    printf("{\"refusal\": ");
    {
        print_code(m->refusal, (const char *const[]){"no_common_version", "not_a_hello", "wrong_role", "address_not_allowed", "too_many_connections", "replaced", "bad_message", "silent", "shutting_down"});
    }
    printf(", \"version_min\": ");
    {
        printf("%lu", (unsigned long)m->version_min);
    }
    printf(", \"version_current\": ");
    {
        printf("%lu", (unsigned long)m->version_current);
    }
    printf(", \"detail\": ");
    {
        print_text(m->detail, 96);
    }
    printf("}");
}

static void print_status(const stars_status_t *m)
{
    printf("{\"sequence\": ");
    {
        printf("%lu", (unsigned long)m->sequence);
    }
    printf(", \"boot_id\": ");
    {
        printf("%lu", (unsigned long)m->boot_id);
    }
    printf(", \"uptime_s\": ");
    {
        printf("%.17g", (double)m->uptime_s);
    }
    printf(", \"claims_charge\": ");
    {
        printf(m->claims_charge ? "true" : "false");
    }
    printf(", \"clock_unix_s_known\": ");
    {
        printf(m->clock_unix_s_known ? "true" : "false");
    }
    printf(", \"clock_unix_s\": ");
    if (!(m->clock_unix_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->clock_unix_s);
    }
    printf(", \"clock_quality\": ");
    {
        print_code(m->clock_quality, (const char *const[]){"unset", "free_running", "synchronised", "flight_computer", "chrony", "ptp"});
    }
    printf(", \"observer_known\": ");
    {
        printf(m->observer_known ? "true" : "false");
    }
    printf(", \"latitude_deg\": ");
    if (!(m->observer_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->latitude_deg);
    }
    printf(", \"sidereal_time_h\": ");
    if (!(m->observer_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sidereal_time_h);
    }
    printf(", \"horizontal_estimate_known\": ");
    {
        printf(m->horizontal_estimate_known ? "true" : "false");
    }
    printf(", \"az_deg\": ");
    if (!(m->horizontal_estimate_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->az_deg);
    }
    printf(", \"el_deg\": ");
    if (!(m->horizontal_estimate_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->el_deg);
    }
    printf(", \"equatorial_estimate_known\": ");
    {
        printf(m->equatorial_estimate_known ? "true" : "false");
    }
    printf(", \"ra_deg\": ");
    if (!(m->equatorial_estimate_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->ra_deg);
    }
    printf(", \"dec_deg\": ");
    if (!(m->equatorial_estimate_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->dec_deg);
    }
    printf(", \"trigger_counter_known\": ");
    {
        printf(m->trigger_counter_known ? "true" : "false");
    }
    printf(", \"trigger_counter\": ");
    if (!(m->trigger_counter_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->trigger_counter);
    }
    printf(", \"trigger_image_counter_known\": ");
    {
        printf(m->trigger_image_counter_known ? "true" : "false");
    }
    printf(", \"trigger_image_counter\": ");
    if (!(m->trigger_image_counter_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->trigger_image_counter);
    }
    printf(", \"trigger_age_s_known\": ");
    {
        printf(m->trigger_age_s_known ? "true" : "false");
    }
    printf(", \"trigger_age_s\": ");
    if (!(m->trigger_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->trigger_age_s);
    }
    printf(", \"trigger_pulses\": ");
    {
        printf("%lu", (unsigned long)m->trigger_pulses);
    }
    printf(", \"updates_received\": ");
    {
        printf("%lu", (unsigned long)m->updates_received);
    }
    printf(", \"last_update_sequence_known\": ");
    {
        printf(m->last_update_sequence_known ? "true" : "false");
    }
    printf(", \"last_update_sequence\": ");
    if (!(m->last_update_sequence_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->last_update_sequence);
    }
    printf("}");
}

static void print_source(const stars_source_t *m)
{
    printf("{\"x_px\": ");
    {
        printf("%.17g", (double)m->x_px);
    }
    printf(", \"y_px\": ");
    {
        printf("%.17g", (double)m->y_px);
    }
    printf(", \"sigma_px\": ");
    {
        printf("%.17g", (double)m->sigma_px);
    }
    printf(", \"flux_adu\": ");
    {
        printf("%.17g", (double)m->flux_adu);
    }
    printf(", \"peak_adu\": ");
    {
        printf("%.17g", (double)m->peak_adu);
    }
    printf(", \"snr\": ");
    {
        printf("%.17g", (double)m->snr);
    }
    printf(", \"saturated\": ");
    {
        printf(m->saturated ? "true" : "false");
    }
    printf(", \"star_id_known\": ");
    {
        printf(m->star_id_known ? "true" : "false");
    }
    printf(", \"star_id\": ");
    if (!(m->star_id_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->star_id);
    }
    printf("}");
}

static void print_command_reply(const stars_command_reply_t *m)
{
    printf("{\"serial\": ");
    {
        printf("%lu", (unsigned long)m->serial);
    }
    printf(", \"flight_computer\": ");
    {
        printf("%lu", (unsigned long)m->flight_computer);
    }
    printf(", \"command\": ");
    {
        printf("%lu", (unsigned long)m->command);
    }
    printf(", \"counter\": ");
    {
        printf("%lu", (unsigned long)m->counter);
    }
    printf(", \"stage\": ");
    {
        print_code(m->stage, (const char *const[]){"accepted", "started", "completed", "rejected", "failed"});
    }
    printf(", \"why_known\": ");
    {
        printf(m->why_known ? "true" : "false");
    }
    printf(", \"why\": ");
    if (!(m->why_known))
        printf("null");
    else
    {
        print_code(m->why, (const char *const[]){"not_in_charge", "stale", "replayed", "out_of_range", "busy", "not_armed", "unknown_command", "unsafe_state", "not_authentic", "half_changed", "early", "wrong_boot", "not_available", "not_kept", "stopped", "device", "program", "dialect", "no_result", "restarted"});
    }
    printf(", \"reply_age_s\": ");
    {
        printf("%.17g", (double)m->reply_age_s);
    }
    printf(", \"words\": ");
    {
        print_text(m->words, 64);
    }
    printf("}");
}

static void print_peer_clock(const stars_peer_clock_t *m)
{
    printf("{\"flight_computer\": ");
    {
        printf("%lu", (unsigned long)m->flight_computer);
    }
    printf(", \"offset_s\": ");
    {
        printf("%.17g", (double)m->offset_s);
    }
    printf(", \"sigma_s\": ");
    {
        printf("%.17g", (double)m->sigma_s);
    }
    printf(", \"age_s\": ");
    {
        printf("%.17g", (double)m->age_s);
    }
    printf("}");
}

static void print_update(const stars_update_t *m)
{
    printf("{\"sequence\": ");
    {
        printf("%lu", (unsigned long)m->sequence);
    }
    printf(", \"boot_id\": ");
    {
        printf("%lu", (unsigned long)m->boot_id);
    }
    printf(", \"uptime_s\": ");
    {
        printf("%.17g", (double)m->uptime_s);
    }
    printf(", \"clock_unix_s_known\": ");
    {
        printf(m->clock_unix_s_known ? "true" : "false");
    }
    printf(", \"clock_unix_s\": ");
    if (!(m->clock_unix_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->clock_unix_s);
    }
    printf(", \"clock_quality\": ");
    {
        print_code(m->clock_quality, (const char *const[]){"unset", "free_running", "synchronised", "flight_computer", "chrony", "ptp"});
    }
    printf(", \"settings_hash\": ");
    {
        printf("%lu", (unsigned long)m->settings_hash);
    }
    printf(", \"simulated_camera\": ");
    {
        printf(m->simulated_camera ? "true" : "false");
    }
    printf(", \"simulated_lens\": ");
    {
        printf(m->simulated_lens ? "true" : "false");
    }
    printf(", \"statuses_received\": ");
    {
        printf("%lu", (unsigned long)m->statuses_received);
    }
    printf(", \"last_status_sequence_known\": ");
    {
        printf(m->last_status_sequence_known ? "true" : "false");
    }
    printf(", \"last_status_sequence\": ");
    if (!(m->last_status_sequence_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->last_status_sequence);
    }
    printf(", \"last_status_age_s_known\": ");
    {
        printf(m->last_status_age_s_known ? "true" : "false");
    }
    printf(", \"last_status_age_s\": ");
    if (!(m->last_status_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->last_status_age_s);
    }
    printf(", \"status_values_withheld\": ");
    {
        printf("%lu", (unsigned long)m->status_values_withheld);
    }
    printf(", \"in_charge_id_known\": ");
    {
        printf(m->in_charge_id_known ? "true" : "false");
    }
    printf(", \"in_charge_id\": ");
    if (!(m->in_charge_id_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->in_charge_id);
    }
    printf(", \"in_charge_since_s_known\": ");
    {
        printf(m->in_charge_since_s_known ? "true" : "false");
    }
    printf(", \"in_charge_since_s\": ");
    if (!(m->in_charge_since_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->in_charge_since_s);
    }
    printf(", \"you_are_in_charge\": ");
    {
        printf(m->you_are_in_charge ? "true" : "false");
    }
    printf(", \"claims\": ");
    {
        printf("%lu", (unsigned long)m->claims);
    }
    printf(", \"commands_accepted\": ");
    {
        printf("%lu", (unsigned long)m->commands_accepted);
    }
    printf(", \"commands_refused\": ");
    {
        printf("%lu", (unsigned long)m->commands_refused);
    }
    printf(", \"last_refusal_known\": ");
    {
        printf(m->last_refusal_known ? "true" : "false");
    }
    printf(", \"last_refusal\": ");
    if (!(m->last_refusal_known))
        printf("null");
    else
    {
        print_code(m->last_refusal, (const char *const[]){"not_in_charge", "stale", "replayed", "out_of_range", "busy", "not_armed", "unknown_command", "unsafe_state", "not_authentic", "half_changed", "early", "wrong_boot", "not_available", "not_kept", "stopped", "device", "program", "dialect", "no_result", "restarted"});
    }
    printf(", \"frames_taken\": ");
    {
        printf("%lu", (unsigned long)m->frames_taken);
    }
    printf(", \"frames_solved\": ");
    {
        printf("%lu", (unsigned long)m->frames_solved);
    }
    printf(", \"frames_skipped\": ");
    {
        printf("%lu", (unsigned long)m->frames_skipped);
    }
    printf(", \"frames_lost\": ");
    {
        printf("%lu", (unsigned long)m->frames_lost);
    }
    printf(", \"restarts_camera\": ");
    {
        printf("%lu", (unsigned long)m->restarts_camera);
    }
    printf(", \"restarts_solver\": ");
    {
        printf("%lu", (unsigned long)m->restarts_solver);
    }
    printf(", \"restarts_hub\": ");
    {
        printf("%lu", (unsigned long)m->restarts_hub);
    }
    printf(", \"restarts_recorder\": ");
    {
        printf("%lu", (unsigned long)m->restarts_recorder);
    }
    printf(", \"restarts_server\": ");
    {
        printf("%lu", (unsigned long)m->restarts_server);
    }
    printf(", \"links_refused\": ");
    {
        printf("%lu", (unsigned long)m->links_refused);
    }
    printf(", \"solving\": ");
    {
        printf(m->solving ? "true" : "false");
    }
    printf(", \"temperature_lens_c_known\": ");
    {
        printf(m->temperature_lens_c_known ? "true" : "false");
    }
    printf(", \"temperature_lens_c\": ");
    if (!(m->temperature_lens_c_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_lens_c);
    }
    printf(", \"temperature_computer_c_known\": ");
    {
        printf(m->temperature_computer_c_known ? "true" : "false");
    }
    printf(", \"temperature_computer_c\": ");
    if (!(m->temperature_computer_c_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_computer_c);
    }
    printf(", \"temperature_vessel_c_known\": ");
    {
        printf(m->temperature_vessel_c_known ? "true" : "false");
    }
    printf(", \"temperature_vessel_c\": ");
    if (!(m->temperature_vessel_c_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_vessel_c);
    }
    printf(", \"temperature_plate_c_known\": ");
    {
        printf(m->temperature_plate_c_known ? "true" : "false");
    }
    printf(", \"temperature_plate_c\": ");
    if (!(m->temperature_plate_c_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_plate_c);
    }
    printf(", \"temperature_dcdc_c_known\": ");
    {
        printf(m->temperature_dcdc_c_known ? "true" : "false");
    }
    printf(", \"temperature_dcdc_c\": ");
    if (!(m->temperature_dcdc_c_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_dcdc_c);
    }
    printf(", \"temperature_flange_c_known\": ");
    {
        printf(m->temperature_flange_c_known ? "true" : "false");
    }
    printf(", \"temperature_flange_c\": ");
    if (!(m->temperature_flange_c_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_flange_c);
    }
    printf(", \"pressure_atm_known\": ");
    {
        printf(m->pressure_atm_known ? "true" : "false");
    }
    printf(", \"pressure_atm\": ");
    if (!(m->pressure_atm_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->pressure_atm);
    }
    printf(", \"disk_free_gib_known\": ");
    {
        printf(m->disk_free_gib_known ? "true" : "false");
    }
    printf(", \"disk_free_gib\": ");
    if (!(m->disk_free_gib_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->disk_free_gib);
    }
    printf(", \"next_image_counter\": ");
    {
        printf("%lu", (unsigned long)m->next_image_counter);
    }
    printf(", \"gain_db_known\": ");
    {
        printf(m->gain_db_known ? "true" : "false");
    }
    printf(", \"gain_db\": ");
    if (!(m->gain_db_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->gain_db);
    }
    printf(", \"focus_counts_known\": ");
    {
        printf(m->focus_counts_known ? "true" : "false");
    }
    printf(", \"focus_counts\": ");
    if (!(m->focus_counts_known))
        printf("null");
    else
    {
        printf("%ld", (long)m->focus_counts);
    }
    printf(", \"aperture_counts_known\": ");
    {
        printf(m->aperture_counts_known ? "true" : "false");
    }
    printf(", \"aperture_counts\": ");
    if (!(m->aperture_counts_known))
        printf("null");
    else
    {
        printf("%ld", (long)m->aperture_counts);
    }
    printf(", \"image_known\": ");
    {
        printf(m->image_known ? "true" : "false");
    }
    printf(", \"image_counter\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->image_counter);
    }
    printf(", \"image_trigger_counter_known\": ");
    {
        printf(m->image_trigger_counter_known ? "true" : "false");
    }
    printf(", \"image_trigger_counter\": ");
    if (!(m->image_known && m->image_trigger_counter_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->image_trigger_counter);
    }
    printf(", \"exposures\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->exposures);
    }
    printf(", \"exposure_s_known\": ");
    {
        printf(m->exposure_s_known ? "true" : "false");
    }
    printf(", \"exposure_s\": ");
    if (!(m->image_known && m->exposure_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->exposure_s);
    }
    printf(", \"captured_unix_s_known\": ");
    {
        printf(m->captured_unix_s_known ? "true" : "false");
    }
    printf(", \"captured_unix_s\": ");
    if (!(m->image_known && m->captured_unix_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->captured_unix_s);
    }
    printf(", \"captured_quality_known\": ");
    {
        printf(m->captured_quality_known ? "true" : "false");
    }
    printf(", \"captured_quality\": ");
    if (!(m->image_known && m->captured_quality_known))
        printf("null");
    else
    {
        print_code(m->captured_quality, (const char *const[]){"unset", "free_running", "synchronised", "flight_computer", "chrony", "ptp"});
    }
    printf(", \"image_age_s_known\": ");
    {
        printf(m->image_age_s_known ? "true" : "false");
    }
    printf(", \"image_age_s\": ");
    if (!(m->image_known && m->image_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->image_age_s);
    }
    printf(", \"reason\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        print_code(m->reason, (const char *const[]){"solved", "saturated", "too_bright", "no_contrast", "too_few_sources", "no_match", "undecided", "requirement", "timed_out", "aborted", "disabled", "skipped", "unreadable", "failed"});
    }
    printf(", \"cause_known\": ");
    {
        printf(m->cause_known ? "true" : "false");
    }
    printf(", \"cause\": ");
    if (!(m->image_known && m->cause_known))
        printf("null");
    else
    {
        print_code(m->cause, (const char *const[]){"overexposed", "saturated", "no_contrast", "out_of_focus", "trailed", "clouds", "too_few_stars", "too_many_artefacts", "wrong_platescale", "mirrored", "wrong_prior", "lens_covered"});
    }
    printf(", \"detail\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        print_text(m->detail, 120);
    }
    printf(", \"mode\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        print_code(m->mode, (const char *const[]){"normal", "robust", "motion"});
    }
    printf(", \"statistics_known\": ");
    {
        printf(m->statistics_known ? "true" : "false");
    }
    printf(", \"mean_adu\": ");
    if (!(m->image_known && m->statistics_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->mean_adu);
    }
    printf(", \"noise_adu\": ");
    if (!(m->image_known && m->statistics_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->noise_adu);
    }
    printf(", \"measured_gain_adu_per_e_known\": ");
    {
        printf(m->measured_gain_adu_per_e_known ? "true" : "false");
    }
    printf(", \"measured_gain_adu_per_e\": ");
    if (!(m->image_known && m->statistics_known && m->measured_gain_adu_per_e_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->measured_gain_adu_per_e);
    }
    printf(", \"measured_gain_db_known\": ");
    {
        printf(m->measured_gain_db_known ? "true" : "false");
    }
    printf(", \"measured_gain_db\": ");
    if (!(m->image_known && m->statistics_known && m->measured_gain_db_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->measured_gain_db);
    }
    printf(", \"saturated_px\": ");
    if (!(m->image_known && m->statistics_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->saturated_px);
    }
    printf(", \"saturated_fraction\": ");
    if (!(m->image_known && m->statistics_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->saturated_fraction);
    }
    printf(", \"fwhm_px_known\": ");
    {
        printf(m->fwhm_px_known ? "true" : "false");
    }
    printf(", \"fwhm_px\": ");
    if (!(m->image_known && m->statistics_known && m->fwhm_px_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->fwhm_px);
    }
    printf(", \"focus_metric_adu_known\": ");
    {
        printf(m->focus_metric_adu_known ? "true" : "false");
    }
    printf(", \"focus_metric_adu\": ");
    if (!(m->image_known && m->focus_metric_adu_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->focus_metric_adu);
    }
    printf(", \"sources_found\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->sources_found);
    }
    printf(", \"sources_tried\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->sources_tried);
    }
    printf(", \"sources_matched\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->sources_matched);
    }
    printf(", \"candidates_tried\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->candidates_tried);
    }
    printf(", \"solve_time_ms_known\": ");
    {
        printf(m->solve_time_ms_known ? "true" : "false");
    }
    printf(", \"solve_time_ms\": ");
    if (!(m->image_known && m->solve_time_ms_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->solve_time_ms);
    }
    printf(", \"equatorial_known\": ");
    {
        printf(m->equatorial_known ? "true" : "false");
    }
    printf(", \"ra_deg\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->ra_deg);
    }
    printf(", \"dec_deg\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->dec_deg);
    }
    printf(", \"roll_deg\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->roll_deg);
    }
    printf(", \"sigma_east_arcsec\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_east_arcsec);
    }
    printf(", \"sigma_north_arcsec\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_north_arcsec);
    }
    printf(", \"sigma_roll_arcsec\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_roll_arcsec);
    }
    printf(", \"sigma_pointing_arcsec\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_pointing_arcsec);
    }
    printf(", \"covariance_arcsec2\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("[");
        for (size_t i = 0; i < 3; i++) {
        printf(i ? ", " : "");
        printf("[");
        for (size_t j = 0; j < 3; j++) {
        printf(j ? ", " : "");
        printf("%.17g", (double)m->covariance_arcsec2[i][j]);
        }
        printf("]");
        }
        printf("]");
    }
    printf(", \"platescale_arcsec_px\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->platescale_arcsec_px);
    }
    printf(", \"sigma_platescale_arcsec_px_known\": ");
    {
        printf(m->sigma_platescale_arcsec_px_known ? "true" : "false");
    }
    printf(", \"sigma_platescale_arcsec_px\": ");
    if (!(m->image_known && m->equatorial_known && m->sigma_platescale_arcsec_px_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_platescale_arcsec_px);
    }
    printf(", \"distortion_k1_known\": ");
    {
        printf(m->distortion_k1_known ? "true" : "false");
    }
    printf(", \"distortion_k1\": ");
    if (!(m->image_known && m->equatorial_known && m->distortion_k1_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->distortion_k1);
    }
    printf(", \"rms_px\": ");
    if (!(m->image_known && m->equatorial_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->rms_px);
    }
    printf(", \"chi2_per_dof_known\": ");
    {
        printf(m->chi2_per_dof_known ? "true" : "false");
    }
    printf(", \"chi2_per_dof\": ");
    if (!(m->image_known && m->equatorial_known && m->chi2_per_dof_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->chi2_per_dof);
    }
    printf(", \"false_probability_log10_known\": ");
    {
        printf(m->false_probability_log10_known ? "true" : "false");
    }
    printf(", \"false_probability_log10\": ");
    if (!(m->image_known && m->equatorial_known && m->false_probability_log10_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->false_probability_log10);
    }
    printf(", \"epoch_yr_known\": ");
    {
        printf(m->epoch_yr_known ? "true" : "false");
    }
    printf(", \"epoch_yr\": ");
    if (!(m->image_known && m->equatorial_known && m->epoch_yr_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->epoch_yr);
    }
    printf(", \"horizontal_known\": ");
    {
        printf(m->horizontal_known ? "true" : "false");
    }
    printf(", \"az_deg\": ");
    if (!(m->image_known && m->horizontal_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->az_deg);
    }
    printf(", \"el_deg\": ");
    if (!(m->image_known && m->horizontal_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->el_deg);
    }
    printf(", \"horizontal_roll_deg\": ");
    if (!(m->image_known && m->horizontal_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->horizontal_roll_deg);
    }
    printf(", \"sigma_az_arcsec\": ");
    if (!(m->image_known && m->horizontal_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_az_arcsec);
    }
    printf(", \"sigma_el_arcsec\": ");
    if (!(m->image_known && m->horizontal_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_el_arcsec);
    }
    printf(", \"sigma_horizontal_roll_arcsec\": ");
    if (!(m->image_known && m->horizontal_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_horizontal_roll_arcsec);
    }
    printf(", \"sigma_horizontal_pointing_arcsec\": ");
    if (!(m->image_known && m->horizontal_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_horizontal_pointing_arcsec);
    }
    printf(", \"latitude_deg\": ");
    if (!(m->image_known && m->horizontal_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->latitude_deg);
    }
    printf(", \"sidereal_time_h\": ");
    if (!(m->image_known && m->horizontal_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sidereal_time_h);
    }
    printf(", \"equinox_yr_known\": ");
    {
        printf(m->equinox_yr_known ? "true" : "false");
    }
    printf(", \"equinox_yr\": ");
    if (!(m->image_known && m->horizontal_known && m->equinox_yr_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->equinox_yr);
    }
    printf(", \"prior_disagreement_deg_known\": ");
    {
        printf(m->prior_disagreement_deg_known ? "true" : "false");
    }
    printf(", \"prior_disagreement_deg\": ");
    if (!(m->image_known && m->prior_disagreement_deg_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->prior_disagreement_deg);
    }
    printf(", \"corrected_proper_motion\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf(m->corrected_proper_motion ? "true" : "false");
    }
    printf(", \"corrected_aberration\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf(m->corrected_aberration ? "true" : "false");
    }
    printf(", \"corrected_precession\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf(m->corrected_precession ? "true" : "false");
    }
    printf(", \"corrected_refraction\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf(m->corrected_refraction ? "true" : "false");
    }
    printf(", \"corrected_distortion\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf(m->corrected_distortion ? "true" : "false");
    }
    printf(", \"sources_count\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->sources_count);
    }
    printf(", \"sources\": ");
    if (!(m->image_known))
        printf("null");
    else
    {
        printf("[");
        for (size_t i = 0; i < m->sources_count; i++) {
        printf(i ? ", " : "");
        print_source(&m->sources[i]);
        }
        printf("]");
    }
    printf(", \"lease_epoch_known\": ");
    {
        printf(m->lease_epoch_known ? "true" : "false");
    }
    printf(", \"lease_epoch\": ");
    if (!(m->lease_epoch_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->lease_epoch);
    }
    printf(", \"armed_command_known\": ");
    {
        printf(m->armed_command_known ? "true" : "false");
    }
    printf(", \"armed_command\": ");
    if (!(m->armed_command_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->armed_command);
    }
    printf(", \"armed_for_s\": ");
    {
        printf("%.17g", (double)m->armed_for_s);
    }
    printf(", \"commands_under_way\": ");
    {
        printf("%lu", (unsigned long)m->commands_under_way);
    }
    printf(", \"authentication_required\": ");
    {
        printf(m->authentication_required ? "true" : "false");
    }
    printf(", \"authentication_key\": ");
    {
        printf(m->authentication_key ? "true" : "false");
    }
    printf(", \"counters_kept\": ");
    {
        printf(m->counters_kept ? "true" : "false");
    }
    printf(", \"refused\": ");
    {
        printf("[");
        for (size_t i = 0; i < 20; i++) {
        printf(i ? ", " : "");
        printf("%lu", (unsigned long)m->refused[i]);
        }
        printf("]");
    }
    printf(", \"settings_commanded\": ");
    {
        printf("%lu", (unsigned long)m->settings_commanded);
    }
    printf(", \"replies_count\": ");
    {
        printf("%lu", (unsigned long)m->replies_count);
    }
    printf(", \"replies\": ");
    {
        printf("[");
        for (size_t i = 0; i < m->replies_count; i++) {
        printf(i ? ", " : "");
        print_command_reply(&m->replies[i]);
        }
        printf("]");
    }
    printf(", \"lens_connected\": ");
    {
        printf(m->lens_connected ? "true" : "false");
    }
    printf(", \"lens_moving\": ");
    {
        printf(m->lens_moving ? "true" : "false");
    }
    printf(", \"lens_stopped\": ");
    {
        printf(m->lens_stopped ? "true" : "false");
    }
    printf(", \"focus_doubt_known\": ");
    {
        printf(m->focus_doubt_known ? "true" : "false");
    }
    printf(", \"focus_doubt\": ");
    if (!(m->focus_doubt_known))
        printf("null");
    else
    {
        print_code(m->focus_doubt, (const char *const[]){"no_lens", "never_read", "requested", "not_read_back", "timed_out", "unexpected_reply", "refused", "port_lost", "not_learned", "power_cycled", "counts_lost", "missed"});
    }
    printf(", \"aperture_doubt_known\": ");
    {
        printf(m->aperture_doubt_known ? "true" : "false");
    }
    printf(", \"aperture_doubt\": ");
    if (!(m->aperture_doubt_known))
        printf("null");
    else
    {
        print_code(m->aperture_doubt, (const char *const[]){"no_lens", "never_read", "requested", "not_read_back", "timed_out", "unexpected_reply", "refused", "port_lost", "not_learned", "power_cycled", "counts_lost", "missed"});
    }
    printf(", \"focus_range_known\": ");
    {
        printf(m->focus_range_known ? "true" : "false");
    }
    printf(", \"focus_nearest_counts\": ");
    if (!(m->focus_range_known))
        printf("null");
    else
    {
        printf("%ld", (long)m->focus_nearest_counts);
    }
    printf(", \"focus_furthest_counts\": ");
    if (!(m->focus_range_known))
        printf("null");
    else
    {
        printf("%ld", (long)m->focus_furthest_counts);
    }
    printf(", \"lens_requests\": ");
    {
        printf("%lu", (unsigned long)m->lens_requests);
    }
    printf(", \"lens_errors\": ");
    {
        printf("%lu", (unsigned long)m->lens_errors);
    }
    printf(", \"lens_last_error\": ");
    {
        print_text(m->lens_last_error, 64);
    }
    printf(", \"autofocus_mode\": ");
    {
        print_code(m->autofocus_mode, (const char *const[]){"not_running", "running", "grace"});
    }
    printf(", \"autofocus_requested_counts_known\": ");
    {
        printf(m->autofocus_requested_counts_known ? "true" : "false");
    }
    printf(", \"autofocus_requested_counts\": ");
    if (!(m->autofocus_requested_counts_known))
        printf("null");
    else
    {
        printf("%ld", (long)m->autofocus_requested_counts);
    }
    printf(", \"autofocus_run_age_s_known\": ");
    {
        printf(m->autofocus_run_age_s_known ? "true" : "false");
    }
    printf(", \"autofocus_run_age_s\": ");
    if (!(m->autofocus_run_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->autofocus_run_age_s);
    }
    printf(", \"autofocus_time_left_s_known\": ");
    {
        printf(m->autofocus_time_left_s_known ? "true" : "false");
    }
    printf(", \"autofocus_time_left_s\": ");
    if (!(m->autofocus_time_left_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->autofocus_time_left_s);
    }
    printf(", \"autofocus_images\": ");
    {
        printf("%lu", (unsigned long)m->autofocus_images);
    }
    printf(", \"autofocus_best_known\": ");
    {
        printf(m->autofocus_best_known ? "true" : "false");
    }
    printf(", \"best_focus_counts\": ");
    if (!(m->autofocus_best_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->best_focus_counts);
    }
    printf(", \"sigma_best_focus_counts\": ");
    if (!(m->autofocus_best_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_best_focus_counts);
    }
    printf(", \"best_focus_drift_counts_min\": ");
    if (!(m->autofocus_best_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->best_focus_drift_counts_min);
    }
    printf(", \"autofocus_ending_known\": ");
    {
        printf(m->autofocus_ending_known ? "true" : "false");
    }
    printf(", \"autofocus_ending\": ");
    if (!(m->autofocus_ending_known))
        printf("null");
    else
    {
        print_code(m->autofocus_ending, (const char *const[]){"found", "edge_low", "edge_high", "no_peak", "too_few", "not_confirmed", "timed_out", "aborted", "stopped", "lens_failed", "better", "worse"});
    }
    printf(", \"focus_estimate_known\": ");
    {
        printf(m->focus_estimate_known ? "true" : "false");
    }
    printf(", \"star_width_px\": ");
    if (!(m->focus_estimate_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->star_width_px);
    }
    printf(", \"focus_distance_counts\": ");
    if (!(m->focus_estimate_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->focus_distance_counts);
    }
    printf(", \"sigma_focus_distance_counts\": ");
    if (!(m->focus_estimate_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->sigma_focus_distance_counts);
    }
    printf(", \"focus_distance_calibrated\": ");
    if (!(m->focus_estimate_known))
        printf("null");
    else
    {
        printf(m->focus_distance_calibrated ? "true" : "false");
    }
    printf(", \"star_width_px_per_hour_known\": ");
    {
        printf(m->star_width_px_per_hour_known ? "true" : "false");
    }
    printf(", \"star_width_px_per_hour\": ");
    if (!(m->focus_estimate_known && m->star_width_px_per_hour_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->star_width_px_per_hour);
    }
    printf(", \"star_width_px_per_kelvin_known\": ");
    {
        printf(m->star_width_px_per_kelvin_known ? "true" : "false");
    }
    printf(", \"star_width_px_per_kelvin\": ");
    if (!(m->focus_estimate_known && m->star_width_px_per_kelvin_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->star_width_px_per_kelvin);
    }
    printf(", \"simulated_housekeeping\": ");
    {
        printf(m->simulated_housekeeping ? "true" : "false");
    }
    printf(", \"temperature_lens_age_s_known\": ");
    {
        printf(m->temperature_lens_age_s_known ? "true" : "false");
    }
    printf(", \"temperature_lens_age_s\": ");
    if (!(m->temperature_lens_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_lens_age_s);
    }
    printf(", \"temperature_computer_age_s_known\": ");
    {
        printf(m->temperature_computer_age_s_known ? "true" : "false");
    }
    printf(", \"temperature_computer_age_s\": ");
    if (!(m->temperature_computer_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_computer_age_s);
    }
    printf(", \"temperature_vessel_age_s_known\": ");
    {
        printf(m->temperature_vessel_age_s_known ? "true" : "false");
    }
    printf(", \"temperature_vessel_age_s\": ");
    if (!(m->temperature_vessel_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_vessel_age_s);
    }
    printf(", \"temperature_plate_age_s_known\": ");
    {
        printf(m->temperature_plate_age_s_known ? "true" : "false");
    }
    printf(", \"temperature_plate_age_s\": ");
    if (!(m->temperature_plate_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_plate_age_s);
    }
    printf(", \"temperature_dcdc_age_s_known\": ");
    {
        printf(m->temperature_dcdc_age_s_known ? "true" : "false");
    }
    printf(", \"temperature_dcdc_age_s\": ");
    if (!(m->temperature_dcdc_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_dcdc_age_s);
    }
    printf(", \"temperature_flange_age_s_known\": ");
    {
        printf(m->temperature_flange_age_s_known ? "true" : "false");
    }
    printf(", \"temperature_flange_age_s\": ");
    if (!(m->temperature_flange_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->temperature_flange_age_s);
    }
    printf(", \"pressure_age_s_known\": ");
    {
        printf(m->pressure_age_s_known ? "true" : "false");
    }
    printf(", \"pressure_age_s\": ");
    if (!(m->pressure_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->pressure_age_s);
    }
    printf(", \"disk_free_age_s_known\": ");
    {
        printf(m->disk_free_age_s_known ? "true" : "false");
    }
    printf(", \"disk_free_age_s\": ");
    if (!(m->disk_free_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->disk_free_age_s);
    }
    printf(", \"temperature_lens_alarm\": ");
    {
        printf(m->temperature_lens_alarm ? "true" : "false");
    }
    printf(", \"temperature_computer_alarm\": ");
    {
        printf(m->temperature_computer_alarm ? "true" : "false");
    }
    printf(", \"temperature_vessel_alarm\": ");
    {
        printf(m->temperature_vessel_alarm ? "true" : "false");
    }
    printf(", \"temperature_plate_alarm\": ");
    {
        printf(m->temperature_plate_alarm ? "true" : "false");
    }
    printf(", \"temperature_dcdc_alarm\": ");
    {
        printf(m->temperature_dcdc_alarm ? "true" : "false");
    }
    printf(", \"temperature_flange_alarm\": ");
    {
        printf(m->temperature_flange_alarm ? "true" : "false");
    }
    printf(", \"pressure_alarm\": ");
    {
        printf(m->pressure_alarm ? "true" : "false");
    }
    printf(", \"disk_free_alarm\": ");
    {
        printf(m->disk_free_alarm ? "true" : "false");
    }
    printf(", \"disk_days_left_known\": ");
    {
        printf(m->disk_days_left_known ? "true" : "false");
    }
    printf(", \"disk_days_left\": ");
    if (!(m->disk_days_left_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->disk_days_left);
    }
    printf(", \"run_number_known\": ");
    {
        printf(m->run_number_known ? "true" : "false");
    }
    printf(", \"run_number\": ");
    if (!(m->run_number_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->run_number);
    }
    printf(", \"last_end_known\": ");
    {
        printf(m->last_end_known ? "true" : "false");
    }
    printf(", \"last_end\": ");
    if (!(m->last_end_known))
        printf("null");
    else
    {
        print_code(m->last_end, (const char *const[]){"clean", "commanded", "crashed", "computer_restarted"});
    }
    printf(", \"kept_at_start\": ");
    {
        print_code(m->kept_at_start, (const char *const[]){"nothing", "whole", "one_copy", "damaged"});
    }
    printf(", \"restarts_lens\": ");
    {
        printf("%lu", (unsigned long)m->restarts_lens);
    }
    printf(", \"restarts_ledger\": ");
    {
        printf("%lu", (unsigned long)m->restarts_ledger);
    }
    printf(", \"restarts_housekeeping\": ");
    {
        printf("%lu", (unsigned long)m->restarts_housekeeping);
    }
    printf(", \"restarts_archive\": ");
    {
        printf("%lu", (unsigned long)m->restarts_archive);
    }
    printf(", \"shed\": ");
    {
        print_code(m->shed, (const char *const[]){"nothing", "display", "images", "solving"});
    }
    printf(", \"images_kept\": ");
    {
        printf("%lu", (unsigned long)m->images_kept);
    }
    printf(", \"images_lost\": ");
    {
        printf("%lu", (unsigned long)m->images_lost);
    }
    printf(", \"images_thinned\": ");
    {
        printf("%lu", (unsigned long)m->images_thinned);
    }
    printf(", \"images_disk_errors\": ");
    {
        printf("%lu", (unsigned long)m->images_disk_errors);
    }
    printf(", \"copies_kept\": ");
    {
        printf("%lu", (unsigned long)m->copies_kept);
    }
    printf(", \"copies_lost\": ");
    {
        printf("%lu", (unsigned long)m->copies_lost);
    }
    printf(", \"copies_thinned\": ");
    {
        printf("%lu", (unsigned long)m->copies_thinned);
    }
    printf(", \"copies_disk_errors\": ");
    {
        printf("%lu", (unsigned long)m->copies_disk_errors);
    }
    printf(", \"last_restart_known\": ");
    {
        printf(m->last_restart_known ? "true" : "false");
    }
    printf(", \"last_restart\": ");
    if (!(m->last_restart_known))
        printf("null");
    else
    {
        print_code(m->last_restart, (const char *const[]){"camera", "lens", "solver", "hub", "recorder", "ledger", "listener", "session", "housekeeping", "legacy_listener", "archive", "display"});
    }
    printf(", \"last_restart_reason\": ");
    {
        print_text(m->last_restart_reason, 64);
    }
    printf(", \"last_restart_age_s_known\": ");
    {
        printf(m->last_restart_age_s_known ? "true" : "false");
    }
    printf(", \"last_restart_age_s\": ");
    if (!(m->last_restart_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->last_restart_age_s);
    }
    printf(", \"series_known\": ");
    {
        printf(m->series_known ? "true" : "false");
    }
    printf(", \"missing_packets\": ");
    if (!(m->series_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->missing_packets);
    }
    printf(", \"missed_images\": ");
    if (!(m->series_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->missed_images);
    }
    printf(", \"start_known\": ");
    {
        printf(m->start_known ? "true" : "false");
    }
    printf(", \"start_ra_deg\": ");
    if (!(m->series_known && m->start_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->start_ra_deg);
    }
    printf(", \"start_dec_deg\": ");
    if (!(m->series_known && m->start_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->start_dec_deg);
    }
    printf(", \"start_roll_deg\": ");
    if (!(m->series_known && m->start_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->start_roll_deg);
    }
    printf(", \"start_sigma_east_arcsec\": ");
    if (!(m->series_known && m->start_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->start_sigma_east_arcsec);
    }
    printf(", \"start_sigma_north_arcsec\": ");
    if (!(m->series_known && m->start_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->start_sigma_north_arcsec);
    }
    printf(", \"start_before_middle_s\": ");
    if (!(m->series_known && m->start_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->start_before_middle_s);
    }
    printf(", \"clocks_count\": ");
    {
        printf("%lu", (unsigned long)m->clocks_count);
    }
    printf(", \"clocks\": ");
    {
        printf("[");
        for (size_t i = 0; i < m->clocks_count; i++) {
        printf(i ? ", " : "");
        print_peer_clock(&m->clocks[i]);
        }
        printf("]");
    }
    printf(", \"exposing\": ");
    {
        print_code(m->exposing, (const char *const[]){"asked", "trigger", "itself"});
    }
    printf(", \"last_triggered_age_s_known\": ");
    {
        printf(m->last_triggered_age_s_known ? "true" : "false");
    }
    printf(", \"last_triggered_age_s\": ");
    if (!(m->last_triggered_age_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->last_triggered_age_s);
    }
    printf(", \"triggers_stayed_away\": ");
    {
        printf("%lu", (unsigned long)m->triggers_stayed_away);
    }
    printf(", \"image_exposed_by_known\": ");
    {
        printf(m->image_exposed_by_known ? "true" : "false");
    }
    printf(", \"image_exposed_by\": ");
    if (!(m->image_exposed_by_known))
        printf("null");
    else
    {
        print_code(m->image_exposed_by, (const char *const[]){"asked", "trigger", "itself"});
    }
    printf(", \"clock_sigma_s_known\": ");
    {
        printf(m->clock_sigma_s_known ? "true" : "false");
    }
    printf(", \"clock_sigma_s\": ");
    if (!(m->clock_sigma_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->clock_sigma_s);
    }
    printf(", \"captured_sigma_s_known\": ");
    {
        printf(m->captured_sigma_s_known ? "true" : "false");
    }
    printf(", \"captured_sigma_s\": ");
    if (!(m->captured_sigma_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->captured_sigma_s);
    }
    printf(", \"captured_uptime_s_known\": ");
    {
        printf(m->captured_uptime_s_known ? "true" : "false");
    }
    printf(", \"captured_uptime_s\": ");
    if (!(m->captured_uptime_s_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->captured_uptime_s);
    }
    printf("}");
}

static void print_exposure(const stars_exposure_t *m)
{
    printf("{\"start_s\": ");
    {
        printf("%.17g", (double)m->start_s);
    }
    printf(", \"duration_s\": ");
    {
        printf("%.17g", (double)m->duration_s);
    }
    printf("}");
}

static void print_rates(const stars_rates_t *m)
{
    printf("{\"az_rate_deg_s\": ");
    {
        printf("%.17g", (double)m->az_rate_deg_s);
    }
    printf(", \"el_rate_deg_s\": ");
    {
        printf("%.17g", (double)m->el_rate_deg_s);
    }
    printf("}");
}

static void print_gyro(const stars_gyro_t *m)
{
    printf("{\"trigger_counter\": ");
    {
        printf("%lu", (unsigned long)m->trigger_counter);
    }
    printf(", \"image_counter\": ");
    {
        printf("%lu", (unsigned long)m->image_counter);
    }
    printf(", \"start_uptime_s\": ");
    {
        printf("%.17g", (double)m->start_uptime_s);
    }
    printf(", \"sample_rate_hz\": ");
    {
        printf("%.17g", (double)m->sample_rate_hz);
    }
    printf(", \"elevation_deg_known\": ");
    {
        printf(m->elevation_deg_known ? "true" : "false");
    }
    printf(", \"elevation_deg\": ");
    if (!(m->elevation_deg_known))
        printf("null");
    else
    {
        printf("%.17g", (double)m->elevation_deg);
    }
    printf(", \"exposures_count\": ");
    {
        printf("%lu", (unsigned long)m->exposures_count);
    }
    printf(", \"exposures\": ");
    {
        printf("[");
        for (size_t i = 0; i < m->exposures_count; i++) {
        printf(i ? ", " : "");
        print_exposure(&m->exposures[i]);
        }
        printf("]");
    }
    printf(", \"samples_count\": ");
    {
        printf("%lu", (unsigned long)m->samples_count);
    }
    printf(", \"samples\": ");
    {
        printf("[");
        for (size_t i = 0; i < m->samples_count; i++) {
        printf(i ? ", " : "");
        print_rates(&m->samples[i]);
        }
        printf("]");
    }
    printf("}");
}

static void print_command_slot(const stars_command_slot_t *m)
{
    printf("{\"command\": ");
    {
        printf("%lu", (unsigned long)m->command);
    }
    printf(", \"act\": ");
    {
        printf("%lu", (unsigned long)m->act);
    }
    printf(", \"counter\": ");
    {
        printf("%lu", (unsigned long)m->counter);
    }
    printf(", \"age_s\": ");
    {
        printf("%.17g", (double)m->age_s);
    }
    printf(", \"values\": ");
    {
        printf("[");
        for (size_t i = 0; i < 8; i++) {
        printf(i ? ", " : "");
        printf("%.17g", (double)m->values[i]);
        }
        printf("]");
    }
    printf(", \"seal\": ");
    {
        printf("%lu", (unsigned long)m->seal);
    }
    printf("}");
}

static void print_commands(const stars_commands_t *m)
{
    printf("{\"sequence\": ");
    {
        printf("%lu", (unsigned long)m->sequence);
    }
    printf(", \"boot_id\": ");
    {
        printf("%lu", (unsigned long)m->boot_id);
    }
    printf(", \"camera_boot_id\": ");
    {
        printf("%lu", (unsigned long)m->camera_boot_id);
    }
    printf(", \"lease_epoch\": ");
    {
        printf("%lu", (unsigned long)m->lease_epoch);
    }
    printf(", \"last_update_sequence_known\": ");
    {
        printf(m->last_update_sequence_known ? "true" : "false");
    }
    printf(", \"last_update_sequence\": ");
    if (!(m->last_update_sequence_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->last_update_sequence);
    }
    printf(", \"acknowledged\": ");
    {
        printf("%lu", (unsigned long)m->acknowledged);
    }
    printf(", \"slots_count\": ");
    {
        printf("%lu", (unsigned long)m->slots_count);
    }
    printf(", \"slots\": ");
    {
        printf("[");
        for (size_t i = 0; i < m->slots_count; i++) {
        printf(i ? ", " : "");
        print_command_slot(&m->slots[i]);
        }
        printf("]");
    }
    printf(", \"tag_known\": ");
    {
        printf(m->tag_known ? "true" : "false");
    }
    printf(", \"tag\": ");
    if (!(m->tag_known))
        printf("null");
    else
    {
        printf("[");
        for (size_t i = 0; i < 32; i++) {
        printf(i ? ", " : "");
        printf("%lu", (unsigned long)m->tag[i]);
        }
        printf("]");
    }
    printf("}");
}

static void print_image_request(const stars_image_request_t *m)
{
    printf("{\"request\": ");
    {
        printf("%lu", (unsigned long)m->request);
    }
    printf(", \"wanted\": ");
    {
        print_code(m->wanted, (const char *const[]){"image", "newest", "next"});
    }
    printf(", \"camera_boot_id_known\": ");
    {
        printf(m->camera_boot_id_known ? "true" : "false");
    }
    printf(", \"camera_boot_id\": ");
    if (!(m->camera_boot_id_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->camera_boot_id);
    }
    printf(", \"image_counter_known\": ");
    {
        printf(m->image_counter_known ? "true" : "false");
    }
    printf(", \"image_counter\": ");
    if (!(m->image_counter_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->image_counter);
    }
    printf(", \"exposure\": ");
    {
        printf("%lu", (unsigned long)m->exposure);
    }
    printf(", \"form\": ");
    {
        print_code(m->form, (const char *const[]){"raw", "view"});
    }
    printf(", \"offset\": ");
    {
        printf("%lu", (unsigned long)m->offset);
    }
    printf(", \"begun_crc32_known\": ");
    {
        printf(m->begun_crc32_known ? "true" : "false");
    }
    printf(", \"begun_crc32\": ");
    if (!(m->begun_crc32_known))
        printf("null");
    else
    {
        printf("%lu", (unsigned long)m->begun_crc32);
    }
    printf(", \"rate_bytes_s\": ");
    {
        printf("%lu", (unsigned long)m->rate_bytes_s);
    }
    printf("}");
}

static void print_image_chunk(const stars_image_chunk_t *m)
{
    printf("{\"request\": ");
    {
        printf("%lu", (unsigned long)m->request);
    }
    printf(", \"camera_boot_id\": ");
    {
        printf("%lu", (unsigned long)m->camera_boot_id);
    }
    printf(", \"image_counter\": ");
    {
        printf("%lu", (unsigned long)m->image_counter);
    }
    printf(", \"exposure\": ");
    {
        printf("%lu", (unsigned long)m->exposure);
    }
    printf(", \"exposures\": ");
    {
        printf("%lu", (unsigned long)m->exposures);
    }
    printf(", \"form\": ");
    {
        print_code(m->form, (const char *const[]){"raw", "view"});
    }
    printf(", \"total_bytes\": ");
    {
        printf("%lu", (unsigned long)m->total_bytes);
    }
    printf(", \"file_crc32\": ");
    {
        printf("%lu", (unsigned long)m->file_crc32);
    }
    printf(", \"offset\": ");
    {
        printf("%lu", (unsigned long)m->offset);
    }
    printf(", \"bytes_count\": ");
    {
        printf("%lu", (unsigned long)m->bytes_count);
    }
    printf(", \"bytes\": ");
    {
        printf("[");
        for (size_t i = 0; i < m->bytes_count; i++) {
        printf(i ? ", " : "");
        printf("%lu", (unsigned long)m->bytes[i]);
        }
        printf("]");
    }
    printf("}");
}

static void print_image_refusal(const stars_image_refusal_t *m)
{
    printf("{\"request\": ");
    {
        printf("%lu", (unsigned long)m->request);
    }
    printf(", \"no_image\": ");
    {
        print_code(m->no_image, (const char *const[]){"never_was", "not_kept", "changed", "offset", "rate", "no_number", "disk", "form", "busy"});
    }
    printf(", \"words\": ");
    {
        print_text(m->words, 96);
    }
    printf("}");
}

static int print_body(uint8_t kind, const uint8_t *body)
{
    switch (kind) {
    case STARS_KIND_HELLO:
        print_hello((const stars_hello_t *)(const void *)body);
        return 0;
    case STARS_KIND_REFUSE:
        print_refuse((const stars_refuse_t *)(const void *)body);
        return 0;
    case STARS_KIND_STATUS:
        print_status((const stars_status_t *)(const void *)body);
        return 0;
    case STARS_KIND_UPDATE:
        print_update((const stars_update_t *)(const void *)body);
        return 0;
    case STARS_KIND_GYRO:
        print_gyro((const stars_gyro_t *)(const void *)body);
        return 0;
    case STARS_KIND_COMMANDS:
        print_commands((const stars_commands_t *)(const void *)body);
        return 0;
    case STARS_KIND_IMAGE_REQUEST:
        print_image_request((const stars_image_request_t *)(const void *)body);
        return 0;
    case STARS_KIND_IMAGE_CHUNK:
        print_image_chunk((const stars_image_chunk_t *)(const void *)body);
        return 0;
    case STARS_KIND_IMAGE_REFUSAL:
        print_image_refusal((const stars_image_refusal_t *)(const void *)body);
        return 0;
    default:
        return 1;
    }
}
