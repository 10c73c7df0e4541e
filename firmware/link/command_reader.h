/* COMMAND_LONG and COMMAND_INT become the application's commands. Pure. */
#ifndef LINK_COMMAND_READER_H
#define LINK_COMMAND_READER_H

#include "link/command.h"
#include "link/mavlink.h"

/* Both messages in one shape. */
typedef struct {
    uint16_t command; /* MAV_CMD */
    bool as_int;
    float param1, param2, param3, param4;
    int32_t x, y; /* COMMAND_INT only */
} command_request_t;

typedef enum {
    COMMAND_READ = 0,
    COMMAND_UNKNOWN,
    COMMAND_NEEDS_INT, /* its values do not fit into a COMMAND_LONG */
    COMMAND_BAD_VALUES
} command_result_t;

/* Fills in |command| but for its sender. */
command_result_t command_read(const command_request_t *request, link_command_t *command);

/* Whether |value| is a whole number from |low| to |high|, which then is |*out|. */
bool command_read_whole(float value, float low, float high, uint32_t *out);

/* Whole numbers that a float32 parameter holds exactly. */
#define COMMAND_WHOLE_MAX 16777216.0f

#endif
