#include "params/limits.h"

typedef enum {
    RULE_LOW,      /* the lower value protects more */
    RULE_HIGH,     /* the higher value protects more */
    RULE_LOW_OR_NO /* the lower value protects more, but 0 switches the limit off */
} limit_rule_t;

typedef struct {
    uint8_t param; /* param_t */
    uint8_t rule;  /* limit_rule_t */
} limit_t;

static const limit_t table[LIMIT_COUNT] = {
    {PARAM_AMP_MAX_RAD, RULE_LOW},
    {PARAM_DU_MAX_RAD, RULE_LOW_OR_NO},
    {PARAM_REF_MAX_M_S, RULE_LOW},
    {PARAM_TANK_LEN_M, RULE_LOW_OR_NO},
    {PARAM_SERVO_MIN_US, RULE_HIGH},
    {PARAM_SERVO_MAX_US, RULE_LOW},
    {PARAM_SERVO_SLEW_RAD_S, RULE_LOW_OR_NO},
    {PARAM_LINK_TIMEOUT_S, RULE_LOW_OR_NO},
    {PARAM_IMU_TIMEOUT_S, RULE_LOW_OR_NO},
    {PARAM_BATT_LOW_V, RULE_HIGH},
    {PARAM_BATT_CRIT_V, RULE_HIGH},
    {PARAM_BATT_SAG_S, RULE_LOW},
    {PARAM_TILT_MAX_RAD, RULE_LOW_OR_NO},
    {PARAM_ERR_MAX_M_S, RULE_LOW_OR_NO},
    {PARAM_GUARD_BEATS, RULE_HIGH},
    {PARAM_SPD_SIGMA_MAX, RULE_LOW},
};

void limits_get(const params_t *params, float limits[LIMIT_COUNT]) {
    for (uint32_t i = 0; i < LIMIT_COUNT; i++) {
        limits[i] = params->value[table[i].param];
    }
}

static bool protects_more(uint8_t rule, float value, float than) {
    switch ((limit_rule_t)rule) {
    case RULE_LOW:
        return value < than;
    case RULE_HIGH:
        return value > than;
    case RULE_LOW_OR_NO:
        break;
    }
    return value > 0.0f && (value < than || than <= 0.0f);
}

void limits_restrict(params_t *params, const float limits[LIMIT_COUNT]) {
    for (uint32_t i = 0; i < LIMIT_COUNT; i++) {
        const param_t param = (param_t)table[i].param;
        if (protects_more(table[i].rule, limits[i], params->value[param])) {
            (void)params_set(params, param, limits[i]);
        }
    }
}
