/* A whole firmware on the mocked board, driven in virtual time by its own command interface. */
#ifndef APP_FIXTURE_H
#define APP_FIXTURE_H

#include "app/app.h"
#include "app/commands.h"
#include "base/crc.h"
#include "mock_hal.h"
#include "store/critical.h"
#include "store_size.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define HOST_SYSTEM 255u

static hal_t hal;
static app_t app;
static bool host_alive;      /* heartbeats of the host that armed keep coming */
static bool camera_on;       /* a vision sample every 40 ms */
static float swim_speed_m_s; /* what the camera sees */
static bool impatient;       /* starts without waiting for blank blocks */

static inline void fixture_reset(void) {
    mock_hal_init(&hal);
    host_alive = true;
    camera_on = true;
    swim_speed_m_s = 0.04f;
    app_init(&app, &hal);
}

static inline void reboot(void) {
    hal.now_us = 0;
    mock_reset_guarded(&hal);
    app_init(&app, &hal);
}

static void see_fish(void) {
    const link_vision_t sample = {
        .time_us = hal.now_us - 500000u, .speed_m_s = swim_speed_m_s, .sigma_m_s = 0.001f};
    app.link.handlers.vision(app.link.handlers.context, &sample);
}

/* A coarser step is cheaper where a trial is long. */
static void run_in_steps_ms(uint32_t step_ms, uint32_t duration_ms) {
    for (uint32_t ms = 0; ms < duration_ms; ms += step_ms) {
        hal.now_us += 1000u * step_ms;
        if (hal.now_us % 20000u == 0) {
            app_tick_isr(&app);
        }
        if (host_alive && hal.now_us % 500000u == 0) {
            app.link.handlers.heartbeat(app.link.handlers.context, HAL_PORT_RADIO, HOST_SYSTEM,
                                        190);
        }
        if (camera_on && hal.now_us % 40000u == 0 && hal.now_us > 500000u) {
            see_fish();
        }
        app_poll(&app);
        hal.tx[0].head = hal.tx[0].tail = 0;
        hal.tx[1].head = hal.tx[1].tail = 0;
    }
}

static inline void run_ms(uint32_t duration_ms) { run_in_steps_ms(10, duration_ms); }

/* As run_ms(), at the ticks only: a pass every 20 ms, and five samples of the camera a second. */
static inline void run_ticks_ms(uint32_t duration_ms) {
    for (uint32_t ms = 0; ms < duration_ms; ms += 20u) {
        hal.now_us += 20000u;
        app_tick_isr(&app);
        app.trial.host.last_heartbeat_us = hal.now_us;
        if (hal.now_us % 200000u == 0 && hal.now_us > 500000u) {
            see_fish();
        }
        app_poll(&app);
        hal.tx[0].head = hal.tx[0].tail = hal.tx[1].head = hal.tx[1].tail = 0;
    }
}

/* A host that waits until the armed board has its blank blocks, on a flash that erases first. */
static inline void wait_for_blank_blocks(app_t *board) {
    preparation_t *preparation = &board->trial.preparation;
    for (uint32_t i = 0; i < 1000u && MOCK_FLASH_ERASES_FIRST &&
                         board->supervisor.state == STATE_ARMED && !preparation->room_made;
         i++) {
        preparation_step(preparation);
    }
}

static fault_t command(link_command_id_t id, uint32_t trial) {
    if (id == LINK_COMMAND_START && !impatient) {
        wait_for_blank_blocks(&app);
    }
    const link_command_t request = {.id = id,
                                    .trial = trial,
                                    .issued_s = (float)hal.now_us * 1e-6f,
                                    .port = HAL_PORT_RADIO,
                                    .system = HOST_SYSTEM,
                                    .component = 190};
    return app.link.handlers.command(app.link.handlers.context, &request);
}

static fault_t commit(vault_upload_t file, const char *path, const uint8_t *bytes, size_t length) {
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, path, bytes, length));
    const link_command_t request = {.id = LINK_COMMAND_COMMIT,
                                    .file = file,
                                    .length_bytes = (uint32_t)length,
                                    .crc = crc32_update(0, bytes, length),
                                    .port = HAL_PORT_RADIO,
                                    .system = HOST_SYSTEM};
    return app.link.handlers.command(app.link.handlers.context, &request);
}

static uint8_t upload_bytes[RECORD_TRIAL_MAX_BYTES];

static size_t encode_flat_reference(uint16_t beats, float speed_m_s) {
    static reference_t reference;
    reference.beats = beats;
    reference.beat_s = 1.0f;
    for (uint16_t k = 0; k < beats; k++) {
        reference.speed_m_s[k] = speed_m_s;
    }
    return record_encode_reference(&reference, upload_bytes);
}

static fault_t upload_flat_reference(uint16_t beats, float speed_m_s) {
    const size_t length = encode_flat_reference(beats, speed_m_s);
    return commit(VAULT_UPLOAD_REFERENCE, "/in/reference.bin", upload_bytes, length);
}

/* Armed and swimming the next trial along a flat reference of |beats| beats. */
static void start_trial(uint16_t beats, float speed_m_s) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(beats, speed_m_s));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
}

static inline void swim_whole_trial(uint16_t beats, float speed_m_s) {
    start_trial(beats, speed_m_s);
    run_ms(beats * 1000u + 5000u);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_TRUE(app.trial.run.pending);
}

#endif
