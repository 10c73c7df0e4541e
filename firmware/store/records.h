/*
 * The small binary files: reference, learned input, pending trial, parameters, uploads.
 *
 * All of one shape, little-endian: magic (4 characters), version u16, count u16, body, CRC-32 of all
 * before it (docs/protocol.md has every offset). Encoding never fails; decoding checks magic,
 * version, length, CRC and values, and touches its output only when all are right.
 * Pure functions over byte buffers; not for interrupts.
 */
#ifndef STORE_RECORDS_H
#define STORE_RECORDS_H

#include "base/units.h"
#include "ilc/memory.h"
#include "params/params.h"
#include "speed/speed.h"
#include "supervisor/faults.h"

#include <stddef.h>
#include <stdint.h>

/* The longest record (learned input, 512 beats) and so the size of the shared buffer. */
#define RECORD_MAX_BYTES (40u + 2u * 4u * BEATS_MAX + 4u)
_Static_assert(RECORD_MAX_BYTES < 2u * 4u * BEATS_MAX + 64u, "one learned input and a header");

typedef struct {
    uint16_t beats; /* 0 = none */
    uint32_t crc;   /* CRC-32 of the record's bytes: the reference's identity */
    float beat_s;
    float speed_m_s[BEATS_MAX];
} reference_t;

/* A trial that was swum, until it is learned from or discarded. */
typedef struct {
    uint32_t number; /* 0 = none */
    uint32_t reference_crc;
    uint16_t iteration;
    uint16_t beats;    /* of the reference */
    uint16_t executed; /* beats swum to their end */
    uint16_t source;   /* speed_source_t */
    uint16_t end;      /* fault_t: NONE = complete */
    float amplitude_rad[BEATS_MAX]; /* as swum (saturated) */
    float speed_m_s[BEATS_MAX];     /* NaN = not measured */
    float sigma_m_s[BEATS_MAX];
} trial_t;

/* Uploads. */
typedef struct {
    uint32_t trial;
    uint16_t beats;
    float speed_m_s[BEATS_MAX]; /* NaN = not measured */
    float sigma_m_s[BEATS_MAX];
} speed_upload_t;

typedef struct {
    uint32_t reference_crc; /* must match the board's */
    uint16_t beats;
    float amplitude_rad[BEATS_MAX];
} amplitudes_upload_t;

/* Encoders return the number of bytes written; |out| holds RECORD_TRIAL_MAX_BYTES or RECORD_MAX_BYTES. */
#define RECORD_TRIAL_MAX_BYTES (40u + 3u * 4u * BEATS_MAX + 4u)
size_t record_encode_reference(const reference_t *reference, uint8_t *out);
size_t record_encode_memory(const memory_t *memory, uint8_t *out);
size_t record_encode_trial(const trial_t *trial, uint8_t *out);
size_t record_encode_params(const params_t *params, uint8_t *out);

/* FAULT_NONE, FAULT_BAD_FORMAT (magic, version, length, CRC) or FAULT_BAD_DATA (values). */
fault_t record_decode_reference(const uint8_t *bytes, size_t length, reference_t *reference);
fault_t record_decode_memory(const uint8_t *bytes, size_t length, memory_t *memory);
fault_t record_decode_trial(const uint8_t *bytes, size_t length, trial_t *trial);
fault_t record_decode_speeds(const uint8_t *bytes, size_t length, speed_upload_t *speeds);
fault_t record_decode_amplitudes(const uint8_t *bytes, size_t length, amplitudes_upload_t *amplitudes);

/* Parameters are stored by name: unknown names are skipped, missing ones keep their default, values
 * out of range keep their default; |ignored| counts both kinds. */
fault_t record_decode_params(const uint8_t *bytes, size_t length, params_t *params, uint16_t *ignored);

#endif
