/* A flight program of old: connects, sends a block every half second, decodes what it is sent, and in between sends blocks that must
 * do nothing. Prints what it saw as one JSON object.
 *
 *     flight PORT OWN_ADDRESS SECONDS */
#define _POSIX_C_SOURCE 200809L
#include "legacy.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define PERIOD_MS 500
#define WINDOW_CS 1500

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}

static void fail(const char *what)
{
    fprintf(stderr, "flight: %s: %s\n", what, errno ? strerror(errno) : "");
    exit(1);
}

/* What the camera has shown. */
static struct {
    long answers, solutions, images, horizontal, unsound;
    int32_t last_image;
    double longest_gap_s, first_s, last_s;
    legacy_answer_t solved;
} seen;

static void take(const legacy_answer_t *answer, double at)
{
    const legacy_channel_t *c = answer->channels;
    if (answer->xsc_protocol_version != LEGACY_VERSION || answer->num_blobs < 0 || answer->num_blobs > LEGACY_BLOBS)
        seen.unsound++;
    if (seen.answers++ == 0)
        seen.first_s = at;
    else if (at - seen.last_s > seen.longest_gap_s)
        seen.longest_gap_s = at - seen.last_s;
    seen.last_s = at;
    if (!c[LEGACY_IMAGE_EQ_VALID].b)
        return;
    seen.solutions++;
    seen.horizontal += c[LEGACY_IMAGE_HOR_VALID].b;
    if (c[LEGACY_IMAGE_CTR_STARS].i != seen.last_image)
        seen.images++;
    seen.last_image = c[LEGACY_IMAGE_CTR_STARS].i;
    seen.solved = *answer;
}

/* The settings that a flight program begins with, as far as a command of this one carries them. */
static void begin(legacy_block_t *block)
{
    memset(block, 0, sizeof *block);
    block->counter_fcp = 7;
    block->network_reset_on_lull_delay = 7200;
    block->main_display_frequency = 10;
    block->solver_enabled = 1;
    block->solver_timeout = 30;
    block->autofocus_search_min = 2300;
    block->autofocus_search_max = 3300;
    block->autofocus_search_step = 10;
    for (int i = 0; i < LEGACY_COMMANDS; i++)
        block->command_admins[i].counter = 3 * i;
    block->xsc_protocol_version = LEGACY_VERSION;
}

/* What is overwritten whenever a block goes out. */
static void overwrite(legacy_block_t *block)
{
    block->in_charge = 1;
    block->horizontal_valid = 1;
    block->horizontal_lat = -1.36;
    block->horizontal_lst = 1.75;
    block->xsc_protocol_version = LEGACY_VERSION;
}

/* The block that goes out in place of the true one, by the number of the block; each must do nothing. */
static void spoil(legacy_block_t *block, long number)
{
    if (number == 16)
        memset(block, 0, sizeof *block);
    if (number == 22 || number == 23)
        for (int i = 0; i < LEGACY_COMMANDS; i++) {
            block->command_admins[i].counter++;
            block->command_admins[i].is_new_countdown = (uint32_t)(WINDOW_CS - 50 * (number - 22));
        }
    if (number >= 30 && number < 33) {
        block->command_admins[LEGACY_SOLVER_ABORT].counter++;
        block->command_admins[LEGACY_SOLVER_ABORT].is_new_countdown = 0;
    }
    if (number == 38 || number == 39)
        block->solver_timeout = 99;
}

static void send_block(int link, legacy_block_t truth, long number)
{
    const uint8_t *bytes = (const uint8_t *)&truth;
    spoil(&truth, number);
    overwrite(&truth);
    /* In two pieces, as a network may deliver them. */
    const size_t half = 1000 + (size_t)(number % 500);
    if (send(link, bytes, half, MSG_NOSIGNAL) != (ssize_t)half)
        fail("send");
    if (send(link, bytes + half, sizeof truth - half, MSG_NOSIGNAL) != (ssize_t)(sizeof truth - half))
        fail("send");
}

static int connect_from(const char *own, int port)
{
    struct sockaddr_in from = {.sin_family = AF_INET}, to = {.sin_family = AF_INET};
    const int link = socket(AF_INET, SOCK_STREAM, 0);
    if (link < 0 || inet_pton(AF_INET, own, &from.sin_addr) != 1 || bind(link, (struct sockaddr *)&from, sizeof from))
        fail("own address");
    to.sin_port = htons((uint16_t)port);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (connect(link, (struct sockaddr *)&to, sizeof to))
        fail("connect");
    return link;
}

static void report(void)
{
    const legacy_channel_t *c = seen.solved.channels;
    printf("{\"answers\": %ld, \"solutions\": %ld, \"images\": %ld, \"horizontal\": %ld, \"unsound\": %ld, ", seen.answers,
           seen.solutions, seen.images, seen.horizontal, seen.unsound);
    printf("\"first_s\": %.3f, \"longest_gap_s\": %.3f, ", seen.first_s, seen.longest_gap_s);
    printf("\"image_ctr_fcp\": %ld, \"matched\": %ld, \"blobs\": %ld, ", (long)c[LEGACY_IMAGE_CTR_FCP].i,
           (long)c[LEGACY_IMAGE_NUM_BLOBS_MATCHED].i, (long)seen.solved.num_blobs);
    printf("\"blob_x\": %.6f, \"blob_y\": %.6f, ", seen.solved.blobs[0].x, seen.solved.blobs[0].y);
    printf("\"ra\": %.12f, \"dec\": %.12f, \"roll\": %.12f, ", c[LEGACY_IMAGE_EQ_RA].d, c[LEGACY_IMAGE_EQ_DEC].d,
           c[LEGACY_IMAGE_EQ_ROLL].d);
    printf("\"sigma_ra\": %.6e, \"sigma_dec\": %.6e, \"sigma_pointing\": %.6e, ", c[LEGACY_IMAGE_EQ_SIGMA_RA].d,
           c[LEGACY_IMAGE_EQ_SIGMA_DEC].d, c[LEGACY_IMAGE_EQ_SIGMA_POINTING].d);
    printf("\"iplate\": %.6e, \"mean\": %.3f}\n", c[LEGACY_IMAGE_EQ_IPLATE].d, c[LEGACY_IMAGE_STATS_MEAN].d);
}

int main(int argc, char **argv)
{
    if (argc != 4)
        fail("usage: flight PORT OWN_ADDRESS SECONDS");
    const int link = connect_from(argv[2], atoi(argv[1]));
    const double started = now_s(), end = started + atof(argv[3]);
    static legacy_block_t block;
    static legacy_answer_t answer;
    size_t got = 0;
    seen.last_image = -1;
    begin(&block);
    for (long number = 0; now_s() < end;) {
        const double due = started + (double)(number + 1) * PERIOD_MS * 1e-3;
        const double wait_s = due - now_s();
        struct pollfd ready = {.fd = link, .events = POLLIN};
        if (wait_s > 0 && poll(&ready, 1, (int)(wait_s * 1e3) + 1) > 0) {
            const ssize_t count = recv(link, (uint8_t *)&answer + got, sizeof answer - got, 0);
            if (count <= 0)
                fail("the camera closed the connection");
            got += (size_t)count;
            if (got == sizeof answer) {
                take(&answer, now_s() - started);
                got = 0;
            }
        }
        if (now_s() < due)
            continue;
        for (int i = 0; i < LEGACY_COMMANDS; i++) {
            uint32_t *countdown = &block.command_admins[i].is_new_countdown;
            *countdown = *countdown > PERIOD_MS / 10 ? *countdown - PERIOD_MS / 10 : 0;
        }
        if (number == 8) { /* the one command */
            block.solver_timeout = 7.5;
            block.command_admins[LEGACY_SOLVER_GENERAL].is_new_countdown = WINDOW_CS;
            block.command_admins[LEGACY_SOLVER_GENERAL].counter++;
        }
        send_block(link, block, number);
        number++;
    }
    close(link);
    report();
    return 0;
}
