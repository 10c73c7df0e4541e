#include "learn/uploads.h"

#include "learn/reference.h"

static workspace_content_t *take(learner_t *learner) {
    return workspace_take(&learner->vault->workspace, WORKSPACE_UPLOAD);
}

static fault_t give_back(learner_t *learner, fault_t fault, vault_upload_t upload) {
    workspace_give_back(&learner->vault->workspace, WORKSPACE_UPLOAD);
    if (fault == FAULT_NONE) {
        vault_drop_upload(learner->vault, upload);
    }
    return fault;
}

fault_t uploads_reference(learner_t *learner, const vault_stamp_t *stamp) {
    reference_t *next = &take(learner)->reference;
    fault_t fault = vault_take_reference(learner->vault, stamp, next);
    if (fault == FAULT_NONE) {
        fault = reference_judge(learner->params, next);
    }
    if (fault == FAULT_NONE) {
        fault = learner_set_reference(learner, next);
    }
    return give_back(learner, fault, VAULT_UPLOAD_REFERENCE);
}

fault_t uploads_amplitudes(learner_t *learner, const vault_stamp_t *stamp) {
    amplitudes_upload_t *next = &take(learner)->amplitudes;
    fault_t fault = vault_take_amplitudes(learner->vault, stamp, next);
    if (fault == FAULT_NONE) {
        fault = learner_set_amplitudes(learner, next);
    }
    return give_back(learner, fault, VAULT_UPLOAD_AMPLITUDES);
}

fault_t uploads_learned(learner_t *learner, const vault_stamp_t *stamp) {
    memory_t *next = &take(learner)->memory;
    fault_t fault = vault_take_learned(learner->vault, stamp, next);
    if (fault == FAULT_NONE) {
        fault = learner_set_memory(learner, next);
    }
    return give_back(learner, fault, VAULT_UPLOAD_LEARNED);
}
