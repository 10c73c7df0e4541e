/* What tests of laws that average share. */
#ifndef PAST_FIXTURE_H
#define PAST_FIXTURE_H

#include "app_fixture.h"

static void set(param_t param, float value) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, param, value));
}

static void learn(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
}

/* Trials in the average that ends with the one learned last. */
static uint16_t trials_in_average(void) {
    static past_t past;
    char path[] = PAST_PATH;
    path[5] = (char)('0' + (app.learner.memory.iteration - 1u) % VAULT_PAST_PLACES);
    const size_t length = vault_read(&app.vault, path);
    TEST_ASSERT_EQUAL(FAULT_NONE, record_decode_past(app.vault.record, length, &past));
    (void)record_encode_memory(&app.learner.memory, app.vault.record);
    TEST_ASSERT_EQUAL_UINT32(record_crc(app.vault.record), past.learned_crc);
    return past.trials;
}

/* How often the command before, the last to put anything there, told of it. */
static uint32_t told_missing(void) {
    static const char text[] = "earlier trials are missing";
    const mock_queue_t *sent = &hal.tx[HAL_PORT_RADIO];
    uint32_t count = 0;
    for (size_t i = 0; i + sizeof text - 1u <= sent->tail; i++) {
        count += memcmp(sent->bytes + i, text, sizeof text - 1u) == 0;
    }
    return count;
}

#endif
