/* The least a host must do to put a simulated fish through trials: MAVLink bytes and a line fit. */
#ifndef BENCH_MINI_HOST_H
#define BENCH_MINI_HOST_H

#include "link/mavlink.h"
#include "sim.h"

#define FIT_PICTURES 26u /* one beat at 25 frames/s, both ends counted */

typedef struct {
    sim_t *sim;
    mavlink_message_t rx_buffer, message;
    mavlink_status_t rx_status, tx_status;
    uint8_t rx[256]; /* bytes that have come, from |rx_at| on */
    size_t rx_at, rx_count;
    uint64_t next_heartbeat_us;
    uint16_t ftp_sequence;
    uint8_t ftp_session;                       /* as the board opened it */
    sim_camera_frame_t pictures[FIT_PICTURES]; /* ring */
    uint64_t picture_count;
    unsigned wakes;
    mavlink_tailbeat_status_t status;
    mavlink_tailbeat_learn_report_t learned;
} mini_host_t;

void mini_host_init(mini_host_t *host, sim_t *sim);

/* Lets time pass, answering what comes, until |message_id| has come. False when it has not within
 * |limit_s|. */
bool mini_host_await(mini_host_t *host, uint32_t message_id, double limit_s);

bool mini_host_set_param(mini_host_t *host, const char *name, float value);

/* A COMMAND_LONG; whether it was accepted. */
bool mini_host_command(mini_host_t *host, uint16_t command, float param1, float param2);

/* Uploads a whole small file and has the board take it over as |kind| (a TAILBEAT_FILE). */
bool mini_host_upload(mini_host_t *host, const char *path, int kind, const uint8_t *bytes,
                      uint8_t length);

#endif
