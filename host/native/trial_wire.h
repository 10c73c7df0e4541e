/*
 * The line to a simulated board while a trial runs, as long as nothing comes that the caller must
 * see: the speed of every picture goes up, heartbeats too, and messages that nobody listens to are
 * dropped. The same bytes at the same times as the caller's own loop (session/trial.py) sends.
 */
#ifndef TRIAL_WIRE_H
#define TRIAL_WIRE_H

#include "line_fit.h"
#include "sim.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define TRIAL_WIRE_BYTES 16384u
#define TRIAL_WIRE_PICTURES 64u

/* Times are those of sim_time_us, s. The caller sets all fields and keeps what pointers lead to. */
typedef struct {
    int port;
    uint8_t system, component; /* of the sender */
    line_fit_t *fit;
    double along_x, along_y; /* direction of the trial; along_y 0: y does not count */
    const uint32_t *wanted;  /* numbers of the messages that somebody listens to */
    size_t wanted_count;
    bool wants_all;      /* every message is wanted */
    bool shows_pictures; /* a guard sees every picture, and every wait without one */
    double wait_s;       /* longest wait */
    double heartbeat_period_s;
    double leave_s;               /* from then on the next wake is an event */
    double silence_s;             /* without a message, after which a wake is an event */
    double blind_s;               /* without a picture, after which a wake is an event */
    double host_s, board_s, rate; /* the board's clock shows board_s at host_s */

    uint8_t sequence; /* of the next message; this and the next three go on counting */
    double last_heartbeat_s, last_heard_s, last_picture_s;

    size_t received, picture_count; /* not yet handled; the caller takes them and sets 0 */
    uint8_t bytes[TRIAL_WIRE_BYTES];
    sim_camera_frame_t pictures[TRIAL_WIRE_PICTURES];

    uint8_t *sent; /* all that is sent, for tests; NULL = not kept */
    size_t sent_max, sent_count;
} trial_wire_t;

typedef enum {
    TRIAL_WIRE_EVENT = 0,  /* what came is for the caller, as after any wait */
    TRIAL_WIRE_PICTURE = 1 /* one picture, for the guard; the next call sends its speed */
} trial_wire_end_t;

/* Lets time pass until there is something for the caller, at the latest with the first wake from
 * |leave_s| on. */
trial_wire_end_t trial_wire_run(trial_wire_t *wire, sim_t *sim);

/* The frame that tells the speed up to |picture|, which takes |sequence| on by one. Returns its
 * length; 0 while there is no speed. |out| holds MAVLINK_MAX_PACKET_LEN (280) bytes. */
size_t trial_wire_speed(trial_wire_t *wire, const sim_camera_frame_t *picture, uint8_t *out);

#endif
