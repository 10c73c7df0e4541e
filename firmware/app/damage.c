#include "app/damage.h"

bool damage_raise(app_t *app) {
    if (app->trial.run.open || app->supervisor.state == STATE_BOOT ||
        !store_take_damage(&app->vault.store)) {
        return false;
    }
    if (app->supervisor.reason != FAULT_STORAGE) {
        trial_stop(&app->trial, FAULT_STORAGE);
    }
    return true;
}

fault_t damage_judge(app_t *app, fault_t fault) {
    const bool failed = fault == FAULT_WRITE_FAILED;
    return failed && (damage_raise(app) || !app->vault.store.mounted) ? FAULT_STORAGE : fault;
}
