#include "app/uploads.h"

/* All that was learned, from a backup: the next trial goes on where the last of it left off. */
static fault_t set_memory(app_t *app, const memory_t *next) {
    const fault_t fault = learner_set_memory(&app->learner, next);
    if (fault == FAULT_NONE) {
        trial_count_from(&app->trial, next->last_trial);
    }
    return fault;
}

static fault_t apply(app_t *app, vault_upload_t upload, const workspace_content_t *next) {
    switch (upload) {
    case VAULT_UPLOAD_REFERENCE:
        return learner_set_reference(&app->learner, &next->reference);
    case VAULT_UPLOAD_AMPLITUDES:
        return learner_set_amplitudes(&app->learner, &next->amplitudes);
    case VAULT_UPLOAD_SPEEDS:
        return trial_set_speeds(&app->trial, &next->speeds);
    case VAULT_UPLOAD_LEARNED:
        return set_memory(app, &next->memory);
    case VAULT_UPLOAD_COUNT:
        break;
    }
    return FAULT_BAD_FILE;
}

fault_t uploads_commit(app_t *app, const link_command_t *command) {
    const vault_stamp_t stamp = {command->length_bytes, command->crc};
    const vault_upload_t upload = command->file;
    workspace_t *workspace = &app->vault.workspace;
    if (upload != VAULT_UPLOAD_SPEEDS && app->trial.run.pending) {
        return FAULT_TRIAL_PENDING;
    }
    workspace_content_t *next = workspace_take(workspace, WORKSPACE_UPLOAD);
    fault_t fault = vault_take_upload(&app->vault, upload, &stamp, next);
    if (fault == FAULT_NONE) {
        fault = apply(app, upload, next);
    }
    workspace_give_back(workspace, WORKSPACE_UPLOAD);
    if (fault == FAULT_NONE) {
        vault_drop_upload(&app->vault, upload);
    }
    return fault;
}
