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

