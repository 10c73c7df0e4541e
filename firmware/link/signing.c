#include "link/signing.h"

#include <string.h>

#define TICK_US 10u
#define TIME_BYTES 6u
#define OUR_LINK_ID 0u

static uint64_t smaller(uint64_t a, uint64_t b) { return a < b ? a : b; }

static uint64_t greater(uint64_t a, uint64_t b) { return a > b ? a : b; }

uint64_t signing_later(uint64_t time, uint64_t ticks) {
    return smaller(time + ticks, SIGNING_TIME_MAX);
}

void signing_clear_key(signing_t *signing) {
    const signing_counters_t counters = signing->counters;
    memset(signing, 0, sizeof *signing);
    signing->counters = counters;
}

void signing_lock(signing_t *signing) {
    signing_clear_key(signing);
    signing->locked = true;
}

void signing_set_key(signing_t *signing, const uint8_t key[SIGNING_KEY_BYTES], uint64_t clock,
                     uint64_t now_us) {
    signing_clear_key(signing);
    signing->locked = signing->keyed = true;
    signing->base = signing->floor = signing->mark = clock;
    signing->base_us = now_us;
    signing->out.flags = MAVLINK_SIGNING_FLAG_SIGN_OUTGOING;
    signing->out.link_id = OUR_LINK_ID;
    signing->out.timestamp = signing_later(clock, 1);
    memcpy(signing->out.secret_key, key, SIGNING_KEY_BYTES);
}

/* Since the clock was last brought up to date, which HEARTBEATs do every second. */
static uint32_t passed_ticks(const signing_t *signing, uint64_t now_us) {
    return (uint32_t)smaller(now_us - signing->base_us, UINT32_MAX) / TICK_US;
}

uint64_t signing_clock(const signing_t *signing, uint64_t now_us) {
    return smaller(signing->base + passed_ticks(signing, now_us), signing->mark);
}

static void advance(signing_t *signing, uint64_t now_us) {
    const uint32_t ticks = passed_ticks(signing, now_us);
    signing->base = signing_clock(signing, now_us);
    signing->base_us += (uint64_t)ticks * TICK_US;
}

void signing_mark(signing_t *signing, uint64_t mark) {
    signing->mark = greater(signing->mark, mark);
    if (signing->asked != 0 && signing->asked <= signing->mark) {
        signing->base = smaller(signing->asked + SIGNING_RESERVE_TICKS, signing->mark);
        signing->floor = signing->base;
        signing->asked = 0;
    }
}

bool signing_wants_mark(const signing_t *signing, uint64_t now_us, uint64_t ahead, uint64_t *mark) {
    const bool asked = signing->asked != 0;
    const uint64_t clock = signing_clock(signing, now_us);
    const uint64_t from = asked ? signing_later(signing->asked, SIGNING_RESERVE_TICKS) : clock;
    *mark = signing_later(from, ahead + SIGNING_RESERVE_TICKS);
    const bool short_of_it = signing->mark - clock < ahead + SIGNING_RESERVE_TICKS / 2u;
    return signing->keyed && *mark > signing->mark && (asked || short_of_it);
}

static uint64_t time_of(const mavlink_message_t *message) {
    uint64_t time = 0;
    for (uint32_t i = TIME_BYTES; i > 0; i--) {
        time = time << 8 | message->signature[i];
    }
    return time;
}

/* Makes the signature anew and compares all of it, always: how long it takes tells nothing. */
static bool is_right(signing_t *signing, const mavlink_message_t *message, uint64_t time) {
    uint8_t right[MAVLINK_SIGNATURE_BLOCK_LEN];
    const uint64_t sending = signing->out.timestamp;
    signing->out.timestamp = time;
    signing->out.link_id = message->signature[0];
    (void)mavlink_sign_packet(&signing->out, right, &message->magic, MAVLINK_NUM_HEADER_BYTES,
                              (const uint8_t *)_MAV_PAYLOAD(message), message->len, message->ck);
    signing->out.timestamp = sending;
    signing->out.link_id = OUR_LINK_ID;
    uint32_t differing = 0;
    for (uint32_t i = 0; i < sizeof right; i++) {
        differing |= (uint32_t)(right[i] ^ message->signature[i]);
    }
    return differing == 0;
}

static bool is_of(const signing_stream_t *stream, const mavlink_message_t *message) {
    return stream->link_id == message->signature[0] && stream->system == message->sysid &&
           stream->component == message->compid;
}

static bool too_old(const signing_t *signing, uint64_t time) {
    return time + SIGNING_AGE_MAX_TICKS < signing->base;
}

/* The sender's own entry; else a free one, or one that may be forgotten because all that could be
 * replayed of it is too old anyway. NULL = none. */
static signing_stream_t *stream_of(signing_t *signing, const mavlink_message_t *message) {
    signing_stream_t *spare = NULL;
    for (uint32_t i = 0; i < signing->stream_count; i++) {
        signing_stream_t *stream = &signing->stream[i];
        if (is_of(stream, message)) {
            return stream;
        }
        spare = too_old(signing, stream->last) ? stream : spare;
    }
    if (spare == NULL && signing->stream_count < SIGNING_STREAMS) {
        spare = &signing->stream[signing->stream_count++];
    }
    if (spare != NULL) {
        *spare = (signing_stream_t){.link_id = message->signature[0],
                                    .system = message->sysid,
                                    .component = message->compid};
    }
    return spare;
}

static signing_verdict_t judge_time(signing_t *signing, const mavlink_message_t *message,
                                    uint64_t time) {
    if (time > signing->mark) {
        if (time - signing->mark > SIGNING_JUMP_MAX_TICKS) {
            return SIGNING_STALE;
        }
        signing->asked = greater(signing->asked, time);
        return SIGNING_AHEAD;
    }
    if (time <= signing->floor || too_old(signing, time)) {
        return SIGNING_STALE;
    }
    signing_stream_t *stream = stream_of(signing, message);
    if (stream == NULL) {
        return SIGNING_CROWDED;
    }
    if (time <= stream->last) {
        return SIGNING_STALE;
    }
    stream->last = time;
    signing->base = greater(signing->base, time);
    return SIGNING_TRUSTED;
}

signing_verdict_t signing_check(signing_t *signing, const mavlink_message_t *message,
                                uint64_t now_us) {
    if (!signing->locked) {
        return SIGNING_TRUSTED;
    }
    if (!signing->keyed || (message->incompat_flags & MAVLINK_IFLAG_SIGNED) == 0) {
        return SIGNING_UNSIGNED;
    }
    const uint64_t time = time_of(message);
    if (!is_right(signing, message, time)) {
        signing->counters.wrong++;
        return SIGNING_WRONG;
    }
    advance(signing, now_us);
    const signing_verdict_t verdict = judge_time(signing, message, time);
    signing->counters.stale += verdict != SIGNING_TRUSTED ? 1u : 0u;
    return verdict;
}

void signing_before_send(signing_t *signing, uint64_t now_us) {
    if (signing->keyed) {
        advance(signing, now_us);
        signing->out.timestamp =
            smaller(greater(signing->base, signing->out.timestamp), signing->mark);
    }
}
