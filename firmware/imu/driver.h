/*
 * Finds a VN-100 at whatever baud rate it runs, asks what it is, and sets it up: ASCII output off,
 * other binary outputs off, baud rate, averaging over a whole frame (register 85), the 64-byte
 * frame (register 75), and the heading mode (35) where asked for. Each setting is written, its echo
 * awaited 100 ms and the time its bytes take, tried three times, and read back. All of it is
 * volatile: nothing is saved in the sensor unless imu_driver_save() asks for it. The mounting (26)
 * works only once it is saved and the sensor has restarted; so it is compared at first, and written
 * when saving: what the register reads is then what the sensor uses. With it go the calibration of
 * accelerometers and gyroscopes (25, 84), where one was given. A sensor that restarts is set
 * up again. It never gives up: with a problem found it starts over, and says which problem
 * meanwhile.
 *
 * Nothing it uses differs between firmware 2.x and 3.x but the notation of errors.
 *
 * A state machine of (state, inputs, time) -> action: it does no input or output of its own. Tell
 * it what comes in, then do what imu_driver_poll() says, until it says nothing more. From power-on
 * to IMU_STREAMING or a problem other than STARTING it takes at most IMU_DRIVER_VERDICT_US. Memory:
 * one struct; no heap. Main loop only.
 *
 * Registers and commands: VN-100 user manual UM001; firmware 3.x as its ICD tells.
 */
#ifndef IMU_DRIVER_H
#define IMU_DRIVER_H

#include "imu/line.h"

#include <stdbool.h>
#include <stdint.h>

#define IMU_DRIVER_VERDICT_US 5000000u
#define IMU_REPLY_TIMEOUT_US 100000u
#define IMU_TRIES 3u
#define IMU_COMMAND_MAX_BYTES 136u
#define IMU_ROWS 6u
#define IMU_ROW_MAX 2.0f   /* of a matrix's elements */
#define IMU_NAME_BYTES 25u /* zero-terminated; longer model or firmware names are cut */

#define IMU_PROBLEM(name, number, meaning, remedy) IMU_PROBLEM_##name = (number),
typedef enum {
#include "imu/problems.def"
} imu_problem_t;
#undef IMU_PROBLEM

/* What is wrong, for people; zero-terminated, static. */
const char *imu_problem_meaning(imu_problem_t problem);
/* What to do about it, likewise; in a file of its own, so that the image does not carry it. */
const char *imu_problem_remedy(imu_problem_t problem);

typedef struct {
    uint32_t baud;    /* the line's speed when all is set up */
    uint16_t rate_hz; /* frames per second; 800 / rate_hz is whole */
    uint8_t port;     /* the sensor's port our wires are on: 1, 2; 0 = find out */
    int8_t heading; /* VPE heading mode, register 35: 0 absolute, 1 relative, 2 indoor; -1 leaves */
    uint8_t mount;  /* how it sits in the fish, register 26: 0 = leave, 1 = as labelled, 2 = upside
                     * down (half a turn about x), 3 = turned by 180 degrees about z, 4 = by +90
                     * (its x points to the fish's right), 5 = by -90 */
} imu_driver_config_t;

typedef enum {
    IMU_SEARCHING,   /* for a baud rate at which it answers */
    IMU_CONFIGURING, /* commands and read-back */
    IMU_WAITING,     /* set up; for the first frame */
    IMU_STREAMING
} imu_driver_state_t;

typedef enum { IMU_DO_NOTHING, IMU_DO_SEND, IMU_DO_SET_BAUD } imu_do_t;

typedef struct {
    imu_do_t what;
    const char *bytes; /* IMU_DO_SEND; valid until the next call */
    uint16_t length;
    uint32_t baud; /* IMU_DO_SET_BAUD: of our end; what was received before is to be dropped */
} imu_action_t;

typedef struct {
    imu_driver_state_t state;
    imu_problem_t problem;
    uint8_t error_code; /* last $VNERR, 0 = none */
    uint8_t found_port; /* the port the frames come out of; 0 = not known */
    bool save_wanted;
    uint8_t rows_given; /* a bit each; only with all of them they are written */
    int32_t row_millionths[IMU_ROWS][3];
    /* The driver's own, up to the next comment; what it uses most stands first, for small code. */
    uint8_t step, phase, tries, baud_index;
    uint8_t port;   /* tried or found */
    uint8_t vpe[4]; /* register 35 as read */
    imu_check_t check;
    bool both_ports, needs_save;
    bool sent;     /* a reply is awaited until deadline_us; else silence until then */
    bool heard;    /* a message at this speed */
    bool answered; /* this and the next two: since the last verdict */
    uint32_t bytes_seen, messages_seen;
    uint32_t line_baud, target_baud;                         /* of our end; what it is to be */
    uint32_t now_us, deadline_us, verdict_us, last_frame_us; /* now: of the call; wrap around */
    /* For others to read. */
    imu_driver_config_t config;
    uint32_t found_baud;               /* at which it answered; 0 = not yet */
    uint32_t replies, errors, retries; /* monotonic */
    char model[IMU_NAME_BYTES];        /* register 1; empty = not known */
    char firmware[IMU_NAME_BYTES];     /* register 4 */
    char command[IMU_COMMAND_MAX_BYTES];
} imu_driver_t;

/* Whether all of it is in range and the sensor accepts it on a line of that speed: rate * 64 bytes
 * <= baud / 10. */
bool imu_driver_config_valid(const imu_driver_config_t *config);

/* So long without a frame, and the stream is taken for lost: half a second, or a little over two
 * frames when they come more slowly. */
uint32_t imu_driver_patience_us(const imu_driver_config_t *config);

/* |config| must be valid. Begins the search at |now_us|. */
void imu_driver_init(imu_driver_t *driver, const imu_driver_config_t *config, uint64_t now_us);

/* |count| bytes were received, whatever they are. */
void imu_driver_bytes(imu_driver_t *driver, uint32_t count);
/* A checked line was received, or a frame of another layout than ours. */
void imu_driver_message(imu_driver_t *driver, const imu_message_t *message, uint64_t now_us);
/* A frame of the wanted layout was received; |restart|: the sensor's clock says that it has
 * started anew. */
void imu_driver_frame(imu_driver_t *driver, bool restart, uint64_t now_us);

/* What to do now. Call it in every pass of the main loop until it answers IMU_DO_NOTHING. */
imu_action_t imu_driver_poll(imu_driver_t *driver, uint64_t now_us);

/* Writes all of the sensor's settings into its flash, ours included, and restarts it, once, when it
 * streams: what register 26 needs to take effect. */
void imu_driver_save(imu_driver_t *driver);

/* Row |row| < IMU_ROWS of what the next saving writes into registers 25 (rows 0 to 2) and 84 (3 to
 * 5), once all six have been given: matrices, close to the identity, that turn what the sensor
 * measures into what is so, in its own axes; biases are set to 0. False: an element is beyond
 * IMU_ROW_MAX. How the sensor prints such numbers is not laid down, so that only its answer is
 * checked, not the values in it. */
bool imu_driver_give_row(imu_driver_t *driver, unsigned row, const float element[3]);

#endif
