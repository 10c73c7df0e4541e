#include "trial/preparation.h"

#include "learn/past_trials.h"
#include "store/erase_ahead.h"
#include "store/trial_log.h"
#include "trial/settle.h"

#define ROOM_STEPS_MAX (2u * STORE_BLOCKS_MAX) /* no more files than that fit */
#define START_ERASES 8u /* for what changed while armed, and what the start itself wrote */

void preparation_init(preparation_t *preparation, learner_t *learner, const trial_run_t *run) {
    preparation->learner = learner;
    preparation->run = run;
}

void preparation_begin(preparation_t *preparation) {
    preparation->space_made = preparation->room_made = false;
    preparation->guess_tried = preparation->guess_stored = !learner_has_guess(preparation->learner);
}

/* The file of a trial that was learned from, if it takes more than a block. The next trial replaces
 * it at less cost, but needs room beside it. */
static bool drop_learned_trial(preparation_t *preparation) {
    vault_t *vault = preparation->learner->vault;
    return !preparation->run->pending &&
           vault_trial_bytes(vault) > store_block_bytes(vault->store.hal) &&
           vault_drop_trial(vault) == STORE_OK;
}

static uint32_t log_room(const learner_t *learner) {
    const uint32_t trial_s = (uint32_t)settle_trial_s(learner->params, &learner->reference) + 1u;
    return erase_ahead_room(&learner->vault->store,
                            trial_log_size_bound(learner->reference.beats, trial_s),
                            trial_log_syncs_bound(trial_s));
}

/* Past trials that no law reads go ahead of any log, the others after all of them, oldest first: a
 * fish that cannot swim learns nothing, and a short average is better than none. */
static store_result_t make_space_step(preparation_t *preparation, bool *done) {
    learner_t *learner = preparation->learner;
    store_t *store = &learner->vault->store;
    if (learner_drop_past(learner, past_trials_reach(learner->params)) ||
        drop_learned_trial(preparation)) {
        return STORE_OK;
    }
    const uint32_t past_bytes =
        past_trials_room_blocks(learner->params) * store_block_bytes(store->hal);
    const store_result_t result =
        store_make_space_step(store, log_room(learner) + past_bytes, 0, done);
    return result == STORE_NO_SPACE && learner_drop_past(learner, 0) ? STORE_OK : result;
}

static bool erases_first(const preparation_t *preparation) {
    return store_erases_first(preparation->learner->vault->store.hal);
}

static store_result_t erase_step(const preparation_t *preparation, bool *done) {
    const learner_t *learner = preparation->learner;
    return erase_ahead_step(&learner->vault->store, log_room(learner), done);
}

/* Space first: making it writes, and compacts folders. */
static store_result_t make_room_step(preparation_t *preparation) {
    if (preparation->space_made && erases_first(preparation)) {
        return erase_step(preparation, &preparation->room_made);
    }
    const store_result_t result = make_space_step(preparation, &preparation->space_made);
    preparation->room_made = preparation->space_made && !erases_first(preparation);
    return result;
}

void preparation_step(preparation_t *preparation) {
    if (!preparation->room_made) {
        const store_result_t result = make_room_step(preparation);
        preparation->room_made = preparation->room_made || result != STORE_OK;
    } else if (!preparation->guess_tried) {
        (void)preparation_save_guess(preparation);
    }
}

/* A few: an erase takes its time. */
static fault_t erase_rest(preparation_t *preparation) {
    bool erased = false;
    store_result_t result = STORE_OK;
    for (uint32_t i = 0; i < START_ERASES && result == STORE_OK && !erased; i++) {
        result = erase_step(preparation, &erased);
        vault_still_alive(preparation->learner->vault);
    }
    preparation->room_made = erased;
    if (result != STORE_OK) {
        return FAULT_WRITE_FAILED;
    }
    return erased ? FAULT_NONE : FAULT_ERASING;
}

fault_t preparation_erase(preparation_t *preparation) {
    return erases_first(preparation) ? erase_rest(preparation) : FAULT_NONE;
}

fault_t preparation_make_room(preparation_t *preparation) {
    bool made = false;
    store_result_t result = STORE_OK;
    for (uint32_t i = 0; i < ROOM_STEPS_MAX && result == STORE_OK && !made; i++) {
        result = make_space_step(preparation, &made);
        vault_still_alive(preparation->learner->vault);
    }
    return result == STORE_OK && made ? preparation_erase(preparation) : FAULT_WRITE_FAILED;
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
