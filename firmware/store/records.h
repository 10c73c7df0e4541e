/*
 * The small binary files: reference, learned input, pending trial, past trials, parameters,
 * counter, key, uploads.
 *
 * All of one shape, little-endian: magic (4 characters), version u16, count u16, CRC-32 of all the
 * rest, body (the protocol's page has every offset). Encoding never fails: its input is ours.
 * Decoding checks magic, version, length, CRC and values, and touches its output only when all are
 * right. Pure functions over byte buffers; not for interrupts.
 */
#ifndef STORE_RECORDS_H
#define STORE_RECORDS_H

#include "base/units.h"
#include "hal/system.h"
#include "ilc/memory.h"
#include "ilc/past.h"
#include "params/params.h"
#include "speed/speed.h"
#include "supervisor/faults.h"

#include <stddef.h>
#include <stdint.h>

#define RECORD_HEADER_BYTES 12u
#define RECORD_MAGIC_BYTES 4u
#define RECORD_VERSION 1u
#define RECORD_MEMORY_VERSION 3u
#define RECORD_CRASH_VERSION 2u
#define RECORD_LAST_TRIAL_MAX 0x00FFFFFFu /* a START carries the next number as a float */

/* The longest pending trial, and the longest of all others (learned input), 512 beats. */
#define RECORD_TRIAL_MAX_BYTES (28u + 3u * 4u * BEATS_MAX)
#define RECORD_MAX_BYTES (34u + 6u * JUDGE_PEAKS + (2u * 4u + 1u) * BEATS_MAX)
#define RECORD_PAST_MAX_BYTES (24u + 2u * 4u * BEATS_MAX)
#define RECORD_KEY_MAX_BYTES 52u
#define RECORD_NO_KEY_BYTES 20u /* a key record without a key */
#define RECORD_COUNTER_BYTES 16u

typedef struct {
    uint16_t beats; /* 0 = none */
    uint32_t crc;   /* the u32 at offset 8 of its record: the reference's identity */
    float beat_s;
    float speed_m_s[BEATS_MAX];
} reference_t;

/* A trial that was swum, until it is learned from or discarded. */
typedef struct {
    uint32_t number; /* 0 = none */
    uint32_t reference_crc;
    uint16_t iteration;
    uint16_t beats;                 /* of the reference */
    uint16_t executed;              /* beats swum to their end */
    uint16_t source;                /* speed_source_t */
    uint16_t end;                   /* fault_t: NONE = complete */
    float amplitude_rad[BEATS_MAX]; /* as swum (saturated) */
    float speed_m_s[BEATS_MAX];     /* NaN = not measured */
    float sigma_m_s[BEATS_MAX];
} trial_record_t;

/* A trial that was learned from, or the mean of all of them up to one, for a law that looks further
 * back than the last. Each names the one before by its CRC, and the learned input that came of it:
 * one that is no longer true is recognised, whatever was stored since. */
typedef struct {
    uint32_t crc;          /* the u32 at offset 8 of its own record */
    uint32_t learned_crc;  /* the same of the learned input that was stored next */
    uint32_t previous_crc; /* the same of the past trial before; 0 = the average begins here */
    uint16_t kind;         /* past_kind_t: a trial (PAST_WINDOW) or a mean (PAST_MEAN) */
    uint16_t trials;       /* in the average that was learned, this one among them: the window's at
                              most; of a mean all, stops at 65535 */
    uint16_t beats;
    float amplitude_rad[BEATS_MAX]; /* as swum (saturated) */
    float error_m_s[BEATS_MAX];     /* NaN = not measured */
} past_t;

/* Speeds measured after the swim. */
typedef struct {
    uint32_t trial;
    uint16_t beats;
    float speed_m_s[BEATS_MAX]; /* NaN = not measured */
    float sigma_m_s[BEATS_MAX];
} speed_upload_t;

/* Amplitudes the host computed. */
typedef struct {
    uint32_t reference_crc; /* must match the board's */
    uint16_t beats;
    float amplitude_rad[BEATS_MAX];
} amplitudes_upload_t;

/* The signing key and how far its clock was reserved (link/signing.h). Outlives the key itself, so
 * that an old key set again does not bring old messages back to life. */
typedef struct {
    bool set;
    uint8_t key[32];
    uint64_t mark; /* ticks of 10 us */
} key_record_t;

#define BUILD_ID_BYTES 50u

/* How a firmware died, and which one it was. */
typedef struct {
    char build_id[BUILD_ID_BYTES]; /* ends with a NUL */
    hal_crash_t crash;
    /* Of crash.registers; each ends with a NUL, "" is a register the board does not fill. */
    char register_names[HAL_CRASH_REGISTERS][HAL_CRASH_NAME_BYTES];
} crash_report_t;

/* Encoders return the number of bytes written; |out| holds RECORD_TRIAL_MAX_BYTES for a trial and
 * RECORD_MAX_BYTES for the others. Beats must be 1..BEATS_MAX. Only the first |beats| values of an
 * array are stored. */

/* |reference->crc| is not read; record_crc() of the result is the reference's identity. */
size_t record_encode_reference(const reference_t *reference, uint8_t *out);
size_t record_encode_memory(const memory_t *memory, uint8_t *out);
size_t record_encode_trial(const trial_record_t *trial, uint8_t *out);
/* |past->crc| is not read, as above. */
size_t record_encode_past(const past_t *past, uint8_t *out);
size_t record_encode_params(const params_t *params, uint8_t *out);
size_t record_encode_counter(uint32_t next_trial, uint8_t *out);
size_t record_encode_speeds(const speed_upload_t *speeds, uint8_t *out);
size_t record_encode_amplitudes(const amplitudes_upload_t *amplitudes, uint8_t *out);
size_t record_encode_key(const key_record_t *key, uint8_t *out);
size_t record_encode_crash(const crash_report_t *report, uint8_t *out);

/* By its first four bytes alone: a key, or any record that only the board writes. */
bool record_is_key(const uint8_t *bytes);
bool record_is_internal(const uint8_t *bytes);

/* The CRC a record states; |bytes| holds at least RECORD_HEADER_BYTES. */
uint32_t record_crc(const uint8_t *bytes);

/* FAULT_NONE, FAULT_BAD_FORMAT (magic, version, length, CRC) or FAULT_BAD_DATA (values). Array
 * values beyond |beats| keep what they were. */

/* Speeds finite and >= 0, beat_s > 0. Limits that depend on parameters are the application's. */
fault_t record_decode_reference(const uint8_t *bytes, size_t length, reference_t *reference);

/* Amplitudes finite (stored unsaturated, so any sign) and of a known origin, memory_first's only at
 * iteration 1; the best ones and their error finite and >= 0 once there is a best; its peaks in
 * their order. Written without peaks (ilc/judge.h) it is of version 2. Version 1 has no visits
 * either: they count from 0, so that no beat's gain fades for trials that nobody counted. */
fault_t record_decode_memory(const uint8_t *bytes, size_t length, memory_t *memory);

/* number > 0, executed <= beats, a known source, amplitudes finite and >= 0; speeds as below. */
fault_t record_decode_trial(const uint8_t *bytes, size_t length, trial_record_t *trial);

/* trials > 0, a kind that keeps trials; amplitudes finite and >= 0, errors finite or NaN. */
fault_t record_decode_past(const uint8_t *bytes, size_t length, past_t *past);

/* next_trial > 0. */
fault_t record_decode_counter(const uint8_t *bytes, size_t length, uint32_t *next_trial);

/* Each speed NaN (not measured; its sigma is then not looked at) or finite with a finite sigma >=
 * 0. */
fault_t record_decode_speeds(const uint8_t *bytes, size_t length, speed_upload_t *speeds);

/* Amplitudes finite, any sign, as the board's own. */
fault_t record_decode_amplitudes(const uint8_t *bytes, size_t length,
                                 amplitudes_upload_t *amplitudes);

/* A mark of 48 bits. The record ends after it when no key is set; |key| is then all zeros. */
fault_t record_decode_key(const uint8_t *bytes, size_t length, key_record_t *key);

/* stack_words <= HAL_CRASH_STACK_WORDS; all texts end with a NUL. Version 1 has the registers of
 * ARMv7-M and no names: it gets them. */
fault_t record_decode_crash(const uint8_t *bytes, size_t length, crash_report_t *report);

/* Parameters are stored by name, older firmware's names (params/renamed.def) included: unknown
 * names are skipped, missing ones get their default, values out of range get their default;
 * |ignored| counts both kinds. */
fault_t record_decode_params(const uint8_t *bytes, size_t length, params_t *params,
                             uint16_t *ignored);

#endif
