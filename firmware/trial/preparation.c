#include "trial/preparation.h"

#include "learn/past_trials.h"
#include "store/trial_log.h"
#include "trial/settle.h"

#define ROOM_STEPS_MAX (2u * STORE_BLOCKS) /* no more files than that fit */

void preparation_init(preparation_t *preparation, learner_t *learner, const trial_run_t *run) {
    preparation->learner = learner;
    preparation->run = run;
}

void preparation_begin(preparation_t *preparation) {
    preparation->room_made = false;
    preparation->guess_tried = preparation->guess_stored = !learner_has_guess(preparation->learner);
}

/* The file of a trial that was learned from, if it takes more than a block. The next trial replaces
 * it at less cost, but needs room beside it. */
static bool drop_learned_trial(preparation_t *preparation) {
    vault_t *vault = preparation->learner->vault;
    return !preparation->run->pending && vault_trial_bytes(vault) > STORE_BLOCK_BYTES &&
           vault_drop_trial(vault) == STORE_OK;
}

static uint32_t log_bytes(const learner_t *learner) {
    const float trial_s = settle_trial_s(learner->params, &learner->reference);
    return trial_log_size_bound(learner->reference.beats, (uint32_t)trial_s + 1u);
}

/* Past trials that no law reads go ahead of any log, the others after all of them, oldest first: a
 * fish that cannot swim learns nothing, and a short average is better than none. */
static store_result_t make_room_step(preparation_t *preparation, bool *done) {
    learner_t *learner = preparation->learner;
    if (learner_drop_past(learner, past_trials_reach(learner->params)) ||
        drop_learned_trial(preparation)) {
        return STORE_OK;
    }
    const uint32_t bytes = log_bytes(learner) + past_trials_room_bytes(learner->params);
    const store_result_t result = store_make_space_step(&learner->vault->store, bytes, 0, done);
    return result == STORE_NO_SPACE && learner_drop_past(learner, 0) ? STORE_OK : result;
}

void preparation_step(preparation_t *preparation) {
    if (!preparation->room_made) {
        const store_result_t result = make_room_step(preparation, &preparation->room_made);
        preparation->room_made = preparation->room_made || result != STORE_OK;
    } else if (!preparation->guess_tried) {
        (void)preparation_save_guess(preparation);
    }
}

bool preparation_make_room(preparation_t *preparation) {
    bool made = false;
    store_result_t result = STORE_OK;
    for (uint32_t i = 0; i < ROOM_STEPS_MAX && result == STORE_OK && !made; i++) {
        result = make_room_step(preparation, &made);
        vault_still_alive(preparation->learner->vault);
    }
    return result == STORE_OK && made;
}

fault_t preparation_save_guess(preparation_t *preparation) {
    learner_t *learner = preparation->learner;
    if (preparation->guess_stored) {
        return FAULT_NONE;
    }
    const fault_t saved = learner_save(learner);
    preparation->guess_tried = true;
    preparation->guess_stored = saved == FAULT_NONE;
    return saved == FAULT_NONE || learner_guess_first(learner) == FAULT_NONE ? saved
                                                                             : FAULT_BAD_LAW;
}
