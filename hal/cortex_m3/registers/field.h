/*
 * Bit fields of hardware registers.
 *
 * The headers of registers hold what is used of a chip, under the names of its datasheet: a struct
 * per peripheral, laid over its registers (32-bit accesses only; read-only ones are
 * const), and a mask PERIPHERAL_REGISTER_FIELD per field. A value that a field may take is
 * PERIPHERAL_REGISTER_FIELD_VALUE. A test compares those of the ATSAM3X8E with the vendor's SVD
 * file.
 */
#ifndef REGISTERS_FIELD_H
#define REGISTERS_FIELD_H

#include <assert.h>
#include <stddef.h>
#include <stdint.h>

/* Lowest bit of |mask|. */
#define FIELD_UNIT(mask) ((mask) & (~(mask) + 1u))

/* |value| moved to where the field |mask| is. */
#define FIELD(mask, value) (((uint32_t)(value)*FIELD_UNIT(mask)) & (mask))

/* What the field |mask| of |word| holds. */
#define FIELD_OF(word, mask) (((word) & (mask)) / FIELD_UNIT(mask))

#define REGISTER_AT(type, member, offset)                                                          \
    static_assert(offsetof(type, member) == (offset), #type "." #member " is misplaced")

#endif
