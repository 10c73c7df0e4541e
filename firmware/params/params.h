/*
 * The parameters: one table (params.def), values in a plain array owned by the caller.
 * On the wire and in files every value is a float32; whole numbers, and whole numbers
 * of halves, are marked and checked.
 */
#ifndef PARAMS_PARAMS_H
#define PARAMS_PARAMS_H

#include <stdbool.h>
#include <stdint.h>

#define PARAM_NAME_BYTES 16u /* MAVLink param_id: not terminated when 16 long */

typedef enum {
#define PARAM(name, fallback, low, high, kind, unit, text) PARAM_##name,
#include "params/params.def"
#undef PARAM
    PARAM_COUNT
} param_t;

typedef enum { PARAM_REAL = 0, PARAM_WHOLE = 1, PARAM_HALF = 2 } param_kind_t;

typedef struct {
    const char *name; /* at most 16 characters */
    float fallback;   /* value after a reset */
    float low, high;  /* inclusive */
    param_kind_t kind;
} param_info_t;

typedef struct {
    float value[PARAM_COUNT];
} params_t;

typedef enum {
    PARAM_OK = 0,
    PARAM_UNKNOWN,
    PARAM_NOT_FINITE,
    PARAM_OUT_OF_RANGE,
    PARAM_NOT_WHOLE /* or no multiple of 0.5 */
} param_result_t;

/* A parameter that had another name before (renamed.def). */
typedef struct {
    char old_name[PARAM_NAME_BYTES]; /* as a MAVLink param_id */
    uint16_t param;                  /* param_t */
} param_renamed_t;

enum {
#define RENAMED(old_name, name) PARAM_RENAMED_##name,
#include "params/renamed.def"
#undef RENAMED
    PARAM_RENAMED_COUNT
};

const param_info_t *param_info(param_t param);

/* Words for people. The host tool prints them; the firmware has no use for them, so they stay out
 * of the image. The unit of a plain number is "", the text is one line. */
const char *param_unit(param_t param);
const char *param_text(param_t param);

void params_reset(params_t *params);

/* PARAM_COUNT when there is none. |name| is a MAVLink param_id. */
param_t param_find(const char name[PARAM_NAME_BYTES]);

/* The same by the name it had before; for records written by older firmware. */
param_t param_find_renamed(const char old_name[PARAM_NAME_BYTES]);

/* Row |index| of the table, 0..PARAM_RENAMED_COUNT-1. */
const param_renamed_t *param_renamed(uint32_t index);

/* Changes nothing unless it returns PARAM_OK. */
param_result_t params_set(params_t *params, param_t param, float value);

/* The value of a PARAM_WHOLE parameter. */
int32_t params_whole(const params_t *params, param_t param);

#endif
