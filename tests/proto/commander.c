/* A flight computer in C: commander PORT CODE VALUE…, claims the charge, gives one command when it has the lease, and prints each
 * stage that it reaches. Ends with 0 when the command is completed. */
#include "stars_icd.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define BOOT 0x0BADCAFEu
static int camera_socket;
static uint8_t received[2 * STARS_MAX_FRAME];
static size_t received_size;

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static void send_message(uint8_t kind, const void *body, size_t size)
{
    static uint8_t frame[STARS_MAX_FRAME];
    size_t whole = stars_put_frame(frame, sizeof frame, kind, body, size);
    if (whole == 0 || write(camera_socket, frame, whole) != (ssize_t)whole)
        exit(3);
}

static void send_hello(void)
{
    stars_hello_t hello;
    memset(&hello, 0, sizeof hello);
    memcpy(hello.magic, "STARSCAM", 8);
    hello.version_min = STARS_VERSION_CURRENT;
    hello.version_current = STARS_VERSION_CURRENT;
    hello.role = STARS_ROLE_FLIGHT_COMPUTER;
    hello.id = 1;
    memcpy(hello.name, "commander", 9);
    hello.boot_id = BOOT;
    send_message(STARS_KIND_HELLO, &hello, sizeof hello);
}

int main(int argc, char **argv)
{
    if (argc < 3)
        return 2;
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(argv[1]))};
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    camera_socket = socket(AF_INET, SOCK_STREAM, 0);
    if (connect(camera_socket, (struct sockaddr *)&address, sizeof address) != 0)
        return 3;
    send_hello();

    double started = now(), due = -1, given = -1;
    uint32_t sequence = 0, camera_boot = 0, epoch = 0, heard = 0, acknowledged = 0;
    int in_charge = 0, has_heard = 0;
    stars_command_slot_t slot;
    while (now() - started < 60) {
        if (due >= 0 && now() >= due) {
            stars_status_t status;
            memset(&status, 0, sizeof status);
            status.sequence = sequence;
            status.boot_id = BOOT;
            status.uptime_s = now() - started;
            status.claims_charge = 1;
            status.clock_quality = STARS_CLOCK_QUALITY_UNSET;
            status.last_update_sequence_known = (uint8_t)has_heard;
            status.last_update_sequence = heard;
            send_message(STARS_KIND_STATUS, &status, sizeof status);

            stars_commands_t block;
            memset(&block, 0, sizeof block);
            block.sequence = sequence++;
            block.boot_id = BOOT;
            block.camera_boot_id = camera_boot;
            block.lease_epoch = epoch;
            block.last_update_sequence_known = (uint8_t)has_heard;
            block.last_update_sequence = heard;
            block.acknowledged = acknowledged;
            if (in_charge && given < 0) {
                double values[8] = {0};
                for (int i = 3; i < argc && i < 11; i++)
                    values[i - 3] = atof(argv[i]);
                given = now();
                slot = stars_command(atoi(argv[2]), STARS_ACT_RUN, 1, values);
            }
            if (given >= 0) {
                slot.age_s = now() - given;
                block.slots_count = 1;
                block.slots[0] = slot;
            }
            send_message(STARS_KIND_COMMANDS, &block, sizeof block);
            due += 0.5;
        }
        fd_set ready;
        FD_ZERO(&ready);
        FD_SET(camera_socket, &ready);
        struct timeval wait = {.tv_usec = 20000};
        if (select(camera_socket + 1, &ready, NULL, NULL, &wait) <= 0)
            continue;
        ssize_t got = read(camera_socket, received + received_size, sizeof received - received_size);
        if (got <= 0)
            return 3;
        received_size += (size_t)got;
        stars_frame_t frame;
        long done;
        while ((done = stars_take_frame(received, received_size, &frame)) > 0) {
            if (frame.body && frame.kind == STARS_KIND_HELLO) {
                camera_boot = ((const stars_hello_t *)frame.body)->boot_id;
                due = now();
            } else if (frame.body && frame.kind == STARS_KIND_UPDATE) {
                const stars_update_t *update = (const stars_update_t *)frame.body;
                has_heard = 1;
                heard = update->sequence;
                epoch = update->lease_epoch;
                in_charge = update->you_are_in_charge;
                for (int i = 0; i < update->replies_count; i++) {
                    const stars_command_reply_t *reply = &update->replies[i];
                    if (reply->serial <= acknowledged)
                        continue;
                    acknowledged = reply->serial;
                    printf("command %u stage %u: %.64s\n", reply->command, reply->stage, reply->words);
                    if (reply->command == atoi(argv[2]) && reply->stage >= STARS_STAGE_COMPLETED)
                        return reply->stage == STARS_STAGE_COMPLETED ? 0 : 1;
                }
            }
            memmove(received, received + done, received_size - (size_t)done);
            received_size -= (size_t)done;
        }
        if (done < 0)
            return 3;
    }
    return 4;
}
