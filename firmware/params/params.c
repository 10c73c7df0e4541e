#include "params/params.h"

#include "base/panic.h"
#include "base/real.h"

#include <string.h>

static const param_info_t table[PARAM_COUNT] = {
#define PARAM(name, fallback, low, high, kind, unit, text)                                         \
    [PARAM_##name] = {#name, fallback, low, high, kind},
#include "params/params.def"
#undef PARAM
};

static const param_renamed_t renamed[PARAM_RENAMED_COUNT] = {
#define RENAMED(old_name, name) {#old_name, PARAM_##name},
#include "params/renamed.def"
#undef RENAMED
};

const param_info_t *param_info(param_t param) {
    REQUIRE((uint32_t)param < PARAM_COUNT);
    return &table[param];
}

void params_reset(params_t *params) {
    for (uint32_t i = 0; i < PARAM_COUNT; i++) {
        params->value[i] = table[i].fallback;
    }
}

param_t param_find(const char name[PARAM_NAME_BYTES]) {
    for (uint32_t i = 0; i < PARAM_COUNT; i++) {
        if (strncmp(name, table[i].name, PARAM_NAME_BYTES) == 0) {
            return (param_t)i;
        }
    }
    return PARAM_COUNT;
}

const param_renamed_t *param_renamed(uint32_t index) {
    REQUIRE(index < PARAM_RENAMED_COUNT);
    return &renamed[index];
}

param_t param_find_renamed(const char old_name[PARAM_NAME_BYTES]) {
    for (uint32_t i = 0; i < PARAM_RENAMED_COUNT; i++) {
        if (strncmp(old_name, renamed[i].old_name, PARAM_NAME_BYTES) == 0) {
            return (param_t)renamed[i].param;
        }
    }
    return PARAM_COUNT;
}

param_result_t params_set(params_t *params, param_t param, float value) {
    if ((uint32_t)param >= PARAM_COUNT) {
        return PARAM_UNKNOWN;
    }
    const param_info_t *info = &table[param];
    if (!real_is_finite(value)) {
        return PARAM_NOT_FINITE;
    }
    if (value < info->low || value > info->high) {
        return PARAM_OUT_OF_RANGE;
    }
    const float steps = info->kind == PARAM_HALF ? 2.0f * value : value;
    if (info->kind != PARAM_REAL && (float)(int32_t)steps != steps) {
        return PARAM_NOT_WHOLE;
    }
    params->value[param] = value;
    return PARAM_OK;
}

int32_t params_whole(const params_t *params, param_t param) {
    REQUIRE(param_info(param)->kind == PARAM_WHOLE);
    return (int32_t)params->value[param];
}
