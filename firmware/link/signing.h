/*
 * Who is believed: MAVLink 2 message signing with one key, and freshness that survives reboots.
 *
 * A signature's time counts 10 us since 2015 and never goes back. The board has no clock that runs
 * while it is off, so it keeps a mark in flash, ahead of its clock: the clock starts at the mark
 * after a boot, and nothing beyond the mark is believed or sent. So whatever was ever believed is
 * older than the clock of the next boot, and a recorded frame is worth nothing. (The usual rule
 * takes streams up to 60 s old after a reboot; this one takes none.) Hosts adopt the board's time
 * from its signed frames.
 *
 * A host that is beyond the mark makes the board ask for a later one and is refused meanwhile. Then
 * the clock goes SIGNING_RESERVE_TICKS beyond that host, so that nothing it was refused can be
 * replayed; it adopts the board's time and goes on. A host whose clock is wrong by decades asks in
 * vain: the board is not dragged to the end of time.
 *
 * The caller stores the mark: at boot, when arming, and when signing_wants_mark() says so and no
 * trial is open. Without a key everything is trusted. Main loop only; checking or signing a full
 * frame hashes 5 blocks of SHA-256.
 */
#ifndef LINK_SIGNING_H
#define LINK_SIGNING_H

#include "link/mavlink.h"

#include <stdbool.h>
#include <stdint.h>

#define SIGNING_KEY_BYTES 32u
#define SIGNING_STREAMS 8u               /* senders remembered: (link id, system, component) */
#define SIGNING_TICKS_PER_S 100000u      /* a tick is 10 us */
#define SIGNING_RESERVE_TICKS 60000000u  /* 10 min */
#define SIGNING_AGE_MAX_TICKS 1000000u   /* 10 s: longer than a radio stalls */
#define SIGNING_TIME_MAX 0xFFFFFFFFFFFFu /* 48 bits: the year 2104 */
#define SIGNING_JUMP_MAX_TICKS                                                                     \
    (1ull << 47) /* 44 years: furthest beyond the mark that is asked for */

typedef enum {
    SIGNING_TRUSTED = 0,
    SIGNING_UNSIGNED, /* there is a key, and the frame has no signature */
    SIGNING_WRONG,    /* another key, or damaged: link id, time and content are all signed */
    SIGNING_STALE,    /* replayed, out of order, older than SIGNING_AGE_MAX_TICKS, or decades off */
    SIGNING_AHEAD,  /* beyond the mark: its sender is good once the caller has stored a later one */
    SIGNING_CROWDED /* more senders than SIGNING_STREAMS within SIGNING_AGE_MAX_TICKS */
} signing_verdict_t;

/* Frames that were not trusted, since boot. */
typedef struct {
    uint32_t unsigned_; /* that asked for something which needs trust; counted by the link */
    uint32_t wrong;
    uint32_t stale; /* also AHEAD and CROWDED */
} signing_counters_t;

typedef struct {
    uint64_t last; /* time of its newest trusted frame */
    uint8_t link_id, system, component;
} signing_stream_t;

typedef struct {
    bool locked; /* a key is needed. Without |keyed|: the stored one is unreadable, trust nobody */
    bool keyed;
    uint64_t base, base_us; /* the clock was |base| at board time |base_us| */
    uint64_t floor;         /* up to here nothing is fresh */
    uint64_t mark;          /* stored */
    uint64_t asked;         /* newest time beyond the mark with a right signature; 0 = none */
    uint8_t stream_count;
    signing_stream_t stream[SIGNING_STREAMS];
    signing_counters_t counters;
    mavlink_signing_t out; /* key, and time of the next frame sent; of both ports */
} signing_t;

/* No key any more, as in a zeroed struct: everything is trusted, nothing is signed. Keeps the
 * counters. */
void signing_clear_key(signing_t *signing);

/* There is a key but it cannot be read: all frames count as unsigned, nothing is signed. */
void signing_lock(signing_t *signing);

/* From now on |key| is needed. The clock starts at |clock|, at which nothing is fresh; nothing is
 * believed until signing_mark() has set a later mark. Forgets the senders, keeps the counters. */
void signing_set_key(signing_t *signing, const uint8_t key[SIGNING_KEY_BYTES], uint64_t clock,
                     uint64_t now_us);

/* The mark that has just been stored. It never goes back. What was ahead of the old one is stale
 * from now on. */
void signing_mark(signing_t *signing, uint64_t mark);

/* |time| + |ticks|, not beyond SIGNING_TIME_MAX. */
uint64_t signing_later(uint64_t time, uint64_t ticks);

/* The signing clock, at most the mark. 0 without a key. */
uint64_t signing_clock(const signing_t *signing, uint64_t now_us);

/* Whether less than |ahead| and half the reserve is left, or a sender with the key is beyond the
 * mark; then |*mark| is what to store. */
bool signing_wants_mark(const signing_t *signing, uint64_t now_us, uint64_t ahead, uint64_t *mark);

/* Judges a frame whose CRC is right. TRUSTED moves the sender's time and, when it is ahead, the
 * clock. Counts all but TRUSTED and UNSIGNED. */
signing_verdict_t signing_check(signing_t *signing, const mavlink_message_t *message,
                                uint64_t now_us);

/* Sets the time of the next frame sent; called before each frame is packed. Times rise from frame
 * to frame, except at a mark that could not be renewed: there they repeat, and stock hosts take the
 * frames for replays. Beyond it the board would go back at its next boot. */
void signing_before_send(signing_t *signing, uint64_t now_us);

#endif
