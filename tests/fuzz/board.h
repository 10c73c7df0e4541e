/* A whole firmware on the mocked board, swimming and storing in virtual time, for the targets that
 * need one. */
#ifndef FUZZ_BOARD_H
#define FUZZ_BOARD_H

#include "app/app.h"
#include "app/commands.h"
#include "base/crc.h"
#include "fuzz.h"
#include "mock_hal.h"
#include "store/critical.h"

#define BOARD_PASS_US 20000u
#define BOARD_HOST 255u

static hal_t hal;
static app_t app;

static inline void board_boot(void) {
    hal.now_us = 0;
    mock_reset_guarded(&hal);
    hal.pulse_count = 0;
    for (uint32_t port = 0; port < HAL_PORT_COUNT; port++) {
        hal.rx[port].head = hal.rx[port].tail = hal.tx[port].head = hal.tx[port].tail = 0;
    }
    app_init(&app, &hal);
}

/* A tick and a pass of the main loop behind it. */
static inline void board_pass(void) {
    hal.now_us += BOARD_PASS_US;
    app_tick_isr(&app);
    app_poll(&app);
}

/* |host| with a camera that sees the fish swim. */
static inline void board_run(uint32_t passes, bool host) {
    for (uint32_t i = 0; i < passes; i++) {
        board_pass();
        hal.tx[0].head = hal.tx[0].tail = hal.tx[1].head = hal.tx[1].tail = 0;
        hal.tx[2].head = hal.tx[2].tail = 0;
        if (host && i % 2u == 0 && hal.now_us > 600000u) {
            const link_vision_t seen = {
                .time_us = hal.now_us - 500000u, .speed_m_s = 0.03f, .sigma_m_s = 0.001f};
            app.link.handlers.vision(app.link.handlers.context, &seen);
            app.link.handlers.heartbeat(app.link.handlers.context, HAL_PORT_RADIO, BOARD_HOST, 190);
        }
    }
}

static inline fault_t board_command(link_command_id_t id, uint32_t trial) {
    const link_command_t request = {.id = id,
                                    .trial = trial,
                                    .issued_s = (float)hal.now_us * 1e-6f,
                                    .port = HAL_PORT_RADIO,
                                    .system = BOARD_HOST,
                                    .component = 190};
    return app.link.handlers.command(app.link.handlers.context, &request);
}

static inline fault_t board_upload(vault_upload_t file, const char *path, const uint8_t *bytes,
                                   size_t length) {
    MUST(store_replace(&app.vault.store, path, bytes, length) == STORE_OK);
    const link_command_t request = {.id = LINK_COMMAND_COMMIT,
                                    .file = file,
                                    .length_bytes = (uint32_t)length,
                                    .crc = crc32_update(0, bytes, length),
                                    .port = HAL_PORT_RADIO,
                                    .system = BOARD_HOST};
    return app.link.handlers.command(app.link.handlers.context, &request);
}

static inline void board_set_reference(uint16_t beats) {
    static reference_t reference;
    static uint8_t bytes[RECORD_MAX_BYTES];
    reference.beats = beats;
    reference.beat_s = 1.0f;
    for (uint16_t k = 0; k < beats; k++) {
        reference.speed_m_s[k] = 0.04f;
    }
    const size_t length = record_encode_reference(&reference, bytes);
    MUST(board_upload(VAULT_UPLOAD_REFERENCE, "/in/reference.bin", bytes, length) == FAULT_NONE);
}

/* Swims the next trial; it is pending afterwards. */
static inline void board_swim(void) {
    MUST(board_command(LINK_COMMAND_ARM, 0) == FAULT_NONE);
    MUST(board_command(LINK_COMMAND_START, app.trial.next) == FAULT_NONE);
    board_run(50u * app.learner.reference.beats + 300u, true);
    MUST(app.supervisor.state == STATE_IDLE && app.trial.run.pending);
}

#endif
