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
