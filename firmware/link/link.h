/*
 * The wire: MAVLink 2 on two ports, dialect wire/tailbeat.xml, sysid 1, compid 1.
 *
 * Owns the parsers, the parameter and FTP servers, TIMESYNC, HEARTBEAT and telemetry. What a
 * command does is the application's: it is handed over through link_handlers_t. Main loop only.
 * Everything sent is dropped and counted when the line is full; answers to requests are not queued
 * beyond what the port holds. A port's line must hold at least LINK_LINE_MIN_BYTES, or file bursts
 * never start.
 *
 * With a key (signing.h) every command, parameter write, file write and speed sample must be signed
 * and fresh, else it is refused, answered with the reason and counted. COMMAND_ACK tells whether
 * another try is worth while: TEMPORARILY_REJECTED = the right key at a wrong time (adopt the
 * board's), DENIED = no key or another one. Reading is free: parameters, lists and files, TIMESYNC,
 * HEARTBEAT. An unsigned HEARTBEAT brings telemetry to its port, but does not reach the
 * application. A frame with a wrong signature is good for nothing but a refusal. All that is sent
 * is signed.
 *
 * HEARTBEATs and texts go out on both ports always, all other telemetry only on ports where a host
 * was heard in the last LINK_HEARD_US. What the application gets through the handlers is finite
 * where a number has to be, and addressed to this board.
 */
#ifndef LINK_LINK_H
#define LINK_LINK_H

#include "hal/serial.h"
#include "ilc/memory.h"
#include "imu/imu.h"
#include "link/channel.h"
#include "link/ftp_server.h"
#include "link/signing.h"
#include "params/params.h"
#include "speed/speed.h"
#include "store/records.h"
#include "store/store.h"
#include "supervisor/battery.h"
#include "supervisor/supervisor.h"

#define LINK_PORTS 2u /* HAL_PORT_RADIO, HAL_PORT_CONSOLE */
#define LINK_LINE_MIN_BYTES 559u
#define LINK_HEARD_US 10000000u
#define LINK_POLL_US 20000u
#define LINK_BLINK_MAX_S 60.0f

/* Commands the application decides on. */
typedef enum {
    LINK_COMMAND_ARM, /* blink_s */
    LINK_COMMAND_DISARM,
    LINK_COMMAND_START,   /* trial, issued_s */
    LINK_COMMAND_ABORT,   /* wall */
    LINK_COMMAND_LEARN,   /* trial */
    LINK_COMMAND_DISCARD, /* trial */
    LINK_COMMAND_RESTORE_BEST,
    LINK_COMMAND_CLEAR,
    LINK_COMMAND_COMMIT, /* file, length_bytes, crc */
    LINK_COMMAND_PARAMS_LOAD,
    LINK_COMMAND_PARAMS_SAVE,
    LINK_COMMAND_PARAMS_RESET,
    LINK_COMMAND_IMU_SAVE,
    LINK_COMMAND_IMU_ROW, /* row, element */
    LINK_COMMAND_REBOOT   /* take note and return; reset once the ACK has left (200 ms later) */
} link_command_id_t;

typedef enum {
    LINK_FILE_REFERENCE = 0,
    LINK_FILE_AMPLITUDES = 1,
    LINK_FILE_SPEEDS = 2,
    LINK_FILE_LEARNED = 3
} link_file_t;

typedef struct {
    link_command_id_t id;
    uint32_t trial;
    float issued_s; /* board time; NaN = not given */
    float blink_s;  /* 0 to LINK_BLINK_MAX_S */
    bool wall;      /* the fish came too close to one */
    uint8_t row;    /* < IMU_ROWS */
    float element[3];
    link_file_t file;
    uint32_t length_bytes;
    uint32_t crc;
    hal_port_t port; /* where it came in */
    uint8_t system;  /* who sent it */
    uint8_t component;
} link_command_t;

typedef struct {
    uint64_t time_us; /* board time, middle of the sample's window */
    float speed_m_s;  /* along x, the swim direction */
    float sigma_m_s;  /* NaN = not given */
} link_vision_t;

/* The application's answers. |context| is handed back as it was given. */
typedef struct {
    void *context;
    /* FAULT_NONE = accepted, otherwise the reason for the refusal. */
    fault_t (*command)(void *context, const link_command_t *command);
    /* Sets it, or tells why not; |value| is finite, its range is not checked yet. */
    fault_t (*param_set)(void *context, param_t param, float value);
    /* |speed_m_s| as it came in, possibly not finite; |sigma_m_s| > 0 or NaN. */
    void (*vision)(void *context, const link_vision_t *sample);
    /* SETUP_SIGNING that came over the wired port, from somebody trusted or while the stored key
     * cannot be read; |key| NULL = no key any more. The answer is told as text: "key set", "key
     * erased", or the reason for the refusal. */
    fault_t (*set_key)(void *context, const uint8_t *key, uint64_t time);
    /* Of any system that is not a fish, when it is trusted. */
    void (*heartbeat)(void *context, hal_port_t port, uint8_t system, uint8_t component);
} link_handlers_t;

/* What the link tells the world about the board; the application fills it before each poll. */
typedef struct {
    state_t state;
    fault_t fault;
    uint32_t trial, next_trial, pending_trial, reference_crc;
    uint32_t open_trial; /* still writing its log; 0 = none */
    uint16_t beats, beat;
    battery_voltage_t battery;
    const memory_t *memory;
    /* live view */
    float angle_rad, amplitude_rad, speed_m_s; /* speed NaN = none */
    uint16_t pulse_ticks;
    const imu_t *imu;
    float still_s; /* how long the fish has been, by the IMU */
    /* counters */
    speed_counters_t speed_counters;
    uint32_t late_ticks, longest_pause_us;
} link_status_t;

typedef struct {
    uint32_t trial;
    uint16_t iteration; /* that the trial swam */
    memory_report_t report;
    float best_max_abs_error_m_s; /* NaN = none */
} link_learn_report_t;

typedef struct {
    uint32_t trial;
    uint16_t beat;
    float amplitude_rad, reference_m_s;
    speed_beat_t speed;
    bool saturated, provisional;
} link_beat_t;

#define LINK_IMU_FRAMES 4u /* in one message */

/* Raw frames on their way to the host that asked for them. */
typedef struct {
    uint8_t port;
    uint32_t interval_us; /* 0 = nobody asked */
    uint64_t next_us;
    uint32_t frames; /* since boot */
    uint32_t first;  /* number of the first one held */
    uint8_t held;
    uint32_t time_us[LINK_IMU_FRAMES];
    imu_frame_t frame[LINK_IMU_FRAMES];
} link_imu_stream_t;

/* When a message is sent on a port. */
typedef struct {
    uint32_t interval_us; /* 0 = as usual */
    bool off;
    uint64_t next_us;
} link_interval_t;

#define LINK_INTERVALS 3u /* telemetry.c has their messages */

typedef struct {
    hal_t *hal;
    store_t *store;
    params_t *params;
    link_handlers_t handlers;
    const link_status_t *status;
    signing_t signing; /* the application sets key and mark */
    channel_t channel[LINK_PORTS];
    ftp_server_t ftp;
    link_learn_report_t last_learned; /* trial 0 = none */
    link_imu_stream_t imu_stream;
    link_interval_t interval[LINK_PORTS][LINK_INTERVALS];
    uint32_t imu_digest;
    uint64_t heard_until_us[LINK_PORTS]; /* telemetry goes there until then */
    uint64_t next_heartbeat_us, next_slow_us, next_health_us;
    uint64_t next_refusal_us; /* when the next one is told as text */
    uint32_t status_digest;
    uint16_t param_stream_next[LINK_PORTS]; /* of a PARAM_REQUEST_LIST; PARAM_COUNT = none */
    uint8_t mode_stream_next[LINK_PORTS];   /* of all AVAILABLE_MODES; STATE_COUNT = none */
} link_t;

void link_init(link_t *link, hal_t *hal, store_t *store, params_t *params,
               const link_handlers_t *handlers);

/* Takes in what has arrived (bounded: what the rings held, and LINK_POLL_US beyond one message of
 * each port), answers it, sends what is due. |status| is read until the next poll. */
void link_poll(link_t *link, const link_status_t *status);

/* Sent on both ports. |severity| is a MAV_SEVERITY; text beyond 49 characters is cut. */
void link_text(link_t *link, uint8_t severity, const char *text);
void link_beat(link_t *link, const link_beat_t *beat);
void link_learned(link_t *link, const link_learn_report_t *report);
/* A frame of the IMU, for the host that asked for all of them. */
void link_imu(link_t *link, const imu_sample_t *sample);

/* git describe of the firmware, zero-terminated, at most 8 + 1 + 40 characters. */
const char *link_build_id(void);

#endif
