/* A flight computer in C, as an example: example PORT [CODE VALUE…]
 *
 * Connects to the camera on this computer, again every 9 s where that fails, tells it every 0.5 s who and where it is, prints each new
 * solution, and claims the charge. With a command (its code and values, as in ICD.md) it gives that once it has the lease, prints each stage
 * that it reaches, and ends with 0 when the command is completed, 1 when it is not. Without one it ends with 0 after five solutions.
 *
 *     cc -std=gnu11 -I proto -o example proto/example.c && ./example 2017 22
 *
 * GUIDE.md goes through it part by part. No memory is asked for, and nothing waits for longer than 20 ms: the loop fits into one that has
 * other things to do. */
#include "stars_icd.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define PERIOD_S 0.5  /* between two statuses */
#define RETRY_S 9.0   /* before connecting again */
#define SILENCE_S 5.0 /* without an update the link is dead */
#define GIVE_UP_S 60.0
#define SOLUTIONS 5

/* What this flight computer is and knows. */
static uint32_t boot_id;
static double started;
static int port, command_code, values_given;
static double values[8];

/* The link, and what came over it. */
static int camera = -1;
static uint8_t received[2 * STARS_MAX_FRAME];
static size_t received_size;
static double due, heard_at;
static uint32_t sequence, camera_boot, lease, heard, acknowledged;
static int has_heard, in_charge, greeted;

/* The command, its counter, and how far it has come. */
static stars_command_slot_t slot;
static double given = -1;
static int stage, solutions;
static uint32_t last_image;
static int has_image;

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static void close_link(const char *why)
{
    printf("closed: %s\n", why);
    close(camera);
    camera = -1;
}

static void send_message(uint8_t kind, const void *body, size_t size)
{
    static uint8_t frame[STARS_MAX_FRAME];
    size_t whole = stars_put_frame(frame, sizeof frame, kind, body, size);
    /* Some kB a second: what the kernel does not take at once is a link that is stuck. */
    if (camera >= 0 && send(camera, frame, whole, MSG_NOSIGNAL | MSG_DONTWAIT) != (ssize_t)whole)
        close_link("the link does not take a message");
}

/* Part 1: the link, and who we are. */
static void open_link(void)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    camera = socket(AF_INET, SOCK_STREAM, 0);
    if (connect(camera, (struct sockaddr *)&address, sizeof address) != 0) {
        close_link("no camera there");
        return;
    }
    int yes = 1;
    setsockopt(camera, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    received_size = 0;
    has_heard = in_charge = greeted = 0;
    sequence = acknowledged = 0;
    heard_at = now();

    stars_hello_t hello;
    memset(&hello, 0, sizeof hello); /* What is not known is 0, and its flag too. */
    memcpy(hello.magic, "STARSCAM", 8);
    hello.version_min = STARS_VERSION_CURRENT;
    hello.version_current = STARS_VERSION_CURRENT;
    hello.role = STARS_ROLE_FLIGHT_COMPUTER;
    hello.id = 1;
    memcpy(hello.name, "example", 7);
    hello.boot_id = boot_id;
    send_message(STARS_KIND_HELLO, &hello, sizeof hello);
}

/* Part 2: every 0.5 s, who and where we are. */
static void send_status(void)
{
    stars_status_t status;
    memset(&status, 0, sizeof status);
    status.sequence = sequence;
    status.boot_id = boot_id;
    status.uptime_s = now() - started;
    status.claims_charge = 1;
    status.clock_quality = STARS_CLOCK_QUALITY_UNSET;
    status.observer_known = 1; /* With it there are azimuth and elevation: a flight program gives its own. */
    status.latitude_deg = -77.86;
    status.sidereal_time_h = 8.25;
    status.last_update_sequence_known = (uint8_t)has_heard;
    status.last_update_sequence = heard;
    send_message(STARS_KIND_STATUS, &status, sizeof status);
}

/* Part 3: what the ground commands. The slot is made once, and repeated until its last stage came. */
static void send_commands(void)
{
    stars_commands_t block;
    memset(&block, 0, sizeof block);
    block.sequence = sequence;
    block.boot_id = boot_id;
    block.camera_boot_id = camera_boot;
    block.lease_epoch = lease;
    block.last_update_sequence_known = (uint8_t)has_heard;
    block.last_update_sequence = heard;
    block.acknowledged = acknowledged;
    if (command_code != 0 && in_charge && given < 0) {
        given = now();
        slot = stars_command(command_code, STARS_ACT_RUN, 1, values);
    }
    if (given >= 0 && stage < STARS_STAGE_COMPLETED) {
        slot.age_s = now() - given;
        block.slots_count = 1;
        block.slots[0] = slot;
    }
    send_message(STARS_KIND_COMMANDS, &block, sizeof block);
}

/* Part 4: what the camera says. */
static void take_update(const stars_update_t *update)
{
    has_heard = 1;
    heard_at = now();
    heard = update->sequence;
    lease = update->lease_epoch;
    in_charge = update->you_are_in_charge;
    if (update->image_known && (!has_image || update->image_counter != last_image)) {
        has_image = 1;
        last_image = update->image_counter;
        if (update->equatorial_known) {
            /* σ is one standard deviation on the sky: its square is the variance that a filter wants. */
            printf("image %u ra %.5f dec %.5f roll %.4f deg, variance %.4f %.4f arcsec^2\n", update->image_counter, update->ra_deg,
                   update->dec_deg, update->roll_deg, update->sigma_east_arcsec * update->sigma_east_arcsec,
                   update->sigma_north_arcsec * update->sigma_north_arcsec);
            solutions++;
        } else {
            printf("image %u not solved: reason %u: %.120s\n", update->image_counter, update->reason, update->detail);
        }
    }
    for (int i = 0; i < update->replies_count; i++) {
        const stars_command_reply_t *reply = &update->replies[i];
        if (reply->serial <= acknowledged)
            continue; /* Seen; the camera repeats it until it knows that. */
        acknowledged = reply->serial;
        printf("command %u stage %u: %.64s\n", reply->command, reply->stage, reply->words);
        if (given >= 0 && reply->command == slot.command && reply->counter == slot.counter)
            stage = reply->stage;
    }
}

static void take_bytes(void)
{
    ssize_t got = recv(camera, received + received_size, sizeof received - received_size, 0);
    if (got <= 0) {
        close_link("the camera closed the connection");
        return;
    }
    received_size += (size_t)got;
    stars_frame_t frame;
    long done;
    while ((done = stars_take_frame(received, received_size, &frame)) > 0) {
        if (frame.body && frame.kind == STARS_KIND_HELLO) {
            camera_boot = ((const stars_hello_t *)frame.body)->boot_id;
            greeted = 1;
            due = now(); /* The schedule begins here, and stands still from then on. */
        } else if (frame.body && frame.kind == STARS_KIND_REFUSE) {
            close_link("the camera refuses");
            return;
        } else if (frame.body && frame.kind == STARS_KIND_UPDATE) {
            take_update((const stars_update_t *)frame.body);
        }
        memmove(received, received + done, received_size - (size_t)done);
        received_size -= (size_t)done;
    }
    if (done < 0)
        close_link("a frame is broken");
}

/* Part 5: the loop. */
int main(int argc, char **argv)
{
    if (argc < 2 || argc > 11)
        return fprintf(stderr, "example PORT [CODE VALUE...]\n"), 2;
    port = atoi(argv[1]);
    command_code = argc > 2 ? atoi(argv[2]) : 0;
    for (values_given = 0; values_given + 3 < argc && values_given < 8; values_given++)
        values[values_given] = atof(argv[values_given + 3]);
    started = now();
    boot_id = (uint32_t)time(NULL) ^ (uint32_t)getpid() << 16; /* Another one at each start: our counters begin anew. */
    setvbuf(stdout, NULL, _IOLBF, 0);

    double next_try = started;
    while (now() - started < GIVE_UP_S) {
        if (camera < 0) {
            if (now() >= next_try) {
                next_try = now() + RETRY_S;
                open_link();
            }
            usleep(20000);
            continue;
        }
        if (greeted && now() >= due) {
            send_status();
            send_commands();
            sequence++;
            due += PERIOD_S;
        }
        if (camera >= 0 && now() - heard_at > SILENCE_S)
            close_link("the camera is silent");
        if (camera < 0)
            continue;
        fd_set ready;
        FD_ZERO(&ready);
        FD_SET(camera, &ready);
        struct timeval wait = {.tv_usec = 20000};
        if (select(camera + 1, &ready, NULL, NULL, &wait) > 0)
            take_bytes();
        if (stage >= STARS_STAGE_COMPLETED)
            return stage == STARS_STAGE_COMPLETED ? 0 : 1;
        if (command_code == 0 && solutions >= SOLUTIONS)
            return 0;
    }
    return 4;
}
