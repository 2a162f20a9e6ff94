
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
